"""Array types, and small helpers to freeze, deduplicate and reorder arrays."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
T = TypeVar("T", bound="np.generic[Any]")


def distinct(values: NDArray[T]) -> NDArray[T]:
    """Select the different values of an array, ascending.

    Numpy's function alone would load its masked arrays first, a fiftieth of a short plan's time; counting, it does not.
    """
    values_once: NDArray[T] = np.unique(values, return_counts=True)[0]
    return values_once


def readonly(values: ArrayLike) -> FloatArray:
    """Copy values to a read-only float array.

    An array that is such a copy already is returned unchanged.
    """
    if (
        isinstance(values, np.ndarray)
        and values.dtype == np.float64
        and values.base is None
        and not values.flags.writeable
    ):
        return values
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def frozen(values: FloatArray) -> FloatArray:
    """Make a new array read-only without a copy."""
    values.setflags(write=False)
    return values


def best_of_each(kinds: IntArray, most: int, count: int | None) -> IntArray:
    """Reorder sorted rows: at most `most` of each kind first, then the others.

    Args:
        kinds: kind of each row, best row first, shape (b,).
        most: number of rows of a kind that come first.
        count: number of rows to return; None for all.
    """
    order = np.argsort(kinds, kind="stable")
    first = np.searchsorted(kinds[order], kinds)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    early = rank - first < most
    return np.concatenate([np.flatnonzero(early), np.flatnonzero(~early)])[:count]
