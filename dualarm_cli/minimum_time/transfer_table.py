"""Transfer times of all pairs of postures, looked up: fast enough for hundreds of millions of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.timing.rest_to_rest import RestToRest

SAME_LAW = 0.03
"""Laws whose constants differ by less than this share are taken as one, the quickest."""
STEPS = 16_000
"""Steps of the table over the largest distance; differences of coordinates then fit 16 bits."""
LONGEST = 4.0 * np.pi
"""Largest joint displacement that is told from larger ones [rad]."""
ROWS = 48
"""Rows of a block of pairs: small enough for the cache."""

Coordinates = NDArray[np.int16]


@dataclass(frozen=True)
class _Class:
    """Joints with one law in units of their speed."""

    columns: tuple[int, ...]
    """Which coordinates."""
    time: NDArray[np.float32]
    """Time [s] of a distance of so many steps, rounded down to whole steps; shape (2 * STEPS,)."""


@dataclass(frozen=True)
class TransferTable:
    """Times of a group of joints that move together, at the resolution of a table.

    A joint's displacement in units of its speed needs T(d / v), the same T for all joints whose limits stand in the
    same proportions; the slowest joint is then the one with the largest d / v, and one look-up serves all. The look-up
    is never above the closed form by more than what rounding a coordinate to half a step makes.
    """

    scale: FloatArray
    """Steps per radian of each joint, shape (c,)."""
    classes: tuple[_Class, ...]
    """Joints by law."""

    @classmethod
    def of(cls, laws: list[RestToRest]) -> TransferTable:
        """Returns the table of several groups of joints, their columns one after the other."""
        velocity = np.concatenate([law.velocity for law in laws])
        acceleration = np.concatenate([law.acceleration for law in laws]) / velocity
        jerk = np.concatenate([law.jerk for law in laws]) / velocity
        step = LONGEST / velocity.min() / STEPS
        classes = []
        left = list(range(len(velocity)))
        while left:
            first = left[0]
            alike = [
                c
                for c in left
                if abs(acceleration[c] / acceleration[first] - 1.0) <= SAME_LAW
                and (jerk[c] == jerk[first] or abs(jerk[c] / jerk[first] - 1.0) <= SAME_LAW)
            ]
            law = RestToRest(
                np.ones(1), acceleration[alike].max(keepdims=True), jerk[alike].max(keepdims=True)
            )
            distance = np.maximum(np.arange(2 * STEPS) - 0.5, 0.0) * step
            classes.append(_Class(tuple(alike), law.duration(distance[:, None]).astype(np.float32)))
            left = [c for c in left if c not in alike]
        return cls(1.0 / (velocity * step), tuple(classes))

    def coordinates(self, joints: FloatArray) -> Coordinates:
        """Returns joints (n, c) [rad] in steps, coordinate first, shape (c, n)."""
        steps = np.round(joints * self.scale).T
        return np.ascontiguousarray(np.clip(steps, -STEPS + 1, STEPS - 1).astype(np.int16))

    def times(
        self, start: Coordinates, goal: Coordinates, without: tuple[int, ...] = ()
    ) -> NDArray[np.float32]:
        """Returns the times of all pairs [s], shape (n, m).

        Args:
            start: in steps, shape (c, n).
            goal: in steps, shape (c, m).
            without: coordinates that do not count.
        """
        longest = None
        work = np.empty((start.shape[1], goal.shape[1]), dtype=np.int16)
        for group in self.classes:
            columns = [c for c in group.columns if c not in without]
            if not columns:
                continue
            most = np.subtract(start[columns[0], :, None], goal[columns[0]])
            np.abs(most, out=most)
            for c in columns[1:]:
                np.subtract(start[c, :, None], goal[c], out=work)
                np.abs(work, out=work)
                np.maximum(most, work, out=most)
            time = np.take(group.time, most, mode="clip")
            longest = time if longest is None else np.maximum(longest, time, out=longest)
        if longest is None:
            return np.zeros((start.shape[1], goal.shape[1]), dtype=np.float32)
        return longest

    def least(
        self,
        start: Coordinates,
        goal: Coordinates,
        beyond: NDArray[np.float32],
        without: tuple[int, ...] = (),
    ) -> NDArray[np.float32]:
        """Returns the least time to any goal and beyond [s], shape (n,): the min-plus product.

        Args:
            start: in steps, shape (c, n).
            goal: in steps, shape (c, m).
            beyond: what comes after each goal [s], shape (m,).
            without: coordinates that do not count.
        """
        n = start.shape[1]
        best = np.empty(n, dtype=np.float32)
        for k in range(0, n, ROWS):
            time = self.times(start[:, k : k + ROWS], goal, without)
            time += beyond
            best[k : k + ROWS] = time.min(axis=1)
        return best


def rows_of(coordinates: Coordinates, rows: IntArray) -> Coordinates:
    """Returns the coordinates of some postures."""
    return np.ascontiguousarray(coordinates[:, rows])
