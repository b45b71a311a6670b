"""How two arms with clocks of their own go their ways without touching: waits where they stand anyway."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import WaitReason
from dualarm_cli.planning.buffer_meeting import MeetingBuffers, first_missed
from dualarm_cli.planning.own_clock import OwnClock, Wait
from dualarm_cli.sequencing.coordination import Diagram, quickest_together

STEP = 0.02
"""Time between the instants at which the arms are looked at, but for ways of minutes [s]."""
MOST_CELLS = 3_000_000
"""Pairs of instants at most."""
AHEAD = (10.0, 40.0)
"""How much farther on its way one arm may be than the other, beyond the difference of their lengths: if the first one
does not do, the second [s]."""
COARSE = 4
"""Every so many instants of both are looked at first."""
FAR = 0.4
"""Between two coarse instants arms that have this to spare are taken to keep clear [m]."""
SOON = 60
"""Waits so few steps before a place with a reason, which are as long as a transfer, have the same reason."""
ROWS = 200_000
"""Pairs of instants that are looked at together."""


@dataclass(frozen=True)
class Meeting:
    """Two arms' ways, and what they have to heed."""

    model: CellModel
    """The job's cell, its platform held."""
    job: Job
    """What is to be done, decided."""
    start: FloatArray
    """All joints while the platform stands where both work [rad], shape (n,)."""
    cell: CellClearance | None
    """What has to keep clear; None where nothing has to."""
    clocks: tuple[OwnClock, OwnClock]
    """Both arms' ways."""
    ready: float
    """When the platform is where both work [s]: before that no line begins."""
    leave: float
    """When arms may leave at the earliest [s]."""

    def waits(self, spread: int) -> tuple[list[Wait], list[Wait]] | None:
        """Returns each arm's waits for the quickest way of both together, None where none was found.

        Args:
            spread: by how many steps what is blocked is made larger, for what is between them.
        """
        for ahead in AHEAD:
            found = self._waits(spread, ahead)
            if found is not None:
                return found
        return None

    def _waits(self, spread: int, ahead: float) -> tuple[list[Wait], list[Wait]] | None:
        durations = [clock.duration for clock in self.clocks]
        step = self._step(durations, ahead)
        steps = tuple(int(np.ceil(duration / step - 1e-9)) for duration in durations)
        band = abs(steps[0] - steps[1]) + max(1, round(ahead / step))
        band = min(band, max(steps))
        rests = tuple(
            {_nearest(time, step, n): time for time in clock.rests()}
            for clock, n in zip(self.clocks, steps, strict=True)
        )
        blocked = self._blocked((steps[0], steps[1]), step, band, spread)
        reasons: tuple[dict[int, WaitReason], ...] = ({}, {})
        self._precedence(blocked, (steps[0], steps[1]), step, reasons)
        buffers = MeetingBuffers(self.job, self.clocks, (steps[0], steps[1]), step).blocked(band)
        blocked |= buffers
        opens = self._opens((steps[0], steps[1]), step, reasons)
        found = quickest_together(
            Diagram(
                (steps[0], steps[1]),
                (tuple(sorted(rests[0])), tuple(sorted(rests[1]))),
                blocked,
                opens,
            )
        )
        if found is None:
            return None

        def missed(a: int, place: int) -> bool:
            now = place + sum(wait for at, wait in found.waits[a] if at < place)
            there = found.place(1 - a, now)
            at = (place, there) if a == 0 else (there, place)
            return first_missed(blocked, buffers, (steps[0], steps[1]), at)

        one, other = (
            [
                Wait(own[place], wait * step, "buffer" if missed(a, place) else _reason(place, why))
                for place, wait in found.waits[a]
                if place in own
            ]
            for a, (own, why) in enumerate(zip(rests, reasons, strict=True))
        )
        return one, other

    def _step(self, durations: Sequence[float], ahead: float) -> float:
        """Returns the time between instants [s], so that there are not too many pairs."""
        scale, step = self.job.speed, STEP / self.job.speed
        while True:
            n, m = (duration / step for duration in durations)
            width = min(2.0 * (abs(n - m) + ahead / step) + 1.0, 2.0 * max(n, m))
            if n * width <= MOST_CELLS or step > 10.0 / scale:
                return step
            step *= 1.25

    def _blocked(self, steps: tuple[int, int], step: float, band: int, spread: int) -> BoolArray:
        """Returns where the arms touch, and what is right beside that, shape (steps + 1, 2 band + 1)."""
        n, m = steps
        shape = (n + 1, 2 * band + 1)
        blocked = np.zeros(shape, dtype=np.bool_)
        if self.cell is None:
            return blocked
        joints, held = [], []
        for clock, count in zip(self.clocks, steps, strict=True):
            time = np.minimum(step * np.arange(count + 1), clock.duration)
            joints.append(clock.trajectory.at(time)[0])
            held.append(clock.held(time, self.cell, self.job))
        near = np.zeros(shape, dtype=np.bool_)
        i, c = (
            x.ravel() for x in np.meshgrid(np.arange(n + 1), np.arange(2 * band + 1), indexing="ij")
        )
        j = i + c - band
        inside = (j >= 0) & (j <= m)
        coarse = inside & (i % COARSE == 0) & (j % COARSE == 0)
        margin = self._margins(joints, held, i[coarse], j[coarse])
        close = margin < FAR
        for a in range(-COARSE, COARSE + 1):
            for b in range(-COARSE, COARSE + 1):
                row, column = i[coarse][close] + a, j[coarse][close] + b
                at = column - row + band
                ok = (row >= 0) & (row <= n) & (at >= 0) & (at <= 2 * band)
                near[row[ok], at[ok]] = True
        look = near.ravel() & inside
        touch = self._margins(joints, held, i[look], j[look]) < 0.0
        blocked[i[look][touch], c[look][touch]] = True
        for _ in range(spread):
            blocked = _grown(blocked)
        return blocked

    def _margins(
        self, joints: Sequence[FloatArray], held: Sequence[IntArray], i: IntArray, j: IntArray
    ) -> FloatArray:
        assert self.cell is not None  # callers have looked
        found = np.empty(len(i))
        columns = [self.model.arms[clock.arm].columns for clock in self.clocks]
        for k in range(0, len(i), ROWS):
            some = slice(k, k + ROWS)
            position = np.tile(self.start, (len(i[some]), 1))
            position[:, columns[0]] = joints[0][i[some]]
            position[:, columns[1]] = joints[1][j[some]]
            both = np.stack([held[0][i[some]], held[1][j[some]]], axis=1)
            found[some] = self.cell.cross_margins(position, both)
        return found

    def _precedence(
        self,
        blocked: BoolArray,
        steps: tuple[int, int],
        step: float,
        reasons: tuple[dict[int, WaitReason], ...],
    ) -> None:
        """Blocks places at which one arm has begun a task that comes after one of the other arm's not yet over."""
        begins = [clock.line_begins() for clock in self.clocks]
        ends = [clock.task_ends() for clock in self.clocks]
        band = (blocked.shape[1] - 1) // 2
        i = np.arange(steps[0] + 1)[:, None]
        j = i + np.arange(2 * band + 1)[None, :] - band
        for task in self.job.tasks:
            for a in (0, 1):
                if task.id not in begins[a]:
                    continue
                begin = _nearest(begins[a][task.id], step, steps[a])
                for name in task.after:
                    if name not in ends[1 - a]:
                        continue
                    over = int(np.ceil(ends[1 - a][name] / step)) + 1
                    over = min(over, steps[1 - a])
                    own, other = (i, j) if a == 0 else (j, i)
                    blocked |= (own > begin) & (other < over)
                    reasons[a][begin] = "after"

    def _opens(
        self,
        steps: tuple[int, int],
        step: float,
        reasons: tuple[dict[int, WaitReason], ...],
    ) -> tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]:
        """Returns by arm where it must not go on before an instant: the platform's turn, and windows."""
        found: list[list[tuple[int, int]]] = [[], []]
        windows = {task.id: task.not_before for task in self.job.tasks}
        for a, clock in enumerate(self.clocks):
            begins = clock.line_begins()
            firsts = {event.task: event.time for event in reversed(clock.events)}
            if self.leave > 0.0:
                found[a].append((0, int(np.ceil(self.leave / step))))
                reasons[a][0] = "platform"
            if begins and self.ready > 0.0:
                place = _nearest(min(begins.values()), step, steps[a])
                found[a].append((place, int(np.ceil(self.ready / step))))
                reasons[a][place] = "platform"
            for name, begin in begins.items():
                opens = windows[name] - (firsts[name] - begin)
                if windows[name] > 0.0 and opens > 0.0:
                    place = _nearest(begin, step, steps[a])
                    found[a].append((place, int(np.ceil(opens / step)) + 1))
                    reasons[a][place] = "window"
        return tuple(found[0]), tuple(found[1])


def _reason(place: int, why: Mapping[int, WaitReason]) -> WaitReason:
    """Returns what an arm waits for at a place: what holds there, or right after, at the next place with a reason."""
    later = [other for other in sorted(why) if place <= other <= place + SOON]
    return why[later[0]] if later else "shared_zone"


def _nearest(time: float, step: float, steps: int) -> int:
    return min(round(time / step), steps)


def _grown(blocked: BoolArray) -> BoolArray:
    """Returns what is blocked together with all that is one step beside it, of either arm or both."""
    found = blocked.copy()
    # The other arm one step on or back: the next column.
    found[:, 1:] |= blocked[:, :-1]
    found[:, :-1] |= blocked[:, 1:]
    # Both: the next row. The first one alone: the next row, one column back.
    found[1:] |= blocked[:-1]
    found[:-1] |= blocked[1:]
    found[1:, :-1] |= blocked[:-1, 1:]
    found[:-1, 1:] |= blocked[1:, :-1]
    return found
