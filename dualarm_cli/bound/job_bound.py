"""Lower bound on the cycle time of any job.

Start here to see which bound a job gets: of its stages, over all orders, of asynchronous arms, or of paths and seams.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.bound.bound import (
    ROUNDED_DOWN,
    LowerBound,
    OtherWork,
    bound_note,
    lower_bound,
    no_bound,
)
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.programs import least_cost
from dualarm_cli.kinds.planning import KindPlanning, Section, kind_of, kinds_of
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import BLENDINGS, STOPPING, Blending
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, Stop, Task
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.notes import Note
from dualarm_cli.orders.model.tool_changes import stand_tasks, with_changes
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.sequence_problem import sequence_problem, stops_problem

MOST_TASKS = 60
"""Maximum number of tasks that are bounded individually; further ones count with their dwells."""


def least_visits(job: Job, arm: str) -> list[Task]:
    """Select the fewest visits to tool stands that an arm makes in any order.

    Only tasks count that this arm alone may do. Each of their tools is taken once, and the start tool again if the
    cycle closes; before each take the mounted tool is left.

    Args:
        job: the job.
        arm: name of the arm.
    """
    start = job.cell.start_tool(arm)
    wanted = {task.tool for task in job.tasks if task.arm == arm} - {start}
    if not wanted:
        return []
    again = {start} if job.returns else set()
    takes = sorted((wanted | again) - {""})
    # In a cycle each taken tool is left once as well; else the last one may stay mounted.
    leaves = takes if job.returns else [start] if start else []
    stands = {
        (task.tool, task.stops[0].action): task for task in stand_tasks(job.cell) if task.arm == arm
    }
    return [stands[tool, "take_tool"] for tool in takes] + [
        stands[tool, "leave_tool"] for tool in leaves
    ]


def _least_makespan(times: FloatArray, setup: FloatArray) -> float:
    """Compute the least makespan [s] if tasks may be divided between arms.

    Infinite if no arm can do a task; 0 if the linear program has no solution.

    Args:
        times: of every task on every arm [s], infinite if an arm cannot do it, shape (arms, n).
        setup: further time of every arm [s], shape (arms,).
    """
    arms, n = times.shape
    is_able = np.isfinite(times)
    if not is_able.any(axis=0).all():
        return np.inf
    task, arm = np.tile(np.arange(n), arms), np.repeat(np.arange(arms), n)
    column, last = np.arange(arms * n), np.full(arms, arms * n)
    # Each arm's load is at most T, the last variable; the fractions of a task add up to at least 1.
    matrix = (
        np.concatenate([arm, np.arange(arms), arms + task]),
        np.concatenate([column, last, column]),
        np.concatenate([np.where(is_able, times, 0.0).ravel(), -np.ones(arms), -np.ones(arms * n)]),
    )
    cost = np.append(np.zeros(arms * n), 1.0)
    upper = np.append(is_able.ravel().astype(np.float64), np.inf)
    solution = least_cost(
        cost, matrix, np.append(-setup, -np.ones(n)), np.zeros(arms * n + 1), upper
    )
    return 0.0 if solution is None else float(solution[-1])


def _kind(section: Section) -> KindPlanning:
    """Return the planning kind of a path or seam."""
    kind = kind_of(section)
    assert kind is not None  # stops have no kind
    return kind


@dataclass(frozen=True)
class _Row:
    """Stage in the bound of a decided job.

    A path or seam makes two: the first ends at its begin, the second at its end.
    """

    stops: Mapping[str, Stop]
    """Stops of the stage by arm."""
    least: float = 0.0
    """Least length of the stage [s]."""
    earliest: float = 0.0
    """Earliest begin of the stage [s]."""
    moved: tuple[str, ...] = ()
    """Arms that end the stage elsewhere: by a path or seam, or past a target."""
    at_rest: bool = False
    """Flag of stages that end at an end of a path or seam."""


def _other_work(job: Job, section: Section) -> list[_Row]:
    """Make the two stages of a path or seam: transfer and motion along it."""
    kind = _kind(section)
    begin, end = (
        {arm: Stop("move", pose, 0.0, 0.0, Dwell(), NOWHERE) for arm, pose in poses.items()}
        for poses in kind.ends(job, section)
    )
    arms = tuple(task.arm for task in section)
    return [
        _Row(begin, kind.least_transfer(job, section), at_rest=True),
        _Row(end, kind.least(job, section), kind.opens(section), arms, at_rest=True),
    ]


def _least_work(problem: SequenceProblem, a: int, k: int, effort: str) -> float:
    """Compute a lower bound on the lines and dwell of one arm's stop [s]."""
    stop = problem.arms[a].stops[k]
    if stop is None:
        return 0.0
    arms = tuple(
        replace(arm, stops=(stop if i == a else None,)) for i, arm in enumerate(problem.arms)
    )
    alone = replace(problem, arms=arms, free_start=True, returns=False, handing=())
    return max(stop.dwell, lower_bound(alone, effort).value or 0.0)


def job_bound(job: Job, effort: str, blend: str = STOPPING.name) -> LowerBound:
    """Measure a job's cell and compute its bound under a law of BLENDINGS; see `JobBound`."""
    model, kinds = CellModel.from_cell(job.cell), tuple(kinds_of(job))
    return JobBound(job, model, kinds, effort, BLENDINGS[blend]).value()


@dataclass(frozen=True)
class JobBound:
    """Lower bound on the cycle time of every plan of a job."""

    job: Job
    """Job as in its file."""
    model: CellModel
    """Kinematics of the cell, with all closed forms."""
    kinds: tuple[KindPlanning, ...]
    """Kinds of work among the tasks."""
    effort: str
    """Value of `--effort`: finer cells give a better bound."""
    blending: Blending = STOPPING
    """Rule for stops that tools pass in motion."""

    def value(self) -> LowerBound:
        """Compute the bound, or the reason for its absence."""
        if reason := next((kind.unbounded for kind in self.kinds if kind.unbounded), None):
            return no_bound(reason)
        bound = self._of_job(self.blending.straight(self.job))
        if bound.value is not None and any(map(self._is_passed, self.job.tasks)):
            notes = (*bound.assumptions, bound_note("passed_targets"))
            bound = replace(bound, assumptions=notes)
        assumption = self.blending.assumption
        # A bound of paths and seams alone counts no stops.
        has_stops = any(not task.alone for task in self.job.tasks)
        has_stops = has_stops and all(note.key != "paths_alone" for note in bound.assumptions)
        if assumption is None or bound.value is None or not has_stops:
            return bound
        others = (note for note in bound.assumptions if note.key != "order")
        return replace(bound, assumptions=(*others, assumption))

    def _of_job(self, job: Job) -> LowerBound:
        """Bound a job whose lines have only their straight parts."""
        unbounded = self._why_unbounded()
        job = with_changes(job)
        if unbounded and not job.in_sections:
            return no_bound(unbounded)
        if not job.is_decided and not job.in_sections:
            return self.over_all_orders(job)
        if job.mode == "free":
            return self._of_asynchronous_arms(job)
        if not job.in_sections:
            value = self._of_rows(job, self._rows(job))
            return LowerBound(value, (bound_note("order"),))
        if unbounded or job.order != "given":
            return self._sum_of_sections(job, stages_count=not unbounded)
        return self._with_other_work(job)

    def _is_passed(self, task: Task) -> bool:
        """Check that a task is a move whose target the tool passes within `blend`."""
        return any(stop.blend > 0.0 and self.blending.passes(stop) for stop in task.stops)

    def _rows(self, job: Job) -> list[_Row]:
        """Make the stages of a decided job, without the targets that tools pass.

        A transfer past such a target counts from the stop before to the next one if no other arm stops in between.
        Otherwise it may begin in any of these stages, and does not count.
        """
        rows, passing = list[_Row](), set[str]()
        for stage in job.stages():
            stops = {a: stop for a, (task, stop) in stage.items() if not self._is_passed(task)}
            passing |= stage.keys() - stops.keys()
            if stops:
                rows.append(_Row(stops, moved=tuple(passing - stops.keys())))
                passing = set()
        return [*rows, _Row({}, moved=tuple(passing))] if passing else rows

    def _of_order(self, job: Job) -> LowerBound:
        """Bound the stages of a decided job."""
        return lower_bound(sequence_problem(self.model, job).under(self.blending.law), self.effort)

    def _why_unbounded(self) -> Note | None:
        """Return the reason against bounding stages, or None."""
        job, robot = self.job, self.job.cell.robot
        if any(arm.kinematics.solves_by_search for arm in self.model.arms.values()):
            return bound_note("no_closed_forms")
        # The cells of the bound cover one platform joint. Several platform joints keep their start position, except
        # along paths and seams, so that stages after these begin elsewhere.
        if len(robot.platform) == 1:
            if robot.sliding.issuperset(robot.platform):
                return bound_note("rail")
            return None if self.model.has_arm_angles else bound_note("turning_wrists")
        return bound_note("paths_alone") if robot.platform and job.in_sections else None

    def over_all_orders(self, job: Job) -> LowerBound:
        """Bound a job over all orders and assignments.

        A linear program divides tasks between arms in fractions, so that the longest load T is least.
        """
        times = np.full((len(self.model.arms), len(job.tasks)), np.inf)
        for t, task in enumerate(job.tasks):
            for a, name in enumerate(self.model.arms):
                if not task.allows(name):
                    continue
                times[a, t] = sum(stop.dwell.total for stop in task.stops)
                if t < MOST_TASKS and not self._is_passed(task):
                    assigned = replace(task, arm=name, after=())
                    alone = replace(
                        job, tasks=(assigned,), start="free", returns=False, pairing=None
                    )
                    bound = self._of_order(alone).value
                    times[a, t] = max(times[a, t], bound or 0.0)
        assumptions = [bound_note("all_orders")]
        if len(job.tasks) > MOST_TASKS:
            assumptions.append(bound_note("dwells_only", tasks=MOST_TASKS))
        visits = np.zeros(len(self.model.arms))
        for a, name in enumerate(self.model.arms):
            for stand in least_visits(job, name):
                alone = replace(job, tasks=(stand,), start="free", returns=False, pairing=None)
                visits[a] += self._of_order(alone).value or 0.0
        return LowerBound(_least_makespan(times, visits), tuple(assumptions))

    def _of_asynchronous_arms(self, job: Job) -> LowerBound:
        """Bound a job whose arms are asynchronous."""
        value = 0.0
        for name in self.model.arms:
            arm_tasks = (task for task in job.tasks if task.arm == name)
            tasks = tuple(task for task in arm_tasks if not self._is_passed(task))
            if tasks:
                alone = replace(job, tasks=tasks, pairing=None)
                bound = self._of_order(alone).value
                value = max(value, bound or 0.0)
        return LowerBound(value, (bound_note("own_clocks"),))

    def _sum_of_sections(self, job: Job, *, stages_count: bool) -> LowerBound:
        """Sum the bounds of paths and seams and of all other tasks.

        For paths and seams in any order, and for robots whose stages have no bound: there the other tasks count as
        zero.

        Args:
            job: the job.
            stages_count: whether this robot has bounds of stages.
        """
        value, assumptions = 0.0, [bound_note("open_paths" if stages_count else "paths_alone")]
        others = tuple(task for task in job.tasks if not task.alone)
        if others and stages_count:
            alone = replace(job, tasks=others, start="free", returns=False)
            bound = self.over_all_orders(alone)
            value = bound.value or 0.0
            assumptions = [*bound.assumptions, *assumptions]
        works = [section for section in job.sections() if section[0].alone]
        if job.order != "given":
            # The transfer may be finished when a path opens. In the order of earliest departure all end soonest.
            works.sort(
                key=lambda work: _kind(work).opens(work) - _kind(work).least_transfer(job, work)
            )
        for work in works:
            kind = _kind(work)
            begin = max(value + kind.least_transfer(job, work), kind.opens(work))
            value = begin + kind.least(job, work)
        return LowerBound(value * ROUNDED_DOWN, tuple(assumptions))

    def _with_other_work(self, job: Job) -> LowerBound:
        """Bound a job with paths and seams in a given order."""
        assumptions = dict[Note, None]()
        rows: list[_Row] = []
        for section in job.sections():
            if section[0].alone:
                rows += _other_work(job, section)
            elif (decided := replace(job, tasks=section)).is_decided:
                assumptions |= {bound_note("order"): None}
                rows += self._rows(decided)
            else:
                shared = self.over_all_orders(replace(decided, start="free", returns=False))
                rows.append(_Row({}, shared.value or 0.0, moved=tuple(self.model.arms)))
                assumptions |= dict.fromkeys(shared.assumptions)
        value = self._of_rows(job, rows)
        if np.isinf(value):
            # Within its tolerance a path may end although no posture reaches its nominal end.
            rows = [replace(row, stops={}) if row.at_rest else row for row in rows]
            value = self._of_rows(job, rows)
        return LowerBound(value, (*assumptions, bound_note("paths")))

    def _of_rows(self, job: Job, rows: list[_Row]) -> float:
        """Bound stages [s], under a job's limits and with its start and return."""
        stops = {name: [row.stops.get(name) for row in rows] for name in self.model.arms}
        handing = tuple(any(stop.action == "give" for stop in row.stops.values()) for row in rows)
        problem = replace(stops_problem(self.model, job, stops), handing=handing)
        works = OtherWork(
            least=np.array([row.least for row in rows]),
            earliest=np.array([row.earliest for row in rows]),
            moved=np.array([[name in row.moved for row in rows] for name in self.model.arms]),
        )
        value = self._of_stages(problem, works).value
        assert value is not None  # there are cells for every stop of this robot
        return value

    def _of_stages(self, problem: SequenceProblem, works: OtherWork | None = None) -> LowerBound:
        """Bound stages in a given order, each arm alone.

        In a hand-over the other arm's lines and dwell come before or after those of an arm: its stop takes at least
        its least time alone, from the best posture.

        Args:
            problem: the stages.
            works: paths and seams among them; None for none.
        """
        problem = problem.under(self.blending.law)
        arms = [list(arm.stops) for arm in problem.arms]
        for k in problem.handover_stages.tolist():
            least = [_least_work(problem, a, k, self.effort) for a in range(len(arms))]
            for a, stops in enumerate(arms):
                stop = stops[k]
                if stop is not None:
                    stops[k] = replace(stop, dwell=stop.dwell + sum(least) - least[a])
        whole = tuple(
            replace(arm, stops=tuple(stops)) for arm, stops in zip(problem.arms, arms, strict=True)
        )
        return lower_bound(replace(problem, arms=whole, handing=()), self.effort, works)
