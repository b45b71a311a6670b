"""Parts in each other's way: what is refused before any search, and the orders that the shapes leave."""

from __future__ import annotations

import pytest

from dualarm_cli.collision.crowding import crowded_stops
from dualarm_cli.collision.rooms import rooms_of
from dualarm_cli.errors import BlockedError
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.planning.room_rules import RoomRules, planned_around
from dualarm_cli.refusals import Refusal, message
from dualarm_cli.verification import verify

from .conftest import PALM, TABLE

TOWER = 0.31
"""Height of the tool centre point over the table when a tower stands on it [m]."""
CUBE, TALL, FLAT = 0.11, 0.21, 0.05
"""The same of other parts."""
QUICK = PlanSettings(effort="quick")


def refusal(job) -> list:
    """What is refused before a search."""
    return RoomRules.of(job).faults()


def test_two_towers_are_not_put_into_one_place(job_of, task):
    """The second one would fill the first one's room: 60 mm to the side is the shortest way out of it."""
    job = job_of(
        *(
            task(
                name, (0.45, 0.15, TOWER), (0.45, 0.45, TOWER), ", part: tower", free=", free: yaw"
            )
            for name in ("one", "two")
        ),
        clearance="0 mm",
    )
    [found] = refusal(job)
    assert (found.key, found.task, found.data["other_task"]) == ("same_room", "two", "one")
    assert str(found).startswith(f"{job.tasks[1].stops[1].place}: task 'two': ")
    assert "'tower' reaches 60.0 mm into 'tower' of task 'one', which lies there" in str(found)


def test_check_says_so(write_job, task, capsys):
    """Exit code 3, with the place and both tasks, without planning."""
    from dualarm_cli.cli.run import run

    path = write_job(
        *(task(name, (0.45, 0.15, CUBE), (0.45, 0.45, CUBE)) for name in ("one", "two"))
    )
    assert run(["check", str(path)]) == 3
    said = capsys.readouterr().out
    assert "tasks.yaml:8:" in said
    assert "'cube' reaches 60.0 mm into 'cube' of task 'one'" in said


def test_a_gap_is_measured_from_side_to_side(job_of, task):
    """Places 72 mm apart leave 12 mm between cubes of 60 mm: enough for 10 mm and the planner's 2 mm, and no more."""

    def job(apart: float, clearance: str = "10 mm", cell: str = ""):
        return job_of(
            task("one", (0.45, 0.10, CUBE), (0.45, 0.40, CUBE)),
            task("two", (0.45, -0.10, CUBE), (0.45, 0.40 + apart, CUBE)),
            clearance=clearance,
            cell=cell,
        )

    assert refusal(job(0.0721)) == []
    [found] = refusal(job(0.0701))
    assert "is 10.1 mm from, and needs 12.0 mm (2.0 mm more than required) to," in str(found)
    own = "clearances: [{between: [cube, cube], clearance: 5 mm}]"
    assert refusal(job(0.0701, cell=own)) == []
    contact = "allowed_contacts: [[cube, cube]]"
    assert refusal(job(0.03, cell=contact)) == []


def test_a_cube_stands_on_the_one_that_its_task_names(job_of, task):
    """100 mm higher: the lower one comes first, in any order, and the plan passes verification."""
    upper = task("upper", (0.45, 0.10, CUBE), (0.45, 0.45, CUBE + 0.1), ", touches: [lower]")
    lower = task("lower", (0.45, -0.10, CUBE), (0.45, 0.45, CUBE))
    job = job_of(upper, lower, head="order: optimise")
    ruled = RoomRules.of(job).ruled()
    assert [one.after for one in ruled.tasks] == [("lower",), ()]
    assert list(ruled.notes) == ["order: upper comes after lower, as its part would obstruct it"]
    [found] = refusal(job_of(upper, lower))
    assert (found.key, found.task) == ("in_the_way", "lower")
    said = message([found])
    assert said.startswith("parts lack room in the given order:")
    assert said.endswith("; another order")
    made = plan(job, QUICK)
    assert [e.task for e in made.events if e.action == "place"] == ["lower", "upper"]
    assert verify(made, job, clearance=True).passed
    # Without the key the two may not touch.
    plain = job_of(lower, upper.replace(", touches: [lower]", ""))
    found = refusal(plain)[0]
    assert found.key == "same_room"
    assert "another order" not in message([found])


def test_touching_is_no_leave_to_reach_into_one_another(job_of, task):
    """10 mm too low the upper cube is 10 mm in the lower one, whatever the key says."""
    job = job_of(
        task("lower", (0.45, -0.10, CUBE), (0.45, 0.45, CUBE)),
        task("upper", (0.45, 0.10, CUBE), (0.45, 0.45, CUBE + 0.09), ", touches: [lower]"),
    )
    [found] = refusal(job)
    assert "'cube' reaches 10.0 mm into 'cube' of task 'lower'" in str(found)


def test_the_tall_part_is_picked_before_the_flat_one_beside_it(job_of, task):
    """The palm is 160 mm wide: beside the tall part it does not get down to the flat one, 80 mm away."""
    tall = task("tall", (0.45, 0.10, TALL), (0.30, 0.55, TALL), ", part: tall")
    flat = task("flat", (0.45, 0.18, FLAT), (0.60, 0.55, FLAT), ", part: flat")
    for tasks in ((tall, flat), (flat, tall)):
        ruled = RoomRules.of(job_of(*tasks, tool=PALM, head="order: optimise")).ruled()
        assert {one.id: one.after for one in ruled.tasks} == {"tall": (), "flat": ("tall",)}
    assert refusal(job_of(flat, tall, tool=PALM))[0].key == "in_the_way"
    assert refusal(job_of(tall, flat, tool=PALM)) == []


def test_the_flat_part_is_placed_before_the_tall_one_beside_it(job_of, task):
    """For the same reason the other way round; where both hold there is no order."""
    tall = task("tall", (0.30, 0.55, TALL), (0.45, 0.10, TALL), ", part: tall")
    flat = task("flat", (0.60, 0.55, FLAT), (0.45, 0.18, FLAT), ", part: flat")
    ruled = RoomRules.of(job_of(tall, flat, tool=PALM, head="order: optimise")).ruled()
    assert {one.id: one.after for one in ruled.tasks} == {"tall": ("flat",), "flat": ()}
    near = flat.replace("xyz: [0.6, 0.55", "xyz: [0.38, 0.55")
    assert refusal(job_of(tall, near, tool=PALM, head="order: optimise"))[0].key == "same_room"


def test_parts_that_leave_and_parts_that_are_taken_away_make_room(job_of, task):
    """Nothing lies where the next one is placed."""
    one, two = (
        task(name, (0.45, y, CUBE), (0.45, 0.45, CUBE), ", leaves: true")
        for name, y in (("one", 0.1), ("two", -0.1))
    )
    assert refusal(job_of(one, two)) == []
    stays = task("one", (0.45, 0.1, CUBE), (0.45, 0.45, CUBE))
    away = task("away", (0.45, 0.45, CUBE), (0.7, 0.3, CUBE))
    last = task("two", (0.45, -0.1, CUBE), (0.45, 0.45, CUBE))
    assert refusal(job_of(stays, away, last)) == []


LONG = (
    "tool_changes: {left: {start: long, time: 0.5 s, tools: {long: {tcp: {xyz: [0, 0, 220 mm]}, "
    "stand: {xyz: [0.2, 0.75, 1.0], rpy: [180 deg, 0, 0]}}}}}"
)
"""A tool for the left arm, its centre point 100 mm beyond the arm's own."""


def test_a_part_in_a_changed_tool_is_where_that_tool_is(job_of, task):
    """The tool centre point 0.11 m over the table, the cube's middle 55 mm below it, whatever tool has it."""
    tasks = (
        task("one", (0.45, 0.10, CUBE), (0.45, 0.40, CUBE), ", tool: long"),
        task("two", (0.45, -0.10, CUBE), (0.45, 0.4701, CUBE), arm="right"),
    )
    job = job_of(*tasks, cell=LONG, clearance="10 mm")
    middles = [room.shapes[0].pose.translation for room in rooms_of(job)]
    assert [middle[2] for middle in middles] == pytest.approx([TABLE + CUBE - 0.055] * 4)
    [found] = refusal(job)
    assert "is 10.1 mm from, and needs 12.0 mm (2.0 mm more than required) to," in str(found)


def test_a_part_at_any_yaw_takes_a_round_room(job_of, task):
    """A square of 60 mm is turned within a circle of 84.85 mm; one with four equal sides stays as it is."""
    free = job_of(task("one", (0.45, 0.1, CUBE), (0.45, 0.45, CUBE), free=", free: yaw"))
    [shape] = rooms_of(free)[0].shapes
    assert shape.kind == "cylinder"
    assert shape.size == pytest.approx((0.03 * 2**0.5, 0.1))
    same = job_of(task("one", (0.45, 0.1, CUBE), (0.45, 0.45, CUBE), free=", symmetry: 4"))
    assert len(rooms_of(same)[0].shapes) == 1
    other = job_of(task("one", (0.45, 0.1, CUBE), (0.45, 0.45, CUBE), free=", symmetry: 3"))
    assert len(rooms_of(other)[0].shapes) == 3


def test_near_others_a_free_yaw_is_kept_as_the_file_has_it(job_of, task):
    """75 mm apart there is room for two cubes side by side, but not for two circles of 84.85 mm."""
    job = job_of(
        task("one", (0.45, 0.10, CUBE), (0.45, 0.40, CUBE), free=", free: yaw"),
        task("two", (0.45, -0.10, CUBE), (0.45, 0.475, CUBE), free=", free: yaw"),
    )
    ruled = RoomRules.of(job).ruled()
    targets = [[stop.target for stop in one.stops] for one in ruled.tasks]
    assert [[t.free_yaw for t in row] for row in targets] == [[True, False]] * 2
    assert [row[1].symmetry for row in targets] == [4, 4]
    assert list(ruled.notes) == [
        "parts: near others these keep the yaw of the file, although it is free: one (place), two (place)"
    ]


def test_a_part_is_no_obstacle_to_the_task_that_takes_it_away(job_of, task):
    """Placed by one task and picked there by another one: no rule, and nothing is refused."""
    job = job_of(
        task("one", (0.45, 0.10, CUBE), (0.45, 0.40, CUBE)),
        task("two", (0.45, 0.40, CUBE), (0.30, 0.60, CUBE)),
    )
    assert refusal(job) == []
    ruled = RoomRules.of(job).ruled()
    assert (ruled.tasks, ruled.notes) == (job.tasks, job.notes)
    assert {(one.task.id, one.room.key) for one in crowded_stops(job)} == {("one", ("two", "pick"))}


@pytest.mark.parametrize("order", ["optimise", "given"])
@pytest.mark.parametrize("cause", [True, False])
def test_a_part_in_the_way_of_a_link_turns_two_tasks_round(job_of, task, order, cause):
    """Only a plan tells that a link meets a part: the next one has the two the other way round, if that is open."""
    job = job_of(
        *(
            task(name, (0.45, y, CUBE), (0.45, y + 0.3, CUBE))
            for name, y in (("a", 0.1), ("b", 0.4))
        ),
        head=f"order: {order}",
    )
    bodies = {"body_a": "left_link_5", "body_b": f"{job.tasks[0].part} of a"}
    touches = Refusal("every_posture_touches", arm="left", measured=0.01, data=bodies)
    fault = Refusal(
        "no_posture", task="b", arm="left", data={"cause": touches} if cause else bodies
    )
    asked = []

    def planned(one):
        asked.append({one.id: one.after for one in one.tasks})
        if one.tasks[0].after != ("b",):
            raise BlockedError(fault, stages=(0,))
        return plan(one, QUICK)

    if order == "given":
        with pytest.raises(BlockedError):
            planned_around(job, planned, lambda: False)
        assert len(asked) == 1
        return
    found = planned_around(job, planned, lambda: False)
    assert asked == [{"a": (), "b": ()}, {"a": ("b",), "b": ()}]
    assert [e.task for e in found.events] == ["b", "b", "a", "a"]
    assert found.order_grid_gap is None and not any("order bound" in note for note in found.notes)


@pytest.mark.parametrize("stopped", [False, True])
def test_tasks_that_are_in_each_other_s_way_are_refused_as_they_are(job_of, task, stopped):
    """Neither order has a plan: the refusal is that of the job without rules, at once where the search is stopped."""
    job = job_of(
        *(
            task(name, (0.45, y, CUBE), (0.45, y + 0.3, CUBE))
            for name, y in (("a", 0.1), ("b", 0.4))
        ),
        head="order: optimise",
    )
    asked = []

    def planned(one):
        asked.append([task.after for task in one.tasks])
        data = {
            "body_a": "left_link_5",
            "body_b": f"{job.tasks[0].part} of a",
            "number": len(asked),
        }
        raise BlockedError(Refusal("no_posture", task="b", arm="left", data=data), stages=(0,))

    with pytest.raises(BlockedError) as caught:
        planned_around(job, planned, lambda: stopped)
    assert caught.value.refusals[0].data["number"] == 1
    assert asked == [[(), ()], [("b",), ()], [(), ("a",)]][: 1 if stopped else 3]


def test_an_order_of_the_file_is_not_turned_round(job_of, task):
    """The file has b after a, whose part is in the way: no plan with b before a is looked for."""
    job = job_of(
        task("a", (0.45, 0.1, CUBE), (0.45, 0.4, CUBE)),
        task("b", (0.45, 0.4, CUBE), (0.45, 0.7, CUBE), ", after: [a]"),
        head="order: optimise",
    )
    asked = []

    def planned(one):
        asked.append([task.after for task in one.tasks])
        data = {"body_a": "left_link_5", "body_b": f"{job.tasks[0].part} of a"}
        raise BlockedError(Refusal("no_posture", task="b", arm="left", data=data), stages=(0,))

    with pytest.raises(BlockedError):
        planned_around(job, planned, lambda: False)
    assert asked == [[(), ("a",)]]


def test_a_return_that_a_part_is_in_the_way_of_is_refused_as_it_is(job_of, task):
    """It is of no task that could be done before another one."""
    job = job_of(task("a", (0.45, 0.1, CUBE), (0.45, 0.4, CUBE)), head="order: optimise")
    data = {"body_a": "left_link_5", "body_b": f"{job.tasks[0].part} of a"}

    asked = []

    def planned(one):
        asked.append(one)
        raise BlockedError(Refusal("return_touches", measured=0.01, data=data), stages=(0,))

    with pytest.raises(BlockedError):
        planned_around(job, planned, lambda: False)
    assert asked == [job]
