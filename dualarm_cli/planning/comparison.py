"""The same work by every method: which runs there are, and what comes of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from dualarm_cli.errors import InfeasibleError, MissingDependencyError, UnsupportedError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.verification import Verification
from dualarm_cli.path_following import PATH_SOLVERS
from dualarm_cli.planning.method import MethodProblem
from dualarm_cli.planning.methods import METHODS
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.planning.redundancy_choice import with_redundancy
from dualarm_cli.redundancy import REDUNDANCY_SOLVERS
from dualarm_cli.timing import TIMING_SOLVERS

Status = Literal["verified", "failed", "infeasible", "not served"]
Judge = Callable[[Schedule, Job], Verification]


@dataclass(frozen=True)
class Case:
    """One way to plan."""

    method: str
    """Name in METHODS."""
    redundancy: str
    """Name of the redundancy solver, or of the follower of paths."""
    timing: str
    """Name of the timing solver."""


@dataclass(frozen=True)
class Outcome:
    """What came of one case on one job."""

    case: Case
    """How it was planned."""
    status: Status
    """Whether there is a plan, and whether the verifier passes it."""
    reason: str
    """Why there is none, or what the verifier found; empty for a verified plan."""
    schedule: Schedule | None
    """The plan with its verification, where there is one."""
    planning_time: float | None
    """Wall-clock time of planning [s], the verification and the bound not counted; None where nothing was planned."""


def cases(
    methods: Sequence[str] = (), redundancies: Sequence[str] = (), timings: Sequence[str] = ()
) -> list[Case]:
    """Returns every combination of the named solvers, or of all of a family where none is named.

    Args:
        methods: names in METHODS.
        redundancies: names of redundancy solvers.
        timings: names of timing solvers; none for the default one, `all` for every one.

    Raises:
        UnknownSolverError: a name that its family does not have.
    """
    # A name given twice is one.
    methods = [METHODS[name].name for name in dict.fromkeys(methods or METHODS.names)]
    redundancies = [
        REDUNDANCY_SOLVERS[name].name
        for name in dict.fromkeys(redundancies or REDUNDANCY_SOLVERS.names)
    ]
    timings = TIMING_SOLVERS.names if "all" in timings else timings or [PlanSettings().timing]
    timings = [TIMING_SOLVERS[name].name for name in dict.fromkeys(timings)]
    return [Case(m, r, t) for m in methods for r in redundancies for t in timings]


def job_cases(
    job: Job,
    methods: Sequence[str] = (),
    redundancies: Sequence[str] = (),
    timings: Sequence[str] = (),
) -> list[Case]:
    """Returns the combinations that make sense for a job; see `cases` for one without paths.

    Of a job with paths every follower with the default method and, where it has stops as well, every method with the
    file's followers (written as the redundancy solver of its stops). What is named is taken in all combinations.

    Args:
        job: what is to be planned.
        methods: names in METHODS.
        redundancies: names of redundancy solvers or path followers.
        timings: names of timing solvers.

    Raises:
        UnknownSolverError: a name that its family does not have.
    """
    for name in redundancies:
        with_redundancy(PlanSettings(), name)
    own = [name for name in redundancies if name in REDUNDANCY_SOLVERS.names]
    if not job.has_paths:
        found = cases(methods, own, timings) if own or not redundancies else []
        others = [name for name in dict.fromkeys(redundancies) if name not in own]
        return found + [
            replace(case, redundancy=name)
            for name in others
            for case in cases(methods, (), timings)
        ]
    if methods or redundancies:
        every = cases(methods or [PlanSettings().platform], (), timings)
        names = [*dict.fromkeys(redundancies or PATH_SOLVERS.names)]
        return [replace(case, redundancy=name) for case in every for name in names]
    default = cases([PlanSettings().platform], (), timings)
    found = [replace(case, redundancy=name) for case in default for name in PATH_SOLVERS.names]
    if all(task.path is not None for task in job.tasks):
        return found
    return found + [
        case for case in cases((), (), timings) if case.method != PlanSettings().platform
    ]


def run_cases(
    job: Job,
    settings: PlanSettings,
    matrix: Sequence[Case],
    bound: float | None,
    judge: Judge,
    clock: Callable[[], float],
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Outcome]:
    """Yields what comes of each case, one after the other, so that no more than one plan need be kept.

    Args:
        job: the same work for all.
        settings: effort and seed for all.
        matrix: how to plan.
        bound: lower bound that every plan is held against [s], or None.
        judge: the verifier.
        clock: wall clock [s].
        progress: is told what is being done.
    """
    model = CellModel.from_cell(job.cell)
    for number, case in enumerate(matrix, start=1):
        name = f"{number}/{len(matrix)} {case.method}, {case.redundancy}, {case.timing}"
        if reason := _why_unserved(model, job, settings, case):
            yield Outcome(case, "not served", reason, None, None)
            continue
        wanted = replace(settings, platform=case.method, timing=case.timing)
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
        yield _judged(case, replace(schedule, lower_bound=bound), job, judge, taken)


def _why_unserved(model: CellModel, job: Job, settings: PlanSettings, case: Case) -> str | None:
    """Returns why a case cannot be run on a job, or None."""
    if case.redundancy not in REDUNDANCY_SOLVERS.names and not job.has_paths:
        return f"{case.redundancy} follows paths, and the job has none"
    redundancy = with_redundancy(settings, case.redundancy).redundancy
    problem = MethodProblem(model, job, redundancy, settings.effort, settings.seed)
    return METHODS[case.method].why_unsupported(problem) or TIMING_SOLVERS[
        case.timing
    ].why_unsupported(job.cell.robot.limits)


def _judged(case: Case, schedule: Schedule, job: Job, judge: Judge, taken: float) -> Outcome:
    """Returns the outcome of a plan: it counts only if the verifier passes it."""
    verification = judge(schedule, job)
    schedule = replace(schedule, verification=verification)
    if verification.passed:
        return Outcome(case, "verified", "", schedule, taken)
    faults = "; ".join(f"{check.name}: {check.detail}" for check in verification.failures)
    return Outcome(case, "failed", faults or "nothing was checked", schedule, taken)
