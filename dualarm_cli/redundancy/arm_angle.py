"""Posture of least time: all branches over the arm angle, lines included, then refined; many stops at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.redundancy.coarse_ways import coarse_ways
from dualarm_cli.redundancy.line_following import Followed
from dualarm_cli.redundancy.problem import NoPosture, Place, StopPosture, StopProblem
from dualarm_cli.redundancy.refinement import leading, refinements, variation
from dualarm_cli.redundancy.stop_batch import StopBatch, batches
from dualarm_cli.redundancy.target_grid import TargetPostures, target_postures
from dualarm_cli.redundancy.ways import LINE_SAMPLES, Ways

DENSE_SAMPLES = 33
"""Samples of a line at which the posture that is taken must keep its limits."""
END_SAMPLES = 3
"""Samples of a line where only its end matters."""
STARTS = 2
"""Ways of a stop that are refined; what becomes of the best of them is taken."""


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

    What a search over platform positions needs: the same posture a little further on, mended where it can be.

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
        ways = Ways(
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
    open_rows = [row for row, one in enumerate(grid) if isinstance(one, TargetPostures)]
    # Nearly always the first ways of the quick look settle it.
    for complete in (False, True):
        if not open_rows:
            break
        coarse = coarse_ways(batch, grid, open_rows, complete)
        settled = _first_that_hold(batch, _with_clear_ends(batch, coarse))
        for row, answer in settled.items():
            answers[row] = answer
        # Where the quick look found no way at all it has left none out.
        open_rows = [row for row in np.unique(coarse.row).tolist() if row not in settled]
    return answers


def _first_that_hold(batch: StopBatch, coarse: Ways) -> dict[int, StopPosture]:
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
        index = [np.arange(low, min(low + STARTS, high)) for low, high in left.values()]
        found |= _settled(batch, coarse.take(np.concatenate(index)))
        left = {
            row: (low + STARTS, high)
            for row, (low, high) in left.items()
            if row not in found and low + STARTS < high
        }
    return found


def _with_clear_ends(batch: StopBatch, ways: Ways) -> Ways:
    """Returns the ways that keep clear where their lines begin and end."""
    if not len(ways.row) or all(problem.clear is None for problem in batch.problems):
        return ways
    ends = ways.follow(batch, END_SAMPLES).q[-1, ..., 0].T
    sides: dict[Place, FloatArray] = {
        "approach": ends[: len(ways.row)],
        "retract": ends[len(ways.row) :],
    }
    kept = np.ones(len(ways.row), dtype=np.bool_)
    for row in np.unique(ways.row).tolist():
        test = batch.problems[row].clear
        rows = np.flatnonzero(ways.row == row)
        for place, q in sides.items() if test is not None else ():
            kept[rows] &= test(q[rows], place)
    return ways.take(np.flatnonzero(kept))


def _no_lines(batch: StopBatch) -> NoPosture:
    """Returns the reason where targets can be reached but no line can be followed."""
    if batch.given:
        return NoPosture(
            "no given configuration can follow its approach and retract lines (a straight wrist or "
            "shoulder cannot: give others, or approach: 0 and retract: 0)"
        )
    clear = any(problem.clear is not None for problem in batch.problems)
    also = " and keep clear at their ends" if clear else ""
    return NoPosture(f"no posture at the target can follow its approach and retract lines{also}")


def _settled(batch: StopBatch, ways: Ways) -> dict[int, StopPosture]:
    """Returns the best posture of each problem that ways lead to and that holds at many more samples."""
    history = refinements(batch, ways) if batch.refine else [ways.take(leading(ways))]
    samples = DENSE_SAMPLES if batch.refine else LINE_SAMPLES
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


def _held(batch: StopBatch, ways: Ways, samples: int = DENSE_SAMPLES) -> dict[int, StopPosture]:
    """Returns by problem the postures of those ways (one of each) that keep all limits at so many samples."""
    if not len(ways.row):
        return {}
    followed = ways.follow(batch, samples)
    held = np.flatnonzero(followed.ok.reshape(2, -1).all(axis=0))
    found = {int(ways.row[k]): _posture(ways, followed, k) for k in held.tolist()}
    return {row: one for row, one in found.items() if _keeps_clear(batch.problems[row], one)}


def _keeps_clear(problem: StopProblem, posture: StopPosture) -> bool:
    """Returns whether a posture keeps clear at its target and at the ends of its lines."""
    if problem.clear is None:
        return True
    places: dict[Place, FloatArray] = {
        "approach": posture.q_approach,
        "target": posture.q_target,
        "retract": posture.q_retract,
    }
    return all(bool(problem.clear(q[None], place)[0]) for place, q in places.items())


def _posture(ways: Ways, followed: Followed, k: int) -> StopPosture:
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
