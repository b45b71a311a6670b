"""Seam solvers: first posture path, best with still part, best with moving part."""

from __future__ import annotations

from functools import partial
from itertools import islice

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinds.seam.closed_chain.chain import KEPT
from dualarm_cli.kinds.seam.closed_chain.closing import all_equations, close
from dualarm_cli.kinds.seam.closed_chain.posture_paths import (
    POSTURE_PATHS,
    least_singular_value,
    path_cost,
    steady_time,
)
from dualarm_cli.kinds.seam.closed_chain.problem import NoSeam, SeamMotion, SeamProblem
from dualarm_cli.kinds.seam.closed_chain.program import SeamProgram
from dualarm_cli.kinds.seam.closed_chain.starts import (
    CLOSED,
    STARTS,
    beyond_limits,
    part_poses,
    seam_starts,
    standing_joints,
    why_impossible,
)
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ProgramSettings:
    """Settings of the sequential quadratic programs."""

    rounds: int = 60
    """Maximum number of steps."""
    first_radius: float = 0.2
    """Largest joint displacement in the first step [rad]."""
    widest: float = 0.5
    """Largest joint displacement in any step [rad]."""
    narrowest: float = 1e-3
    """Trust-region radius below which a search ends [rad]."""
    good: float = 0.5
    """Fraction of the predicted gain above which the trust region grows."""
    poor: float = 0.2
    """Fraction of the predicted gain below which the trust region shrinks."""
    grown: float = 1.5
    """Growth factor of the trust region."""
    shrunk: float = 0.5
    """Shrink factor of the trust region after a step with little gain."""
    refused: float = 0.35
    """Shrink factor of the trust region after a rejected step."""
    looked_back: int = 6
    """Number of latest costs over which progress is measured."""
    enough: float = 2e-3
    """Relative gain over the latest costs below which a search ends."""
    closing_steps: int = 8
    """Newton steps after each step."""
    smoothing: int = 16
    """Maximum number of smoothing steps at the end, at the same time."""
    easy: float = 0.01
    """Relative gain of a smoothing step below which smoothing ends."""
    first_rounds: int = 16
    """Number of steps after which starts are compared."""
    leant: float = (1.0 + KEPT) / 2.0
    """Fraction of the allowed tilts up to which a step is accepted."""
    spare_time: float = 1.003
    """Factor on a posture path's own time within which it is smoothed.

    At the required time, effort may mean nothing.
    """


PROGRAM = ProgramSettings()


def improved(
    problem: SeamProblem,
    position: FloatArray,
    stands: BoolArray,
    rounds: int = PROGRAM.rounds,
    *,
    easy: bool = True,
) -> FloatArray:
    """Shorten a seam by quadratic-program steps on its joints, (nodes, n) [rad].

    Ends at the required speed or at a local optimum; then the remaining freedom makes the motion smooth. If the result
    collides, a second descent rejects colliding steps.

    Args:
        problem: the seam.
        position: joints at the nodes, chain closed [rad], shape (nodes, n).
        stands: joints that are constant over all nodes, shape (n,).
        rounds: maximum number of steps.
        easy: whether the motion is smoothed at the end.
    """
    descended = _descended(problem, position, stands, rounds, easy=easy, is_clear=False)
    if problem.is_free is None or bool(problem.is_free(descended).all()):
        return descended
    # The unconstrained descent ended in a collision. A descent that stops before it is slower, but can be worked.
    return _descended(problem, position, stands, rounds, easy=easy, is_clear=True)


def _descended(
    problem: SeamProblem,
    position: FloatArray,
    stands: BoolArray,
    rounds: int,
    *,
    easy: bool,
    is_clear: bool,
) -> FloatArray:
    """Take steps that each make the seam faster, without collisions if required."""

    def touches(candidate: FloatArray) -> bool:
        return is_clear and problem.is_free is not None and not problem.is_free(candidate).all()

    program = SeamProgram(problem, stands)
    best, time = position, steady_time(position, problem.limits)
    beyond = float(beyond_limits(problem, best).max())
    enough = POSTURE_PATHS.ample * problem.time
    radius, history = PROGRAM.first_radius, [_cost(time, beyond)]
    for _ in range(rounds):
        if (time <= enough and beyond == 0.0) or radius < PROGRAM.narrowest:
            break
        solution = program.step(best, time, radius, pace=1.0)
        candidate = None if solution is None else _closed(problem, solution[0], stands)
        if solution is None or candidate is None:
            radius *= PROGRAM.refused
            continue
        reached = steady_time(candidate, problem.limits)
        still_beyond = float(beyond_limits(problem, candidate).max())
        gained = _cost(time, beyond) - _cost(reached, still_beyond)
        if gained <= 0.0 or touches(candidate):
            radius *= PROGRAM.refused
            continue
        gain = gained / max(_cost(time, beyond) - solution[1], 1e-12)
        best, time, beyond = candidate, reached, still_beyond
        radius = min(
            PROGRAM.widest,
            radius
            * (
                PROGRAM.grown
                if gain > PROGRAM.good
                else PROGRAM.shrunk
                if gain < PROGRAM.poor
                else 1.0
            ),
        )
        history.append(_cost(time, beyond))
        if (
            len(history) > PROGRAM.looked_back
            and history[-PROGRAM.looked_back] - history[-1] < PROGRAM.enough * time
        ):
            break
    if beyond > 0.0 or not easy:
        return best
    smooth = _smoothed(problem, program, best, time * PROGRAM.spare_time)
    return best if touches(smooth) else smooth


def _cost(time: float, beyond: float) -> float:
    """Compute a posture path's cost from its time [s] and violation [rad].

    The violation is that of the joint limits.
    """
    return time * (1.0 + STARTS.violation_cost * beyond)


def _smoothed(
    problem: SeamProblem, program: SeamProgram, position: FloatArray, time: float
) -> FloatArray:
    """Smooth the motion away from limits within a time, (nodes, n) [rad]."""
    best, radius = position, PROGRAM.first_radius
    unease = program.unease(best, time)
    # Low effort alone would favour stretched arms.
    regular = min(least_singular_value(problem, best), POSTURE_PATHS.regular) / 2.0
    for _ in range(PROGRAM.smoothing):
        solution = program.step(best, time, radius, pace=0.0)
        candidate = None if solution is None else _closed(problem, solution[0], program.stands)
        if (
            candidate is None
            or beyond_limits(problem, candidate).max() > 0.0
            or steady_time(candidate, problem.limits) > time
            or program.unease(candidate, time) >= unease
            or least_singular_value(problem, candidate) < regular
        ):
            radius *= PROGRAM.refused
            if radius < PROGRAM.narrowest:
                break
            continue
        gained = unease - program.unease(candidate, time)
        best, unease, radius = (
            candidate,
            unease - gained,
            min(PROGRAM.widest, radius * PROGRAM.grown),
        )
        if gained < PROGRAM.easy * unease:
            break
    return best


def _closed(problem: SeamProblem, position: FloatArray, stands: BoolArray) -> FloatArray | None:
    """Close the chain at every node, or return None."""
    chain, limits = problem.chain, problem.limits
    poses = part_poses(problem, problem.shares)
    if poses is not None and chain.work.hold.stands:
        first = close(
            partial(
                all_equations,
                chain,
                share=problem.shares[:1],
                part=(poses[0][:1], poses[1][:1]),
            ),
            position[:1],
            np.square(limits.velocity) * chain.closes,
            PROGRAM.closing_steps,
        )
        position = np.where(chain.master_joints, first.position, position)
        poses = None
    closed = close(
        partial(all_equations, chain, share=problem.shares, part=poses),
        position,
        np.square(limits.velocity) * (chain.closes & ~stands),
        PROGRAM.closing_steps,
    )
    # The next step corrects excess tilts; a still part cannot while its tool moves.
    bodies = chain.bodies(closed.position)
    exact = chain.equations(bodies, problem.shares).exact.size
    too_far = chain.leans_too_far(bodies, problem.shares, PROGRAM.leant)
    return closed.position if exact.max() < CLOSED and not too_far else None


def solve_least_motion(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Solve a seam by least-norm steps, as the quickest of many starts.

    Only feasible starts count.

    The tool follows the seam by steps of least norm while the part stands or moves as in the file: the method of
    [Qin2024] section 3.5, from many starts.
    """
    starts = seam_starts(problem)
    first = next((path for path in starts.position if _is_feasible(problem, path)), None)
    if first is not None:
        return _motion(problem, first)
    return starts.failure or why_impossible(problem, list(starts.position))


def solve_still(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Solve a seam with the part still at its fastest pose.

    Pose, arm angles and spin are optimised together. If the file gives the part's motion, only the others are.
    """
    paths = _best_paths(problem, moving=False)
    if isinstance(paths, NoSeam):
        return paths
    return _motion(problem, paths[0])


def solve_moving(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Solve a seam with moving part and tool, or a still part.

    A still part is taken if it is fast enough.

    Without a master the platform moves instead of the part.
    """
    paths = _best_paths(problem, moving=False)
    if not isinstance(paths, NoSeam):
        if steady_time(paths[0], problem.limits) <= POSTURE_PATHS.ample * problem.time:
            return _motion(problem, paths[0])
        stands = standing_joints(problem, moving=True)
        moving = [improved(problem, path, stands) for path in paths]
        candidates = [paths[0], *(path for path in moving if _is_feasible(problem, path))]
        return _motion(problem, min(candidates, key=lambda path: path_cost(problem, path)))
    # Some seams need a moving part, such as one around a pipe with the surface always facing up.
    paths = _best_paths(problem, moving=True)
    return paths if isinstance(paths, NoSeam) else _motion(problem, paths[0])


def _best_paths(problem: SeamProblem, *, moving: bool) -> list[FloatArray] | NoSeam:
    """Compute the best posture paths, quickest first.

    A few steps are taken for several, all steps for the best.
    """
    starts = seam_starts(problem, moving=moving)
    if starts.failure is not None:
        return starts.failure
    stands = standing_joints(problem, moving=moving)
    candidates = [
        improved(problem, path, stands, PROGRAM.first_rounds, easy=False)
        for path in starts.position[: problem.improved_starts]
    ]
    candidates = sorted(candidates, key=lambda path: path_cost(problem, path))
    # A quicker path may be near a singular posture: then the one before is only smoothed.
    best = [improved(problem, candidates[0], stands, rounds) for rounds in (PROGRAM.rounds, 0)]
    best.sort(key=lambda path: path_cost(problem, path))
    all_paths = [*best, *candidates, *starts.position]
    paths = list(
        islice(
            (path for path in all_paths if _is_feasible(problem, path)),
            _moving_start_count(problem),
        )
    )
    if not paths:
        return why_impossible(problem, all_paths)
    if not any(paths[0] is path for path in best):
        easy = improved(problem, paths[0], stands, 0)
        paths[0] = easy if _is_feasible(problem, easy) else paths[0]
    return paths


def _moving_start_count(problem: SeamProblem) -> int:
    """Compute the number of still posture paths that are starts for moving ones."""
    return max(1, (problem.improved_starts + 1) // 2)


def _is_feasible(problem: SeamProblem, path: FloatArray) -> bool:
    """Test a posture path for limits, clearance, and the next seam's start."""
    if beyond_limits(problem, path).max() > 0.0:
        return False
    if problem.can_continue is not None and not problem.can_continue(path[-1]):
        return False
    return problem.is_free is None or bool(problem.is_free(path).all())


def _motion(problem: SeamProblem, path: FloatArray) -> SeamMotion:
    return SeamMotion(path, steady_time(path, problem.limits))
