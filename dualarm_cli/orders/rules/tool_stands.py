"""Cost of changing tools between an arm's tasks, by the best postures at both stands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct, readonly
from dualarm_cli.records import dataclass

NO_TOOL = -1
"""Stands for no tool."""


@dataclass(frozen=True)
class ToolStands:
    """One arm's m tools: with which each of n tasks is done, and up to w ways to leave and to take each."""

    tool: IntArray
    """Number of each task's tool, NO_TOOL for none, shape (n,)."""
    start: int
    """The tool that is on before the first task."""
    home: int
    """The tool that is on in the end, where the arm goes back."""
    entry: FloatArray
    """Joints where the approach to a stand begins, to leave a tool and to take it [rad], shape (2, m, w, joints)."""
    leaving: FloatArray
    """Joints where the retract ends [rad], shape (2, m, w, joints)."""
    work: FloatArray
    """Time of lines and dwell [s], infinite for a way that there is not, shape (2, m, w)."""

    def __post_init__(self) -> None:
        """Freezes the arrays of numbers."""
        for name in ("entry", "leaving", "work"):
            object.__setattr__(self, name, readonly(getattr(self, name)))

    def between_with_changes(
        self,
        plain: FloatArray,
        entry: FloatArray,
        leaving: FloatArray,
        duration: Callable[[FloatArray], FloatArray],
        turn: tuple[float, float],
        *,
        returns: bool,
    ) -> FloatArray:
        """Compute times between an arm's nodes, including the tool changes due there [s].

        The result has shape (N + 1, N + 1).

        From the last task of a tool to its stand, from there to the stand of the next one, and on to the next task.

        Args:
            plain: the times without changes; the last row is from the start, the last column the way back.
            entry: joints where every node begins, where the arm goes back to last, shape (N + 1, joints).
            leaving: joints where every node ends, the start last, shape (N + 1, joints).
            duration: rest-to-rest times of moves (..., joints) [s].
            turn: how long the platform turns before the first stop and after the last one [s].
            returns: whether the arm goes back to its start.
        """
        found = plain.copy()
        last = len(plain) - 1
        tool = np.repeat(self.tool, last // len(self.tool))
        came, goes = np.append(tool, self.start), np.append(tool, self.home)
        for old in distinct(came).tolist():
            rows = np.flatnonzero(came == old)
            for new in distinct(goes).tolist():
                columns = np.flatnonzero(goes == new)
                if not returns:
                    columns = columns[columns != last]
                if old == new or not len(columns):
                    continue
                here: FloatArray = leaving[rows]
                time: FloatArray = np.where(np.eye(len(rows)) > 0.0, 0.0, np.inf)
                # From the start no sooner than the platform is there.
                least = np.where(rows == last, turn[0], 0.0)[:, None]
                for action, number in ((0, old), (1, new)):
                    if number == NO_TOOL:
                        continue
                    step = np.maximum(_moves(here, self.entry[action, number], duration), least)
                    time = minimum_sums(time, step + self.work[action, number][None])
                    here, least = self.leaving[action, number], np.zeros((1, 1))
                end = _moves(here, entry[columns], duration)
                end = np.where(columns == last, np.maximum(end, turn[1]), end)
                found[np.ix_(rows, columns)] = minimum_sums(time, end)
        return found


def minimum_sums(one: FloatArray, other: FloatArray) -> FloatArray:
    """Returns the least of one[i, k] + other[k, j] over k, shape (i, j), for shapes (i, k) and (k, j)."""
    found = np.full((one.shape[0], other.shape[1]), np.inf)
    for k in range(one.shape[1]):
        np.minimum(found, one[:, k, None] + other[None, k], out=found)
    return found


def _moves(
    leaving: FloatArray, entry: FloatArray, duration: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Returns the times from every posture to every other [s], infinite where there is none."""
    found = duration(entry[None] - leaving[:, None])
    return np.where(np.isnan(found), np.inf, found)
