"""A stage at many instants: everybody's joints and what the arms hold, and whether all of it keeps clear."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.schedule import Event
from dualarm_cli.planning.holding import Holding
from dualarm_cli.planning.motion import Motion
from dualarm_cli.planning.waiting import transfer_ends

STEP = 0.004
"""Time between the instants at full speed, but for stages of minutes [s]."""
MOST = 20_000
"""Instants of a stage at most."""
KEPT = 0.0005
"""What is asked for beyond the required clearance, for what is between the instants [m]."""
NEAR = 0.008
"""Between two instants of which one has less than this to spare it is looked at more closely [m]; times their number
where instants have been left out between the two."""
COARSE = 8
"""Every so many instants are looked at first."""
BETWEEN = 8
"""Instants that are looked at there."""
SAME_TIME = 1e-9
"""Instants nearer than this are one [s]."""
LINES = ("approach", "dwell", "retract")
"""Segments on which a part may touch what stands still."""

Margins = Callable[[FloatArray, IntArray], FloatArray]
"""Margins [m], shape (n,), of joints (n, columns) [rad] with what the arms hold, shape (n, arms)."""


@dataclass(frozen=True)
class StageSamples:
    """One stage at t instants a step apart."""

    position: FloatArray
    """All joints [rad], shape (t, columns)."""
    held: IntArray
    """What each arm holds, shape (t, arms)."""
    step: float = STEP
    """Time between the instants [s]."""


@dataclass(frozen=True)
class ArmWay:
    """What one arm does in a stage, by itself."""

    q: FloatArray
    """Its joints [rad], shape (t, 7)."""
    held: IntArray
    """What it holds, shape (t,)."""
    arrival: int
    """Number of the instant at which its transfer is over."""

    @property
    def end(self) -> int:
        """Number of the instant after which it does not move."""
        return last_motion(self.q)


def stage_samples(motion: Motion, number: int, stage: int, holding: Holding) -> StageSamples:
    """Returns one stage of a motion.

    Args:
        motion: of some stages.
        number: which of them.
        stage: its number in the job, that of the return being the number of all others.
        holding: what the arms hold.
    """
    this = motion.stages[number]
    step = max(STEP * holding.pace, (this.end - this.start) / MOST)
    count = max(2, int(np.ceil((this.end - this.start) / step - 1e-9)) + 1)
    time = np.minimum(this.start + step * np.arange(count), this.end)
    held = np.empty((count, len(holding.cell.arms)), dtype=np.int64)
    last = len(holding.before) - 1
    for a, arm in enumerate(holding.cell.arms):
        if stage > last:
            held[:, a] = holding.after[last, a]
            continue
        held[:, a] = holding.before[stage, a]
        event = _event_of(motion, number, arm)
        if event is None:
            continue
        held[time >= event.changes_held - SAME_TIME, a] = holding.after[stage, a]
        start, end = _on_lines(motion, arm, this.start, this.end)
        # With no approach (or no retract) the part lies where it is picked (or placed) at that very instant as well.
        first = start - SAME_TIME if start == event.time else start + SAME_TIME
        inside = (time >= first) & (time <= end - SAME_TIME)
        held[inside, a] |= 1
    return StageSamples(motion.trajectory.at(time)[0], held, step)


def _event_of(motion: Motion, number: int, arm: str) -> Event | None:
    """Returns the event of an arm in one stage of a motion; every stage in which it works has one."""
    events = [event for event in motion.events if event.arm == arm]
    tasks = {event.task for event in events}
    works = [k for k, stage in enumerate(motion.stages) if tasks & set(stage.tasks)]
    return events[works.index(number)] if number in works else None


def _on_lines(motion: Motion, arm: str, start: float, end: float) -> tuple[float, float]:
    """Returns when an arm is on the lines of its stop in a stage from start to end [s]; an empty span for never."""
    parts = [
        part
        for part in motion.segments
        if part.arm == arm
        and part.kind in LINES
        and part.start >= start - SAME_TIME
        and part.end <= end + SAME_TIME
    ]
    return min((p.start for p in parts), default=np.inf), max(
        (p.end for p in parts), default=-np.inf
    )


def arm_ways(
    model: CellModel, motion: Motion, number: int, samples: StageSamples
) -> dict[str, ArmWay]:
    """Returns what each arm does in one stage of a motion.

    Args:
        model: the cell.
        motion: of some stages.
        number: which of them.
        samples: of that stage.
    """
    this = motion.stages[number]
    ways = {}
    for a, (name, arm) in enumerate(model.arms.items()):
        own = [part for part in motion.segments if part.arm == name]
        ends = transfer_ends(own, this.start, this.end + samples.step)
        arrival = round((max(ends, default=this.start) - this.start) / samples.step)
        arrival = min(arrival, len(samples.position) - 1)
        ways[name] = ArmWay(samples.position[:, arm.columns], samples.held[:, a], arrival)
    return ways


def combined(
    model: CellModel,
    samples: StageSamples,
    ways: Mapping[str, ArmWay],
    delays: Mapping[str, int],
) -> StageSamples:
    """Returns a stage with other ways of its arms, some of them late.

    Args:
        model: the cell.
        samples: of the stage as it was, for the platform.
        ways: of every arm.
        delays: instants that an arm waits before it leaves, by arm.
    """
    lengths = [delays.get(name, 0) + way.end + 1 for name, way in ways.items()]
    length = max(*lengths, last_motion(samples.position[:, model.platform_columns]) + 1, 2)
    rows = np.minimum(np.arange(length), len(samples.position) - 1)
    position = samples.position[rows]
    held = np.empty((length, len(ways)), dtype=np.int64)
    for a, (name, way) in enumerate(ways.items()):
        own = np.clip(np.arange(length) - delays.get(name, 0), 0, len(way.q) - 1)
        position[:, model.arms[name].columns] = way.q[own]
        held[:, a] = way.held[own]
    return StageSamples(position, held, samples.step)


def keeps_clear(cell: CellClearance, samples: StageSamples) -> bool:
    """Returns whether everything keeps clear of everything in a stage."""
    return bool(which_keep_clear(cell, [samples])[0])


def which_keep_clear(cell: CellClearance, stages: Sequence[StageSamples]) -> BoolArray:
    """Returns in which of s stages everything keeps clear of everything, shape (s,)."""
    kept = np.ones(len(stages), dtype=np.bool_)
    kinds = [_cross(cell), *(_own(cell, a) for a in range(len(cell.arms)))]
    for margins in kinds:
        left = np.flatnonzero(kept).tolist()
        kept[left] = _kept([stages[k] for k in left], margins)
    return kept


def apart(cell: CellClearance, samples: StageSamples) -> bool:
    """Returns whether the arms keep clear of each other."""
    return bool(_kept([samples], _cross(cell))[0])


def alone_clear(cell: CellClearance, samples: StageSamples, a: int) -> bool:
    """Returns whether one arm keeps clear of itself and of all that is not the other arm."""
    return bool(_kept([samples], _own(cell, a))[0])


def _cross(cell: CellClearance) -> Margins:
    return cell.cross_margins


def _own(cell: CellClearance, a: int) -> Margins:
    def margins(position: FloatArray, held: IntArray) -> FloatArray:
        return cell.own_margins(a, position, held[:, a], ground=True)

    return margins


def _kept(stages: Sequence[StageSamples], margins: Margins) -> BoolArray:
    """Returns in which of s stages all margins are kept, shape (s,).

    At every COARSE-th instant first, then at all of them about those that have little to spare, or between which what
    is held changes, and then between these.
    """
    kept = np.ones(len(stages), dtype=np.bool_)
    if not len(stages):
        return kept
    position = np.concatenate([stage.position for stage in stages])
    held = np.concatenate([stage.held for stage in stages])
    length = np.array([len(stage.position) for stage in stages])
    last = np.cumsum(length) - 1
    stage = np.repeat(np.arange(len(stages)), length)
    within = np.arange(len(position)) - (last - length + 1)[stage]

    def looked_at(rows: IntArray, q: FloatArray, numbers: IntArray) -> FloatArray:
        found = margins(q, numbers)
        kept[stage[rows[found < KEPT]]] = False
        return found

    rows = np.flatnonzero((within % COARSE == 0) | (within == length[stage] - 1))
    margin = np.full(len(position), np.inf)
    margin[rows] = looked_at(rows, position[rows], held[rows])
    first, second = rows[:-1], rows[1:]
    close = np.minimum(margin[first], margin[second]) < NEAR * (second - first)
    # A part on a line counts only where it reaches into something: how far it is from that says nothing.
    close |= ((held[first] != held[second]) | (held[first] % 2 == 1)).any(axis=1)
    close &= (stage[first] == stage[second]) & kept[stage[first]]
    steps = (first[close, None] + np.arange(1, COARSE)).ravel()
    rows = steps[steps < np.repeat(second[close], COARSE - 1)]
    margin[rows] = looked_at(rows, position[rows], held[rows])
    tight = np.flatnonzero(np.minimum(margin[:-1], margin[1:]) < NEAR)
    tight = tight[(stage[tight] == stage[tight + 1]) & kept[stage[tight]]]
    # Between two instants joints are taken to go straight.
    share = ((np.arange(BETWEEN) + 1.0) / (BETWEEN + 1.0))[None, :, None]
    way = position[tight, None] + share * (position[tight + 1] - position[tight])[:, None]
    rows = np.repeat(tight, BETWEEN)
    looked_at(rows, way.reshape(-1, position.shape[1]), held[rows])
    return kept


def last_motion(position: FloatArray) -> int:
    """Returns the number of the instant after which nothing moves, of joints (t, columns)."""
    moves = np.flatnonzero(np.abs(np.diff(position, axis=0)).max(axis=1, initial=0.0) > 0.0)
    return int(moves[-1]) + 1 if len(moves) else 0
