"""Estimated gains of levers against re-planned ones: rank correlation, errors, and whether the best is among the first.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.quality.levers 01_first_pick 13_hand_over --effort quick`.

Every estimated lever of each bundled job is re-planned and verified. Without names the jobs are those of DEFAULT.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from scipy.stats import spearmanr

from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.evaluation.crew import Crew
from dualarm_cli.evaluation.request import Request
from dualarm_cli.files.source.bundled import task_file
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.levers.estimates import estimated_levers
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound

DEFAULT = [
    *("01_first_pick", "02_two_trays", "05_two_robots", "06_shared_bin", "07_two_shelves"),
    *("08_narrow_bin", "09_yumi", "12_chute", "13_hand_over", "04_packing"),
]
FIRST = 3
"""Number of estimates among which the best re-planned lever is sought."""


def of_job(name: str, effort: str, processes: int, most: int) -> list[tuple[str, float, float]]:
    """Returns lever, estimate and re-planned gain of a job's levers [s]."""
    tasks, _ = task_file(name)
    job = load_job(tasks)
    schedule = plan_without_bound(job, PlanSettings(effort=effort))
    estimates = [e for e in estimated_levers(schedule, job, tasks) if e.gain is not None][:most]
    requests = [Request.of(tasks, name, effort=effort, overrides=e.lever.values) for e in estimates]
    rows = []
    with Crew(processes) as crew:
        for k, answer in crew.run(requests):
            if answer.status == "planned" and answer.cycle_time is not None:
                gain = schedule.duration - answer.cycle_time
                rows.append((str(estimates[k].lever), float(estimates[k].gain or 0.0), gain))
    return sorted(rows, key=lambda row: -row[1])


def main() -> None:
    """Prints one row per job, and all levers into a file if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("jobs", nargs="*", default=DEFAULT)
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--most", type=int, default=1000, help="levers of a job, largest first")
    parser.add_argument("--out", type=Path, help="JSON file of all levers")
    chosen = parser.parse_args()
    every: dict[str, list[tuple[str, float, float]]] = {}
    hits = 0
    what = "rank correlation", "error, median", "worst", "best one is estimate number", "it is"
    print_head("job", "levers", *what)
    for name in chosen.jobs:
        rows = of_job(name, chosen.effort, chosen.processes, chosen.most)
        every[name] = rows
        if not rows:
            tell(f"{name} has no estimates")
            continue
        estimate, gain = np.array([row[1:] for row in rows]).T
        error = np.abs(estimate - gain)
        best = int(np.argmax(gain))
        hits += best < FIRST
        tell(f"{name}: the largest error is that of {rows[int(np.argmax(error))][0]}")
        print_row(name, len(rows), *numbers(estimate, gain), best + 1, rows[best][0])
        if chosen.out:
            chosen.out.write_text(json.dumps(every, indent=1))
    estimate, gain = np.array([row[1:] for rows in every.values() for row in rows]).T
    first = f"among the first {FIRST} in {hits} of {len(every)}"
    print_row("all", len(estimate), *numbers(estimate, gain), first, "")


def numbers(estimate: FloatArray, gain: FloatArray) -> tuple[str, str, str]:
    """Returns rank correlation, median and largest error of estimates [s] of gains [s]."""
    error = np.abs(estimate - gain)
    ranks = spearmanr(estimate, gain)[0]
    return f"{ranks:.2f}", f"{np.median(error):.3f} s", f"{error.max():.3f} s"


if __name__ == "__main__":
    main()
