"""Platform angles: moves per second of every method, against the plain alternatives, in one run.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.speed.platform_angles`. Everything is timed in one process on
the same moves; quote the ratios, not the times. `exact` counts with all it does: candidates of both
signs, rejection of false roots, polish, and fallbacks of moves without a root.

The companion matrices replace the closed form inside the same solver, so that only the zeros differ. The
scan is what one would write first: 720 samples of the unsquared equation of each move in numpy,
then Brent's method on plain floats at each change of sign; it gives roots only, no fallbacks. Both must find the same
roots as `exact`, or the run stops.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from unittest import mock

import numpy as np
from scipy.optimize import brentq

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.roots import zeros_of_any_order
from dualarm_cli.platform_angle import PLATFORM_SOLVERS, PlatformProblem, PlatformSolution
from dualarm_cli.platform_angle import exact as balance
from dualarm_cli.platform_angle.problem import cosine_coefficients

SAMPLES = 720
"""Of the dense scan, over one turn."""
SCANNED = 300
"""Moves that are scanned one at a time."""
GRID = np.linspace(-np.pi, np.pi, SAMPLES)


def main() -> None:
    """Prints the measurements."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--moves", type=int, default=100_000)
    parser.add_argument("--repeat", type=int, default=7, help="best of so many runs")
    options = parser.parse_args()
    for title, problem in (
        ("an SDA10F, targets around it", sda10f_moves(options.moves)),
        ("arms of any shape, a quarter out of reach", any_moves(options.moves)),
    ):
        measure(title, problem, options.repeat)


def sda10f_moves(count: int) -> PlatformProblem:
    """Returns moves of an SDA10F: wrists 0.35 to 0.75 m from the axis, in front of either shoulder."""
    rng = np.random.default_rng(0)
    distance = rng.uniform(0.35, 0.75, (count, 2))
    azimuth = rng.uniform(-1.2, 1.2, (count, 2)) + np.array([0.4, -0.4])
    height = rng.uniform(-0.3, 0.1, (count, 2))
    side = np.radians(69.326)
    return PlatformProblem.broadcast(
        shoulder=(0.28324, [side, -side], 0.0),
        links=(0.36, 0.36),
        wrist=np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), height], axis=-1),
        angle_0=rng.uniform(-0.5, 0.5, count),
        elbow_0=rng.uniform(0.8, 2.6, (count, 2)),
    )


def any_moves(count: int) -> PlatformProblem:
    """Returns moves of random arms: every radius, height and link of its own."""
    rng = np.random.default_rng(1)
    distance, azimuth = rng.uniform(0, 0.8, (count, 2)), rng.uniform(-np.pi, np.pi, (count, 2))
    height = rng.uniform(-0.2, 0.2, (count, 2))
    return PlatformProblem.broadcast(
        shoulder=(rng.uniform(0.02, 0.4, (count, 2)), rng.uniform(-np.pi, np.pi, (count, 2)), 0.0),
        links=(rng.uniform(0.1, 0.5, (count, 2)), rng.uniform(0.1, 0.5, (count, 2))),
        wrist=np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), height], axis=-1),
        angle_0=rng.uniform(-2.0, 2.0, count),
        elbow_0=rng.uniform(0.3, 2.9, (count, 2)),
    )


def measure(title: str, problem: PlatformProblem, repeat: int) -> None:
    """Prints moves per second of every method on one set of moves."""
    count = len(problem.angle_0)
    solve = PLATFORM_SOLVERS["exact"].solve
    rate = {
        solver.name: count / _best(lambda solver=solver: solver.solve(problem), repeat)  # type: ignore[misc]
        for solver in PLATFORM_SOLVERS
    }
    solution = solve(problem)
    with mock.patch.object(balance, "second_order_zeros", zeros_of_any_order):
        rate["exact, zeros by companion matrices"] = count / _best(lambda: solve(problem), 3)
        other = solve(problem)
    _compare(int(solution.is_root.sum()), int(other.is_root.sum()), "companion matrices")
    begin = time.perf_counter()
    scanned = [_scan(problem, move) for move in range(SCANNED)]
    rate["dense scan + Brent, one at a time"] = SCANNED / (time.perf_counter() - begin)
    _check_scan(solution, scanned)
    print(f"{title} ({count:,} moves)")
    print(f"{'  method':38s} {'moves/s':>12s} {'exact / this':>14s}")
    for name, value in rate.items():
        print(f"  {name:36s} {value:12,.0f} {rate['exact'] / value:14.2f}")
    share = solution.is_root.any(axis=1).mean()
    print(
        f"  with a reachable root: {share:.1%}; roots per move: {solution.is_root.sum() / count:.2f}\n"
    )


def _best(work: Callable[[], object], repeat: int) -> float:
    """Returns the shortest of several runs [s]; on a shared machine the least disturbed one."""
    work()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def _scan(problem: PlatformProblem, move: int) -> list[float]:
    """Returns the roots of one move by sampling and Brent's method [rad]."""
    arms = cosine_coefficients(problem.rows(slice(move, move + 1)))[0]
    x = arms[:, :1] + arms[:, 1:2] * np.cos(GRID) + arms[:, 2:] * np.sin(GRID)
    inside = (np.abs(x) <= 1.0).all(axis=0)
    q = np.arccos(np.clip(x, -1.0, 1.0))
    start = problem.elbow_0[move]
    roots = []
    for sign in (1.0, -1.0):
        g = q[0] - sign * q[1] - (start[0] - sign * start[1])
        for i in np.flatnonzero(inside[:-1] & inside[1:] & (g[:-1] * g[1:] < 0)):
            args = (arms[0].tolist(), arms[1].tolist(), sign, float(start[0] - sign * start[1]))
            roots.append(brentq(_difference, GRID[i], GRID[i + 1], args, xtol=1e-12))
    return roots


def _difference(
    phi: float, one: list[float], two: list[float], sign: float, target: float
) -> float:
    """Returns q4_1 - s q4_2 - K at one platform angle [rad]."""
    c, s = math.cos(phi), math.sin(phi)
    x = (min(1.0, max(-1.0, u + v * c + w * s)) for u, v, w in (one, two))
    return math.acos(next(x)) - sign * math.acos(next(x)) - target


def _check_scan(solution: PlatformSolution, scanned: list[list[float]]) -> None:
    """Stops the run unless every scanned root is one of the solution's."""
    missed = 0
    for move, roots in enumerate(scanned):
        ours: FloatArray = solution.angle[move][solution.is_root[move]]
        for root in roots:
            turn = np.mod(ours - root + np.pi, 2.0 * np.pi) - np.pi
            missed += not bool((np.abs(turn) < 1e-6).any())
    _compare(missed, 0, "the scan's roots that exact misses")


def _compare(found: int, expected: int, what: str) -> None:
    if found != expected:
        raise SystemExit(f"{what}: {found} against {expected}")


if __name__ == "__main__":
    main()
