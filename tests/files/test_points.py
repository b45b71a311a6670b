# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dualarm_cli.errors import InputError
from dualarm_cli.exporting.files import base_file
from dualarm_cli.files.calibration.points import load_points, read_base
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.checking import load_file
from dualarm_cli.files.source.projects import Project
from dualarm_cli.geometry.rotations import exp_rotation
from tests.checked_files import check_file

Change = Callable[..., None]
Messages = Callable[..., list[str]]

POINTS = """\
dualarm: points/1
left: {robot: qin_150, tcp: {xyz: [0, 0, 347 mm]}}
noise: 0.5 mm
origin: P3
fit: [tool]
points:
  - {name: P1, left: {joints: [0, -90 deg, 0, 0, 0.5, 0]}, right: {xyz: [1, 0, 1 mm]}}
  - {name: P2, left: {joints: [1, -1, 0, 0, 0.5, 0], xyz: [1, 2, 3]}, right: {xyz: [0, 1, 0]}}
  - {name: P3, left: {xyz: [3, 2, 1]}, right: {xyz: [0, 0, 1]}}
"""
PAIR = "robot:\n  left: {robot: iiwa14, base: {xyz: [0, 0.5, 0], rpy: [0, 0, 90 deg]}}\n  right: {robot: iiwa14, base: base.yaml}"
BASE = "dualarm: base/1\nrelative_to: left\nbase: {xyz: [1, 2, 3], rpy: [0, 0, 0.3]}\n"


TABLE = """\
dualarm: robot/1
name: Table
dh:
  bases: {left: {xyz: [0, 0, 1]}}
  left:
    - {joint: a, a: 0.3, alpha: 1, d: 0.3, theta: 1, lower: -3, upper: 3, velocity: 2, radius: 0.1}
    - {joint: b, a: 1.2, lower: -2, upper: 2, velocity: 2}
arms: {left: {kind: general, flange: f}}
limits: {a: {acceleration: 5, source: assumed}, b: {acceleration: 5, source: assumed}}
"""
VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.sampled_from(["30 mm", "left", "P1", "qin_150", "base.yaml", "../x", "a", "a_link"])
    | st.text(max_size=6),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=4)
    ),
    max_leaves=8,
)


@settings(
    max_examples=150,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(kind=st.integers(0, 3), path=st.lists(st.integers(0, 9), max_size=6), value=VALUES)
def test_random_values_give_nouns_or_input_errors(
    project: Path, kind: int, path: list[int], value: object
) -> None:
    """Any value of a good file of points, table, base or pair replaced by any YAML value."""
    (project / "base.yaml").write_text(BASE)
    data = yaml.safe_load([POINTS, TABLE, BASE, f"dualarm: cell/1\n{PAIR}\n"][kind])
    holder = data
    for step in path:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        key = keys[step % len(keys)]
        if not isinstance(holder[key], dict | list) or not holder[key] or step == path[-1]:
            holder[key] = value
            break
        holder = holder[key]
    name = "base.yaml" if kind == 2 else "file.yaml"
    (project / name).write_text(yaml.safe_dump(data, allow_unicode=True))
    try:
        load_file(name)
    except InputError as error:
        assert error.diagnostics
        assert all(d.file and d.code and d.message for d in error.diagnostics)


def test_a_file_of_points_becomes_touches(project: Path) -> None:
    """SI units; what a point has not is NaN; the right robot is unknown, so it has coordinates only."""
    (project / "p.yaml").write_text(POINTS)
    loaded = load_points("p.yaml")
    touches = loaded.touches
    assert touches.names == ("P1", "P2", "P3")
    assert (touches.noise, touches.origin, touches.fit) == (0.5e-3, 2, ("tool",))
    assert touches.left.tcp == pytest.approx([0, 0, 0.347])
    assert touches.left.read.tolist() == [True, True, False]
    assert touches.left.measured.tolist() == [False, True, True]
    assert touches.left.joints[0, 1] == pytest.approx(-math.pi / 2)
    assert touches.right.robot is None
    assert touches.right.measured.all()
    assert not touches.right.read.any()
    assert touches.right.xyz[0].tolist() == [1, 0, 1e-3]
    assert set(loaded.inputs) == {"p.yaml", "robots/qin_150/robot.yaml"}
    assert check_file("p.yaml") == []


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("[0, -90 deg, 0, 0, 0.5, 0]", "[0, -90 deg, 0, 0, 0.5]", "7:31: E300 Qin et al. 2024, 150 kg robot has 6 joints (joint_1, joint_2, joint_3, joint_4, joint_5, joint_6); found 5 readings"),
        ("-90 deg", "-5", "7:35: E300 -5 is outside the limits of 'joint_2': -2.44346 to -0.0872665 rad (-140 to -5 deg); a plain number is rad, degrees are written `30 deg`"),
        ("-90 deg", "-90 mm", "7:35: E200 unit 'mm' in '-90 mm' is not one of angle; allowed: rad, mrad, deg"),
        ("[1, 2, 3]", "[1, 2, .nan]", None),
        ("[1, 2, 3]", "[1e6, 2, 3]", "8:60: E200 1000000.0 is outside the range of length: -1000 to 1000 m"),
        ("[1, 2, 3]", "[1, 2]", "8:59: E200 a list of 2 is too short; at least 3 are needed"),
        ("[1, 2, 3]", "[1 deg, 2, 3]", "8:60: E200 unit 'deg' in '1 deg' is not one of length; allowed: m, mm, cm, um, in"),
        (", right: {xyz: [0, 0, 1]}", "", "9:5: E202 'right' is missing"),
        ("{xyz: [0, 0, 1]}", "{}", "9:47: E202 no reading; give xyz, joints or both"),
        ("{xyz: [0, 0, 1]}", "{joints: [0]}", "9:48: E300 joint readings need the robot; give `right: {robot: …}` at the top"),
        ("name: P2", "name: P1", "8:12: E102 duplicate point 'P1', first at line 7"),
        ("origin: P3", "origin: P4", "4:9: E300 'P4' cannot be the origin; the first three points are: P1, P2, P3"),
        ("noise: 0.5 mm", "noise: 0", "3:8: E200 0: length must be positive"),
        ("noise: 0.5 mm", "noise: 0.5", "3:8: E200 0.5: length must be at most 0.1 m"),
        ("fit: [tool]", "fit: [toool]", "5:7: E200 'toool' is not allowed, did you mean 'tool'? Allowed: tool, base_height"),
        ("robot: qin_150", "robot: qin_15", None),
        ("robot: qin_150", "robot: sda10f", "2:15: E300 Yaskawa Motoman SDA10F has 2 arms; each robot of a pair must have exactly one"),
        ("robot: qin_150", "robot: none.yaml", "2:15: E500 there is no file 'none.yaml' here"),
        ("robot: qin_150", "robot: ../../x.yaml", None),
        ("points:", "pionts:", None),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    old: str, new: str, expected: str | None, project: Path, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    assert old in POINTS
    (project / "p.yaml").write_text(POINTS.replace(old, new, 1))
    found = messages(lambda: load_points("p.yaml"))
    if expected is not None:
        assert found == [f"p.yaml:{expected}"]
    assert found
    assert all(line.startswith("p.yaml:") for line in found)


def test_a_base_may_be_a_file(project: Path, change: Change) -> None:
    """T_cell_right = T_cell_left T_left_right: (0, 0.5, 0) + turned by 90 deg (1, 2, 3) = (-2, 1.5, 3)."""
    (project / "base.yaml").write_text(BASE)
    change("cell.yaml", "robot: robot.yaml", PAIR)
    loaded = load_cell("cell.yaml")
    assert "base.yaml" in loaded.inputs
    urdf = loaded.cell.robot.urdf
    start = urdf.index('name="world_to_right"')
    xyz = urdf[start:].split('xyz="')[1].split('"')[0]
    rpy = urdf[start:].split('rpy="')[1].split('"')[0]
    assert [float(w) for w in xyz.split()] == pytest.approx([-2.0, 1.5, 3.0])
    assert [float(w) for w in rpy.split()] == pytest.approx([0.0, 0.0, 0.3 + math.pi / 2])
    (project / "base.yaml").write_text(BASE.replace("relative_to: left\n", ""))
    urdf = load_cell("cell.yaml").cell.robot.urdf
    start = urdf.index('name="world_to_right"')
    xyz = urdf[start:].split('xyz="')[1].split('"')[0]
    assert [float(w) for w in xyz.split()] == pytest.approx([1.0, 2.0, 3.0])
    assert check_file("base.yaml") == []


@pytest.mark.parametrize(
    ("cell", "base", "expected"),
    [
        (("base: base.yaml", "base: none.yaml"), None, "cell.yaml:4:32: E500 there is no file 'none.yaml' here"),
        (("base: base.yaml", "base: 5"), None, "cell.yaml:4:32: E200 must be a pose, such as {xyz: [0, 0, 0]}, or the path of a base file, not 5"),
        (("base: base.yaml", "base: {xzy: [0, 0, 0]}"), None, "cell.yaml:4:33: E201 unknown key 'xzy', did you mean 'xyz'? Allowed: xyz, rpy, quat"),
        (("base: base.yaml", "base: {xyz: [0, 0]}"), None, "cell.yaml:4:38: E200 a list of 2 is too short; at least 3 are needed"),
        (("base: base.yaml", "base: robot.yaml"), None, "robot.yaml:1:10: E200 this is a robot file (robot/1); required here: base/1"),
        (("base: {xyz: [0, 0.5, 0], rpy: [0, 0, 90 deg]}", "base: base.yaml"), None, "cell.yaml:3:31: E300 the file gives this robot's base relative to itself (left); use it for the other robot"),
        (None, ("relative_to: left", "relative_to: up"), "base.yaml:2:14: E200 'up' is not allowed; allowed: left, right"),
        (None, ("relative_to: left", "relative_to: right"), "cell.yaml:4:32: E300 the file gives this robot's base relative to itself (right); use it for the other robot"),
        (None, ("xyz: [1, 2, 3]", "xyz: [1, 2, x]"), "base.yaml:3:20: E200 'x' is not a number; write one such as '30 mm'"),
        (None, ("base: {", "bsae: {"), None),
    ],
)  # fmt: skip
def test_mistakes_in_bases_are_reported_at_their_place(
    cell: tuple[str, str] | None,
    base: tuple[str, str] | None,
    expected: str | None,
    project: Path,
    change: Change,
    messages: Messages,
) -> None:
    """In the cell file or in the base file, whichever is wrong; nothing else."""
    (project / "base.yaml").write_text(BASE)
    change("cell.yaml", "robot: robot.yaml", PAIR)
    if cell:
        change("cell.yaml", *cell)
    if base:
        change("base.yaml", *base)
    found = messages(lambda: load_cell("cell.yaml"))
    assert all(line.startswith("base.yaml") for line in found) if expected is None else True
    assert expected is None or found == [expected]


def test_a_base_file_stays_in_the_project(
    project: Path, change: Change, messages: Messages
) -> None:
    """A path that leads out is refused."""
    change("cell.yaml", "robot: robot.yaml", PAIR.replace("base.yaml", "../../base.yaml"))
    assert "leaves the project folder" in messages(lambda: load_cell("cell.yaml"))[0]


def test_two_robots_cannot_both_stand_on_each_other(
    project: Path, change: Change, messages: Messages
) -> None:
    """One of them has to stand in the cell."""
    (project / "base.yaml").write_text(BASE)
    (project / "other.yaml").write_text(BASE.replace("left", "right"))
    change("cell.yaml", "robot: robot.yaml", PAIR)
    change("cell.yaml", "base: {xyz: [0, 0.5, 0], rpy: [0, 0, 90 deg]}", "base: other.yaml")
    assert messages(lambda: load_cell("cell.yaml")) == [
        "cell.yaml:4:32: E300 the base of each robot is given relative to the other; give one of them a pose in the cell"
    ]


def test_what_is_written_is_read_back_to_rounding(project: Path) -> None:
    """50 random poses, near quarter turns of pitch among them, to 1e-15; remarks stay comments."""
    random = np.random.default_rng(0)
    for k in range(50):
        R = exp_rotation(random.normal(size=3) if k % 2 else np.array([0, math.pi / 2, 1e-9 * k]))
        t = random.normal(size=3)
        (project / "b.yaml").write_bytes(base_file(R, t, ["a remark: {\nwith: a line end"]))
        base = read_base(Project.of(project / "b.yaml"), project / "b.yaml", "b.yaml")
        assert base.relative_to == "left"
        np.testing.assert_allclose(base.pose.rotation, R, atol=2e-15)
        assert base.pose.translation.tolist() == t.tolist()
