"""What arms hold, by hand: tools that change, parts in them, parts that go from tool to tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.cell import Cell, ChangedTool, Tool, ToolChanges
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import ANY, Job, PoseTarget, Stop, Task
from dualarm_cli.model.part_flow import Conveyor, Handover, OnBelt, part_as_held
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.shape import Shape

HERE = pin.SE3.Identity()


def ahead(z: float, turn: float = 0.0) -> pin.SE3:
    """A frame farther along z, turned about it."""
    return pin.SE3(pin.utils.rotate("z", turn), np.array([0.0, 0.0, z]))


def ball(z: float) -> Shape:
    """A ball somewhere along z."""
    return Shape("sphere", (0.01,), ahead(z))


OWN = Tool(ahead(0.1))
LONG = Tool(ahead(0.3, np.pi / 2), shapes=(ball(0.2),))
LIMITS = JointLimits(("l", "r"), *(s * np.ones(2) for s in (-1, 1, 1, 1, 1)), ("assumed",) * 2)
ROBOT = Robot(
    "two",
    "",
    (),
    tuple(Arm(s, (s[0],), f"{s}_flange", "general") for s in ("left", "right")),
    LIMITS,
)
CELL = Cell(
    ROBOT,
    HERE,
    {"left": OWN, "right": OWN},
    parts={"plate": (Shape("box", (0.1, 0.2, 0.3), pin.SE3(np.eye(3), np.array([0.1, 0, 0]))),)},
    tool_changes={"left": ToolChanges({"long": ChangedTool(LONG, HERE)}, start="long")},
    clearances=(("plate", "table", 0.01), ("table", "plate", 0.02), ("a", "b", 0.03)),
    allowed_contacts=(("plate", "rack"), ("a", "b")),
)


def stop(action, **more) -> Stop:
    """A stop somewhere."""
    return Stop(action, PoseTarget(HERE), 0.0, 0.0, Dwell(), NOWHERE, **more)


def test_an_arm_without_changes_has_its_own_tool_alone() -> None:
    """The left one has the long tool on at the start, the right one nothing."""
    assert CELL.tool_names("left") == ("", "long")
    assert CELL.tool_names("right") == ("",)
    assert (CELL.start_tool("left"), CELL.start_tool("right")) == ("long", "")
    job = Job(CELL, (), "home", False)
    assert (job.held_at_start("left"), job.held_at_start("right")) == ("long", "")


def test_everything_that_is_ever_held_has_one_name() -> None:
    """Nothing, a part, a tool, a part in a tool, a tool at its stand."""
    assert list(CELL.all_held("left")) == [
        "", "plate", "long", "long with plate", "long at its stand",
    ]  # fmt: skip
    assert list(CELL.all_held("right")) == ["", "plate"]


def test_a_changed_tool_begins_where_the_flange_does() -> None:
    """Own tool 0.1 m, the long one 0.3 m and a quarter turn: 0.2 m ahead; its ball at 0.2 m is 0.1 m ahead."""
    T = CELL.T_own_tool("left", "long")
    np.testing.assert_allclose(T.translation, [0, 0, 0.2], atol=1e-15)
    np.testing.assert_allclose(T.rotation, pin.utils.rotate("z", np.pi / 2), atol=1e-15)
    assert CELL.T_own_tool("left", "") == HERE
    held = CELL.all_held("left")
    of_tool, of_part = CELL.held_shapes("left", held["long with plate"])
    np.testing.assert_allclose([s.pose.translation for s in of_tool], [[0, 0, 0.1]], atol=1e-15)
    # The part's x is the own tool's y in the long one.
    np.testing.assert_allclose([s.pose.translation for s in of_part], [[0, 0.1, 0.2]], atol=1e-15)
    of_tool, of_part = CELL.held_shapes("left", held["plate"])
    assert of_tool == ()
    np.testing.assert_allclose([s.pose.translation for s in of_part], [[0.1, 0, 0]], atol=1e-15)
    assert CELL.held_shapes("left", held[""]) == ((), ())


def test_a_taken_part_hangs_in_the_other_tool_with_the_same_neighbours() -> None:
    """The taking tool 0.4 m ahead and half a turn about z: the part is 0.4 m behind it, its x turned round."""
    grip = ahead(0.4, np.pi)
    name = part_as_held("plate", "flip")
    assert (name, part_as_held("", "flip")) == ("plate@flip", "")
    cell = CELL.with_held_part("plate", "flip", grip)
    assert set(cell.parts) == {"plate", name}
    np.testing.assert_allclose(cell.parts[name][0].pose.translation, [-0.1, 0, -0.4], atol=1e-12)
    assert cell.parts[name][0].size == CELL.parts["plate"][0].size
    assert cell.clearances == (*CELL.clearances, (name, "table", 0.01), ("table", name, 0.02))
    assert cell.allowed_contacts == (*CELL.allowed_contacts, (name, "rack"))


def test_what_is_carried_by_either_arm_counts_for_both() -> None:
    """The left arm's tools come first, though no task names them; each thing once, parts of tasks with parts only."""
    tasks = (
        Task("a", ANY, (stop("pick"), stop("place")), part="plate"),
        Task("b", "left", (stop("pick"), stop("place")), part="plate", tool="long"),
        Task("c", "right", (stop("pick"), stop("place"))),
        Task("d", "right", (stop("pick"), stop("place")), part="plate"),
    )
    assert Job(CELL, tasks, "home", False).carried() == [
        ("left", "long"),
        ("left", "long at its stand"),
        ("left", "plate"),
        ("right", "plate"),
        ("left", "long with plate"),
    ]


@pytest.mark.parametrize(
    ("action", "tool", "part", "before", "after"),
    [
        ("pick", "", "plate", "", "plate"),
        ("place", "long", "plate", "long with plate", "long"),
        ("move", "long", "", "long", "long"),
        ("take_tool", "long", "", "", "long at its stand"),
        ("leave_tool", "long", "", "long at its stand", ""),
    ],
)
def test_what_is_held_before_and_after_a_stop(action, tool, part, before, after) -> None:
    """Picks and takes begin it, places and leaves end it."""
    task = Task("t", "left", (stop(action),), tool=tool, part=part)
    assert (task.held_before(action), task.held_after(action)) == (before, after)
    assert task.is_change == (action in ("take_tool", "leave_tool"))


def test_a_job_knows_what_kinds_of_work_it_has() -> None:
    """One task of each kind among bare moves; a conveyor at any stop counts."""
    move = Task("m", "left", (stop("move"),))
    belt = OnBelt(Conveyor("belt", np.array([0.1, 0.0, 0.0])), 0.0, 1.0, 0.0)
    met = Task("b", "left", (stop("pick", belt=belt), stop("place")))
    hand = Task("h", "left", (stop("pick"),), handover=Handover("left", "right", HERE))
    kinds = ("moves", "has_handovers", "has_paths", "has_seams", "in_sections")
    for task, expected in ((move, set()), (met, {kinds[0]}), (hand, {kinds[1]})):
        job = Job(CELL, (move, task, move), "home", False)
        assert {kind for kind in kinds if getattr(job, kind)} == expected
    assert hand.shared and not hand.alone and not move.shared


def test_a_job_is_decided_once_arms_and_order_are() -> None:
    """One task of any arm, or an order to choose, leaves it open."""
    mine, anyone = Task("a", "left", (stop("move"),)), Task("b", ANY, (stop("move"),))
    job = Job(CELL, (mine, mine), "home", False)
    assert job.is_decided
    assert not replace(job, order="optimise").is_decided
    assert not replace(job, tasks=(mine, anyone)).is_decided
    assert [arm for arm in ("left", "right") if mine.allows(arm)] == ["left"]
    assert [arm for arm in ("left", "right") if anyone.allows(arm)] == ["left", "right"]
    assert set(replace(job, tasks=(anyone,)).stops_by_key()) == {
        ("left", "b", "move"),
        ("right", "b", "move"),
    }


def test_stages_that_the_job_pairs_itself_are_these() -> None:
    """In any order, whatever the files have."""
    tasks = tuple(
        Task(n, a, (stop("move"),)) for n, a in (("a", "left"), ("b", "left"), ("c", "right"))
    )
    pairing = ((("left", "b", "move"),), (("right", "c", "move"), ("left", "a", "move")))
    found = Job(CELL, tasks, "home", False, pairing=pairing).stages()
    assert [{arm: task.id for arm, (task, _) in stage.items()} for stage in found] == [
        {"left": "b"},
        {"right": "c", "left": "a"},
    ]


def test_a_robot_knows_its_joints_and_arms_by_name() -> None:
    """Columns, limits and postures follow the names; an arm that is not there has no entry."""
    assert ROBOT.columns(("r", "l")) == [1, 0]
    assert ROBOT.arm("right").joints == ("r",)
    with pytest.raises(KeyError):
        ROBOT.arm("middle")
    arms = tuple(
        replace(arm, kind=kind) for arm, kind in zip(ROBOT.arms, ("srs", "wrist"), strict=True)
    )
    assert replace(ROBOT, arms=arms).without_closed_form == ("right",)
    with pytest.raises(ValueError, match="share a name"):
        replace(ROBOT, arms=tuple(replace(arm, name="left") for arm in ROBOT.arms))
    one = replace(LIMITS, upper=np.array([1.0, 2.0])).select(("r",))
    assert (one.joints, one.upper.tolist(), one.source) == (("r",), [2.0], ("assumed",))
