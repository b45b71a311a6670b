# ruff: noqa: E501 (tables of exact messages, one a line)
"""Paths in task files: what they become, and every mistake at its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.curves.tool_path import Line, Spline, Turn
from dualarm_cli.model.job import Job, PoseTarget
from dualarm_cli.model.process_work import PathWork

Change = Callable[..., None]
Messages = Callable[..., list[str]]

HEAD = "dualarm: tasks/1\ncell: cell.yaml\nstart: bent\ntasks:\n"
ONE = (
    HEAD
    + """\
  - id: seam
    arm: left
    path:
      speed: 50 mm/s
      through:
        - {xyz: [0.4, 0.1, 0.9], rpy: [180 deg, 0, 0]}
        - {xyz: [0.5, 0.1, 0.9]}
        - {arc: {via: {xyz: [0.6, 0.2, 0.9]}, to: {xyz: [0.5, 0.3, 0.9]}}}
        - {turn: {about: [0.5, 0.5, 0], axis: [0, 0, 1], angle: 90 deg}}
        - {spline: [{xyz: [0.8, 0.5, 0.9]}, {xyz: [0.9, 0.4, 1.0]}]}
"""
)
BOTH = (
    HEAD
    + """\
  - id: seams
    path:
      speed: 50 mm/s
      left:
        through:
          - {xyz: [0.4, 0.1, 0.9], rpy: [0, 0, 0]}
          - {xyz: [0.5, 0.1, 0.9]}
      right:
        poses: right.csv
"""
)
COLUMNS = "x,y,z,qx,qy,qz,qw\n"
CSV = COLUMNS + "0,0,0,0,0,0,1\n0.1,0,0,0,0,0,1\n0.2,0.3,0,0,0,0,1\n"


@pytest.fixture
def one(project: Path) -> Path:
    """The tiny project with a path of the left arm."""
    (project / "tasks.yaml").write_text(ONE)
    return project


@pytest.fixture
def both(project: Path) -> Path:
    """The tiny project with paths of both arms, one of them from a file."""
    (project / "tasks.yaml").write_text(BOTH)
    (project / "right.csv").write_text(CSV)
    return project


def work_of(job: Job) -> PathWork:
    """The path of the first task."""
    work = job.tasks[0].path
    assert work is not None
    return work


def test_every_kind_of_piece_becomes_what_it_says(one: Path) -> None:
    """Line, arc, turn and spline, each from where the one before ends, by hand."""
    (task,) = load_job("tasks.yaml").tasks
    assert (task.id, task.arm) == ("seam", "left")
    path = work_of(load_job("tasks.yaml")).paths["left"]
    line, arc, turn, spline = path.pieces
    assert isinstance(line, Line)
    assert isinstance(arc, Turn)
    assert isinstance(turn, Turn)
    assert isinstance(spline, Spline)
    assert line.length == pytest.approx(0.1)
    # Half a circle of radius 0.1 about (0.5, 0.2).
    assert arc.about == pytest.approx([0.5, 0.2, 0.9])
    assert arc.length == pytest.approx(0.1 * np.pi)
    # From (0.5, 0.3) a quarter turn about (0.5, 0.5): the radius -y becomes +x, (0.7, 0.5).
    assert turn.length == pytest.approx(0.2 * np.pi / 2)
    end = path.pose(0.1 + 0.1 * np.pi + 0.1 * np.pi)
    assert end.translation == pytest.approx([0.7, 0.5, 0.9])
    down = pin.utils.rotate("x", np.pi)
    assert end.rotation == pytest.approx(pin.utils.rotate("z", np.pi / 2) @ down, abs=1e-12)
    assert [p.translation.tolist() for p in spline.poses[1:]] == [[0.8, 0.5, 0.9], [0.9, 0.4, 1.0]]
    (stop,) = task.stops
    assert isinstance(stop.target, PoseTarget)
    assert (stop.action, stop.approach, stop.retract, stop.dwell.total) == ("path", 0.0, 0.0, 0.0)
    assert stop.target.pose.translation == pytest.approx([0.9, 0.4, 1.0])
    assert str(stop.place) == "tasks.yaml:8:7"


def test_what_the_file_leaves_out_has_its_default(one: Path) -> None:
    """Slower forbidden, 0.1 mm, no torques, no posture; acceleration, jerk and method are left open."""
    work = work_of(load_job("tasks.yaml"))
    assert (work.speed, work.slower, work.tolerance, work.torque) == (0.05, False, 1e-4, False)
    assert (work.acceleration, work.jerk, work.redundancy, work.posture) == (None,) * 4
    assert (work.stiffness, work.critical_points) == (10.0, {})


def test_what_the_file_gives_counts(one: Path, change: Change) -> None:
    """With units; a critical point by its place, another by radius, angle and height: (0.3 cos 60°, 0.3 sin 60°, 0.5)."""
    change(
        "tasks.yaml",
        "speed: 50 mm/s",
        "speed: 50 mm/s\n      acceleration: 200 mm/s²\n      jerk: 3\n      slower: allowed\n"
        "      tolerance: 0.5 mm\n      redundancy: min_norm\n      posture: bent\n      stiffness: 4\n"
        "      torque: limited\n      critical_points: {left: {radius: 300 mm, angle: 60 deg, height: 0.5}}",
    )
    work = work_of(load_job("tasks.yaml"))
    assert (work.acceleration, work.jerk, work.slower) == (0.2, 3.0, True)
    assert work.tolerance == pytest.approx(5e-4)
    assert (work.redundancy, work.posture, work.stiffness, work.torque) == ("min_norm", "bent", 4.0, True)  # fmt: skip
    assert work.critical_points["left"] == pytest.approx([0.15, 0.3 * np.sqrt(0.75), 0.5])
    change("tasks.yaml", "{radius: 300 mm, angle: 60 deg, height: 0.5}", "{xyz: [1, 2 mm, 3]}")
    assert work_of(load_job("tasks.yaml")).critical_points["left"].tolist() == [1.0, 0.002, 3.0]


def test_a_pose_without_a_rotation_keeps_the_one_before(one: Path, change: Change) -> None:
    """On lines, ends of arcs and splines; after the turn the turned one. A rotation of its own counts."""
    path = work_of(load_job("tasks.yaml")).paths["left"]
    down = pin.utils.rotate("x", np.pi)
    turned = pin.utils.rotate("z", np.pi / 2) @ down
    for s in (0.0, 0.1, 0.2, 0.1 + 0.1 * np.pi):
        assert path.pose(s).rotation == pytest.approx(down, abs=1e-12)
    assert path.pose(path.length).rotation == pytest.approx(turned, abs=1e-12)
    change("tasks.yaml", "xyz: [0.9, 0.4, 1.0]", "xyz: [0.9, 0.4, 1.0], rpy: [180 deg, 0, 60 deg]")
    path = work_of(load_job("tasks.yaml")).paths["left"]
    expected = pin.utils.rotate("z", np.pi / 3) @ down
    assert path.pose(path.length).rotation == pytest.approx(expected, abs=1e-12)


def test_a_tool_that_keeps_its_rotation_does_not_turn_with_its_turn(
    one: Path, change: Change
) -> None:
    """`tool: keeps`: the rotation of the start, on the same circle."""
    change("tasks.yaml", "angle: 90 deg}", "angle: 90 deg, tool: keeps}")
    end = work_of(load_job("tasks.yaml")).paths["left"].pose(0.1 + 0.2 * np.pi)
    assert end.rotation == pytest.approx(pin.utils.rotate("x", np.pi), abs=1e-12)
    assert end.translation == pytest.approx([0.7, 0.5, 0.9])


def test_the_path_s_frame_holds_for_all_that_names_none(one: Path, change: Change) -> None:
    """`bin` is at (0.4, 0.1, 0.7), turned by 90 deg about z: (x, y, z) is (0.4 - y, 0.1 + x, 0.7 + z) in the world."""
    world = work_of(load_job("tasks.yaml")).paths["left"]
    change("tasks.yaml", "speed: 50 mm/s", "speed: 50 mm/s\n      in: bin")
    found = work_of(load_job("tasks.yaml")).paths["left"]
    assert found.length == pytest.approx(world.length)
    s = np.linspace(0.0, world.length, 41)
    (R, p), (R_world, p_world) = found.at(s), world.at(s)
    expected = np.column_stack([0.4 - p_world[:, 1], 0.1 + p_world[:, 0], 0.7 + p_world[:, 2]])
    assert p == pytest.approx(expected, abs=1e-12)
    assert pin.utils.rotate("z", np.pi / 2) @ R_world == pytest.approx(R, abs=1e-12)


def test_a_piece_may_name_a_frame_of_its_own(one: Path, change: Change) -> None:
    """A line's pose, an arc's points, a turn's axis, a spline's pose; `world` undoes the path's frame."""
    change(
        "tasks.yaml",
        "{xyz: [0.5, 0.1, 0.9]}", "{xyz: [0, -0.1, 0.2], in: bin}",
        "via: {xyz: [0.6, 0.2, 0.9]}", "via: {xyz: [0.1, -0.2, 0.2], in: bin}",
        "to: {xyz: [0.5, 0.3, 0.9]}", "to: {in: bin, xyz: [0.2, -0.1, 0.2]}",
        "about: [0.5, 0.5, 0], axis: [0, 0, 1]", "in: bin, about: [0.4, -0.1, 0], axis: [0, 0, 2]",
        "{xyz: [0.8, 0.5, 0.9]}", "{xyz: [0.4, -0.4, 0.2], in: bin}",
    )  # fmt: skip
    framed = work_of(load_job("tasks.yaml")).paths["left"]
    (Path("tasks.yaml")).write_text(ONE)
    plain = work_of(load_job("tasks.yaml")).paths["left"]
    s = np.linspace(0.0, plain.length, 41)
    assert framed.at(s)[1] == pytest.approx(plain.at(s)[1], abs=1e-12)
    change("tasks.yaml", "speed: 50 mm/s", "speed: 50 mm/s\n      in: bin")
    text = Path("tasks.yaml").read_text().replace("xyz: [", "in: world, xyz: [")
    Path("tasks.yaml").write_text(text.replace("{turn: {", "{turn: {in: world, "))
    assert work_of(load_job("tasks.yaml")).paths["left"].at(s)[1] == pytest.approx(
        plain.at(s)[1], abs=1e-12
    )


def test_an_axis_in_a_tilted_frame_is_turned_with_it(one: Path, change: Change) -> None:
    """The frame's z axis is the world's -y: a quarter turn about it takes (0, 0, -0.2) from the axis to (0.2, 0, 0)."""
    change("cell.yaml", "frames:\n", "frames:\n  tilt: {rpy: [90 deg, 0, 0]}\n")
    # Rx(90 deg): z -> -y. The point of the axis (0.5, 1.1, 0) of the frame is (0.5, 0, 1.1) in the world.
    change(
        "tasks.yaml",
        "{about: [0.5, 0.5, 0], axis: [0, 0, 1], angle: 90 deg}",
        "{in: tilt, about: [0.5, 1.1, 0], axis: [0, 0, 1], angle: 90 deg}",
    )
    path = work_of(load_job("tasks.yaml")).paths["left"]
    turn = path.pieces[2]
    assert isinstance(turn, Turn)
    assert turn.axis == pytest.approx([0, -1, 0], abs=1e-15)
    # -y turns -z towards +x: (-y) x (-z) = y x z = x.
    assert turn.at(np.array([turn.length]))[1][0] == pytest.approx([0.7, 0.3, 1.1])


def test_both_arms_have_a_task_each_with_the_same_work(both: Path) -> None:
    """Left along its line, right along the file's spline; the speed is that of the longer one."""
    left, right = load_job("tasks.yaml").tasks
    assert (left.id, left.arm, right.id, right.arm) == ("seams", "left", "seams", "right")
    assert left.path is right.path
    work = work_of(load_job("tasks.yaml"))
    assert list(work.paths) == ["left", "right"]
    assert work.length == pytest.approx(work.paths["right"].length)
    ends = [stop.target.pose.translation.tolist() for task in (left, right) for stop in task.stops]  # type: ignore[union-attr]
    assert ends[0] == pytest.approx([0.5, 0.1, 0.9])
    assert ends[1] == pytest.approx([0.2, 0.3, 0.0])


POSES = [
    ([0.0, 0.0, 0.0], 0.0),
    ([0.1, 0.0, 0.05], 0.2),
    ([0.2, 0.1, 0.05], 0.3),
    ([0.25, 0.25, 0.0], 0.7),
]


def _rows(order: str = "x,y,z,qx,qy,qz,qw") -> str:
    """The poses as a CSV file, turned about z, the columns in some order, with one that nobody reads."""
    lines = [f"{order},note"]
    for (x, y, z), angle in POSES:
        values = {"x": x, "y": y, "z": z, "qx": 0.0, "qy": 0.0}
        values |= {"qz": float(np.sin(angle / 2)), "qw": float(np.cos(angle / 2))}
        lines.append(",".join(repr(values[name]) for name in order.split(",")) + ",x")
    return "\n".join(lines) + "\n\n"


@pytest.mark.parametrize("order", ["x,y,z,qx,qy,qz,qw", "qw,z,qx,y,qz,x,qy"])
def test_a_file_of_poses_is_the_spline_through_them(one: Path, order: str) -> None:
    """The same poses in the task file give the same path; columns in any order; in the path's frame; its hash is kept."""
    (one / "poses").mkdir()
    (one / "poses" / "way.csv").write_text(_rows(order))
    head = ONE[: ONE.index("      through:")] + "      in: bin\n"
    (one / "tasks.yaml").write_text(head + "      poses: poses/way.csv\n")
    job = load_job("tasks.yaml")
    from_file = work_of(job).paths["left"]
    listed = [f"{{xyz: {xyz}, rpy: [0, 0, {angle!r}]}}" for xyz, angle in POSES]
    (one / "tasks.yaml").write_text(
        head + f"      through: [{listed[0]}, {{spline: [{', '.join(listed[1:])}]}}]\n"
    )
    written = work_of(load_job("tasks.yaml")).paths["left"]
    assert from_file.length == pytest.approx(written.length, rel=1e-12)
    s = np.linspace(0.0, written.length, 101)
    assert from_file.at(s)[1] == pytest.approx(written.at(s)[1], abs=1e-12)
    assert from_file.at(s)[0] == pytest.approx(written.at(s)[0], abs=1e-12)
    assert "poses/way.csv" in job.inputs


START = "{xyz: [0.4, 0.1, 0.9], rpy: [180 deg, 0, 0]}"
ARC = "{arc: {via: {xyz: [0.6, 0.2, 0.9]}, to: {xyz: [0.5, 0.3, 0.9]}}}"
SPLINE = "{spline: [{xyz: [0.8, 0.5, 0.9]}, {xyz: [0.9, 0.4, 1.0]}]}"
SPEED = "speed: 50 mm/s"
FRAMES = "E300 the cell has no frame 'bun', did you mean 'bin'? It has: bin, bin.slot, world"
BACK = "E300 the curve turns back at once near {}, where the tool would have to stop; end the curve there and begin another piece"
ALONE = (
    "E310 {} does not go with paths and coordinate tasks (task 'seam') in this version; use {}, "
    "or plan them in files of their own"
)
MARK = "¦"
"""Stands in front of what a message shall point at."""


def refused(
    file: str, old: str, new: str, change: Change, messages: Messages
) -> tuple[str, list[str]]:
    """Changes a file, and returns the place of the mark as line:column with what the loader says."""
    change(file, old, new)
    text = Path(file).read_text()
    before, behind = text.split(MARK)
    Path(file).write_text(before + behind)
    place = f"{before.count(chr(10)) + 1}:{len(before) - (before.rfind(chr(10)) + 1) + 1}"
    return f"{file}:{place}", messages(lambda: load_job("tasks.yaml"))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        # The path as a whole.
        ("      speed: 50 mm/s\n      through", "      ¦through", "E202 'speed' is missing"),
        (SPEED, "speed: ¦0", "E200 0: speed must be positive"),
        (SPEED, "speed: ¦-1 mm/s", "E200 '-1 mm/s': speed must be positive"),
        (SPEED, "speed: 1\n      tolerance: ¦0", "E200 0: length must be positive"),
        (SPEED, "speed: 1\n      acceleration: ¦0", "E200 0: acceleration must be positive"),
        (SPEED, "speed: 1\n      jerk: ¦0", "E200 0: jerk must be positive"),
        (SPEED, "speed: 1\n      stiffness: ¦-1", "E200 -1: stiffness must be at least 0"),
        (SPEED, "speed: 1\n      slower: ¦maybe", "E200 'maybe' is not allowed; allowed: allowed, forbidden"),
        (SPEED, "speed: 1\n      posture: ¦bend", "E300 Tiny has no posture 'bend', did you mean 'bent'? Choose one of: home, bent"),
        (SPEED, "speed: 1\n      in: ¦bun", FRAMES),
        (SPEED, "speed: 1\n      critical_points: {left: ¦{radius: 1}}", "E200 a critical point needs xyz, or radius, height and angle"),
        (SPEED, "speed: 1\n      critical_points: {left: {¦xyz: [0, 0, 0], angle: 1}}", "E200 a critical point is given by xyz, or by radius, height and angle"),
        (SPEED + "\n      through", "speed: 1\n      ¦poses: a.csv\n      through", "E200 'poses' does not go with 'through'; keep one"),
        # Who follows.
        ("  - id: seam\n    arm: left\n", "  - ¦id: seam\n", "E202 'arm' is missing"),
        ("arm: left", "arm: ¦any", "E310 arm: any does not go with 'path'; it names its arms itself"),
        (SPEED, "¦speed: 1\n      arm: right", "E300 the task's arm is left, its path's is right; keep one"),
        (SPEED, "¦speed: 1\n      left: {poses: a.csv}", "E202 'right' is missing: where both follow, both need a path"),
        (SPEED, "¦speed: 1\n      right: {poses: a.csv}", "E202 'left' is missing: where both follow, both need a path"),
        (SPEED + "\n      through", "speed: 1\n      left: {poses: a.csv}\n      right: {poses: a.csv}\n      ¦through", "E200 'through' does not go with 'left' and 'right'"),
        # What does not go with a path.
        ("    path:", "    dwell: ¦1 s\n    path:", "E300 'dwell' does not go with a path; remove it"),
        ("    path:", "    approach: ¦1 mm\n    path:", "E300 'approach' does not go with a path; remove it"),
        ("    path:", "    retract: ¦0\n    path:", "E300 'retract' does not go with a path; remove it"),
        ("    path:", "    not_before: ¦1 s\n    path:", "E300 'not_before' goes with picks, places and moves only; remove it"),
        ("    path:", "    not_after: ¦1 s\n    path:", "E300 'not_after' goes with picks, places and moves only; remove it"),
        ("cell: cell.yaml", "cell: cell.yaml\nmode: ¦free", ALONE.format("mode: free", "mode: paired")),
        ("    path:", "    part: ¦box\n    path:", "E300 'part' does not go with a path; remove it"),
        ("    path:", "    move: {xyz: [0, 0, 0]}\n    ¦path:", "E200 'path' does not go with 'move'; make two tasks"),
        ("    path:", "    pick: {xyz: [0, 0, 0]}\n    ¦path:", "E200 'path' does not go with 'pick'; make two tasks"),
        # The first entry.
        (START, "¦" + ARC, "E300 the first entry of a path is the pose where it starts: give xyz"),
        (START, "¦{rpy: [0, 0, 0]}", "E200 no pose; give xyz, with rpy or quat, or one of arc, turn, spline"),
        (START, "{xyz: [0.4, 0.1, 0.9], quat: ¦[0, 0, 0, 2]}", "E200 a quaternion [x, y, z, w] must have length 1, not 2; divide by its length"),
        # Lines.
        ("{xyz: [0.5, 0.1, 0.9]}", "¦{xyz: [0.4, 0.1, 0.9]}", "E300 the tool is already there; remove this piece"),
        ("{xyz: [0.5, 0.1, 0.9]}", "¦{xyz: [0.4, 0.1, 0.9000005]}", "E300 the tool is already there; remove this piece"),
        ("{xyz: [0.5, 0.1, 0.9]}", "{xyz: [0.5, 0.1, 0.9], in: ¦bun}", FRAMES),
        ("{xyz: [0.5, 0.1, 0.9]}", "{xyz: ¦[0.5, 0.1]}", "E200 a list of 2 is too short; at least 3 are needed"),
        # Arcs.
        ("{arc: {via: {xyz: [0.6, 0.2, 0.9]}", "{arc: ¦{via: {xyz: [0.5, 0.2, 0.9]}", "E300 start, via and end lie on a line; write it as a line"),
        ("arc: {via: {xyz: [0.6, 0.2, 0.9]}, to: {xyz: [0.5, 0.3, 0.9]}}", "arc: ¦{via: {xyz: [0.6, 0.2, 0.9]}, to: {xyz: [0.5, 0.1, 0.9]}}", "E300 an arc cannot end where it starts; write a full circle as a turn"),
        ("via: {xyz: [0.6, 0.2, 0.9]}", "via: {xyz: [0.6, 0.2, 0.9], in: ¦bun}", FRAMES),
        ("to: {xyz: [0.5, 0.3, 0.9]}", "to: {xyz: [0.5, 0.3, 0.9], in: ¦bun}", FRAMES),
        ("to: {xyz: [0.5, 0.3, 0.9]}", "to: ¦{rpy: [0, 0, 0]}", "E300 no position; give xyz"),
        (ARC, "{arc: ¦{via: {xyz: [0.6, 0.2, 0.9]}}}", "E202 'to' is missing"),
        (ARC, ARC[:-1] + ", ¦xyz: [0, 0, 0]}", "E200 'xyz' does not go with 'arc'"),
        (ARC, ARC[:-1] + ", ¦in: bin}", "E200 'in' does not go with 'arc'"),
        (ARC, ARC[:-1] + ", ¦turn: {about: [0, 0, 0], axis: [0, 0, 1], angle: 1}}", "E200 'turn' does not go with 'arc'; make two pieces"),
        # Turns.
        ("axis: [0, 0, 1]", "¦axis: [0, 0, 0]", "E200 an axis needs a direction; allowed: for example [0, 0, 1]"),
        ("{turn: {about: [0.5, 0.5, 0], axis: [0, 0, 1], angle: 90 deg}}", "¦{turn: {about: [0.5, 0.5, 0], axis: [0, 0, 1], angle: 0}}", "E300 the tool is already there; remove this piece"),
        ("about: [0.5, 0.5, 0]", "in: ¦bun, about: [0.5, 0.5, 0]", FRAMES),
        ("angle: 90 deg", "angle: 90 deg, tool: ¦turn", "E200 'turn' is not allowed, did you mean 'turns'? Allowed: turns, keeps"),
        # Splines.
        ("{xyz: [0.9, 0.4, 1.0]}", "¦{xyz: [0.8, 0.5, 0.9]}", "E300 the same pose as the one before; remove it"),
        ("{xyz: [0.9, 0.4, 1.0]}", "¦{rpy: [0, 0, 1]}", "E300 no position; give xyz"),
        ("{xyz: [0.9, 0.4, 1.0]}", "{xyz: [0.9, 0.4, 1.0], in: ¦bun}", FRAMES),
        ("[0.9, 0.4, 1.0]}]", "[0.9, 0.5, 0.9]}, ¦{xyz: [1.0, 0.5, 0.9]}, {xyz: [0.9, 0.5, 0.9]}, {xyz: [0.8, 0.5, 0.9]}, {xyz: [0.7, 0.5, 0.9]}]", BACK.format("this pose")),
        (SPLINE, "{spline: ¦[]}", "E200 a list of 0 is too short; at least 1 are needed"),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    old: str, new: str, expected: str, one: Path, change: Change, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    place, found = refused("tasks.yaml", old, new, change, messages)
    assert found == [f"{place}: {expected}"]


def test_a_start_alone_is_no_path(one: Path, messages: Messages) -> None:
    """The message points at the list."""
    (one / "tasks.yaml").write_text(ONE[: ONE.index("        - {xyz: [0.5")])
    assert messages(lambda: load_job("tasks.yaml")) == [
        "tasks.yaml:10:9: E300 a path needs a start and at least one more entry"
    ]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (SPEED, "¦speed: 1\n      arm: left", "E200 'arm' does not go with 'left' and 'right'"),
        ("    path:\n      speed: 50 mm/s", "    arm: left\n    path:\n      ¦speed: 1", "E300 'arm' does not go with 'left' and 'right' of the path"),
        ("      right:\n        poses: right.csv\n", "", "E202 'right' is missing: where both follow, both need a path"),
        ("right:\n        poses: right.csv", "¦right: {}", "E200 no path; give 'through' or 'poses'"),
        ("xyz: [0.5, 0.1, 0.9]", "xyz: [0.5, 0.1, 0.9], in: ¦bun", FRAMES),
        (SPEED, "speed: 1\n      in: ¦bun", FRAMES),
        ("poses: right.csv", "poses: ¦left.csv", "E500 there is no file 'left.csv' here"),
        ("poses: right.csv", "poses: ¦/etc/passwd", "E500 '/etc/passwd' must be a relative path with forward slashes"),
        ("poses: right.csv", "poses: ¦../right.csv", None),
    ],
)  # fmt: skip
def test_each_mistake_of_two_paths_is_reported_at_its_place(
    old: str, new: str, expected: str | None, both: Path, change: Change, messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    if new == "":
        new, old = "      ¦speed: 50 mm/s\n", "      speed: 50 mm/s\n"
        change("tasks.yaml", "      right:\n        poses: right.csv\n", "")
    if "arm: left" in new and new.startswith("¦"):
        new = "speed: 1\n      ¦arm: left"
    place, found = refused("tasks.yaml", old, new, change, messages)
    if expected is None:
        (message,) = found
        assert message.startswith(f"{place}: E500 '../right.csv' leaves the project folder")
    else:
        assert found == [f"{place}: {expected}"]


def test_the_robot_needs_the_arm_that_follows(
    one: Path, both: Path, change: Change, messages: Messages
) -> None:
    """A robot with one arm."""
    fixed = [
        text
        for joint in ("r1", "r2")
        for text in (f'"{joint}" type="revolute"', f'"{joint}" type="fixed"')
    ]
    change("tiny.urdf", *fixed)
    change(
        "robot.yaml",
        "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n", "",
        "  r1: {acceleration: 10, jerk: none, source: datasheet}\n", "",
        "  r2: {acceleration: 10, jerk: none, source: datasheet}\n", "",
        ", r1: -1.5", "",
    )  # fmt: skip
    assert messages(lambda: load_job("tasks.yaml")) == [
        "tasks.yaml:7:7: E300 the robot has no right arm"
    ]
    (one / "tasks.yaml").write_text(ONE.replace("arm: left", "arm: right"))
    assert messages(lambda: load_job("tasks.yaml")) == [
        "tasks.yaml:8:7: E300 the robot has no right arm; it has left"
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "1:1: E300 the first line must name the columns x, y, z, qx, qy, qz, qw, with commas between them; missing: x, y, z, qx, qy, qz, qw"),
        (CSV.replace("qz,qw", "qz,w"), "1:1: E300 the first line must name the columns x, y, z, qx, qy, qz, qw, with commas between them; missing: qw"),
        (CSV.replace("0.1,0,0", "0.1,zero,0"), "3:1: E300 y: 'zero' is not a number"),
        (CSV.replace("0.1,0,0", "0.1,,0"), "3:1: E300 y: '' is not a number"),
        (CSV.replace("0.1,0,0", "nan,0,0"), "3:1: E300 x: 'nan' is outside the range of -1000 to 1000"),
        (CSV.replace("0.1,0,0", "inf,0,0"), "3:1: E300 x: 'inf' is outside the range of -1000 to 1000"),
        (CSV.replace("0.1,0,0", "1001,0,0"), "3:1: E300 x: '1001' is outside the range of -1000 to 1000"),
        (CSV.replace("0.1,0,0,0,0,0,1", "0.1,0,0,0,0,0,nan"), "3:1: E300 qw: 'nan' is outside the range of -1000 to 1000"),
        (CSV.replace("0.1,0,0,0,0,0,1", "0.1,0,0,0,0,1,1"), "3:1: E300 a quaternion must have length 1, not 1.41421; divide by its length"),
        (CSV.replace("0.1,0,0,0,0,0,1", "0.1,0,0,0,0,0,0"), "3:1: E300 a quaternion must have length 1, not 0; divide by its length"),
        (CSV.replace("0.1,0,0,0,0,0,1", "0.1,0,0,0,0,0"), "3:1: E300 6 values; the first line names 7 columns"),
        (CSV.replace("0.1,0,0,0,0,0,1", "0.1,0,0,0,0,0,1,1"), "3:1: E300 8 values; the first line names 7 columns"),
        (CSV.replace("0.2,0.3,0,", "0.1,0,0,"), "4:1: E300 the same pose as the one before; remove it"),
        (COLUMNS + "0,0,0,0,0,0,1\n", " E300 a path needs two poses or more"),
        (COLUMNS, " E300 a path needs two poses or more"),
    ],
)  # fmt: skip
def test_each_mistake_of_a_file_of_poses_is_reported_at_its_line(
    text: str, expected: str, both: Path, messages: Messages
) -> None:
    """Exact text; nothing else is reported."""
    (both / "right.csv").write_text(text)
    assert messages(lambda: load_job("tasks.yaml")) == [f"right.csv:{expected}"]


def test_a_file_of_poses_that_turns_back_is_refused(both: Path, messages: Messages) -> None:
    """There and back on one line; the message points at the file's name in the task file and counts poses."""
    rows = "".join(f"{x},0,0,0,0,0,1\n" for x in (0, 0.1, 0.2, 0.1, 0))
    (both / "right.csv").write_text(COLUMNS + rows)
    assert messages(lambda: load_job("tasks.yaml")) == [
        f"tasks.yaml:13:16: {BACK.format('its pose number 3')}"
    ]


def test_all_mistakes_of_a_file_of_poses_come_at_once(both: Path, messages: Messages) -> None:
    """One message a line, with those of the task file."""
    (both / "right.csv").write_text(CSV.replace("0.1,0,0", "a,0,0").replace("0.2,0.3", "0.2,b"))
    (both / "tasks.yaml").write_text(BOTH.replace("start: bent", "start: bend"))
    found = messages(lambda: load_job("tasks.yaml"))
    assert [text.split(" ")[0] for text in found] == [
        "tasks.yaml:3:8:",
        "right.csv:3:1:",
        "right.csv:4:1:",
    ]


def test_a_quaternion_of_nearly_unit_length_is_normalised(both: Path) -> None:
    """Within 1e-3, as elsewhere: 1.0005 is scaled, so that the tool's rotation is one."""
    (both / "right.csv").write_text(COLUMNS + "0,0,0,1.0005,0,0,0\n0.1,0,0,1,0,0,0\n")
    (spline,) = work_of(load_job("tasks.yaml")).paths["right"].pieces
    assert isinstance(spline, Spline)
    R = spline.poses[0].rotation
    assert np.abs(R - np.diag([1.0, -1.0, -1.0])).max() < 1e-12


def test_choi_s_circles_are_mirrored_and_take_what_the_file_says(tasks_folder: Path) -> None:
    """Radius 0.1 m about (0.42, ±0.32, 1.05), 375 degrees: 0.6545 m; left and right swap with the sign of y."""
    work = work_of(load_job(tasks_folder / "papers" / "choi_circles" / "tasks.yaml"))
    assert work.length == pytest.approx(0.1 * np.radians(375.0))
    s = np.linspace(0.0, work.length, 101)
    (R_left, left), (R_right, right) = (work.paths[arm].at(s) for arm in ("left", "right"))
    assert left == pytest.approx(right * [1.0, -1.0, 1.0], abs=1e-12)
    assert np.linalg.norm(left - [0.42, 0.32, 1.05], axis=1) == pytest.approx(0.1)
    assert np.ptp(R_left, axis=0).max() < 1e-15
    assert np.ptp(R_right, axis=0).max() < 1e-15
    # The outermost point comes first: half around is on the far side, (0.42, 0.42, 1.05).
    half = work.paths["left"].pose(0.1 * np.pi).translation
    assert half == pytest.approx([0.42, 0.42, 1.05], abs=1e-12)


def test_zhang_s_tools_hold_one_rigid_part_all_the_way(tasks_folder: Path) -> None:
    """Their relative pose never changes: 200 mm apart along the axis, facing each other; a ring of 100 mm by 180 degrees."""
    work = work_of(load_job(tasks_folder / "papers" / "zhang_turn" / "tasks.yaml"))
    assert work.length == pytest.approx(0.1 * np.pi)
    for s in np.linspace(0.0, work.length, 21):
        left, right = (work.paths[arm].pose(float(s)) for arm in ("left", "right"))
        between = left.actInv(right)
        assert between.translation == pytest.approx([0.0, 0.0, 0.2], abs=1e-12)
        # z of the one against z of the other.
        assert between.rotation[2, 2] == pytest.approx(-1.0)
        grasp = (left.translation + right.translation) / 2
        assert np.linalg.norm(grasp - [0.5, 0.0, 0.9]) == pytest.approx(0.1)
    assert grasp == pytest.approx([0.6, 0.0, 0.9], abs=1e-12)
