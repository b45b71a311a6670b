"""Evaluation of one job: read, plan and verify it; every error becomes a status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dualarm_cli.errors import DualArmError, InfeasibleError, InputError, lacks_memory
from dualarm_cli.evaluation.draws import drawn_job
from dualarm_cli.evaluation.fingerprint import names_of
from dualarm_cli.evaluation.request import Request
from dualarm_cli.exporting.files import URDF
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.files.source.text_source import recorded_reads
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.interface import Plan, planned
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.page.packed import packed_document
from dualarm_cli.page.page_data import page_data
from dualarm_cli.planning.redundancy_choice import with_redundancy
from dualarm_cli.refusals import message
from dualarm_cli.report.comparison.schedule_comparison import Version
from dualarm_cli.report.measures import joint_travel, limiting_times
from dualarm_cli.report.report import relative_gap, smallest_clearance
from dualarm_cli.report.stage_parts import stage_parts
from dualarm_cli.report.torques import has_torques, largest_share
from dualarm_cli.stages.methods import METHODS
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification.budget_checks import judge_budget
from dualarm_cli.verification.varied_cycle import varied_cycle

MAX_FINDINGS = 20
"""Maximum number of reported findings per case."""


def evaluate(request: Request) -> Evaluation:
    """Evaluate a request.

    Raises:
        MemoryError: out of memory, when no message is reliable.
    """
    with recorded_reads() as record:
        try:
            evaluation = _evaluated(request)
        except MemoryError:
            raise
        except InputError as error:
            findings = [Finding(d.message, d.file, d.line, d.column) for d in error.diagnostics]
            evaluation = _failed(request, "bad_input", findings)
        except InfeasibleError as error:
            evaluation = _failed(request, "infeasible", [_located(error, request.case)])
        except DualArmError as error:
            status = "bad_input" if error.exit_code == 2 else "internal_error"
            evaluation = _failed(request, status, [Finding(str(error), request.case)])
        except Exception as error:
            if lacks_memory(error):
                raise MemoryError(str(error)) from None
            text = f"internal error: {type(error).__name__}: {error}; this is a bug"
            evaluation = _failed(request, "internal_error", [Finding(text, request.case)])
    return replace(evaluation, inputs=names_of(record, request.folder))


def settings_of(request: Request) -> PlanSettings:
    """Build the planning settings of a request.

    Raises:
        UnknownSolverError: a named solver does not exist.
    """
    plain = PlanSettings(
        timing=request.timing, blend=request.blend, effort=request.effort, seed=request.seed
    )
    settings = with_redundancy(plain.naming(platform=request.platform), request.redundancy)
    METHODS[settings.platform]
    TIMING_SOLVERS[settings.timing]
    return settings


def _evaluated(request: Request) -> Evaluation:
    job = load_job(request.path, request.case, request.overrides)
    if request.draw:
        job = drawn_job(job, request.draw_seed, request.draw)
    plan = planned(job, settings_of(request))
    evaluation = evaluation_of(request.case, plan, request.page)
    if request.above is not None and (evaluation.cycle_time or 0.0) > request.above:
        text = b"".join(to_json(plan.schedule, URDF, {})).decode()
        evaluation = replace(evaluation, schedule=text)
    if request.draw is None or evaluation.cycle_time is None:
        return evaluation
    varied = varied_cycle(plan.schedule, job)
    stated = {} if varied is None else {"95%": varied.percentile_95, "worst": varied.worst}
    return replace(evaluation, stages=_stage_times(plan.schedule), stated=stated)


def _stage_times(schedule: Schedule) -> dict[str, float]:
    """Collect the length of each stage by its work [s]; the return has an empty name."""
    stages = [Version(schedule, parts) for parts in stage_parts(schedule)]
    return {
        ", ".join(f"{task} {action}" for task, action in sorted(stage.work)): stage.duration
        for stage in stages
    }


def evaluation_of(case: str, plan: Plan, page: bool = False) -> Evaluation:
    """Build the evaluation of a plan: verdict, figures and budget.

    Args:
        case: name of the job.
        plan: the judged plan.
        page: whether to include the data of its page.
    """
    schedule, job = plan.schedule, plan.job
    failures = () if schedule.verification is None else schedule.verification.failures
    nearest: Mapping[str, Any] = smallest_clearance(schedule) or {}
    sliding = schedule.robot.sliding
    turning = tuple(joint for joint in schedule.trajectory.joints if joint not in sliding)
    torque, joint = largest_share(schedule, job) if has_torques(job) else (None, "")
    evaluation = Evaluation(
        case,
        "planned" if plan.verified else "fails_verification",
        cycle_time=float(schedule.duration),
        closes=job.returns,
        lower_bound=_finite(schedule.lower_bound),
        gap=_finite(relative_gap(schedule)),
        clearance=_finite(nearest.get("clearance")),
        required_clearance=_finite(nearest.get("required")),
        travel=float(sum(joint_travel(schedule, turning).values())),
        torque=torque,
        torque_joint=joint,
        limiting=dict(sorted(limiting_times(schedule).items())),
        limits=_limits(schedule.robot.limits),
        sliding=tuple(sorted(sliding.intersection(schedule.robot.limits.joints))),
        budgets=judge_budget(schedule, job),
        caveats=plan.caveats,
        findings=tuple(Finding(f"{check.name}: {check.detail}", case) for check in failures)[
            :MAX_FINDINGS
        ],
    )
    figures = (
        *(evaluation.cycle_time, evaluation.travel, *evaluation.limiting.values()),
        *(line.measured for line in evaluation.budgets),
    )
    if not all(math.isfinite(figure) for figure in figures if figure is not None):
        return Evaluation(
            case, "internal_error", findings=(Finding("a figure is not finite", case),)
        )
    if page:
        data = page_data(schedule, job, plan.report)
        return replace(evaluation, page=packed_document(data))
    return evaluation


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and math.isfinite(value) else None


def _limits(limits: JointLimits) -> dict[str, dict[str, float]]:
    """Collect the finite limits of each joint."""
    return {
        joint: {
            name: value
            for name in ("acceleration", "jerk", "lower", "upper", "velocity")
            if math.isfinite(value := float(getattr(limits, name)[limits.joints.index(joint)]))
        }
        for joint in sorted(limits.joints)
    }


def _failed(request: Request, status: Any, findings: list[Finding]) -> Evaluation:
    more = len(findings) - MAX_FINDINGS
    if more > 0:
        findings = [*findings[:MAX_FINDINGS], Finding(f"... and {more} more", request.case)]
    return Evaluation(request.case, status, findings=tuple(findings))


def _located(error: InfeasibleError, case: str) -> Finding:
    """Locate a finding at the first refusal with a place, else the case."""
    for refusal in error.refusals:
        if refusal.place is not None and refusal.place.file:
            place = refusal.place.file, refusal.place.line, refusal.place.column
            return Finding(message(error.refusals, placed=refusal), *place)
    return Finding(str(error), case)
