"""Length along smooth curves, and the parameter at a length."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, readonly
from dualarm_cli.geometry.products import product
from dualarm_cli.records import dataclass

_OFFSETS = np.array([-np.sqrt(0.6), 0.0, np.sqrt(0.6)])
_WEIGHTS = np.array([5.0, 8.0, 5.0]) / 18.0
TOLERANCE = 1e-12
"""Error between two nodes that refining leaves, per length of the whole curve."""
ROUNDS = 16
"""Times that nodes are halved at most."""


@dataclass(frozen=True)
class ArcLength:
    """Length up to nodes of a curve's parameter: three-point Gauss-Legendre between them."""

    parameter: FloatArray
    """The nodes, rising, shape (k,)."""
    length: FloatArray
    """Length up to each of them [m], shape (k,)."""
    speed: FloatArray
    """Length per unit of the parameter there [m], above 0, shape (k,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("parameter", "length", "speed"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def measure(cls, speed: Callable[[FloatArray], FloatArray], parameter: FloatArray) -> ArcLength:
        """Returns the length of a curve.

        Args:
            speed: length per unit of the parameter (k,) [m] for parameters (k,).
            parameter: the nodes, rising, shape (k,); the curve is smooth between them.
        """
        steps = _steps(speed, parameter[:-1], parameter[1:])
        return cls(parameter, np.concatenate([[0.0], np.cumsum(steps)]), speed(parameter))

    @classmethod
    def refine(cls, speed: Callable[[FloatArray], FloatArray], parameter: FloatArray) -> ArcLength:
        """Returns the length of a curve with more nodes where its speed changes fast.

        What is found between two nodes is compared with what both halves give, and the parameter at half the length
        with the length up to it, until both agree.

        Args:
            speed: length per unit of the parameter (k,) [m] for parameters (k,).
            parameter: the nodes to begin with, rising, shape (k,); the curve is smooth between them.
        """
        found = cls.measure(speed, parameter)
        for _ in range(ROUNDS):
            u, length = found.parameter, found.length
            half = 0.5 * (length[:-1] + length[1:])
            middle = found.at(half)
            first, second = _steps(speed, u[:-1], middle), _steps(speed, middle, u[1:])
            wrong = np.abs(first + length[:-1] - half) + np.abs(first + second - np.diff(length))
            poor = wrong > TOLERANCE * found.whole
            if not poor.any():
                break
            found = cls.measure(speed, np.sort([*u, *(0.5 * (u[:-1] + u[1:]))[poor]]))
        return found

    @property
    def whole(self) -> float:
        """Length of the curve [m]."""
        return float(self.length[-1])

    def at(self, s: FloatArray) -> FloatArray:
        """Returns the parameters (k,) at lengths (k,) [m].

        Cubic Hermite: the parameter's slope over the length is the inverse of the speed. The error falls with the
        fourth power of the nodes' distance.
        """
        u, length = self.parameter, self.length
        k = np.clip(np.searchsorted(length, s, side="right") - 1, 0, len(u) - 2)
        h, gap = u[k + 1] - u[k], length[k + 1] - length[k]
        x = np.clip((s - length[k]) / gap, 0.0, 1.0)
        m0, m1 = gap / self.speed[k], gap / self.speed[k + 1]
        rise = np.square(x) * (3.0 - 2.0 * x)
        found: FloatArray = (
            u[k] + h * rise + m0 * x * np.square(1.0 - x) - m1 * np.square(x) * (1.0 - x)
        )
        return found


def _steps(
    speed: Callable[[FloatArray], FloatArray], start: FloatArray, end: FloatArray
) -> FloatArray:
    """Returns lengths (k,) [m] between parameters (k,) and (k,)."""
    h = end - start
    inner = start[:, None] + h[:, None] * (0.5 + 0.5 * _OFFSETS)
    found: FloatArray = h * product(speed(inner.ravel()).reshape(inner.shape), _WEIGHTS)
    return found
