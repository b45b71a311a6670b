"""Who watches a search: when it ends, and which plan is kept when it does."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

import dualarm_cli.planning.watch as watching
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.planning.ordered_plan import _quickest, order_notes
from dualarm_cli.planning.orders import DecidedOrder, Orders
from dualarm_cli.planning.watch import INTERRUPTED, SeenEnoughError, Watch


@dataclass
class Clock:
    """A clock that goes on when told."""

    now: float = 100.0

    def monotonic(self):
        """The time [s]."""
        return self.now


@pytest.fixture
def clock(monkeypatch):
    """The clock that watches look at."""
    clock = Clock()
    monkeypatch.setattr(watching, "time", clock)
    return clock


@dataclass
class Plan:
    """Something with a duration."""

    duration: float


def test_time_counts_from_the_beginning_of_the_search(clock):
    """Ten seconds before it count nothing; what takes longer than is left is not begun."""
    watch = Watch(limit=5.0)
    clock.now += 10.0
    watch.begin()
    clock.now += 4.0
    assert not watch.stop()
    assert not watch.stop(0.9)
    assert watch.stopped == ""
    assert watch.stop(1.1)
    assert watch.stopped == "its time limit is 5 s"
    clock.now += 1.1
    assert watch.stop()


def test_without_limit_and_interruption_it_never_stops(clock):
    """However long it takes."""
    watch = Watch()
    watch.begin()
    clock.now += 1e9
    assert not watch.stop(1e9)


def test_a_search_can_be_ended_while_it_goes_on_and_has_something():
    """Not before, and not after."""
    watch = Watch()
    watch.found(3.0)
    assert not watch.endable
    watch.begin()
    assert not watch.endable
    watch.found(3.0)
    assert watch.endable
    watch.end()
    assert not watch.endable


def planned(durations, watch, clock=None, takes=1.0):
    """The quickest of some plans, and how many were made; negative durations have no plan, 0 is interrupted."""
    made = []

    def plan(job, _start, _patient):
        made.append((job, watch.droppable, watch.endable))
        if clock is not None:
            clock.now += takes
        duration = durations[job]
        if duration < 0.0:
            raise InfeasibleError("it touches")
        if duration == 0.0:
            watch.enough = lambda: True
            raise SeenEnoughError
        return Plan(duration)

    watch.begin()
    watch.found(1.0)
    orders = [DecidedOrder(k, 1.0) for k in range(len(durations))]
    best, _ = _quickest(orders, watch, plan, set(), patient=True)
    return best, made


def test_what_the_search_says_of_the_order_of_the_quickest_plan_is_told():
    """On the grid another one is better: nothing is said of that one."""
    plans = {"first": Plan(9.0), "second": Plan(8.0)}
    orders = [DecidedOrder("first", 1.0), DecidedOrder("second", 1.25)]
    best, total = _quickest(orders, Watch(), lambda job, *_: plans[job], set(), patient=True)
    assert (best.duration, total) == (8.0, 1.25)
    orders = Orders(tuple(orders), 1.0, "")
    assert orders.gap(total) == pytest.approx(0.2)
    (_, bound) = order_notes(orders, total, Watch())
    assert "where this order takes 1.25 s, no order takes less than 1.00 s" in bound


def test_an_interruption_drops_the_plan_that_is_made_and_keeps_the_best():
    """The second of three is the best one when the third is dropped; the fourth is not begun."""
    watch = Watch()
    best, made = planned([9.0, 8.0, 0.0, 7.0], watch)
    assert best.duration == 8.0
    assert [job for job, *_ in made] == [0, 1, 2]
    assert watch.stopped == INTERRUPTED
    assert not watch.droppable


def test_only_what_comes_after_a_plan_may_be_dropped():
    """Not the first one, nor the next one when the first has no plan."""
    _, made = planned([-1.0, 9.0, 8.0], Watch())
    assert [droppable for _, droppable, _ in made] == [False, False, True]


def test_planning_the_only_order_is_no_search():
    """Nothing is left to choose: Ctrl-C then gives up."""
    _, made = planned([9.0], Watch())
    assert [endable for *_, endable in made] == [False]
    _, made = planned([9.0, 8.0], Watch())
    assert [endable for *_, endable in made] == [True, True]


def test_orders_are_planned_for_as_long_as_there_is_time(clock):
    """Plans of 2 s each within 5 s: two of them, as the third would take longer than is left."""
    watch = Watch(limit=5.0)
    best, made = planned([9.0, 8.0, 7.0], watch, clock, takes=2.0)
    assert len(made) == 2
    assert best.duration == 8.0
    assert watch.stopped == "its time limit is 5 s"


def test_where_no_order_has_a_plan_the_first_reason_is_given():
    """As it was said."""
    with pytest.raises(InfeasibleError, match="touches"):
        planned([-1.0, -1.0], Watch())
