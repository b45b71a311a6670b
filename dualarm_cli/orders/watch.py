"""Watch on a long search: progress, best plan, and early end."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import field

from dualarm_cli.model.schedule import Schedule
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass

stop_note = NoteTable(
    "early end",
    interrupted="it was interrupted",
    time_limit="its time limit is {seconds:g} s",
)
"""Reasons for the early end of a search."""


class SeenEnoughError(BaseException):
    """Interrupt of work with a droppable result, see `Watch.droppable`.

    Solvers do not catch it.
    """


@dataclass
class Watch:
    """Progress of a search, the best plan so far, and its early end."""

    report: Callable[[str], None] = lambda _: None
    """Callback for progress messages."""
    limit: float | None = None
    """Time limit [s]; None for the limits of the effort."""
    enough: Callable[[], bool] = lambda: False
    """Callback that returns whether the user has interrupted the search."""
    stopped: Note | None = None
    """Reason for an early end, or None."""
    best: float | None = None
    """Least total of the search so far [s], or None."""
    bound: float | None = None
    """Best lower bound of all totals [s], or None."""
    file_order_best: float | None = None
    """Least total in the file's arm orders [s], or None.

    None if not searched.
    """
    searching: bool = False
    """Whether a search is running."""
    best_plan: Schedule | None = None
    """Quickest plan of the whole job so far, with its notes, or None."""
    catching: bool = False
    """Whether the planner continues with the best plan after a SeenEnoughError."""
    step: tuple[int, int] = (0, 0)
    """Number of the planned order, from 1, and of all orders.

    Both are 0 without orders.
    """
    _begin: float = field(default_factory=time.monotonic)
    _counted: float = 0.0

    @property
    def endable(self) -> bool:
        """Whether an end now would return a plan or an order."""
        return self.best_plan is not None or (self.searching and self.best is not None)

    @property
    def droppable(self) -> bool:
        """Whether a SeenEnoughError may be raised into the running work."""
        return self.catching and self.best_plan is not None

    def begin(self) -> None:
        """Start a search; the time limit counts from the first search."""
        if not self.searching:
            self._begin = time.monotonic()
        self.best = self.bound = self.file_order_best = None
        self.searching = True

    def count(self, number: int, total: int) -> None:
        """Count an order to plan, of a number of orders; 0 ends counting."""
        self.step = number, total
        if number <= 1:
            self._counted = time.monotonic()

    def left(self) -> float | None:
        """Estimate the time left for the counted orders [s], or None."""
        number, total = self.step
        if number <= 1:
            return None
        return (time.monotonic() - self._counted) * (total - number + 1) / (number - 1)

    def end(self) -> None:
        """Mark the end of the search."""
        self.searching, self.step = False, (0, 0)

    def record(self, total: float) -> None:
        """Record the total of a result of the search [s]."""
        self.best = total if self.best is None else min(self.best, total)

    def keep(self, schedule: Schedule) -> None:
        """Keep a plan of the whole job if it is the quickest so far."""
        if self.best_plan is None or schedule.duration < self.best_plan.duration:
            self.best_plan = schedule

    def record_bound(self, bound: float) -> None:
        """Record a lower bound of all totals [s]."""
        self.bound = bound if self.bound is None else max(self.bound, bound)

    def stop(self, ahead: float = 0.0) -> bool:
        """Test whether to stop now.

        Args:
            ahead: expected duration of the next step [s], if that cannot be interrupted.
        """
        if self.enough():
            self.stopped = self.stopped or stop_note("interrupted")
            return True
        if self.limit is not None and self.elapsed() + ahead > self.limit:
            self.stopped = self.stopped or stop_note("time_limit", seconds=self.limit)
            return True
        return False

    def elapsed(self) -> float:
        """Compute the elapsed time of the search [s]."""
        return time.monotonic() - self._begin
