"""Seam solvers: the first way found, the best with the part still, the best with the part moving too."""

from __future__ import annotations

from functools import partial
from itertools import islice

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinds.seam.closed_chain.chain import KEPT
from dualarm_cli.kinds.seam.closed_chain.closing import all_equations, close
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
from dualarm_cli.kinds.seam.closed_chain.ways import (
    WAYS,
    least_singular_value,
    steady_time,
    way_cost,
)
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ProgramSettings:
    """Numbers that steer the sequential quadratic programs."""

    rounds: int = 60
    """Steps at most."""
    first_radius: float = 0.2
    """Largest joint displacement in the first step [rad]."""
    widest: float = 0.5
    """Largest joint displacement in any step [rad]."""
    narrowest: float = 1e-3
    """Trust-region radius below which a search ends [rad]."""
    good: float = 0.5
    """Share of the predicted gain above which the trust region grows."""
    poor: float = 0.2
    """Share of the predicted gain below which the trust region shrinks."""
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
    """Steps at most that make the motion easy at the end, the time kept."""
    easy: float = 0.01
    """Share of what a motion costs whose gain in a step ends that."""
    first_rounds: int = 16
    """Steps by which starts are compared before the best is improved further."""
    leant: float = (1.0 + KEPT) / 2.0
    """Share of what tool and surface may lean up to which a step is taken."""
    spare_time: float = 1.003
    """Factor on a way's own time within which it is smoothed: at the required time, effort may mean nothing."""


PROGRAM = ProgramSettings()


def improved(
    problem: SeamProblem,
    position: FloatArray,
    stands: BoolArray,
    rounds: int = PROGRAM.rounds,
    *,
    easy: bool = True,
) -> FloatArray:
    """Returns joints at the nodes of a seam that can be worked faster, at a steady speed, (nodes, n) [rad].

    Ends where it is as fast as asked or no faster one is found near by; then what is left open makes the motion easy.
    Where that touches something, steps that touch are refused from the beginning.

    Args:
        problem: the seam.
        position: joints at the nodes, chain closed [rad], shape (nodes, n).
        stands: joints that are the same at all nodes, shape (n,).
        rounds: steps at most.
        easy: whether what is left open is used at the end.
    """
    found = _descended(problem, position, stands, rounds, easy=easy, is_clear=False)
    if problem.clear is None or bool(problem.clear(found).all()):
        return found
    # The free descent ran into something; one that stops short of it is worth less, but can be worked.
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
    """Returns joints at the nodes after steps that each make the seam faster, and if asked are collision-free."""

    def touches(tried: FloatArray) -> bool:
        return is_clear and problem.clear is not None and not problem.clear(tried).all()

    program = SeamProgram(problem, stands)
    best, time = position, steady_time(position, problem.limits)
    beyond = float(beyond_limits(problem, best).max())
    enough = WAYS.ample * problem.time
    radius, history = PROGRAM.first_radius, [_cost(time, beyond)]
    for _ in range(rounds):
        if (time <= enough and beyond == 0.0) or radius < PROGRAM.narrowest:
            break
        found = program.step(best, time, radius, pace=1.0)
        tried = None if found is None else _closed(problem, found[0], stands)
        if found is None or tried is None:
            radius *= PROGRAM.refused
            continue
        reached = steady_time(tried, problem.limits)
        still_beyond = float(beyond_limits(problem, tried).max())
        gained = _cost(time, beyond) - _cost(reached, still_beyond)
        if gained <= 0.0 or touches(tried):
            radius *= PROGRAM.refused
            continue
        gain = gained / max(_cost(time, beyond) - found[1], 1e-12)
        best, time, beyond = tried, reached, still_beyond
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
    """Returns what a way costs that takes a time [s] and is beyond limits by so much [rad]."""
    return time * (1.0 + STARTS.dear * beyond)


def _smoothed(
    problem: SeamProblem, program: SeamProgram, position: FloatArray, time: float
) -> FloatArray:
    """Returns the smoothest motion near by, away from limits, that takes no longer than a time, (nodes, n) [rad]."""
    best, radius = position, PROGRAM.first_radius
    unease = program.unease(best, time)
    # Where little is to be moved an arm that is stretched has the least to do.
    regular = min(least_singular_value(problem, best), WAYS.regular) / 2.0
    for _ in range(PROGRAM.smoothing):
        found = program.step(best, time, radius, pace=0.0)
        tried = None if found is None else _closed(problem, found[0], program.stands)
        if (
            tried is None
            or beyond_limits(problem, tried).max() > 0.0
            or steady_time(tried, problem.limits) > time
            or program.unease(tried, time) >= unease
            or least_singular_value(problem, tried) < regular
        ):
            radius *= PROGRAM.refused
            if radius < PROGRAM.narrowest:
                break
            continue
        gained = unease - program.unease(tried, time)
        best, unease, radius = tried, unease - gained, min(PROGRAM.widest, radius * PROGRAM.grown)
        if gained < PROGRAM.easy * unease:
            break
    return best


def _closed(problem: SeamProblem, position: FloatArray, stands: BoolArray) -> FloatArray | None:
    """Returns the joints with the chain closed at all nodes, or None where it cannot be."""
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
    found = close(
        partial(all_equations, chain, share=problem.shares, part=poses),
        position,
        np.square(limits.velocity) * (chain.closes & ~stands),
        PROGRAM.closing_steps,
    )
    # What one step leans beyond what is kept the next one takes back; a still part cannot while its tool is moved.
    bodies = chain.bodies(found.position)
    exact = chain.equations(bodies, problem.shares).exact.size
    too_far = chain.leans_too_far(bodies, problem.shares, PROGRAM.leant)
    return found.position if exact.max() < CLOSED and not too_far else None


def work_least_motion(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Returns the quickest of the ways that inverse kinematics along the seam finds, improved no further.

    The tool follows the seam by steps of least norm while the part stands or moves as the file says: what [Qin2024]
    section 3.5 does, from many starts.
    """
    starts = seam_starts(problem)
    first = next((way for way in starts.position if _possible(problem, way)), None)
    if first is not None:
        return _motion(problem, first)
    return starts.failure or why_impossible(problem, list(starts.position))


def work_still(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Returns the seam with the part still where it is fastest: pose, arm angles and spin chosen together.

    Where the file says how the part moves, the rest is chosen.
    """
    found = _ways(problem, moving=False)
    if isinstance(found, NoSeam):
        return found
    return _motion(problem, found[0])


def work_moving(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Returns the seam with part and tool moving at once, or with the part still where that is as fast as asked.

    Without a master it is the platform that moves along.
    """
    found = _ways(problem, moving=False)
    if not isinstance(found, NoSeam):
        if steady_time(found[0], problem.limits) <= WAYS.ample * problem.time:
            return _motion(problem, found[0])
        stands = standing_joints(problem, moving=True)
        moving = [improved(problem, way, stands) for way in found]
        ways = [found[0], *(way for way in moving if _possible(problem, way))]
        return _motion(problem, min(ways, key=lambda way: way_cost(problem, way)))
    # There are seams that no still part lets a tool work, such as round a pipe with the surface always facing up.
    found = _ways(problem, moving=True)
    return found if isinstance(found, NoSeam) else _motion(problem, found[0])


def _ways(problem: SeamProblem, *, moving: bool) -> list[FloatArray] | NoSeam:
    """Returns the best ways, quickest first: a few steps for some, all for the best of them."""
    starts = seam_starts(problem, moving=moving)
    if starts.failure is not None:
        return starts.failure
    stands = standing_joints(problem, moving=moving)
    tried = [
        improved(problem, way, stands, PROGRAM.first_rounds, easy=False)
        for way in starts.position[: problem.tried]
    ]
    tried = sorted(tried, key=lambda way: way_cost(problem, way))
    # What is quicker may have come near to a singular posture: then the one before is only made easy.
    best = [improved(problem, tried[0], stands, rounds) for rounds in (PROGRAM.rounds, 0)]
    best.sort(key=lambda way: way_cost(problem, way))
    every = [*best, *tried, *starts.position]
    ways = list(islice((way for way in every if _possible(problem, way)), _kept(problem)))
    if not ways:
        return why_impossible(problem, every)
    if not any(ways[0] is way for way in best):
        easy = improved(problem, ways[0], stands, 0)
        ways[0] = easy if _possible(problem, easy) else ways[0]
    return ways


def _kept(problem: SeamProblem) -> int:
    """Returns how many still ways are taken as starts for moving ones."""
    return max(1, (problem.tried + 1) // 2)


def _possible(problem: SeamProblem, way: FloatArray) -> bool:
    """Returns whether a way keeps within limits and clear of everything, and what comes next can be done after it."""
    if beyond_limits(problem, way).max() > 0.0:
        return False
    if problem.goes_on is not None and not problem.goes_on(way[-1]):
        return False
    return problem.clear is None or bool(problem.clear(way).all())


def _motion(problem: SeamProblem, way: FloatArray) -> SeamMotion:
    return SeamMotion(way, steady_time(way, problem.limits))
