"""Buffers as numbers: what stops put in and take out, and orders of stages that have no room or no part for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass

MISSING = 1000.0
"""What a part counts in the total that is taken and not there, or put where there is no room [s]."""


@dataclass(frozen=True)
class Stores:
    """K buffers, and what each of s stops does to them."""

    change: IntArray
    """1 for a stop that puts a part in, -1 for one that takes one out, shape (s + 1, K); 0 in the last row, which IDLE
    points at."""
    capacity: IntArray
    """Room for so many parts, shape (K,)."""
    initial: IntArray
    """Parts at the start, shape (K,)."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("change", "capacity", "initial"):
            numbers = np.array(getattr(self, name), dtype=np.int64)
            numbers.setflags(write=False)
            object.__setattr__(self, name, numbers)

    def only(self, k: int) -> Stores:
        """Returns one of the buffers by itself."""
        return Stores(self.change[:, [k]], self.capacity[[k]], self.initial[[k]])

    def joined(self, other: Stores | None) -> Stores:
        """Returns these and other buffers of the same stops."""
        if other is None:
            return self
        return Stores(
            np.concatenate([other.change, self.change], axis=1),
            np.append(other.capacity, self.capacity),
            np.append(other.initial, self.initial),
        )

    @property
    def is_possible(self) -> bool:
        """Returns whether what there is at the start, and after all stops, is no less than nothing and has room."""
        end = self.initial + self.change.sum(axis=0)
        levels = np.stack([self.initial, end])
        return bool(((levels >= 0) & (levels <= self.capacity)).all())

    def of(self, stops: Sequence[int], before: Sequence[int]) -> Stores:
        """Returns the buffers of some stops alone, numbered anew, with what there is after others."""
        change = np.concatenate([self.change[list(stops)], self.change[-1:]])
        initial = self.initial + self.change[list(before)].sum(axis=0)
        return Stores(change, self.capacity, initial)

    def after(self, slots: IntArray) -> IntArray:
        """Returns how many parts there are after the stages of an order (n, arms), shape (K,)."""
        found: IntArray = self.initial + self.change[slots].sum(axis=(0, 1))
        return found

    def fits(self, level: IntArray, stops: IntArray) -> IntArray:
        """Returns by how many parts stages go wrong: taken and not there, or put where there is no room, shape (..,).

        Within a stage any of its stops may be the first: what is put in is not there yet for what is taken out, and
        what is taken out leaves no room yet.

        Args:
            level: parts before each stage, shape (.., K).
            stops: of each stage, IDLE for none, shape (.., arms).
        """
        change = self.change[stops]
        puts, takes = (np.maximum(sign * change, 0).sum(axis=-2) for sign in (1, -1))
        over = np.where(puts > 0, np.maximum(level + puts - self.capacity, 0), 0)
        lack = np.where(takes > 0, np.maximum(takes - level, 0), 0)
        found: IntArray = (over + lack).sum(axis=-1)
        return found

    def missing(self, slots: IntArray, level: IntArray | None = None) -> FloatArray:
        """Returns what b orders of stages count for parts that are not there or have no room [s], shape (b,).

        Args:
            slots: stops, shape (b, n, arms), IDLE where an arm has none.
            level: parts before them, shape (K,); those at the start by default.
        """
        start = self.initial if level is None else level
        change = self.change[slots].sum(axis=2)
        before = start + np.cumsum(change, axis=1) - change
        found: FloatArray = MISSING * self.fits(before, slots).sum(axis=1)
        return found
