"""How good a calibration is: what it leaves at every point, how the points lie, and what to do about it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dualarm_cli.calibration.confidence import explained, half_widths
from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.calibration.rigid import fit_rigid
from dualarm_cli.calibration.solution import CalibrationSolution
from dualarm_cli.calibration.spread import NEARLY_A_LINE, Spread, distances, measure_spread
from dualarm_cli.geometry.arrays import FloatArray, readonly

SAME_POINT = 1e-4
"""Points nearer than this for both robots are one point [m]."""
DISTANCE_OFF = 1e-3
"""A distance on which the robots disagree by more is told of where no noise is stated [m]."""
SCALE_OFF = 0.01
"""By how much the size of both robots' sets of points may differ."""
CULPRIT = 4.0
"""A point without which the others fit this many times better is suspected."""
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
    warnings = [
        *_few(problem, method),
        *_near_line(problem, left, right),
        *_repeated(problem, pairs),
        *_disagreement(problem, pairs, residuals, method, fitted),
        *mirrored(problem),
        *_culprit(problem),
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
    residuals: FloatArray,
    method: str,
    fitted: int,
) -> list[str]:
    """Says so where the robots' lengths or residuals contradict each other or the stated noise."""
    found = []
    sizes = [
        float(np.sqrt(((p - p.mean(axis=0)) ** 2).sum())) for p in (problem.left, problem.right)
    ]
    if abs(sizes[0] / sizes[1] - 1.0) > SCALE_OFF:
        found.append(
            f"the left robot's points span {sizes[0] / sizes[1]:.3f} times what the right robot's "
            "do; look at units, tools and lengths "
            "of the robot files"
        )
    worst = max(pairs, key=lambda pair: abs(pair.left - pair.right))
    off = abs(worst.left - worst.right)
    if problem.noise is None and off > DISTANCE_OFF:
        found.append(
            f"the robots disagree by {off * 1000:.1f} mm about the distance of {worst.first} and "
            f"{worst.second}: no transform can "
            "mend that; touch them again, or look at tools and robot files"
        )
    degrees = 3 * len(problem.names) - 6 - fitted
    least = least_squares(problem) if method == "frame" else float((residuals**2).sum())
    if (
        problem.noise is not None
        and degrees > 0
        and not explained(least, degrees, 2.0 * problem.noise**2)
    ):
        found.append(
            f"the residuals are larger than a noise of {problem.noise * 1000:g} mm explains (it would take "
            f"{math.sqrt(least / degrees / 2.0) * 1000:.2g} mm), so the intervals are too narrow; "
            "look at single points, tools and "
            "robot files, or leave the noise out"
        )
    return found


def least_squares(problem: CalibrationProblem) -> float:
    """Returns the least sum of squared residuals [m^2] that any rigid motion leaves."""
    R, t = fit_rigid(problem.left, problem.right)
    return float(((problem.left - problem.right @ R.T - t) ** 2).sum())


def mirrored(problem: CalibrationProblem) -> list[str]:
    """Says so where a reflection fits far better: a sign was lost."""
    flipped = CalibrationProblem(problem.left, -problem.right, problem.names)
    plain, mirror = (math.sqrt(least_squares(p) / len(p.names)) for p in (problem, flipped))
    if plain < DISTANCE_OFF or mirror > plain / 3.0:
        return []
    return [
        "one robot's points are the mirror image of the other's: a reflection leaves "
        f"{mirror * 1000:.3g} mm where the best motion "
        f"leaves {plain * 1000:.3g} mm; look for a lost sign, or axes of the wrong hand"
    ]


def _culprit(problem: CalibrationProblem) -> list[str]:
    """Names the one point that spoils the rest, where five or more leave enough to tell."""
    n = len(problem.names)
    if n < 5:
        return []
    kept = np.array([[k for k in range(n) if k != out] for out in range(n)])
    left, right = problem.left[kept], problem.right[kept]
    R, t = fit_rigid(left, right)
    rest = left - (right @ np.swapaxes(R, -1, -2) + t[:, None])
    without = (rest**2).sum(axis=(1, 2)) / (3 * (n - 1) - 6)
    every = least_squares(problem) / (3 * n - 6)
    worst = int(np.argmin(without))
    if every < DISTANCE_OFF**2 or every < CULPRIT**2 * without[worst]:
        return []
    return [
        f"without {problem.names[worst]} the others fit "
        f"{math.sqrt(every / max(float(without[worst]), 1e-30)):.3g} times better: "
        "touch it again, or look whether both robots mean the same point"
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
