"""Platform angles: moves per second of every method, against the plain alternatives, in one run.

Run: OPENBLAS_NUM_THREADS=1 python benchmarks/platform_angles.py
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

from dualarm_cli.geometry.roots import second_order_zeros, zeros_by_companion
from dualarm_cli.platform_angle import PLATFORM_SOLVERS, Kind, PlatformProblem
from dualarm_cli.platform_angle.exact import _squared
from dualarm_cli.platform_angle.problem import cosine_coefficients, elbow_cosine

MOVES, SCANNED, SAMPLES, REPEATS = 200_000, 200, 720, 5


def moves(count: int) -> PlatformProblem:
    """Moves of an SDA10F: wrists 0.35 to 0.75 m from the axis, in front of either shoulder."""
    rng = np.random.default_rng(0)
    distance = rng.uniform(0.35, 0.75, (count, 2))
    azimuth = rng.uniform(-1.2, 1.2, (count, 2)) + np.array([0.4, -0.4])
    wrist = np.stack(
        [
            distance * np.cos(azimuth),
            distance * np.sin(azimuth),
            rng.uniform(-0.3, 0.1, (count, 2)),
        ],
        axis=-1,
    )
    side = np.radians(69.326)
    return PlatformProblem.broadcast(
        radius=0.28324,
        offset=[side, -side],
        height=0.0,
        upper=0.36,
        fore=0.36,
        wrist=wrist,
        angle_0=rng.uniform(-0.5, 0.5, count),
        elbow_0=rng.uniform(0.8, 2.6, (count, 2)),
    )


def best_time(work: Callable[[], object]) -> float:
    """Least time of several runs [s]."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def scan_and_brent(problem: PlatformProblem) -> int:
    """What one would write first: sample the difference of each move, then refine each sign change."""
    found = 0
    grid = np.linspace(-np.pi, np.pi, SAMPLES)
    for k in range(len(problem.angle_0)):
        one = problem.rows(slice(k, k + 1))
        for sign in (1.0, -1.0):
            target = one.elbow_0[0, 0] - sign * one.elbow_0[0, 1]

            def difference(phi: float) -> float:
                x = np.clip(elbow_cosine(one, np.array([[phi]]))[0, 0], -1.0, 1.0)  # noqa: B023
                return float(np.arccos(x[0]) - sign * np.arccos(x[1]) - target)  # noqa: B023

            x = elbow_cosine(one, grid[None])[0]
            inside = (np.abs(x) <= 1.0).all(axis=1)
            q = np.arccos(np.clip(x, -1.0, 1.0))
            g = q[:, 0] - sign * q[:, 1] - target
            for i in np.flatnonzero(inside[:-1] & inside[1:] & (g[:-1] * g[1:] < 0)):
                brentq(difference, grid[i], grid[i + 1], xtol=1e-12)
                found += 1
    return found


def main() -> None:
    """Prints the table."""
    problem = moves(MOVES)
    exact = PLATFORM_SOLVERS["exact"]
    rate = {
        name: MOVES / best_time(lambda name=name: PLATFORM_SOLVERS[name].solve(problem))  # type: ignore[misc]
        for name in PLATFORM_SOLVERS.names
    }
    coefficients = cosine_coefficients(problem)
    rows = [
        _squared(coefficients, problem.elbow_0[:, 0] - s * problem.elbow_0[:, 1])
        for s in (1.0, -1.0)
    ]
    rate["zeros alone, closed form"] = MOVES / best_time(
        lambda: [second_order_zeros(r) for r in rows]
    )
    few = [r[:20_000] for r in rows]
    rate["zeros alone, companion matrices"] = 20_000 / best_time(
        lambda: [zeros_by_companion(r) for r in few]
    )
    begin = time.perf_counter()
    scan_and_brent(problem.rows(slice(0, SCANNED)))
    rate["dense scan + Brent, one at a time"] = SCANNED / (time.perf_counter() - begin)
    print(f"{'method':36s} {'moves/s':>12s} {'exact is … times as fast':>26s}")
    for name, value in rate.items():
        print(f"{name:36s} {value:12,.0f} {rate['exact'] / value:26.2f}")
    solution = exact.solve(problem)
    roots = solution.reachable & (solution.kind <= Kind.ROOT_OPPOSITE) & solution.valid
    print(f"moves with a reachable root: {roots.any(axis=1).mean():.1%}")


if __name__ == "__main__":
    main()
