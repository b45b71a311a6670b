"""What data determine: the rank of a Jacobian, and the directions that it does not see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray

WEAKEST = 1e-3
"""Singular values below this, relative to the largest of the scaled Jacobian, count as zero: there noise would come
out a thousand times as large."""
SHARE = 1e-4
"""A parameter with a larger share than this in an unseen direction is not determined."""


@dataclass(frozen=True)
class Sight:
    """How a Jacobian sees its parameters."""

    inverse: FloatArray
    """Pseudo-inverse over the directions that it sees, shape (k, m)."""
    seen: BoolArray
    """Which parameters are determined, shape (k,)."""
    unseen: FloatArray
    """Directions that are not, a row each, scaled parameters, shape (j, k)."""
    rank: int
    """How many directions it sees."""

    def covariance(self, variance: float) -> FloatArray:
        """Returns the covariance (k, k) of the parameters for a variance of each residual."""
        return variance * self.inverse @ self.inverse.T

    def in_words(self, names: Sequence[str]) -> list[str]:
        """Returns each direction that is not seen, as a sum of parameters with their shares."""
        found = []
        for row in self.unseen:
            largest = [k for k, share in enumerate(row) if abs(share) > 0.05]
            sign = np.sign(row[largest[0]])
            terms = [f"{sign * row[k]:+.2f} {names[k]}" for k in largest]
            found.append(" ".join(terms).removeprefix("+"))
        return found


def look(jacobian: FloatArray, scale: FloatArray) -> Sight:
    """Returns what a Jacobian determines.

    Args:
        jacobian: of m residuals by k parameters, shape (m, k).
        scale: size of each parameter that counts as one, so that columns can be compared, shape (k,).
    """
    _, values, Vt = np.linalg.svd(jacobian * scale, full_matrices=True)
    count = jacobian.shape[1]
    values = np.concatenate([values, np.zeros(count - len(values))])
    good = values > WEAKEST * values[0]
    kept = Vt[good]
    # pinv(J S) = V diag(1 / values²) Vᵀ (J S)ᵀ over the directions that are seen.
    inverse = scale[:, None] * (kept.T / values[good] ** 2) @ kept @ (jacobian * scale).T
    unseen = Vt[~good]
    share = np.linalg.norm(unseen, axis=0)
    return Sight(inverse, share < SHARE, unseen, int(good.sum()))
