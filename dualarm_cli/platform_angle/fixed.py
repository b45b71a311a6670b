"""The platform stays where it is: the baseline of every comparison."""

from __future__ import annotations

import numpy as np

from dualarm_cli.platform_angle.problem import Kind, PlatformProblem
from dualarm_cli.platform_angle.solution import PlatformSolution, build_solution


def solve_fixed(problem: PlatformProblem) -> PlatformSolution:
    """Returns the start angle as the only candidate of every move."""
    angle = problem.angle_0[:, None]
    kind = np.full(angle.shape, Kind.START, dtype=np.int64)
    return build_solution(problem, angle, kind, np.ones(angle.shape, dtype=np.bool_))
