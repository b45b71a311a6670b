"""What no plan of a job can beat, by the bound that serves it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dualarm_cli.bound.bound import ASSUMPTIONS, LowerBound, lower_bound
from dualarm_cli.bound.passing import passing
from dualarm_cli.clearing.permissions import permitted
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.linear_programs import least_cost
from dualarm_cli.kinds.planning import KindPlanning, Section, ToolPoses, kind_of, kinds_of
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.closed_arm import ClosedArm
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.model.job import Dwell, Job, PoseTarget, Stop, Task
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.orders.model.tool_changes import stand_tasks, with_changes
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.sequence_problem import sequence_problem, stops_problem

SHARED = (
    "lower bound: holds for every plan of these tasks, whichever arm does what in whatever order: each task takes at "
    "least its shortest time alone, with its best platform angle, postures and yaws, and the slower arm does at least "
    "its share; transfers between tasks count as zero, tool changes as the fewest visits to stands"
)
"""What the bound over all orders assumes."""
OWN_CLOCKS = (
    "lower bound: holds for every plan in this order in which the arms run asynchronously: the time of the slower "
    "arm's stops, as if the platform moved for this arm only"
)
"""What the bound of asynchronous arms assumes."""
BLENDED = (
    "lower bound: holds for every plan that keeps the order, if one is given, and stops at its targets only: transfers "
    "take at least each joint's way at full speed, the straight parts of lines what joints need from rest to any "
    "speed; these are followed exactly, and the platform stands during them and dwells"
)
"""What a bound assumes of plans with blended lines."""
DWELLS_ONLY = "lower bound: tasks after the first {most} count with their dwells only"
"""Message where there are too many tasks to bound each."""
MOST_TASKS = 60
"""So many tasks are bounded one by one."""


@dataclass(frozen=True)
class BoundMethod:
    """How hard bounds try, and what of."""

    effort: str
    """quick, normal or thorough."""
    law: Callable[[SequenceProblem], SequenceProblem]
    """Turns sequences into those whose plans are bounded."""

    def of(self, model: CellModel, job: Job) -> LowerBound:
        """Returns the bound of a decided job's stages."""
        return lower_bound(self.law(sequence_problem(model, job)), self.effort)


def shared_bound(bounds: BoundMethod, model: CellModel, job: Job) -> LowerBound:
    """Returns a bound over all orders and assignments.

    The least T so that tasks, shared out in fractions, take no arm longer than T: a linear programme.

    Args:
        bounds: how they are computed.
        model: the job's cell, with closed forms.
        job: what is to be done.
    """
    times = np.full((len(model.arms), len(job.tasks)), np.inf)
    for t, task in enumerate(job.tasks):
        for a, name in enumerate(model.arms):
            if not task.allows(name):
                continue
            times[a, t] = sum(stop.dwell.total for stop in task.stops)
            if t < MOST_TASKS:
                own = replace(task, arm=name, after=())
                alone = replace(job, tasks=(own,), start="free", returns=False, pairing=None)
                found = bounds.of(model, alone).value
                times[a, t] = max(times[a, t], found or 0.0)
    more = (DWELLS_ONLY.format(most=MOST_TASKS),) if len(job.tasks) > MOST_TASKS else ()
    visits = np.zeros(len(model.arms))
    for a, name in enumerate(model.arms):
        for stand in least_visits(job, name):
            alone = replace(job, tasks=(stand,), start="free", returns=False, pairing=None)
            visits[a] += bounds.of(model, alone).value or 0.0
    return LowerBound(_least_makespan(times, visits), (SHARED, *more))


def least_visits(job: Job, arm: str) -> list[Task]:
    """Returns the visits to stands that an arm makes at least, whatever the order, for tasks that only it may do.

    Every tool of theirs is taken once, that of the start again where it has to be on in the end; before each of these
    what was on is left.

    Args:
        job: what is to be done.
        arm: which arm.
    """
    start = job.cell.start_tool(arm)
    wanted = {task.tool for task in job.tasks if task.arm == arm} - {start}
    if not wanted:
        return []
    again = {start} if job.returns else set()
    takes = sorted((wanted | again) - {""})
    # In a cycle what is taken is left once as well; else one of them stays on, or may.
    leaves = takes if job.returns else [start] if start else []
    stands = {
        (task.tool, task.stops[0].action): task for task in stand_tasks(job.cell) if task.arm == arm
    }
    return [stands[tool, "take_tool"] for tool in takes] + [
        stands[tool, "leave_tool"] for tool in leaves
    ]


def own_clocks_bound(bounds: BoundMethod, model: CellModel, job: Job) -> LowerBound:
    """Returns a bound for arms that go through their stops by their own clocks; arguments as of `shared_bound`."""
    value = 0.0
    for name in model.arms:
        tasks = tuple(task for task in job.tasks if task.arm == name)
        if tasks:
            alone = replace(job, tasks=tasks, pairing=None)
            found = bounds.of(model, alone).value
            value = max(value, found or 0.0)
    return LowerBound(value, (OWN_CLOCKS,))


def _least_makespan(times: FloatArray, besides: FloatArray) -> float:
    """Returns the least T of tasks shared out in fractions.

    Args:
        times: of every task on every arm [s], infinite where an arm cannot, shape (arms, n).
        besides: what every arm does besides [s], shape (arms,).
    """
    arms, n = times.shape
    can = np.isfinite(times)
    if not can.any(axis=0).all():
        return np.inf
    task, arm = np.tile(np.arange(n), arms), np.repeat(np.arange(arms), n)
    column, last = np.arange(arms * n), np.full(arms, arms * n)
    # Each arm's load is at most T, the last variable; all shares of a task are at least the task.
    matrix = (
        np.concatenate([arm, np.arange(arms), arms + task]),
        np.concatenate([column, last, column]),
        np.concatenate([np.where(can, times, 0.0).ravel(), -np.ones(arms), -np.ones(arms * n)]),
    )
    cost = np.append(np.zeros(arms * n), 1.0)
    most = np.append(can.ravel().astype(np.float64), np.inf)
    found = least_cost(cost, matrix, np.append(-besides, -np.ones(n)), np.zeros(arms * n + 1), most)
    return 0.0 if found is None else float(found[-1])


PATH_BOUND = (
    "lower bound: paths and seams count at full speed, and begin and end at rest, exactly where the file has them; "
    "transfers to and from them count where the file gives the tool's pose, or how long they take"
)
OPEN_PATH_BOUND = (
    "lower bound: paths and seams count at full speed; transfers to and from them count only as long as the file says "
    "they take, as their order is not given"
)
STAGES_AS_ZERO = (
    "lower bound: paths and seams count at full speed; stages between them count as zero on this robot, and transfers "
    "to and from them only as long as the file says they take"
)
"""What a bound of paths and seams counts: in a given order, in any order, and on robots without bounds of stages."""
NO_BOUND = "lower bound: none for arms without closed forms"
"""Message where there is no bound."""
NO_BOUND_ON_RAILS = (
    "lower bound: none for a platform that slides; frozen at a position (`frozen`) there is one"
)
NO_TURNING_BOUND = "lower bound: none for arms of six axes on a platform that turns"
"""Messages where there is none for the platform's sake."""
NO_MOVING_BOUND = {
    "dwell_motion": "lower bound: none with `dwell_motion: allowed`, as the platform need not stand while tools dwell",
    "line_motion": "lower bound: none with `line_motion: allowed`, as the platform need not stand while tools are on "
    "lines",
}
"""Messages where dwells or lines do not keep the platform."""
NO_CORNER_BOUND = (
    "lower bound: none with `blend` at targets of moves, as tools need not come to these"
)
"""Message where tools pass beside targets."""


def job_bound(job: Job, effort: str, *, blended: bool = False) -> LowerBound:
    """Returns what no plan of a job can beat.

    Args:
        job: what is to be done.
        effort: quick, normal or thorough.
        blended: whether tools may pass the outer ends of lines in motion, of which only the straight parts count then.
    """
    if keys := permitted(job):
        return LowerBound(None, tuple(NO_MOVING_BOUND[key] for key in keys))
    if blended and any(stop.blend > 0.0 for task in job.tasks for stop in task.stops):
        return LowerBound(None, (NO_CORNER_BOUND,))
    if not blended:
        return _job_bound(BoundMethod(effort, lambda problem: problem), job)
    found = _job_bound(BoundMethod(effort, passing), job.blended())
    if found.value is None:
        return found
    kept = (text for text in found.assumptions if text not in ASSUMPTIONS)
    return replace(found, assumptions=(*kept, BLENDED))


def _job_bound(bounds: BoundMethod, job: Job) -> LowerBound:
    if why := next((kind.unbounded for kind in kinds_of(job) if kind.unbounded), ""):
        return LowerBound(None, (why,))
    model = CellModel.from_cell(job.cell)
    unbounded = _why_unbounded(job, model)
    job = with_changes(job)
    if unbounded and not job.in_sections:
        return LowerBound(None, (unbounded,))
    if not job.is_decided and not job.in_sections:
        return shared_bound(bounds, model, job)
    if job.mode == "free":
        return own_clocks_bound(bounds, model, job)
    if not job.in_sections:
        return _bound(bounds, model, job)
    return _sections_bound(bounds, model, job, stages_count=not unbounded)


def _why_unbounded(job: Job, model: CellModel) -> str:
    """Returns why there is no bound on a job's stages, empty where there is one."""
    robot = job.cell.robot
    others = [a.kinematics for a in model.arms.values() if not isinstance(a.kinematics, SrsArm)]
    if not all(isinstance(arm, ClosedArm) for arm in others):
        return NO_BOUND
    # The cells of the bound are of platform angles; several joints stand where the start has them, but along paths and
    # seams they move, and stages after these are made from elsewhere.
    if len(robot.platform) == 1:
        if robot.sliding.issuperset(robot.platform):
            return NO_BOUND_ON_RAILS
        return NO_TURNING_BOUND if others else ""
    return STAGES_AS_ZERO if robot.platform and job.in_sections else ""


@dataclass(frozen=True)
class _Run:
    """Stops, and the path or seam after them."""

    stops: Section = ()
    """Tasks of the stops; empty for none."""
    after: Section = ()
    """The path or seam after them; empty where the motion ends."""
    before: Section = ()
    """The path or seam before them; empty where the motion begins."""


def _runs(job: Job) -> list[_Run]:
    """Returns parts of a job that take at least the sum of their bounds, in whatever order they are done."""
    if job.order != "given":
        others = tuple(task for task in job.tasks if not task.alone)
        alone = [_Run(after=one) for one in job.sections() if one[0].alone]
        # No order ends sooner than the one in which paths and seams follow one another as they open.
        return [_Run(others), *sorted(alone, key=lambda run: _kind(run.after).opens(run.after))]
    found, stops, before = [], Section(), Section()
    for section in job.sections():
        if section[0].alone:
            found.append(_Run(stops, section, before))
            stops, before = (), section
        else:
            stops = section
    return [*found, _Run(stops, before=before)]


def _kind(section: Section) -> KindPlanning:
    """Returns the kind of a path or seam."""
    kind = kind_of(section)
    assert kind is not None  # stops have no kind
    return kind


def _sections_bound(
    bounds: BoundMethod, model: CellModel, job: Job, *, stages_count: bool
) -> LowerBound:
    """Returns the bound of a job with paths or seams: the sum over its runs.

    Args:
        bounds: how bounds are computed.
        model: the job's cell.
        job: what is to be done.
        stages_count: whether this robot has bounds of stages.
    """
    value, assumptions = 0.0, dict[str, None]()
    for run in _runs(job):
        transfer = _kind(run.after).transfer(job, run.after) if run.after else 0.0
        bound = LowerBound(transfer, ())
        if stages_count:
            bound = _run_bound(bounds, model, job, run, transfer)
        value += bound.value or 0.0
        assumptions |= dict.fromkeys(bound.assumptions)
        if run.after:
            kind = _kind(run.after)
            value = max(value, kind.opens(run.after)) + kind.least(job, run.after)
    counted = PATH_BOUND if job.order == "given" else OPEN_PATH_BOUND
    return LowerBound(value, (*assumptions, counted if stages_count else STAGES_AS_ZERO))


def _run_bound(
    bounds: BoundMethod, model: CellModel, job: Job, run: _Run, transfer: float
) -> LowerBound:
    """Returns the bound of a run's stops and transfers, without the path or seam after them.

    Args:
        bounds: how bounds are computed.
        model: the job's cell.
        job: what is to be done; transfers to and from paths and seams count where it gives their order.
        run: part of the job.
        transfer: least time of the last transfer that the file asks for [s].
    """
    stops = replace(job, tasks=run.stops, returns=job.returns and not run.after)
    if job.order != "given":
        if not run.stops:
            return LowerBound(transfer, ())
        return shared_bound(bounds, model, replace(stops, start="free", returns=False))
    # Paths and seams begin and end at rest, so a transfer between two of them is at rest at both ends in any plan.
    bounds = bounds if run.stops else replace(bounds, law=lambda problem: problem)
    before = _kind(run.before).ends(job, run.before)[1] if run.before else None
    after = _kind(run.after).ends(job, run.after)[0] if run.after else None
    found = _bound(bounds, model, stops, before, after)
    if transfer:
        without = _bound(bounds, model, stops, before).value or 0.0
        found = replace(found, value=max(found.value or 0.0, without + transfer))
    return found


def _bound(
    bounds: BoundMethod,
    model: CellModel,
    job: Job,
    before: ToolPoses | None = None,
    after: ToolPoses | None = None,
) -> LowerBound:
    """Returns the bound of a decided job.

    It looks at each arm by itself. In a hand-over what the other arm does comes before or after one's own lines and
    dwell: at least what its stop takes by itself from wherever it likes.

    Args:
        bounds: how they are computed.
        model: the job's cell.
        job: what is to be done.
        before: tool poses before its first stage, where a path or seam ends; None where the motion begins.
        after: tool poses after its last stage, where a path or seam begins; None where the motion ends.
    """
    problem = bounds.law(_with_ends(sequence_problem(model, job), model, job, before, after))
    arms = [list(arm.stops) for arm in problem.arms]
    for k in problem.together.tolist():
        least = [_least_work(problem, a, k, bounds.effort) for a in range(len(arms))]
        for a, stops in enumerate(arms):
            stop = stops[k]
            if stop is not None:
                stops[k] = replace(stop, dwell=stop.dwell + sum(least) - least[a])
    whole = tuple(
        replace(arm, stops=tuple(stops)) for arm, stops in zip(problem.arms, arms, strict=True)
    )
    return lower_bound(
        replace(problem, arms=whole, handing=()), bounds.effort, begins_anywhere=before is not None
    )


def _with_ends(
    problem: SequenceProblem,
    model: CellModel,
    job: Job,
    before: ToolPoses | None,
    after: ToolPoses | None,
) -> SequenceProblem:
    """Returns a job's stages with one more stage before them and one after, where tools are at rest; see `_bound`."""
    first, last = ([] if poses is None else [poses] for poses in (before, after))
    stops = {name: [_stop_at(poses.get(name)) for poses in first + last] for name in model.arms}
    ends = stops_problem(model, job, stops)
    n = len(first)
    arms = tuple(
        replace(arm, stops=(*end.stops[:n], *arm.stops, *end.stops[n:]))
        for arm, end in zip(problem.arms, ends.arms, strict=True)
    )
    handing = (*[False for _ in first], *problem.handing, *[False for _ in last])
    return replace(problem, arms=arms, handing=handing)


def _stop_at(target: PoseTarget | None) -> Stop | None:
    """Returns a stop without lines and dwell; None for an arm whose pose is not known."""
    return None if target is None else Stop("move", target, 0.0, 0.0, Dwell(), NOWHERE)


def _least_work(problem: SequenceProblem, a: int, k: int, effort: str) -> float:
    """Returns what lines and dwell of one arm's stop take at least [s]."""
    stop = problem.arms[a].stops[k]
    if stop is None:
        return 0.0
    arms = tuple(
        replace(arm, stops=(stop if i == a else None,)) for i, arm in enumerate(problem.arms)
    )
    alone = replace(problem, arms=arms, free_start=True, returns=False, handing=())
    return max(stop.dwell, lower_bound(alone, effort).value or 0.0)
