"""The table of one move: every method's candidates with the elbow displacements they cause."""

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
    """One candidate of one method."""

    method: str
    """Platform solver."""
    kind: Kind
    """What the candidate is."""
    angle: float
    """Platform angle at the end [rad]."""
    turn: float
    """How far the platform turns, phi_f - phi_0, within half a turn [rad]."""
    delta: tuple[float | None, float | None]
    """Displacement of each elbow [rad]; None for an arm that cannot reach its target."""
    chosen: bool
    """Whether the method prefers it."""

    @property
    def difference(self) -> float | None:
        """|delta_2| - |delta_1| [rad], as the paper prints it; None where an arm cannot reach."""
        one, two = self.delta
        return None if one is None or two is None else abs(two) - abs(one)


def candidate_rows(method: str, solution: PlatformSolution, move: int = 0) -> list[MethodRow]:
    """Returns the candidates of one move: roots by their angle, then the others as they come.

    For `linearised` that is the order of [Bottin2021] Table 2.

    Args:
        method: name of the solver.
        solution: its answer.
        move: which move.
    """
    problem = solution.problem.rows(np.array([move]))
    columns = np.flatnonzero(solution.valid[move])
    kinds, angles = solution.kind[move], solution.angle[move]
    is_root = np.isin(kinds, (Kind.ROOT_SAME, Kind.ROOT_OPPOSITE))
    order = sorted(columns, key=lambda k: (0, angles[k]) if is_root[k] else (1, 0.0))
    best = int(solution.best[move])
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
    """Returns each elbow's displacement, None for an arm out of reach."""
    q, reached = elbow_angles(problem, np.array([[angle]]))
    one, two = (
        float(q[0, 0, arm] - problem.elbow_0[0, arm]) if reached[0, 0, arm] else None
        for arm in (0, 1)
    )
    return one, two
