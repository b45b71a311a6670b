"""Closed-form times against ruckig, and lines against toppra, in one run.

Run: OPENBLAS_NUM_THREADS=1 python benchmarks/timing.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.line_profile import estimate_line_durations
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.rest_to_rest import RestToRest

JOINTS = ("s", "l", "e", "u", "r", "b", "t")
VELOCITY = np.radians([170.0, 170, 170, 170, 200, 200, 400])
REPEATS = 5


def limits(jerk: float) -> JointLimits:
    """An SDA10F arm's limits; `jerk` 1 for the assumed ones, infinity for none."""
    wide = np.full(7, 3.2)
    return JointLimits(
        JOINTS, -wide, wide, VELOCITY, VELOCITY / 0.3, jerk * VELOCITY / 0.03, ("assumed",) * 7
    )


def best_time(work: Callable[[], object], calls: int = 1) -> float:
    """Least time per call of several runs [s]."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        for _ in range(calls):
            work()
        times.append((time.perf_counter() - begin) / calls)
    return min(times)


def main() -> None:
    """Prints the table."""
    rng = np.random.default_rng(0)
    assumed, free = limits(1.0), limits(np.inf)
    law = RestToRest(assumed.velocity, assumed.acceleration, assumed.jerk)
    moves = rng.uniform(-2, 2, (100_000, 7))
    closed = best_time(lambda: law.duration(moves)) / len(moves)
    ruckig = TIMING_SOLVERS["ruckig"]
    transfer = TransferProblem(JOINTS, moves[0], moves[1], assumed)
    solved = best_time(lambda: ruckig.transfer(transfer), 50)
    print(f"closed-form duration, 7 joints   {closed * 1e9:10.0f} ns")
    print(f"ruckig transfer with exact knots {solved * 1e6:10.0f} us   {solved / closed:8.0f} x")

    length = np.linspace(0.0, 0.08, 65)
    share = length[:, None] / 0.08
    ratios, ours, theirs = [], [], []
    for _ in range(20):
        a, b, c, d = rng.uniform(-1, 1, (4, 7))
        path = a + 0.4 * b * share + 0.1 * c * share**2 + 0.05 * d * np.sin(3 * share)
        line = LineProblem(JOINTS, path, length, free)
        one, other = ruckig.line(line), TIMING_SOLVERS["toppra"].line(line)
        ratios.append(one.duration / other.duration)
        ours.append(best_time(lambda line=line: ruckig.line(line)))  # type: ignore[misc]
        theirs.append(best_time(lambda line=line: TIMING_SOLVERS["toppra"].line(line)))  # type: ignore[misc]
    many = np.repeat(path[None, ::10][:, :7], 2_000, axis=0)
    estimate = best_time(lambda: estimate_line_durations(many, length[::10][:7], assumed)) / 2_000
    print(f"line profile                     {np.median(ours) * 1e6:10.0f} us")
    print(f"toppra line                      {np.median(theirs) * 1e6:10.0f} us")
    print(f"estimate of a line in a batch    {estimate * 1e6:10.1f} us")
    print(
        "duration of the profile over toppra's, no jerk limit: "
        f"median {np.median(ratios):.3f}, worst {max(ratios):.3f}"
    )


if __name__ == "__main__":
    main()
