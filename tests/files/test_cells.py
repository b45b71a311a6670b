# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.cells.cells import load_cell

Change = Callable[..., None]
Messages = Callable[..., list[str]]

SINGLE = """\
dualarm: robot/1
name: Single
urdf: tiny.urdf
arms: {left: {joints: [turn, l1, l2], flange: l_tool, kind: general}}
limits:
  turn: {acceleration: 5, source: assumed}
  l1: {acceleration: 6, source: assumed}
  l2: {acceleration: 7, source: assumed}
postures: {bent: {l1: 0.5}}
"""


def test_a_cell_file_becomes_a_cell(project: Path) -> None:
    """Tools, frames and obstacles of the tiny cell, by hand."""
    cell = load_cell("cell.yaml").cell
    assert cell.tools["left"].tcp.translation.tolist() == [0, 0, 0.12]
    assert cell.tools["left"].inertia.mass == 0.8
    assert cell.tools["right"].tcp == pin.SE3.Identity()
    assert cell.clearance == 0.01
    # The bin is turned by 90 deg about z, so 0.1 along its x is 0.1 along the world's y.
    slot = cell.frames["bin.slot"]
    assert slot.translation == pytest.approx([0.4, 0.2, 0.7])
    assert slot.rotation == pytest.approx(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), abs=1e-15)
    (table,) = cell.obstacles
    assert (table.name, table.shape.kind, table.shape.size) == ("table", "box", (1.0, 2.0, 0.04))
    assert table.shape.pose.translation.tolist() == [0.5, 0.0, 0.6]


def test_frames_compose_in_any_order_of_the_file(project: Path, change: Change) -> None:
    """Three nested frames, the innermost first, against matrices multiplied by hand."""
    change(
        "cell.yaml",
        "  bin.slot: {in: bin, xyz: [0.1, 0, 0]}",
        "  c: {in: b, xyz: [0, 0, 0.3], rpy: [0.1, 0.2, 0.3]}\n"
        "  b: {in: a, xyz: [0, 0.2, 0], rpy: [0, 90 deg, 0]}\n"
        "  a: {in: world, xyz: [0.1, 0, 0], quat: [0, 0, 1, 0]}",
    )
    a = np.array([[-1, 0, 0, 0.1], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
    b = np.array([[0, 0, 1, 0], [0, 1, 0, 0.2], [-1, 0, 0, 0], [0, 0, 0, 1.0]])

    def turn(axis: int, angle: float) -> np.ndarray:
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        R = np.eye(3)
        R[i, i] = R[j, j] = math.cos(angle)
        R[i, j], R[j, i] = -math.sin(angle), math.sin(angle)
        return R

    c = np.eye(4)
    c[:3, :3] = turn(2, 0.3) @ turn(1, 0.2) @ turn(0, 0.1)
    c[2, 3] = 0.3
    frames = load_cell("cell.yaml").cell.frames
    assert list(frames) == ["bin", "c", "b", "a"]
    assert frames["c"].homogeneous == pytest.approx(a @ b @ c, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "kind", "size"),
    [
        ("sphere: 50 mm", "sphere", (0.05,)),
        ("sphere: {radius: 50 mm}", "sphere", (0.05,)),
        ("cylinder: {radius: 0.1, length: 0.2}", "cylinder", (0.1, 0.2)),
        ("capsule: {radius: 0.1, length: 0.2}", "capsule", (0.1, 0.2)),
        ("half_space: true", "half_space", ()),
        ("half_space: {}", "half_space", ()),
        ("mesh: {file: m.obj, scale: 0.001}", "mesh", ()),
        ("mesh: m.obj", "mesh", ()),
    ],
)
def test_every_kind_of_solid_is_read(
    text: str, kind: str, size: tuple[float, ...], project: Path, change: Change
) -> None:
    """In a named frame: 0.5 along the bin's x is 0.5 along the world's y."""
    (project / "m.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")
    change("cell.yaml", "box: [1, 2, 40 mm]", f"in: bin, {text}")
    shape = load_cell("cell.yaml").cell.obstacles[0].shape
    assert (shape.kind, shape.size) == (kind, size)
    assert shape.pose.translation == pytest.approx([0.4, 0.6, 1.3])
    if kind == "mesh":
        scale = 0.001 if "scale" in text else 1.0
        assert shape.hull is not None
        wanted = sorted([(0.0, 0.0, 0.0), (scale, 0.0, 0.0), (0.0, scale, 0.0), (0.0, 0.0, scale)])
        assert sorted(map(tuple, shape.hull.corners)) == wanted


def test_two_robots_become_one(project: Path, change: Change) -> None:
    """Names are prefixed, bases are mounts on a world link, postures and limits side by side."""
    (project / "single.yaml").write_text(SINGLE)
    change(
        "cell.yaml",
        "robot: robot.yaml",
        "robot:\n  left: {robot: single.yaml, base: {xyz: [-0.5, 0, 0]}}\n"
        "  right: {robot: single.yaml, base: {xyz: [0.5, 0, 0], rpy: [0, 0, 180 deg]}}",
    )
    robot = load_cell("cell.yaml").cell.robot
    assert robot.joints == (
        "left_turn", "left_l1", "left_l2", "right_turn", "right_l1", "right_l2",
    )  # fmt: skip
    assert [(arm.name, arm.flange) for arm in robot.arms] == [
        ("left", "left_l_tool"),
        ("right", "right_l_tool"),
    ]
    assert robot.limits.acceleration.tolist() == [5, 6, 7, 5, 6, 7]
    assert robot.postures["bent"].tolist() == [0, 0.5, 0, 0, 0.5, 0]
    model = pin.buildModelFromXML(robot.urdf)
    assert model.nq == 6
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    # All joints at 0: four steps of 0.1 along x, mirrored for the right robot turned by 180 deg.
    left = data.oMf[model.getFrameId("left_l_tool")].translation
    right = data.oMf[model.getFrameId("right_l_tool")].translation
    assert left == pytest.approx([-0.1, 0, 0.8])
    assert right == pytest.approx([0.1, 0, 0.8])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("bin: {xyz", "bin: {in: bin.slot, xyz", "6:13: E300 frames form a cycle: 'bin' in 'bin.slot' in 'bin'"),
        ("in: bin,", "in: bon,", "7:18: E300 there is no frame 'bon', did you mean 'bin'? Frames: bin, bin.slot, world"),
        ("bin.slot: {in", "world: {in", "7:3: E300 'world' is the name of the root frame; choose another name"),
        ("box: [1, 2, 40 mm]", "box: [1, 2, 0]", "9:23: E200 0: length must be positive"),
        ("box: [1, 2, 40 mm]", "sphere: -0.1", "9:19: E200 -0.1: length must be positive"),
        ("box: [1, 2, 40 mm]", "capsule: {radius: 1 mm}", "9:20: E202 'length' is missing"),
        ("box: [1, 2, 40 mm]", "box: [1, 1, 1], sphere: 1", "9:27: E200 more than one shape: box, sphere; keep one"),
        ("box: [1, 2, 40 mm], ", "", "9:10: E200 no shape; give one of box, sphere, cylinder, capsule, half_space, mesh"),
        ("box: [1, 2, 40 mm]", "mesh: none.stl", "9:17: E500 there is no file 'none.stl' here"),
        ("box: [1, 2, 40 mm]", "in: bim, box: [1, 1, 1]", "9:15: E300 the cell has no frame 'bim', did you mean 'bin'? It has: bin, bin.slot, world"),
        ("  table:", "  table: {sphere: 1}\n  table:", "10:3: E102 duplicate key 'table', first at line 9"),
        ("robot: robot.yaml", "robot: 5", "2:8: E200 must be a robot's name, a path, or {left: …, right: …}, not 5"),
        ("robot: robot.yaml", "robot: none.yaml", "2:8: E500 there is no file 'none.yaml' here"),
        ("robot: robot.yaml\n", "", "1:1: E202 'robot' is missing"),
        ("left: {tcp", "lefft: {tcp", "4:3: E201 unknown key 'lefft', did you mean 'left'? Allowed: left, right"),
        ("mass: 800 g", "mass: -1", "4:44: E200 -1: mass must be at least 0"),
        ("clearance: 10 mm", "clearance: 10 s", "10:12: E200 unit 's' in '10 s' is not one of length; allowed: m, mm, cm, um, in"),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    old: str, new: str, expected: str, project: Path, change: Change, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    change("cell.yaml", old, new)
    assert messages(lambda: load_cell("cell.yaml")) == [f"cell.yaml:{expected}"]


def test_a_pair_needs_robots_of_one_arm_without_a_platform(
    project: Path, change: Change, messages: Messages
) -> None:
    """The whole tiny robot has two arms; with the platform kept it has one and a platform."""
    one_arm = SINGLE.replace(
        "arms: {left: {joints: [turn,", "platform: [turn]\narms: {left: {joints: ["
    )
    (project / "carried.yaml").write_text(one_arm)
    change(
        "cell.yaml",
        "robot: robot.yaml",
        "robot: {left: {robot: robot.yaml}, right: {robot: carried.yaml}}",
    )
    assert messages(lambda: load_cell("cell.yaml")) == [
        "cell.yaml:2:23: E300 Tiny has 2 arms; each robot of a pair must have exactly one",
        "cell.yaml:2:51: E300 Single has a platform; robots of a pair must not have one",
    ]


def test_a_tool_needs_its_arm(project: Path, change: Change, messages: Messages) -> None:
    """A robot with a left arm only has nowhere to put a right tool."""
    (project / "single.yaml").write_text(SINGLE)
    change("cell.yaml", "robot: robot.yaml", "robot: single.yaml", "  left: {tcp", "  right: {tcp")
    assert messages(lambda: load_cell("cell.yaml")) == [
        "cell.yaml:4:3: E300 Single has no right arm; it has left"
    ]


@pytest.fixture
def weighed(project: Path, change: Change) -> Callable[[str, str], pin.Inertia]:
    """The inertia of a part with given solids and keys, in the frame of its tool."""

    def read(shapes: str, keys: str) -> pin.Inertia:
        text = (project / "cell.yaml").read_text()
        (project / "weighed.yaml").write_text(
            text + f"parts: {{weighed: {{shapes: [{shapes}], {keys}}}}}\n"
        )
        return load_cell("weighed.yaml").cell.part_inertias["weighed"]

    return read


def test_the_weight_of_a_part_follows_from_its_solids(
    weighed: Callable[[str, str], pin.Inertia],
) -> None:
    """A bar of two cubes by hand: 2.7 g/cm³ times volume, their common centre, Steiner's theorem."""
    cubes = "{box: [0.1, 0.1, 0.1], xyz: [0, 0, 0.05]}, {box: [0.1, 0.1, 0.1], xyz: [0, 0, 0.15]}"
    inertia = weighed(cubes, "density: 2.7 g/cm^3")
    assert inertia.mass == pytest.approx(5.4, rel=1e-12)
    assert inertia.lever == pytest.approx([0.0, 0.0, 0.1], abs=1e-15)
    along, across = 2 * 2.7 * 0.01 / 6, 5.4 * (0.01 + 0.04) / 12
    assert inertia.inertia == pytest.approx(np.diag([across, across, along]), abs=1e-12)
    # The same mass, stated, has the same moments.
    assert weighed(cubes, "mass: 5.4 kg").inertia == pytest.approx(inertia.inertia, rel=1e-9)


def test_stated_centres_and_moments_have_priority(
    weighed: Callable[[str, str], pin.Inertia],
) -> None:
    """Of a ball of 2 kg: its own moments 2/5 m r² about a stated centre, or the stated ones."""
    ball = "{sphere: 50 mm}"
    inertia = weighed(ball, "mass: 2 kg, center_of_mass: [0, 10 mm, 0]")
    assert inertia.lever.tolist() == [0.0, 0.01, 0.0]
    assert inertia.inertia == pytest.approx(0.4 * 2.0 * 0.05**2 * np.eye(3), rel=1e-12)
    stated = weighed(ball, "mass: 2 kg, inertia: [0.1, 0.2, 0.25, 0.01, 0.02, 0.03]")
    expected = [[0.1, 0.01, 0.02], [0.01, 0.2, 0.03], [0.02, 0.03, 0.25]]
    assert stated.inertia == pytest.approx(np.array(expected), rel=1e-12)
    units = "mass: 2 kg, inertia: [0.1 kg m^2, 0.2 kgm², 250e6 g mm², 0.01, 0.02, 0.03]"
    assert weighed(ball, units).inertia == pytest.approx(stated.inertia, rel=1e-12)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ("mass: 1 kg, density: 7", "the mass follows from the density; keep one of the two"),
        ("density: 0", "density must be positive"),
        ("center_of_mass: [0, 0, 0]", "it needs a mass"),
        ("inertia: [1, 1, 1]", "it needs a mass"),
        ("mass: 1 kg, inertia: [1, 1, 1, 1]", "takes 3 or 6 numbers, not 4"),
        ("mass: 1 kg, inertia: [1, 1, 3]", "no body has these moments"),
        ("mass: 1 kg, inertia: [1, 1, 1, 2, 0, 0]", "no body has these moments"),
        ("mass: 1 kg, inertia: [1.0e+300, 1.0e+300, 1.0e+300]", "1e+06"),
        (
            "mass: 1 kg, inertia: [1 lb, 1, 1]",
            "unit 'lb' in '1 lb' is not one of moment of inertia",
        ),
        ("mass: -1 kg", "mass must be at least 0"),
    ],
)
def test_weights_that_no_body_has_are_refused(
    weighed: Callable[[str, str], pin.Inertia], keys: str, message: str
) -> None:
    """Each at its place, with what is wrong."""
    with pytest.raises(InputError, match=re.escape(message)):
        weighed("{sphere: 50 mm}", keys)


def test_a_density_goes_with_a_stated_centre(
    weighed: Callable[[str, str], pin.Inertia],
) -> None:
    """The mass from the volume of a cube of 0.1 m, the centre as stated."""
    inertia = weighed("{box: [0.1, 0.1, 0.1]}", "density: 1000, center_of_mass: [0, 0, 20 mm]")
    assert inertia.mass == pytest.approx(1.0, rel=1e-12)
    assert inertia.lever.tolist() == [0.0, 0.0, 0.02]


def test_a_tool_without_solids_weighs_at_its_centre_point(project: Path, change: Change) -> None:
    """As the tiny cell's left tool does; a density has no volume to act on."""
    inertia = load_cell("cell.yaml").cell.tools["left"].inertia
    assert inertia.lever.tolist() == [0, 0, 0.12]
    assert not inertia.inertia.any()
    change("cell.yaml", "mass: 800 g", "density: 1000")
    with pytest.raises(InputError, match="a density needs shapes that have a volume"):
        load_cell("cell.yaml")
