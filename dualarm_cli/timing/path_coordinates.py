"""Coordinates along a path in which a double S is nearly the fastest motion."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.timing.interpolation import interpolate_samples
from dualarm_cli.timing.rest_to_rest import RestToRest
from dualarm_cli.timing.shapes import Shapes

COORDINATES = 3
"""Path length, slowness of the deciding joint, and slowness by what each place allows."""
NORM = 8
"""Norm over the joints: high, so that the slowest decides; even, so that it stays smooth."""
LEAST_SLOWNESS = 0.02
"""Floor of the slowness, as a share of its largest: where no joint moves a coordinate still rises."""


@dataclass(frozen=True)
class PathCoordinates:
    """c coordinates of one path, and what the joints do per unit of each of them.

    A joint that alone decides moves fastest if its own angle follows a double S. So a good coordinate rises with
    the deciding joint's angle rather than with the path length: each joint's speed along the path is weighted
    by the joint's own least time over its whole way, and the NORM-norm over the joints is the slope of the second
    coordinate. The third rises by the least time that velocity, acceleration and jerk limits allow each bit
    of the path at a steady pace, which matters where the path bends sharply in joint space. Our own derivation.
    """

    share: FloatArray
    """Share of the path length at m equidistant values of each coordinate, shape (c, m)."""
    speed: FloatArray
    """Largest |q'| / velocity limit over the joints, shape (c, m)."""
    rates: FloatArray
    """q', q'' over the acceleration limit and q', 3 q'', q''' over the jerk limit, (c, m, 5, n)."""

    @classmethod
    def measure(cls, position: FloatArray, law: RestToRest) -> PathCoordinates:
        """Returns all COORDINATES of a path.

        Args:
            position: joints at equidistant gridpoints [rad], shape (m, n), m at least 8.
            law: the joints' limits.
        """
        m, n = position.shape
        share = _shares(position, law)
        q = np.empty((len(share), m, n))
        q[0] = position
        q[1:] = interpolate_samples(position, share[1:].ravel()).reshape(-1, m, n)
        first, second, third = np.moveaxis(_differences(m) @ q[:, None], 1, 0)
        a, j = law.acceleration, law.jerk
        rates = np.stack([first / a, second / a, first / j, 3.0 * second / j, third / j], axis=2)
        return cls(share, np.abs(first / law.velocity).max(axis=2), rates)

    def scaled_time(self, shapes: Shapes, coordinate: IntArray, per_phase: int) -> FloatArray:
        """Returns how long each shape must take for every limit to hold [s], shape (g,).

        Args:
            shapes: g shapes.
            coordinate: index of the coordinate each of them shapes, shape (g,).
            per_phase: instants per phase that are looked at.
        """
        way, sd, sdd, sddd = shapes.within_phases(per_phase)
        last = self.share.shape[1] - 1
        at = coordinate[:, None], (way * last + 0.5).astype(np.int64)
        velocity = (self.speed[at] * sd).max(axis=1)
        rates = self.rates[at]
        factors = np.stack([sdd, sd**2, sddd, sd * sdd, sd**3], axis=2)[..., None]
        rates *= factors
        acceleration = np.abs(rates[:, :, 0] + rates[:, :, 1]).max(axis=(1, 2))
        jerk = np.abs(rates[:, :, 2] + rates[:, :, 3] + rates[:, :, 4]).max(axis=(1, 2))
        time: FloatArray = np.maximum(velocity, np.maximum(np.sqrt(acceleration), np.cbrt(jerk)))
        return time


def _shares(position: FloatArray, law: RestToRest) -> FloatArray:
    """Returns the share of the length at equidistant values of every coordinate, shape (c, m)."""
    m = len(position)
    first, second, third = np.abs(_differences(m) @ position)
    way = first.mean(axis=0)
    weight = law.per_joint(way) ** 3 / np.where(way > 0.0, way, 1.0)
    deciding = ((first * weight) ** NORM).sum(axis=1)
    # Velocity, acceleration and jerk of a steady pace p are q' p, q'' p², q''' p³.
    steady = (
        (first / law.velocity) ** NORM
        + (second / law.acceleration) ** (NORM / 2)
        + (third / law.jerk) ** (NORM / 3)
    ).sum(axis=1)
    grid = np.linspace(0.0, 1.0, m)
    share = np.tile(grid, (COORDINATES, 1))
    for k, power in enumerate((deciding, steady), start=1):
        slope = np.maximum((power / power.max()) ** (1.0 / NORM), LEAST_SLOWNESS)
        coordinate = np.zeros(m)
        np.cumsum((slope[1:] + slope[:-1]) / 2.0, out=coordinate[1:])
        slope *= (m - 1) / coordinate[-1]
        coordinate /= coordinate[-1]
        share[k] = _inverse(coordinate, slope, grid)
    return share


def _inverse(coordinate: FloatArray, slope: FloatArray, grid: FloatArray) -> FloatArray:
    """Returns where a rising coordinate takes equidistant values, as smooth as the coordinate."""
    both = np.column_stack([coordinate, slope])
    near: FloatArray = np.interp(grid, coordinate, grid)
    # One Newton step from linear interpolation leaves about 1e-9; only smoothness matters here.
    found = interpolate_samples(both, near)
    share: FloatArray = np.clip(
        near - (found[:, 0] - grid) / np.maximum(found[:, 1], LEAST_SLOWNESS), 0.0, 1.0
    )
    share[0], share[-1] = 0.0, 1.0
    return share


@lru_cache(maxsize=8)
def _differences(samples: int) -> FloatArray:
    """Returns operators from equidistant samples on [0, 1] to three derivatives, (3, m, m)."""
    step = 1.0 / (samples - 1)
    once: FloatArray = np.asarray(np.gradient(np.eye(samples), step, axis=0, edge_order=2))
    return np.stack([once, once @ once, once @ once @ once])
