"""Lines from rest to rest against an IPOPT optimum: the path is given, its speed is free.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.quality.rest_lines --line 0.08 0.04 --lines 50`.

Lines are those of `blended_corners.py`: retracts at random targets of an SDA10F arm, with postures as the planner
chooses them. The reference is the least time from rest to rest with the path parameter's jerk piecewise constant and
all limits of all joints as constraints at the ends and in the middle of each interval.
"""

from __future__ import annotations

import argparse
from itertools import islice
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.quality.blended_corners import (
    DEGREE,
    JOINTS,
    WITHIN,
    after,
    line_rates,
    polynomials,
    random_corners,
)
from benchmarks.tables import print_head, print_row
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.problem import LineProblem

INTERVALS = 30
"""Intervals of constant jerk."""


class Reference:
    """The line as a nonlinear program, for any line of the same joints."""

    def __init__(self, limits: JointLimits) -> None:
        """Builds the program."""
        on_line, coefficients = line_rates(), ca.SX.sym("line", JOINTS * (DEGREE + 1))
        T, X, U = ca.SX.sym("T"), ca.SX.sym("X", 3, INTERVALS + 1), ca.SX.sym("U", INTERVALS)
        ends = ca.DM([0, 0, 0]), ca.DM([1, 0, 0])
        terms = [(X[:, k] - end, 0.0, 0.0) for k, end in zip((0, INTERVALS), ends, strict=True)]
        terms += [(X[1, 1:-1], 0.0, np.inf)]
        for i in range(INTERVALS):
            terms.append((after(X[:, i], U[i], T / INTERVALS) - X[:, i + 1], 0.0, 0.0))
            for share in WITHIN:
                at = after(X[:, i], U[i], share * T / INTERVALS)
                _, *rates = on_line(coefficients, at, U[i])
                scales = limits.velocity, limits.acceleration, limits.jerk
                terms += [(x / m, -1.0, 1.0) for x, m in zip(rates, scales, strict=True)]
        self._bounds = {
            "lbg": np.concatenate([np.full(g.numel(), low) for g, low, _ in terms]),
            "ubg": np.concatenate([np.full(g.numel(), high) for g, _, high in terms]),
        }
        program = {
            "x": ca.vertcat(T, ca.vec(X), U),
            "p": coefficients,
            "f": T,
            "g": ca.vertcat(*(ca.vec(g) for g, _, _ in terms)),
        }
        ipopt = {"print_level": 0, "sb": "yes", "max_iter": 400, "tol": 1e-6}
        options: dict[str, Any] = {"print_time": False, "ipopt": ipopt}
        self._solve = ca.nlpsol("line", "ipopt", program, options)

    def solve(self, path: FloatArray, duration: float) -> float | None:
        """Returns the least time of a line [s] from a first guess; None where IPOPT does not converge."""
        t, longer = np.linspace(0.0, 1.0, INTERVALS + 1), 1.2 * duration
        states = np.column_stack(
            [
                t**3 * (10.0 - 15.0 * t + 6.0 * t**2),
                30.0 * (t * (1.0 - t)) ** 2 / longer,
                60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / longer**2,
            ]
        )
        jerk = np.diff(states[:, 2]) * INTERVALS / longer
        guess = np.concatenate([[longer], states.ravel(), jerk])
        found = self._solve(x0=guess, p=polynomials(path).ravel(), **self._bounds)
        return float(found["f"]) if self._solve.stats()["success"] else None


def main() -> None:
    """Prints how much longer our lines take than the reference."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    lengths = {"type": float, "nargs": "+", "default": [0.08, 0.04]}
    parser.add_argument("--line", **lengths, help="lengths of lines [m]")
    parser.add_argument("--lines", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print_head("lines", "length", "duration / optimum, median", "worst")
    for length in given.line:
        ratios = compared(length, given.lines, given.seed)
        cells = f"{np.median(ratios):.4f}", f"{max(ratios):.4f}"
        print_row(len(ratios), f"{1e3 * length:g} mm", *cells)


def compared(length: float, count: int, seed: int) -> list[float]:
    """Returns our durations over the reference's, of so many lines of a length [m]."""
    reference, ratios = None, []
    for corner in islice(random_corners(length, seed), count):
        limits, path = corner.limits, corner.retract
        line = TIMING_SOLVERS["ruckig"].line
        ours = line(LineProblem(limits.joints, path, corner.length, limits)).duration
        reference = reference or Reference(limits)
        least = reference.solve(path, ours)
        if least is not None:
            ratios.append(ours / least)
    return ratios


if __name__ == "__main__":
    main()
