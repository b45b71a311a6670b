"""Posture of least time: all branches over the arm angle, lines included, then refined; many stops at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, distinct
from dualarm_cli.geometry.elementary import power
from dualarm_cli.kinematics.srs.srs_limits import wrap
from dualarm_cli.postures.line_following import FollowedLines, Lines
from dualarm_cli.postures.problem import POSTURES, NoPosture, Place, StopPosture, StopProblem
from dualarm_cli.postures.stop_batch import StopBatch, batches
from dualarm_cli.postures.target_grid import target_postures
from dualarm_cli.postures.ways import StopWays, transfer_cost
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


def coarse_ways(
    batch: StopBatch,
    grid: Sequence[StopWays | NoPosture],
    rows: Sequence[int],
    complete: bool,
) -> StopWays:
    """Returns postures at targets with their best swings, problem by problem and best first.

    Timing lines costs most: those that cannot come near the best are left out, unless all ways are asked for.

    Args:
        batch: the problems.
        grid: the postures at their targets.
        rows: the problems whose ways are asked for.
        complete: whether all ways are timed.
    """
    ways = StopWays.together([one for row in rows if isinstance(one := grid[row], StopWays)])
    swings = np.array(POSTURES.swings if batch.length.any() else (0.0,))
    sides = _sides(batch, ways, swings)
    transfer, travel = transfer_cost(batch, ways.row, sides[0][1].at(-1))
    least = np.empty((2, *transfer.shape))
    for side in (0, 1):
        lines, followed = sides[side % len(sides)]
        least[side] = POSTURES.sure * lines.least_times(followed)
    least[0] += transfer + travel
    wanted = np.isfinite(least)
    if complete:
        line = _line_times(sides, wanted)
    else:
        first = _first(ways.row, least.min(axis=2).sum(axis=0))[:, None]
        line = _line_times(sides, wanted & first)
        best = _best_of_row(
            ways.row, (transfer + travel + line[0]).min(axis=1) + line[1].min(axis=1)
        )
        # The two lines share what the best takes: one has what the other, at its least, leaves.
        other = least.min(axis=2)[::-1, :, None]
        worth = wanted & np.isfinite(other)
        worth[worth] = (least + np.where(worth, other, 0.0) <= POSTURES.near * best[:, None])[worth]
        line = np.minimum(line, _line_times(sides, worth & ~first))
    cost_in, own = transfer + travel + line[0], np.arange(len(ways.row))
    k_in, k_out = cost_in.argmin(axis=1), line[1].argmin(axis=1)
    cost = cost_in[own, k_in] + line[1, own, k_out]
    ways = replace(
        ways,
        swing_in=swings[k_in],
        swing_out=swings[k_out],
        time=transfer[own, k_in] + line[0, own, k_in] + line[1, own, k_out],
        cost=cost,
    )
    order = np.lexsort((cost, ways.row))
    return _spread(ways.take(order[np.isfinite(cost[order])]))


def _spread(ways: StopWays) -> StopWays:
    """Returns sorted ways with the best one of each problem that is far from its very best in second place."""
    first = np.flatnonzero(np.diff(ways.row, prepend=-1))
    best = np.repeat(first, np.diff(np.append(first, len(ways.row))))
    turned = np.stack([ways.psi - ways.psi[best], ways.yaw - ways.yaw[best]])
    far = (np.abs(wrap(turned)) > POSTURES.far).any(axis=0) | (ways.branch != ways.branch[best])
    place = np.arange(len(ways.row), dtype=np.float64)
    far_ones = np.flatnonzero(far)
    second = far_ones[np.diff(ways.row[far_ones], prepend=-1) > 0]
    place[second] = best[second] + 0.5
    return ways.take(np.argsort(place, kind="stable"))


def _sides(
    batch: StopBatch, ways: StopWays, swings: FloatArray
) -> list[tuple[Lines, FollowedLines]]:
    """Returns approach and retract of every way with every swing; one for both where they are equal."""
    alike = np.array_equal(batch.length[:, 0], batch.length[:, 1])
    psi = np.broadcast_to(ways.psi[:, None], (len(ways.row), len(swings)))
    poses, reference = ways.poses(batch), ways.reference(batch)
    sides = []
    for side in (0,) if alike else (0, 1):
        lines = Lines.of(batch, poses, batch.length[ways.row, side], POSTURES.line_samples)
        sides.append((lines, lines.follow(psi, psi + swings, ways.branch, reference)))
    return sides


def _line_times(sides: Sequence[tuple[Lines, FollowedLines]], wanted: BoolArray) -> FloatArray:
    """Returns times of wanted lines [s], infinite for others, shape (2, n, s)."""
    if len(sides) == 1:
        ((lines, followed),) = sides
        both = lines.times(followed, wanted[0] | wanted[1])
        return np.stack([both, both])
    return np.stack(
        [lines.times(followed, one) for (lines, followed), one in zip(sides, wanted, strict=True)]
    )


def _first(row: IntArray, least: FloatArray) -> BoolArray:
    """Mark the `looked_at_first` least entries of each problem, shape (n,)."""
    order = np.lexsort((least, row))
    place = np.arange(len(row)) - np.searchsorted(row[order], row[order], side="left")
    first = np.zeros(len(row), dtype=np.bool_)
    first[order[place < POSTURES.looked_at_first]] = True
    return first


def _best_of_row(row: IntArray, total: FloatArray) -> FloatArray:
    """Returns the least total of each entry's problem, shape (n,); row ascends."""
    first = np.flatnonzero(np.diff(row, prepend=-1))
    counts = np.diff(np.append(first, len(row)))
    return np.repeat(np.minimum.reduceat(total, first), counts)


def _steps(count: int) -> FloatArray:
    """Returns an odd number of equal steps from -1 to 1, no step being the first of them and the only one of one."""
    half = count // 2
    return np.roll(np.arange(-half, half + 1) / max(half, 1), -half)


@dataclass(frozen=True)
class _Pattern:
    """How rounds of refinement vary a way: every combination of yaws, arm angles and swings is looked at."""

    yaw: FloatArray
    """Variations of the yaw, as shares of the half-width; none is the first."""
    psi: FloatArray
    """Of the arm angle at the target."""
    swing: FloatArray
    """Of each line's swing."""
    shrink: float
    """Half-width of a round as a share of that of the one before."""
    rounds: int
    """How many rounds there are."""

    @classmethod
    def of(cls, batch: StopBatch) -> _Pattern:
        """Returns what is free to vary in the problems of a batch, as finely as it is cheap."""
        if batch.length.any():
            yaw, psi = 3 if batch.free_yaw else 1, 1 if batch.given else 5
            return cls(_steps(yaw), _steps(psi), _steps(5), 0.6, 6)
        yaw, psi, shrink = (9, 9, 0.25) if batch.free_yaw else (1, 17, 0.125)
        return cls(_steps(yaw), _steps(1 if batch.given else psi), _steps(1), shrink, 3)

    def thinned(self) -> _Pattern:
        """Returns the same with three variations at most of each."""
        yaw, psi, swing = (_steps(min(3, len(v))) for v in (self.yaw, self.psi, self.swing))
        return replace(self, yaw=yaw, psi=psi, swing=swing)


def refinements(batch: StopBatch, ways: StopWays) -> list[StopWays]:
    """Returns one ever better way of each problem, the first one given; all in lockstep.

    Of several ways of one problem the best after `all_ways` rounds goes on alone.

    In a round every combination of a few yaws, arm angles at the target and swings of approach and retract is looked
    at; given the target the two lines do not depend on each other, so that each is followed for its own swings only
    and the best of both belong together.

    Args:
        batch: the problems.
        ways: ways that can be gone, problem by problem.
    """
    pattern = _Pattern.of(batch)
    found = [ways]
    lines: Lines | None = None
    for k in range(pattern.rounds):
        width = POSTURES.first_width * power(pattern.shrink, k)
        if k == POSTURES.all_ways:
            best = leading(found[-1])
            if len(best) < len(ways.row):
                found, lines = [stage.take(best) for stage in found], None
        last = found[-1]
        yaw = last.yaw[:, None] + width * pattern.yaw
        if lines is None or batch.free_yaw:
            lines = _lines(batch, last, yaw)
        found.append(_better(batch, last, lines, pattern, width))
    return found


def variation(batch: StopBatch, ways: StopWays, width: float) -> StopWays:
    """Returns the best of one round of variation of each way, by up to a half-width [rad]; or the way itself."""
    pattern = _Pattern.of(batch).thinned()
    lines = _lines(batch, ways, ways.yaw[:, None] + width * pattern.yaw)
    return _better(batch, ways, lines, pattern, width)


def leading(ways: StopWays) -> IntArray:
    """Returns the index of the best way of each problem."""
    order = np.lexsort((ways.cost, ways.row))
    best: IntArray = order[np.diff(ways.row[order], prepend=-1) > 0]
    return best


def _lines(batch: StopBatch, ways: StopWays, yaw: FloatArray) -> Lines:
    """Returns both lines of n ways from y yaws (n, y) each, in the order (n, y, approach and retract)."""
    y = yaw.shape[1]
    row, target = np.repeat(ways.row, y), np.repeat(ways.target, y)
    poses = batch.poses(row, target, yaw.ravel())
    twice = np.repeat(np.arange(len(row)), 2)
    return Lines.of(batch, poses.take(twice), batch.length[row].ravel(), POSTURES.line_samples)


def _better(
    batch: StopBatch, ways: StopWays, lines: Lines, pattern: _Pattern, width: float
) -> StopWays:
    """Returns the best variation of each way, or the way itself where none is better."""
    n, y, t, s = len(ways.row), len(pattern.yaw), len(pattern.psi), len(pattern.swing)
    psi = ways.psi[:, None] + width * pattern.psi
    swings = np.stack([ways.swing_in, ways.swing_out], axis=1)[:, :, None] + width * pattern.swing
    shape = (n, y, 2, t, s)
    psi_target = np.broadcast_to(psi[:, None, None, :, None], shape)
    psi_end = psi_target + swings[:, None, :, None, :]
    each = np.repeat(np.arange(n), 2 * y)
    followed = lines.follow(
        psi_target.reshape(-1, t * s),
        psi_end.reshape(-1, t * s),
        ways.branch[each],
        ways.reference(batch)[each],
    )
    end = followed.at(-1).reshape(*shape, 7)[:, :, 0]
    transfer, travel = transfer_cost(batch, ways.row, end)
    least = lines.least_times(followed).reshape(shape) * POSTURES.sure
    least[:, :, 0] += transfer + travel
    # Of the two lines one cannot be worth more than what the other leaves.
    room = (ways.cost[:, None, None, None] - least.min(axis=4))[:, :, ::-1]
    wanted = least < room[..., None]
    line = lines.times(followed, wanted.reshape(len(each), -1)).reshape(shape)
    time_in = transfer + line[:, :, 0]
    cost_in = time_in + travel
    best_in, best_out = cost_in.argmin(axis=3), line[:, :, 1].argmin(axis=3)
    total = (cost_in.min(axis=3) + line[:, :, 1].min(axis=3)).reshape(n, -1)
    index, own = total.argmin(axis=1), np.arange(n)
    at_yaw, at_psi = np.divmod(index, t)
    k_in, k_out = best_in[own, at_yaw, at_psi], best_out[own, at_yaw, at_psi]
    better = total[own, index] < ways.cost
    time = time_in[own, at_yaw, at_psi, k_in] + line[own, at_yaw, 1, at_psi, k_out]
    return replace(
        ways,
        yaw=np.where(better, ways.yaw + width * pattern.yaw[at_yaw], ways.yaw),
        psi=np.where(better, psi[own, at_psi], ways.psi),
        swing_in=np.where(better, swings[own, 0, k_in], ways.swing_in),
        swing_out=np.where(better, swings[own, 1, k_out], ways.swing_out),
        time=np.where(better, time, ways.time),
        cost=np.where(better, total[own, index], ways.cost),
    )


def choose_posture(problem: StopProblem) -> StopPosture | NoPosture:
    """Returns the posture of least time for transfer, approach and retract, or why there is none.

    As `choose_postures` does for many.
    """
    return choose_postures([problem])[0]


def choose_postures(problems: Sequence[StopProblem]) -> list[StopPosture | NoPosture]:
    """Returns for each stop the posture of least time for transfer, approach and retract, or why there is none.

    The time of the transfer is the closed form of its slowest joint (or of the platform, where that is slower). The
    eight branches are taken over a grid of arm angles and yaws at the target; the quickest are followed along their
    lines with several changes of the arm angle; the best is refined locally where the problem asks for it. No
    optimality over the continuum is claimed. A stop's answer does not depend on which others are asked for with it.

    Args:
        problems: of any arms; those of one arm with equal limits are computed together.
    """
    answers: list[StopPosture | NoPosture | None] = [None] * len(problems)
    for numbers, batch in batches(problems):
        for number, answer in zip(numbers, _choose(batch), strict=True):
            answers[number] = answer
    return [answer for answer in answers if answer is not None]


def choose_near(
    problems: Sequence[StopProblem],
    likes: Sequence[StopPosture],
    limits: Sequence[float],
    width: float,
) -> list[StopPosture | None]:
    """Returns for each stop the quickest posture of a round of variation about another stop's, None for too slow.

    What a search over platform positions needs: the same posture a little further on, repaired where it can be.

    Args:
        problems: of any arms.
        likes: for each problem a posture of nearly the same stop.
        limits: for each problem the time from which on a posture is of no use [s].
        width: half-width of the variation [rad].
    """
    answers: list[StopPosture | None] = [None] * len(problems)
    for numbers, batch in batches(problems):
        own = [likes[k] for k in numbers]
        psi = np.array([like.psi_target for like in own])
        ways = StopWays(
            row=np.arange(len(own)),
            target=np.array([like.target for like in own]),
            yaw=np.array([like.yaw for like in own]),
            branch=np.array([like.branch for like in own]),
            psi=psi,
            swing_in=np.array([like.psi_approach for like in own]) - psi,
            swing_out=np.array([like.psi_retract for like in own]) - psi,
            time=np.full(len(own), np.inf),
            cost=np.array([limits[k] for k in numbers]),
        )
        varied = variation(batch, ways, width)
        possible = varied.take(np.flatnonzero(np.isfinite(varied.time)))
        for row, answer in _held(batch, possible).items():
            answers[numbers[row]] = answer
    return answers


def _choose(batch: StopBatch) -> list[StopPosture | NoPosture]:
    """Returns the answers to one batch."""
    grid = target_postures(batch)
    answers: list[StopPosture | NoPosture] = [
        found if isinstance(found, NoPosture) else _no_lines(batch) for found in grid
    ]
    open_rows = [row for row, one in enumerate(grid) if isinstance(one, StopWays)]
    # Nearly always the first ways of the quick look settle it.
    for complete in (False, True):
        if not open_rows:
            break
        coarse = coarse_ways(batch, grid, open_rows, complete)
        settled = _first_that_hold(batch, _with_clear_ends(batch, coarse))
        for row, answer in settled.items():
            answers[row] = answer
        # Where the quick look found no way at all it has left none out.
        open_rows = [row for row in distinct(coarse.row).tolist() if row not in settled]
    return answers


def _first_that_hold(batch: StopBatch, coarse: StopWays) -> dict[int, StopPosture]:
    """Returns by problem the posture that the best ways lead to and that holds between the samples.

    Args:
        batch: the problems.
        coarse: ways, problem by problem and best first.
    """
    rows, first = np.unique(coarse.row, return_index=True)
    last = [*first[1:], len(coarse.row)][: len(rows)]
    left = {int(row): (int(a), int(b)) for row, a, b in zip(rows, first, last, strict=True)}
    found: dict[int, StopPosture] = {}
    while left:
        index = [np.arange(low, min(low + POSTURES.starts, high)) for low, high in left.values()]
        found |= _settled(batch, coarse.take(np.concatenate(index)))
        left = {
            row: (low + POSTURES.starts, high)
            for row, (low, high) in left.items()
            if row not in found and low + POSTURES.starts < high
        }
    return found


def _with_clear_ends(batch: StopBatch, ways: StopWays) -> StopWays:
    """Returns the ways that are collision-free where their lines begin and end."""
    if not len(ways.row) or all(problem.clear is None for problem in batch.problems):
        return ways
    ends = ways.follow(batch, POSTURES.end_samples).q[-1, ..., 0].T
    sides: dict[Place, FloatArray] = {
        "approach": ends[: len(ways.row)],
        "retract": ends[len(ways.row) :],
    }
    kept = np.ones(len(ways.row), dtype=np.bool_)
    for row in distinct(ways.row).tolist():
        test = batch.problems[row].clear
        rows = np.flatnonzero(ways.row == row)
        for place, q in sides.items() if test is not None else ():
            kept[rows] &= test(q[rows], place)
    return ways.take(np.flatnonzero(kept))


def _no_lines(batch: StopBatch) -> NoPosture:
    """Returns the reason where targets can be reached but no line can be followed."""
    if batch.given:
        return NoPosture(Refusal("given_lines_not_followed"))
    clear = any(problem.clear is not None for problem in batch.problems)
    return NoPosture(Refusal("lines_not_clear" if clear else "lines_not_followed"))


def _settled(batch: StopBatch, ways: StopWays) -> dict[int, StopPosture]:
    """Returns the best posture of each problem that ways lead to and that holds at many more samples."""
    history = refinements(batch, ways) if batch.refine else [ways.take(leading(ways))]
    samples = POSTURES.dense_samples if batch.refine else POSTURES.line_samples
    answers: dict[int, StopPosture] = {}
    left = np.arange(len(history[0].row))
    for stage in reversed(history):
        # Nearly always the most refined ways hold.
        some = stage.take(left)
        answers |= _held(batch, some, samples)
        left = left[[row not in answers for row in some.row.tolist()]]
        if not len(left):
            break
    return answers


def _held(
    batch: StopBatch, ways: StopWays, samples: int = POSTURES.dense_samples
) -> dict[int, StopPosture]:
    """Returns by problem the postures of those ways (one of each) that keep all limits at so many samples."""
    if not len(ways.row):
        return {}
    followed = ways.follow(batch, samples)
    held = np.flatnonzero(followed.ok.reshape(2, -1).all(axis=0))
    found = {int(ways.row[k]): _posture(ways, followed, k) for k in held.tolist()}
    return {row: one for row, one in found.items() if _is_clear(batch.problems[row], one)}


def _is_clear(problem: StopProblem, posture: StopPosture) -> bool:
    """Returns whether a posture is collision-free at its target and at the ends of its lines."""
    if problem.clear is None:
        return True
    places: dict[Place, FloatArray] = {
        "approach": posture.q_approach,
        "target": posture.q_target,
        "retract": posture.q_retract,
    }
    return all(bool(problem.clear(q[None], place)[0]) for place, q in places.items())


def _posture(ways: StopWays, followed: FollowedLines, k: int) -> StopPosture:
    """Returns one way as the solution."""
    q, n = followed.q[..., 0], len(ways.row)
    psi = float(ways.psi[k])
    return StopPosture(
        target=int(ways.target[k]),
        yaw=float(ways.yaw[k]),
        branch=int(ways.branch[k]),
        psi_target=psi,
        psi_approach=psi + float(ways.swing_in[k]),
        psi_retract=psi + float(ways.swing_out[k]),
        q_approach=q[-1, :, k],
        q_target=q[0, :, k],
        q_retract=q[-1, :, n + k],
        cost=float(ways.time[k]),
    )
