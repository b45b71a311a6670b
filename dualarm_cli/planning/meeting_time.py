"""When an arm meets a part on a conveyor: as soon as it can be there, which depends on where the part is then."""

from __future__ import annotations

from dataclasses import dataclass

SPARE = 1e-3
"""By how much an arm is to be earlier than its part at most where nothing else makes it wait [s]."""
SIDE = 0.1
"""A new time is within what is known of both sides by this share of it at least."""

FARTHEST = 8.0
"""A time is tried no later than by so many times what the arm is late."""


@dataclass
class MeetingTime:
    """The least time that is no earlier than when the arm can be there for a part met then, between two that are known.

    Later the part is elsewhere and the arm may be there sooner or later than for an earlier one: the time is looked for
    by the rule of the false position.
    """

    least: float
    """No part is met earlier than this [s]."""
    last: float
    """No part is met later than this [s]."""
    time: float
    """What is tried now [s]."""
    too_early: tuple[float, float] | None = None
    """The latest time known to be too early, and by how much the arm is late for it [s]."""
    rate: float = 1.0
    """By how much less late the arm was for a later time that is too early as well, per second."""
    boldness: float = 1.0
    """By how many times what the arm is early an earlier time is tried."""
    possible: tuple[float, float] | None = None
    """The earliest time known to be possible, and by how much the arm is early for it [s]."""

    def note(self, arrival: float) -> bool:
        """Notes when the arm can be there for a part that is met at `time`; returns whether that is soon enough.

        Args:
            arrival: the earliest time at which it can be there [s].
        """
        spare = self.time - arrival
        if spare < 0.0:
            if self.too_early is None or self.time > self.too_early[0]:
                if self.too_early is not None:
                    closed = (self.too_early[1] + spare) / (self.time - self.too_early[0])
                    self.rate = min(1.5, max(1.0 / FARTHEST, closed))
                self.too_early = self.time, -spare
            return False
        if self.possible is None or self.time < self.possible[0]:
            self.possible = self.time, spare
        return spare <= SPARE or self.time <= self.least

    def next(self) -> bool:
        """Takes the next time to be tried; returns whether there is one: else even the last one is too early."""
        if self.possible is None:
            assert self.too_early is not None  # one of the two has been noted
            tried, late = self.too_early
            self.time = min(tried + late / self.rate + 0.5 * SPARE, self.last)
            return tried < self.last
        high, spare = self.possible
        if self.too_early is None or self.too_early[0] >= high:
            self.time = max(self.least, high - self.boldness * spare + 0.5 * SPARE)
            self.boldness = min(2.0 * self.boldness, FARTHEST)
            return True
        low, late = self.too_early
        # Where the arm would just be in time if that went straight from one to the other; a little later.
        share = late / (late + spare) if late + spare > 0.0 else 0.5
        goal = low + share * (high - low) + 0.25 * SPARE
        room = SIDE * (high - low)
        self.time = max(self.least, min(max(goal, low + room), high - room))
        return True
