"""Products of matrices and vectors, and their norms, with the same bits on every processor.

Those of numpy's `@` and `linalg` come from a library that adds up in another order on every class of processors.
"""

from __future__ import annotations

from ctypes import c_int64, c_void_p
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.native import function

SMALL = 4096
"""Multiplications up to which numpy's `einsum` is quicker, because it begins sooner than a compiled function."""
_SUBSCRIPTS = {
    (1, 1): "i,i->",
    (1, 2): "i,...ij->...j",
    (2, 1): "...ij,j->...i",
    (2, 2): "...ij,...jk->...ik",
}


def product(first: ArrayLike, *others: ArrayLike) -> Any:
    """Multiply matrices from left to right, as `@` does.

    Args:
        first: a vector, a matrix or a stack of matrices.
        others: factors; stacks are broadcast.
    """
    result = np.asarray(first, dtype=np.float64)
    for factor in others:
        other = np.asarray(factor, dtype=np.float64)
        dimensions = min(result.ndim, 2), min(other.ndim, 2)
        work = other.size * (result.shape[-2] if result.ndim > 1 else 1)
        if max(work, result.size * (other.shape[-1] if other.ndim > 1 else 1)) <= SMALL:
            result = np.einsum(_SUBSCRIPTS[dimensions], result, other)
        else:
            result = _compiled_product(result, other)
    return result


def _compiled_product(a: FloatArray, b: FloatArray) -> Any:
    """Multiply two stacks of matrices in compiled code."""
    one = a[None] if a.ndim == 1 else a
    other = b[:, None] if b.ndim == 1 else b
    (n, k), m = one.shape[-2:], other.shape[-1]
    if other.shape[-2] != k:
        raise ValueError(f"shapes {a.shape} and {b.shape} have no product")
    stack = one.shape[:-2] or other.shape[:-2]
    if one.ndim > 2 and other.ndim > 2:
        stack = np.broadcast_shapes(one.shape[:-2], other.shape[:-2])
    out = np.empty((*stack, n, m))
    count = out.size // max(1, n * m)
    one, other = _flat(one, stack), _flat(other, stack)
    factor = c_void_p, c_int64, c_int64, c_int64
    compiled = function("products", *[c_int64] * 4, *factor, *factor, c_void_p)
    compiled(*(count, n, k, m), *_place(one), *_place(other), out.ctypes.data)
    if a.ndim == 1:
        out = out[..., 0, :]
    return out[..., 0] if b.ndim == 1 else out


def _flat(factor: FloatArray, stack: tuple[int, ...]) -> FloatArray:
    """View a factor as a matrix or as one stack of matrices, copied where strides alone cannot say it."""
    if factor.ndim == 2 or (factor.ndim == 3 and factor.shape[:-2] == stack):
        return factor
    every = np.broadcast_to(factor, (*stack, *factor.shape[-2:]))
    return every.reshape(-1, *factor.shape[-2:])


def _place(factor: FloatArray) -> tuple[int, ...]:
    """Return the address of a factor and the strides of its stack, rows and columns in bytes."""
    return factor.ctypes.data, *(0,) * (3 - factor.ndim), *factor.strides


def norm(x: ArrayLike, axis: int | tuple[int, ...] | None = None, keepdims: bool = False) -> Any:
    """Compute Euclidean lengths along axes, or of all numbers together."""
    values = np.asarray(x, dtype=np.float64)
    return np.sqrt(np.sum(values * values, axis=axis, keepdims=keepdims))
