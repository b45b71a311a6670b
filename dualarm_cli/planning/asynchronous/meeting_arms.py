"""Coordination of two asynchronous arms: waits that avoid collisions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import WaitReason
from dualarm_cli.orders.asynchronous.coordination import Diagram, quickest_path
from dualarm_cli.orders.model.buffer_numbers import used_buffers
from dualarm_cli.planning.asynchronous.own_clock import (
    ClockSteps,
    NotBefore,
    OwnClock,
    Since,
    Wait,
    due,
    leaving_times,
    waits_at,
)
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class _Use:
    """Use of a buffer by an arm, in steps of its timeline."""

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
    """Return whether a buffer, not a collision, first blocks two arms that proceed.

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
    """Buffers of a job over the timelines of two arms.

    What needs something counts from the step before its event, what gives something from the step after its dwell, and
    not before the arm has gone on from where it may wait: so instants between steps are no matter.
    """

    def __init__(self, job: Job, clocks: Sequence[OwnClock], steps: Sequence[ClockSteps]) -> None:
        """Count parts along both timelines.

        Args:
            job: decided.
            clocks: both arms' timelines.
            steps: of each timeline.
        """
        stops = job.stops_by_key()
        self._names, self._job = used_buffers(job), job
        self._steps = tuple(grid.count for grid in steps)
        self._uses: list[dict[str, list[_Use]]] = []
        for clock, grid in zip(clocks, steps, strict=True):
            arm_uses: dict[str, list[_Use]] = {}
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
                arm_uses.setdefault(stop.buffer, []).append(use)
            self._uses.append(arm_uses)

    def blocked(self, band: int) -> BoolArray:
        """Return places of missing parts or room, (steps + 1, 2 band + 1)."""
        n, m = self._steps
        i = np.arange(n + 1)[:, None]
        j = np.clip(i + np.arange(2 * band + 1)[None, :] - band, 0, m)
        is_missing: BoolArray = np.zeros((n + 1, 2 * band + 1), dtype=np.bool_)
        for name in self._names:
            is_missing |= self._wrong(name, i, j)
        return is_missing

    def rules(self, place: Callable[[int, int], int]) -> list[NotBefore]:
        """Derive waits that keep a path's order of buffer uses.

        Args:
            place: step of the other arm when an arm, by its index, reaches a step.
        """
        rules = []
        for a, arm_uses in enumerate(self._uses):
            for name, uses in arm_uses.items():
                for use in uses:
                    other_step = place(a, use.event)
                    changes = [
                        use_b
                        for use_b in self._uses[1 - a].get(name, ())
                        if use_b.change != use.change and use_b.over <= other_step
                    ]
                    if changes and use.begins.rest >= 0:
                        lead = -use.begins.after
                        rest = use.begins.rest
                        rules.append(NotBefore(a, rest, "buffer", lead, changes[-1].ends))
        return rules

    def _wrong(self, name: str, i: IntArray, j: IntArray) -> BoolArray:
        """Return whether a buffer lacks parts or room at pairs of steps."""
        buffer = self._job.buffers[name]
        parts = room = np.full(np.broadcast_shapes(i.shape, j.shape), buffer.initial)
        for arm_uses, at, count in zip(self._uses, (i, j), self._steps, strict=True):
            present, used = (np.zeros(count + 1, dtype=np.int64) for _ in range(2))
            for use in arm_uses.get(name, ()):
                # A part is present from the end of its dwell to its removal; its room is occupied from event to end.
                present[use.over if use.change > 0 else use.event :] += use.change
                used[use.event if use.change > 0 else use.over :] += use.change
            parts, room = parts + present[at], room + used[at]
        return np.asarray((parts < 0) | (room > buffer.capacity))


@dataclass(frozen=True)
class MeetingGrid:
    """Resolution of the grid on which two arms are coordinated."""

    step: float = 0.02
    """Time between the instants at which the arms are compared [s].

    Longer where there would be more than `most_cells` pairs.
    """
    most_cells: int = 3_000_000
    """Maximum number of step pairs."""
    ahead: tuple[float, ...] = (10.0, 40.0)
    """Allowed lead of one arm over the other, tried in this order [s].

    It counts along the arms' motions, beyond the difference of their lengths.
    """
    coarse: int = 4
    """Stride of the coarse pass [steps]."""
    far: float = 0.4
    """Margin above which arms are assumed clear between coarse steps [m]."""
    soon: int = 60
    """Largest distance of a wait from the place that explains it [steps].

    About as long as a transfer.
    """
    rows: int = 200_000
    """Number of step pairs per batch."""


GRID = MeetingGrid()


@dataclass(frozen=True)
class ArmCoordination:
    """Coordination problem of two arms."""

    model: CellModel
    """The job's cell, its platform held."""
    job: Job
    """Job with fixed arms and order."""
    start: FloatArray
    """All joints while the platform stands where both work [rad], shape (n,)."""
    cell: CellClearance | None
    """Collision model; None disables collision checking."""
    clocks: tuple[OwnClock, ...]
    """Timelines of both arms, or of the only one."""
    ready: float
    """Arrival of the platform [s]; no line begins earlier."""
    leave: float
    """Earliest departure of the arms [s]."""

    def waits(self, spread: int) -> tuple[list[Wait], ...] | None:
        """Compute each arm's waits for the fastest joint motion; None if infeasible.

        Args:
            spread: growth of the blocked region, for motion between steps [steps].
        """
        if len(self.clocks) == 1:
            (clock,) = self.clocks
            timeline = ClockSteps.of(clock.rests(), clock.duration, GRID.step)
            return self._exact((timeline,), self._opens((timeline,)), lambda a, rest: False)
        for ahead in GRID.ahead:
            waits = self._waits(spread, ahead)
            if waits is not None:
                return waits
        return None

    def _waits(self, spread: int, ahead: float) -> tuple[list[Wait], ...] | None:
        step = self._step([clock.duration for clock in self.clocks], ahead)
        steps = tuple(ClockSteps.of(c.rests(), c.duration, step) for c in self.clocks)
        counts = (steps[0].count, steps[1].count)
        band = abs(counts[0] - counts[1]) + max(1, round(ahead / step))
        band = min(band, max(counts))
        blocked = self._blocked(steps, band, spread)
        uses = MeetingBuffers(self.job, self.clocks, steps)
        buffers = uses.blocked(band)
        blocked |= buffers
        opens, after, needs = self._opens(steps), *self._after(steps)
        path = quickest_path(
            Diagram(
                counts,
                (steps[0].places, steps[1].places),
                blocked,
                (_in_steps(steps, opens, 0), _in_steps(steps, opens, 1)),
                needs,
            )
        )
        if path is None:
            return None

        def missed(a: int, rest: int) -> bool:
            place = steps[a].places[rest]
            there = path.place(1 - a, path.arrival(a, place))
            return first_missed(
                blocked, buffers, counts, (place, there) if a == 0 else (there, place)
            )

        progress_rules = [
            NotBefore(
                a,
                timeline.places.index(place),
                "",
                0.0,
                steps[1 - a].reached(
                    min(path.place(1 - a, path.departure(a, place)), counts[1 - a])
                ),
            )
            for a, timeline in enumerate(steps)
            for place, _ in path.waits[a]
        ]
        buffer_rules = uses.rules(lambda a, place: path.place(1 - a, path.arrival(a, place)))
        rules = sorted(
            [*opens, *after, *progress_rules, *buffer_rules],
            key=lambda rule: path.departure(rule.arm, steps[rule.arm].places[rule.rest]),
        )
        return self._exact(steps, rules, missed)

    def _exact(
        self,
        steps: Sequence[ClockSteps],
        rules: Sequence[NotBefore],
        missed: Callable[[int, int], bool],
    ) -> tuple[list[Wait], ...] | None:
        """Convert steps to exact waits; None if the arms wait for each other forever.

        Args:
            steps: both timelines.
            rules: rules of departure.
            missed: whether an arm waits for a buffer at a rest, by their indices.
        """
        leaving = leaving_times(steps, rules)
        if leaving is None:
            return None
        waits = []
        for a, arm in enumerate(steps):
            why: dict[int, tuple[float, WaitReason]] = {}
            for rule in rules:
                if rule.arm == a and rule.reason and rule.reason != "buffer":
                    place = arm.places[rule.rest]
                    why[place] = max(
                        why.get(place, (0.0, rule.reason)), (due(rule, leaving), rule.reason)
                    )
            waits.append(
                [
                    Wait(time, length, "buffer" if missed(a, k) else _reason(arm.places[k], why))
                    for k, (time, length) in enumerate(
                        zip(arm.rests, waits_at(arm, leaving[a]), strict=True)
                    )
                    if length > SAME_TIME
                ]
            )
        return tuple(waits)

    def _step(self, durations: Sequence[float], ahead: float) -> float:
        """Choose a time step that limits the number of pairs [s]."""
        scale, step = self.job.speed, GRID.step / self.job.speed
        while True:
            n, m = (duration / step for duration in durations)
            width = min(2.0 * (abs(n - m) + ahead / step) + 1.0, 2.0 * max(n, m))
            if n * width <= GRID.most_cells or step > 10.0 / scale:
                return step
            step *= 1.25

    def _blocked(self, steps: Sequence[ClockSteps], band: int, spread: int) -> BoolArray:
        """Compute colliding pairs of steps, grown, shape (steps + 1, 2 band + 1)."""
        n, m = (timeline.count for timeline in steps)
        shape = (n + 1, 2 * band + 1)
        blocked = np.zeros(shape, dtype=np.bool_)
        if self.cell is None:
            return blocked
        joints, held = [], []
        for clock, timeline in zip(self.clocks, steps, strict=True):
            time = timeline.times()
            joints.append(clock.trajectory.clamped(time)[0])
            held.append(clock.held(time, self.cell, self.job))
        near = np.zeros(shape, dtype=np.bool_)
        i, c = (
            x.ravel() for x in np.meshgrid(np.arange(n + 1), np.arange(2 * band + 1), indexing="ij")
        )
        j = i + c - band
        inside = (j >= 0) & (j <= m)
        coarse = inside & (i % GRID.coarse == 0) & (j % GRID.coarse == 0)
        margin = self._margins(joints, held, i[coarse], j[coarse])
        close = margin < GRID.far
        for a in range(-GRID.coarse, GRID.coarse + 1):
            for b in range(-GRID.coarse, GRID.coarse + 1):
                row, column = i[coarse][close] + a, j[coarse][close] + b
                at = column - row + band
                ok = (row >= 0) & (row <= n) & (at >= 0) & (at <= 2 * band)
                near[row[ok], at[ok]] = True
        candidates = near.ravel() & inside
        collides = self._margins(joints, held, i[candidates], j[candidates]) < 0.0
        blocked[i[candidates][collides], c[candidates][collides]] = True
        # A late arm may still be at any of the previous steps.
        punctual = blocked.copy()
        for late in range(1, int(np.ceil(self.cell.skew / steps[0].step)) + 1):
            blocked[late:, :-late] |= punctual[:-late, late:]
            blocked[:, late:] |= punctual[:, :-late]
        for _ in range(spread):
            blocked = _grown(blocked)
        return blocked

    def _margins(
        self, joints: Sequence[FloatArray], held: Sequence[IntArray], i: IntArray, j: IntArray
    ) -> FloatArray:
        assert self.cell is not None  # checked by the callers
        margins = np.empty(len(i))
        columns = [self.model.arms[clock.arm].columns for clock in self.clocks]
        for k in range(0, len(i), GRID.rows):
            batch = slice(k, k + GRID.rows)
            position = np.tile(self.start, (len(i[batch]), 1))
            position[:, columns[0]] = joints[0][i[batch]]
            position[:, columns[1]] = joints[1][j[batch]]
            both = np.stack([held[0][i[batch]], held[1][j[batch]]], axis=1)
            margins[batch] = self.cell.cross_margins(position, both)
        return margins

    def _after(
        self, steps: Sequence[ClockSteps]
    ) -> tuple[list[NotBefore], tuple[tuple[tuple[int, int], ...], tuple[tuple[int, int], ...]]]:
        """List departures that require a finished task of the other arm, with steps."""
        rules: list[NotBefore] = []
        needs: list[list[tuple[int, int]]] = [[], []]
        begins = [clock.line_begins() for clock in self.clocks]
        ends = [clock.task_ends() for clock in self.clocks]
        for task in self.job.tasks:
            for a in (0, 1):
                if task.id not in begins[a] or not task.after:
                    continue
                rest = steps[a].rest_at(begins[a][task.id])
                assert rest is not None  # tasks begin where arms rest
                for name in task.after:
                    if name not in ends[1 - a]:
                        continue
                    over, partner = ends[1 - a][name], steps[1 - a]
                    # A task without duration ends when the arm departs from its rest.
                    at_once = over <= begins[1 - a][name] + SAME_TIME
                    here = partner.rest_at(over)
                    place = partner.place_after(over)
                    if here is not None:
                        place = partner.places[here] + at_once
                    needs[a].append((steps[a].places[rest], place))
                    since = partner.left(over) if at_once else partner.arrived(over)
                    rules.append(NotBefore(a, rest, "after", 0.0, since))
        return rules, (tuple(needs[0]), tuple(needs[1]))

    def _opens(self, steps: Sequence[ClockSteps]) -> list[NotBefore]:
        """List earliest departures due to platform moves and time windows."""
        rules: list[NotBefore] = []
        windows = {task.id: task.not_before for task in self.job.tasks}
        for a, (clock, timeline) in enumerate(zip(self.clocks, steps, strict=True)):
            begins = clock.line_begins()
            firsts = {event.task: event.time for event in reversed(clock.events)}
            if self.leave > 0.0 and timeline.rests:
                rules.append(NotBefore(a, 0, "platform", self.leave))
            if begins and self.ready > 0.0:
                rest = timeline.rest_at(min(begins.values()))
                assert rest is not None  # tasks begin where arms rest
                rules.append(NotBefore(a, rest, "platform", self.ready))
            for name, begin in begins.items():
                opens = windows[name] - (firsts[name] - begin)
                rest = timeline.rest_at(begin)
                if windows[name] > 0.0 and opens > 0.0 and rest is not None:
                    rules.append(NotBefore(a, rest, "window", opens))
        return rules


def _in_steps(
    steps: Sequence[ClockSteps], opens: Sequence[NotBefore], arm: int
) -> tuple[tuple[int, int], ...]:
    """Convert an arm's earliest departures to steps."""
    timeline = steps[arm]
    return tuple(
        (timeline.places[rule.rest], int(np.ceil(rule.time / timeline.step)))
        for rule in opens
        if rule.arm == arm
    )


def _reason(place: int, reasons: Mapping[int, tuple[float, WaitReason]]) -> WaitReason:
    """Return a wait's reason: at its place, or the next reason."""
    places = [candidate for candidate in sorted(reasons) if place <= candidate <= place + GRID.soon]
    return reasons[places[0]][1] if places else "shared_zone"


def _grown(blocked: BoolArray) -> BoolArray:
    """Grow blocked pairs by one step of either arm or both."""
    grown = blocked.copy()
    # The other arm one step ahead or behind: the next column.
    grown[:, 1:] |= blocked[:, :-1]
    grown[:, :-1] |= blocked[:, 1:]
    # Both: the next row. The first arm alone: the next row, one column back.
    grown[1:] |= blocked[:-1]
    grown[:-1] |= blocked[1:]
    grown[1:, :-1] |= blocked[:-1, 1:]
    grown[:-1, 1:] |= blocked[1:, :-1]
    return grown
