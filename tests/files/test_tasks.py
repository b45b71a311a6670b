# ruff: noqa: E501 (tables of exact messages, one a line)
from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import JointTarget, PoseTarget

Change = Callable[..., None]
Messages = Callable[..., list[str]]


def test_a_task_file_becomes_a_job(project: Path) -> None:
    """Every field of the tiny job, by hand."""
    job = load_job("tasks.yaml")
    first, second = job.tasks
    pick, place = first.stops
    # bin at (0.4, 0.1, 0.7) turned by 90 deg about z; the slot 0.1 along its x, which is the world's y;
    # the pick 50 mm above: (0.4, 0.2, 0.75). Its rotation: Rz(90 deg) Rx(180 deg).
    assert isinstance(pick.target, PoseTarget) and isinstance(place.target, PoseTarget)
    assert pick.target.pose.translation == pytest.approx([0.4, 0.2, 0.75])
    assert pick.target.pose.rotation == pytest.approx(
        np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]]), abs=1e-15
    )
    assert (pick.target.free_yaw, place.target.free_yaw) == (True, False)
    assert (pick.target.symmetry, place.target.symmetry) == (1, 2)
    assert (pick.approach, pick.retract) == (0.08, 0.06)
    assert pick.dwell == Dwell(0.12, 0.03, 0.0)
    assert str(place.place) == "tasks.yaml:11:12"
    (move,) = second.stops
    assert isinstance(move.target, JointTarget)
    assert move.target.configurations == pytest.approx(np.array([[0.5, -math.pi / 2]]))
    assert (move.approach, move.retract, move.dwell.total) == (0.0, 0.0, 0.0)
    assert (job.start, job.returns, job.speed, job.tool_speed) == ("bent", False, 1.0, None)
    assert job.notes == ()


def test_inputs_are_hashed_by_their_names_in_the_project(project: Path) -> None:
    """All four files of the tiny job, relative to the project folder."""
    files = ["tasks.yaml", "cell.yaml", "robot.yaml", "tiny.urdf"]
    hashes = {name: hashlib.sha256((project / name).read_bytes()).hexdigest() for name in files}
    assert load_job(project / "tasks.yaml").inputs == hashes


def test_a_task_overrides_the_defaults_and_the_smaller_cap_counts(
    project: Path, change: Change
) -> None:
    """approach, retract and dwell of the task; tool_speed of cell and tasks; speed in percent."""
    change("cell.yaml", "clearance:", "limits: {tool_speed: 250 mm/s}\nclearance:")
    change("tasks.yaml", "start: bent", "start: free\nspeed: 80%\nlimits: {tool_speed: 1.5}")
    change("tasks.yaml", "    move:", "    approach: 5 mm\n    dwell: 0.5 s\n    move:")
    job = load_job("tasks.yaml")
    stop = job.tasks[1].stops[0]
    assert (stop.approach, stop.retract, stop.dwell.total) == (0.005, 0.0, 0.5)
    assert (job.tool_speed, job.cell.tool_speed, job.speed, job.start) == (0.25, 0.25, 0.8, "free")


def test_joint_alternatives_are_lists_in_a_list(project: Path, change: Change) -> None:
    """A list of lists gives one row per alternative."""
    change("tasks.yaml", "[0.5, -90 deg]", "[[0.5, 0], [1, 2], [180 mrad, 3]]")
    target = load_job("tasks.yaml").tasks[1].stops[0].target
    assert isinstance(target, JointTarget)
    assert target.configurations.tolist() == [[0.5, 0.0], [1.0, 2.0], [0.18, 3.0]]


def test_a_quaternion_is_normalised(project: Path, change: Change) -> None:
    """Within 1e-3 of unit length it is scaled; here a half turn about x."""
    change("tasks.yaml", "symmetry: 2", "quat: [1.0005, 0, 0, 0]")
    target = load_job("tasks.yaml").tasks[0].stops[1].target
    assert isinstance(target, PoseTarget)
    assert target.pose.rotation == pytest.approx(np.diag([1, -1, -1]), abs=1e-15)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("mode: paired", "mode: pared", "3:7: E200 'pared' is not allowed, did you mean 'paired'? Allowed: paired, free"),
        ("order: given", "order: optimize", "4:8: E200 'optimize' is not allowed, did you mean 'optimise'? Allowed: given, optimise"),
        ("arm: right", "arm: any", "14:20: E300 joint configurations belong to one arm; use arm: left or right, or give a pose"),
        ("arm: right", "arm: both", "13:10: E200 'both' is not allowed; allowed: left, right, any"),
        ("id: b", "id: b\n    not_before: 2 s\n    not_after: 1500 ms", "14:16: E300 not_after: 1.5 s is before not_before: 2 s"),
        ("id: b", "id: b\n    not_before: -1 s", "13:17: E200 '-1 s': time must be at least 0"),
        ("id: b", "id: b\n    not_after: .inf", "13:16: E104 non-finite number '.inf' is not allowed"),
        ("start: bent", "start: bend", "5:8: E300 Tiny has no posture 'bend', did you mean 'bent'? Choose one of: home, bent, free"),
        ("approach: 80 mm", "aproach: 80 mm", "6:12: E201 unknown key 'aproach', did you mean 'approach'? Allowed: approach, retract, dwell, part, leaves, signals, straight, blend, tool"),
        ("approach: 80 mm", "approach: -1 mm", "6:22: E200 '-1 mm': length must be at least 0"),
        ("[0.2, 0.5, 0.8]", "[0.2, 0.5]", "11:18: E200 a list of 2 is too short; at least 3 are needed"),
        ("[0.2, 0.5, 0.8]", "[1,5, 2, 3]", "11:18: E200 a list of 4 is too long; at most 3 are allowed"),
        ("[0.2, 0.5, 0.8]", "[.inf, 0, 0]", "11:19: E104 non-finite number '.inf' is not allowed"),
        ("[0.2, 0.5, 0.8]", "[017, 0, 0]", "11:19: E200 '017' is not a number; remove the leading zero"),
        ("symmetry: 2", "quat: [0, 0, 0, 0]", "11:41: E200 a quaternion [x, y, z, w] must have length 1, not 0; divide by its length"),
        ("symmetry: 2", "quat: [0, 0, 0, 1], rpy: [0, 0, 0]", "11:35: E200 rpy and quat both give the rotation; keep one"),
        ("symmetry: 2", "symmetry: 361", "11:45: E200 361 must be at most 360"),
        ("symmetry: 2", "symmetry: 2, free: yaw", "11:35: E200 'free: yaw' and 'symmetry' both give the allowed turns; keep one"),
        ("symmetry: 2", "symmetry: 2.0", "11:45: E200 must be a whole number, not 2.0"),
        ("xyz: [0.2, 0.5, 0.8], ", "", "11:12: E200 no target; give xyz ([0, 0, 0] at the frame), with rpy or quat, joints or posture"),
        ("at: bin.slot", "at: bin.slit", "10:16: E300 the cell has no frame 'bin.slit', did you mean 'bin.slot'? It has: bin, bin.slot, world"),
        ("at: bin.slot", "at: 'bin[1,2]'", "10:16: E300 'bin[1,2]' is no frame; for one place of a grid write `at: bin` and, such as for the second along y, `each: {x: [1, 1], y: [2, 2]}`"),
        ("at: bin.slot", "at: bin, in: bin", "10:21: E200 'in' and 'at' both name the frame; keep one"),
        ("-90 deg]", "-90 deg], symmetry: 2", "14:36: E200 'symmetry' does not go with 'joints'; keep one"),
        ("-90 deg]", "-90 deg, 1]", "14:20: E300 3 joint positions; the arm has 2 joints: r1, r2"),
        ("[0.5, -90 deg]", "[[0, 0], [0, 4]]", "14:33: E300 4 is outside the limits of 'r2': -3 to 3 rad (-171.887 to 171.887 deg)"),
        ("id: b", "id: a", "12:9: E102 duplicate task id 'a', first at line 8"),
        ("id: b", "id: 12", "12:9: E200 must be text (in quotes, if it looks like a number), not 12"),
        ("id: b", 'id: "a\\eb"', "12:9: E200 'a\\x1bb' has characters that cannot be printed; remove them"),
        ("id: b", "id: " + "x" * 121, f"12:9: E200 '{'x' * 57}...' has 121 characters; at most 120"),
        ("id: b", "id: b\n    after: [b]", "13:13: E300 task 'b' cannot come after itself"),
        ("id: b", "id: b\n    after: [aa]", "13:13: E300 there is no task 'aa', did you mean 'a'?"),
        ("    arm: right\n", "", "12:5: E202 'arm' is missing"),
        ("    move:", "    pick: {xyz: [0, 0, 0]}\n    move:", "15:5: E200 'move' does not go with 'pick'; make two tasks"),
        ("    move:", "    x:", "14:5: E201 unknown key 'x'; allowed: id, arm, after, not_before, not_after, pick, place, move, path, coordinate, handover, tool, speed, acceleration, tool_speed, tilt, part, grasp, touches, leaves, approach, retract, straight, blend, dwell, signals"),
        ("id: b", "id: b\n    line_motion: allowed", "13:5: E201 key 'line_motion' was removed: the platform stands while tools are on lines; delete it"),
        ("settle: 30 ms}}", "settle: 30 ms}, dwell_motion: allowed}", "6:86: E201 key 'dwell_motion' was removed: joints stand while tools dwell; delete it"),
        ("cell: cell.yaml", "cell: ../cell.yaml", None),
        ("cell: cell.yaml", "cell: /etc/passwd", "2:7: E500 '/etc/passwd' must be a relative path with forward slashes"),
        ("cell: cell.yaml", "cell: file:///etc/passwd", "2:7: E500 'file:///etc/passwd' must be a relative path with forward slashes"),
        ("cell: cell.yaml", "cell: none.yaml", "2:7: E500 there is no file 'none.yaml' here"),
        ("cell: cell.yaml", "cell: .", "2:7: E500 '.' is a directory; name a file in it"),
        ("order: given", "order: given\nspeed: 120%", "5:8: E200 '120%': fraction must be at most 100 %"),
        ("order: given", "order: given\nreturn: yes", "5:9: E200 must be true or false, not 'yes'"),
        ("order: given", "order: given\norder: given", "5:1: E102 duplicate key 'order', first at line 4"),
        ("order: given", "order: given\nlimits: {tool_speed: 0}", "5:22: E200 0: speed must be positive"),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    old: str,
    new: str,
    expected: str | None,
    project: Path,
    change: Change,
    messages: Messages,
) -> None:
    """Exact text, line and column; nothing else is reported."""
    change("tasks.yaml", old, new)
    if expected is None:
        expected = (
            f"2:7: E500 '../cell.yaml' leaves the project folder '{project.name}'; keep the file "
            "inside it, or put a dualarm.toml into the folder that holds both"
        )
    assert messages(lambda: load_job("tasks.yaml")) == [f"tasks.yaml:{expected}"]


def test_tasks_that_wait_for_each_other_are_found(
    project: Path, change: Change, messages: Messages
) -> None:
    """A ring of two, named once."""
    change("tasks.yaml", "id: b", "id: b\n    after: [a]")
    change("tasks.yaml", "id: a", "id: a\n    after: [b]")
    assert messages(lambda: load_job("tasks.yaml")) == [
        "tasks.yaml:9:12: E300 tasks wait for each other: 'a' after 'b' after 'a'"
    ]


def test_a_long_chain_of_tasks_is_no_ring(project: Path, change: Change) -> None:
    """2,000 tasks after one another load; nothing recurses."""
    lines = [
        f"  - {{id: t{k}, arm: left, after: [t{k - 1}], move: {{xyz: [0, 0, 0]}}}}"
        for k in range(1, 2000)
    ]
    first = "  - {id: t0, arm: left, move: {xyz: [0, 0, 0]}}\n"
    change("tasks.yaml", "tasks:\n", "tasks:\n" + first + "\n".join(lines) + "\n")
    assert len(load_job("tasks.yaml").tasks) == 2002


def test_an_order_that_the_file_itself_breaks_is_refused(
    project: Path, change: Change, messages: Messages
) -> None:
    """On one arm the first of two cannot wait for the second."""
    tasks = "".join(
        f"  - {{id: {name}, arm: left, after: [{after}], move: {{xyz: [0, 0, 0]}}}}\n"
        for name, after in (("x", "z"), ("z", ""))
    )
    change("tasks.yaml", "tasks:\n", f"tasks:\n{tasks}")
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert "task 'x' must come after 'z', but order: given puts it first" in message


def test_arms_wait_for_each_others_tasks(project: Path, change: Change) -> None:
    """Without `after` the first tasks of both arms share a stage; with it none has both."""
    assert {"left", "right"} in [set(stage) for stage in load_job("tasks.yaml").stages()]
    change("tasks.yaml", "id: b", "id: b\n    after: [a]")
    job = load_job("tasks.yaml")
    made = [{task.id for task, _ in stage.values()} for stage in job.stages()]
    assert job.notes == ()
    assert not any({"a", "b"} <= names for names in made)
    assert max(k for k, n in enumerate(made) if "a" in n) < made.index({"b"})


def test_all_errors_of_all_files_come_at_once(
    project: Path, change: Change, messages: Messages
) -> None:
    """Schema and cross-file errors of the task file, errors of the cell and of the URDF."""
    change(
        "tasks.yaml", "arm: right", "arm: rigth", "start: bent", "start: bend", "bin.slot", "bon"
    )
    assert [m.split(" ")[0] for m in messages(lambda: load_job("tasks.yaml"))] == [
        "tasks.yaml:5:8:",
        "tasks.yaml:10:16:",
        "tasks.yaml:13:10:",
    ]
    change("cell.yaml", "mass: 800 g", "mass: 800 m")
    change("tiny.urdf", 'lower="-3"', 'lower="-3,0"')
    assert [m.split(" ")[0] for m in messages(lambda: load_job("tasks.yaml"))] == [
        "tasks.yaml:13:10:",
        "cell.yaml:4:44:",
        "tiny.urdf:11:120:",
    ]


def test_odd_but_printable_names_are_kept(project: Path, change: Change) -> None:
    """Formulas, paths, tags and emoji are names like any other; exporters escape them."""
    change("tasks.yaml", "id: b", "id: ../=cmd() 😀 </script>")
    assert load_job("tasks.yaml").tasks[1].id == "../=cmd() 😀 </script>"
