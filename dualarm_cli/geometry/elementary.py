"""Sines, roots, logarithms and the like with the same bits on every processor.

Those of numpy and of the machine's C library differ in their last digits between processors with and without AVX-512
or fused operations. Arguments are numbers or arrays of any shape; results are float64, as numpy's are.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import c_int64, c_void_p
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.native import function


def _unary(name: str) -> Callable[[ArrayLike], Any]:
    """Wrap a compiled function of one number for arrays."""

    def of_arrays(x: ArrayLike) -> Any:
        values = np.asarray(x, dtype=np.float64, order="C")
        out = np.empty(values.shape)
        compiled = function(name, c_int64, c_void_p, c_void_p)
        compiled(values.size, values.ctypes.data, out.ctypes.data)
        return out if out.ndim else out[()]

    return of_arrays


def _binary(name: str) -> Callable[[ArrayLike, ArrayLike], Any]:
    """Wrap a compiled function of two numbers for arrays, which are broadcast."""

    def of_arrays(x: ArrayLike, y: ArrayLike) -> Any:
        one, other = np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64)
        if one.shape != other.shape:
            one, other = np.broadcast_arrays(one, other)
        one, other = np.asarray(one, order="C"), np.asarray(other, order="C")
        out = np.empty(one.shape)
        compiled = function(name, c_int64, c_void_p, c_void_p, c_void_p)
        compiled(out.size, one.ctypes.data, other.ctypes.data, out.ctypes.data)
        return out if out.ndim else out[()]

    return of_arrays


sin = _unary("sin")
"""Sine of angles [rad]."""
cos = _unary("cos")
"""Cosine of angles [rad]."""
arcsin = _unary("asin")
"""Angles [rad] by their sine, in [-pi/2, pi/2]."""
arccos = _unary("acos")
"""Angles [rad] by their cosine, in [0, pi]."""
arctan = _unary("atan")
"""Angles [rad] by their tangent, in [-pi/2, pi/2]."""
arctan2 = _binary("atan2")
"""Angles [rad] of points by their y and x, in [-pi, pi]."""
exp = _unary("exp")
"""Exponential function."""
log = _unary("log")
"""Natural logarithm."""
tanh = _unary("tanh")
"""Hyperbolic tangent."""
cbrt = _unary("cbrt")
"""Cube root, of negative numbers too."""
power = _binary("pow")
"""First number to the power of the second."""


def cube(x: Any) -> Any:
    """Compute the third power of numbers as two products."""
    return x * x * x


def angle_of(z: Any) -> Any:
    """Compute the angles of complex numbers [rad], in [-pi, pi]."""
    return arctan2(np.imag(z), np.real(z))


def angle_between(z: Any, w: Any) -> Any:
    """Compute the angles by which complex numbers z are turned against w [rad], in [-pi, pi]."""
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
