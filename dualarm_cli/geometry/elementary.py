"""Sines, roots, logarithms and the like with the same bits on every processor.

Those of numpy and of the machine's C library differ in their last digits between processors with and without AVX-512
or fused operations. Arguments are numbers or arrays of any shape; results are float64, as numpy's are, without
its warnings.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from dualarm_cli.native import universal

TURN = 2.0 * np.pi
"""Whole turn [rad]."""


def _function(name: str, inputs: int = 1) -> Callable[..., Any]:
    """Wrap a compiled function, looked up at its first call."""

    def function(*x: Any) -> Any:
        return universal(name, inputs)(*x)

    return function


sin = _function("sin")
"""Sine of angles [rad]."""
cos = _function("cos")
"""Cosine of angles [rad]."""
arcsin = _function("asin")
"""Angles [rad] by their sine, in [-pi/2, pi/2]."""
arccos = _function("acos")
"""Angles [rad] by their cosine, in [0, pi]."""
arctan = _function("atan")
"""Angles [rad] by their tangent, in [-pi/2, pi/2]."""
arctan2 = _function("atan2", 2)
"""Angles [rad] of points by their y and x, in [-pi, pi]."""
exp = _function("exp")
"""Exponential function."""
log = _function("log")
"""Natural logarithm."""
tanh = _function("tanh")
"""Hyperbolic tangent."""
cbrt = _function("cbrt")
"""Cube root, of negative numbers too."""
power = _function("pow", 2)
"""First number to the power of the second."""


def cube(x: Any) -> Any:
    """Compute the third power of numbers as two products."""
    return x * x * x


def angle_of(z: Any) -> Any:
    """Compute the angles of complex numbers [rad], in [-pi, pi]."""
    return arctan2(np.imag(z), np.real(z))


def angle_between(z: Any, w: Any) -> Any:
    """Compute the angles from complex numbers w to z [rad], in [-pi, pi]."""
    return angle_of(complex_product(z, np.conj(w)))


def modulus(z: Any) -> Any:
    """Compute the absolute values of complex numbers."""
    return np.hypot(np.real(z), np.imag(z))


def unit_complex(angle: Any) -> Any:
    """Compute the complex numbers of modulus 1 at angles [rad]."""
    return cos(angle) + 1j * sin(angle)


def complex_product(z: Any, w: Any) -> Any:
    """Multiply complex numbers; numpy's product of two arrays may fuse operations."""
    x, y, u, v = np.real(z), np.imag(z), np.real(w), np.imag(w)
    return (x * u - y * v) + 1j * (x * v + y * u)


def geometric(first: float, last: float, count: int) -> Any:
    """Compute numbers from first to last with the same ratio of neighbours, shape (count,)."""
    values = first * exp(np.linspace(0.0, log(last / first), count))
    values[0], values[-1] = first, last
    return values
