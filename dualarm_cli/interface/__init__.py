"""Python interface: read, plan, verify and compare jobs. The commands use these functions."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from numbers import Real
from os import PathLike
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, TypedDict, Unpack, cast, get_args

from dualarm_cli.background import BackgroundCall, run_both
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import UsageError, check_type
from dualarm_cli.exporting.cell_urdf import cell_urdf
from dualarm_cli.exporting.files import REPORT, write_schedule_set
from dualarm_cli.exporting.schedule_reader import read_schedule, torn_files
from dualarm_cli.exporting.whole_files import replace_all
from dualarm_cli.formats import export
from dualarm_cli.formats.request import COLUMNS, Column, ExportRequest, check_rate, columns_named
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import Blend, Effort, PlanSettings, Timing, check_effort, check_seed
from dualarm_cli.model.verification import Check, Verification
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning import planner
from dualarm_cli.planning.redundancy_choice import with_redundancy
from dualarm_cli.records import ShownInNotebooks, dataclass
from dualarm_cli.report.document import Report
from dualarm_cli.report.printable import PrintedComparison, printable
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify as judged
from dualarm_cli.verification.budget_checks import judge_budget
from dualarm_cli.verification.measuring.criteria import criterion, judge
from dualarm_cli.verification.robot_checks import check_robot

if TYPE_CHECKING:
    from collections.abc import Iterable

    from dualarm_cli.planning.comparison import Case, Outcome
    from dualarm_cli.report.comparisons import ScheduleComparison, SolverComparison

PAGE = "report.html"
"""File name of a schedule's page."""
RATE = 250.0
"""Default sampling rate of schedule.csv [Hz]."""

Progress = Callable[[str], None]
"""Callback for progress messages."""


@dataclass(frozen=True, eq=False)
class Plan(ShownInNotebooks):
    """Planned job with its schedule, verified independently. It equals only itself."""

    job: Job
    """Job that was planned."""
    schedule: Schedule
    """Joint motion, stages and events, with the verification."""

    def __repr__(self) -> str:
        """Describe the plan in a line."""
        return repr(self.schedule).replace("Schedule", "Plan", 1)

    @classmethod
    def judged(cls, job: Job, schedule: Schedule) -> Plan:
        """Verify a schedule, with a proof of clearance, as the plan of a job."""
        verification = judged(schedule, job, clearance=True, both=run_both)
        return cls(job, replace(schedule, verification=verification))

    @property
    def cycle_time(self) -> float:
        """Cycle time: duration of the motion [s], its period for a closed cycle."""
        return float(self.schedule.duration)

    @property
    def verification(self) -> Verification:
        """Findings of the verifier, without checks for a schedule that was not verified."""
        return self.schedule.verification or Verification(())

    @property
    def verified(self) -> bool:
        """Flag of a plan that passed verification."""
        return self.verification.passed

    @property
    def caveats(self) -> tuple[str, ...]:
        """Sentences on gaps of the verification, such as tools without shapes."""
        return self.verification.caveats

    @property
    def keeps_budget(self) -> bool:
        """Flag of a plan within the task file's budget, or without a budget."""
        return all(line.kept for line in judge_budget(self.schedule, self.job))

    @cached_property
    def report(self) -> Report:
        """Content of `report.json`, JSON-ready, in SI units; a dict whose members have types."""
        return build_report(self.schedule, self.job)

    def write(
        self,
        folder: str | Path,
        *,
        rate: float = RATE,
        columns: Sequence[Column] = COLUMNS,
        page: bool = True,
        force: bool = False,
    ) -> Path:
        """Write the files of `dualarm plan`, each atomically; returns the folder.

        These are schedule.json; schedule.csv, events.csv, targets.csv; report.json; the cell as robot.urdf with its
        meshes.

        Args:
            folder: folder, created if missing.
            rate: samples per second of schedule.csv [Hz].
            columns: columns of schedule.csv for each joint: position, velocity, acceleration.
            page: whether report.html, the animated page, is written.
            force: whether files of an earlier plan are replaced.

        Raises:
            UsageError: unknown column, or a rate that is not allowed.
            OutputError: files exist already, or cannot be written.
            PageNotBuiltError: this installation has no code of the page; all other files are written.
        """
        folder = Path(folder)
        check_rate(rate)
        request = ExportRequest(self.schedule, self.job, rate, columns=columns_named(columns))
        if not page:
            self._write_set(folder, request, force)
            return folder
        with BackgroundCall(self._shown) as shown:
            self._write_set(folder, request, force)
            replace_all(folder, {PAGE: [self._page(shown.result())]})
        return folder

    def _write_set(self, folder: Path, request: ExportRequest, force: bool) -> None:
        """Write all files except the page; see `write`."""
        text = json.dumps(self.report, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
        cell = cell_urdf(self.job.cell)
        shown = replace(self.schedule, robot=replace(self.schedule.robot, urdf=cell.text))
        others = {REPORT: [text.encode()], **export("csv", request)}
        others |= {name: [mesh] for name, mesh in cell.meshes.items()}
        write_schedule_set(folder, shown, others, force)

    def write_page(self, folder: str | Path) -> Path:
        """Write the animated page into a folder; returns its path.

        Raises:
            OutputError: the page cannot be written.
            PageNotBuiltError: this installation has no code of the page.
        """
        from dualarm_cli.page.what_helps import kept_levers

        shown = self._shown()
        if (levers := kept_levers(Path(folder), shown["pieces"])) is not None:
            shown["levers"] = levers
        replace_all(Path(folder), {PAGE: [self._page(shown)]})
        return Path(folder) / PAGE

    def _shown(self) -> dict[str, Any]:
        """Compute the page's data apart from the report."""
        from dualarm_cli.page.page_data import without_report

        return without_report(self.schedule, self.job)

    def _page(self, shown: Mapping[str, Any]) -> bytes:
        """Render report.html.

        Args:
            shown: data of the page apart from the report.

        Raises:
            PageNotBuiltError: this installation has no code of the page.
        """
        from dualarm_cli.page.page import page_html

        return page_html({**shown, "report": self.report})


def load(tasks: str | Path | Mapping[str, Any], changes: Mapping[str, Any] | None = None) -> Job:
    """Read the job of a task file, with its cell and robot.

    Args:
        tasks: the task file, the name of a bundled job such as `04_packing`, or the content of a task file as a
            mapping. In a mapping `cell` may be the content of a cell file, and paths are relative to the working
            directory.
        changes: values that replace those in the files, in the files' notation, by the file's role and a JSON
            pointer, such as `tasks:/tasks/tray-1/pick/xyz`, `cell:/clearance` or `robot:/limits/torso_b1/velocity`.
            Entries of lists are named by id, name or index.

    Raises:
        InputError: all faults of the files, with file, line and column (`diagnostics`).
        UsageError: an argument of a wrong type.
    """
    check_type("tasks", tasks, str, PathLike, Mapping)
    if changes is not None:
        check_type("changes", changes, Mapping)
        for pointer in changes:
            check_type("pointer", pointer, str)
    # Not imported by a process that plans a job read by another process.
    from dualarm_cli.files.tasks.tasks import load_job

    return load_job(tasks, overrides=changes)


class PlanOptions(TypedDict, total=False):
    """Options of `plan`."""

    platform: str | None
    redundancy: str | None
    timing: Timing
    blend: Blend
    effort: Effort
    seed: int
    time_limit: float | None


def plan(
    job: Job,
    *,
    platform: str | None = None,
    redundancy: str | None = None,
    timing: Timing = "ruckig",
    blend: Blend = "lines",
    effort: Effort = "normal",
    seed: int = 0,
    time_limit: float | None = None,
    progress: Progress | None = None,
) -> Plan:
    """Plan a job and verify the plan, including a proof of clearance.

    A plan that fails verification is returned as well: check `Plan.verified`.

    Args:
        job: the job.
        platform: method that chooses platform angles and postures; None for the default.
        redundancy: redundancy solver, or method of paths or seams; None for the one that fits the robot.
        timing: timing solver: ruckig, toppra or trapezoid.
        blend: `lines`, or `none` for stops at both ends of all lines.
        effort: quick, normal or thorough.
        seed: random seed.
        time_limit: maximum time of the search for orders [s]; None for no limit.
        progress: callback for progress messages.

    Raises:
        InfeasibleError: no plan exists or was found; it names the tasks and the reasons.
        UnknownSolverError: unknown method or solver.
        UnsupportedError: method or solver that does not support this robot.
        UsageError: any other value that is not allowed.
    """
    check_type("job", job, Job)
    settings = plan_settings(
        platform=platform,
        redundancy=redundancy,
        timing=timing,
        blend=blend,
        effort=effort,
        seed=seed,
        time_limit=time_limit,
    )
    return planned(job, settings, Watch(progress or (lambda _: None), time_limit))


def plan_settings(**options: Unpack[PlanOptions]) -> PlanSettings:
    """Build the settings of a plan from the options of `plan`.

    Raises:
        UnknownSolverError: unknown redundancy solver.
        UsageError: any other value that is not allowed.
    """
    for name in sorted(options.keys() - PlanOptions.__annotations__.keys()):
        raise UsageError(f"{name}: is no option; use {', '.join(PlanOptions.__annotations__)}")
    values: dict[str, Any] = {**options}
    platform, redundancy = values.pop("platform", None), values.pop("redundancy", None)
    settings = PlanSettings(**values)
    if settings.blend not in get_args(Blend):
        blends = ", ".join(get_args(Blend))
        raise UsageError(f"blend {settings.blend!r}: choose one of {blends}")
    check_effort(settings.effort)
    limit = settings.time_limit
    if limit is not None and not (isinstance(limit, Real) and 0.0 < limit < math.inf):
        raise UsageError(f"time_limit {limit!r}: must be above 0 s, and finite")
    check_seed(settings.seed)
    return with_redundancy(settings.naming(platform=platform), redundancy)


def planned(job: Job, settings: PlanSettings, watch: Watch | None = None) -> Plan:
    """Plan a job with settings; see `plan`.

    Args:
        job: the job.
        settings: settings of the plan.
        watch: observer of the search that may end it.
    """
    watch = watch or Watch(limit=settings.time_limit)
    schedule = planner.plan(job, settings, watch)
    watch.report("verifying")
    return Plan.judged(job, schedule)


def verify(
    schedule: Schedule | Plan | str | Path, job: Job | None = None, *, clearance: bool = True
) -> Verification:
    """Verify a schedule independently, with its budget and files, if any.

    Args:
        schedule: schedule, plan, or path of a plan's folder or schedule file.
        job: cell and tasks; without it targets, order and clearance are not checked. A `Plan` brings its own.
        clearance: whether to prove that the whole motion is collision-free.

    Raises:
        InputError: the file cannot be read.
        UsageError: an argument of a wrong type.
    """
    if isinstance(schedule, Plan) and job is None:
        job = schedule.job
    read = schedule_of(schedule, "schedule", job)
    result = judged(read, job, clearance=clearance and job is not None, both=run_both)
    files = _file_checks(Path(schedule), read, job) if isinstance(schedule, str | Path) else ()
    return replace(result, checks=(*result.checks, *_budget_checks(read, job, result), *files))


def compare(
    before: Schedule | Plan | str | Path,
    after: Schedule | Plan | str | Path,
    names: tuple[str, str] = ("A", "B"),
) -> ScheduleComparison:
    """Compare two plans stage by stage, as `dualarm compare schedules --json` [s, rad, m].

    `print` shows the table of the command.

    Args:
        before: schedule, plan, or path of a plan's folder or schedule file.
        after: the same kinds of values.
        names: names of both plans.

    Raises:
        InputError: a file cannot be read.
        UsageError: unusable schedules, or schedules without common work.
    """
    from dualarm_cli.report.comparison.schedule_comparison import compare_schedules
    from dualarm_cli.report.comparison.schedule_comparison_table import schedules_sentence

    first, second = schedule_of(before, "before"), schedule_of(after, "after")
    document = compare_schedules(first, second, names)
    document["sentence"] = schedules_sentence(document)
    return cast("ScheduleComparison", PrintedComparison(printable(document)))


def schedule_of(
    given: Schedule | Plan | str | Path, argument: str, job: Job | None = None
) -> Schedule:
    """Return the schedule of a plan or schedule, or read it from a path.

    Args:
        given: schedule, plan, or path of a plan's folder or schedule file.
        argument: name of the Python argument.
        job: cell and tasks that belong to it, or None.

    Raises:
        InputError: the file cannot be read.
        UsageError: a value of a wrong type.
    """
    check_type(argument, given, Schedule, Plan, str, PathLike)
    if job is not None:
        check_type("job", job, Job)
    if isinstance(given, Plan):
        return given.schedule
    return given if isinstance(given, Schedule) else read_schedule(Path(given))


Kept = Callable[[str, Job, "Iterator[Outcome]"], "Iterator[Outcome]"]
"""Filter that passes on a job's outcomes and may store them."""


def compare_solvers(
    jobs: Job | Mapping[str, Job],
    *,
    cases: Mapping[str, Sequence[Case]] | None = None,
    effort: Effort = "normal",
    seed: int = 0,
    progress: Progress | None = None,
    kept: Kept | None = None,
) -> SolverComparison:
    """Compare methods on jobs, as `dualarm compare solvers --json` [SI units].

    `print` shows the table of the command.

    Args:
        jobs: a job, or several by name.
        cases: cases by the jobs' names; None for all that apply.
        effort: quick, normal or thorough.
        seed: random seed.
        progress: callback for progress messages.
        kept: receives each outcome with its plan; otherwise a single plan is held at a time.
    """
    from dualarm_cli.planning.comparison import job_cases, run_cases
    from dualarm_cli.report.comparison.comparison import comparison_document, job_comparison

    jobs = jobs if isinstance(jobs, Mapping) else {"job": jobs}
    settings = plan_settings(effort=effort, seed=seed)
    sections: list[dict[str, Any]] = []
    clock: list[dict[str, Any]] = []
    for name, job in jobs.items():
        check_type("job", job, Job)

        def say(text: str, name: str = name) -> None:
            if progress is not None:
                progress(f"{name}: {text}")

        say("lower bound")
        bound = job_bound(job, effort, settings.blend)
        # If a stop is out of reach, every row says so and an infinite bound is useless.
        least = bound.value if bound.value and math.isfinite(bound.value) else None
        matrix = job_cases(job) if cases is None else cases[name]

        def judge(schedule: Schedule, job: Job, least: float | None = least) -> Schedule:
            bounded = replace(schedule, lower_bound=least)
            return replace(bounded, verification=judged(bounded, job, clearance=True))

        outcomes = run_cases(job, settings, matrix, judge, perf_counter, say)
        if kept is not None:
            outcomes = kept(name, job, outcomes)
        section, timed = job_comparison(name, job, outcomes, least, bound.assumptions)
        sections.append(section)
        clock.extend(timed)
    document = comparison_document(sections, clock, {"effort": effort, "seed": seed})
    return cast("SolverComparison", PrintedComparison(printable(document)))


def _budget_checks(schedule: Schedule, job: Job | None, result: Verification) -> Iterable[Check]:
    """Yield checks of the task file's budget, if the schedule's numbers are usable."""
    usable = all(check.name not in ("finite", "time") for check in result.failures)
    if job is None or job.budget is None or not usable:
        return
    for line in judge_budget(replace(schedule, verification=result), job):
        proven = line.measured is not None
        verdict: Any = "passed" if line.kept else "failed" if proven else "not checked"
        name = f"budget_{line.name}"
        unit = criterion(name).unit
        yield Check(name, verdict, line.measured, line.allowed, unit, str(line))


def _file_checks(path: Path, schedule: Schedule, job: Job | None) -> Iterable[Check]:
    """Yield checks of a file's robot, length and source files."""
    yield check_robot(schedule, job)
    stated = schedule.extra.get("duration")
    if isinstance(stated, int | float):
        difference = abs(float(stated) - schedule.duration)
        detail = f"stated {stated:g} s, trajectory {schedule.duration:g} s"
        yield judge("duration", difference, SAME_TIME, detail)
    if "files" in schedule.extra:
        torn = torn_files(path, schedule)
        yield judge("files", len(torn), 0, "; ".join(torn) or "as written")
