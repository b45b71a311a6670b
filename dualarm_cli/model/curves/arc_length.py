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
"""Relative error between nodes that ends the refinement, per length of the curve."""
ROUNDS = 16
"""Maximum number of refinements."""


@dataclass(frozen=True)
class ArcLength:
    """Length of a curve at nodes of its parameter, by three-point Gauss-Legendre quadrature."""

    parameter: FloatArray
    """Nodes, rising, shape (k,)."""
    length: FloatArray
    """Length up to each node [m], shape (k,)."""
    speed: FloatArray
    """Derivative of the length by the parameter [m], above 0, shape (k,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("parameter", "length", "speed"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    @classmethod
    def measure(cls, speed: Callable[[FloatArray], FloatArray], parameter: FloatArray) -> ArcLength:
        """Measure a curve between given nodes.

        Args:
            speed: length per unit of the parameter (k,) [m] for parameters (k,).
            parameter: the nodes, rising, shape (k,); the curve is smooth between them.
        """
        steps = _steps(speed, parameter[:-1], parameter[1:])
        return cls(parameter, np.concatenate([[0.0], np.cumsum(steps)]), speed(parameter))

    @classmethod
    def refine(cls, speed: Callable[[FloatArray], FloatArray], parameter: FloatArray) -> ArcLength:
        """Measure a curve, with more nodes where its speed changes fast.

        Length and half-length of each interval are compared with those of its halves, until all agree.

        Args:
            speed: length per unit of the parameter (k,) [m] for parameters (k,).
            parameter: the nodes to begin with, rising, shape (k,); the curve is smooth between them.
        """
        measured = cls.measure(speed, parameter)
        for _ in range(ROUNDS):
            u, length = measured.parameter, measured.length
            half = 0.5 * (length[:-1] + length[1:])
            middle = measured.at(half)
            first, second = _steps(speed, u[:-1], middle), _steps(speed, middle, u[1:])
            errors = np.abs(first + length[:-1] - half) + np.abs(first + second - np.diff(length))
            poor = errors > TOLERANCE * measured.whole
            if not poor.any():
                break
            measured = cls.measure(speed, np.sort([*u, *(0.5 * (u[:-1] + u[1:]))[poor]]))
        return measured

    @property
    def whole(self) -> float:
        """Length of the curve [m]."""
        return float(self.length[-1])

    def at(self, s: FloatArray) -> FloatArray:
        """Compute the parameters (k,) at lengths (k,) [m].

        Cubic Hermite: the parameter's slope over the length is the inverse of the speed. The error falls with the
        fourth power of the nodes' distance.
        """
        u, length = self.parameter, self.length
        k = np.clip(np.searchsorted(length, s, side="right") - 1, 0, len(u) - 2)
        h, gap = u[k + 1] - u[k], length[k + 1] - length[k]
        x = np.clip((s - length[k]) / gap, 0.0, 1.0)
        m0, m1 = gap / self.speed[k], gap / self.speed[k + 1]
        rise = np.square(x) * (3.0 - 2.0 * x)
        parameters: FloatArray = (
            u[k] + h * rise + m0 * x * np.square(1.0 - x) - m1 * np.square(x) * (1.0 - x)
        )
        return parameters


def _steps(
    speed: Callable[[FloatArray], FloatArray], start: FloatArray, end: FloatArray
) -> FloatArray:
    """Compute lengths (k,) [m] between parameters (k,) and (k,)."""
    h = end - start
    inner = start[:, None] + h[:, None] * (0.5 + 0.5 * _OFFSETS)
    lengths: FloatArray = h * product(speed(inner.ravel()).reshape(inner.shape), _WEIGHTS)
    return lengths
