"""Buffers as numbers: changes by stops, and penalties for missing parts and missing room."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.records import dataclass

MISSING = 1000.0
"""Penalty per part that is missing or has no room [s]."""


@dataclass(frozen=True)
class Stores:
    """K buffers, and the changes by each of s stops."""

    change: IntArray
    """Change by each stop, shape (s + 1, K).

    1 for a part put in, -1 for one taken out; the last row, for IDLE, is 0.
    """
    capacity: IntArray
    """Capacities [parts], shape (K,)."""
    initial: IntArray
    """Parts at the start, shape (K,)."""

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("change", "capacity", "initial"):
            numbers = np.array(getattr(self, name), dtype=np.int64)
            numbers.setflags(write=False)
            object.__setattr__(self, name, numbers)

    def only(self, k: int) -> Stores:
        """Select one buffer."""
        return Stores(self.change[:, [k]], self.capacity[[k]], self.initial[[k]])

    def joined(self, stores: Stores | None) -> Stores:
        """Append these buffers to others of the same stops."""
        if stores is None:
            return self
        return Stores(
            np.concatenate([stores.change, self.change], axis=1),
            np.append(stores.capacity, self.capacity),
            np.append(stores.initial, self.initial),
        )

    @property
    def is_possible(self) -> bool:
        """Test whether levels at start and end are within the capacity."""
        end = self.initial + self.change.sum(axis=0)
        levels = np.stack([self.initial, end])
        return bool(((levels >= 0) & (levels <= self.capacity)).all())

    def of(self, stops: Sequence[int], before: Sequence[int]) -> Stores:
        """Select stops, renumbered, with the levels after other stops."""
        change = np.concatenate([self.change[list(stops)], self.change[-1:]])
        initial = self.initial + self.change[list(before)].sum(axis=0)
        return Stores(change, self.capacity, initial)

    def after(self, slots: IntArray) -> IntArray:
        """Compute the levels after the stages of an order (n, arms), shape (K,)."""
        levels: IntArray = self.initial + self.change[slots].sum(axis=(0, 1))
        return levels

    def fits(self, level: IntArray, stops: IntArray) -> IntArray:
        """Count the parts that stages miss or have no room for, shape (..,).

        Within a stage any stop may be the first: a part put in is not available to the other stop, and a part taken out
        makes no room for it.

        Args:
            level: parts before each stage, shape (.., K).
            stops: stops of each stage, IDLE for none, shape (.., arms).
        """
        change = self.change[stops]
        puts, takes = (np.maximum(sign * change, 0).sum(axis=-2) for sign in (1, -1))
        excess = np.where(puts > 0, np.maximum(level + puts - self.capacity, 0), 0)
        lack = np.where(takes > 0, np.maximum(takes - level, 0), 0)
        count: IntArray = (excess + lack).sum(axis=-1)
        return count

    def missing(self, slots: IntArray, level: IntArray | None = None) -> FloatArray:
        """Compute penalties of b orders for missing parts, room [s], shape (b,).

        Args:
            slots: stops, shape (b, n, arms), IDLE where an arm has none.
            level: levels before the stages, shape (K,); the initial ones by default.
        """
        start = self.initial if level is None else level
        change = self.change[slots].sum(axis=2)
        before = start + np.cumsum(change, axis=1) - change
        penalties: FloatArray = MISSING * self.fits(before, slots).sum(axis=1)
        return penalties
