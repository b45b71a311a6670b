"""Bindings of the compiled functions for lines, launches, transfers and splines."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.native import PointerStruct, library, numbers, pointer

Array = NDArray[np.float64]
Knots = tuple[Array, Array, Array, Array]
"""Knots of n joints: times (k,), positions, velocities and accelerations, (k, n) each."""

_pointer, _int64 = ctypes.c_void_p, ctypes.c_int64
EXTRA_KNOTS = 16
"""Maximum number of knots of a line beyond the requested ones."""


class Path(PointerStruct):
    """Sampled joint path and joint limits: `Path` in C."""

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
        """Build a path, or the first one of several lines in one array.

        Args:
            position: joints at equidistant gridpoints [rad], shape (m, n) or (lines, m, n), m at least 8.
            limits: limits of velocity, acceleration and jerk (may be infinite), shape (n,) each.
        """
        arrays = [numbers(array) for array in (position, *limits)]
        path = cls(*map(pointer, arrays), *position.shape[-2:])
        path.held = tuple(arrays)
        return path


class _Motion(ctypes.Structure):
    _fields_ = tuple((name, _pointer) for name in ("time", "position", "velocity", "acceleration"))


class _Transfer(ctypes.Structure):
    _fields_ = (
        *(
            (name, _pointer)
            for name in (
                *("start", "start_rates", "goal", "goal_rates"),
                *("jerk_limit", "length", "acceleration", "jerk"),
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
    """Time a line from rest to rest by the fastest shape of a family.

    Args:
        path: the line.
        knots: minimum number of knots.

    Raises:
        MemoryError: out of memory.
    """
    arrays, motion = _motion(knots + EXTRA_KNOTS, path.joints)
    count = library().rest_line(byref(path), _int64(knots), byref(motion))
    return _cut(arrays, count)


def launched_line(
    path: Path, shape: tuple[float, float, float, float], coordinate: int, knots: int
) -> Knots:
    """Time a launch: a profile from rest that passes the far end in motion.

    Args:
        path: the line.
        shape: constant, cruise, inner and cut, see `timing.launch.Launch`.
        coordinate: index of the path coordinate.
        knots: approximate number of knots.

    Raises:
        MemoryError: out of memory.
    """
    arrays, motion = _motion(knots + EXTRA_KNOTS, path.joints)
    arguments = byref(_Launch(*shape)), _int64(coordinate), _int64(knots), byref(motion)
    return _cut(arrays, library().launched_line(byref(path), *arguments))


def launches(
    path: Path, profiles: Array, cuts: Array, compared: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Estimate launches of a line: every profile with every cut.

    Args:
        path: the line, of n joints.
        profiles: constant, cruise and inner, shape (p, 3).
        cuts: shape (c,).
        compared: cut at which path coordinates are compared.

    Returns:
        Fastest coordinates of the profiles, (p,); times [s], (p, c); velocities and accelerations at the far end,
        (p, c, n).

    Raises:
        MemoryError: out of memory.
    """
    counts = len(profiles), len(cuts)
    coordinate = np.zeros(len(profiles), dtype=np.int64)
    time, velocity, acceleration = (
        np.empty(shape) for shape in (counts, (*counts, path.joints), (*counts, path.joints))
    )
    arguments = pointer(profiles), _int64(counts[0]), pointer(cuts), _int64(counts[1])
    results = map(pointer, (coordinate, time, velocity, acceleration))
    if library().launches(byref(path), *arguments, ctypes.c_double(compared), *results):
        raise MemoryError
    return coordinate, time, velocity, acceleration


def launched_lines(
    lines: Path, profiles: Array, cuts: Array, compared: float
) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Estimate l launches of each of several lines.

    Args:
        lines: the first line, of n joints, see `Path.of`.
        profiles: constant, cruise and inner, shape (lines, l, 3).
        cuts: shape (lines, l).
        compared: cut at which path coordinates are compared.

    Returns:
        Coordinates and times [s], (lines, l); velocities and accelerations at the far ends, (lines, l, n).

    Raises:
        MemoryError: out of memory.
    """
    counts = cuts.shape
    assert profiles.shape == (*counts, 3)
    assert lines.held[0].size == counts[0] * lines.samples * lines.joints
    coordinate, time = np.empty(counts, dtype=np.int64), np.empty(counts)
    velocity, acceleration = (np.empty((*counts, lines.joints)) for _ in range(2))
    if cuts.size:
        arguments = (
            *map(_int64, counts),
            pointer(profiles),
            pointer(cuts),
            ctypes.c_double(compared),
        )
        results = map(pointer, (coordinate, time, velocity, acceleration))
        if library().launched_lines(byref(lines), *arguments, *results):
            raise MemoryError
    return coordinate, time, velocity, acceleration


def transfer_knots(
    ends: tuple[Array, Array, Array, Array],
    jerk_limit: Array,
    phases: Sequence[Array],
    duration: float,
) -> Knots:
    """Compute the knots of a transfer of n joints from phases of constant jerk.

    Args:
        ends: positions at the start [rad], shape (n,), velocities and accelerations there, shape (2, n), and the same
            at the goal, which the last knot reaches exactly.
        jerk_limit: jerk limits, shape (n,); accelerations may jump, at two knots at the same time, if infinite.
        phases: durations [s], accelerations at the starts and jerks, shape (n, 7) each.
        duration: duration of all joints' motions [s].

    Raises:
        MemoryError: out of memory.
    """
    numbers = np.concatenate([x.ravel() for x in (*ends, jerk_limit, *phases)])
    n, begin = len(jerk_limit), numbers.ctypes.data
    first = (begin + numbers.itemsize * n * k for k in (0, 1, 3, 4, 6, 7, 14, 21))
    arrays, motion = _motion(2 * (8 * n + 2), n)
    transfer = _Transfer(*first, duration, n)
    return _cut(arrays, library().transfer_knots(byref(transfer), byref(motion)))


def stays_between(phases: Array, lower: Array, upper: Array) -> bool:
    """Check that joints stay within position limits in phases of constant jerk.

    Args:
        phases: durations, and positions, velocities, accelerations and jerks at the starts, shape (n, 5, 7).
        lower: lower position limits, shape (n,).
        upper: upper position limits, shape (n,).
    """
    held = [numbers(x) for x in (phases, lower, upper)]
    return bool(library().stays_between(*map(pointer, held), _int64(len(phases))))


def line_deviation(
    chain: tuple[Array, NDArray[np.bool_], Array], ends: Array, knots: Knots, parts: int
) -> tuple[float, float]:
    """Compute a tool's deviation from the line between two postures [m], and its turn [rad].

    Args:
        chain: n joints along or about their z axes: poses of each joint at zero in its parent [m], and of the flange in
            the last joint, (n + 1, 3, 4); whether joints are prismatic, (n,); tool tip in the flange frame [m], (3,).
        ends: joints at the line's ends [rad], shape (2, n).
        knots: knots of the motion.
        parts: checked instants per interval.

    Raises:
        MemoryError: out of memory.
    """
    slides = np.ascontiguousarray(chain[1], dtype=np.bool_)
    held = [numbers(x) for x in (chain[0], chain[2], ends, *knots)]
    steps, tip, end_postures, *at = map(pointer, held)
    joints, motion = _Chain(steps, pointer(slides), tip, len(slides)), _Motion(*at)
    distance, angle = ctypes.c_double(), ctypes.c_double()
    arguments = byref(joints), end_postures, byref(motion), _int64(len(knots[0])), _int64(parts)
    if library().line_deviation(*arguments, byref(distance), byref(angle)):
        raise MemoryError
    return distance.value, angle.value


def cubic_spline(
    time: Array, position: Array, first: Array | None, last: Array | None
) -> tuple[Array, Array, Array]:
    """Solve a C2 cubic spline; return positions, velocities and accelerations at its knots.

    Args:
        time: knots [s], increasing, shape (k,).
        position: interpolated positions [rad], shape (k, n).
        first: velocities at the start [rad/s], shape (n,); None: at rest, and the second knot is free.
        last: velocities at the end [rad/s], shape (n,); None: at rest, and the last knot but one is free.

    Raises:
        ValueError: fewer than 3 knots, 4 with one end at rest, or 5 with both.
        MemoryError: out of memory.
    """
    if len(time) < 3 + (first is None) + (last is None):
        raise ValueError(f"{len(time)} knots are too few for a spline")
    q = np.array(position, dtype=np.float64, order="C")
    v, a = np.empty_like(q), np.empty_like(q)
    held = [None if x is None else numbers(x) for x in (time, first, last)]
    times, *ends = (None if x is None else pointer(x) for x in held)
    results = map(pointer, (q, v, a))
    if library().cubic_spline(times, *map(_int64, q.shape), *ends, *results):
        raise MemoryError
    return q, v, a


def largest_rates(time: Array, velocity: Array, acceleration: Array) -> Array:
    """Compute the largest |velocity|, |acceleration| and |jerk| of each joint, shape (3, n).

    Args:
        time: knots [s], shape (k,).
        velocity: at the knots [rad/s], shape (k, n).
        acceleration: at the knots [rad/s²], shape (k, n).
    """
    largest = np.empty((3, velocity.shape[1]))
    held = [numbers(x) for x in (time, velocity, acceleration)]
    library().largest_rates(*map(pointer, held), *map(_int64, velocity.shape), pointer(largest))
    return largest


def _motion(capacity: int, joints: int) -> tuple[Knots, _Motion]:
    """Allocate arrays for knots, and the structure of their addresses."""
    n, block = joints, np.empty(capacity * (1 + 3 * joints))
    q, v, a = block[capacity:].reshape(3, capacity, n)
    begin = block.ctypes.data
    rows = (begin + block.itemsize * capacity * (1 + k * n) for k in range(3))
    return (block[:capacity], q, v, a), _Motion(begin, *rows)


def _cut(arrays: Knots, count: int) -> Knots:
    """Cut arrays of knots to their number."""
    if count == 0:
        raise MemoryError
    time, q, v, a = arrays
    return time[:count], q[:count], v[:count], a[:count]
