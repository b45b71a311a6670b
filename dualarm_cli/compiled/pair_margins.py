"""Binding of `src/pair_margins.c`: margins of pairs of a robot's solids in many postures."""

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
"""Kinds of the second solid of a pair."""
FRAME, SEGMENT = 12, 6
"""Sizes of a frame and of a capsule in doubles."""


class _Arrays(PointerStruct):
    """Structure with array members that are set by name."""

    def put(self, **arrays: NDArray[np.float64] | NDArray[np.int64]) -> None:
        """Set members to the addresses of arrays, which are kept alive."""
        assert set(arrays) <= {
            name for name, *_ in self._fields_
        }  # an unknown name would set an attribute that C does not see
        converted = {
            name: whole(array) if array.dtype.kind in "ib" else numbers(array)
            for name, array in arrays.items()
        }
        for name, array in converted.items():
            setattr(self, name, pointer(array).value)
        self.held = tuple(converted.values())


class JointSteps(_Arrays):
    """Joints of a robot: `Tree` in C."""

    _fields_ = tuple((name, _pointer) for name in ("parent", "column", "slides", "R", "p"))
    count: int
    """Number of joints."""
    last: int
    """Highest column of a joint."""

    @classmethod
    def of(
        cls, parent: IntArray, column: IntArray, slides: IntArray, R: FloatArray, p: FloatArray
    ) -> JointSteps:
        """Build the structure of j joints, the root link first; see `JointTree`.

        Args:
            parent: parent joints, shape (j,).
            column: columns of the joint positions, shape (j,).
            slides: whether joints are prismatic, shape (j,).
            R: rotations in the parent at zero, shape (j, 3, 3).
            p: translations in the parent at zero [m], shape (j, 3).
        """
        steps = cls()
        steps.put(parent=parent, column=column, slides=slides, R=R, p=p)
        steps.count, steps.last = len(parent), int(column.max())
        return steps


class SolidPairs(_Arrays):
    """Pairs of solids: `Pairs` in C."""

    _fields_ = (
        *(
            (name, _pointer)
            for name in (
                *("joint", "capsule_joint", "center", "half", "capsule", "kind", "solid"),
                *("slack", "ball", "rough", "normal"),
                *("box_joint", "axes", "box_center", "box_half"),
            )
        ),
        *((name, _int64) for name in ("joints", "capsules", "pairs", "roughs")),
    )

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[np.float64] | NDArray[np.int64]]) -> SolidPairs:
        """Build the structure of pairs.

        Args:
            arrays: c capsules, `capsule_joint` (c,), `center` and `half` (c, 3); q pairs of a `capsule` and a `solid`
                of a `kind` (CAPSULE, PLANE, BOX), with `slack`, `ball` [m] and `rough`, (q,); planes' `normal`
                (…, 3); boxes' `box_joint`, `axes` (…, 3, 3), `box_center` and `box_half` (…, 3) [m]; `joint` lists the
                joints whose frames are required, ascending, without the root link.
        """
        pairs = cls(
            joints=len(arrays["joint"]),
            capsules=len(arrays["capsule_joint"]),
            pairs=len(arrays["capsule"]),
            roughs=int(arrays["rough"].max(initial=-1)) + 1,
        )
        pairs.put(**arrays)
        return pairs


@dataclass(frozen=True)
class Scenes:
    """Checked pairs of a group by scene."""

    first: IntArray
    """Offsets of the scenes in `listed`, and its length, shape (s + 1,)."""
    listed: IntArray
    """Indices of pairs, scene by scene."""

    def of(self, scene: int) -> list[int]:
        """Return the indices of the pairs of a scene."""
        pairs: list[int] = self.listed[self.first[scene] : self.first[scene + 1]].tolist()
        return pairs


def pair_margins(
    joints: JointSteps,
    pairs: SolidPairs,
    position: FloatArray,
    enough: float,
    scenes: tuple[Scenes, IntArray] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Compute the least margin of the exact pairs and the margins of the rough pairs [m].

    Args:
        joints: joints of the robot.
        pairs: pairs of its solids.
        position: joint positions [rad, m], shape (n, columns).
        enough: margin from bounding balls from which on no closer one is computed [m].
        scenes: pairs of each scene, and the scene of each row, shape (n,); None checks all pairs.

    Returns:
        Least margins of the pairs that are not rough, shape (n,); margins of the rough pairs, shape (rough, n),
        infinite for pairs that are not in the row's scene.
    """
    rows = numbers(position)
    n, columns = rows.shape
    assert columns > joints.last  # C does not check its bounds
    least, rough = np.empty(n), np.empty((pairs.roughs, n))
    frames = np.empty((joints.count, FRAME))
    capsules = np.empty((max(1, pairs.capsules), SEGMENT))
    selection: list[IntArray] = []
    if scenes is not None:
        lists, scene = scenes
        assert not n or 0 <= scene.min() <= scene.max() < len(lists.first) - 1
        selection = [whole(array) for array in (scene, lists.first, lists.listed)]
    library().pair_margins(
        byref(joints),
        byref(pairs),
        pointer(rows),
        _int64(columns),
        _int64(n),
        *([pointer(array) for array in selection] or [_pointer()] * 3),
        _double(enough),
        pointer(frames),
        pointer(capsules),
        pointer(least),
        pointer(rough),
    )
    return least, rough
