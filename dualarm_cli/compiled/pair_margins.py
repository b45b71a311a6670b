"""The compiled functions of `src/pair_margins.c`: how far pairs of a robot's solids are apart in many postures."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.native import PointerStruct, library, numbers, pointer, whole

_pointer, _int64, _double = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
CAPSULE, PLANE, BOX = range(3)
"""What the second solid of a pair is."""
FRAME, SEGMENT = 12, 6
"""Numbers of a frame and of a capsule."""


class _Arrays(PointerStruct):
    """Members by their names."""

    def put(self, **arrays: NDArray[np.float64] | NDArray[np.int64]) -> None:
        """Points members at arrays."""
        assert set(arrays) <= {name for name, *_ in self._fields_}  # others would be no pointers
        own = {
            name: whole(array) if array.dtype.kind in "ib" else numbers(array)
            for name, array in arrays.items()
        }
        for name, array in own.items():
            setattr(self, name, pointer(array).value)
        self.held = tuple(own.values())


class JointSteps(_Arrays):
    """A robot's joints: `Tree` in C."""

    _fields_ = tuple((name, _pointer) for name in ("parent", "column", "slides", "R", "p"))
    count: int
    """Number of joints."""
    last: int
    """The highest column of one."""

    @classmethod
    def of(
        cls, parent: IntArray, column: IntArray, slides: IntArray, R: FloatArray, p: FloatArray
    ) -> JointSteps:
        """Returns j joints, the root link first; see `JointTree`.

        Args:
            parent: the joint before each, shape (j,).
            column: of its position, shape (j,).
            slides: whether it slides, shape (j,).
            R: rotation before its motion, shape (j, 3, 3).
            p: translation before its motion [m], shape (j, 3).
        """
        own = cls()
        own.put(parent=parent, column=column, slides=slides, R=R, p=p)
        own.count, own.last = len(parent), int(column.max())
        return own


class SolidPairs(_Arrays):
    """Pairs of solids: `Group` in C."""

    _fields_ = (
        *(
            (name, _pointer)
            for name in (
                *("joint", "capsule_joint", "center", "half", "one", "kind", "other"),
                *("slack", "ball", "rough", "normal"),
                *("box_joint", "axes", "box_center", "box_half"),
            )
        ),
        *((name, _int64) for name in ("joints", "capsules", "pairs")),
    )

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.float64] | NDArray[np.int64]]) -> SolidPairs:
        """Returns pairs.

        Args:
            arrays: c capsules, `capsule_joint` (c,), `center` and `half` (c, 3); q pairs of a capsule `one` and an
                `other` of a `kind` (CAPSULE, PLANE, BOX), with `slack`, `ball` [m] and `rough`, (q,); planes' `normal`
                (…, 3); boxes' `box_joint`, `axes` (…, 3, 3), `box_center` and `box_half` (…, 3) [m]; `joint` has those
                whose frames are needed, rising, without the root link.
        """
        own = cls(
            joints=len(arrays["joint"]),
            capsules=len(arrays["capsule_joint"]),
            pairs=len(arrays["one"]),
        )
        own.put(**arrays)
        return own


def pair_margins(
    joints: JointSteps, pairs: SolidPairs, position: FloatArray, enough: float, rough: int
) -> tuple[FloatArray, FloatArray]:
    """Returns the least margin of all pairs that are not rough, shape (n,), and those of rough ones, (rough, n) [m].

    Args:
        joints: the robot's.
        pairs: of its solids.
        position: all joints [rad, m], shape (n, columns).
        enough: margins that balls around capsules show to be greater are not computed closely [m].
        rough: number of rough pairs.
    """
    given = numbers(position)
    n, columns = given.shape
    assert columns > joints.last  # or columns would be read that there are not
    least, closer = np.empty(n), np.empty((rough, n))
    frames = np.empty((joints.count, FRAME))
    capsules = np.empty((max(1, pairs.capsules), SEGMENT))
    library().pair_margins(
        byref(joints),
        byref(pairs),
        pointer(given),
        _int64(columns),
        _int64(n),
        _double(enough),
        pointer(frames),
        pointer(capsules),
        pointer(least),
        pointer(closer),
    )
    return least, closer
