"""Products of matrices and vectors, and their norms, with the same bits on every processor.

Those of numpy's `@` and `linalg` come from a library that adds up in another order on every class of processors.
"""

from __future__ import annotations

from ctypes import c_int64, c_void_p
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.native import library

SMALL = 256
"""Multiplications up to which a single product is numpy's `einsum`: it begins sooner than a compiled function."""


def product(first: ArrayLike, *others: ArrayLike) -> Any:
    """Multiply matrices from left to right, as `@` does.

    Args:
        first: a vector, a matrix or a stack of matrices.
        others: factors; stacks are broadcast.
    """
    result = np.asarray(first, dtype=np.float64)
    for factor in others:
        other = np.asarray(factor, dtype=np.float64)
        if result.ndim <= 2 and other.ndim <= 2 and result.size * other.shape[-1] <= SMALL:
            result = np.einsum(_SUBSCRIPTS[result.ndim, other.ndim], result, other)
        else:
            result = _stacked(result, other)
    return result


_SUBSCRIPTS = {(1, 1): "i,i->", (1, 2): "i,ij->j", (2, 1): "ij,j->i", (2, 2): "ij,jk->ik"}


@cache
def _products() -> Any:
    """Look up the compiled product."""
    found = library().dualarm_products
    found.argtypes, found.restype = [*[c_int64] * 4, *[c_void_p] * 5], None
    return found


def _stacked(a: FloatArray, b: FloatArray) -> FloatArray:
    """Multiply two stacks of matrices."""
    one = a[None] if a.ndim == 1 else a
    other = b[:, None] if b.ndim == 1 else b
    stack = one.shape[:-2]
    if stack != other.shape[:-2]:
        stack = np.broadcast_shapes(stack, other.shape[:-2])
    (n, k), m = one.shape[-2:], other.shape[-1]
    if other.shape[-2] != k:
        raise ValueError(f"shapes {a.shape} and {b.shape} have no product")
    out = np.empty((*stack, n, m))
    count = out.size // max(1, n * m)
    one, other = _flat(one, stack, count), _flat(other, stack, count)
    strides = np.array([one.strides, other.strides])
    where = strides.ctypes.data
    _products()(
        *(count, n, k, m, one.ctypes.data, where),
        *(other.ctypes.data, where + 3 * strides.itemsize, out.ctypes.data),
    )
    if b.ndim == 1:
        out = out[..., 0]
    return out[..., 0, :] if a.ndim == 1 and b.ndim > 1 else out[..., 0] if a.ndim == 1 else out


def _flat(factor: FloatArray, stack: tuple[int, ...], count: int) -> FloatArray:
    """View a factor as one stack of `count` matrices, copied where strides alone cannot say it."""
    if factor.ndim == 3 and len(factor) == count:
        return factor
    if factor.size == factor.shape[-2] * factor.shape[-1]:
        return np.broadcast_to(factor.reshape(factor.shape[-2:]), (count, *factor.shape[-2:]))
    return np.broadcast_to(factor, (*stack, *factor.shape[-2:])).reshape(-1, *factor.shape[-2:])


def norm(x: ArrayLike, axis: int | tuple[int, ...] | None = None, keepdims: bool = False) -> Any:
    """Compute Euclidean lengths along axes, or of all numbers together."""
    values = np.asarray(x, dtype=np.float64)
    return np.sqrt(np.sum(values * values, axis=axis, keepdims=keepdims))
