"""95 % intervals and regions of estimates whose noise is stated or estimated."""

from __future__ import annotations

import math

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray

LEVEL = 0.95
"""How sure intervals and regions are."""


def interval_factor(degrees: int | None) -> float:
    """Returns how many standard deviations an interval of one number reaches to either side.

    Args:
        degrees: of freedom of the noise's estimate (Student's t); None where the noise is stated (normal).
    """
    # scipy.special is quick to load; scipy.stats is not.
    from scipy.special import ndtri, stdtrit

    tail = 0.5 + LEVEL / 2.0
    return float(ndtri(tail) if degrees is None else stdtrit(degrees, tail))


def region_limit(degrees: int | None, count: int = 6) -> float:
    """Returns the largest squared Mahalanobis distance of the region of `count` numbers together.

    Args:
        degrees: of freedom of the noise's estimate: count F(count, degrees); None where it is stated: chi squared.
        count: how many numbers.
    """
    from scipy.special import chdtri, fdtri

    if degrees is None:
        return float(chdtri(count, 1.0 - LEVEL))
    return count * float(fdtri(count, degrees, LEVEL))


def half_widths(covariance: FloatArray, degrees: int | None) -> FloatArray:
    """Returns the half widths (n,) of the intervals of single numbers with a covariance (n, n)."""
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    found: FloatArray = interval_factor(degrees) * deviations
    return found


def explained(squares: float, degrees: int, variance: float, level: float = 0.01) -> bool:
    """Returns whether noise of that variance leaves residuals as large as these with a chance of at least `level`.

    Args:
        squares: sum of squared residuals [m^2].
        degrees: their degrees of freedom.
        variance: of one residual [m^2].
        level: the chance.
    """
    from scipy.special import chdtrc

    return math.isclose(squares, 0.0) or float(chdtrc(degrees, squares / variance)) >= level
