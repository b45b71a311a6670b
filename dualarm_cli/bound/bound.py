"""Lower bound on the duration of rest-to-rest plans: dynamic programming over posture cells.

The proof holds up to rounding in floating point; enclosures are widened by a thousand times as much. At each stop of a
plan an arm begins its approach in some posture cell and ends its retract in another, both over the same platform cell,
because the platform stands still while an arm is at its stop. `StopCells` covers every posture at platform angles from
which all arms of the stage reach both ends of their lines, so that these cells exist. Then

- the transfer takes at least the rest-to-rest time of the slowest joint, or of the platform, over the gap between the
  two cells (times grow with the distance);
- approach, dwell and retract take at least the dwell plus the larger of two times: the bound of the lines
  (`pose_cells`), and the rest-to-rest time between the two cells (two consecutive rest-to-rest motions take no less
  than a single one);
- a stage lasts as long as the slower arm, so at least the least time of the other arm over all its postures in the
  same two platform cells;
- a path or seam makes two stages, the first up to its begin, the second along it. Its arms reach its end without a
  transfer, and leave it from any posture if their poses there are unknown (`OtherWork`).

The least sum over all sequences of cells is computed backwards, stage by stage and arm by arm. From each stage on the
larger sum of the two arms is a bound, because a plan takes as long as either arm needs from there. Our own method; the
idea to bound pairs of cells instead of nodes comes from interval methods.
"""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from dualarm_cli.bound.layers import StopCells, StopWork
from dualarm_cli.effort import EFFORTS, Resolution
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.rest_to_rest import at_rest
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import TransferChain
from dualarm_cli.stages.search.potentials import platform_columns, transfer_table
from dualarm_cli.timing.transfer_table import Pairs, PostureBoxes, Times, TransferTable

bound_note = NoteTable(
    "lower bound",
    order="lower bound: valid for every plan of these stages, with any platform angles, postures, yaws and "
    "timing. It assumes stops at the ends of all transfers and lines, lines that are followed exactly, and a "
    "platform that stands during lines and dwells",
    all_orders="lower bound: valid for every assignment and order of these tasks. It counts the shortest time "
    "of each task alone, divided between the arms; transfers between tasks count as zero, tool changes as the "
    "fewest visits to stands",
    own_clocks="lower bound: valid for every plan of asynchronous arms in this order. It is the time of the "
    "slower arm's stops with a platform that moves for this arm only",
    dwells_only="lower bound: tasks after the first {tasks} count with their dwells only",
    paths="lower bound: paths and seams count at full speed, from rest to rest, where the file has them; an "
    "idle arm stands still. Transfers to and from them count where the file gives the tool's pose or a duration",
    open_paths="lower bound: paths and seams count at full speed. Transfers to and from them count with the "
    "duration in the file only, because their order is open",
    paths_alone="lower bound: paths and seams count at full speed. On this robot all other stages count as "
    "zero, and transfers to and from paths and seams with the duration in the file only",
    no_closed_forms="lower bound: none for arms without closed forms",
    rail="lower bound: none for a platform that slides; frozen at a position (`frozen`) there is one",
    turning_wrists="lower bound: none for arms of six axes on a platform that turns",
    passed_targets="lower bound: none with `blend` at targets of moves, because tools need not reach them",
    interrupted="lower bound: none, as its computation was interrupted",
)
"""Notes on the assumptions of a bound, or on its absence."""
ROUNDED_DOWN = 1.0 - 1e-5
"""Factor that covers the rounding of bounds in single precision."""


@dataclass(frozen=True)
class LowerBound:
    """Lower bound on the cycle time of a job's plans, with its assumptions."""

    value: float | None
    """Lower bound on the cycle time [s], or None.

    Infinite if the cells prove that a stop is out of reach, or that the arms of a stage share no platform angle.
    """
    assumptions: tuple[Note, ...]
    """Notes on the plans for which the bound holds, or on its absence."""


def no_bound(why: Note) -> LowerBound:
    """Make the result of a job without a bound from the reason."""
    return LowerBound(None, (why,))


@dataclass(frozen=True)
class OtherWork:
    """Paths and seams among the n stages of a sequence."""

    least: FloatArray
    """Least length of each stage [s], shape (n,)."""
    earliest: FloatArray
    """Earliest begin of each stage [s], shape (n,)."""
    moved: BoolArray
    """Mask of arms that end a stage by a path or seam, (arms, n)."""
    at_rest: BoolArray
    """Mask of stages whose stops are at rest even with blending, shape (n,)."""

    @classmethod
    def none(cls, problem: SequenceProblem) -> OtherWork:
        """Make the data of a sequence without paths and seams."""
        n = problem.stages
        moved = np.zeros((len(problem.arms), n), dtype=np.bool_)
        return cls(np.zeros(n), np.zeros(n), moved, np.zeros(n, dtype=np.bool_))


@dataclass
class _Arm:
    """State of an arm in the backward pass over the stages."""

    index: int
    """Number of the arm in the sequence."""
    table: TransferTable
    table_at_rest: TransferTable
    """Transfer times from rest to rest, without blending."""
    chain: TransferChain
    here: StopWork | None = None
    """Last stop before the processed stages, or None."""
    remaining: Times = field(default_factory=lambda: np.zeros(1, dtype=np.float32))
    """Least remaining time from each retract cell of `here` [s], shape (n,).

    Beyond the common part of both arms; shape (1,) without a stop.
    """

    @classmethod
    def of(
        cls, problem: SequenceProblem, index: int, table: TransferTable, works: OtherWork
    ) -> _Arm:
        """Make the state of an arm after its last stage."""
        work, table_at_rest = problem.arms[index], table
        if works.at_rest.any():
            table_at_rest = transfer_table(problem, replace(work, law=at_rest(work.law)))
        return cls(index, table, table_at_rest, TransferChain.of(work))


@dataclass(frozen=True)
class _Stage:
    """Transfer and work of an arm in a stage."""

    pairs: Pairs | None
    """Pairs of cells of its transfer; None without a transfer."""
    consecutive: bool
    """Flag of a transfer that begins in the directly preceding stage."""
    work: StopWork
    by_cells: Times
    """Least stage duration by pair of platform cells [s], shape (g, g), or infinite."""


def lower_bound(
    problem: SequenceProblem, effort: str, works: OtherWork | None = None
) -> LowerBound:
    """Compute the lower bound of a sequence of stages; see the module.

    Args:
        problem: the sequence.
        effort: one of EFFORTS: finer cells give a better bound.
        works: paths and seams among the stages; None for none.
    """
    value = 0.0
    if problem.stages:
        value = _backward(problem, EFFORTS[effort].bound, works or OtherWork.none(problem))
    return LowerBound(max(0.0, value * ROUNDED_DOWN), (bound_note("order"),))


def platform_edges(problem: SequenceProblem, step: float) -> FloatArray:
    """Divide the platform's range into cells: borders [rad], shape (g + 1,).

    Args:
        problem: the sequence.
        step: maximum width of a cell [rad].
    """
    if not problem.turns:
        return np.zeros(2)
    low, high = problem.platform_range
    if not _platform_counts(problem):
        here = float(problem.platform_start[0])
        low, high = here - 0.5 * TURN, here + 0.5 * TURN
    return np.linspace(low, high, max(1, int(np.ceil((high - low) / step - 1e-9))) + 1)


def _platform_counts(problem: SequenceProblem) -> bool:
    """Check that cells are platform angles, not angles modulo a turn.

    Between angles modulo a turn the platform's motion counts as zero.
    """
    low, high = problem.platform_range
    return high - low <= 2.0 * TURN


def _backward(problem: SequenceProblem, resolution: Resolution, works: OtherWork) -> float:
    """Compute the bound [s] by a backward pass over the stages."""
    edges = platform_edges(problem, resolution.step)
    cells = StopCells(problem, edges, resolution)
    arms = [_Arm.of(problem, a, table, works) for a, table in enumerate(cells.tables)]
    pending: dict[tuple[int, int], StopWork] = {}

    def work_of(a: int, stage: int) -> StopWork | None:
        if stage < 0:
            return None
        if (a, stage) not in pending:
            pending.update({(b, stage): work for b, work in cells.works(stage).items()})
        return pending.pop((a, stage))

    for a, arm in enumerate(arms):
        if len(arm.chain.active):
            arm.here = work_of(a, int(arm.chain.active[-1]))
            arm.remaining = _return_times(problem, arm, works)
    passed = _take_common(arms)
    longest = 0.0
    for k in range(problem.stages - 1, -1, -1):
        stages, before = {}, {}
        for a, arm in enumerate(arms):
            if arm.here is None or problem.arms[a].stops[k] is None:
                continue
            before[a] = work_of(a, int(arm.chain.previous[k]))
            if not all(stop is None or stop.possible for stop in (arm.here, before[a])):
                return np.inf
            stages[a] = _stage(problem, arm, k, before[a], len(edges) - 1, works)
        least = np.float32(works.least[k])
        for a, arm in enumerate(arms):
            others = [stage.by_cells for b, stage in stages.items() if b != a]
            if a in stages:
                arm.remaining = _least_from(arm, stages[a], others, least, before[a])
                arm.here = before[a]
            else:
                arm.remaining = arm.remaining + max([least, *(times.min() for times in others)])
        passed += _take_common(arms)
        longest = max(longest, passed + float(works.earliest[k]))
    return longest


def _take_common(arms: list[_Arm]) -> float:
    """Subtract the common part from the arms' remaining times; returns it [s].

    The processed stages last as long as the slower arm needs for them. The remainders stay small, so that the rounding
    of a thousand stages does not add up.
    """
    least = max(float(arm.remaining.min(initial=np.inf)) for arm in arms)
    if np.isfinite(least):
        for arm in arms:
            arm.remaining = np.maximum(arm.remaining - np.float32(least), np.float32(0.0))
    return least


def _return_times(problem: SequenceProblem, arm: _Arm, works: OtherWork) -> Times:
    """Compute the least return time from each cell of the last stop [s].

    Zero without a return, and with a free start, because the cycle may close without motion.
    """
    a, stop, last = arm.index, arm.here, int(arm.chain.active[-1])
    assert stop is not None  # an arm without stops has nothing to return from
    if not problem.returns or problem.free_start or works.moved[a, last + 1 :].any():
        return np.zeros(len(stop.retract.index), dtype=np.float32)
    without = _ignored(problem, a, stop.ignored, last == problem.stages - 1)
    table = arm.table_at_rest if works.at_rest[last] else arm.table
    start = _start(problem, a, table)
    return table.gap_times(stop.retract.low, stop.retract.high, start.low, start.high, without)[
        :, 0
    ]


def _ignored(
    problem: SequenceProblem, a: int, free: tuple[int, ...], adjacent: bool
) -> tuple[int, ...]:
    """Select the coordinates to ignore: free ones, and the platform unless the stages are adjacent."""
    counts = adjacent and _platform_counts(problem)
    return (*free, *(() if counts else platform_columns(problem, a)))


def _start(problem: SequenceProblem, a: int, table: TransferTable) -> PostureBoxes:
    """Make the cell of the start configuration, the first in the platform's grid."""
    q = problem.arms[a].start[None]
    if problem.turns:
        q = np.column_stack([q, problem.platform_start[None]])
    zero = np.zeros(1, dtype=np.int64)
    return PostureBoxes(zero, zero, *table.box(q, q), np.zeros(1, dtype=np.float32))


def _stage(
    problem: SequenceProblem,
    arm: _Arm,
    k: int,
    before: StopWork | None,
    cells: int,
    works: OtherWork,
) -> _Stage:
    """Compute an arm's transfer and work in stage k; `cells` is the platform grid's size."""
    a, stop = arm.index, arm.here
    assert stop is not None  # callers ask for active stages only
    previous = int(arm.chain.previous[k])
    begins = k == 0 and problem.free_start
    if begins or works.moved[a, previous + 1 : k + 1].any():
        table = np.full((cells, cells), np.inf, dtype=np.float32)
        columns, first = np.unique(stop.approach.index, return_index=True)
        table[:, columns] = np.minimum.reduceat(stop.least, first)
        return _Stage(None, False, stop, table)
    consecutive = previous == k - 1
    origin = _start(problem, a, arm.table) if before is None else before.retract
    if not consecutive:
        origin = replace(origin, index=np.zeros_like(origin.index))
    free = stop.ignored or (() if before is None else before.ignored)
    without = _ignored(problem, a, free, consecutive)
    rests = works.at_rest[k] and (before is None or works.at_rest[previous])
    pairs = Pairs(arm.table_at_rest if rests else arm.table, origin, stop.approach, without)
    by_cells = pairs.by_cells(stop.least, stop.from_target(0.0, cells))
    return _Stage(
        pairs, consecutive, stop, by_cells if consecutive else np.tile(by_cells[0], (cells, 1))
    )


def _least_from(
    arm: _Arm, stage: _Stage, others: list[Times], least: np.float32, before: StopWork | None
) -> Times:
    """Compute the least remaining time from every cell of the stop before [s].

    max(transfer + work, others, least) + rest, over all retract cells, is at least the larger minimum of the two sums.
    """
    work_and_rest, beyond = stage.work.with_rest(arm.remaining)
    floor = np.full_like(stage.by_cells, least)
    for times in others:
        np.maximum(floor, times if stage.consecutive else times.min(axis=0), out=floor)
    if stage.pairs is not None:
        from_target = stage.work.from_target(arm.remaining, len(floor))
        return stage.pairs.least_from(work_and_rest, from_target, floor, beyond)
    totals = np.maximum(work_and_rest, floor.min(axis=0)[stage.work.approach.index] + beyond)
    return np.full(1 if before is None else len(before.retract.index), totals.min())
