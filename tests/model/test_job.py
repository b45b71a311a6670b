"""Jobs with paths: which tasks run together, and what is paired within them."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.curves.tool_path import Line, ToolPath
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, Place, PoseTarget, Stop, Task
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.side_by_side import side_by_side

HERE = pin.SE3.Identity()


def stop(action):
    """A stop somewhere."""
    return Stop(action, PoseTarget(HERE), 0.0, 0.0, Dwell(), Place("tasks.yaml", 1, 1))


def carry(name, arm):
    """A pick and a place."""
    return Task(name, arm, (stop("pick"), stop("place")))


def move(name, arm):
    """A bare move."""
    return Task(name, arm, (stop("move"),))


def polyline(*x):
    """A path through places along x; there and back where they fall."""
    poses = [pin.SE3(np.eye(3), np.array([value, 0.0, 0.0])) for value in x]
    return ToolPath(tuple(Line(a, b) for a, b in pairwise(poses)))


def follow(name, **paths):
    """A path task: a task for each arm that follows, with one work."""
    work = PathWork(paths or {"left": polyline(0, 1)}, 0.1)
    return [Task(name, arm, (stop("path"),), path=work) for arm in work.paths]


def both(name):
    """A path of both arms."""
    return follow(name, left=polyline(0, 1), right=polyline(0, 2))


def job(*tasks):
    """A job of two arms with one joint each."""
    n = 2
    limits = JointLimits(
        ("l", "r"), -np.ones(n), np.ones(n), np.ones(n), np.ones(n), np.ones(n), ("assumed",) * n
    )
    arms = tuple(Arm(side, (side[0],), f"{side}_flange", "general") for side in ("left", "right"))
    robot = Robot("two", "", (), arms, limits)
    cell = Cell(robot, HERE, {arm.name: Tool(HERE) for arm in arms})
    return Job(cell, tuple(tasks), "home", False)


def names(sections):
    """Ids of the tasks, section by section."""
    return [[task.id for task in section] for section in sections]


def stages(found):
    """Who does what in each stage."""
    return [{arm: f"{task.id} {s.action}" for arm, (task, s) in stage.items()} for stage in found]


def test_without_paths_all_tasks_are_one_section():
    """As before there were paths."""
    one = job(carry("a", "left"), carry("b", "right"), move("c", "left"))
    assert names(one.sections()) == [["a", "b", "c"]]
    assert not one.has_paths
    assert job().sections() == []
    assert job().stages() == []


def test_a_path_is_a_section_between_those_before_and_behind():
    """Picks, a path of one arm, moves."""
    one = job(carry("a", "left"), carry("b", "right"), *follow("p"), move("c", "left"))
    assert names(one.sections()) == [["a", "b"], ["p"], ["c"]]
    assert one.has_paths


def test_both_arms_of_a_path_are_one_section_and_two_paths_are_two():
    """The same work makes them one; equal works of different tasks do not."""
    one = job(*both("p"), *both("q"), *follow("r"), *follow("s"))
    assert names(one.sections()) == [["p", "p"], ["q", "q"], ["r"], ["s"]]


def test_stages_do_not_pair_tasks_across_a_path():
    """Left has two stops before the path and one behind, right one before and three behind."""
    one = job(
        carry("a", "left"),
        move("b", "right"),
        *both("p"),
        carry("c", "right"),
        move("d", "left"),
        move("e", "right"),
    )
    assert stages(one.stages()) == [
        {"left": "a pick", "right": "b move"},
        {"left": "a place"},
        {"left": "p path", "right": "p path"},
        {"left": "d move", "right": "c pick"},
        {"right": "c place"},
        {"right": "e move"},
    ]


def test_a_path_of_one_arm_is_a_stage_of_that_arm_alone():
    """The other arm's tasks before and behind stay where they are."""
    one = job(move("a", "right"), *follow("p", right=polyline(0, 1)), move("b", "left"))
    assert stages(one.stages()) == [{"right": "a move"}, {"right": "p path"}, {"left": "b move"}]


def test_a_task_is_made_in_a_stage_after_those_that_it_comes_after():
    """By hand: b waits for both stops of a; c, which waits for nothing, is beside its first stop all the same."""
    b = replace(carry("b", "right"), after=("a",))
    one = job(carry("a", "left"), b, move("c", "left"), replace(move("d", "left"), after=("b",)))
    assert stages(one.stages()) == [
        {"left": "a pick"},
        {"left": "a place"},
        {"left": "c move", "right": "b pick"},
        {"right": "b place"},
        {"left": "d move"},
    ]


@pytest.mark.parametrize("seed", range(20))
def test_stages_are_as_early_as_after_lets_them_be(seed):
    """Each stop is right behind its arm's stop before, or behind the end of a task that it waits for; none before."""
    rng = np.random.default_rng(seed)
    tasks = []
    for k in range(12):
        arm = str(rng.choice(["left", "right"]))
        make = carry if rng.random() < 0.6 else move
        after = tuple(f"t{j}" for j in range(k) if rng.random() < 0.15)
        tasks.append(replace(make(f"t{k}", arm), after=after))
    found = job(*tasks).stages()
    at = {
        (task.id, stop.action): k for k, stage in enumerate(found) for task, stop in stage.values()
    }
    assert sum(map(len, found)) == len(at) == sum(len(task.stops) for task in tasks)
    over = {task.id: max(at[task.id, stop.action] for stop in task.stops) for task in tasks}
    for arm in ("left", "right"):
        last = -1
        for task in (task for task in tasks if task.arm == arm):
            for number, stop in enumerate(task.stops):
                waits = [over[name] for name in task.after] if number == 0 else []
                assert at[task.id, stop.action] == 1 + max(last, *waits, -1)
                last = at[task.id, stop.action]


def test_tasks_that_wait_for_ever_are_no_stages():
    """By hand: a waits for d behind c, c for b behind a."""
    a, c = replace(move("a", "left"), after=("d",)), replace(move("c", "right"), after=("b",))
    one = job(a, move("b", "left"), c, move("d", "right"))
    with pytest.raises(InfeasibleError, match="'a' and 'c' wait forever"):
        one.stages()
    assert len(job(move("a", "left"), c, move("b", "left")).stages()) == 3


def test_stops_are_found_by_arm_task_and_action():
    """Both arms' ends of one path are two stops."""
    one = job(*both("p"), carry("a", "left"))
    assert set(one.stops_by_key()) == {
        ("left", "p", "path"),
        ("right", "p", "path"),
        ("left", "a", "pick"),
        ("left", "a", "place"),
    }
    assert [s.action for _, s in one.stops_of("left")] == ["path", "pick", "place"]


def test_the_longer_path_counts_and_corners_are_shares_of_the_way():
    """Left 0 -> 1 -> 0.5 (corner at 1 of 1.5), right 0 -> 1 -> 0 -> 2 (corners at 1 and 2 of 4)."""
    work = PathWork({"left": polyline(0, 1, 0.5), "right": polyline(0, 1, 0, 2)}, 0.1)
    assert work.length == pytest.approx(4.0)
    assert work.corners() == pytest.approx((0.25, 0.5, 2.0 / 3.0))


def test_corners_at_the_same_share_are_one_stop():
    """Both tools turn back after a third, 0.1 m and 0.3 m: not twice, however the shares are rounded."""
    for scale in (0.1, 0.3, 0.7, 1.0 / 3.0, 0.011):
        work = PathWork({"left": polyline(0, 0.1, -0.1), "right": polyline(0, scale, -scale)}, 0.1)
        assert work.corners() == pytest.approx((1.0 / 3.0,)), scale


def test_stages_are_side_by_side_between_meetings():
    """Lower case letters are done alone, capitals by both; who has run out waits for the next meeting."""

    def stages(left, right):
        rows = {"left": left, "right": right}
        return side_by_side(rows, str.isupper, lambda _: (), lambda _: "")

    assert stages("abCd", "eCfg") == (
        [
            {"left": "a", "right": "e"},
            {"left": "b"},
            {"left": "C", "right": "C"},
            {"left": "d", "right": "f"},
            {"right": "g"},
        ],
        [],
    )
    assert stages("", "ab") == ([{"right": "a"}, {"right": "b"}], [])
    assert stages("", "") == ([], [])


def test_a_dwell_of_which_nothing_is_said_takes_no_time():
    """Each of its shares is 0; together they are its total."""
    assert Dwell() == Dwell(0.0, 0.0, 0.0)
    assert Dwell().total == 0.0
    assert Dwell(1.0, 2.0, 4.0).total == 7.0


def test_a_motion_starts_in_its_posture_unless_it_is_a_part_of_one():
    """A free start counts turns from home; a part of a job begins where the one before ended."""
    postures = {"home": np.zeros(2), "ready": np.ones(2)}
    cell = SimpleNamespace(robot=SimpleNamespace(postures=postures))
    assert Job(cell, (), "ready", False).start_joints.tolist() == [1.0, 1.0]
    assert Job(cell, (), "free", False).start_joints.tolist() == [0.0, 0.0]
    part = Job(cell, (), "ready", False, begin=np.array([3.0, 4.0]))
    assert part.start_joints.tolist() == [3.0, 4.0]
