"""Array types and the one way to freeze an array."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
SingleArray = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


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
