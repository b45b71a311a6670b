"""Transfer times of all pairs of postures, looked up: fast enough for hundreds of millions of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.timing.rest_to_rest import RestToRest

SAME_LAW = 0.03
"""Laws whose constants differ by less than this share are taken as one, the quickest."""
STEPS = 32_000
"""Steps of the table over the widest joint's range; differences of coordinates then fit 16 bits."""
WIDEST = 4.0 * np.pi
"""Range of a joint without position limits beyond which the table does not distinguish [rad]."""
ROWS = 48
"""Rows of a block of pairs: small enough for the cache."""

Coordinates = NDArray[np.int16]


@dataclass(frozen=True)
class _Class:
    """Joints with one law in units of their speed."""

    columns: tuple[int, ...]
    """Which coordinates."""
    time: NDArray[np.float32]
    """Time [s] of a distance of so many steps, one step less, shape (STEPS + 1,)."""


@dataclass(frozen=True)
class TransferTable:
    """Times of a group of joints that move together, at the resolution of a table.

    A joint's displacement in units of its speed needs T(d / v), the same T for all joints whose limits stand in the
    same proportions; the slowest joint is then the one with the largest d / v, and one look-up serves all. As
    rounding two coordinates can make one step, a step less is looked up: times are never above the closed form.
    """

    scale: FloatArray
    """Steps per radian of each joint, shape (c,)."""
    middle: FloatArray
    """Middle of each joint's range [rad], shape (c,)."""
    classes: tuple[_Class, ...]
    """Joints by law."""

    @classmethod
    def of(cls, laws: list[RestToRest], lower: FloatArray, upper: FloatArray) -> TransferTable:
        """Returns the table of several groups of joints, their columns one after the other.

        Args:
            laws: of each group.
            lower: lowest position of every joint [rad], shape (c,), -inf allowed.
            upper: highest position [rad], shape (c,), inf allowed.
        """
        bounded = np.isfinite(lower) & np.isfinite(upper)
        low, high = np.where(bounded, lower, -0.5 * WIDEST), np.where(bounded, upper, 0.5 * WIDEST)
        span, middle = high - low, 0.5 * (low + high)
        velocity = np.concatenate([law.velocity for law in laws])
        acceleration = np.concatenate([law.acceleration for law in laws]) / velocity
        jerk = np.concatenate([law.jerk for law in laws]) / velocity
        step = float((span / velocity).max()) / STEPS
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
            distance = np.maximum(np.arange(STEPS + 1) - 1.0, 0.0) * step
            classes.append(_Class(tuple(alike), law.duration(distance[:, None]).astype(np.float32)))
            left = [c for c in left if c not in alike]
        return cls(1.0 / (velocity * step), middle, tuple(classes))

    def coordinates(self, joints: FloatArray) -> Coordinates:
        """Returns joints (n, c) [rad] in steps, coordinate first, shape (c, n)."""
        steps = np.round((joints - self.middle) * self.scale).T
        half = STEPS // 2
        return np.ascontiguousarray(np.clip(steps, -half, half).astype(np.int16))

    def joints(self, coordinates: Coordinates) -> FloatArray:
        """Returns joints (n, c) [rad] from steps (c, n), to half a step."""
        return coordinates.T / self.scale + self.middle

    def box(self, low: FloatArray, high: FloatArray) -> tuple[Coordinates, Coordinates]:
        """Returns boxes of joints in steps, rounded outward, coordinate first, shape (c, n) each.

        Args:
            low: lowest joints [rad], shape (n, c), -inf allowed.
            high: highest joints [rad], shape (n, c), inf allowed.
        """
        half = STEPS // 2
        bottom, top = ((x - self.middle) * self.scale for x in (low, high))
        steps = np.floor(np.clip(bottom, -half, half)), np.ceil(np.clip(top, -half, half))
        return tuple(np.ascontiguousarray(x.T.astype(np.int16)) for x in steps)  # type: ignore[return-value]

    def gap_times(
        self,
        low: Coordinates,
        high: Coordinates,
        goal_low: Coordinates,
        goal_high: Coordinates,
        without: tuple[int, ...] = (),
    ) -> NDArray[np.float32]:
        """Returns the least times between all pairs of boxes [s], shape (n, m): from the nearest points of each.

        Args:
            low: lowest coordinates of the boxes where transfers begin, shape (c, n).
            high: highest ones.
            goal_low: lowest coordinates of the boxes where they end, shape (c, m).
            goal_high: highest ones.
            without: coordinates that do not count.
        """
        n, m = low.shape[1], goal_low.shape[1]
        result = np.zeros((n, m), dtype=np.float32)
        for k in range(0, n, ROWS):
            rows = slice(k, k + ROWS)
            for group in self.classes:
                columns = [c for c in group.columns if c not in without]
                if not columns:
                    continue
                gap = np.zeros((min(ROWS, n - k), m), dtype=np.int16)
                for c in columns:
                    np.maximum(gap, goal_low[c] - high[c, rows, None], out=gap)
                    np.maximum(gap, low[c, rows, None] - goal_high[c], out=gap)
                time = np.take(group.time, gap, mode="clip")
                np.maximum(result[rows], time, out=result[rows])
        return result

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


def rows_of(coordinates: Coordinates, rows: IntArray) -> Coordinates:
    """Returns the coordinates of some postures."""
    return np.ascontiguousarray(coordinates[:, rows])
