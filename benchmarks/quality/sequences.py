"""Whole sequences: the default plan against simpler methods, its gaps, and how planning time grows.

python -m benchmarks.quality.sequences ratios [--sequences 20] [--effort normal]
python -m benchmarks.quality.sequences shipped
python -m benchmarks.quality.sequences growth [--stages 24 100 1000]
"""

from __future__ import annotations

import argparse
import resource
import statistics
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.jobs.random_jobs import random_job
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

TASKS = Path(__file__).parents[2] / "tasks"
SIMPLER = ("fixed", "exact", "linearised", "minimum_time")
STUDIES = {
    "transfers alone, no jerk limit": {"lines": False, "jerk": False},
    "transfers alone, preset's jerk": {"lines": False, "jerk": True},
    "whole cycle, preset's jerk": {"lines": True, "jerk": True},
}


def times(job: Job, effort: str) -> dict[str, float]:
    """Cycle time of every method, the default's gaps, and how long it took to plan; all verified."""
    row = {}
    for method in ("sequence", *SIMPLER):
        begin = time.perf_counter()
        try:
            schedule = plan_without_bound(
                job, PlanSettings(platform=method, effort=effort), check_collisions=False
            )
        except InfeasibleError:
            row[method] = float("inf")
            continue
        if method == "sequence":
            row["planning"] = time.perf_counter() - begin
            row["grid gap"] = schedule.grid_gap or 0.0
        failures = verify(schedule, job).failures
        if failures:
            raise SystemExit(f"{method}: {failures}")
        row[method] = schedule.duration
    begin = time.perf_counter()
    row["bound"] = job_bound(job, effort).value
    row["bounding"] = time.perf_counter() - begin
    return row


def print_rows(name: str, rows: list[dict[str, float]]) -> None:
    """Medians over the sequences, and the worst case of what must never happen."""
    print(f"\n{name}: {len(rows)} sequences")
    for method in SIMPLER:
        ratios = [row["sequence"] / row[method] for row in rows]
        print(
            f"  sequence / {method:12s} median {statistics.median(ratios):.3f}   "
            f"worst {max(ratios):.3f}   best {min(ratios):.3f}"
        )
    gaps = [row["grid gap"] for row in rows]
    bounds = [1.0 - row["bound"] / row["sequence"] for row in rows]
    print(
        f"  gap to the grid's bound  median {statistics.median(gaps):.4f}   worst {max(gaps):.4f}"
    )
    print(
        f"  gap to the lower bound   median {statistics.median(bounds):.4f}   worst {max(bounds):.4f}"
    )
    planning = [row["planning"] + row["bounding"] for row in rows]
    print(
        f"  planning with bound      median {statistics.median(planning):.2f} s   worst {max(planning):.2f} s"
    )
    slower = sum(row["sequence"] > min(row[m] for m in SIMPLER) + 1e-9 for row in rows)
    above = sum(row["bound"] > min(row[m] for m in ("sequence", *SIMPLER)) for row in rows)
    print(f"  slower than a simpler method: {slower}; bound above a plan: {above}")


def ratios(sequences: int, effort: str) -> None:
    """Random sequences, half of them with free yaw."""
    for name, options in STUDIES.items():
        rows = [
            times(random_job(seed, free_yaw=seed % 2 == 1, **options), effort)
            for seed in range(sequences)
        ]
        print_rows(name, rows)


def shipped(effort: str) -> None:
    """The shipped tasks, one by one."""
    for folder in sorted(TASKS.iterdir()):
        job = load_job(folder / "tasks.yaml")
        row = times_that_serve(job, effort)
        print(f"{folder.name}: " + ", ".join(f"{name} {value:.3f}" for name, value in row.items()))


def times_that_serve(job: Job, effort: str) -> dict[str, float]:
    """Cycle times of the methods that serve a robot."""
    from dualarm_cli.errors import UnsupportedError

    row = {}
    for method in ("sequence", *SIMPLER):
        try:
            schedule = plan_without_bound(
                job, PlanSettings(platform=method, effort=effort), check_collisions=False
            )
        except UnsupportedError:
            continue
        row[method] = schedule.duration
    return row | {"bound": job_bound(job, effort).value}


def growth(stages: list[int], effort: str) -> None:
    """Planning time and memory by number of stages; the default method with the bound."""
    plan_without_bound(
        random_job(0, 2, free_yaw=False, lines=True),
        PlanSettings(effort=effort),
        check_collisions=False,
    )
    for count in stages:
        job = repeated(random_job(0, 24, free_yaw=False, lines=True), count)
        begin = time.perf_counter()
        schedule = plan_without_bound(job, PlanSettings(effort=effort), check_collisions=False)
        middle = time.perf_counter()
        bound = job_bound(job, effort).value
        end = time.perf_counter()
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
        schedule = replace(schedule, lower_bound=bound)
        print(
            f"{count:5d} stages: {middle - begin:7.2f} s + bound {end - middle:6.2f} s, "
            f"{(end - begin) / count * 1e3:6.1f} ms per stage, cycle {schedule.duration:8.2f} s, "
            f"peak {memory:.2f} GiB"
        )


def repeated(job: Job, stages: int) -> Job:
    """The first stages of a job over and over: any number of them, all feasible."""
    tasks = []
    for arm in ("left", "right"):
        own = [task for task in job.tasks if task.arm == arm]
        tasks += [replace(own[k % len(own)], id=f"{arm}-{k}") for k in range(stages)]
    return replace(job, tasks=tuple(tasks))


def main() -> None:
    """Runs one study."""
    parser = argparse.ArgumentParser()
    parser.add_argument("study", choices=["ratios", "shipped", "growth"])
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--effort", default="normal")
    parser.add_argument("--stages", type=int, nargs="+", default=[24, 100, 1000])
    arguments = parser.parse_args()
    if arguments.study == "ratios":
        ratios(arguments.sequences, arguments.effort)
    elif arguments.study == "shipped":
        shipped(arguments.effort)
    else:
        growth(arguments.stages, arguments.effort)


if __name__ == "__main__":
    main()
