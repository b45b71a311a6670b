"""Comparison of methods on one job: cases to run and their outcomes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Literal

from dualarm_cli.errors import InfeasibleError, MissingDependencyError, UnsupportedError
from dualarm_cli.kinds.planning import families, kinds_of
from dualarm_cli.model.blending import STOPPING
from dualarm_cli.model.job import Job
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.planning.redundancy_choice import with_redundancy
from dualarm_cli.postures import REDUNDANCY_SOLVERS
from dualarm_cli.records import dataclass
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.stages.serving import cell_model, own_redundancy, served_settings
from dualarm_cli.timing import TIMING_SOLVERS

Status = Literal["verified", "failed", "infeasible", "not served"]
Judge = Callable[[Schedule, Job], Schedule]
"""Adds the verification, and the lower bound that it is compared with, to a schedule."""


@dataclass(frozen=True)
class Case:
    """Combination of solvers that plans a job."""

    method: str
    """Name in METHODS."""
    redundancy: str
    """Name of the redundancy solver, or of the follower of paths."""
    timing: str
    """Name of the timing solver."""
    blend: str = "lines"
    """Name of the blending, as in `PlanSettings`."""
    named: bool = True
    """Whether the user named the redundancy solver; otherwise it is the robot's default."""

    def on(self, robot: Robot) -> Case:
        """Complete the case with a robot's default solvers."""
        if self.named:
            return self
        return replace(self, redundancy=own_redundancy(self.method, robot))


@dataclass(frozen=True)
class Outcome:
    """Outcome of one case on one job."""

    case: Case
    """The case that planned it."""
    status: Status
    """Whether there is a plan, and whether the verifier passes it."""
    reason: str
    """Why there is none, or what the verifier found; empty for a verified plan."""
    schedule: Schedule | None
    """The plan with its verification, where there is one."""
    planning_time: float | None
    """Wall-clock time of planning [s], the verification and the bound not counted.

    None where nothing was planned.
    """


def cases(
    methods: Sequence[str] = (), redundancies: Sequence[str] = (), timings: Sequence[str] = ()
) -> list[Case]:
    """List all combinations of the named solvers; unnamed families contribute all members.

    If no redundancy solver is named, every method uses the robot's default.

    Args:
        methods: names in METHODS.
        redundancies: names of redundancy solvers.
        timings: names of timing solvers; none for the default one, `all` for every one.

    Raises:
        UnknownSolverError: a name that its family does not have.
    """
    # A name given twice is one.
    methods = [METHODS[name].name for name in dict.fromkeys(methods or METHODS.names)]
    redundancies = [REDUNDANCY_SOLVERS[name].name for name in dict.fromkeys(redundancies)]
    timings = TIMING_SOLVERS.names if "all" in timings else timings or [PlanSettings().timing]
    timings = [TIMING_SOLVERS[name].name for name in dict.fromkeys(timings)]
    if not redundancies:
        return [
            Case(m, PlanSettings().redundancy, t, named=False) for m in methods for t in timings
        ]
    return [Case(m, r, t) for m in methods for r in redundancies for t in timings]


def job_cases(
    job: Job,
    methods: Sequence[str] = (),
    redundancies: Sequence[str] = (),
    timings: Sequence[str] = (),
) -> list[Case]:
    """List the sensible combinations for a job, with its paths and seams.

    A job with paths or seams gets every follower and seam solver with the default method. If it has stops as well, it
    also gets every method with the file's followers, listed as the redundancy solver of its stops. Named solvers are
    combined with each other. If none is named, the default method is also planned with stops at every line end.

    Args:
        job: job to plan.
        methods: names in METHODS.
        redundancies: names of redundancy solvers or path followers.
        timings: names of timing solvers.

    Raises:
        UnknownSolverError: a name that its family does not have.
    """
    for name in redundancies:
        with_redundancy(PlanSettings(), name)
    method = served_settings(PlanSettings(), job.cell.robot)[0].platform
    matrix = _job_cases(job, method, methods, redundancies, timings)
    lines = any(s.approach > 0.0 or s.retract > 0.0 for task in job.tasks for s in task.stops)
    if methods or redundancies or not lines:
        return matrix
    at_rest = [replace(case, blend=STOPPING.name) for case in matrix if case.method == method]
    return matrix + at_rest[:1]


def _job_cases(
    job: Job,
    default: str,
    methods: Sequence[str],
    redundancies: Sequence[str],
    timings: Sequence[str],
) -> list[Case]:
    """List the combinations without line ends at rest, see `job_cases`.

    Args:
        job: what is to be planned.
        default: the default method.
        methods: names in METHODS.
        redundancies: names of redundancy solvers or path followers.
        timings: names of timing solvers.
    """
    if not job.in_sections:
        of_stops = [name for name in redundancies if name in REDUNDANCY_SOLVERS.names]
        matrix = cases(methods, of_stops, timings) if of_stops or not redundancies else []
        others = [name for name in dict.fromkeys(redundancies) if name not in of_stops]
        return matrix + _with_each(others, cases(methods, (), timings))
    if methods or redundancies:
        names = list(dict.fromkeys(redundancies or _solvers(job)))
        return _with_each(names, cases(methods or [default], (), timings))
    matrix = _with_each(_solvers(job), cases([default], (), timings))
    if all(task.alone for task in job.tasks):
        return matrix
    return matrix + [case for case in cases((), (), timings) if case.method != default]


def _solvers(job: Job) -> list[str]:
    """Return the path followers and seam solvers that a job requires."""
    families = [kind.solvers for kind in kinds_of(job) if kind.solvers is not None]
    return [name for solvers in families for name in solvers.names]


def _with_each(names: Sequence[str], every: Sequence[Case]) -> list[Case]:
    return [replace(case, redundancy=name, named=True) for name in names for case in every]


def run_cases(
    job: Job,
    settings: PlanSettings,
    matrix: Sequence[Case],
    judge: Judge,
    clock: Callable[[], float],
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Outcome]:
    """Yield the outcome of each case in turn, so that one plan is kept.

    Args:
        job: the same work for all.
        settings: effort and seed for all.
        matrix: how to plan.
        judge: the verifier.
        clock: wall clock [s].
        progress: receives what is being done.
    """
    every = [case.on(job.cell.robot) for case in matrix]
    for number, case in enumerate(every, start=1):
        name = f"{number}/{len(matrix)} {case.method}, {case.redundancy}, {case.timing}"
        name += "" if case.blend == PlanSettings().blend else f", blend {case.blend}"
        if reason := _why_unserved(job, settings, case):
            yield Outcome(case, "not served", reason, None, None)
            continue
        wanted = replace(
            settings,
            platform=case.method,
            timing=case.timing,
            blend=case.blend,
            named=frozenset({"platform"}),
        )
        if case.redundancy not in REDUNDANCY_SOLVERS.names:
            default = own_redundancy(case.method, job.cell.robot)
            wanted = replace(wanted, redundancy=default)
        wanted = with_redundancy(wanted, case.redundancy)
        progress(f"{name}: planning")
        begin = clock()
        try:
            schedule = plan_without_bound(job, wanted)
        except InfeasibleError as error:
            yield Outcome(case, "infeasible", str(error), None, clock() - begin)
            continue
        except (UnsupportedError, MissingDependencyError) as error:
            yield Outcome(case, "not served", str(error), None, None)
            continue
        taken = clock() - begin
        progress(f"{name}: verifying")
        yield _judged(case, judge(schedule, job), taken)


def _why_unserved(job: Job, settings: PlanSettings, case: Case) -> str | None:
    """Explain why a case cannot run on a job; None if it can."""
    redundancy = case.redundancy
    if redundancy not in REDUNDANCY_SOLVERS.names:
        for kind, solvers in families():
            if redundancy in solvers.names and kind not in kinds_of(job):
                return f"{redundancy} {kind.does}, and the job has none"
        redundancy = own_redundancy(case.method, job.cell.robot)
    model = cell_model(job.cell, redundancy)
    problem = MethodProblem(model, job, redundancy, settings.effort, settings.seed)
    return METHODS[case.method].why_unsupported(problem) or TIMING_SOLVERS[
        case.timing
    ].why_unsupported(job.cell.robot.limits)


def _judged(case: Case, schedule: Schedule, taken: float) -> Outcome:
    """Build the outcome of a verified plan; a failed verification excludes it."""
    verification = schedule.verification
    assert verification is not None  # it has been judged
    if verification.passed:
        return Outcome(case, "verified", "", schedule, taken)
    faults = "; ".join(f"{check.name}: {check.detail}" for check in verification.failures)
    return Outcome(case, "failed", faults or "nothing was checked", schedule, taken)
