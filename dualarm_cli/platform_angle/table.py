"""Table of a move: the candidates of every solver with their elbow displacements."""

from __future__ import annotations

import numpy as np

from dualarm_cli.platform_angle.problem import (
    Kind,
    PlatformProblem,
    elbow_angles,
)
from dualarm_cli.platform_angle.solution import PlatformSolution
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class MethodRow:
    """Candidate of a platform solver for a move."""

    method: str
    """Platform solver."""
    kind: Kind
    """Kind of the candidate."""
    angle: float
    """Platform angle at the end [rad]."""
    turn: float
    """Platform rotation phi_f - phi_0, within half a turn [rad]."""
    delta: tuple[float | None, float | None]
    """Displacement of each elbow [rad]; None for an arm out of reach."""
    chosen: bool
    """Flag of the solver's preferred candidate."""

    @property
    def difference(self) -> float | None:
        """Difference |delta_2| - |delta_1| [rad], as in the paper; None out of reach."""
        first, second = self.delta
        return None if first is None or second is None else abs(second) - abs(first)


def candidate_rows(method: str, solution: PlatformSolution) -> list[MethodRow]:
    """List the candidates of the first move: roots by their angle, then the others.

    For `linearised` that is the order of [Bottin2021] Table 2.

    Args:
        method: name of the solver.
        solution: its solution.
    """
    problem = solution.problem.rows(np.array([0]))
    columns = np.flatnonzero(solution.valid[0])
    kinds, angles = solution.kind[0], solution.angle[0]
    is_root = np.isin(kinds, (Kind.ROOT_SAME, Kind.ROOT_OPPOSITE))
    order = sorted(columns, key=lambda k: (0, angles[k]) if is_root[k] else (1, 0.0))
    best = int(solution.best[0])
    return [
        MethodRow(
            method,
            Kind(int(kinds[k])),
            float(angles[k]),
            float(angles[k] - problem.angle_0[0]),
            _displacements(problem, angles[k]),
            int(k) == best,
        )
        for k in order
    ]


def _displacements(problem: PlatformProblem, angle: float) -> tuple[float | None, float | None]:
    """Compute each elbow's displacement [rad], None for an arm out of reach."""
    q, reached = elbow_angles(problem, np.array([[angle]]))
    first, second = (
        float(q[0, 0, arm] - problem.elbow_0[0, arm]) if reached[0, 0, arm] else None
        for arm in (0, 1)
    )
    return first, second
