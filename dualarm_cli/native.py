"""The library of compiled functions, and how arrays are handed to it.

`compiled/src` has their C; the package's build compiles it with the compiler that pip brings, for x86-64 processors
since 2009. All arithmetic is that of IEEE 754 in the order written, and sines and the like are linked into the
library: results are the same on all of these processors.
"""

from __future__ import annotations

import ctypes
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LIBRARY = Path(__file__).parent / "compiled" / "built" / "libdualarm.so"
"""Path of the library that the build makes of `compiled/src`."""

_UFUNC = ctypes.PYFUNCTYPE(
    ctypes.py_object,
    *[ctypes.c_void_p] * 2,
    ctypes.c_char_p,
    *[ctypes.c_int] * 4,
    *[ctypes.c_char_p] * 2,
    ctypes.c_int,
    ctypes.c_char_p,
)
"""Type of numpy's `PyUFunc_FromFuncAndDataAndSignature`."""
_HELD: list[tuple[Any, ...]] = []


@cache
def library() -> ctypes.CDLL:
    """Load the compiled functions.

    Raises:
        DualArmError: they were not built.
    """
    try:
        return ctypes.CDLL(str(LIBRARY))
    except OSError as error:
        # All arrays stand on this module: it loads the errors and their sentences only to raise one.
        from dualarm_cli.errors import DualArmError

        raise DualArmError(
            f"the compiled functions cannot be loaded ({error}); install dualarm again with pip, which builds them"
        ) from error


@cache
def function(name: str, *types: Any) -> Any:
    """Look up a compiled function without a result, by the types of its arguments.

    Args:
        name: in C, without `dualarm_` before it.
        types: of ctypes.
    """
    found = getattr(library(), f"dualarm_{name}")
    found.argtypes, found.restype = types, None
    return found


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return the address of a contiguous array for a compiled function.

    Args:
        array: has to outlive the call.
    """
    assert array.flags.c_contiguous  # rows are expected one after the other
    return ctypes.c_void_p(array.ctypes.data)


@cache
def universal(name: str, inputs: int, signature: str | None = None) -> Any:
    """Make numpy's universal function of a compiled loop over float64 numbers.

    It broadcasts, takes arrays that lie in memory in any way, and begins sooner than a call by ctypes.

    Args:
        name: of the loop, without its prefix.
        inputs: number of arguments; there is one result.
        signature: sizes of arguments and result that are no single numbers, as numpy writes them.

    Raises:
        DualArmError: the compiled functions were not built.
    """
    # By numpy's C interface, a table of functions in which each keeps its place, found where C code finds it.
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = ctypes.POINTER(ctypes.c_void_p), [ctypes.py_object, ctypes.c_char_p]
    of_loops = get(import_module("numpy._core._multiarray_umath")._UFUNC_API, None)[31]
    loops = (ctypes.c_void_p * 1)(ctypes.cast(library()[f"dualarm_{name}"], ctypes.c_void_p).value)
    data, types = (ctypes.c_void_p * 1)(), bytes([np.dtype(np.float64).num] * (inputs + 1))
    text, sizes = name.encode(), signature.encode() if signature else None
    # Numpy reads them for as long as the function lives.
    _HELD.append((loops, data, types, text))
    return _UFUNC(of_loops)(loops, data, types, 1, inputs, 1, -1, text, None, 0, sizes)


class PointerStruct(ctypes.Structure):
    """A structure of pointers that keeps the arrays they point into."""

    held: tuple[Any, ...] = ()


def numbers(array: np.ndarray) -> NDArray[np.float64]:
    """Convert an array to contiguous doubles for compiled functions."""
    return np.ascontiguousarray(array, dtype=np.float64)


def whole(array: np.ndarray) -> NDArray[np.int64]:
    """Convert an array to contiguous 64-bit integers for compiled functions."""
    return np.ascontiguousarray(array, dtype=np.int64)
