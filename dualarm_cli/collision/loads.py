"""Loads of arms, and their numbers in arrays."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, IntArray
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Load:
    """Tool and part held by an arm, with their treatment in collision checks."""

    name: str
    """Name of the held object, see `Held.name`; empty for nothing."""
    on_line: bool = False
    """Whether it is on a stop's lines, where the part may touch standing objects."""
    is_handed: bool = False
    """Whether it is handed over, so that the other tool and its load may touch it."""
    scene: int = 0
    """Index of the scene."""


@dataclass(frozen=True)
class Loads:
    """Numbering of loads in arrays, by name within each scene."""

    names: tuple[str, ...]
    """Names of all objects that may be held: nothing, then tools, then parts."""

    @property
    def _per_scene(self) -> int:
        return 4 * len(self.names)

    def number(self, name: str, *, on_line: bool = False) -> int:
        """Return the number of a load in the first scene."""
        return 2 * self.names.index(name) + on_line

    def load(self, number: int) -> Load:
        """Decode the number of a load."""
        scene, plain = divmod(number, self._per_scene)
        is_handed, place = divmod(plain // 2, len(self.names))
        return Load(self.names[place], plain % 2 == 1, is_handed == 1, scene)

    def nothing(self, *shape: int) -> IntArray:
        """Return the numbers of empty arms in the first scene."""
        return np.full(shape, self.number(""), dtype=np.int64)

    def in_scenes(self, numbers: IntArray, scenes: IntArray) -> IntArray:
        """Return the numbers of loads of the first scene in other scenes."""
        return numbers + self._per_scene * scenes

    def scenes(self, numbers: IntArray) -> IntArray:
        """Return the scenes of loads."""
        return numbers // self._per_scene

    def in_first_scene(self, numbers: IntArray) -> IntArray:
        """Return the numbers of loads in the first scene."""
        return numbers % self._per_scene

    def off_lines(self, numbers: IntArray) -> IntArray:
        """Return the numbers of loads off lines, in the first scene."""
        return self.in_first_scene(numbers) // 2 * 2

    def on_lines(self, numbers: IntArray) -> IntArray:
        """Return the numbers of loads on lines."""
        return numbers | 1

    def are_on_lines(self, numbers: IntArray) -> BoolArray:
        """Check which loads are on lines."""
        return np.asarray(numbers % 2 == 1)

    def at_stops(self, numbers: IntArray, handing: BoolArray) -> IntArray:
        """Return the numbers of loads at stops and on the lines there.

        Args:
            numbers: numbers of loads off lines, shape (..., arms).
            handing: where a part is handed over, shape (...).
        """
        handed = numbers + 2 * len(self.names)
        return np.where(handing[..., None], handed, self.on_lines(numbers))

    def fuller(self, before: IntArray, after: IntArray) -> IntArray:
        """Return the numbers of the larger loads: a tool with a part exceeds the tool."""
        return np.maximum(before, after)
