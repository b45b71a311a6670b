"""Critical path of a schedule: what decides its cycle time, with all slack.

The slack of a piece follows from re-timing: all that waits for what is known from the segments (`cycle_times`), so the
piece is delayed by far, and the delay that the cycle does not show is its slack. Between synchronous arms that is
exact. Asynchronous arms may have to wait for each other where they do not in the plan: their slack is an upper bound.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Schedule, Segment, Stage
from dualarm_cli.motion.waiting import MOVES
from dualarm_cli.records import dataclass
from dualarm_cli.report.stage_parts import PLATFORM, stages_of
from dualarm_cli.verification.varied_cycle import cycle_times

CRITICAL = 1e-6
"""Slack up to which a piece decides the cycle time [s]."""


@dataclass(frozen=True)
class TimedPiece:
    """Motion, dwell or wait of an arm or of the platform."""

    group: str
    """Name of the arm, or PLATFORM."""
    kind: str
    """Kind of its segment; `turn` for a motion of the platform."""
    task: str
    """Id of the task; empty for the platform and for returns."""
    action: str
    """Action at the target; empty for the platform and for returns."""
    stage: int
    """Index of its stage."""
    start: float
    """Start time [s]."""
    end: float
    """End time [s]."""
    length: float
    """Time that it takes by itself, without waiting for others [s]."""
    reason: str = ""
    """Reason of a wait; empty for others."""
    segment: int = -1
    """Index of its segment; -1 for the platform."""
    stretched_to: tuple[int, ...] = ()
    """Indices of the pieces with which it ends together if they take longer."""
    slack: float = 0.0
    """Delay that does not make the cycle longer [s]."""

    @property
    def is_critical(self) -> bool:
        """Whether a delay makes the cycle longer."""
        return self.slack <= CRITICAL


@dataclass(frozen=True)
class CriticalPath:
    """Pieces of a schedule with their slack, and the chain that decides its cycle time."""

    pieces: tuple[TimedPiece, ...]
    """All pieces in order of time."""
    chain: tuple[tuple[TimedPiece | None, float, float], ...]
    """Critical pieces in order, with the times from and to which each decides [s].

    None stands for time that no motion decides: a window, or a part on a conveyor.
    """

    def seconds(self) -> dict[tuple[str, str], float]:
        """Sum the chain's time by group and kind of piece [s], largest first."""
        time: dict[tuple[str, str], float] = {}
        for piece, start, end in self.chain:
            key = (piece.group, piece.kind) if piece is not None else ("", "wait")
            time[key] = time.get(key, 0.0) + end - start
        return dict(sorted(time.items(), key=lambda item: (-item[1], item[0])))


def critical_path(schedule: Schedule) -> CriticalPath:
    """Find the critical path of a schedule, and the slack of all pieces.

    Args:
        schedule: a plan with stages and segments.
    """
    pieces = pieces_of(schedule)
    if not pieces:
        return CriticalPath((), ())
    far = schedule.duration + 1.0
    lengths = np.tile([piece.length for piece in pieces], (len(pieces), 1))
    np.fill_diagonal(lengths, lengths.diagonal() + far)
    slack = far - (retimed(schedule, pieces, lengths) - schedule.duration)
    delayed = [
        replace(piece, slack=max(0.0, float(delay)))
        for piece, delay in zip(pieces, slack, strict=True)
    ]
    delayed.sort(key=lambda piece: (piece.start, piece.end, piece.group))
    return CriticalPath(tuple(delayed), _chain(delayed, schedule.duration))


def retimed(schedule: Schedule, pieces: Sequence[TimedPiece], lengths: FloatArray) -> FloatArray:
    """Compute the cycle times of a plan whose pieces take other times [s], shape (count,).

    Args:
        schedule: the plan.
        pieces: of the plan, in the order of `pieces_of`.
        lengths: time that each piece takes by itself in each case [s], shape (count, pieces).
    """
    longer: dict[int, FloatArray] = {}
    for k, piece in enumerate(pieces):
        if piece.segment >= 0:
            together = [k, *piece.stretched_to]
            before = max(pieces[i].length for i in together)
            longer[piece.segment] = lengths[:, together].max(axis=1) - before
    return cycle_times(schedule, longer, len(lengths))


def pieces_of(schedule: Schedule) -> list[TimedPiece]:
    """List the pieces of a schedule, those of the platform first.

    A wait for another arm or for the platform is no piece, as it has no length of its own; the delay of a transfer that
    keeps synchronous arms apart is one.
    """
    stages = schedule.stages
    pieces = [
        TimedPiece(PLATFORM, "turn", "", "", k, stage.start, stage.start + time, time)
        for k, stage in enumerate(stages)
        if (time := stage.platform_time) > 0.0
    ]
    turns = {piece.stage: i for i, piece in enumerate(pieces)}
    arms: dict[int, list[int]] = {}
    for k, (part, stage) in enumerate(
        zip(schedule.segments, stages_of(schedule.segments, stages), strict=True)
    ):
        is_move = part.kind in MOVES
        if part.kind == "wait" and (part.reason != "shared_zone" or stages[stage].arm):
            continue
        alone = _own_time(part, stages[stage], schedule.robot.platform != ()) if is_move else None
        length = part.end - part.start if alone is None else alone
        if part.kind == "return":
            arms.setdefault(stage, []).append(len(pieces))
        stretched = (turns[stage],) if is_move and stage in turns else ()
        names = part.arm, part.kind, part.task, part.action
        times = part.start, part.end, length, part.reason
        pieces.append(TimedPiece(*names, stage, *times, segment=k, stretched_to=stretched))
    for group in arms.values():
        for i in group:
            others = tuple(j for j in group if j != i)
            if pieces[i].length < pieces[i].end - pieces[i].start - SAME_TIME:
                together = (*pieces[i].stretched_to, *others)
                pieces[i] = replace(pieces[i], stretched_to=together)
    return pieces


def _own_time(part: Segment, stage: Stage, has_platform: bool) -> float:
    """Compute how long a transfer takes without waiting for what arrives with it [s]."""
    actual, alone = part.end - part.start, stage.arm_times.get(part.arm, 0.0)
    groups = {PLATFORM: stage.platform_time} if has_platform else {}
    if part.kind == "return":
        groups |= stage.arm_times
    others = max((time for name, time in groups.items() if name != part.arm), default=0.0)
    return min(alone, actual) if others >= actual - CRITICAL else actual


def _chain(
    pieces: Sequence[TimedPiece], duration: float
) -> tuple[tuple[TimedPiece | None, float, float], ...]:
    """Select one critical piece for every instant, of one arm as long as possible."""
    critical = [piece for piece in pieces if piece.is_critical]
    chain: list[tuple[TimedPiece | None, float, float]] = []
    clock, group = 0.0, ""
    while clock < duration - CRITICAL:
        running = [p for p in critical if p.start <= clock + CRITICAL and p.end > clock + CRITICAL]
        if running:
            # A platform that decides comes before the arms that arrive with it.
            piece = min(
                running, key=lambda p: (p.length < p.end - p.start - CRITICAL, p.group != group)
            )
            chain.append((piece, clock, piece.end))
            clock, group = piece.end, piece.group
            continue
        begins = min((p.start for p in critical if p.start > clock), default=duration)
        chain.append((None, clock, begins))
        clock = begins
    return tuple(chain)
