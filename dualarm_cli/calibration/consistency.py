"""Whether two robots' points are the same but for noise: tests whose chance of a false alarm does not grow with n."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from dualarm_cli.calibration.confidence import explained
from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.calibration.rigid import fit_rigid
from dualarm_cli.geometry.arrays import FloatArray

TOUCH_NOISE = 0.5e-3
"""Standard deviation that a touched coordinate is taken to have at most, where no noise is stated [m]."""
OUTLIER_LEVEL, SCALE_LEVEL = 0.02, 0.01
"""Chance at which sound points are called to have an outlier, or two scales. With the 1 % of `explained` and for
whatever number of points, a false alarm comes in less than 5 of 100 sound files."""
READINGS_LEVEL = 0.0025
"""Chance at which either of the two tests of a robot's own readings fails sound ones: 1 % in a file of two robots."""
RELEVANT = 1e-3
"""A disagreement of less is not told of, however sure [m]."""


@dataclass(frozen=True)
class Outlier:
    """A point that does not belong to the others."""

    point: int
    """Its number."""
    off: float
    """How far it is from where the other points put it [m]."""
    factor: float
    """How many times better the others fit without it."""


@dataclass(frozen=True)
class Consistency:
    """What contradicts that noise alone makes the robots' points differ."""

    too_much: bool
    """Whether the residuals are larger than the stated noise, or TOUCH_NOISE, explains."""
    outlier: Outlier | None
    """The point that does not belong to the others."""
    scale: float | None
    """How many times larger the left robot's points are, where that is more than noise."""

    @property
    def contradicted(self) -> bool:
        """Whether anything does."""
        return self.too_much or self.outlier is not None or self.scale is not None


def check_consistency(problem: CalibrationProblem, fitted: int = 0) -> Consistency:
    """Returns what noise alone does not explain.

    Args:
        problem: the points.
        fitted: how many coordinates of tools were fitted to the same residuals.
    """
    squares = least_squares(problem)
    degrees = 3 * len(problem.names) - 6 - fitted
    noise = TOUCH_NOISE if problem.noise is None else problem.noise
    # Both robots' noise is in a residual.
    too_much = degrees > 0 and not explained(squares, degrees, 2.0 * noise**2)
    return Consistency(
        too_much, _outlier(problem, squares, fitted), _scale(problem, squares, fitted)
    )


def readings_apart(apart: FloatArray, noise: float | None, fitted: int) -> float | None:
    """Returns how far coordinates and joint readings of one robot's points are apart at most [m], if noise is not why.

    All points together and, by Bonferroni's bound, the worst of them are compared with noise in both readings.

    Args:
        apart: the differences [m], shape (n, 3).
        noise: standard deviation of each coordinate [m]; None for TOUCH_NOISE.
        fitted: how many numbers were fitted to these differences.
    """
    squares = (apart**2).sum(axis=1)
    worst, degrees = float(squares.max()), apart.size - fitted
    if worst <= RELEVANT**2 or degrees <= 0:
        return None
    variance = 2.0 * (TOUCH_NOISE if noise is None else noise) ** 2
    together = explained(float(squares.sum()), degrees, variance, READINGS_LEVEL)
    if together and explained(worst, 3, variance, READINGS_LEVEL / len(squares)):
        return None
    return math.sqrt(worst)


def least_squares(problem: CalibrationProblem) -> float:
    """Returns the least sum of squared residuals [m^2] that any rigid motion leaves."""
    R, t = fit_rigid(problem.left, problem.right)
    return float(((problem.left - problem.right @ R.T - t) ** 2).sum())


def _outlier(problem: CalibrationProblem, squares: float, fitted: int) -> Outlier | None:
    """Returns the point without which the others fit so much better that noise does it in OUTLIER_LEVEL of all files.

    The mean-shift test of each point, F(3, 3 n - 9) under noise of any size, and Bonferroni's bound on the most
    extreme of n.
    """
    from scipy.special import fdtrc

    n = len(problem.names)
    degrees = 3 * n - 9 - fitted
    if degrees <= 0:
        return None
    kept = np.array([[k for k in range(n) if k != out] for out in range(n)])
    left, right = problem.left[kept], problem.right[kept]
    R, t = fit_rigid(left, right)
    rest = left - (right @ np.swapaxes(R, -1, -2) + t[:, None])
    without = (rest**2).sum(axis=(1, 2))
    worst = int(np.argmin(without))
    least = max(float(without[worst]), 1e-30)
    off = float(np.linalg.norm(problem.left[worst] - R[worst] @ problem.right[worst] - t[worst]))
    F = (squares - least) / 3.0 * degrees / least
    if off < RELEVANT or n * float(fdtrc(3, degrees, F)) >= OUTLIER_LEVEL:
        return None
    return Outlier(worst, off, math.sqrt(squares / (degrees + 3) * degrees / least))


def _scale(problem: CalibrationProblem, squares: float, fitted: int) -> float | None:
    """Returns by how much one robot's lengths are larger, if noise does as much in SCALE_LEVEL of all files.

    The scale of least squares ([Umeyama1991]) as a seventh unknown: F(1, 3 n - 7) under noise of any size.
    """
    from scipy.special import fdtrc

    degrees = 3 * len(problem.names) - 7 - fitted
    if degrees <= 0:
        return None
    R, _ = fit_rigid(problem.left, problem.right)
    left = problem.left - problem.left.mean(axis=0)
    turned = (problem.right - problem.right.mean(axis=0)) @ R.T
    size = float((turned**2).sum())
    scale = float((left * turned).sum()) / size
    least = max(squares - (scale - 1.0) ** 2 * size, 1e-30)
    F = (squares - least) * degrees / least
    off = abs(scale - 1.0) * float(np.linalg.norm(turned[:, None] - turned[None], axis=-1).max())
    if off < RELEVANT or float(fdtrc(1, degrees, F)) >= SCALE_LEVEL:
        return None
    return scale
