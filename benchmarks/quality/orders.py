"""Open orders: the plan of the search against the file's order and nearest neighbours, gaps, and planning time.

python -m benchmarks.quality.orders [--tasks 20 50 100 500] [--seeds 10] [--first 0] [--effort normal]
    [--mode paired|free] [--family spots parts] [--baselines file own nearest] [--blend lines|none]

Everything is planned by the same planner with the same effort, and verified, clearances proven. Where arms touch in a
stage of a baseline's order, so that it has no plan, the stops of that stage are made one after the other instead.
Times are those of the processor; planning is one process here.
"""

from __future__ import annotations

import argparse
import math
import statistics
import time
from collections.abc import Sequence
from dataclasses import replace

from benchmarks.jobs.nearest_neighbour import each_arms_nearest, nearest_neighbour
from benchmarks.jobs.random_orders import FAMILIES, Instance, random_instance
from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.model.job import Job, StopKey
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

MENDED = 12
"""So often the stages of a baseline that collide are taken apart."""
BASELINES = ("file", "own", "nearest")
"""The file's order, each arm's own nearest neighbours, and the nearest stages, which both arms choose together."""


def baseline(instance: Instance, what: str) -> Job:
    """Returns a job in the order of a baseline."""
    if what == "file":
        return instance.given
    return (each_arms_nearest if what == "own" else nearest_neighbour)(instance.job)


def mended_plan(job: Job, settings: PlanSettings) -> tuple[Schedule, int]:
    """Returns the schedule of a decided job, and how many stages were taken apart for it."""
    count = 0
    for _ in range(MENDED):
        try:
            return plan_without_bound(job, settings), count
        except InfeasibleError as error:
            stages = error.stages if isinstance(error, BlockedError) else named_stages(job, error)
            if job.mode == "free" or not stages:
                raise
            pairing = taken_apart(job, stages)
            if len(pairing) == len(job.stages()):
                raise
            count += len(pairing) - len(job.stages())
            job = replace(job, pairing=pairing)
    return plan_without_bound(job, settings), count


def named_stages(job: Job, error: InfeasibleError) -> tuple[int, ...]:
    """Returns the stages of the tasks that an error names."""
    names = {refusal.task for refusal in error.refusals}
    return tuple(
        k
        for k, work in enumerate(job.stages())
        if any(task.id in names for task, _ in work.values())
    )


def taken_apart(job: Job, stages: Sequence[int]) -> tuple[tuple[StopKey, ...], ...]:
    """Returns what is done in each stage when the stops of some stages are made one after the other."""
    found: list[tuple[StopKey, ...]] = []
    for k, work in enumerate(job.stages()):
        keys = tuple((arm, task.id, stop.action) for arm, (task, stop) in work.items())
        found += [(key,) for key in keys] if k in stages else [keys]
    return tuple(found)


def row_of(given: argparse.Namespace, seed: int, tasks: int, family: str) -> dict[str, float]:
    """Durations of all three plans, the gap, and how long everything took; all verified."""
    mode, effort = given.mode, given.effort
    instance = random_instance(seed, tasks, family, mode)
    settings = PlanSettings(effort=effort, blend=given.blend)
    row: dict[str, float] = {}
    # Asynchronous arms have no stages to choose together.
    for what in [*(one for one in given.baselines if mode == "paired" or one != "own"), "search"]:
        begin = time.process_time()
        try:
            if what == "search":
                schedule, apart = plan_without_bound(instance.job, settings), 0
            else:
                schedule, apart = mended_plan(baseline(instance, what), settings)
        except InfeasibleError as error:
            tell(f"{tasks} {family} seed {seed}: {what} has no plan: {str(error)[:150]}")
            row[what] = float("inf")
            continue
        row[f"{what} planning"] = time.process_time() - begin
        row[what], row[f"{what} apart"] = schedule.duration, apart
        begin = time.process_time()
        failures = verify(schedule, instance.job, clearance=True).failures
        row[f"{what} verifying"] = time.process_time() - begin
        if failures:
            tell(f"{tasks} {family} seed {seed}: {what} fails: {failures}")
            row[f"{what} fails"] = 1.0
        if what == "search":
            gap = schedule.order_grid_gap
            row["gap"] = float("nan") if gap is None else gap
    begin = time.process_time()
    row["bound"] = job_bound(instance.job, effort, given.blend).value or 0.0
    row["bounding"] = time.process_time() - begin
    return row


def tell_row(seed: int, row: dict[str, float]) -> None:
    """One instance."""
    none = float("nan")
    known = [one for one in BASELINES if one in row]
    planned = " ".join(f"{row.get(f'{what} planning', none):.1f}" for what in (*known, "search"))
    others = ", ".join(
        f"{what} {row[what]:.3f} s ({row['search'] / row[what]:.3f}, {row.get(f'{what} apart', none):.0f} apart)"
        for what in known
    )
    tell(
        f"seed {seed}: search {row['search']:.3f} s, gap {row.get('gap', none):.1%}; {others};"
        f" planning {planned} + bound {row['bounding']:.1f} + verification {row.get('search verifying', none):.1f} s"
    )


def print_medians(tasks: int, family: str, rows: list[dict[str, float]]) -> None:
    """Prints medians over the seeds."""

    def median(values: list[float], shown: str) -> str:
        return format(statistics.median(values), shown) if values else ""

    ratios = (
        [row["search"] / row[what] for row in rows if math.isfinite(row.get(what, math.inf))]
        for what in BASELINES
    )
    gaps = [row["gap"] for row in rows if row.get("gap", float("nan")) >= 0.0]
    planning = [row["search planning"] for row in rows if "search planning" in row]
    cells = *(median(ratio, ".2f") for ratio in ratios), median(gaps, ".1%")
    print_row(tasks, family, len(rows), *cells, f"{median(planning, '.0f')} s")


def main() -> None:
    """Runs the study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--tasks", type=int, nargs="+", default=[20, 50, 100, 500])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--effort", default="normal")
    parser.add_argument("--mode", choices=["paired", "free"], default="paired")
    parser.add_argument("--baselines", choices=BASELINES, nargs="*", default=list(BASELINES))
    parser.add_argument("--blend", choices=["lines", "none"], default="lines")
    parser.add_argument("--family", choices=FAMILIES, nargs="+", default=list(FAMILIES))
    arguments = parser.parse_args()
    against = "cycle / file's order", "/ nearest stop", "/ nearest stage"
    print_head("stops", "family", "jobs", *against, "above the bound on its grid", "planned in")
    for family in arguments.family:
        for tasks in arguments.tasks:
            rows = []
            for seed in range(arguments.first, arguments.first + arguments.seeds):
                rows.append(row_of(arguments, seed, tasks, family))
                tell_row(seed, rows[-1])
            print_medians(tasks, family, rows)


if __name__ == "__main__":
    main()
