"""The compiled functions of `src/pair_margins.c`: how far pairs of a robot's solids are apart in many postures."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.native import PointerStruct, library, numbers, pointer, whole
from dualarm_cli.records import dataclass

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
        *((name, _int64) for name in ("joints", "capsules", "pairs", "roughs")),
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
            roughs=int(arrays["rough"].max(initial=-1)) + 1,
        )
        own.put(**arrays)
        return own


@dataclass(frozen=True)
class Scenes:
    """Pairs of a group that count, by scene."""

    first: IntArray
    """Offsets of each scene's pairs in `listed`, and its length, shape (s + 1,)."""
    listed: IntArray
    """Numbers of pairs, scene by scene."""

    def of(self, scene: int) -> list[int]:
        """Return the numbers of the pairs of a scene."""
        found: list[int] = self.listed[self.first[scene] : self.first[scene + 1]].tolist()
        return found


def pair_margins(
    joints: JointSteps,
    pairs: SolidPairs,
    position: FloatArray,
    enough: float,
    scenes: tuple[Scenes, IntArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Returns the least margin of all pairs that are not rough, shape (n,), and those of rough ones, (rough, n) [m].

    Args:
        joints: the robot's.
        pairs: of its solids.
        position: all joints [rad, m], shape (n, columns).
        enough: margins that balls around capsules show to be greater are not computed closely [m].
        scenes: which pairs count in which scene, and the scene of each row, shape (n,); None: all pairs. Margins of
            rough pairs that do not count are infinite.
    """
    given = numbers(position)
    n, columns = given.shape
    assert columns > joints.last  # or columns would be read that there are not
    least, closer = np.empty(n), np.empty((pairs.roughs, n))
    frames = np.empty((joints.count, FRAME))
    capsules = np.empty((max(1, pairs.capsules), SEGMENT))
    own: list[IntArray] = []
    if scenes is not None:
        lists, scene = scenes
        assert not n or 0 <= scene.min() <= scene.max() < len(lists.first) - 1
        own = [whole(array) for array in (scene, lists.first, lists.listed)]
    library().pair_margins(
        byref(joints),
        byref(pairs),
        pointer(given),
        _int64(columns),
        _int64(n),
        *([pointer(array) for array in own] or [_pointer()] * 3),
        _double(enough),
        pointer(frames),
        pointer(capsules),
        pointer(least),
        pointer(closer),
    )
    return least, closer
