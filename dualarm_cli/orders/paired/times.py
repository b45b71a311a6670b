"""Makespans at the best platform angles: dynamic programming for many orders at once."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.records import dataclass

LATE = 1000.0
"""Penalty per second of lateness [s]."""


@dataclass(frozen=True)
class Ends:
    """State before and after a stretch of stages that is searched."""

    last_stops: IntArray
    """Last stop of each arm before the stretch, shape (arms,) or (b, arms)."""
    values: FloatArray
    """Earliest end of the previous stage by angle [s], (f,) or (b, f)."""
    next_stages: IntArray
    """Stages after the stretch, until each arm has stopped, shape (m, arms)."""
    remaining: FloatArray | None
    """Time after those stages by angle [s], (f,) or (b, f).

    None for the return alone.
    """
    parts: IntArray | None = None
    """Parts in each buffer before the stretch, shape (K,); None without buffers."""

    def take(self, rows: slice) -> Ends:
        """Select orders, if the state differs between them."""
        if self.last_stops.ndim == 1:
            return self
        rest = None if self.remaining is None else self.remaining[rows]
        return Ends(self.last_stops[rows], self.values[rows], self.next_stages, rest, self.parts)


def totals(problem: StageProblem, slots: IntArray, ends: Ends | None = None) -> FloatArray:
    """Compute makespans plus penalties of b orders at best platform angles [s], shape (b,).

    Args:
        problem: the stage problem.
        slots: stops of every order, shape (b, n, arms), IDLE for none; stages without any stop do not count.
        ends: state before and after, if the stages are a stretch of an order.
    """
    f = len(problem.turn)
    if ends is not None:
        next_stages = np.broadcast_to(ends.next_stages, (len(slots), *ends.next_stages.shape))
        slots = np.concatenate([slots, next_stages], axis=1)
    size = max(1, 3_000_000 // (f * f))  # numbers at once
    blocks = [
        _swept(
            problem,
            slots[k : k + size],
            None if ends is None else ends.take(slice(k, k + size)),
            trace=False,
        )[0]
        for k in range(0, len(slots), size)
    ]
    makespans = np.concatenate(blocks) if blocks else np.zeros(0)
    return makespans + missing_parts(problem, slots, ends)


def missing_parts(problem: StageProblem, slots: IntArray, ends: Ends | None) -> FloatArray:
    """Compute the penalties of b orders for missing parts, room [s], (b,).

    Arguments as in `totals`.
    """
    if problem.stores is None or (ends is not None and ends.parts is None):
        return np.zeros(len(slots))
    return problem.stores.missing(slots, None if ends is None else ends.parts)


def with_angles(problem: StageProblem, slots: IntArray) -> StageOrder:
    """Choose the best platform angles of an order (n, arms)."""
    total, angles = _swept(problem, slots[None], None, trace=True)
    missing = missing_parts(problem, slots[None], None)
    return StageOrder(slots, angles, float(total[0] + missing[0]))


def previous(slots: IntArray, start: int, last_stops: IntArray | None = None) -> IntArray:
    """Compute each arm's last stop around all stages, (b, n + 1, arms).

    Row i is before stage i, the last row after all.

    Args:
        slots: stops, shape (b, n, arms).
        start: stop number of the start.
        last_stops: last stop of each arm before all stages, shape (arms,) or (b, arms); the start by default.
    """
    b, n, arms = slots.shape
    before = np.full((b, 1, arms), start)
    if last_stops is not None:
        before[:, 0] = last_stops
    number = np.where(slots != IDLE, np.arange(1, n + 1)[None, :, None], 0)
    last_number = np.maximum.accumulate(number, axis=1)
    last_number = np.concatenate([np.zeros((b, 1, arms), dtype=np.int64), last_number], axis=1)
    padded = np.concatenate([before, slots], axis=1)
    return np.take_along_axis(padded, last_number, axis=1)


class Stretches:
    """Values of an order from its start and to its end, by stage."""

    def __init__(self, problem: StageProblem, slots: IntArray) -> None:
        """Compute the values in both directions."""
        self._slots, self._stores = slots, problem.stores
        self._last_stops = previous(slots[None], problem.stops)
        with np.errstate(invalid="ignore"):
            self._values = _forward(problem, slots[None], self._last_stops, None, trace=False)[0][
                :, 0
            ]
            n, f = len(slots), len(problem.turn)
            self._remaining = np.zeros((n + 1, f))
            self._remaining[n] = closing(problem, self._last_stops[:, n])[0]
            for k in range(n - 1, -1, -1):
                step = _ends(problem, slots[None], self._last_stops, np.zeros((1, f)), k)[0]
                self._remaining[k] = (step + self._remaining[k + 1]).min(axis=1)

    def ends(self, first: int, last: int) -> Ends:
        """Build the state before stage `first` and from stage `last` on."""
        seen = np.zeros(self._slots.shape[1], dtype=np.bool_)
        stop = last
        while stop < len(self._slots) and not seen.all():
            seen |= self._slots[stop] != IDLE
            stop += 1
        remaining = self._remaining[stop] if stop < len(self._slots) else None
        parts = None if self._stores is None else self._stores.after(self._slots[:first])
        return Ends(
            self._last_stops[0, first],
            self._values[first],
            self._slots[last:stop],
            remaining,
            parts,
        )


def _swept(
    problem: StageProblem, slots: IntArray, ends: Ends | None, *, trace: bool
) -> tuple[FloatArray, IntArray]:
    """Compute the makespans (b,) and, of a single order, its angles (n,).

    The value of a stage is its earliest end by platform angle. The last stop of an idle arm counts as made at the angle
    of the stage before.
    """
    # Idle arms add minus infinity and infeasible stops infinity; `_forward` repairs stages without any stop.
    with np.errstate(invalid="ignore"):
        last_stops = previous(slots, problem.stops, None if ends is None else ends.last_stops)
        values, chosen = _forward(problem, slots, last_stops, ends, trace=trace)
        n = slots.shape[1]
        remaining = None if ends is None else ends.remaining
        last = values[n] + (closing(problem, last_stops[:, n]) if remaining is None else remaining)
    total: FloatArray = last.min(axis=1)
    angles = np.zeros(n, dtype=np.int64)
    if trace and n and np.isfinite(total[0]):
        at = int(last[0].argmin())
        for k in range(n - 1, -1, -1):
            angles[k], at = at, int(chosen[k][at])
    return total, angles


def _forward(
    problem: StageProblem, slots: IntArray, last_stops: IntArray, ends: Ends | None, *, trace: bool
) -> tuple[FloatArray, list[IntArray]]:
    """Compute the ends of stages; of a single order also the best angles before.

    Shapes (n + 1, b, f) and, for each stage, (f,).
    """
    b, n, _ = slots.shape
    f = len(problem.turn)
    is_empty = (slots == IDLE).all(axis=2)
    values = np.full((n + 1, b, f), np.inf)
    if ends is None:
        values[0, :, slice(None) if problem.free_start else 0] = 0.0
    else:
        values[0] = ends.values
    chosen: list[IntArray] = []
    for k in range(n):
        stage_ends = _ends(problem, slots, last_stops, values[k], k)
        best = in_windows(problem, slots[:, k], stage_ends.min(axis=1))
        if is_empty[:, k].any():
            best[is_empty[:, k]] = values[k][is_empty[:, k]]
        values[k + 1] = best
        if trace:
            # In a stage without stops the platform stays.
            chosen.append(np.where(is_empty[0, k], np.arange(f), stage_ends[0].argmin(axis=0)))
    return values, chosen


def _ends(
    problem: StageProblem, slots: IntArray, last_stops: IntArray, value: FloatArray, k: int
) -> FloatArray:
    """Compute the ends of stage k by both angles [s], shape (b, f, f).

    Args:
        problem: the stage problem.
        slots: stops of every order, shape (b, n, arms).
        last_stops: last stop of each arm before each stage, shape (b, n + 1, arms).
        value: end of the stage before by angle [s], shape (b, f).
        k: number of the stage.
    """
    stage_ends: FloatArray = problem.length[0][last_stops[:, k, 0], slots[:, k, 0]]
    for a in range(1, slots.shape[2]):
        np.maximum(
            stage_ends, problem.length[a][last_stops[:, k, a], slots[:, k, a]], out=stage_ends
        )
    if problem.pair_cost is not None:
        stage_ends += problem.pair_cost[slots[:, k, 0], slots[:, k, 1]][:, None]
    stage_ends += value[:, :, None]
    return stage_ends


def stage_values(
    problem: StageProblem, stops: IntArray, last_stops: IntArray, value: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Compute the ends of a stage of b orders, with the best angles before.

    Both by the angle of the stage, shape (b, f) each.

    Args:
        problem: the stage problem.
        stops: stops of the stage, shape (b, arms); not all IDLE.
        last_stops: last stop of each arm before, shape (b, arms).
        value: end of the stage before by angle [s], shape (b, f).
    """
    with np.errstate(invalid="ignore"):
        stage_ends = _ends(problem, stops[:, None], last_stops[:, None], value, 0)
        return in_windows(problem, stops, stage_ends.min(axis=1)), stage_ends.argmin(axis=1)


def in_windows(problem: StageProblem, stops: IntArray, stage_ends: FloatArray) -> FloatArray:
    """Add window waits and lateness penalties to stage ends (b, f) [s]."""
    if problem.not_before is not None:
        for a in range(stops.shape[1]):
            floor = _window_floor(problem, a, stops[:, a], stops[:, a] != IDLE)
            stage_ends = np.where(
                np.isfinite(stage_ends), np.maximum(stage_ends, floor), stage_ends
            )
    if problem.not_after is not None:
        stage_ends = stage_ends + _late(problem, stops, stage_ends)
    return stage_ends


def _window_floor(problem: StageProblem, a: int, stop: IntArray, active: BoolArray) -> FloatArray:
    """Compute the earliest ends of stops under their windows [s], shape (b, f)."""
    assert problem.not_before is not None  # callers have looked
    opens = np.where(active, problem.not_before[stop], 0.0)
    work = problem.work[a][stop]
    return np.where(
        (opens > 0.0)[:, None] & np.isfinite(work),
        opens[:, None] + np.where(np.isfinite(work), work, 0.0),
        0.0,
    )


def _late(problem: StageProblem, stops: IntArray, stage_ends: FloatArray) -> FloatArray:
    """Compute the lateness penalties of stops (b, arms), shape (b, f)."""
    assert problem.not_after is not None  # callers have looked
    closes = np.append(problem.not_after, np.inf)[stops].min(axis=1)
    late = np.maximum(0.0, np.where(np.isfinite(stage_ends), stage_ends, 0.0) - closes[:, None])
    return LATE * late


def closing(problem: StageProblem, last: IntArray) -> FloatArray:
    """Compute the duration of the return from every angle [s], shape (b, f)."""
    b, f = len(last), len(problem.turn)
    if not problem.returns:
        return np.zeros((b, f))
    durations = np.zeros((b, f))
    if not problem.free_start:
        durations = np.tile(problem.turn[:, 0], (b, 1))
    for a, length in enumerate(problem.length):
        moved = last[:, a] != problem.stops
        durations[moved] = np.maximum(
            durations[moved], length[last[moved, a], problem.stops][:, :, 0]
        )
    return durations
