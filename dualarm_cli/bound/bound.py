"""A lower bound on every rest-to-rest plan of a sequence: dynamic programming over cells that cover all postures.

What is proven, up to rounding in floating point (enclosures are widened by a thousand times as much). Of a plan that
keeps the stages, let an arm be at each stop in some cell where its approach begins (at the target if there is none)
and in some cell where its retract ends, both over one cell of the platform's angle, as the platform stands while any
arm is at its stop of the stage. `StopCells` leaves out no posture at an angle from which all arms of the stage reach
both ends of their lines, so that these cells exist. Then

- the transfer takes at least the rest-to-rest time of the slowest joint, or of the platform, over the gap between the
  two cells (times grow with the distance);
- approach, dwell and retract take at least the dwell and the larger of the lines' own bounds (`pose_cells`) and of
  the rest-to-rest time from one cell to the other: two motions from rest to rest, one after the other, are one;
- a stage lasts as long as the slower arm, so at least as long as the other arm needs for the same two cells of the
  platform with whatever postures suit it best;
- a path or seam has two stages of its own, one that ends where it begins and one that ends with it: arms that follow it
  come to its end by no transfer, and go on from anywhere where their poses there are not known (`OtherWork`).

The least sum over all sequences of cells, found backwards stage by stage for each arm, is a bound. From each stage on
the larger one of both arms' counts: a plan takes as long as either of them needs from there. Our own; the proposal to
bound pairs of cells instead of nodes stems from interval methods.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from functools import partial

import numpy as np

from dualarm_cli.bound.layers import StopCells, StopWork
from dualarm_cli.effort import EFFORTS, Resolution
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.rest_to_rest import at_rest
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import TransferChain
from dualarm_cli.stages.search.potentials import platform_columns, transfer_table
from dualarm_cli.timing.transfer_table import Pairs, PostureBoxes, Times, TransferTable

SENTENCES: Mapping[str, str] = {
    "order": "lower bound: valid for every plan of these stages, with any platform angles, postures, yaws and "
    "timing. It assumes stops at the ends of all transfers and lines, lines that are followed exactly, and a "
    "platform that stands during lines and dwells",
    "all_orders": "lower bound: valid for every assignment and order of these tasks. It counts the shortest time "
    "of each task alone, divided between the arms; transfers between tasks count as zero, tool changes as the "
    "fewest visits to stands",
    "own_clocks": "lower bound: valid for every plan of asynchronous arms in this order. It is the time of the "
    "slower arm's stops with a platform that moves for this arm only",
    "dwells_only": "lower bound: tasks after the first {tasks} count with their dwells only",
    "paths": "lower bound: paths and seams count at full speed, from rest to rest, where the file has them; an idle "
    "arm stands still. Transfers to and from them count where the file gives the tool's pose or a duration",
    "open_paths": "lower bound: paths and seams count at full speed. Transfers to and from them count with the "
    "duration in the file only, because their order is open",
    "paths_alone": "lower bound: paths and seams count at full speed. On this robot all other stages count as "
    "zero, and transfers to and from paths and seams with the duration in the file only",
    "no_closed_forms": "lower bound: none for arms without closed forms",
    "rail": "lower bound: none for a platform that slides; frozen at a position (`frozen`) there is one",
    "turning_wrists": "lower bound: none for arms of six axes on a platform that turns",
    "passed_targets": "lower bound: none with `blend` at targets of moves, because tools need not reach them",
    "interrupted": "lower bound: none, as its computation was interrupted",
}
"""Assumptions of bounds, and why there is none, by key."""
bound_note = partial(Note.of, SENTENCES, "lower bound")
"""Make a note of a bound, from its key and data."""
ROUNDED_DOWN = 1.0 - 1e-5
"""What a bound in single precision is multiplied by."""


@dataclass(frozen=True)
class LowerBound:
    """No plan is faster."""

    value: float | None
    """Least cycle time [s]; infinite where the cells prove that a stop cannot be reached, or that the arms of a stage
    share no platform angle, None where none is known."""
    assumptions: tuple[Note, ...]
    """What a plan must be like for the bound to hold, or why there is none."""


def no_bound(why: str) -> LowerBound:
    """Return what is known where there is no bound, from the key of the reason."""
    return LowerBound(None, (bound_note(why),))


@dataclass(frozen=True)
class OtherWork:
    """Paths and seams among the stages of a sequence: what n stages have besides the stops of their arms."""

    least: FloatArray
    """Least length of each stage [s], shape (n,)."""
    earliest: FloatArray
    """When each stage begins at the earliest [s], shape (n,)."""
    moved: BoolArray
    """Which arms come to the end of each stage by a path or seam, not by a transfer, shape (arms, n)."""
    at_rest: BoolArray
    """In which stages tools are at rest at their stops whatever is passed in motion elsewhere, shape (n,)."""

    @classmethod
    def none(cls, problem: SequenceProblem) -> OtherWork:
        """Returns that there are stops only."""
        n = problem.stages
        moved = np.zeros((len(problem.arms), n), dtype=np.bool_)
        return cls(np.zeros(n), np.zeros(n), moved, np.zeros(n, dtype=np.bool_))


@dataclass
class _Arm:
    """One arm while the stages are gone through backwards."""

    index: int
    """Number of the arm in the sequence."""
    table: TransferTable
    table_at_rest: TransferTable
    """For transfers from rest to rest."""
    chain: TransferChain
    here: StopWork | None = None
    """The last stop that has not been dealt with; None if there is none left."""
    to_go: Times = field(default_factory=lambda: np.zeros(1, dtype=np.float32))
    """How much longer all stages that have been dealt with take at least, from each of n cells where the next transfer
    begins, shape (n,); (1,) without a stop [s]."""

    @classmethod
    def of(
        cls, problem: SequenceProblem, index: int, table: TransferTable, works: OtherWork
    ) -> _Arm:
        """Returns an arm before any of its stages."""
        work, table_at_rest = problem.arms[index], table
        if works.at_rest.any():
            table_at_rest = transfer_table(problem, replace(work, law=at_rest(work.law)))
        return cls(index, table, table_at_rest, TransferChain.of(work))


@dataclass(frozen=True)
class _Stage:
    """What one arm has to do in a stage."""

    pairs: Pairs | None
    """Its transfers; None where it takes none."""
    known: bool
    """Whether the platform's cell before is the one where its transfer begins (else stages lie between)."""
    work: StopWork
    by_cells: Times
    """Least length of the stage for every pair of platform cells [s], shape (g, g), infinite for none."""


def lower_bound(
    problem: SequenceProblem, effort: str, works: OtherWork | None = None
) -> LowerBound:
    """Returns a bound on the cycle time of every rest-to-rest plan that keeps the stages; see the module.

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
    """Returns the borders of the platform's cells [rad], shape (g + 1,), over all angles that it may have.

    Args:
        problem: the sequence.
        step: most of a cell's width [rad].
    """
    if not problem.turns:
        return np.zeros(2)
    low, high = problem.platform_range
    if not _turns_tell(problem):
        here = float(problem.platform_start[0])
        low, high = here - 0.5 * TURN, here + 0.5 * TURN
    return np.linspace(low, high, max(1, int(np.ceil((high - low) / step - 1e-9))) + 1)


def _turns_tell(problem: SequenceProblem) -> bool:
    """Returns whether cells are of platform angles, rather than of angles modulo a turn, which need no time."""
    low, high = problem.platform_range
    return high - low <= 2.0 * TURN


def _backward(problem: SequenceProblem, resolution: Resolution, works: OtherWork) -> float:
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
            arm.to_go = _return_times(problem, arm, works)
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
                arm.to_go = _least_from(arm, stages[a], others, least, before[a])
                arm.here = before[a]
            else:
                arm.to_go = arm.to_go + max([least, *(one.min() for one in others)])
        passed += _take_common(arms)
        longest = max(longest, passed + float(works.earliest[k]))
    return longest


def _take_common(arms: list[_Arm]) -> float:
    """Takes what all stages that have been dealt with need at least off the arms' times; returns it [s].

    These stages last as long as any arm needs for them. The numbers that are left are small, so that a thousand stages
    do not add up rounding.
    """
    least = max(float(arm.to_go.min(initial=np.inf)) for arm in arms)
    if np.isfinite(least):
        for arm in arms:
            arm.to_go = np.maximum(arm.to_go - np.float32(least), np.float32(0.0))
    return least


def _return_times(problem: SequenceProblem, arm: _Arm, works: OtherWork) -> Times:
    """Returns how long the return takes at least from each cell of the last stop [s], 0 where there is none.

    A free start is closed to wherever the first transfer would end: that may be no way at all.
    """
    a, stop, last = arm.index, arm.here, int(arm.chain.active[-1])
    assert stop is not None  # an arm without stops has nothing to return from
    if not problem.returns or problem.free_start or works.moved[a, last + 1 :].any():
        return np.zeros(len(stop.retract.index), dtype=np.float32)
    without = _untold(problem, a, stop.untold, last == problem.stages - 1)
    table = arm.table_at_rest if works.at_rest[last] else arm.table
    start = _start(problem, a, table)
    return table.gap_times(stop.retract.low, stop.retract.high, start.low, start.high, without)[
        :, 0
    ]


def _untold(
    problem: SequenceProblem, a: int, free: tuple[int, ...], adjacent: bool
) -> tuple[int, ...]:
    """Returns the coordinates that do not count: those that are free, and the platform where it may turn between."""
    told = adjacent and _turns_tell(problem)
    return (*free, *(() if told else platform_columns(problem, a)))


def _start(problem: SequenceProblem, a: int, table: TransferTable) -> PostureBoxes:
    """Returns the start as the only cell; of the platform's grid it takes the first place, for both arms alike."""
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
    """Returns an arm's transfers into stage k, and its work there; the platform's grid has so many cells."""
    a, stop = arm.index, arm.here
    assert stop is not None  # callers ask for active stages only
    came = int(arm.chain.previous[k])
    begins = k == 0 and problem.free_start
    if begins or works.moved[a, came + 1 : k + 1].any():
        table = np.full((cells, cells), np.inf, dtype=np.float32)
        columns, first = np.unique(stop.approach.index, return_index=True)
        table[:, columns] = np.minimum.reduceat(stop.least, first)
        return _Stage(None, False, stop, table)
    known = came == k - 1
    origin = _start(problem, a, arm.table) if before is None else before.retract
    if not known:
        origin = replace(origin, index=np.zeros_like(origin.index))
    free = stop.untold or (() if before is None else before.untold)
    without = _untold(problem, a, free, known)
    rests = works.at_rest[k] and (before is None or works.at_rest[came])
    pairs = Pairs(arm.table_at_rest if rests else arm.table, origin, stop.approach, without)
    by_cells = pairs.by_cells(stop.least, cells)
    return _Stage(pairs, known, stop, by_cells if known else np.tile(by_cells[0], (cells, 1)))


def _least_from(
    arm: _Arm, stage: _Stage, others: list[Times], least: np.float32, before: StopWork | None
) -> Times:
    """Returns the least time from every cell before to the end, beyond what has passed, shape (n before,).

    max(transfer + work, others, least) + rest, over all retract cells, is at least the larger of the two sums' minima.
    """
    own, beyond = stage.work.with_rest(arm.to_go)
    floor = np.full_like(stage.by_cells, least)
    for other in others:
        np.maximum(floor, other if stage.known else other.min(axis=0), out=floor)
    if stage.pairs is not None:
        return stage.pairs.least_from(own, floor, beyond)
    found = np.maximum(own, floor.min(axis=0)[stage.work.approach.index] + beyond)
    return np.full(1 if before is None else len(before.retract.index), found.min())
