"""Lines, transfers and splines: what the compiled functions for them take, as they take it."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.native import PointerStruct, library, numbers, pointer

Array = NDArray[np.float64]
Knots = tuple[Array, Array, Array, Array]
"""Times (k,), positions, velocities and accelerations, (k, n) each, at k knots of n joints."""

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64
MORE_KNOTS = 16
"""Lines have no more knots beyond those that are asked for."""


class Path(PointerStruct):
    """A sampled path and the limits of its joints: `Path` in C."""

    _fields_ = (
        ("position", _pointer),
        ("velocity", _pointer),
        ("acceleration", _pointer),
        ("jerk", _pointer),
        ("samples", _int64),
        ("joints", _int64),
    )

    @classmethod
    def of(cls, position: Array, limits: Sequence[Array]) -> Path:
        """Returns a path, or the first of several lines in one array.

        Args:
            position: joints at equidistant gridpoints [rad], shape (m, n) or (lines, m, n), m at least 8.
            limits: of velocity, acceleration and jerk, which may be infinite, shape (n,) each.
        """
        arrays = [numbers(array) for array in (position, *limits)]
        own = cls(*map(pointer, arrays), *position.shape[-2:])
        own.held = tuple(arrays)
        return own


class _Motion(ctypes.Structure):
    _fields_ = tuple((name, _pointer) for name in ("time", "position", "velocity", "acceleration"))


class _Transfer(ctypes.Structure):
    _fields_ = (
        *(
            (name, _pointer)
            for name in (
                *("start", "leaving", "goal", "arriving"),
                *("limit", "length", "acceleration", "jerk"),
            )
        ),
        ("duration", ctypes.c_double),
        ("joints", _int64),
    )


class _Chain(ctypes.Structure):
    _fields_ = (("steps", _pointer), ("slides", _pointer), ("tip", _pointer), ("joints", _int64))


class _Launch(ctypes.Structure):
    _fields_ = tuple((name, ctypes.c_double) for name in ("constant", "cruise", "inner", "cut"))


def rest_line(path: Path, knots: int) -> Knots:
    """Returns the fastest profile of a family from rest to rest.

    Args:
        path: the line.
        knots: how many knots at least.

    Raises:
        MemoryError: there is none.
    """
    arrays, motion = _motion(knots + MORE_KNOTS, path.joints)
    count = library().rest_line(byref(path), _int64(knots), byref(motion))
    return _cut(arrays, count)


def launched_line(
    path: Path, shape: tuple[float, float, float, float], coordinate: int, knots: int
) -> Knots:
    """Returns a profile from rest that passes the far end in motion.

    Args:
        path: the line.
        shape: constant, cruise, inner and cut, see `timing.launch.Launch`.
        coordinate: the path coordinate that it shapes.
        knots: about how many knots.

    Raises:
        MemoryError: there is none.
    """
    arrays, motion = _motion(knots + MORE_KNOTS, path.joints)
    arguments = byref(_Launch(*shape)), _int64(coordinate), _int64(knots), byref(motion)
    return _cut(arrays, library().launched_line(byref(path), *arguments))


def launches(
    path: Path, profiles: Array, cuts: Array, compared: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Returns estimates of profiles that pass a line's far end, each with all cuts.

    Args:
        path: the line, of n joints.
        profiles: constant, cruise and inner, shape (p, 3).
        cuts: shape (c,).
        compared: the cut with which path coordinates are compared.

    Returns:
        The fastest coordinate of each profile, (p,); times [s], (p, c); velocities and accelerations at the far end,
        (p, c, n).

    Raises:
        MemoryError: there is none.
    """
    counts = len(profiles), len(cuts)
    coordinate = np.zeros(len(profiles), dtype=np.int64)
    time, velocity, acceleration = (
        np.empty(shape) for shape in (counts, (*counts, path.joints), (*counts, path.joints))
    )
    asked = pointer(profiles), _int64(counts[0]), pointer(cuts), _int64(counts[1])
    found = map(pointer, (coordinate, time, velocity, acceleration))
    if library().launches(byref(path), *asked, ctypes.c_double(compared), *found):
        raise MemoryError
    return coordinate, time, velocity, acceleration


def launched_lines(
    lines: Path, profiles: Array, cuts: Array, compared: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Returns estimates of many lines that pass their far ends in motion, each in several ways of its own.

    Args:
        lines: the first of them, of n joints, see `Path.of`.
        profiles: constant, cruise and inner, shape (lines, ways, 3).
        cuts: shape (lines, ways).
        compared: the cut with which path coordinates are compared.

    Returns:
        Coordinates and times [s], (lines, ways); velocities and accelerations at the far ends, (lines, ways, n).

    Raises:
        MemoryError: there is none.
    """
    counts = cuts.shape
    assert profiles.shape == (*counts, 3)
    assert lines.held[0].size == counts[0] * lines.samples * lines.joints
    coordinate, time = np.empty(counts, dtype=np.int64), np.empty(counts)
    velocity, acceleration = (np.empty((*counts, lines.joints)) for _ in range(2))
    if cuts.size:
        asked = *map(_int64, counts), pointer(profiles), pointer(cuts), ctypes.c_double(compared)
        found = map(pointer, (coordinate, time, velocity, acceleration))
        if library().launched_lines(byref(lines), *asked, *found):
            raise MemoryError
    return coordinate, time, velocity, acceleration


def transfer_knots(
    ends: tuple[Array, Array, Array, Array], limit: Array, phases: Sequence[Array], duration: float
) -> Knots:
    """Returns the knots of a transfer of n joints by phases of constant jerk.

    Args:
        ends: positions at the start [rad], shape (n,), velocities and accelerations there, shape (2, n), and the same
            at the goal, where all end exactly.
        limit: of the jerk, shape (n,); only where it is infinite accelerations jump, at two knots at one time.
        phases: lengths [s], accelerations at their starts and jerks throughout, shape (n, 7) each.
        duration: when every motion ends [s].

    Raises:
        MemoryError: there is none.
    """
    numbers = np.concatenate([x.ravel() for x in (*ends, limit, *phases)])
    n, begin = len(limit), numbers.ctypes.data
    first = (begin + numbers.itemsize * n * k for k in (0, 1, 3, 4, 6, 7, 14, 21))
    arrays, motion = _motion(2 * (8 * n + 2), n)
    asked = _Transfer(*first, duration, n)
    return _cut(arrays, library().transfer_knots(byref(asked), byref(motion)))


def stays_between(phases: Array, lower: Array, upper: Array) -> bool:
    """Returns whether joints stay between positions in all their phases of constant jerk.

    Args:
        phases: lengths, and positions, velocities, accelerations and jerks at the starts, shape (n, 5, 7).
        lower: least positions, shape (n,).
        upper: greatest positions, shape (n,).
    """
    held = [numbers(x) for x in (phases, lower, upper)]
    return bool(library().stays_between(*map(pointer, held), _int64(len(phases))))


def line_deviation(
    chain: tuple[Array, NDArray[np.bool_], Array], ends: Array, knots: Knots, parts: int
) -> tuple[float, float]:
    """Returns how far a tool leaves the line between two postures [m], and how far it turns from the first one [rad].

    Args:
        chain: of n joints along or about their z axes: rotation and position [m] of each joint at zero in the one
            before, and of the flange in the last one, (n + 1, 3, 4); which of them slide, (n,); the tool in the flange
            [m], (3,).
        ends: joints at the line's ends [rad], shape (2, n).
        knots: of the motion.
        parts: how many instants of each interval are looked at.

    Raises:
        MemoryError: there is none.
    """
    slides = np.ascontiguousarray(chain[1], dtype=np.bool_)
    held = [numbers(x) for x in (chain[0], chain[2], ends, *knots)]
    steps, tip, ends_at, *at = map(pointer, held)
    joints, motion = _Chain(steps, pointer(slides), tip, len(slides)), _Motion(*at)
    distance, angle = ctypes.c_double(), ctypes.c_double()
    arguments = byref(joints), ends_at, byref(motion), _int64(len(knots[0])), _int64(parts)
    if library().line_deviation(*arguments, byref(distance), byref(angle)):
        raise MemoryError
    return distance.value, angle.value


def cubic_spline(
    time: Array, position: Array, first: Array | None, last: Array | None
) -> tuple[Array, Array, Array]:
    """Returns positions, velocities, accelerations at the knots of a C2 cubic spline.

    Args:
        time: knots [s], increasing, shape (k,).
        position: what to interpolate [rad], shape (k, n).
        first: velocities at the start [rad/s], shape (n,); None: at rest, and the second knot gives way.
        last: the same at the end.

    Raises:
        ValueError: fewer knots than 3, or than 4 with one end at rest, or than 5 with both.
        MemoryError: there is none.
    """
    if len(time) < 3 + (first is None) + (last is None):
        raise ValueError(f"{len(time)} knots are too few for a spline")
    q = np.array(position, dtype=np.float64, order="C")
    v, a = np.empty_like(q), np.empty_like(q)
    held = [None if x is None else numbers(x) for x in (time, first, last)]
    times, *ends = (None if x is None else pointer(x) for x in held)
    found = map(pointer, (q, v, a))
    if library().cubic_spline(times, *map(_int64, q.shape), *ends, *found):
        raise MemoryError
    return q, v, a


def largest_rates(time: Array, velocity: Array, acceleration: Array) -> Array:
    """Returns the largest |velocity|, |acceleration| and |jerk| of each joint between all knots, shape (3, n).

    Args:
        time: knots [s], shape (k,).
        velocity: at the knots [rad/s], shape (k, n).
        acceleration: at the knots [rad/s²], shape (k, n).
    """
    largest = np.empty((3, velocity.shape[1]))
    held = [numbers(x) for x in (time, velocity, acceleration)]
    library().largest_rates(*map(pointer, held), *map(_int64, velocity.shape), pointer(largest))
    return largest


def _motion(room: int, joints: int) -> tuple[Knots, _Motion]:
    """Returns arrays for so many knots, and where they are."""
    n, block = joints, np.empty(room * (1 + 3 * joints))
    q, v, a = block[room:].reshape(3, room, n)
    begin = block.ctypes.data
    rows = (begin + block.itemsize * room * (1 + k * n) for k in range(3))
    return (block[:room], q, v, a), _Motion(begin, *rows)


def _cut(arrays: Knots, count: int) -> Knots:
    """Returns the knots that there are."""
    if count == 0:
        raise MemoryError
    time, q, v, a = arrays
    return time[:count], q[:count], v[:count], a[:count]
