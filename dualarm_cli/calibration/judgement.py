"""How good a calibration is: what it leaves at every point, how the points lie, and what to do about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dualarm_cli.calibration.confidence import half_widths
from dualarm_cli.calibration.consistency import (
    TOUCH_NOISE,
    Consistency,
    check_consistency,
    least_squares,
)
from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.calibration.solution import CalibrationSolution
from dualarm_cli.calibration.spread import NEARLY_A_LINE, Spread, distances, measure_spread
from dualarm_cli.geometry.arrays import FloatArray, readonly

SAME_POINT = 1e-4
"""Points nearer than this for both robots are one point [m]."""
MIRRORED = 1e-3
"""Residuals of which the root mean square is less are not those of a mirror image [m]."""
TURN_OFF = math.radians(0.5)
"""An uncertainty of rotation that is told of [rad]."""


@dataclass(frozen=True)
class PairDistance:
    """The distance of two points, as both robots have it."""

    first: str
    """One point."""
    second: str
    """The other."""
    left: float
    """For the left robot [m]."""
    right: float
    """For the right robot [m]."""


@dataclass(frozen=True)
class Judgement:
    """What there is to say of a calibration."""

    residuals: FloatArray
    """What is left at each point, left minus transformed right [m], shape (n, 3)."""
    pairs: tuple[PairDistance, ...]
    """Distances of all pairs of points."""
    left: Spread
    """How the left robot's points lie."""
    right: Spread
    """How the right robot's points lie."""
    widths: FloatArray | None
    """Half widths of the 95 % intervals of translation [m] and rotation vector [rad], shape (6,)."""
    warnings: tuple[str, ...]
    """What is wrong or weak, and what to do."""

    @property
    def distances(self) -> FloatArray:
        """Length of the residual at each point [m], shape (n,)."""
        return readonly(np.linalg.norm(self.residuals, axis=1))

    @property
    def rms(self) -> float:
        """Root mean square of those lengths [m]."""
        return float(np.sqrt((self.residuals**2).sum() / len(self.residuals)))


def judge(
    problem: CalibrationProblem, solution: CalibrationSolution, method: str, fitted: int = 0
) -> Judgement:
    """Returns residuals, distances, spread, uncertainty and warnings.

    Args:
        problem: the points.
        solution: what a method made of them.
        method: which method it was.
        fitted: how many coordinates of tools were fitted to the same residuals.
    """
    residuals = solution.residuals(problem.left, problem.right)
    left, right = measure_spread(problem.left), measure_spread(problem.right)
    apart = distances(problem.left), distances(problem.right)
    n = len(problem.names)
    pairs = tuple(
        PairDistance(
            problem.names[i], problem.names[j], float(apart[0][i, j]), float(apart[1][i, j])
        )
        for i in range(n)
        for j in range(i + 1, n)
    )
    widths = None
    if solution.covariance is not None:
        widths = readonly(half_widths(solution.covariance, solution.degrees))
    consistency = check_consistency(problem, fitted)
    warnings = [
        *_few(problem, method),
        *_near_line(problem, left, right),
        *_repeated(problem, pairs),
        *_disagreement(problem, pairs, consistency, fitted),
        *mirrored(problem),
        *_uncertain(widths, method),
    ]
    return Judgement(readonly(residuals), pairs, left, right, widths, tuple(warnings))


def _few(problem: CalibrationProblem, method: str) -> list[str]:
    """Says so where three points are all, or more than a method uses."""
    n = len(problem.names)
    if method == "frame" and n > 3:
        others = ", ".join(problem.names[3:])
        return [
            f"the frame method uses the first three points only; {others}: checks. least_squares uses all"
        ]
    if n > 3:
        return []
    return [
        "three points are the fewest that do, and a bad one can hide among them; touch 4 to 8, "
        "well spread in all directions"
    ]


def _near_line(problem: CalibrationProblem, left: Spread, right: Spread) -> list[str]:
    """Says so where the points are nearly on a line."""
    worst = min(left, right, key=lambda spread: spread.ratio)
    if worst.ratio >= NEARLY_A_LINE:
        return []
    ends = " and ".join(problem.names[k] for k in worst.ends)
    return [
        f"the points are nearly on one line: none is more than {left.height * 1000:.1f} mm (left) and "
        f"{right.height * 1000:.1f} mm (right) off the line of {worst.length * 1000:.0f} mm "
        f"through {ends}, so errors of touching "
        f"turn the result about that line; touch a point at least {worst.length * 500:.0f} mm beside it"
    ]


def _repeated(problem: CalibrationProblem, pairs: tuple[PairDistance, ...]) -> list[str]:
    """Names points that are one."""
    return [
        f"{pair.first} and {pair.second} are the same point (less than {SAME_POINT * 1000:g} mm "
        "apart): it tells how well touching "
        "repeats, but adds nothing to the spread"
        for pair in pairs
        if max(pair.left, pair.right) < SAME_POINT
    ]


def _disagreement(
    problem: CalibrationProblem,
    pairs: tuple[PairDistance, ...],
    consistency: Consistency,
    fitted: int,
) -> list[str]:
    """Says so where the robots' points differ by more than noise."""
    found = []
    if consistency.scale is not None:
        found.append(
            f"the left robot's points span {consistency.scale:.4f} times what the right robot's "
            "do; look at units, tools and lengths of the robot files"
        )
    if problem.noise is None and consistency.contradicted:
        worst = max(pairs, key=lambda pair: abs(pair.left - pair.right))
        found.append(
            f"the robots disagree by {abs(worst.left - worst.right) * 1000:.1f} mm about the "
            f"distance of {worst.first} and {worst.second}, more than "
            + (f"a noise of {TOUCH_NOISE * 1000:g} mm" if consistency.too_much else "their noise")
            + " explains: no transform can mend that; touch them again, or look at tools and robot files"
        )
    elif consistency.too_much and problem.noise is not None:
        degrees = 3 * len(problem.names) - 6 - fitted
        found.append(
            f"the residuals are larger than a noise of {problem.noise * 1000:g} mm explains (it would take "
            f"{math.sqrt(least_squares(problem) / degrees / 2.0) * 1000:.2g} mm), so the intervals are too narrow; "
            "look at single points, tools and robot files, or leave the noise out"
        )
    if consistency.outlier is not None:
        outlier = consistency.outlier
        found.append(
            f"without {problem.names[outlier.point]} the others fit {outlier.factor:.3g} times better, and it is "
            f"{outlier.off * 1000:.3g} mm from where they put it: touch it again, or look whether both robots mean "
            "the same point"
        )
    return found


def mirrored(problem: CalibrationProblem) -> list[str]:
    """Says so where a reflection fits far better: a sign was lost."""
    flipped = CalibrationProblem(problem.left, -problem.right, problem.names)
    plain, mirror = (math.sqrt(least_squares(p) / len(p.names)) for p in (problem, flipped))
    if plain < MIRRORED or mirror > plain / 3.0:
        return []
    return [
        "one robot's points are the mirror image of the other's: a reflection leaves "
        f"{mirror * 1000:.3g} mm where the best motion "
        f"leaves {plain * 1000:.3g} mm; look for a lost sign, or axes of the wrong hand"
    ]


def _uncertain(widths: FloatArray | None, method: str) -> list[str]:
    """Says so where the uncertainty is large, or not known."""
    if widths is None and method == "frame":
        return [
            "how sure the frame method is can be said only where the noise is stated (`noise: 0.5 mm`)"
        ]
    if widths is None:
        return [
            "there are as many unknowns as equations, so nothing tells how sure this is; touch more points, "
            "or state the noise"
        ]
    if widths[3:].max() < TURN_OFF:
        return []
    return [
        f"the rotation is known to ±{math.degrees(float(widths[3:].max())):.2g} deg only (95 %), which is "
        f"{math.tan(min(float(widths[3:].max()), 1.5)) * 1000:.0f} mm at a distance of 1 m; touch "
        "more points, farther apart in all directions"
    ]
