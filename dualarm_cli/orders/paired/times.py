"""Stage lengths at the best platform angles: dynamic programming for many orders at once."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.records import dataclass

LATE = 1000.0
"""What an instant of a window that is missed counts, in instants of the total."""


@dataclass(frozen=True)
class Ends:
    """What comes before and after a stretch of stages, while these are looked at."""

    last_stops: IntArray
    """The stop that each arm made last before them, shape (arms,) or (b, arms)."""
    values: FloatArray
    """When that is over with the platform at each angle [s], shape (f,) or (b, f)."""
    next_stages: IntArray
    """The stages right after them, until each arm has had a stop, shape (m, arms)."""
    remaining: FloatArray | None
    """How long all takes after those, from each angle [s], shape (f,) or (b, f); None for the way back alone."""
    parts: IntArray | None = None
    """How many parts are in each buffer before them, shape (K,); None where that does not count."""

    def take(self, rows: slice) -> Ends:
        """Returns those of some orders, where they are different ones."""
        if self.last_stops.ndim == 1:
            return self
        rest = None if self.remaining is None else self.remaining[rows]
        return Ends(self.last_stops[rows], self.values[rows], self.next_stages, rest, self.parts)


def totals(problem: StageProblem, slots: IntArray, ends: Ends | None = None) -> FloatArray:
    """Returns when all is done for b orders, each at the best platform angles for it [s], shape (b,).

    Args:
        problem: what is asked.
        slots: stops of every order, shape (b, n, arms), IDLE where an arm has none; stages in which all are idle do
            not count.
        ends: what comes before and after, where the stages are a stretch of an order.
    """
    f = len(problem.turn)
    if ends is not None:
        then = np.broadcast_to(ends.next_stages, (len(slots), *ends.next_stages.shape))
        slots = np.concatenate([slots, then], axis=1)
    size = max(1, 3_000_000 // (f * f))  # numbers at once
    found = [
        _swept(
            problem,
            slots[k : k + size],
            None if ends is None else ends.take(slice(k, k + size)),
            trace=False,
        )[0]
        for k in range(0, len(slots), size)
    ]
    plain = np.concatenate(found) if found else np.zeros(0)
    return plain + missing_parts(problem, slots, ends)


def missing_parts(problem: StageProblem, slots: IntArray, ends: Ends | None) -> FloatArray:
    """Returns what b orders count for parts that are not there or have no room [s], shape (b,); as of `totals`."""
    if problem.stores is None or (ends is not None and ends.parts is None):
        return np.zeros(len(slots))
    return problem.stores.missing(slots, None if ends is None else ends.parts)


def with_angles(problem: StageProblem, slots: IntArray) -> StageOrder:
    """Returns one order (n, arms) with the best platform angles for it."""
    total, angles = _swept(problem, slots[None], None, trace=True)
    missing = missing_parts(problem, slots[None], None)
    return StageOrder(slots, angles, float(total[0] + missing[0]))


def previous(slots: IntArray, start: int, came: IntArray | None = None) -> IntArray:
    """Returns the stop that each arm made last before each stage and after all, shape (b, n + 1, arms).

    Args:
        slots: stops, shape (b, n, arms).
        start: what stands for the start.
        came: what each arm made before all, shape (arms,) or (b, arms); the start by default.
    """
    b, n, arms = slots.shape
    before = np.full((b, 1, arms), start)
    if came is not None:
        before[:, 0] = came
    number = np.where(slots != IDLE, np.arange(1, n + 1)[None, :, None], 0)
    last = np.maximum.accumulate(number, axis=1)
    last = np.concatenate([np.zeros((b, 1, arms), dtype=np.int64), last], axis=1)
    padded = np.concatenate([before, slots], axis=1)
    return np.take_along_axis(padded, last, axis=1)


class Stretches:
    """An order's values from its start to every stage, and from there to its end; at paired arms' stages."""

    def __init__(self, problem: StageProblem, slots: IntArray) -> None:
        """Computes both."""
        self._slots, self._stores = slots, problem.stores
        self._came = previous(slots[None], problem.stops)
        with np.errstate(invalid="ignore"):
            self._values = _forward(problem, slots[None], self._came, None, trace=False)[0][:, 0]
            n, f = len(slots), len(problem.turn)
            self._rest = np.zeros((n + 1, f))
            self._rest[n] = closing(problem, self._came[:, n])[0]
            for k in range(n - 1, -1, -1):
                step = _ends(problem, slots[None], self._came, np.zeros((1, f)), k)[0]
                self._rest[k] = (step + self._rest[k + 1]).min(axis=1)

    def ends(self, first: int, last: int) -> Ends:
        """Returns what comes before stage `first` and from stage `last` on."""
        seen = np.zeros(self._slots.shape[1], dtype=np.bool_)
        stop = last
        while stop < len(self._slots) and not seen.all():
            seen |= self._slots[stop] != IDLE
            stop += 1
        rest = self._rest[stop] if stop < len(self._slots) else None
        parts = None if self._stores is None else self._stores.after(self._slots[:first])
        return Ends(self._came[0, first], self._values[first], self._slots[last:stop], rest, parts)


def _swept(
    problem: StageProblem, slots: IntArray, ends: Ends | None, *, trace: bool
) -> tuple[FloatArray, IntArray]:
    """Returns totals (b,) and, of a single order, its angles (n,).

    The value of a stage is the earliest instant at which it is over with the platform at each angle. An arm that was
    idle is taken to have made its last stop at the angle of the stage before.
    """
    # Idle arms count minus infinity, what cannot be reached infinity: stages of neither are put right below.
    with np.errstate(invalid="ignore"):
        came = previous(slots, problem.stops, None if ends is None else ends.last_stops)
        values, chosen = _forward(problem, slots, came, ends, trace=trace)
        n = slots.shape[1]
        rest = None if ends is None else ends.remaining
        last = values[n] + (closing(problem, came[:, n]) if rest is None else rest)
    total: FloatArray = last.min(axis=1)
    angles = np.zeros(n, dtype=np.int64)
    if trace and n and np.isfinite(total[0]):
        at = int(last[0].argmin())
        for k in range(n - 1, -1, -1):
            angles[k], at = at, int(chosen[k][at])
    return total, angles


def _forward(
    problem: StageProblem, slots: IntArray, came: IntArray, ends: Ends | None, *, trace: bool
) -> tuple[FloatArray, list[IntArray]]:
    """Returns when stages are over, (n + 1, b, f), and of a single order from which angle each is best begun, (f,)."""
    b, n, _ = slots.shape
    f = len(problem.turn)
    nothing = (slots == IDLE).all(axis=2)
    values = np.full((n + 1, b, f), np.inf)
    if ends is None:
        values[0, :, slice(None) if problem.free_start else 0] = 0.0
    else:
        values[0] = ends.values
    chosen: list[IntArray] = []
    for k in range(n):
        over = _ends(problem, slots, came, values[k], k)
        best = in_windows(problem, slots[:, k], over.min(axis=1))
        if nothing[:, k].any():
            best[nothing[:, k]] = values[k][nothing[:, k]]
        values[k + 1] = best
        if trace:
            # Where there is nothing to do the platform stays.
            chosen.append(np.where(nothing[0, k], np.arange(f), over[0].argmin(axis=0)))
    return values, chosen


def _ends(
    problem: StageProblem, slots: IntArray, came: IntArray, value: FloatArray, k: int
) -> FloatArray:
    """Returns when stage k is over, by the angle before and its own [s], shape (b, f, f).

    Args:
        problem: what is asked.
        slots: stops of every order, shape (b, n, arms).
        came: what each arm made before each stage, shape (b, n + 1, arms).
        value: when the stage before is over at each angle [s], shape (b, f).
        k: number of the stage.
    """
    whole: FloatArray = problem.length[0][came[:, k, 0], slots[:, k, 0]]
    for a in range(1, slots.shape[2]):
        np.maximum(whole, problem.length[a][came[:, k, a], slots[:, k, a]], out=whole)
    if problem.pair_cost is not None:
        whole += problem.pair_cost[slots[:, k, 0], slots[:, k, 1]][:, None]
    whole += value[:, :, None]
    return whole


def stage_values(
    problem: StageProblem, stops: IntArray, came: IntArray, value: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Returns when a stage of b orders is over by its own angle [s], and the angle it is best begun at, (b, f) each.

    Args:
        problem: what is asked.
        stops: of the stage, shape (b, arms); not all IDLE.
        came: what each arm made before, shape (b, arms).
        value: when the stage before is over at each angle [s], shape (b, f).
    """
    with np.errstate(invalid="ignore"):
        over = _ends(problem, stops[:, None], came[:, None], value, 0)
        return in_windows(problem, stops, over.min(axis=1)), over.argmin(axis=1)


def in_windows(problem: StageProblem, stops: IntArray, over: FloatArray) -> FloatArray:
    """Returns when a stage (b, arms) is over, (b, f), after waiting for windows, and with what is late."""
    if problem.not_before is not None:
        for a in range(stops.shape[1]):
            floor = _window_floor(problem, a, stops[:, a], stops[:, a] != IDLE)
            over = np.where(np.isfinite(over), np.maximum(over, floor), over)
    if problem.not_after is not None:
        over = over + _late(problem, stops, over)
    return over


def _window_floor(problem: StageProblem, a: int, stop: IntArray, active: BoolArray) -> FloatArray:
    """Returns when stops that may not begin before an instant are over at the earliest [s], shape (b, f)."""
    assert problem.not_before is not None  # callers have looked
    opens = np.where(active, problem.not_before[stop], 0.0)
    work = problem.work[a][stop]
    return np.where(
        (opens > 0.0)[:, None] & np.isfinite(work),
        opens[:, None] + np.where(np.isfinite(work), work, 0.0),
        0.0,
    )


def _late(problem: StageProblem, stops: IntArray, over: FloatArray) -> FloatArray:
    """Returns the penalty for stops (b, arms) that are over too late, shape (b, f)."""
    assert problem.not_after is not None  # callers have looked
    closes = np.append(problem.not_after, np.inf)[stops].min(axis=1)
    late = np.maximum(0.0, np.where(np.isfinite(over), over, 0.0) - closes[:, None])
    return LATE * late


def closing(problem: StageProblem, last: IntArray) -> FloatArray:
    """Returns the length of the way back from every angle [s], shape (b, f)."""
    b, f = len(last), len(problem.turn)
    if not problem.returns:
        return np.zeros((b, f))
    found = np.zeros((b, f))
    if not problem.free_start:
        found = np.tile(problem.turn[:, 0], (b, 1))
    for a, length in enumerate(problem.length):
        there = last[:, a] != problem.stops
        found[there] = np.maximum(found[there], length[last[there, a], problem.stops][:, :, 0])
    return found
