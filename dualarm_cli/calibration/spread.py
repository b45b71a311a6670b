"""Precision of a fitted pose: spread of points, rank of the Jacobian, 95 % regions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


def interval_factor(degrees: int | None) -> float:
    """Compute the half width of an interval in standard deviations.

    Args:
        degrees: of freedom of the noise's estimate (Student's t); None where the noise is stated (normal).
    """
    # scipy.special is quick to load; scipy.stats is not.
    from scipy.special import ndtri, stdtrit

    tail = 0.5 + SPREAD.level / 2.0
    return float(ndtri(tail) if degrees is None else stdtrit(degrees, tail))


def region_limit(degrees: int | None, count: int = 6) -> float:
    """Compute the squared Mahalanobis radius of the joint region of `count` numbers.

    Args:
        degrees: of freedom of the noise's estimate: count F(count, degrees); None where it is stated: chi squared.
        count: number of quantities.
    """
    from scipy.special import chdtri, fdtri

    if degrees is None:
        return float(chdtri(count, 1.0 - SPREAD.level))
    return count * float(fdtri(count, degrees, SPREAD.level))


def half_widths(covariance: FloatArray, degrees: int | None) -> FloatArray:
    """Compute the interval half widths (n,) from a covariance (n, n)."""
    deviations = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    widths: FloatArray = interval_factor(degrees) * deviations
    return widths


def explained(squares: float, degrees: int, variance: float, level: float = 0.01) -> bool:
    """Test whether noise explains residuals of this size.

    True if residuals at least as large occur with probability `level`.

    Args:
        squares: sum of squared residuals [m^2].
        degrees: their degrees of freedom.
        variance: of one residual [m^2].
        level: significance level.
    """
    from scipy.special import chdtrc

    return math.isclose(squares, 0.0) or float(chdtrc(degrees, squares / variance)) >= level


@dataclass(frozen=True)
class SpreadSettings:
    """Levels and limits of a calibration's uncertainty."""

    weakest: float = 1e-3
    """Relative singular value of the scaled Jacobian below which it counts as zero.

    There noise would be amplified a thousand times.
    """
    share: float = 1e-4
    """Component in an unobservable direction above which a parameter is undetermined."""
    on_a_line: float = 1e-6
    """Ratio of height to length below which points are collinear.

    It applies for any noise.
    """
    noise_factor: float = 3.0
    """Ratio of height to noise below which the height is insignificant."""
    scale_limit: float = 2.0
    """Ratio of lengths from which the robots cannot have touched the same points."""
    level: float = 0.95
    """Confidence of intervals and regions."""
    nearly_a_line: float = 0.2
    """Ratio of height to length below which points are nearly on a line."""


SPREAD = SpreadSettings()


@dataclass(frozen=True)
class Sight:
    """Observability of parameters from a Jacobian."""

    inverse: FloatArray
    """Pseudo-inverse over the observable directions, shape (k, m)."""
    seen: BoolArray
    """Mask of determined parameters, shape (k,)."""
    unseen: FloatArray
    """Unobservable directions as rows, in scaled parameters, shape (j, k)."""
    rank: int
    """Number of observable directions."""

    def covariance(self, variance: float) -> FloatArray:
        """Compute the covariance (k, k) of the parameters from the variance of each residual."""
        return variance * self.inverse @ self.inverse.T

    def in_words(self, names: Sequence[str]) -> list[str]:
        """Describe each unobservable direction as a sum of parameters."""
        directions = []
        for row in self.unseen:
            largest = [k for k, share in enumerate(row) if abs(share) > 0.05]
            sign = np.sign(row[largest[0]])
            terms = [f"{sign * row[k]:+.2f} {names[k]}" for k in largest]
            directions.append(" ".join(terms).removeprefix("+"))
        return directions


def look(jacobian: FloatArray, scale: FloatArray) -> Sight:
    """Analyse the observability of parameters by a singular value decomposition.

    Args:
        jacobian: of m residuals by k parameters, shape (m, k).
        scale: unit of each parameter, which makes columns comparable, shape (k,).
    """
    _, values, Vt = np.linalg.svd(jacobian * scale, full_matrices=True)
    count = jacobian.shape[1]
    values = np.concatenate([values, np.zeros(count - len(values))])
    kept = values > SPREAD.weakest * values[0]
    seen = Vt[kept]
    # pinv(J S) = V diag(1 / values²) Vᵀ (J S)ᵀ over the observable directions.
    inverse = scale[:, None] * (seen.T / values[kept] ** 2) @ seen @ (jacobian * scale).T
    unseen = Vt[~kept]
    components = np.linalg.norm(unseen, axis=0)
    return Sight(inverse, components < SPREAD.share, unseen, int(kept.sum()))


@dataclass(frozen=True)
class Spread:
    """Spread of one robot's points."""

    length: float
    """Distance of the two farthest points [m]."""
    height: float
    """Largest distance of a point from the line through the two farthest points [m]."""
    ends: tuple[int, int]
    """Indices of the two farthest points."""
    deviations: tuple[float, float, float]
    """Root mean squares along the principal axes [m].

    Singular values of the centred points over sqrt(n).
    """

    @property
    def ratio(self) -> float:
        """Height over length; 0 on a line."""
        return self.height / self.length if self.length > 0.0 else 0.0


def measure_spread(points: FloatArray) -> Spread:
    """Measure the spread of points (n, 3) [m]."""
    point_distances = distances(points)
    i, j = (int(k) for k in np.unravel_index(np.argmax(point_distances), point_distances.shape))
    length = float(point_distances[i, j])
    along = (points[j] - points[i]) / length if length > 0.0 else np.zeros(3)
    across = points - points[i] - ((points - points[i]) @ along)[:, None] * along
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    deviations = (float(values[0]), float(values[1]), float(values[2]))
    height = float(np.linalg.norm(across, axis=1).max())
    return Spread(length, height, (min(i, j), max(i, j)), deviations)


def distances(points: FloatArray) -> FloatArray:
    """Compute the distances between points (n, 3) [m], shape (n, n)."""
    lengths: FloatArray = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return lengths


def refuse_lines(problem: CalibrationProblem) -> None:
    """Raise if the points cannot determine a pose.

    Raises:
        InfeasibleError: the two robots' points differ in size, or they are on a line.
    """
    spreads = {"left": measure_spread(problem.left), "right": measure_spread(problem.right)}
    lengths = [spread.length for spread in spreads.values()]
    for side, spread in spreads.items():
        if spread.length <= 1e-9:
            raise InfeasibleError(Refusal("points_are_one", arm=side))
    if max(lengths) > SPREAD.scale_limit * min(lengths):
        raise InfeasibleError(
            Refusal("sizes_differ", data={"left": lengths[0], "right": lengths[1]})
        )
    noise = (problem.noise or 0.0) * SPREAD.noise_factor
    for side, spread in spreads.items():
        if spread.height <= max(SPREAD.on_a_line * spread.length, noise):
            ends = [problem.names[k] for k in spread.ends]
            near = (
                [Refusal("near_line", data={"factor": SPREAD.noise_factor})] if noise > 0.0 else []
            )
            data = {"ends": ends, "near": near, "mm": spread.height * 1000}
            raise InfeasibleError(
                Refusal("points_on_line", arm=side, measured=spread.height, data=data)
            )
