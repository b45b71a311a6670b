"""Buffers in the plane of two arms' timelines: where a part would be taken that is not there, or has no room."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, IntArray
from dualarm_cli.model.job import Job
from dualarm_cli.planning.buffer_numbers import used_buffers
from dualarm_cli.planning.clock_steps import ClockSteps, Since
from dualarm_cli.planning.leaving_times import NotBefore
from dualarm_cli.planning.own_clock import OwnClock
from dualarm_cli.planning.waiting import SAME_TIME


@dataclass(frozen=True)
class _Use:
    """One stop of an arm at a buffer, in steps of its timeline."""

    begins: Since
    """When its tool is there, counted from where the arm may wait last before that."""
    ends: Since
    """When its dwell is over, counted likewise."""
    event: int
    """From where on it counts as at its target."""
    over: int
    """From where on its dwell counts as over."""
    change: int
    """1 for a part that is put in, -1 for one that is taken out."""


def first_missed(
    blocked: BoolArray, buffers: BoolArray, steps: tuple[int, int], at: tuple[int, int]
) -> bool:
    """Returns whether it is a buffer that two arms would miss first if both went on from somewhere without a wait.

    Args:
        blocked: where they must not be together for any reason, as of `Diagram.blocked`.
        buffers: where they must not for buffers, of the same shape.
        steps: of each timeline.
        at: where both are.
    """
    (n, m), band = steps, (blocked.shape[1] - 1) // 2
    on = np.arange(1, max(n - at[0], m - at[1], 0) + 1)
    i, j = np.minimum(at[0] + on, n), np.minimum(at[1] + on, m)
    column = j - i + band
    inside = (column >= 0) & (column <= 2 * band)
    i, column = i[inside], column[inside]
    stops = np.flatnonzero(blocked[i, column])
    return len(stops) > 0 and bool(buffers[i[stops[0]], column[stops[0]]])


class MeetingBuffers:
    """A job's buffers in the plane of two timelines.

    What needs something counts from the step before its event, what gives something from the step after its dwell, and
    not before the arm has gone on from where it may wait: so instants between steps are no matter.
    """

    def __init__(self, job: Job, clocks: Sequence[OwnClock], steps: Sequence[ClockSteps]) -> None:
        """Counts parts along both timelines.

        Args:
            job: decided.
            clocks: both arms' ways.
            steps: of each timeline.
        """
        stops = job.stops_by_key()
        self._names, self._job = used_buffers(job), job
        self._steps = tuple(own.count for own in steps)
        self._uses: list[dict[str, list[_Use]]] = []
        for clock, grid in zip(clocks, steps, strict=True):
            own: dict[str, list[_Use]] = {}
            for event in clock.events:
                stop = stops.get((clock.arm, event.task, event.action))
                if stop is None or not stop.buffer:
                    continue
                over, begins = event.time + event.dwell, grid.left(event.time)
                waits = grid.places[begins.rest] if begins.rest >= 0 else -1
                use = _Use(
                    begins,
                    Since(begins.rest, begins.after + event.dwell),
                    max(int(np.floor(event.time / grid.step + SAME_TIME)), waits + 1),
                    min(max(int(np.ceil(over / grid.step - SAME_TIME)), waits + 1), grid.count),
                    stop.stored,
                )
                own.setdefault(stop.buffer, []).append(use)
            self._uses.append(own)

    def blocked(self, band: int) -> BoolArray:
        """Returns where parts or room are missing, shape (steps + 1, 2 band + 1), as of `Diagram.blocked`."""
        n, m = self._steps
        i = np.arange(n + 1)[:, None]
        j = np.clip(i + np.arange(2 * band + 1)[None, :] - band, 0, m)
        found: BoolArray = np.zeros((n + 1, 2 * band + 1), dtype=np.bool_)
        for name in self._names:
            found |= self._wrong(name, i, j)
        return found

    def rules(self, place: Callable[[int, int], int]) -> list[NotBefore]:
        """Returns what each arm waits for so that buffers are used in the order in which they are on a way.

        Args:
            place: the step of the other arm on that way when an arm, by its number, comes to one of its steps.
        """
        found = []
        for a, own in enumerate(self._uses):
            for name, uses in own.items():
                for use in uses:
                    there = place(a, use.event)
                    gives = [
                        other
                        for other in self._uses[1 - a].get(name, ())
                        if other.change != use.change and other.over <= there
                    ]
                    if gives and use.begins.rest >= 0:
                        lead = -use.begins.after
                        rest = use.begins.rest
                        found.append(NotBefore(a, rest, "buffer", lead, gives[-1].ends))
        return found

    def _wrong(self, name: str, i: IntArray, j: IntArray) -> BoolArray:
        """Returns whether a buffer lacks parts or room where both arms are, of the shape of both together."""
        buffer = self._job.buffers[name]
        there = room = np.full(np.broadcast_shapes(i.shape, j.shape), buffer.initial)
        for own, at, count in zip(self._uses, (i, j), self._steps, strict=True):
            present, used = (np.zeros(count + 1, dtype=np.int64) for _ in range(2))
            for use in own.get(name, ()):
                # A part is there when its dwell is over and gone at the event; room is taken and free the other way.
                present[use.over if use.change > 0 else use.event :] += use.change
                used[use.event if use.change > 0 else use.over :] += use.change
            there, room = there + present[at], room + used[at]
        return np.asarray((there < 0) | (room > buffer.capacity))
