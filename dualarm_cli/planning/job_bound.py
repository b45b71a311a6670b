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
from dualarm_cli.kinds.planning import kind_of, kinds_of
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.closed_arm import ClosedArm
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.model.job import Job, Task
from dualarm_cli.orders.model.tool_changes import stand_tasks, with_changes
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.sequence_problem import sequence_problem

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
    "lower bound: the sum of the sections between paths and seams, each from its best start, and of paths and seams "
    "at full speed; transfers to and from paths and seams count as zero"
)
"""What a bound with paths assumes."""
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
STAGES_AS_ZERO = "lower bound: stages between paths and seams count as zero on this robot"
"""Message where only paths and seams are bounded."""


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
    value, assumptions = 0.0, dict[str, None]()
    for section in _bounded_sections(job):
        if (kind := kind_of(section)) is not None:
            value = max(value, _opens(section)) + kind.least(job, section)
        elif unbounded:
            assumptions[STAGES_AS_ZERO] = None
        else:
            # Where a section starts is for the plan to choose, and what comes after it does not count.
            alone = replace(job, tasks=section, start="free", returns=False)
            bounded = _bound if alone.is_decided else shared_bound
            bound = bounded(bounds, model, alone)
            value += bound.value if bound.value is not None else 0.0
            assumptions |= dict.fromkeys(bound.assumptions)
    return LowerBound(value, (*assumptions, PATH_BOUND))


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


def _opens(section: tuple[Task, ...]) -> float:
    """Returns when a section may begin at the earliest [s]."""
    kind = kind_of(section)
    return 0.0 if kind is None else kind.opens(section)


def _bounded_sections(job: Job) -> list[tuple[Task, ...]]:
    """Returns sections that take at least as long together as each by itself, in whatever order they are done."""
    if job.order == "given":
        return job.sections()
    others = tuple(task for task in job.tasks if not task.alone)
    alone = sorted((one for one in job.sections() if one[0].alone), key=_opens)
    # Of works that each open at some time no order is over sooner than that in which they open.
    return [*([others] if others else []), *alone]


def _bound(bounds: BoundMethod, model: CellModel, job: Job) -> LowerBound:
    """Returns the bound of a decided job.

    It looks at each arm by itself. In a hand-over what the other arm does comes before or after one's own lines and
    dwell: at least what its stop takes by itself from wherever it likes.
    """
    problem = bounds.law(sequence_problem(model, job))
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
    return lower_bound(replace(problem, arms=whole, handing=()), bounds.effort)


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
