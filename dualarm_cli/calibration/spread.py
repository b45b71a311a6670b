"""How well points determine a pose: their spread, and how far they are from one line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.calibration.problem import CalibrationProblem
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray

NEARLY_A_LINE = 0.2
"""Height over length below which points are called nearly on a line."""
ON_A_LINE = 1e-6
"""Height over length below which they are on a line, whatever the noise."""
NOISE_FACTOR = 3.0
"""A height below this many times the noise is no height."""
SCALE_LIMIT = 2.0
"""A ratio of lengths beyond which the two robots cannot have touched the same points."""


@dataclass(frozen=True)
class Spread:
    """How the points of one robot lie."""

    length: float
    """Distance of the two points that are farthest apart [m]."""
    height: float
    """Largest distance of a point from the line through those two [m]; of three points the triangle's height."""
    ends: tuple[int, int]
    """Those two points."""
    deviations: tuple[float, float, float]
    """Root mean squares along the principal axes [m]: singular values of the centred points over sqrt(n)."""

    @property
    def ratio(self) -> float:
        """Height over length; 0 on a line."""
        return self.height / self.length if self.length > 0.0 else 0.0


def measure_spread(points: FloatArray) -> Spread:
    """Returns how points (n, 3) [m] lie."""
    apart = distances(points)
    i, j = (int(k) for k in np.unravel_index(np.argmax(apart), apart.shape))
    length = float(apart[i, j])
    along = (points[j] - points[i]) / length if length > 0.0 else np.zeros(3)
    across = points - points[i] - ((points - points[i]) @ along)[:, None] * along
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) / np.sqrt(len(points))
    deviations = (float(values[0]), float(values[1]), float(values[2]))
    height = float(np.linalg.norm(across, axis=1).max())
    return Spread(length, height, (min(i, j), max(i, j)), deviations)


def distances(points: FloatArray) -> FloatArray:
    """Returns the distances between points (n, 3) [m], shape (n, n)."""
    found: FloatArray = np.linalg.norm(points[:, None] - points[None], axis=-1)
    return found


def refuse_lines(problem: CalibrationProblem) -> None:
    """Raises where the points cannot determine a pose.

    Raises:
        InfeasibleError: the two robots' points differ in size, or they are on a line.
    """
    spreads = {"left": measure_spread(problem.left), "right": measure_spread(problem.right)}
    lengths = [spread.length for spread in spreads.values()]
    for side, spread in spreads.items():
        if spread.length <= 1e-9:
            raise InfeasibleError(
                f"all points of the {side} robot are one; touch points well apart"
            )
    if max(lengths) > SCALE_LIMIT * min(lengths):
        raise InfeasibleError(
            f"the points span {lengths[0]:.6g} m for the left robot and {lengths[1]:.6g} m for "
            "the right one: they cannot be "
            "the same points; look at the units (a plain number is m), at the tools and at the order of the points"
        )
    noise = (problem.noise or 0.0) * NOISE_FACTOR
    for side, spread in spreads.items():
        if spread.height <= max(ON_A_LINE * spread.length, noise):
            ends = " and ".join(problem.names[k] for k in spread.ends)
            near = f" to within {NOISE_FACTOR:g} times the noise" if noise > 0.0 else ""
            raise InfeasibleError(
                f"the points of the {side} robot are on one line{near}: none is more than "
                f"{spread.height * 1000:.3g} mm off the "
                f"line through {ends}, so nothing says how the robots are turned about it; touch "
                "a point far beside that line"
            )
