"""Targets on conveyors, touched points, and what nouns ask for where nobody names anything."""

from __future__ import annotations

import dataclasses
import importlib
import math
import pkgutil
import sys

import numpy as np
import pinocchio as pin
import pytest

import dualarm_cli.model
from dualarm_cli.kinds.path.reading import PathSection
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import PoseTarget, Stop
from dualarm_cli.model.part_flow import Conveyor, OnBelt
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.shape import Hull, Shape
from dualarm_cli.model.studies.study import Amount
from dualarm_cli.model.touches import TouchSide

BELT = Conveyor("belt", np.array([0.3, 0.0, -0.4]))
TURNED = pin.SE3(pin.utils.rotate("x", math.pi), np.array([1.0, 2.0, 3.0]))


def test_a_belt_carries_its_targets_on_without_turning_them() -> None:
    """0.5 m/s: 1 m within takes 2 s; 4 s after it was at its pose it is 1.2 m and -1.6 m farther."""
    on = OnBelt(BELT, passes=3.0, within=1.0, at=3.0)
    assert BELT.speed == pytest.approx(0.5)
    assert on.last == pytest.approx(5.0)
    assert on.gone(5.0) == pytest.approx(1.0)
    assert on.gone(2.0) == pytest.approx(-0.5)
    pose, later = on.moved(TURNED, 7.0)
    np.testing.assert_allclose(pose.translation, [2.2, 2.0, 1.4])
    np.testing.assert_allclose(pose.rotation, TURNED.rotation)
    assert (later.at, later.passes, later.within) == (7.0, 3.0, 1.0)
    again, _ = later.moved(pose, 3.0)
    np.testing.assert_allclose(again.translation, TURNED.translation)


def test_a_stop_is_met_where_the_belt_has_its_target() -> None:
    """The same as above by the stop; one that stands is itself."""
    stands = Stop("pick", PoseTarget(TURNED), 0.0, 0.0, Dwell(), NOWHERE)
    assert stands.met(9.0) is stands
    moves = dataclasses.replace(stands, belt=OnBelt(BELT, 3.0, 1.0, 3.0)).met(7.0)
    assert isinstance(moves.target, PoseTarget)
    np.testing.assert_allclose(moves.target.pose.translation, [2.2, 2.0, 1.4])


@pytest.mark.parametrize(
    ("action", "buffer", "stored"),
    [("pick", "b", -1), ("place", "b", 1), ("move", "b", 0), ("pick", "", 0), ("place", "", 0)],
)
def test_a_place_fills_a_buffer_and_a_pick_empties_it(action, buffer, stored) -> None:
    """One part; none where no buffer is named."""
    stop = Stop(action, PoseTarget(TURNED), 0.0, 0.0, Dwell(1.0, 2.0, 4.0), NOWHERE, buffer)
    assert stop.stored == stored
    assert stop.dwell.total == 7.0


@pytest.mark.parametrize(("kind", "with_hull"), [("mesh", False), ("box", True)])
def test_meshes_alone_have_hulls(kind, with_hull) -> None:
    """And a mesh is nothing without."""
    hull = Hull(np.zeros((4, 3)), np.zeros((4, 3), dtype=np.int64))
    with pytest.raises(ValueError, match="hull"):
        Shape(kind, (), TURNED, hull if with_hull else None)
    Shape(kind, (), TURNED, None if with_hull else hull)


def test_points_are_read_where_every_joint_is_and_measured_where_every_coordinate_is() -> None:
    """A reading that lacks one number is none, and a robot without joints reads nothing."""
    nan = math.nan
    xyz = np.array([[1, 2, 3], [1, nan, 3], [nan, nan, nan]], dtype=float)
    some = TouchSide(None, np.zeros(3), np.array([[1.0, 2.0], [nan, 2.0], [nan, nan]]), xyz)
    assert some.read.tolist() == [True, False, False]
    assert some.measured.tolist() == [True, False, False]
    assert not TouchSide(None, np.zeros(3), np.zeros((3, 0)), xyz).read.any()
    assert TouchSide(None, np.zeros(3), np.zeros((3, 1)), xyz).read.all()


PATH = PathSection.model_fields
LIMITS = JointLimits(("j",), *np.array([[-1.0], [1.0], [2.0], [3.0], [5.0]]), ("",))
NEUTRAL = {
    ("Care", "speed"): lambda speed: (LIMITS.scaled(speed).jerk == LIMITS.jerk).all(),
    ("Care", "acceleration"): lambda share: LIMITS.scaled(1.0, share).acceleration == 3.0,
    ("Care", "tool_speed"): lambda speed: speed > sys.float_info.max,
    ("Care", "tilt"): lambda angle: angle > math.pi,
    ("Job", "speed"): lambda speed: (LIMITS.scaled(speed).jerk == LIMITS.jerk).all(),
    ("Task", "not_after"): lambda last: last > sys.float_info.max,
    ("Stop", "straight"): lambda length: min(length, sys.float_info.max) == sys.float_info.max,
    ("PoseTarget", "symmetry"): lambda poses: math.isclose(math.cos(math.tau / poses), 1.0),
    ("Grasp", "symmetry"): lambda poses: math.isclose(math.cos(math.tau / poses), 1.0),
    ("Amount", "factor"): lambda factor: Amount(7.0, factor=factor).si == 7.0,
    ("PathWork", "tolerance"): lambda tolerance: tolerance == PATH["tolerance"].default,
    ("PathWork", "stiffness"): lambda stiffness: stiffness == PATH["stiffness"].default,
}
"""Fields of nouns that are not 0 by themselves, with the effect that nobody asked for anything has."""


def test_what_nobody_names_is_not_asked_for() -> None:
    """Lengths, times and angles of all nouns are 0 by themselves, freedoms are false."""
    seen = set()
    for found in pkgutil.walk_packages(dualarm_cli.model.__path__, "dualarm_cli.model."):
        for noun in vars(importlib.import_module(found.name)).values():
            if not (isinstance(noun, type) and dataclasses.is_dataclass(noun)):
                continue
            if noun.__name__.endswith("Settings"):
                continue
            for field in dataclasses.fields(noun):
                if isinstance(field.default, (int, float)):
                    key = (noun.__name__, field.name)
                    assert NEUTRAL.get(key, lambda value: value == 0)(field.default), key
                    seen.add(key)
    assert seen >= {*NEUTRAL, ("Ellipse", "outward")}
    assert not any((NOWHERE.file, NOWHERE.line, NOWHERE.column))
