"""Arms that change their tools: changes where they are due, what is held when, plans that pass every check."""

from __future__ import annotations

import dataclasses
from collections import Counter
from itertools import pairwise, permutations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.bound.job_bound import JobBound, least_visits
from dualarm_cli.clearing.blocked import start_faults
from dualarm_cli.clearing.clear_plan import quickest_clear
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Shape
from dualarm_cli.orders.messages import check_reach
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.tool_changes import changes_of, with_changes
from dualarm_cli.orders.orders import PairedSearch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning import free_ordered_plan
from dualarm_cli.planning.asynchronous import free_plan
from dualarm_cli.planning.asynchronous.free_epochs import FreeEpochs, plan_epochs
from dualarm_cli.planning.asynchronous.free_plan import FreePlanner
from dualarm_cli.planning.asynchronous.own_clock import OwnClock
from dualarm_cli.planning.decided_plan import schedule_of
from dualarm_cli.planning.job_faults import job_faults
from dualarm_cli.planning.planned_job import resolve
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.postures.holding import Holding
from dualarm_cli.report.console import summary_lines
from dualarm_cli.report.figures.gantt_figure import task_words
from dualarm_cli.report.report import build_report
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")
THERE = ["leave fingers ({})", "take suction ({})"]
BACK = ["leave suction ({})", "take fingers ({})"]
END = "left arm, at the end"


@pytest.fixture(scope="module")
def kit(tasks_folder):
    """The shipped job: plates by suction and screws by fingers for the left arm, screws for the right one."""
    return load_job(tasks_folder / "14_two_grippers" / "tasks.yaml")


def some(job, *ids, **changes):
    """Returns a job of some tasks, in that order."""
    tasks = {task.id: task for task in job.tasks}
    return dataclasses.replace(job, tasks=tuple(tasks[name] for name in ids), **changes)


def in_cell(job, **changes):
    """Returns a job whose left arm has other tool changes."""
    own = dataclasses.replace(job.cell.tool_changes["left"], **changes)
    return dataclasses.replace(job, cell=dataclasses.replace(job.cell, tool_changes={"left": own}))


def left(job):
    """Returns the left arm's tasks."""
    return [task.id for task in job.tasks if task.arm == "left"]


def named(rows, what):
    """Returns the names of changes for a task."""
    return [row.format(what) for row in rows]


@pytest.mark.parametrize(
    ("ids", "returns", "expected"),
    [
        (["screw-1"], True, ["screw-1"]),
        (["plate-1"], False, [*named(THERE, "plate-1"), "plate-1"]),
        (["plate-1"], True, [*named(THERE, "plate-1"), "plate-1", *named(BACK, END)]),
        (["plate-1", "plate-2"], False, [*named(THERE, "plate-1"), "plate-1", "plate-2"]),
        (
            ["screw-1", "plate-1", "screw-2"],
            True,
            ["screw-1", *named(THERE, "plate-1"), "plate-1", *named(BACK, "screw-2"), "screw-2"],
        ),
    ],
)
def test_tools_are_changed_where_the_next_task_asks_for_another(kit, ids, returns, expected):
    """Before it, and at the end of a cycle; never for nothing; once is enough."""
    job = some(kit, *ids, "screw-3", order="given", returns=returns)
    changed = with_changes(job)
    assert left(changed) == expected
    assert [t.id for t in changed.tasks if t.arm == "right"] == ["screw-3"]
    assert with_changes(changed) is changed
    for task in changed.tasks:
        if task.is_change:
            tool = job.cell.tool_changes["left"].tools[task.tool]
            [stop] = task.stops
            assert stop.target.pose == tool.stand
            assert (stop.approach, stop.retract, stop.dwell.total) == (0.08, 0.08, 0.8)


def test_no_tool_is_only_taken_and_only_left(kit):
    """From none at the start, to none at the end."""
    job = in_cell(some(kit, "plate-1", order="given"), start="")
    assert left(with_changes(job)) == [
        "take suction (plate-1)",
        "plate-1",
        f"leave suction ({END})",
    ]


def test_what_is_open_or_has_no_tools_stays_as_it_is(kit, tasks_folder):
    """An order that is not decided has no place for changes yet."""
    assert with_changes(kit) is kit
    plain = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    assert with_changes(plain) is plain


def test_a_given_pairing_gets_stages_for_changes(kit):
    """The other arm is idle there; all its own stages stay."""
    job = some(kit, "plate-1", "screw-3", order="given")
    stage = tuple((t.arm, t.id, "pick") for t in job.tasks)
    then = tuple((t.arm, t.id, "place") for t in job.tasks)
    changed = with_changes(dataclasses.replace(job, pairing=(stage, then)))
    there, back = named(THERE, "plate-1"), named(BACK, END)
    assert changed.pairing == (
        (("left", there[0], "leave_tool"),),
        (("left", there[1], "take_tool"),),
        stage,
        then,
        (("left", back[0], "leave_tool"),),
        (("left", back[1], "take_tool"),),
    )
    assert [len(work) for work in changed.stages()] == [1, 1, 2, 2, 1, 1]


def test_what_is_held_goes_from_tool_to_tool_and_part(kit):
    """Fingers from the start, nothing between the stands, suction, suction with a plate, and fingers in the end."""
    cell = dataclasses.replace(
        kit.cell, parts={"plate": (Shape("box", (0.1, 0.1, 0.01), pin.SE3.Identity()),)}
    )
    job = some(kit, "plate-1", order="given", cell=cell)
    job = dataclasses.replace(job, tasks=(dataclasses.replace(job.tasks[0], part="plate"),))
    holding = Holding.of(with_changes(job))
    a = holding.cell.arms.index("left")
    loads = holding.cell.loads
    names = [
        [loads.load(k).name for k in rows[:, a].tolist()]
        for rows in (holding.before, holding.after)
    ]
    at = " at its stand"
    assert names[0] == [f"fingers{at}", "", "suction", "suction with plate", f"suction{at}", ""]
    assert names[1] == ["", f"suction{at}", "suction with plate", "suction", "", f"fingers{at}"]
    np.testing.assert_array_equal(loads.off_lines(holding.before[:, 1 - a]), loads.nothing(6))
    # A tool with a part in it counts for more than the tool alone where both are looked at.
    tool, both = (np.array([loads.number(name)]) for name in ("suction", "suction with plate"))
    assert loads.fuller(tool, both) == loads.fuller(both, tool) == both != tool


def test_a_part_hangs_at_the_tool_that_grips_it(kit):
    """In the frame of the arm's own tool: 70 mm farther on at the suction cup (110 mm) than at the changer (40 mm)."""
    box = Shape("box", (0.1, 0.1, 0.01), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.005])))
    cell = dataclasses.replace(kit.cell, parts={"plate": (box,)})
    [tool], [part] = cell.held_shapes("left", Held("suction", "plate"))
    np.testing.assert_allclose(part.pose.translation, [0.0, 0.0, 0.075])
    np.testing.assert_allclose(tool.pose.translation, [0.0, 0.0, 0.035])
    assert cell.held_shapes("left", Held("", "plate"))[1][0].pose == box.pose


def test_on_its_stand_a_tool_may_touch_what_stands_there_and_nowhere_else(kit):
    """A rack right under the fingers as they hang: fine while they are left, not while an arm just comes by."""
    rack = Shape("box", (0.3, 0.3, 0.1), pin.SE3(np.eye(3), np.array([0.25, 0.60, 0.80])))
    [_, other] = kit.cell.obstacles
    cell = dataclasses.replace(kit.cell, obstacles=(dataclasses.replace(other, shape=rack),))
    job = some(kit, "plate-1", order="given", cell=cell)
    holding = Holding.of(with_changes(job))
    model, test = CellModel.from_cell(cell), holding.cell
    stand = PoseTarget(cell.tool_changes["left"].tools["fingers"].stand)
    order = OrderModel.of(model, job)
    nodes = order.nodes["left", order.stand("left", "fingers", "leave_tool"), 0]
    position = np.tile(order.start, (len(nodes.q_target), 1))
    position[:, model.platform_columns] = order.angles[nodes.angle_index]
    position[:, model.arms["left"].columns] = nodes.q_target
    a = test.arms.index("left")

    def margins(name, on_line):
        held = np.full(len(position), test.loads.number(name, on_line=on_line))
        return test.arm_margins(a, position, held, ground=True)

    free = margins("", False) >= 0.0
    assert free.any(), "the arm itself is clear of the rack somewhere"
    # 95 mm under the changer at 0.95 m is 5 mm above the rack's 0.85 m, where 4 mm are required; 2 mm lower it is not.
    assert stand.pose.translation[2] == 0.95
    assert (margins("fingers", False)[free] >= 0.0).any()
    lower = dataclasses.replace(rack, pose=pin.SE3(np.eye(3), np.array([0.25, 0.60, 0.803])))
    cell = dataclasses.replace(cell, obstacles=(dataclasses.replace(other, shape=lower),))
    test = Holding.of(with_changes(dataclasses.replace(job, cell=cell))).cell
    assert (margins("fingers at its stand", False)[free] < 0.0).all()
    assert (margins("fingers at its stand", True)[free] >= 0.0).any()
    assert (margins("fingers", True)[free] < 0.0).all()


@pytest.mark.parametrize("mode", [pytest.param("paired", marks=pytest.mark.slow), "free"])
def test_orders_group_tools_and_plans_pass_every_check(kit, mode, monkeypatch):
    """A screw between two plates in the file: four changes in its order, two in the plan."""
    job = some(kit, "plate-1", "screw-1", "plate-2", "screw-3", mode=mode)
    before, end = changes_of(dataclasses.replace(job, order="given"))
    assert sum(map(len, before.values())) + len(end) == 8
    # The platform stands at one angle: what else there is has tests of its own.
    monkeypatch.setattr(free_ordered_plan, "_turns", lambda _: False)
    monkeypatch.setattr(free_ordered_plan, "_may_be_quicker", lambda *_: False)
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job, clearance=True).failures == ()
    events = sorted((e for e in schedule.events if e.arm == "left"), key=lambda e: e.time)
    visits = [event.action in ("take_tool", "leave_tool") for event in events]
    assert sum(visits) == 4
    assert sum(b and not a for a, b in pairwise([False, *visits])) == 2


def test_an_arm_with_tools_fills_a_buffer_that_the_other_one_empties(kit):
    """In the file's order the screw is taken out first; the right arm waits until the left one has put it in."""
    job = some(kit, "screw-3", "plate-1", "screw-1", buffers={"tray": Buffer(1, 0)})
    take, plate, put = job.tasks
    stops = {"pick": (take, 0), "place": (put, 1)}
    for action, (task, k) in stops.items():
        own = list(task.stops)
        assert own[k].action == action
        own[k] = dataclasses.replace(own[k], buffer="tray")
        stops[action] = dataclasses.replace(task, stops=tuple(own))
    job = dataclasses.replace(job, tasks=(stops["pick"], plate, stops["place"]))
    schedule = plan_without_bound(job, QUICK)
    assert verify(schedule, job, clearance=True).failures == ()
    when = {(e.task, e.action): e.time for e in schedule.events}
    assert when["screw-1", "place"] < when["screw-3", "pick"]


def test_the_report_and_the_chart_tell_of_changes(kit):
    """How often, how many visits, and how long: transfers to stands, lines and dwells there."""
    job = some(kit, "plate-1", order="given", returns=False)
    schedule = plan_without_bound(job, QUICK)
    schedule = dataclasses.replace(schedule, verification=verify(schedule, job))
    report = build_report(schedule, job)
    own = [s for s in schedule.segments if s.arm == "left" and "plate-1)" in s.task]
    spent = sum(s.end - s.start for s in own if s.kind != "wait")
    assert report["tool_changes"]["left"] == {
        "changes": 1,
        "visits": 2,
        "time": pytest.approx(spent),
    }
    assert spent > 2 * 0.8
    line = f"left arm: 1 tool change: 2 visits to stands, {spent:.2f} s including the motions there"
    assert line in summary_lines(report)
    words = [word.text for word in task_words(schedule, ["left"], 0.0, schedule.duration)]
    assert words[:3] == ["leave fingers", "take suction", "plate-1"]


def test_changes_go_on_where_the_platform_stood_before(kit, monkeypatch):
    """Two epochs: suction is on from the first to the second one, fingers are on again at the end of it."""
    job = some(kit, "plate-1", "plate-2", "screw-3", order="given", mode="free")
    model = CellModel.from_cell(job.cell)
    before, end = changes_of(job)
    first, second, right = job.tasks
    found = FreeEpochs(
        with_changes(job),
        (
            (np.array([0.0]), (*before[first.id], first, right)),
            (np.radians([-20.0]), (second, *end)),
        ),
        0.0,
    )
    problem = MethodProblem(model, found.job, "arm_angle", "quick", 0)
    planner = FreePlanner(
        problem,
        METHODS["sequence"].solve,
        TIMING_SOLVERS["ruckig"],
        check_collisions=True,
    )
    held = []

    def spied(problem, *rest, **kinds):
        held.append((len(problem.job.tasks), problem.job.held_at_start("left")))
        return quickest_clear(problem, *rest, **kinds)

    monkeypatch.setattr(free_plan, "quickest_clear", spied)
    schedule = schedule_of(resolve(job, QUICK), found.job, plan_epochs(planner, found), ())
    # The left arm's stops, the right one's, the left one's next and its way back; the right arm is looked at by itself.
    assert held[:4] == [(3, "fingers"), (1, "fingers"), (3, "suction"), (0, "fingers")]
    assert verify(schedule, job, clearance=True).failures == ()


def test_a_stand_out_of_reach_is_named(kit):
    """With the tool, the arm, and where it is written; not where it is never needed."""
    changes = kit.cell.tool_changes["left"]
    far = pin.SE3(np.eye(3), np.array([3.0, 0.0, 1.0]))
    tools = {**changes.tools, "suction": dataclasses.replace(changes.tools["suction"], stand=far)}
    job = in_cell(kit, tools=tools)
    with pytest.raises(InfeasibleError, match=r"cell.yaml:\d+.*the stand of tool 'suction'"):
        plan_without_bound(dataclasses.replace(job, mode="free"), QUICK)
    screws = some(job, "screw-1", "screw-3")
    check_reach(OrderModel.of(CellModel.from_cell(job.cell), screws))


@pytest.mark.parametrize(
    ("ids", "returns", "start", "expected"),
    [
        (["screw-1", "screw-3"], True, "fingers", ""),
        (["plate-1", "screw-1"], True, "fingers", "take fingers, take suction, leave fingers, leave suction"),
        (["plate-1"], False, "fingers", "take suction, leave fingers"),
        (["plate-1"], False, "", "take suction"),
        (["plate-1", "screw-1"], True, "", "take fingers, take suction, leave fingers, leave suction"),
    ],
)  # fmt: skip
def test_the_fewest_visits_are_those_of_any_order(kit, ids, returns, start, expected):
    """None has fewer: every order of the tasks, with the changes that are then due, has these among them."""
    job = in_cell(some(kit, *ids, returns=returns), start=start)
    least = [f"{t.stops[0].action.split('_')[0]} {t.tool}" for t in least_visits(job, "left")]
    assert ", ".join(least) == expected
    for order in permutations(job.tasks):
        changed = with_changes(dataclasses.replace(job, tasks=order, order="given"))
        made = [task.id.split(" (")[0] for task in changed.tasks if task.is_change]
        assert not Counter(least) - Counter(made)


def test_the_bound_over_all_orders_has_the_fewest_visits_in_it(kit):
    """Four visits of at least 0.8 s more than without; the plan of the shipped job takes 20.5 s."""
    model = CellModel.from_cell(kit.cell)
    bound = JobBound(kit, model, (), "quick").over_all_orders(kit).value
    screws = dataclasses.replace(
        kit,
        tasks=tuple(dataclasses.replace(t, tool="fingers" if t.tool else "") for t in kit.tasks),
    )
    without = JobBound(screws, model, (), "quick").over_all_orders(screws).value
    # Bounds are rounded down by a hundred-thousandth.
    assert without + 4 * 0.8 <= bound * (1.0 + 2e-5)
    assert bound < 20.5


def test_a_tool_that_reaches_into_its_stand_is_told_before_any_search(kit):
    """Its end is 95 mm under the changer's face at 0.95 m; the rack ends at 0.857 m: 2 mm into it."""
    pose = pin.SE3(np.eye(3), np.array([0.175, 0.61, 0.847]))
    [table, rack] = kit.cell.obstacles
    rack = dataclasses.replace(rack, shape=dataclasses.replace(rack.shape, pose=pose))
    cell = dataclasses.replace(kit.cell, obstacles=(table, rack))
    job = some(kit, "plate-1", order="given", cell=cell)
    with pytest.raises(InfeasibleError) as caught:
        plan_without_bound(job, QUICK)
    assert (
        "where left has to leave it or on the line there, tool 'fingers' reaches 2.0 mm into 'rack'"
        in str(caught.value)
    )
    allowed = dataclasses.replace(cell, allowed_contacts=(("left_fingers", "rack"),))
    assert job_faults(dataclasses.replace(job, cell=allowed)) == []


def test_the_tool_of_the_start_is_there_from_the_start(kit):
    """Huge fingers touch at home; a huge suction cup does not until it is taken."""
    for tool, touches in (("fingers", True), ("suction", False)):
        changes = kit.cell.tool_changes["left"]
        huge = (Shape("sphere", (0.5,), pin.SE3.Identity()),)
        one = changes.tools[tool]
        one = dataclasses.replace(one, tool=dataclasses.replace(one.tool, shapes=huge))
        job = in_cell(some(kit, "screw-1", order="given"), tools={**changes.tools, tool: one})
        touching = [
            pair.data["body_a"] + pair.data["body_b"]
            for fault in start_faults(job, Holding.of(job))
            for pair in fault.data["pairs"]
        ]
        assert bool(touching) is touches
        assert all("left_fingers" in pair for pair in touching)


def test_an_arm_by_its_own_clock_holds_what_its_stops_say(kit):
    """Fingers until they have been left, suction from its stand on, on lines what may lie there; by hand."""
    job = with_changes(some(kit, "plate-1", order="given", returns=False))
    leave, take, _ = job.tasks
    parts, events = [], []
    for k, task in enumerate((leave, take)):
        action = task.stops[0].action
        for kind, start, end in (
            ("transfer", 0, 1),
            ("approach", 1, 2),
            ("dwell", 2, 3),
            ("retract", 3, 4),
        ):
            parts.append(Segment("left", kind, task.id, action, 4.0 * k + start, 4.0 * k + end))
        events.append(
            Event(4.0 * k + 2.0, "left", task.id, action, "left_tcp", pin.SE3.Identity(), 1.0)
        )
    still = Trajectory(("a",), np.array([0.0, 9.0]), *np.zeros((3, 2, 1)))
    clock = OwnClock("left", still, (), tuple(parts), tuple(events))
    cell = Holding.of(job).cell
    found = clock.held(np.arange(0.5, 9.0), cell, job).tolist()
    at = " at its stand"
    expected = [
        ("fingers", False),  # on the way
        (f"fingers{at}", True),  # approach
        (f"fingers{at}", True),  # it is given at the end of the dwell
        ("", True),
        ("", False),
        ("", True),
        (f"suction{at}", True),  # it is taken from the event on
        (f"suction{at}", True),
        (f"suction{at}", False),  # on the way that is a tool like any other
    ]
    assert found == [cell.loads.number(name, on_line=line) for name, line in expected]


def test_visits_to_stands_are_kept_apart_from_stops_that_turned_out_to_touch(kit):
    """What the right arm did beside a visit it does not do beside it in the next order."""
    job = some(kit, "plate-1", "screw-1", "screw-3")
    watch = Watch()
    search = PairedSearch.of(
        CellModel.from_cell(job.cell), job, "quick", 0, watch, check_collisions=False
    )
    first = search.orders(watch).ranked[0].job
    beside = {}
    for work in first.stages():
        if len(work) == 2 and work["left"][0].is_change:
            task, stop = work["right"]
            beside[work["left"][0].tool, work["left"][1].action] = task.id, stop.action
    assert beside
    (tool, action), other = next(iter(beside.items()))
    pair = ((f"{action.split('_')[0]} {tool} (left arm)", action), other)
    found = search.without({pair}, set(), first).orders(watch).ranked[0].job
    visits = 0
    for work in found.stages():
        task, stop = work.get("left", (None, None))
        if task is not None and (task.tool, stop.action) == (tool, action):
            visits += 1
            assert "right" not in work or (work["right"][0].id, work["right"][1].action) != other
    assert visits == 1


def test_orders_with_tool_changes_keep_buffers(kit):
    """The right arm takes what the left one puts, plate by plate; changes of tools are in between."""
    job = some(kit, "plate-1", "screw-1", "plate-2", "screw-3", "screw-4", order="optimise")
    uses = {("plate", "place"), ("screw-3", "pick"), ("screw-4", "pick")}
    tasks = tuple(
        dataclasses.replace(
            task,
            stops=tuple(
                dataclasses.replace(stop, buffer="tray")
                if {(task.id, stop.action), (task.id[:5], stop.action)} & uses
                else stop
                for stop in task.stops
            ),
        )
        for task in job.tasks
    )
    job = dataclasses.replace(job, tasks=tasks, buffers={"tray": Buffer(1)})
    model, watch = CellModel.from_cell(job.cell), Watch()
    search = PairedSearch.of(model, job, "quick", 0, watch, check_collisions=False)
    for one in search.orders(watch).ranked:
        assert any(task.is_change for task in one.job.tasks)
        levels = [0]
        for work in one.job.stages():
            levels.append(levels[-1] + sum(stop.stored for _, stop in work.values()))
            assert sum(bool(stop.buffer) for _, stop in work.values()) < 2
        assert set(levels) == {0, 1}
