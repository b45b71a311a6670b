"""Seam solvers: the first way found, the best with the part still, the best with the part moving too."""

from __future__ import annotations

from itertools import islice

from dualarm_cli.closed_chain.improvement import ROUNDS, improved
from dualarm_cli.closed_chain.problem import NoSeam, SeamMotion, SeamProblem
from dualarm_cli.closed_chain.rates import steady_time
from dualarm_cli.closed_chain.starts import LIMITS, beyond_limits, seam_starts, standing_joints
from dualarm_cli.closed_chain.ways import AMPLE, way_cost
from dualarm_cli.geometry.arrays import FloatArray

FIRST_ROUNDS = 16
"""Steps by which starts are compared before the best is improved further."""


def work_least_motion(problem: SeamProblem) -> SeamMotion | NoSeam:
    """Returns the quickest of the ways that inverse kinematics along the seam finds, improved no further.

    The tool follows the seam by steps of least norm while the part stands or moves as the file says: what [Qin2024]
    section 3.5 does, from many starts.
    """
    starts = seam_starts(problem)
    first = next((way for way in starts.position if _possible(problem, way)), None)
    return _motion(problem, first) if first is not None else starts.failure or NoSeam(LIMITS, 1.0)


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
        if steady_time(found[0], problem.limits) <= AMPLE * problem.time:
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
        improved(problem, way, stands, FIRST_ROUNDS, easy=False)
        for way in starts.position[: problem.tried]
    ]
    tried = sorted(tried, key=lambda way: way_cost(problem, way))
    # What is quicker may have come near to a singular posture: then the one before is only made easy.
    best = [improved(problem, tried[0], stands, rounds) for rounds in (ROUNDS, 0)]
    best.sort(key=lambda way: way_cost(problem, way))
    possible = (way for way in (*best, *tried, *starts.position) if _possible(problem, way))
    ways = list(islice(possible, _kept(problem)))
    if not ways:
        return NoSeam(LIMITS, 1.0)
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
