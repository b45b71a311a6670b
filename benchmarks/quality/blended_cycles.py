"""What passing lines' outer ends in motion saves: whole cycles against those with all stops, both decided anew.

python -m benchmarks.quality.blended_cycles --sequences 20 --stages 24 --effort normal

Random sequences of `long_sequences.py` on the SDA10F, lines of 80 mm, dwells of 0.15 s: with all stops
(`--blend none`), with whole lines straight, and with their inner 40 and 20 mm straight; under jerk limits and without.
Every plan is verified with its clearance. Printed are ratios of cycle times, medians and worst, and of processor times.
Sequences that have no plan by some variant are left out, and named.
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.jobs.long_sequences import write_sequence
from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

DWELL = 0.15
"""Of every pick and place [s]."""
VARIANTS = {
    "stops": ("none", math.inf),
    "whole": ("lines", math.inf),
    "40 mm": ("lines", 0.04),
    "20 mm": ("lines", 0.02),
}
"""By name `--blend` and how much of a line has to be straight [m]."""


def without_jerk_limits(job: Job) -> Job:
    """Returns the job on the same robot without any jerk limit."""
    robot = job.cell.robot
    limits = replace(robot.limits, jerk=np.full(len(robot.limits.joints), math.inf))
    return replace(job, cell=replace(job.cell, robot=replace(robot, limits=limits)))


def with_straight(job: Job, straight: float) -> Job:
    """Returns the job with only so much of its lines straight [m]."""
    tasks = tuple(
        replace(task, stops=tuple(replace(stop, straight=straight) for stop in task.stops))
        for task in job.tasks
    )
    return replace(job, tasks=tasks)


def planned(job: Job, blend: str, effort: str) -> tuple[float, float]:
    """Returns a job's cycle time [s] and the processor time of its planning [s].

    Raises:
        AssertionError: the verifier does not pass the plan.
    """
    begin = time.process_time()
    schedule = plan_without_bound(job, PlanSettings(blend=blend, effort=effort))
    taken = time.process_time() - begin
    verification = verify(schedule, job, clearance=True)
    assert verification.passed, verification.failures
    return schedule.duration, taken


def sequence_job(seed: int, stages: int) -> Job:
    """Returns one random sequence."""
    with tempfile.TemporaryDirectory() as folder:
        write_sequence("sda10f", stages, seed, Path(folder))
        tasks = Path(folder) / "tasks.yaml"
        document = json.loads(tasks.read_text(encoding="utf-8"))
        document["defaults"]["dwell"] = DWELL
        tasks.write_text(json.dumps(document), encoding="utf-8")
        return load_job(tasks)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sequences", type=int, default=20)
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--effort", default="normal")
    parser.add_argument(
        "--jobs", nargs="*", default=[], help="task files in place of random sequences"
    )
    arguments = parser.parse_args()
    if arguments.jobs:
        jobs = {name: load_job(Path(name)) for name in arguments.jobs}
    else:
        jobs = {f"seed {k}": sequence_job(k, arguments.stages) for k in range(arguments.sequences)}
    print_head("", "straight", "jobs", "cycle / with stops (worst)", "planning / with stops")
    for limits in ("jerk limits", "no jerk limits"):
        ratios: dict[str, list[float]] = {name: [] for name in VARIANTS}
        times: dict[str, list[float]] = {name: [] for name in VARIANTS}
        for name, job in jobs.items():
            own = job if limits == "jerk limits" else without_jerk_limits(job)
            try:
                found = {
                    variant: planned(with_straight(own, straight), blend, arguments.effort)
                    for variant, (blend, straight) in VARIANTS.items()
                }
            except InfeasibleError as error:
                tell(f"{limits}, {name}: {str(error).splitlines()[0]}")
                continue
            stops = found["stops"]
            for variant, (cycle, taken) in found.items():
                ratios[variant].append(cycle / stops[0])
                times[variant].append(taken / stops[1])
            row = ", ".join(f"{v} {cycle:.3f} s" for v, (cycle, _) in found.items())
            tell(f"{limits}, {name}: {row}")
        for variant in VARIANTS:
            cycle = f"{np.median(ratios[variant]):.3f} ({max(ratios[variant]):.3f})"
            count, planning = len(ratios[variant]), f"{np.median(times[variant]):.2f}"
            print_row(limits, variant, count, cycle, planning)


if __name__ == "__main__":
    main()
