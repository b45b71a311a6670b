"""Plans of drawn poses and dwells: distribution of the cycle time, failures, stages that react.

Every draw is re-planned, as by a robot that measures where parts lie. The share of a stage is its covariance with
the cycle time in parts of the variance: of synchronous stages, whose lengths add up, the shares add up to 1.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from dualarm_cli import __version__
from dualarm_cli.background import usable_cores
from dualarm_cli.errors import UsageError, check_type
from dualarm_cli.evaluation import crew
from dualarm_cli.evaluation.answers import Run, answers
from dualarm_cli.evaluation.draws import count_varying
from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import Effort, check_count, check_effort, check_seed
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.report import comparisons as members
from dualarm_cli.studies.document import failure_groups
from dualarm_cli.studies.rows import StudyRow


def perturb(
    tasks: str | Path,
    draws: int = 200,
    *,
    seed: int = 0,
    effort: Effort = "normal",
    processes: int | None = None,
    cache: str | Path | None = None,
) -> members.PerturbationReport:
    """Plan draws of what varies in a job, as `dualarm sweep --perturb --json`.

    Args:
        tasks: the task file, or the name of a bundled job.
        draws: number of draws.
        seed: seed of the draws.
        effort: of each plan, as of `plan`.
        processes: maximum number of processes; None for one per core.
        cache: folder of finished plans, which are not planned again; None for none.

    Raises:
        InputError: all faults of the files.
        UsageError: nothing varies, or a value that is not allowed.
    """
    check_type("tasks", tasks, str, PathLike)
    check_effort(effort)
    check_seed(seed)
    check_count("draws", draws)
    check_count("processes", processes)
    base, job = Request.of(tasks, effort=effort, draw_seed=seed), load_job(tasks)
    with closing(crew.Crew(processes or usable_cores())) as workers:
        store = None if cache is None else Store(Path(cache))
        return perturbation(base, job, draws, workers.run, store)


def perturbation(
    base: Request,
    job: Job,
    draws: int,
    run: Run,
    store: Store | None,
    tell: Callable[[int, int], None] = lambda done, cached: None,
) -> members.PerturbationReport:
    """Plan a job and draws of what varies in it, and compose the document.

    Args:
        base: request of the job.
        job: the job.
        draws: number of draws.
        run: runner of requests that the store lacks.
        store: store of earlier evaluations, or None.
        tell: callback, called with the numbers of finished and of cached plans.
    """
    varying = count_varying(job)
    if not any(varying.values()):
        raise UsageError(
            f"{base.case}: nothing varies; give targets or frames `varies`, or a dwell its least, nominal and "
            "greatest time"
        )
    requests = [replace(base, draw=number) for number in range(draws + 1)]
    plans: dict[int, Evaluation] = {}
    cached = 0
    for answer in answers(requests, run, store):
        plans[answer.index] = answer.evaluation
        cached += answer.from_store
        tell(len(plans), cached)
    nominal, rows = plans[0], [StudyRow(k, (), (plans[k],)) for k in range(1, draws + 1)]
    planned = [row.evaluations[0] for row in rows if row.is_planned]
    failed = [row for row in rows if not row.is_planned]
    reasons = {row.number: [*map(str, row.evaluations[0].findings)] for row in failed}
    counts = {"draws": draws, "planned": len(planned)}
    for row in failed:
        counts[row.status] = counts.get(row.status, 0) + 1
    return {
        "format": "dualarm.perturbation/1",
        "version": __version__,
        "tasks": base.case,
        "settings": {"effort": base.effort, "seed": base.draw_seed},
        "varying": varying,
        "counts": counts,
        "nominal": nominal.cycle_time,
        "stated": dict(nominal.stated),
        "cycle_time": _distribution([plan.cycle_time or 0.0 for plan in planned]),
        "stages": _stages(nominal, planned),
        "failures": failure_groups(failed, reasons),
        "rows": [
            {
                "draw": row.number,
                "status": row.status,
                "cycle_time": row.figures["cycle_time"],
                "clearance": row.figures["clearance"],
                "stages": dict(row.evaluations[0].stages),
                "reasons": reasons.get(row.number, []),
            }
            for row in rows
        ],
        "inputs": dict(job.inputs),
    }


def _distribution(times: Sequence[float]) -> members.Distribution | None:
    """Compute least, median, 95 % and worst of times [s]; None without any."""
    if not times:
        return None
    # A stated share of the times does not exceed a percentile.
    median, most = np.percentile(times, [50.0, 95.0], method="inverted_cdf")
    return {
        "least": min(times),
        "median": float(median),
        "percentile_95": float(most),
        "worst": max(times),
    }


def _stages(nominal: Evaluation, planned: Sequence[Evaluation]) -> list[members.ReactingStage]:
    """List the stages of all plans, the one with the largest share of the variance first."""
    cycles = np.array([plan.cycle_time or 0.0 for plan in planned])
    variance = float(np.var(cycles)) if planned else 0.0
    stages: list[members.ReactingStage] = []
    for work in dict.fromkeys(work for plan in planned for work in plan.stages):
        # A stage that a plan lacks takes no time in it.
        times: FloatArray = np.array([plan.stages.get(work, 0.0) for plan in planned])
        spread = _distribution([plan.stages[work] for plan in planned if work in plan.stages])
        assert spread is not None  # some plan has the stage
        covariance = float(np.mean((times - times.mean()) * (cycles - cycles.mean())))
        share = covariance / variance if variance > 0.0 else None
        stages.append(
            {"work": work, "nominal": nominal.stages.get(work), "share": share, "time": spread}
        )
    return sorted(stages, key=lambda stage: (-round(stage["share"] or 0.0, 9), stage["work"]))
