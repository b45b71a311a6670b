"""Faults that make a job impossible: told all at once, with places, by check as by plan, and only where proven."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import typer
from typer.testing import CliRunner

from dualarm_cli.cli.check import check_command
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.rotations import exp_rotation
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, PoseTarget
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning import planner
from dualarm_cli.planning.job_faults import job_faults
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.out_of_reach import out_of_reach
from dualarm_cli.postures.reach import explain_reach
from dualarm_cli.postures.stage_problems import stop_problems

IIWAS = """\
dualarm: cell/1
robot:
  left: {robot: iiwa14, base: {xyz: [0, 0.5, 0]}}
  right: {robot: iiwa14, base: {xyz: [0, -0.5, 0]}}
tools:
  left: {tcp: {xyz: [0, 0, 150 mm]}, shapes: [{box: [80 mm, 80 mm, 100 mm], xyz: [0, 0, 50 mm]}]}
  right: {tcp: {xyz: [0, 0, 150 mm]}, shapes: [{box: [80 mm, 80 mm, 100 mm], xyz: [0, 0, 50 mm]}]}
obstacles:
  table: {box: [1, 2, 0.1], xyz: [0.6, 0, -0.05]}
"""
DOWN = "rpy: [180 deg, 0, 0]"
GOOD = f"  - {{id: good, arm: left, move: {{xyz: [0.5, 0.5, 0.2], {DOWN}}}}}\n"


@pytest.fixture
def job(tmp_path: Path):
    """Makes a job of two iiwa14 at a table from lines of its tasks."""

    def made(tasks: str, head: str = "", cell: str = IIWAS) -> Job:
        (tmp_path / "dualarm.toml").write_text("")
        (tmp_path / "cell.yaml").write_text(cell)
        text = f"dualarm: tasks/1\ncell: cell.yaml\n{head}tasks:\n{tasks}"
        (tmp_path / "tasks.yaml").write_text(text)
        return load_job(tmp_path / "tasks.yaml")

    return made


def checked(folder: Path, *options: str) -> tuple[int, str]:
    """Exit code and stdout of `dualarm check`."""
    app = typer.Typer()
    app.command()(check_command)
    result = CliRunner().invoke(app, [str(folder / "tasks.yaml"), *options])
    return result.exit_code, result.stdout


def test_check_and_plan_tell_all_faults_with_their_places_before_any_search(
    job, tmp_path, monkeypatch
):
    """An elbow in a box at the start, a tool 10 mm in the table, a target far away; numbers by hand.

    The shoulder is 0.36 m high; the wrist is 150 + 126 mm over the target, at (4, 0) m before the shoulder:
    sqrt(4² + 0.066²) - 0.82 m. The gripper ends 50 mm above its tip: 60 mm below the table's face are 10 mm in it.
    """
    cell = IIWAS + "  block: {box: [0.2, 0.2, 0.2], xyz: [0.21, -0.5, 0.72]}\n"
    tasks = (
        f"  - {{id: deep, arm: left, move: {{xyz: [0.5, 0.5, -0.06], {DOWN}}}}}\n" + GOOD + "\n" * 3
    )
    tasks += f"  - {{id: far, arm: left, move: {{xyz: [4, 0.5, 0.15], {DOWN}}}}}\n"
    made = job(tasks, "start: home\n", cell)
    searched: list[str] = []
    monkeypatch.setattr(planner, "_planned", lambda *_: searched.append("searched"))
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(made, PlanSettings(effort="quick"))
    code, said = checked(tmp_path)
    assert (code, searched) == (3, [])
    miss = 1e3 * (np.hypot(4.0, 0.15 + 0.276 - 0.36) - 0.82)
    for place, words in (
        ("3:8", "start: in posture 'home' "),
        ("5:33", "task 'deep': left arm cannot move: at the target or on its lines left_tool and"),
        ("5:33", "left_tool and table lack 10.0 mm of clearance"),
        ("10:32", f"task 'far': left arm cannot move: the target is {miss:.1f} mm beyond"),
    ):
        for text in (str(caught.value), said):
            assert any(f"tasks.yaml:{place}: " in row and words in row for row in text.split("\n"))
    assert "check the units (a plain number is m)" in said
    assert "'good'" not in said
    rows = json.loads(checked(tmp_path, "--json")[1])["files"][0]["diagnostics"]
    for task, value in (("deep", 0.01), ("far", miss / 1e3)):
        [row] = [row for row in rows if row.get("task") == task]
        assert (row["arm"], row["value"]) == ("left", pytest.approx(value, abs=1e-6))
    places = [line.split(":")[2] for line in said.split("\n") if line.startswith("error[E6")]
    assert places == ["3", "5", "10"]


@pytest.mark.parametrize("head", ["", "start: free\n"])
def test_links_that_are_never_clear_are_named_with_the_entry_that_helps(job, head):
    """Links 1 and 3 are never 1 m apart, as 0.42 m of arm is between them; links 1 and 6 are in some postures 0.5 m."""
    for near, far, count in (("1 m", "0.5 m", 1), ("1 mm", "0.5 mm", 0)):
        clearances = (
            f"clearances: [{{between: [left_link_1, left_link_3], clearance: {near}}}, "
            f"{{between: [left_link_1, left_link_6], clearance: {far}}}]\n"
        )
        faults = job_faults(job(GOOD, head, IIWAS + clearances))
        named = [fault for fault in faults if fault.key == "never_clear"]
        assert len(named) == count
        for fault in named:
            entries = "`clearances: [{between: [left_link_1, left_link_3], clearance: …}]`"
            assert entries in str(fault)
            assert 1.0 > fault.measured > 1.0 - 0.42


@pytest.mark.parametrize(
    ("task", "head", "wanted"),
    [
        # A tool that points up, where the flange would be in the table; turned over it is as `good`.
        ("arm: left, move: {xyz: [0.5, 0.5, 0.2], rpy: [0, 0, 0]}", "", "turn the tool over"),
        # The other arm's target.
        (f"arm: left, move: {{xyz: [0.5, -0.6, 0.2], {DOWN}}}", "", "(arm: any)"),
        # Decimetres.
        (f"arm: left, move: {{xyz: [5, 5, 2], {DOWN}}}", "", "a plain number is m"),
        (f"arm: left, move: {{xyz: [0.95, 0.5, 0.2], {DOWN}, free: yaw}}", "", "; move the target"),
        # Nobody does it, and each has its reason.
        (
            f"arm: any, pick: {{xyz: [0.5, 0, 0.2], {DOWN}}}, place: {{xyz: [2.5, 0, 0.2], {DOWN}}}",
            "order: optimise\n",
            "; right arm: place: the target is ",
        ),
    ],
)
def test_the_remedy_is_one_that_helps(job, task, head, wanted):
    """One fault each, and what is told to do removes it."""
    [fault] = job_faults(job(f"  - {{id: one, {task}}}\n", head))
    assert wanted in fault.sentence
    assert ("turn the tool over" in fault.sentence) is ("[0, 0, 0]" in task)
    assert ("(arm: any)" in fault.sentence) is ("-0.6" in task)


def test_a_good_job_has_no_faults(job):
    """Both arms, their own targets; a start that is left open is none."""
    right = f"  - {{id: other, arm: right, move: {{xyz: [0.5, -0.5, 0.2], {DOWN}}}}}\n"
    for head in ("", "start: free\n"):
        assert job_faults(job(GOOD + right, head)) == []


def test_a_start_in_a_collision_is_a_fault_only_where_the_motion_begins_there(job):
    """A box about the right arm's elbow at home."""
    cell = IIWAS + "  block: {box: [0.2, 0.2, 0.2], xyz: [0.21, -0.5, 0.72]}\n"
    [fault] = job_faults(job(GOOD, "", cell))
    assert fault.key == "start_touches"
    assert job_faults(job(GOOD, "start: free\n", cell)) == []
    assert job_faults(job(GOOD, "", cell), check_collisions=False) == []


def test_a_tool_that_fits_between_the_turns_that_are_tried_is_left_to_the_planner(job):
    """A blade of 100 mm in a slot of 6 mm, turned by 7.5 deg, half way between two turns; filled up it fits nowhere.

    At the nearest turns that are tried its ends are 50 mm * sin 7.5 deg = 6.5 mm off, 4.5 mm of them in the walls.
    """
    blade = "[{box: [100 mm, 2 mm, 60 mm], xyz: [0, 0, 120 mm]}]"
    walls = "".join(
        f"  {name}: {{box: [0.4, 0.1, 0.1], xyz: [{0.5 - y * np.sin(np.radians(7.5))}, "
        f"{0.5 + y * np.cos(np.radians(7.5))}, 0.05], rpy: [0, 0, 7.5 deg]}}\n"
        for name, y in (("one", 0.053), ("other", -0.053))
    )
    cell = IIWAS.replace("[{box: [80 mm, 80 mm, 100 mm], xyz: [0, 0, 50 mm]}]", blade)
    task = f"  - {{id: cut, arm: left, move: {{xyz: [0.5, 0.5, 0.05], {DOWN}, free: yaw}}}}\n"
    assert job_faults(job(task, "", cell + walls)) == []
    block = "  filled: {box: [0.4, 0.4, 0.1], xyz: [0.5, 0.5, 0.05]}\n"
    [fault] = job_faults(job(task, "", cell + block))
    assert (fault.key, fault.data["into"]) == ("tool_too_near", "filled")
    allowed = cell + block + "allowed_contacts: [[left_tool, filled]]\n"
    assert job_faults(job(task, "", allowed)) == []


CUBE = "parts: {cube: {shapes: [{box: [40 mm, 40 mm, 40 mm], xyz: [0, 0, 20 mm]}]}}\nclearance: 10 mm\n"
"""Part that ends 40 mm beyond the tip of the tool."""


@pytest.mark.parametrize(
    ("free", "line"), [("", "approach: 6 mm"), (", free: yaw", "straight: 6 mm")]
)
def test_a_part_leaves_what_it_lies_on_within_its_line(job, free, line):
    """It stands on the table; its line, or the straight part of it, begins 6 mm above, where 10 mm are required."""
    cell = IIWAS + CUBE
    task = (
        "  - {id: a, arm: left, part: cube, retract: 30 mm, approach: 30 mm,\n"
        f"     pick: {{xyz: [0.5, 0.5, 0.04], {DOWN}}},\n"
        f"     place: {{xyz: [0.6, 0.5, 0.04], {DOWN}{free}}}}}\n"
    )
    # A tip 300 mm from the shoulder's axis and 40 mm above the table: in reach.
    assert job_faults(job(task, "", cell).blended()) == []
    short = (
        task.replace("approach: 30 mm", line)
        if "approach" in line
        else task.replace("retract", f"{line}, retract")
    )
    faults = job_faults(job(short, "", cell).blended())
    assert [fault.data["action"] for fault in faults] == (
        ["place"] if "approach" in line else ["pick", "place"]
    )
    fault = faults[-1]
    assert (fault.key, fault.task, fault.arm) == ("line_ends_near", "a", "left")
    assert (fault.measured, fault.allowed) == (pytest.approx(0.006, abs=1e-6), 0.01)
    assert f"make `{line.split(':')[0]}` longer" in fault.sentence
    own = cell + "clearances: [{between: [cube, table], clearance: 5 mm}]\n"
    assert job_faults(job(short, "", own).blended()) == []


def test_a_part_that_is_handed_over_keeps_clear_of_obstacles(job):
    """At the meeting a beam is 4 mm beyond the cube, which ends 40 mm below the giving tool's tip."""
    beam = "  beam: {box: [0.3, 20 mm, 20 mm], xyz: [0.4, 0, 0.446]}\n"
    task = (
        "  - {id: a, arm: left, part: cube, retract: 30 mm, approach: 30 mm,\n"
        f"     pick: {{xyz: [0.5, 0.5, 0.04], {DOWN}}},\n"
        f"     handover: {{xyz: [0.4, 0, 0.5], {DOWN}, grip: {{xyz: [0, 0, 20 mm], rpy: [90 deg, 0, 0]}}}},\n"
        f"     place: {{xyz: [0.5, -0.5, 0.1], {DOWN}}}}}\n"
    )
    faults = job_faults(job(task, "", IIWAS + beam + CUBE))
    near = {fault.data["action"]: fault for fault in faults if fault.data.get("held") == "cube"}
    assert {action: fault.data["into"] for action, fault in near.items()} == {
        "give": "beam",
        "take": "beam",
    }
    for fault in near.values():
        assert fault.key == "tool_too_near" and fault.measured == pytest.approx(0.006, abs=1e-6)


@pytest.mark.parametrize(
    "robot", ["sda10f", "iiwa7", "openarm", "yumi", "nextage", "spherical", "ur5"]
)
def test_what_a_posture_within_limits_reaches_is_never_refused(robot, tmp_path, general_robots):
    """Targets from forward kinematics at random joints, with any platform position and turn of the tool, by number.

    Joints at both ends of their limits are among them; arms with and without closed forms; the tool may be turned.
    """
    (tmp_path / "dualarm.toml").write_text("")
    tool = "{tcp: {xyz: [30 mm, 20 mm, 0.2], rpy: [0.3, 0, 0]}}"
    cell = f"dualarm: cell/1\nrobot: {robot}\ntools: {{left: {tool}}}\n"
    file = tmp_path / "tasks.yaml"
    if robot in general_robots.ROBOTS and robot not in ("yumi", "nextage"):
        file = general_robots.write_cell(tmp_path, robot)
    else:
        (tmp_path / "cell.yaml").write_text(cell)
        file.write_text(f"dualarm: tasks/1\ncell: cell.yaml\ntasks:\n{GOOD}")
    made = load_job(file)
    model = CellModel.from_cell(made.cell)
    limits = made.cell.robot.limits
    low, high = np.maximum(limits.lower, -np.pi), np.minimum(limits.upper, np.pi)
    random, start = np.random.default_rng(5), np.array(made.start_joints)
    task = made.tasks[0]
    for k in range(60):
        q = random.uniform(low, high)
        at_end = random.random(len(q)) < 0.3
        q = np.where(at_end, random.choice([low, high]), q)
        if not model.platform.is_chosen:
            q[model.platform_columns] = start[model.platform_columns]
        yaw = random.uniform(-np.pi, np.pi) if k % 2 else 0.0
        pose = model.tool_pose("left", q) * pin.SE3(pin.utils.rotate("z", yaw), np.zeros(3))
        target = PoseTarget(pose, free_yaw=bool(k % 2))
        stop = dataclasses.replace(task.stops[0], target=target, approach=0.0, retract=0.0)
        seen = stop_problems(model, made, start, {"left": (task, stop)})["left"]
        assert out_of_reach(model, start, seen) is None


@pytest.mark.parametrize(("robot", "count", "wide"), [("sda10f", 80, 0.9), ("yumi", 20, 0.6)])
def test_most_of_what_no_posture_reaches_is_proven(job, robot, count, wide):
    """At random poses about the robot, every second one with the tool down; IK at samples says what is reached.

    With a platform that turns, limits of the shoulder and the wrist are what is missed; with seven axes that do not
    meet, what the first and the last joint can do.
    """
    made = job(GOOD, "", f"dualarm: cell/1\nrobot: {robot}\n")
    model, start, task = CellModel.from_cell(made.cell), np.array(made.start_joints), made.tasks[0]
    random, seen = np.random.default_rng(3), []
    for k in range(count):
        axis = random.normal(size=3)
        turn = (
            pin.exp3(np.pi * axis / np.sqrt(axis @ axis)) if k % 2 else np.diag([1.0, -1.0, -1.0])
        )
        pose = pin.SE3(turn, np.array([0.0, 0.0, wide + 0.1]) + random.uniform(-wide, wide, 3))
        target = dataclasses.replace(task.stops[0], target=PoseTarget(pose), approach=0.0)
        stop = stop_problems(model, made, start, {"left": (task, target)})["left"]
        refused = explain_reach(model, start, stop) is not None
        seen.append((refused, out_of_reach(model, start, stop) is not None))
    assert (False, True) not in seen
    unreached = [proven for refused, proven in seen if refused]
    assert 8 < len(unreached) < count
    assert sum(unreached) >= 0.9 * len(unreached)


def test_the_elbow_of_a_posture_within_limits_is_found_near_its_pose(job):
    """Random joints, ends of limits and stretched arms among them; the pose moved as much as is allowed for."""
    made = job(GOOD, "", "dualarm: cell/1\nrobot: sda10f\n")
    arm, random = CellModel.from_cell(made.cell).arms["left"].kinematics, np.random.default_rng(7)
    size = (2000, 7)
    q = random.uniform(arm.lower, arm.upper, size)
    q = np.where(random.random(size) < 0.3, random.choice([arm.lower, arm.upper]), q)
    q = np.where(random.random(size) < 0.2, 0.0, q)
    R, p = arm.forward(q)
    moved, turned = random.uniform(0.0, 0.05, 2000), random.uniform(0.0, 0.2, 2000)
    ways, axes = (
        vectors / np.sqrt((vectors * vectors).sum(axis=1, keepdims=True))
        for vectors in random.normal(size=(2, 2000, 3))
    )
    wrist = arm.wrist_center(R, p) + moved[:, None] * ways
    R = exp_rotation(turned[:, None] * axes) @ R
    assert arm.may_bend(R, wrist - R @ arm.geometry.p_flange_wrist, moved, turned).all()


def test_limits_a_whole_turn_on_say_the_same_of_the_elbow(job):
    """Where an encoder counts from is no matter of where the elbow can be."""
    made = job(GOOD, "", "dualarm: cell/1\nrobot: sda10f\n")
    arm, random = CellModel.from_cell(made.cell).arms["left"].kinematics, np.random.default_rng(8)
    R, p = arm.forward(random.uniform(-np.pi, np.pi, (500, 7)))
    still = np.zeros((2, 500))
    fits = arm.may_bend(R, p, *still)
    assert 50 < fits.sum() < 450
    turns = 2.0 * np.pi * np.array([0, 1, 0, 0, 0, -1, 0])
    turned = dataclasses.replace(arm, lower=arm.lower + turns, upper=arm.upper + turns)
    np.testing.assert_array_equal(turned.may_bend(R, p, *still), fits)


def test_a_platform_is_examined_within_its_limits_only(job):
    """A target behind the robot needs half a turn of its waist."""
    made = job(
        f"  - {{id: back, arm: left, move: {{xyz: [-0.85, 0, 1.0], {DOWN}}}}}\n",
        "",
        "dualarm: cell/1\nrobot: sda10f\n",
    )
    robot, wide = made.cell.robot, made.cell.robot.limits
    waist = wide.joints.index(robot.platform[0])
    assert wide.upper[waist] > 2.5
    for most, reached in ((wide.upper[waist], True), (0.5, False)):
        lower, upper = wide.lower.copy(), wide.upper.copy()
        lower[waist], upper[waist] = -most, most
        narrow = dataclasses.replace(wide, lower=lower, upper=upper)
        cell = dataclasses.replace(made.cell, robot=dataclasses.replace(robot, limits=narrow))
        model, start, task = CellModel.from_cell(cell), np.array(made.start_joints), made.tasks[0]
        stop = stop_problems(model, made, start, {"left": (task, task.stops[0])})["left"]
        assert (out_of_reach(model, start, stop) is None) == reached


def test_a_path_that_leaves_reach_on_its_way_is_a_fault_there(job):
    """Both ends 0.65 m before the shoulder; the corner, half way, at (1, 0, 0.116) m; what its blend may save is not.

    The tools lie 150 + 126 mm over the path, and the wrist reaches 0.82 m. A tolerance of 200 mm would save it.
    """
    path = (
        "through: [{{xyz: [0.5, 0.9, 0.2], {d}}}, {{xyz: [1, 0.5, 0.2]}}, {{xyz: [0.5, 0.1, 0.2]}}]"
    )
    task = f"  - {{id: weld, arm: left, path: {{{path.format(d=DOWN)}, speed: 0.1}}}}\n"
    [fault] = job_faults(job(task).blended())
    miss = np.hypot(1.0, 0.116) - 0.82
    assert fault.measured == pytest.approx(miss, abs=1e-6)
    assert fault.sentence.startswith(
        f"task 'weld' (left): after 50% of its path: the target is {1e3 * miss:.1f} mm beyond"
    )
    loose = task.replace("speed: 0.1", "speed: 0.1, blend: 200 mm")
    assert job_faults(job(loose).blended()) == []
    assert job_faults(job(task.replace("[1, 0.5", "[0.7, 0.5")).blended()) == []


def test_a_conveyor_brings_a_target_within_reach(job):
    """Out of reach where it passes, 1.2 m ahead, and 0.5 m ahead at the end; with less of its way it is a fault."""
    belt = IIWAS + "conveyors: {belt: {velocity: [-0.1, 0, 0]}}\n"
    task = (
        "  - {{id: part, arm: left, pick: {{xyz: [1.2, 0.5, 0.2], "
        + DOWN
        + ", conveyor: belt, passes: 10 s, "
        "within: {within}}}, place: {{xyz: [0.5, 0.5, 0.2], " + DOWN + "}}}}\n"
    )
    assert job_faults(job(task.format(within="700 mm"), "", belt)) == []
    [fault] = job_faults(job(task.format(within="200 mm"), "", belt))
    assert (fault.key, fault.task) == ("stop_impossible", "part")
