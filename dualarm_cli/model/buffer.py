"""Buffer: places for parts on the way from one task to another."""

from __future__ import annotations

from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Buffer:
    """Places for parts that are all alike: whoever takes one takes any.

    A place takes its room from its event on, the tool at the target; its part can be taken once its dwell is over. A
    pick takes its part at its event, and frees the room once its dwell is over.
    """

    capacity: int
    """How many parts it has room for."""
    initial: int = 0
    """How many are in it at the start."""
    place: Place = NOWHERE
    """Where it is written."""
