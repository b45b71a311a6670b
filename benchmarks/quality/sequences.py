"""Whole sequences: the default plan against simpler methods, without collision checking.

python -m benchmarks.quality.sequences [--sequences 20] [--effort normal]
"""

from __future__ import annotations

import argparse
import statistics

from benchmarks.jobs.random_jobs import random_job
from benchmarks.tables import print_head, print_row
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

SIMPLER = ("fixed", "exact", "linearised", "minimum_time")
STUDIES = {
    "transfers alone, no jerk limit": {"lines": False, "jerk": False},
    "transfers alone, preset's jerk": {"lines": False, "jerk": True},
    "whole cycle, preset's jerk": {"lines": True, "jerk": True},
}


def times(job: Job, effort: str) -> dict[str, float]:
    """Returns the cycle time of every method [s], verified, and the lower bound."""
    row = {}
    for method in ("sequence", *SIMPLER):
        try:
            schedule = plan_without_bound(
                job, PlanSettings(platform=method, effort=effort), check_collisions=False
            )
        except InfeasibleError:
            row[method] = float("inf")
            continue
        failures = verify(schedule, job).failures
        if failures:
            raise SystemExit(f"{method}: {failures}")
        row[method] = schedule.duration
    row["bound"] = job_bound(job, effort, "lines").value
    return row


def print_rows(name: str, rows: list[dict[str, float]]) -> None:
    """Prints medians over the sequences.

    Raises:
        AssertionError: a bound is above a plan.
    """
    assert all(row["bound"] <= min(row[m] for m in ("sequence", *SIMPLER)) for row in rows)
    ratios = (statistics.median(row["sequence"] / row[m] for row in rows) for m in SIMPLER)
    slower = sum(row["sequence"] > min(row[m] for m in SIMPLER) + 1e-9 for row in rows)
    print_row(name, len(rows), *(f"{ratio:.2f}" for ratio in ratios), slower)


def main() -> None:
    """Prints one row per study: random sequences, half of them with free yaw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--effort", default="normal")
    given = parser.parse_args()
    print_head("timed", "jobs", *(f"/ `{m}`" for m in SIMPLER), "slower than one of them")
    for name, options in STUDIES.items():
        rows = [
            times(random_job(seed, free_yaw=seed % 2 == 1, **options), given.effort)
            for seed in range(given.sequences)
        ]
        print_rows(name, rows)


if __name__ == "__main__":
    main()
