"""Cost of changing tools between an arm's tasks, by the best postures at both stands."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray, distinct, readonly
from dualarm_cli.records import dataclass

NO_TOOL = -1
"""Tool number of an arm without a tool."""


@dataclass(frozen=True)
class ToolStands:
    """Tools and stands of an arm, n tasks, m tools, w options.

    There are up to w options to leave and to take each tool.
    """

    tool: IntArray
    """Number of each task's tool, shape (n,); NO_TOOL for none."""
    start: int
    """Tool before the first task."""
    home: int
    """Tool at the end, if the arm returns."""
    entry: FloatArray
    """Joints at stand approach starts [rad], shape (2, m, w, joints).

    The first index is 0 to leave and 1 to take a tool.
    """
    leaving: FloatArray
    """Joints at the end of the retract [rad], shape (2, m, w, joints)."""
    work: FloatArray
    """Time of lines and dwell [s], shape (2, m, w); infinite without an option."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
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
        """Compute times between an arm's nodes with the required tool changes [s].

        The result has shape (N + 1, N + 1). A change leads from the last task with a tool to the stand of that tool, to
        the stand of the next tool, and on to the next task.

        Args:
            plain: times without changes; the last row is from the start, the last column the return.
            entry: joints at the start of each node, the home last, shape (N + 1, joints).
            leaving: joints at the end of each node, the start last, shape (N + 1, joints).
            duration: rest-to-rest times of moves (..., joints) [s].
            turn: durations of the platform's turns before the first stop and after the last one [s].
            returns: whether the arm returns to its start.
        """
        times = plain.copy()
        last = len(plain) - 1
        tool = np.repeat(self.tool, last // len(self.tool))
        source_tool, target_tool = np.append(tool, self.start), np.append(tool, self.home)
        for old in distinct(source_tool).tolist():
            rows = np.flatnonzero(source_tool == old)
            for new in distinct(target_tool).tolist():
                columns = np.flatnonzero(target_tool == new)
                if not returns:
                    columns = columns[columns != last]
                if old == new or not len(columns):
                    continue
                position: FloatArray = leaving[rows]
                time: FloatArray = np.where(np.eye(len(rows)) > 0.0, 0.0, np.inf)
                # The first arrival is not before the end of the platform's turn.
                earliest = np.where(rows == last, turn[0], 0.0)[:, None]
                for action, number in ((0, old), (1, new)):
                    if number == NO_TOOL:
                        continue
                    step = np.maximum(
                        _moves(position, self.entry[action, number], duration), earliest
                    )
                    time = minimum_sums(time, step + self.work[action, number][None])
                    position, earliest = self.leaving[action, number], np.zeros((1, 1))
                end = _moves(position, entry[columns], duration)
                end = np.where(columns == last, np.maximum(end, turn[1]), end)
                times[np.ix_(rows, columns)] = minimum_sums(time, end)
        return times


def minimum_sums(first: FloatArray, second: FloatArray) -> FloatArray:
    """Compute the min-plus product of matrices, shapes (i, k) and (k, j)."""
    sums = np.full((first.shape[0], second.shape[1]), np.inf)
    for k in range(first.shape[1]):
        np.minimum(sums, first[:, k, None] + second[None, k], out=sums)
    return sums


def _moves(
    leaving: FloatArray, entry: FloatArray, duration: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    """Compute the times between all pairs of postures [s], infinite without a posture."""
    times = duration(entry[None] - leaving[:, None])
    return np.where(np.isnan(times), np.inf, times)
