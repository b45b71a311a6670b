"""Clearance by what each arm holds: many postures with different parts at once are each one by itself."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.clearance import CellClearance, Load
from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Obstacle
from dualarm_cli.model.shape import Shape

SHELF = Obstacle(
    "shelf", Shape("box", (0.6, 1.6, 0.05), pin.SE3(np.eye(3), np.array([0.7, 0.0, 0.6])))
)
SHAPES = {"rod": (0.02, 0.02, 0.5), "plate": (0.3, 0.3, 0.02)}


@pytest.fixture(scope="module")
def cell(tasks_folder):
    """Two parts and a shelf."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    ahead = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05]))
    parts = {name: (Shape("box", sides, ahead),) for name, sides in SHAPES.items()}
    return dataclasses.replace(cell, parts=parts, obstacles=(SHELF,), clearance=0.005)


@pytest.fixture(scope="module")
def clearance(cell):
    """Both parts, carried by either arm."""
    return CellClearance.of(cell, [(arm, part) for arm in ("left", "right") for part in SHAPES])


@pytest.fixture(scope="module")
def postures(tasks_folder):
    """Forty about the one in which the packing job begins, shape (40, 15)."""
    robot = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell.robot
    random = np.random.default_rng(2)
    return robot.postures["home"] + random.normal(scale=0.6, size=(40, len(robot.joints)))


def test_every_load_has_a_number_of_its_own(clearance):
    """Three names on and off lines and handed over, in two scenes: all are told apart, and found again."""
    loads, names = clearance.loads, ("", "rod", "plate")
    assert loads.names == names
    off = np.array([loads.number(name) for name in names])
    on, handed = loads.on_lines(off), loads.at_stops(off, np.array([True]))
    assert on.tolist() == [loads.number(name, on_line=True) for name in names]
    for scene in (0, 1):
        given = [loads.in_scenes(numbers, np.array(scene)) for numbers in (off, on, handed.ravel())]
        found = [loads.load(number) for numbers in given for number in numbers.tolist()]
        assert found == [
            *(Load(name, scene=scene) for name in names),
            *(Load(name, on_line=True, scene=scene) for name in names),
            *(Load(name, is_handed=True, scene=scene) for name in names),
        ]
        for numbers, plain in zip(given, (off, off, handed.ravel()), strict=True):
            assert (loads.scenes(numbers) == scene).all()
            np.testing.assert_array_equal(loads.off_lines(numbers), plain)
        assert [bool(loads.are_on_lines(numbers).any()) for numbers in given] == [
            False,
            True,
            False,
        ]
        np.testing.assert_array_equal(loads.in_first_scene(given[1]), on)
    np.testing.assert_array_equal(loads.nothing(2, 1), [off[:1], off[:1]])


def test_arms_at_stops_are_on_lines_or_hand_over(clearance):
    """Two stages: a pick of the right arm, and a hand-over of the rod."""
    loads = clearance.loads
    empty, rod = loads.number(""), loads.number("rod")
    at = loads.at_stops(np.array([[empty, rod], [rod, empty]]), np.array([False, True]))
    assert [[loads.load(number) for number in row] for row in at.tolist()] == [
        [Load("", on_line=True), Load("rod", on_line=True)],
        [Load("rod", is_handed=True), Load("", is_handed=True)],
    ]


def test_margins_of_mixed_rows_are_those_of_each_row_alone(clearance, postures):
    """Every part in either hand, on and off lines; a part takes clearance and never gives any."""
    held = np.random.default_rng(3).integers(0, 6, (40, 2))
    together = clearance.margins(postures, held)
    alone = [
        clearance.margins(q[None], number[None])[0]
        for q, number in zip(postures, held, strict=True)
    ]
    np.testing.assert_allclose(together, alone, atol=2e-6)
    nothing = clearance.margins(postures, np.zeros((40, 2), dtype=np.int64))
    assert (together <= nothing + 2e-6).all()
    assert (together < nothing - 0.01).any()


def test_of_an_arm_alone_only_its_own_margins_count(clearance, postures):
    """Neither those from the other arm nor those of the other arm, wherever that stands."""
    held = np.random.default_rng(4).integers(0, 6, (40, 2))
    apart = dataclasses.replace(clearance, alone="left")
    assert (apart.cross_margins(postures, held) == np.inf).all()
    own = clearance.arm_margins(0, postures, held[:, 0], ground=True)
    np.testing.assert_array_equal(apart.margins(postures, held), own)
    assert all("right" not in pair[0] + pair[1] for pair in apart.lacking(postures[0], held[0]))
    assert np.isfinite(clearance.cross_margins(postures, held)).all()


@pytest.mark.parametrize("part", ["", "rod", "plate"])
@pytest.mark.parametrize("on_line", [False, True])
def test_a_number_stands_for_the_pairs_of_its_part(clearance, postures, part, on_line):
    """Off lines all pairs of the arm with its part; on lines without what stands, which counts where it is reached."""
    held = np.full(40, clearance.loads.number(part, on_line=on_line))
    test = clearance.test
    for a, arm in enumerate(clearance.arms):
        own = test.margins(test.arm_pairs(arm, part, on_line), postures)
        np.testing.assert_array_equal(clearance.arm_margins(a, postures, held), own)
        lying = test.margins(test.ground(arm, part), postures)
        least = np.where((lying < 0.0) & on_line, np.minimum(own, lying), own)
        found = clearance.arm_margins(a, postures, held, ground=True)
        np.testing.assert_array_equal(found, least)


@pytest.mark.parametrize("parts", [[], ["rod"], ["rod", "plate"]])
def test_arms_keep_clear_of_what_the_other_one_holds(cell, postures, parts):
    """Of none, one and two parts: the quick test's pairs for what is held, whether on lines or not."""
    carried = [("left", part) for part in parts]
    clearance, test = CellClearance.of(cell, carried), QuickTest(cell, carried)
    for part in ["", *parts]:
        for on_line in (False, True):
            held = np.tile([clearance.loads.number(part, on_line=on_line), 0], (40, 1))
            expected = test.margins(test.cross({"left": part, "right": ""}), postures)
            np.testing.assert_array_equal(clearance.cross_margins(postures, held), expected)
