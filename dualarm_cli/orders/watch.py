"""Watch on a long search: receives progress, keeps the best plan, ends it early."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import field

from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass

INTERRUPTED = "it was interrupted"
"""Why a search ended that the user had seen enough of."""


class SeenEnoughError(BaseException):
    """Raised from outside into what may be dropped, see `Watch.droppable`; no solver swallows it."""


@dataclass
class Watch:
    """Progress of a search, the best plan so far, and the end, by time or because the user has seen enough."""

    report: Callable[[str], None] = lambda _: None
    """Receives what is being done."""
    limit: float | None = None
    """How long to search at most [s]; None for as long as the effort says."""
    enough: Callable[[], bool] = lambda: False
    """Whether the user has seen enough."""
    stopped: str = ""
    """Why the search was stopped early; empty where it was not."""
    best: float | None = None
    """Least total that the search has found [s]; None where it has found nothing yet."""
    bound: float | None = None
    """Best bound known on all totals [s]."""
    file_order_best: float | None = None
    """Least total that it has found among orders in which each arm keeps that of the file [s]; None where it has not
    looked for one."""
    searching: bool = False
    """Whether a search is going on."""
    best_plan: Schedule | None = None
    """The quickest plan of the whole job so far, with its notes; None where there is none yet."""
    catching: bool = False
    """Whether whoever makes plans goes on with the kept one after a SeenEnoughError."""
    _begin: float = field(default_factory=time.monotonic)

    @property
    def endable(self) -> bool:
        """Whether there is something that an end now must not lose: a plan, or what a search has found."""
        return self.best_plan is not None or (self.searching and self.best is not None)

    @property
    def droppable(self) -> bool:
        """Whether a SeenEnoughError may be raised into what is being done."""
        return self.catching and self.best_plan is not None

    def begin(self) -> None:
        """A search begins; the time of all searches for a plan counts from the first one."""
        if not self.searching:
            self._begin = time.monotonic()
        self.best = self.bound = self.file_order_best = None
        self.searching = True

    def end(self) -> None:
        """Nothing is left to search for."""
        self.searching = False

    def record(self, total: float) -> None:
        """The search has found something [s]."""
        self.best = total if self.best is None else min(self.best, total)

    def keep(self, schedule: Schedule) -> None:
        """Keeps a plan of the whole job, if it is quicker than the one that is kept."""
        if self.best_plan is None or schedule.duration < self.best_plan.duration:
            self.best_plan = schedule

    def record_bound(self, bound: float) -> None:
        """Nothing takes less than a bound [s]."""
        self.bound = bound if self.bound is None else max(self.bound, bound)

    def stop(self, ahead: float = 0.0) -> bool:
        """Returns whether to stop now.

        Args:
            ahead: how long the next thing will take [s], where it cannot be stopped.
        """
        if self.enough():
            self.stopped = self.stopped or INTERRUPTED
            return True
        if self.limit is not None and self.elapsed() + ahead > self.limit:
            self.stopped = self.stopped or f"its time limit is {self.limit:g} s"
            return True
        return False

    def elapsed(self) -> float:
        """Returns how long the search has taken [s]."""
        return time.monotonic() - self._begin
