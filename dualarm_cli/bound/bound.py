"""Lower bound on the duration of rest-to-rest plans: dynamic programming over posture cells.

The proof holds up to rounding in floating point; enclosures are widened by a thousand times as much. At each stop of a
plan an arm begins its approach in some posture cell and ends its retract in another, both over the same platform cell,
because the platform stands still while an arm is at its stop. `StopCells` covers every posture at platform angles from
which all arms of the stage reach both ends of their lines, so that these cells exist. Then

- the transfer takes at least the rest-to-rest time of the slowest joint, or of the platform, over the gap between the
  two cells (times grow with the distance);
- approach, dwell and retract take at least the dwell plus the bounds of the lines (`pose_cells`), or longer where the
  joints are to travel farther from one cell to the other: on each line a joint starts or ends at rest at the target, so
  that its travel grows ever faster with time, and the least sum of both times lengthens only the longer line;
- a stage lasts as long as the slower arm, so at least the least time of the other arm over all its postures in the same
  two platform cells;
- a path or seam makes two stages, the first up to its begin, the second along it. Its arms reach its end without a
  transfer, and leave it from any posture if their poses there are unknown (`OtherWork`).

The least remaining time from every cell is computed backwards, stage by stage and arm by arm. Arms begin a stage at the
same time, so that from each platform cell a plan takes as long as either arm needs. Our own method; the idea to bound
pairs of cells instead of nodes comes from interval methods.
"""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from dualarm_cli.bound.layers import StopCells, StopWork
from dualarm_cli.effort import EFFORTS, Resolution
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.motion.rest_to_rest import PassingLaw
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import TransferChain
from dualarm_cli.stages.search.potentials import platform_columns
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
    passed_targets="lower bound: targets of moves with `blend` do not count, because tools need not reach them",
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

    @classmethod
    def none(cls, problem: SequenceProblem) -> OtherWork:
        """Make the data of a sequence without paths and seams."""
        n = problem.stages
        moved = np.zeros((len(problem.arms), n), dtype=np.bool_)
        return cls(np.zeros(n), np.zeros(n), moved)


@dataclass
class _Arm:
    """State of an arm in the backward pass over the stages."""

    index: int
    """Number of the arm in the sequence."""
    table: TransferTable
    chain: TransferChain
    here: StopWork | None = None
    """Last stop before the processed stages, or None."""
    remaining: Times = field(default_factory=lambda: np.zeros(1, dtype=np.float32))
    """Least remaining time from each retract cell of `here` [s], shape (n,).

    Beyond the common part of both arms; shape (1,) without a stop.
    """
    turned: Times = field(default_factory=lambda: np.zeros(1, dtype=np.float32))
    """Least remaining time after retracts from the target to these cells [s], shape (n,).

    Joints that turn back from a retract to a transfer count.
    """
    stage: int = -1
    """Stage of `here`."""

    def cells_in(self, stage: int) -> IntArray:
        """Select the platform cells of the remaining times, shape (n,).

        Empty unless `here` is in the stage.
        """
        if self.here is None or self.stage != stage:
            return np.zeros(0, dtype=np.int64)
        return self.here.retract.index

    def least_by_cell(self, stage: int, cells: int) -> Times:
        """Select the least remaining time by platform cell of a stage [s], shape (g,)."""
        least = np.full(cells, self.remaining.min(initial=np.inf), dtype=np.float32)
        present, first = np.unique(self.cells_in(stage), return_index=True)
        if len(present):
            least[present] = np.minimum.reduceat(self.remaining, first)
        return least

    def raise_to(self, least: Times | np.float32) -> None:
        """Raise the remaining times to a bound [s], broadcast to shape (n,)."""
        self.remaining = np.maximum(self.remaining, least)
        self.turned = np.maximum(self.turned, least)


@dataclass(frozen=True)
class _Stage:
    """Transfer and work of an arm in a stage."""

    pairs: Pairs | None
    """Pairs of cells of its transfer; None without a transfer."""
    consecutive: bool
    """Flag of a transfer that begins in the directly preceding stage."""
    work: StopWork

    def by_cells(self, cells: int) -> Times:
        """Compute the least stage duration by pair of platform cells [s], shape (g, g), or infinite."""
        if self.pairs is None:
            return np.tile(_least_by_cell(self.work, self.work.least, cells), (cells, 1))
        times = self.pairs.by_cells(self.work.least, cells)
        return times if self.consecutive else np.tile(times[0], (cells, 1))


def _least_by_cell(work: StopWork, times: Times, cells: int) -> Times:
    """Select the least time of approach cells by platform cell [s], shape (g,), or infinite."""
    least = np.full(cells, np.inf, dtype=np.float32)
    present, first = np.unique(work.approach.index, return_index=True)
    least[present] = np.minimum.reduceat(times, first)
    return least


def lower_bound(
    problem: SequenceProblem, effort: str, works: OtherWork | None = None
) -> LowerBound:
    """Compute the lower bound of a sequence of stages; see the module.

    Args:
        problem: the sequence.
        effort: one of EFFORTS: finer cells give a better bound.
        works: paths and seams among the stages; None for none.
    """
    value, settings = 0.0, EFFORTS[effort]
    passes = any(isinstance(arm.law, PassingLaw) for arm in problem.arms)
    resolution = settings.passing_bound if passes else settings.bound
    if problem.stages:
        value = _backward(problem, resolution, works or OtherWork.none(problem))
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
    arms = [
        _Arm(a, table, TransferChain.of(problem.arms[a])) for a, table in enumerate(cells.tables)
    ]
    pending: dict[tuple[int, int], StopWork] = {}

    def work_of(a: int, stage: int) -> StopWork | None:
        if stage < 0:
            return None
        if (a, stage) not in pending:
            pending.update({(b, stage): work for b, work in cells.works(stage).items()})
        return pending.pop((a, stage))

    for a, arm in enumerate(arms):
        if len(arm.chain.active):
            arm.stage = int(arm.chain.active[-1])
            arm.here = work_of(a, arm.stage)
            arm.turned, arm.remaining = _return_times(problem, arm, works)
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
            stages[a] = _stage(problem, arm, k, before[a], works)
        floors = _floors(arms, stages, len(edges) - 1, np.float32(works.least[k]))
        for a, (arm, floor) in enumerate(zip(arms, floors, strict=True)):
            if a in stages:
                arm.turned, arm.remaining = _least_from(arm, stages[a], floor, before[a])
                arm.here, arm.stage = before[a], int(arm.chain.previous[k])
                continue
            arm.raise_to(arm.remaining + floor.min())
        _begin_together(arms, k - 1, len(edges) - 1)
        passed += _take_common(arms)
        begins = max(float(arm.turned.min(initial=np.inf)) for arm in arms)
        longest = max(longest, passed + begins + float(works.earliest[k]))
    return longest


def _floors(
    arms: list[_Arm], stages: dict[int, _Stage], cells: int, least: np.float32
) -> list[Times]:
    """Bound the time of each arm in a stage by the other arms [s].

    By pair of platform cells, shape (g, g).
    """
    times = {a: stage.by_cells(cells) for a, stage in stages.items()}
    floors = []
    for a in range(len(arms)):
        floor = np.full((cells, cells), least)
        adjacent = a in stages and stages[a].consecutive
        for b, bound in times.items():
            if b != a:
                np.maximum(floor, bound if adjacent else bound.min(axis=0), out=floor)
        floors.append(floor)
    return floors


def _begin_together(arms: list[_Arm], stage: int, cells: int) -> None:
    """Raise remaining times to those of the other arm, which begins at the same time.

    In the same platform cell where both worked in the stage before, whose number is given.
    """
    least = [arm.least_by_cell(stage, cells) for arm in arms]
    for arm, others in zip(arms, reversed(least) if len(arms) == 2 else least, strict=True):
        here = arm.cells_in(stage)
        arm.raise_to(others[here] if len(here) else others.min())


def _take_common(arms: list[_Arm]) -> float:
    """Subtract the common part from the arms' remaining times; returns it [s].

    The remainders stay small, so that the rounding of a thousand stages does not add up.
    """
    least = min(float(arm.remaining.min(initial=np.inf)) for arm in arms)
    if np.isfinite(least):
        for arm in arms:
            arm.remaining = arm.remaining - np.float32(least)
            arm.turned = arm.turned - np.float32(least)
    return least


def _return_times(problem: SequenceProblem, arm: _Arm, works: OtherWork) -> tuple[Times, Times]:
    """Compute the least return time from each cell of the last stop [s], shape (n,) each.

    After the retract from its target, and after any motion. Zero without a return, and with a free start, because the
    cycle may close without motion.
    """
    a, stop, last = arm.index, arm.here, int(arm.chain.active[-1])
    assert stop is not None  # an arm without stops has nothing to return from
    if not problem.returns or problem.free_start or works.moved[a, last + 1 :].any():
        return (np.zeros(len(stop.retract.index), dtype=np.float32),) * 2
    without = _ignored(problem, a, stop.ignored, last == problem.stages - 1)
    cells = 1 + int(stop.retract.index.max(initial=0))
    table, zero = arm.table, np.zeros(1, dtype=np.float32)
    floor = np.zeros((cells, cells), dtype=np.float32)
    return Pairs(table, stop.retract, _start(problem, a, table), without).least_from(
        zero, zero, floor, zero
    )


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
    low, high = table.box(q, q)
    at_rest = np.zeros((2, *low.shape), dtype=np.int16)
    return PostureBoxes(zero, zero, low, high, np.zeros(1, dtype=np.float32), at_rest, np.inf)


def _stage(
    problem: SequenceProblem,
    arm: _Arm,
    k: int,
    before: StopWork | None,
    works: OtherWork,
) -> _Stage:
    """Prepare an arm's transfer and work in stage k."""
    a, stop = arm.index, arm.here
    assert stop is not None  # callers ask for active stages only
    previous = int(arm.chain.previous[k])
    begins = k == 0 and problem.free_start
    if begins or works.moved[a, previous + 1 : k + 1].any():
        return _Stage(None, False, stop)
    consecutive = previous == k - 1
    origin = _start(problem, a, arm.table) if before is None else before.retract
    if not consecutive:
        origin = replace(origin, index=np.zeros_like(origin.index))
    free = stop.ignored or (() if before is None else before.ignored)
    without = _ignored(problem, a, free, consecutive)
    pairs = Pairs(arm.table, origin, stop.approach, without)
    return _Stage(pairs, consecutive, stop)


def _least_from(
    arm: _Arm, stage: _Stage, floor: Times, before: StopWork | None
) -> tuple[Times, Times]:
    """Compute the least remaining times from every cell of the stop before [s], shape (n,) each.

    After its retract, and after any motion.

    Args:
        arm: the arm.
        stage: its transfer and work.
        floor: least time by the other arms, see `_floors`.
        before: its stop before, or None.
    """
    work_and_rest, beyond = stage.work.with_rest(arm.remaining, arm.turned)
    if stage.pairs is not None:
        onward = stage.work.onward(arm.turned)
        return stage.pairs.least_from(work_and_rest, onward, floor, beyond)
    totals = np.maximum(work_and_rest, floor.min(axis=0)[stage.work.approach.index] + beyond)
    return (np.full(1 if before is None else len(before.retract.index), totals.min()),) * 2
