"""Library of compiled functions, and conversion of arrays for its calls.

`compiled/src` has the C code; the package's build compiles it with the compiler that pip brings, for x86-64 processors
since 2009. Arithmetic follows IEEE 754 in the order written, and elementary functions are linked into the library:
results are the same on all of these processors.
"""

from __future__ import annotations

import ctypes
import zlib
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LIBRARY = Path(__file__).parent / "compiled" / "built" / "libdualarm.so"
"""Path of the library built from `compiled/src`."""
SOURCES = LIBRARY.parents[1] / "src"
"""Folder of the C code in a source tree."""

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
        DualArmError: the library was not built, or from other sources than those in the source tree.
    """
    try:
        loaded = ctypes.CDLL(str(LIBRARY))
        check_sources(loaded)
    except (OSError, ValueError) as error:
        # Every array module imports this one: errors and their sentences are imported only to raise one.
        from dualarm_cli.errors import DualArmError

        raise DualArmError(
            f"the compiled functions cannot be loaded ({error}); install dualarm again with pip, which builds them"
        ) from error
    return loaded


def check_sources(loaded: ctypes.CDLL, folder: Path = SOURCES) -> None:
    """Compare the checksum in a library with its sources, which wheels do not have.

    Without this check a stale library crashes, or gives wrong bounds.

    Raises:
        ValueError: the library is built from other sources.
    """
    if not folder.is_dir():
        return
    kept = (path for path in sorted(folder.iterdir()) if path.suffix in (".c", ".h", ".zig"))
    checksum = zlib.crc32(b"".join(path.read_bytes() for path in kept))
    try:
        built = ctypes.c_uint.in_dll(loaded, "dualarm_sources").value
    except ValueError:
        built = None  # older than this check
    if built != checksum:
        raise ValueError("they are not built from the C code of this version")


@cache
def function(name: str, *types: Any) -> Any:
    """Look up a compiled function without a result, by the types of its arguments.

    Args:
        name: name in C, without the prefix `dualarm_`.
        types: argument types of ctypes.
    """
    compiled = getattr(library(), f"dualarm_{name}")
    compiled.argtypes, compiled.restype = types, None
    return compiled


class _ArrayInterface(ctypes.Structure):
    """Numpy's `PyArrayInterface`, the documented C structure behind `__array_struct__`."""

    _fields_ = (
        ("two", ctypes.c_int),
        ("dimensions", ctypes.c_int),
        ("kind", ctypes.c_char),
        ("item_size", ctypes.c_int),
        ("flags", ctypes.c_int),
        ("shape", ctypes.c_void_p),
        ("strides", ctypes.c_void_p),
        ("data", ctypes.c_void_p),
    )


_interface = ctypes.PYFUNCTYPE(ctypes.POINTER(_ArrayInterface), ctypes.py_object, ctypes.c_char_p)(
    ("PyCapsule_GetPointer", ctypes.pythonapi)
)


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Return the address of a contiguous array, in half of the time of `array.ctypes.data`.

    Args:
        array: array that outlives the call.
    """
    assert array.flags.c_contiguous  # compiled functions expect rows in order
    capsule = array.__array_struct__
    return ctypes.c_void_p(_interface(capsule, None).contents.data)


@cache
def universal(name: str, inputs: int, signature: str | None = None) -> Any:
    """Wrap a compiled loop over float64 numbers as a numpy universal function.

    It broadcasts, takes arrays of any memory layout, and starts faster than a call by ctypes.

    Args:
        name: name of the loop, without its prefix.
        inputs: number of arguments; there is one result.
        signature: core dimensions in numpy's notation; None for single numbers.

    Raises:
        DualArmError: the compiled functions were not built.
    """
    # Numpy's C interface is a table of functions with fixed places.
    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = ctypes.POINTER(ctypes.c_void_p), [ctypes.py_object, ctypes.c_char_p]
    of_loops = get(import_module("numpy._core._multiarray_umath")._UFUNC_API, None)[31]
    loops = (ctypes.c_void_p * 1)(ctypes.cast(library()[f"dualarm_{name}"], ctypes.c_void_p).value)
    data, types = (ctypes.c_void_p * 1)(), bytes([np.dtype(np.float64).num] * (inputs + 1))
    text, sizes = name.encode(), signature.encode() if signature else None
    # Numpy reads them as long as the function exists.
    _HELD.append((loops, data, types, text))
    return _UFUNC(of_loops)(loops, data, types, 1, inputs, 1, -1, text, None, 0, sizes)


class PointerStruct(ctypes.Structure):
    """C structure that keeps alive the arrays to which it points."""

    held: tuple[Any, ...] = ()


def numbers(array: np.ndarray) -> NDArray[np.float64]:
    """Convert an array to contiguous doubles for compiled functions."""
    return np.ascontiguousarray(array, dtype=np.float64)


def whole(array: np.ndarray) -> NDArray[np.int64]:
    """Convert an array to contiguous 64-bit integers for compiled functions."""
    return np.ascontiguousarray(array, dtype=np.int64)
