"""Closed-form redundancy solver for SRS arms, many stops at once.

The posture of least time is searched over all branches and arm angles with lines, then refined.
"""

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
from dualarm_cli.postures.stop_candidates import StopCandidates, transfer_cost
from dualarm_cli.postures.target_grid import target_postures
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


def coarse_candidates(
    batch: StopBatch,
    grid: Sequence[StopCandidates | NoPosture],
    rows: Sequence[int],
    complete: bool,
) -> StopCandidates:
    """Select the best swings of postures at targets, problem by problem and best first.

    Timing lines costs most: lines that cannot come near the best are left out, unless all are requested.

    Args:
        batch: the problems.
        grid: the postures at their targets.
        rows: numbers of the problems.
        complete: whether all candidates are timed.
    """
    candidates = StopCandidates.concatenated(
        [answer for row in rows if isinstance(answer := grid[row], StopCandidates)]
    )
    swings = np.array(POSTURES.swings if batch.length.any() else (0.0,))
    sides = _follow_sides(batch, candidates, swings)
    transfer, travel = transfer_cost(batch, candidates.row, sides[0][1].at(-1))
    least = np.empty((2, *transfer.shape))
    for side in (0, 1):
        lines, followed = sides[side % len(sides)]
        least[side] = POSTURES.bound_factor * lines.least_times(followed)
    least[0] += transfer + travel
    is_feasible = np.isfinite(least)
    if complete:
        line = _line_times(sides, is_feasible)
    else:
        first = _mark_first(candidates.row, least.min(axis=2).sum(axis=0))[:, None]
        line = _line_times(sides, is_feasible & first)
        best = _best_of_row(
            candidates.row, (transfer + travel + line[0]).min(axis=1) + line[1].min(axis=1)
        )
        # A line can only matter if it and the least of the other line are near the best total.
        other_least = least.min(axis=2)[::-1, :, None]
        is_near_best = is_feasible & np.isfinite(other_least)
        is_near_best[is_near_best] = (
            least + np.where(is_near_best, other_least, 0.0)
            <= POSTURES.timing_factor * best[:, None]
        )[is_near_best]
        line = np.minimum(line, _line_times(sides, is_near_best & ~first))
    cost_in, indices = transfer + travel + line[0], np.arange(len(candidates.row))
    k_in, k_out = cost_in.argmin(axis=1), line[1].argmin(axis=1)
    cost = cost_in[indices, k_in] + line[1, indices, k_out]
    candidates = replace(
        candidates,
        swing_in=swings[k_in],
        swing_out=swings[k_out],
        time=transfer[indices, k_in] + line[0, indices, k_in] + line[1, indices, k_out],
        cost=cost,
    )
    order = np.lexsort((cost, candidates.row))
    return _diversify(candidates.take(order[np.isfinite(cost[order])]))


def _diversify(candidates: StopCandidates) -> StopCandidates:
    """Move each problem's best distant candidate to second place.

    Distant is far from the best one in arm angle, yaw or branch.
    """
    first = np.flatnonzero(np.diff(candidates.row, prepend=-1))
    best = np.repeat(first, np.diff(np.append(first, len(candidates.row))))
    turned = np.stack(
        [candidates.psi - candidates.psi[best], candidates.yaw - candidates.yaw[best]]
    )
    is_distant = (np.abs(wrap(turned)) > POSTURES.far_angle).any(axis=0) | (
        candidates.branch != candidates.branch[best]
    )
    place = np.arange(len(candidates.row), dtype=np.float64)
    distant = np.flatnonzero(is_distant)
    second = distant[np.diff(candidates.row[distant], prepend=-1) > 0]
    place[second] = best[second] + 0.5
    return candidates.take(np.argsort(place, kind="stable"))


def _follow_sides(
    batch: StopBatch, candidates: StopCandidates, swings: FloatArray
) -> list[tuple[Lines, FollowedLines]]:
    """Follow each candidate's approach and retract with every swing; equal ones once."""
    psi = np.broadcast_to(candidates.psi[:, None], (len(candidates.row), len(swings)))
    poses, reference = candidates.poses(batch), candidates.reference(batch)
    sides = []
    for side in (0,) if batch.alike_lines else (0, 1):
        line = poses.outward[:, side], batch.length[candidates.row, side]
        lines = Lines.of(batch, poses, line, POSTURES.line_samples)
        sides.append((lines, lines.follow(psi, psi + swings, candidates.branch, reference)))
    return sides


def _line_times(sides: Sequence[tuple[Lines, FollowedLines]], wanted: BoolArray) -> FloatArray:
    """Time the selected lines [s], infinite for others, shape (2, n, s)."""
    if len(sides) == 1:
        ((lines, followed),) = sides
        times = lines.times(followed, wanted[0] | wanted[1])
        return np.stack([times, times])
    return np.stack(
        [
            lines.times(followed, selection)
            for (lines, followed), selection in zip(sides, wanted, strict=True)
        ]
    )


def _mark_first(row: IntArray, least: FloatArray) -> BoolArray:
    """Mark the `first_timed` least entries of each problem, shape (n,)."""
    order = np.lexsort((least, row))
    place = np.arange(len(row)) - np.searchsorted(row[order], row[order], side="left")
    first = np.zeros(len(row), dtype=np.bool_)
    first[order[place < POSTURES.first_timed]] = True
    return first


def _best_of_row(row: IntArray, total: FloatArray) -> FloatArray:
    """Compute the least total of each entry's problem, shape (n,); row ascends."""
    first = np.flatnonzero(np.diff(row, prepend=-1))
    counts = np.diff(np.append(first, len(row)))
    return np.repeat(np.minimum.reduceat(total, first), counts)


def _steps(count: int) -> FloatArray:
    """Create an odd number of equal steps from -1 to 1, with 0 first."""
    half = count // 2
    return np.roll(np.arange(-half, half + 1) / max(half, 1), -half)


@dataclass(frozen=True)
class _Pattern:
    """Pattern of a refinement: all combinations of yaws, arm angles and swings."""

    yaw: FloatArray
    """Variations of the yaw as fractions of the half-width, 0 first."""
    psi: FloatArray
    """Variations of the arm angle at the target."""
    swing: FloatArray
    """Variations of each line's swing."""
    shrink: float
    """Ratio of a round's half-width to the previous one."""
    rounds: int
    """Number of rounds."""

    @classmethod
    def of(cls, batch: StopBatch) -> _Pattern:
        """Choose the variations of a batch by its free quantities."""
        if batch.length.any():
            yaw, psi = 3 if batch.free_yaw else 1, 1 if batch.given else 5
            return cls(_steps(yaw), _steps(psi), _steps(5), 0.6, 6)
        yaw, psi, shrink = (9, 9, 0.25) if batch.free_yaw else (1, 17, 0.125)
        return cls(_steps(yaw), _steps(1 if batch.given else psi), _steps(1), shrink, 3)

    def thinned(self) -> _Pattern:
        """Reduce the pattern to at most three variations of each quantity."""
        yaw, psi, swing = (_steps(min(3, len(v))) for v in (self.yaw, self.psi, self.swing))
        return replace(self, yaw=yaw, psi=psi, swing=swing)


def refine(batch: StopBatch, candidates: StopCandidates) -> list[StopCandidates]:
    """Refine candidates in rounds, all problems in lockstep.

    Of several candidates of one problem only the best goes on after `joint_rounds` rounds. A round compares all
    combinations of a few yaws, arm angles at the target and swings of approach and retract. Given the target the two
    lines are independent: each is followed for its own swings only, and the best of both are combined.

    Args:
        batch: the problems.
        candidates: feasible candidates, problem by problem.

    Returns:
        Candidates after each round, the given ones first.
    """
    pattern = _Pattern.of(batch)
    rounds = [candidates]
    lines: Lines | None = None
    for k in range(pattern.rounds):
        width = POSTURES.first_width * power(pattern.shrink, k)
        if k == POSTURES.joint_rounds:
            best = best_candidates(rounds[-1])
            if len(best) < len(candidates.row):
                rounds, lines = [stage.take(best) for stage in rounds], None
        last = rounds[-1]
        yaw = last.yaw[:, None] + width * pattern.yaw
        if lines is None or batch.free_yaw:
            lines = _sample_lines(batch, last, yaw)
        rounds.append(_select_improvements(batch, last, lines, pattern, width))
    return rounds


def vary(batch: StopBatch, candidates: StopCandidates, width: float) -> StopCandidates:
    """Vary each candidate once by up to a half-width [rad], and keep the best."""
    pattern = _Pattern.of(batch).thinned()
    lines = _sample_lines(batch, candidates, candidates.yaw[:, None] + width * pattern.yaw)
    return _select_improvements(batch, candidates, lines, pattern, width)


def best_candidates(candidates: StopCandidates) -> IntArray:
    """Find the index of each problem's best candidate."""
    order = np.lexsort((candidates.cost, candidates.row))
    best: IntArray = order[np.diff(candidates.row[order], prepend=-1) > 0]
    return best


def _sample_lines(batch: StopBatch, candidates: StopCandidates, yaw: FloatArray) -> Lines:
    """Sample both lines of n candidates at y yaws each, in the order (n, y, 2)."""
    y = yaw.shape[1]
    row, target = np.repeat(candidates.row, y), np.repeat(candidates.target, y)
    poses = batch.poses(row, target, yaw.ravel())
    twice = np.repeat(np.arange(len(row)), 2)
    line = poses.outward.reshape(-1, 3), batch.length[row].ravel()
    return Lines.of(batch, poses.take(twice), line, POSTURES.line_samples)


def _select_improvements(
    batch: StopBatch, candidates: StopCandidates, lines: Lines, pattern: _Pattern, width: float
) -> StopCandidates:
    """Select the best vary of each candidate, or itself if none is better."""
    n, y, t, s = len(candidates.row), len(pattern.yaw), len(pattern.psi), len(pattern.swing)
    psi = candidates.psi[:, None] + width * pattern.psi
    swings = (
        np.stack([candidates.swing_in, candidates.swing_out], axis=1)[:, :, None]
        + width * pattern.swing
    )
    shape = (n, y, 2, t, s)
    psi_target = np.broadcast_to(psi[:, None, None, :, None], shape)
    psi_end = psi_target + swings[:, None, :, None, :]
    candidate_of_line = np.repeat(np.arange(n), 2 * y)
    followed = lines.follow(
        psi_target.reshape(-1, t * s),
        psi_end.reshape(-1, t * s),
        candidates.branch[candidate_of_line],
        candidates.reference(batch)[candidate_of_line],
    )
    end = followed.at(-1).reshape(*shape, 7)[:, :, 0]
    transfer, travel = transfer_cost(batch, candidates.row, end)
    least = lines.least_times(followed).reshape(shape) * POSTURES.bound_factor
    least[:, :, 0] += transfer + travel
    # A line must not take longer than the cost less the least time of the other line.
    limit = (candidates.cost[:, None, None, None] - least.min(axis=4))[:, :, ::-1]
    wanted = least < limit[..., None]
    line = lines.times(followed, wanted.reshape(len(candidate_of_line), -1)).reshape(shape)
    time_in = transfer + line[:, :, 0]
    cost_in = time_in + travel
    best_in, best_out = cost_in.argmin(axis=3), line[:, :, 1].argmin(axis=3)
    total = (cost_in.min(axis=3) + line[:, :, 1].min(axis=3)).reshape(n, -1)
    index, indices = total.argmin(axis=1), np.arange(n)
    at_yaw, at_psi = np.divmod(index, t)
    k_in, k_out = best_in[indices, at_yaw, at_psi], best_out[indices, at_yaw, at_psi]
    better = total[indices, index] < candidates.cost
    time = time_in[indices, at_yaw, at_psi, k_in] + line[indices, at_yaw, 1, at_psi, k_out]
    return replace(
        candidates,
        yaw=np.where(better, candidates.yaw + width * pattern.yaw[at_yaw], candidates.yaw),
        psi=np.where(better, psi[indices, at_psi], candidates.psi),
        swing_in=np.where(better, swings[indices, 0, k_in], candidates.swing_in),
        swing_out=np.where(better, swings[indices, 1, k_out], candidates.swing_out),
        time=np.where(better, time, candidates.time),
        cost=np.where(better, total[indices, index], candidates.cost),
    )


def choose_posture(problem: StopProblem) -> StopPosture | NoPosture:
    """Choose the posture of least time for one stop (`choose_postures`)."""
    return choose_postures([problem])[0]


def choose_postures(problems: Sequence[StopProblem]) -> list[StopPosture | NoPosture]:
    """Choose each stop's posture of least time for transfer, approach and retract.

    The time of the transfer is the closed form of its slowest joint, or of a slower platform. The
    eight branches are taken over a grid of arm angles and yaws at the target; the quickest are followed along their
    lines with several changes of the arm angle; the best is refined locally if the problem requires it.
    No optimality over the continuum is claimed. A stop's answer does not depend on the other stops.

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
    """Vary the posture of a similar stop for each stop, and choose the quickest.

    A search over platform positions adapts the same posture to a nearby position in this manner.

    Args:
        problems: of any arms.
        likes: for each problem a posture of nearly the same stop.
        limits: for each problem the time from which a posture is too slow [s].
        width: half-width of the vary [rad].
    """
    answers: list[StopPosture | None] = [None] * len(problems)
    for numbers, batch in batches(problems):
        likes_of_batch = [likes[k] for k in numbers]
        psi = np.array([like.psi_target for like in likes_of_batch])
        candidates = StopCandidates(
            row=np.arange(len(likes_of_batch)),
            target=np.array([like.target for like in likes_of_batch]),
            yaw=np.array([like.yaw for like in likes_of_batch]),
            branch=np.array([like.branch for like in likes_of_batch]),
            psi=psi,
            swing_in=np.array([like.psi_approach for like in likes_of_batch]) - psi,
            swing_out=np.array([like.psi_retract for like in likes_of_batch]) - psi,
            time=np.full(len(likes_of_batch), np.inf),
            cost=np.array([limits[k] for k in numbers]),
        )
        varied = vary(batch, candidates, width)
        possible = varied.take(np.flatnonzero(np.isfinite(varied.time)))
        for row, answer in _feasible_postures(batch, possible).items():
            answers[numbers[row]] = answer
    return answers


def _choose(batch: StopBatch) -> list[StopPosture | NoPosture]:
    """Solve one batch."""
    grid = target_postures(batch)
    answers: list[StopPosture | NoPosture] = [
        answer if isinstance(answer, NoPosture) else _no_lines(batch) for answer in grid
    ]
    open_rows = [row for row, answer in enumerate(grid) if isinstance(answer, StopCandidates)]
    # Nearly always the first candidates of the partial timing suffice.
    for complete in (False, True):
        if not open_rows:
            break
        coarse = coarse_candidates(batch, grid, open_rows, complete)
        settled = _first_feasible(batch, _with_clear_ends(batch, coarse))
        for row, answer in settled.items():
            answers[row] = answer
        # If the partial timing found no candidate of a problem, it has left none out.
        open_rows = [row for row in distinct(coarse.row).tolist() if row not in settled]
    return answers


def _first_feasible(batch: StopBatch, coarse: StopCandidates) -> dict[int, StopPosture]:
    """Refine the best candidates of each problem until one is feasible at dense samples.

    Args:
        batch: the problems.
        coarse: candidates, problem by problem and best first.
    """
    rows, first = np.unique(coarse.row, return_index=True)
    last = [*first[1:], len(coarse.row)][: len(rows)]
    remaining = {int(row): (int(a), int(b)) for row, a, b in zip(rows, first, last, strict=True)}
    answers: dict[int, StopPosture] = {}
    while remaining:
        index = [
            np.arange(low, min(low + POSTURES.starts, high)) for low, high in remaining.values()
        ]
        answers |= _refine_to_postures(batch, coarse.take(np.concatenate(index)))
        remaining = {
            row: (low + POSTURES.starts, high)
            for row, (low, high) in remaining.items()
            if row not in answers and low + POSTURES.starts < high
        }
    return answers


def _with_clear_ends(batch: StopBatch, candidates: StopCandidates) -> StopCandidates:
    """Select candidates that are collision-free at the outer ends of their lines."""
    if not len(candidates.row) or all(problem.is_free is None for problem in batch.problems):
        return candidates
    ends = candidates.follow(batch, POSTURES.end_samples).q[-1, ..., 0].T
    sides: dict[Place, FloatArray] = {
        "approach": ends[: len(candidates.row)],
        "retract": ends[len(candidates.row) :],
    }
    is_clear = np.ones(len(candidates.row), dtype=np.bool_)
    for row in distinct(candidates.row).tolist():
        test = batch.problems[row].is_free
        rows = np.flatnonzero(candidates.row == row)
        for place, q in sides.items() if test is not None else ():
            is_clear[rows] &= test(q[rows], place)
    return candidates.take(np.flatnonzero(is_clear))


def _no_lines(batch: StopBatch) -> NoPosture:
    """Give the reason if targets are reached but no line can be followed."""
    if batch.given:
        return NoPosture(Refusal("given_lines_not_followed"))
    clear = any(problem.is_free is not None for problem in batch.problems)
    return NoPosture(Refusal("lines_not_clear" if clear else "lines_not_followed"))


def _refine_to_postures(batch: StopBatch, candidates: StopCandidates) -> dict[int, StopPosture]:
    """Refine candidates to each problem's best posture that is feasible at dense samples."""
    history = (
        refine(batch, candidates)
        if batch.refine
        else [candidates.take(best_candidates(candidates))]
    )
    samples = POSTURES.dense_samples if batch.refine else POSTURES.line_samples
    answers: dict[int, StopPosture] = {}
    remaining = np.arange(len(history[0].row))
    for stage in reversed(history):
        # Nearly always the most refined candidates are feasible.
        open_candidates = stage.take(remaining)
        answers |= _feasible_postures(batch, open_candidates, samples)
        remaining = remaining[[row not in answers for row in open_candidates.row.tolist()]]
        if not len(remaining):
            break
    return answers


def _feasible_postures(
    batch: StopBatch, candidates: StopCandidates, samples: int = POSTURES.dense_samples
) -> dict[int, StopPosture]:
    """Convert candidates, one a problem, that are feasible at every sample to postures."""
    if not len(candidates.row):
        return {}
    followed = candidates.follow(batch, samples)
    feasible = np.flatnonzero(followed.ok.reshape(2, -1).all(axis=0))
    postures = {
        int(candidates.row[k]): _posture(candidates, followed, k) for k in feasible.tolist()
    }
    return {
        row: posture for row, posture in postures.items() if _is_clear(batch.problems[row], posture)
    }


def _is_clear(problem: StopProblem, posture: StopPosture) -> bool:
    """Return whether a posture is collision-free at target and ends of lines."""
    if problem.is_free is None:
        return True
    places: dict[Place, FloatArray] = {
        "approach": posture.q_approach,
        "target": posture.q_target,
        "retract": posture.q_retract,
    }
    return all(bool(problem.is_free(q[None], place)[0]) for place, q in places.items())


def _posture(candidates: StopCandidates, followed: FollowedLines, k: int) -> StopPosture:
    """Convert one candidate to the solution."""
    q, n = followed.q[..., 0], len(candidates.row)
    psi = float(candidates.psi[k])
    return StopPosture(
        target=int(candidates.target[k]),
        yaw=float(candidates.yaw[k]),
        branch=int(candidates.branch[k]),
        psi_target=psi,
        psi_approach=psi + float(candidates.swing_in[k]),
        psi_retract=psi + float(candidates.swing_out[k]),
        q_approach=q[-1, :, k],
        q_target=q[0, :, k],
        q_retract=q[-1, :, n + k],
        cost=float(candidates.time[k]),
    )
