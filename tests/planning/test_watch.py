"""Who watches a search: when it ends, and which plan is kept when it does."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import pytest

import dualarm_cli.orders.watch as watching
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.orders.orders import DecidedOrder, Orders
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.ordered_plan import _is_as_quick, _quickest, _Tried, order_notes
from dualarm_cli.refusals import Refusal


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
    """Something with a duration, and what blending gained of it."""

    duration: float
    blend_gain: float | None = None


def test_time_counts_from_the_beginning_of_the_search(clock):
    """Ten seconds before it count nothing; what takes longer than is left is not begun."""
    watch = Watch(limit=5.0)
    clock.now += 10.0
    watch.begin()
    clock.now += 4.0
    assert not watch.stop()
    assert not watch.stop(0.9)
    assert watch.stopped is None
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
    """Not before, and not after: then there is a plan, which is kept, or nothing."""
    watch = Watch()
    watch.record(3.0)
    assert not watch.endable
    watch.begin()
    assert not watch.endable
    watch.record(3.0)
    assert watch.endable
    watch.end()
    assert not watch.endable
    watch.keep(Plan(3.0))
    assert watch.endable
    watch.begin()
    assert watch.endable


def test_the_quickest_plan_is_kept():
    """Whenever it comes; only where whoever makes plans goes on with it what is being done may be dropped."""
    watch = Watch()
    watch.catching = True
    assert not watch.droppable
    for duration in (9.0, 8.0, 10.0):
        watch.keep(Plan(duration))
    assert watch.best_plan == Plan(8.0)
    assert watch.droppable
    watch.catching = False
    assert not watch.droppable


def planned(durations, watch, clock=None, takes=1.0, expected=None, only_first=False):
    """The quickest of some plans, and which were made; negative durations have no plan."""
    made = []

    def plan(order):
        made.append(order.job)
        if clock is not None:
            clock.now += takes
        duration = durations[order.job]
        if duration < 0.0:
            raise InfeasibleError(Refusal("not_clear"))
        return Plan(duration)

    watch.begin()
    watch.record(1.0)
    orders = [
        DecidedOrder(k, 1.0, expected=expected[k] if expected else None)
        for k in range(len(durations))
    ]
    return _quickest(orders, watch, plan, _Tried(2), only_first=only_first), made


def test_what_is_said_of_the_planned_order_is_of_its_own_total():
    """Also where another one is better on the grid: 1.25 s there where no order takes less than 1 s is a fifth."""
    orders = Orders((DecidedOrder("first", 1.0), DecidedOrder("second", 1.25)), 1.0, "")
    assert orders.gap(1.25) == pytest.approx(0.2)
    (_, bound) = order_notes(orders, 1.25)
    assert "where this order takes 1.25 s, no order takes less than 1.00 s" in bound


def test_orders_are_planned_until_the_user_has_seen_enough():
    """At least until one has a plan."""
    watch = Watch(enough=lambda: True)
    best, made = planned([-1.0, 9.0, 8.0], watch)
    assert (best.duration, made) == (9.0, [0, 1])
    assert watch.stopped == "it was interrupted"


@pytest.mark.parametrize(
    ("durations", "expected", "made"),
    [
        ([9.0, 8.9, 8.8], [9.1, 9.2, 9.3], [0]),
        ([9.0, 8.9, 8.8], [9.0, 9.01, 9.02], [0, 1]),
        ([9.9, 9.8, 9.7], [9.0, 9.1, 9.2], [0, 1, 2]),
        ([-1.0, 9.0, 8.0], [9.0, 9.1, 9.2], [0, 1]),
    ],
)
def test_no_order_is_planned_that_is_expected_to_be_no_quicker_than_a_plan(
    durations, expected, made
):
    """A plan is quicker than expected by some 0.2 %."""
    best, found = planned(durations, Watch(), expected=expected)
    assert found == made
    assert best.duration == min(durations[k] for k in made if durations[k] > 0.0)


def test_what_blending_gains_makes_no_plan_quicker_than_expected():
    """Orders are expected to take so long with all stops."""
    order = SimpleNamespace(expected=9.0)
    assert _is_as_quick(Plan(8.9), order)
    assert _is_as_quick(Plan(7.9, 1.0), order)
    assert not _is_as_quick(Plan(8.0, 1.5), order)


def test_of_long_orders_no_other_one_is_planned_where_the_first_has_no_plan():
    """Where it has a slow one others are."""
    assert planned([9.9, 9.0], Watch(), expected=[8.0, 8.1], only_first=True)[1] == [0, 1]
    with pytest.raises(InfeasibleError):
        planned([-1.0, 9.0], Watch(), expected=[8.0, 8.1], only_first=True)


def test_orders_are_planned_for_as_long_as_there_is_time(clock):
    """Plans of 2 s each within 5 s: two of them, as the third would take longer than is left."""
    watch = Watch(limit=5.0)
    best, made = planned([9.0, 8.0, 7.0], watch, clock, takes=2.0)
    assert len(made) == 2
    assert best.duration == 8.0
    assert watch.stopped == "its time limit is 5 s"


def test_where_no_order_has_a_plan_the_first_reason_is_given():
    """As it was said."""
    with pytest.raises(InfeasibleError, match="no collision-free plan"):
        planned([-1.0, -1.0], Watch())
