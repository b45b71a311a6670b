"""What no order can repair is refused after few tries, not after all."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import pytest

from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders.orders import DecidedOrder, Orders, PairedSearch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning import ordered_plan
from dualarm_cli.planning.planner import plan
from dualarm_cli.postures.holding import Holding
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages

TOUCHES = Refusal("not_clear")


class Blocked:
    """A search whose orders never are collision-free: each time in another stage of both arms."""

    start = ()

    def __init__(self, alone):
        """Says whether one arm alone is to blame."""
        self.alone, self.tries = alone, 0

    def of_either_arm(self):
        """Each task has its arm."""
        return frozenset()

    def without(self, _pairs, _others, _first):
        """The search goes on."""
        return self

    def orders(self, _watch=None):
        """One order of ten stages."""
        tasks = [
            {
                arm: (
                    SimpleNamespace(id=f"{arm}-{k}", is_change=False),
                    SimpleNamespace(action="move"),
                )
                for arm in ("left", "right")
            }
            for k in range(10)
        ]
        return Orders((DecidedOrder(SimpleNamespace(stages=lambda: tasks), 1.0),), None, "")

    as_it_is = orders

    def planned(self, _one, of, repair_touching_stops):
        """No plan."""
        self.tries += 1
        raise BlockedError(TOUCHES, stages=(self.tries - 1,), alone=self.alone)


@pytest.mark.parametrize("effort", EFFORTS)
@pytest.mark.parametrize("alone", [True, False])
def test_where_an_arm_touches_by_itself_other_orders_are_soon_given_up(alone, effort, monkeypatch):
    """Where it is both arms that touch, they are taken apart as often as ever."""
    monkeypatch.setattr(ordered_plan, "_promising", lambda _s, found, *_: list(found))
    monkeypatch.setattr(ordered_plan, "stop_name", lambda task: task.id)
    search = Blocked(alone)
    settings = PlanSettings(effort=effort)
    with pytest.raises(BlockedError, match="no collision-free plan"):
        ordered_plan._searched(search, search.orders(), settings, Watch(), search.planned)
    trials = EFFORTS[effort].trials
    most = trials.searches + trials.separations + 1
    assert search.tries == (min(most, EFFORTS[effort].hopeless_orders) if alone else most)


@pytest.fixture
def made(tmp_path):
    """Makes a job of tasks on an SDA10F whose tools are capsules 80 mm thick."""
    shape = {"capsule": {"radius": 0.04, "length": 0.06}, "xyz": [0, 0, 0.06]}
    tool = {"tcp": {"xyz": [0, 0, 0.12]}, "shapes": [shape]}
    cell = {"dualarm": "cell/1", "robot": "sda10f", "tools": {"left": tool, "right": tool}}

    def job(tasks, box=None, **changes):
        obstacles = {} if box is None else {"box": {"box": [0.1, 0.1, 0.1], "xyz": box}}
        (tmp_path / "cell.yaml").write_text(json.dumps(cell | {"obstacles": obstacles}))
        document = {"dualarm": "tasks/1", "cell": "cell.yaml", "tasks": tasks}
        (tmp_path / "tasks.yaml").write_text(json.dumps(document | changes))
        return load_job(tmp_path / "tasks.yaml")

    return job


def move(name, arm, xyz, **more):
    """A bare move with the tool pointing down."""
    return {"id": name, "arm": arm, "move": {"xyz": xyz, "rpy": ["180 deg", 0, 0]}} | more


THERE = [0.5, 0.0, 0.85]


def test_an_idle_arm_that_stands_at_the_target_is_said_to_block_the_stage(made):
    """The right tool stays where the left one is to be: no posture of the left arm by itself is at fault."""
    job = made([move("first", "right", THERE), move("second", "left", THERE, after=["first"])])
    with pytest.raises(BlockedError, match="second") as caught:
        choose_stages(
            MethodProblem(CellModel.from_cell(job.cell), job, "arm_angle", holding=Holding.of(job)),
            "fixed",
        )
    assert (caught.value.stages, caught.value.alone, caught.value.never) == ((1,), False, ())


def test_what_is_within_an_obstacle_no_posture_of_an_arm_does_in_any_order(made):
    """A tool's shape where its target is fills a box of 100 mm; the first target is far from it."""
    job = made([move("first", "left", [0.5, 0.4, 0.85]), move("in", "left", THERE)], box=THERE)
    with pytest.raises(BlockedError, match="box") as caught:
        choose_stages(
            MethodProblem(CellModel.from_cell(job.cell), job, "arm_angle", holding=Holding.of(job)),
            "fixed",
        )
    assert (caught.value.stages, caught.value.never) == ((1,), (("left", "in"),))


def test_a_task_is_left_to_the_other_arm(made):
    """The left arm is on its side, and yet the right one has to go there; a task of one arm stays its own."""
    tasks = [move("open", "any", [0.5, 0.15, 0.85]), move("own", "left", [0.5, 0.3, 0.85])]
    job = made(tasks, order="optimise")
    search = PairedSearch.of(
        CellModel.from_cell(job.cell), job, "quick", 0, Watch(), check_collisions=False
    )
    assert search.of_either_arm() == {"open"}
    near = dataclasses.replace(
        job, tasks=tuple(dataclasses.replace(task, arm="left") for task in job.tasks), order="given"
    )
    left = search.without(set(), {("left", "open")}, near)
    assert left.start is None
    for one in left.orders(Watch()).ranked:
        assert {task.id: task.arm for task in one.job.tasks} == {"open": "right", "own": "left"}
    with pytest.raises(InfeasibleError):
        search.without(set(), {("left", "own")}, near).orders(Watch())


class OneArm(Blocked):
    """A search whose orders give a task to the left arm, which the idle right arm blocks, until it is told not to."""

    def __init__(self, orders_left):
        """Says whether there are orders without the left arm."""
        super().__init__(alone=False)
        self.orders_left, self.others = orders_left, set()

    def of_either_arm(self):
        """Either arm may do it."""
        return frozenset(["box"])

    def without(self, _pairs, others, _first):
        """Remembers what the other arm is to do."""
        self.others, self.start = set(others), None
        return self

    def orders(self, _watch=None):
        """Two orders of one stage, the same but for their totals."""
        if self.others and not self.orders_left:
            raise InfeasibleError(Refusal("no_order"))
        arm = "right" if self.others else "left"
        task = SimpleNamespace(id="box", is_change=False), SimpleNamespace(action="move")
        job = SimpleNamespace(stages=lambda: [{arm: task}], arm=arm)
        return Orders((DecidedOrder(job, 1.0), DecidedOrder(job, 1.1)), None, "")

    def planned(self, one, of, repair_touching_stops):
        """A plan where the right arm does it."""
        self.tries += 1
        if one.job.arm == "left":
            raise BlockedError(TOUCHES, stages=(0,))
        return SimpleNamespace(duration=one.total, blend_gain=None)


@pytest.mark.parametrize("orders_left", [True, False])
def test_what_an_idle_arm_blocks_is_done_by_that_arm(orders_left, monkeypatch):
    """The same task by the same arm is not planned again; where no order is left it is said what was in the way."""
    monkeypatch.setattr(ordered_plan, "_promising", lambda _s, found, *_: list(found))
    search = OneArm(orders_left)

    def planned():
        settings = PlanSettings(effort="quick")
        return ordered_plan._searched(search, search.orders(), settings, Watch(), search.planned)

    if orders_left:
        assert planned().duration == 1.0
        assert search.tries == 3  # once by the left arm, two orders by the right one
    else:
        with pytest.raises(BlockedError, match="no collision-free plan"):
            planned()
        assert search.tries == 1
    assert search.others == {("left", "box")}


@pytest.mark.parametrize("either", [True, False])
def test_what_no_posture_of_an_arm_does_ends_the_search_at_once_unless_the_other_arm_may(either):
    """Whatever is side by side with it."""
    tried = ordered_plan._Tried(12, frozenset(["in"] if either else []))
    work = {"left": (SimpleNamespace(id="in", is_change=False), SimpleNamespace(action="move"))}
    job = SimpleNamespace(stages=lambda: [work])
    tried.add(job, BlockedError(TOUCHES, stages=(0,), alone=True, never=(("left", "in"),)))
    assert tried.is_hopeless != either
    assert tried.others == ({("left", "in")} if either else set())
    tried.add(job, BlockedError(TOUCHES, stages=(0,), alone=True, never=(("right", "in"),)))
    assert tried.is_hopeless


def test_parts_too_heavy_for_an_arm_go_to_the_other_one():
    """All of them at once; a task of a fixed arm stays with it."""
    tried = ordered_plan._Tried(12, frozenset(["a", "b"]))
    heavy = (("left", "a"), ("left", "b"), ("left", "fixed"))
    tried.add(SimpleNamespace(stages=list), BlockedError(TOUCHES, stages=(), unheld=heavy))
    assert tried.others == set(heavy[:2])
    # The other arm cannot hold one, either: nothing is left to learn.
    data = {"joint": "r7", "unit": "N m", "time": 0, "carrying": "", "share": 1.1, "tried": []}
    last = BlockedError(
        Refusal("cannot_hold", measured=7.7, data=data), stages=(), unheld=(("right", "a"),)
    )
    tried.add(SimpleNamespace(stages=list), last)
    assert tried.count == 2
    told = str(ordered_plan.naming_other_arms(last, tried.unheld))
    assert (
        "110% of its effort, and the left arm cannot hold it, either; give a lighter part" in told
    )


CROWDED = """\
dualarm: cell/1
robot: yumi
tools:
  left:  {tcp: {xyz: [0, 0, 130 mm]}, shapes: [{box: [60 mm, 60 mm, 110 mm], xyz: [0, 0, 55 mm]}]}
  right: {tcp: {xyz: [0, 0, 130 mm]}, shapes: [{box: [60 mm, 60 mm, 110 mm], xyz: [0, 0, 55 mm]}]}
obstacles: {table: {box: [0.8, 1.4, 0.04], xyz: [0.5, 0, -0.02]}}
clearance: 5 mm
"""
NEAR_THE_BODY = """\
dualarm: tasks/1
cell: cell.yaml
order: optimise
return: true
defaults: {approach: 50 mm, retract: 50 mm, dwell: 0.1}
tasks:
  - id: a
    arm: any
    pick: {xyz: [0.40, 0.20, 0.05], rpy: [180 deg, 0, 0], free: yaw}
    place: {xyz: [0.40, 0.10, 0.05], rpy: [180 deg, 0, 0]}
  - id: b
    arm: any
    pick: {xyz: [0.40, -0.20, 0.05], rpy: [180 deg, 0, 0], free: yaw}
    place: {xyz: [0.40, -0.10, 0.05], rpy: [180 deg, 0, 0]}
"""


def test_a_task_that_no_arm_does_without_a_collision_is_named(tmp_path):
    """Its stops are in reach of both arms, which is not what 'every arm lacks one' would say."""
    (tmp_path / "cell.yaml").write_text(CROWDED)
    (tmp_path / "tasks.yaml").write_text(NEAR_THE_BODY)
    job = load_job(tmp_path / "tasks.yaml")
    with pytest.raises(InfeasibleError) as refused:
        plan(job, PlanSettings(effort="quick"))
    (refusal,) = refused.value.refusals
    assert (refusal.key, refusal.task) == ("out_of_reach", "a")
    assert [cause.arm for cause in refusal.data["causes"]] == ["left", "right"]
    assert {cause.data["cause"].key for cause in refusal.data["causes"]} == {"stops_lack_clearance"}
