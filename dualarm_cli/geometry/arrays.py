"""Array types, different values, and the one way to freeze an array."""

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
    """Returns the different values of an array, ascending.

    Numpy's function alone would load its masked arrays first, a fiftieth of a short plan's time; counting, it does not.
    """
    found: NDArray[T] = np.unique(values, return_counts=True)[0]
    return found


def readonly(values: ArrayLike) -> FloatArray:
    """Returns a read-only float copy of `values`, so that a frozen dataclass is frozen through.

    What is such a copy already is returned as it is.
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
    """Returns an array of one's own, made read-only without a copy."""
    values.setflags(write=False)
    return values


def best_of_each(kinds: IntArray, most: int, count: int | None) -> IntArray:
    """Reorder rows that are sorted, best first: up to `most` of each kind, then the others.

    Args:
        kinds: of the rows, shape (b,).
        most: rows of a kind that come first.
        count: how many rows are kept; None for all.
    """
    order = np.argsort(kinds, kind="stable")
    first = np.searchsorted(kinds[order], kinds)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    early = rank - first < most
    return np.concatenate([np.flatnonzero(early), np.flatnonzero(~early)])[:count]
