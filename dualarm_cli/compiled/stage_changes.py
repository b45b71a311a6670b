"""The compiled function of `src/stage_changes.c`: what changes of an order of two arms' stages are worth."""

from __future__ import annotations

import ctypes
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.compiled import library, pointer
from dualarm_cli.geometry.arrays import FloatArray, IntArray

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64


class PairedLengths(ctypes.Structure):
    """Lengths of stages: `Problem` in C."""

    _fields_ = (
        ("length", _pointer * 2),
        ("apart", _pointer),
        ("turns_back", _pointer),
        ("stops", _int64),
        ("angles", _int64),
    )
    held: tuple[object, ...] = ()

    @classmethod
    def of(
        cls,
        length: tuple[FloatArray, FloatArray],
        apart: NDArray[np.floating] | None,
        turns_back: FloatArray,
    ) -> PairedLengths:
        """Returns the lengths.

        Args:
            length: by arm, as `StageProblem.length` has them [s], shape (s + 1, s + 2, f, f).
            apart: as `StageProblem.apart` has it [s], shape (s + 2, s + 2, f).
            turns_back: how long the platform takes back from each angle [s], shape (f,).
        """
        held = tuple(np.ascontiguousarray(x, dtype=np.float64) for x in (*length, turns_back))
        near = None if apart is None else np.ascontiguousarray(apart, dtype=np.float32)
        one, other, back = (pointer(x).value for x in held)
        place = None if near is None else pointer(near).value
        own = cls((_pointer * 2)(one, other), place, back, len(length[0]) - 1, len(turns_back))
        own.held = (*held, near)
        return own


class _Line(ctypes.Structure):
    """`Line` in C."""

    _fields_ = tuple((name, _pointer) for name in ("rows", "came", "next", "angle", "cost", "sum"))


def change_worths(
    lengths: PairedLengths,
    line: tuple[IntArray, IntArray, IntArray, IntArray, FloatArray, FloatArray],
    first: IntArray,
    rows: IntArray,
) -> tuple[FloatArray, IntArray, IntArray]:
    """Returns by how much all is done later [s], (b,), the angles then, (b, w), and the last stage that changes, (b,).

    Args:
        lengths: of stages.
        line: of all n stages, start and way back included: stops, the stops before, the arms' next stages, (n, 2) each;
            angles, lengths [s], (n,) each; sums of lengths before each [s], (n + 1,).
        first: the first stage of each change, shape (b,).
        rows: the stops of its stages then, shape (b, w, 2).

    Raises:
        ValueError: there are more angles, or stages in a change, than the function has room for.
    """
    b, w, _ = rows.shape
    held = [np.ascontiguousarray(x) for x in (*line, first, rows)]
    places = [pointer(x) for x in held]
    delta, angles = np.empty(b), np.empty((b, w), dtype=np.int64)
    last = np.empty(b, dtype=np.int64)
    found = (pointer(x) for x in (delta, angles, last))
    sizes = _int64(b), _int64(w)
    if library().change_worths(
        byref(lengths), byref(_Line(*places[:6])), *places[6:], *sizes, *found
    ):
        raise ValueError(f"{lengths.angles} angles, {w} stages")
    return delta, angles, last
