"""Plans of jobs with open arms or order: the best orders compete."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import field, replace
from functools import partial

from dualarm_cli.effort import EFFORTS
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders.model.tool_changes import stop_name
from dualarm_cli.orders.order_trials import orders_to_plan
from dualarm_cli.orders.orders import (
    NO_ORDER_FOUND,
    ArmTask,
    DecidedOrder,
    Orders,
    PairedSearch,
    StagePair,
)
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.decided_plan import decided_plan
from dualarm_cli.planning.notes import order_bound_note, order_note
from dualarm_cli.planning.planned_job import PlannedJob
from dualarm_cli.planning.room_rules import planned_around
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.serving import SEQUENCE


def plan_in_best_order(
    work: PlannedJob, job: Job, watch: Watch, keep: Callable[[Schedule], None]
) -> Schedule:
    """Plan paired arms in the best orders; return the fastest plan.

    Args:
        work: the resolved job.
        job: its variant to plan.
        watch: receives progress, and may end the search.
        keep: receives every plan, with its notes.

    Raises:
        InfeasibleError: no arm reaches a task, no order keeps the rules, or every order collides.
    """
    if job.is_decided:
        return decided_plan(work, job, watch)
    return planned_around(job, lambda ruled: _in_best_order(work, ruled, watch, keep), watch.stop)


def _in_best_order(
    work: PlannedJob, job: Job, watch: Watch, keep: Callable[[Schedule], None]
) -> Schedule:
    """Plan paired arms in the best orders, see `plan_in_best_order`."""
    watch.begin()
    settings = work.settings

    def planned(order: DecidedOrder, of: Orders, repair_touching_stops: bool) -> Schedule:
        schedule = decided_plan(
            work, order.job, watch, order.plan, repair_touching_stops=repair_touching_stops
        )
        notes = (*schedule.notes, *order_notes(of, order.total))
        schedule = replace(schedule, order_grid_gap=of.gap(order.total), notes=notes)
        keep(schedule)
        return schedule

    wanted = partial(PairedSearch.of, work.model, job, settings.effort, settings.seed, watch)
    search = wanted(check_collisions=work.check_collisions)
    try:
        orders = search.orders(watch)
    except InfeasibleError as error:
        if not work.check_collisions or error.refusals[0].key != NO_ORDER_FOUND:
            raise
        try:
            orders = wanted(check_collisions=False).orders(watch)
        except InfeasibleError:
            raise error from None
        # Collisions at stops exclude every order: planning one shows which bodies collide.
        return planned(orders.ranked[0], orders, False)
    if job.order != "given" and not watch.stop():
        watch.file_order_best = search.in_file_order()
    return _searched(search, orders, settings, watch, planned)


def _searched(
    search: PairedSearch,
    orders: Orders,
    settings: PlanSettings,
    watch: Watch,
    planned: Callable[..., Schedule],
) -> Schedule:
    """Plan the orders of a search; exclude colliding stages and search again.

    Args:
        search: search for orders.
        orders: its first result.
        settings: settings of the plan.
        watch: receives progress, and may end the search.
        planned: plans an order, `of` a search result; `repair_touching_stops` re-plans colliding stages.
    """
    effort = EFFORTS[settings.effort]
    tried, trials = _Tried(effort.hopeless_orders, search.of_either_arm()), effort.trials
    long = len(orders.ranked[0].job.stages()) > trials.long
    searches = trials.searches_of_long if long else trials.searches
    tries = 0
    while True:
        count_before = tried.count
        # Without a further search no other order follows: repair this one.
        repair_touching_stops = not long or tries > searches or watch.stop()
        one_by_one = partial(planned, of=orders, repair_touching_stops=repair_touching_stops)
        try:
            promising = _promising(search, orders.ranked, settings, watch)
            # In a long order, separating colliding stops succeeds sooner than other orders.
            return _quickest(promising, watch, one_by_one, tried, only_first=long)
        except BlockedError as error:
            last = tries == searches + trials.separations
            if last or tried.count == count_before or tried.is_hopeless:
                raise naming_other_arms(error, tried.unheld) from None
            # Exclude the colliding stops and search again from the best order.
            first = orders.ranked[0].job
            watch.report(f"searching without {tried.count} pairs of stops or arms of tasks")
            search = search.without(tried.pairs, tried.others, first)
            # The last attempts only separate colliding stops and keep the rest, to get any plan.
            is_full_search = search.start is None or (tries < searches and not watch.stop())
            try:
                next_orders = search.orders(watch) if is_full_search else search.as_it_is()
            except InfeasibleError:
                # No-goods are not rules of the job: report the collision instead.
                raise naming_other_arms(error, tried.unheld) from None
            orders = replace(next_orders, bound=orders.bound)
            tries += 1


def _quickest(
    orders: list[DecidedOrder],
    watch: Watch,
    planned: Callable[[DecidedOrder], Schedule],
    tried: _Tried,
    *,
    only_first: bool = False,
) -> Schedule:
    """Plan orders in turn; return the fastest plan.

    Args:
        orders: orders to plan, best first.
        watch: receives progress.
        planned: plans an order.
        tried: no-goods, added to.
        only_first: whether a failure of the first order ends the attempts.
    """
    best: Schedule | None = None
    failure: InfeasibleError | None = None
    longest = 0.0
    for number, order in enumerate(orders, start=1):
        if best is not None and (watch.stop(longest) or _is_as_quick(best, order)):
            break
        if best is None and failure is not None and only_first:
            break
        if tried.repeats(order.job):
            continue
        watch.count(number, len(orders))
        watch.report(f"planning order {number} (estimate {order.total:.2f} s)")
        begin = watch.elapsed()
        try:
            schedule = planned(order)
        except InfeasibleError as error:
            failure = failure or error
            if isinstance(error, BlockedError):
                tried.add(order.job, error)
            if best is None and tried.is_hopeless:
                break
            continue
        longest = max(longest, watch.elapsed() - begin)
        if best is None or schedule.duration < best.duration:
            best = schedule
    watch.count(0, 0)
    if best is None:
        # A search without orders has raised an error before.
        assert failure is not None
        raise failure
    return best


@dataclass
class _Tried:
    """No-goods learned from orders without a plan."""

    most: int
    """Maximum number of orders in which an arm collides regardless of the other."""
    either: frozenset[str] = frozenset()
    """Tasks that either arm may do."""
    alone: int = 0
    """Number of orders in which an arm collided regardless of the other."""
    pairs: set[StagePair] = field(default_factory=set)
    """Pairs of stops that collide in the same stage."""
    others: set[ArmTask] = field(default_factory=set)
    """(arm, task) pairs excluded by a collision without the other arm, or by weight."""
    unheld: set[ArmTask] = field(default_factory=set)
    """(arm, task) pairs whose part the arm could not hold still."""

    @property
    def count(self) -> int:
        """Number of no-goods."""
        return len(self.pairs) + len(self.others)

    def add(self, job: Job, error: BlockedError) -> None:
        """Learn from an order whose plan collides."""
        before = len(self.others)
        self.unheld.update(error.unheld)
        movable = self.either - {task for _, task in self.others}
        self.others |= {pair for pair in error.unheld if pair[1] in movable}
        # Later collisions may follow from the first one: learn one task at a time.
        lone = error.never or _lone_tasks(job, error.stages)
        self.others |= set([pair for pair in lone if pair[1] in movable][:1])
        if not self.others.issuperset(error.never):
            self.alone = self.most
        self.pairs |= _blocked_pairs(job, error.stages)
        # A task that moves to the other arm is progress, not a failure.
        self.alone += error.alone and len(self.others) == before

    def repeats(self, job: Job) -> bool:
        """Return whether an order gives a task to an arm that cannot do it."""
        if not self.others:
            return False
        return not self.others.isdisjoint(_lone_tasks(job, range(len(job.stages()))))

    @property
    def is_hopeless(self) -> bool:
        """Whether no further order is tried."""
        return self.alone >= self.most


def naming_other_arms(error: BlockedError, unheld: Iterable[ArmTask]) -> BlockedError:
    """Add to a refusal by weight the arms that cannot hold the same part, either.

    Args:
        error: of an arm that cannot hold a part; others are returned as they are.
        unheld: all (arm, task) pairs whose part the arm could not hold still.
    """
    arm, task = error.unheld[0] if error.unheld else ("", "")
    arms = sorted({by for by, name in unheld if name == task and by != arm})
    if not arms:
        return error
    first, *others = error.refusals
    tried = [Refusal("other_arm_cannot_hold", arm=name) for name in arms]
    first = replace(first, data={**first.data, "tried": tried})
    return BlockedError(first, *others, stages=error.stages, unheld=error.unheld)


def _lone_tasks(job: Job, stages: Collection[int]) -> list[ArmTask]:
    """Return the (arm, task) pairs of given stages in which the other arm idles."""
    return [
        (arm, task.id)
        for k, work in enumerate(job.stages())
        if k in stages and len(work) == 1
        for arm, (task, _) in work.items()
    ]


def _blocked_pairs(job: Job, stages: tuple[int, ...]) -> set[StagePair]:
    """Return the pairs of simultaneous stops in given stages of a decided job."""
    pairs: set[StagePair] = set()
    for k, work in enumerate(job.stages()):
        if k in stages and len(work) == 2:
            stop_a, stop_b = ((stop_name(task), stop.action) for task, stop in work.values())
            # The two stops of a hand-over cannot be separated.
            if "give" not in (stop_a[1], stop_b[1]):
                pairs.add((stop_a, stop_b))
    return pairs


def _promising(
    search: PairedSearch, orders: tuple[DecidedOrder, ...], settings: PlanSettings, watch: Watch
) -> list[DecidedOrder]:
    """Select the orders to plan, fastest expected plan first."""
    trials = EFFORTS[settings.effort].trials
    if len(orders[0].job.stages()) > trials.most_stages:
        return [orders[0]]
    windows = search.problem.not_before is not None or search.problem.not_after is not None
    if settings.platform == SEQUENCE and not windows:
        orders = orders_to_plan(search, orders, settings.effort, watch)
    limit = (1.0 + trials.promising) * min(_expected(order) for order in orders)
    promising = [order for order in orders if _expected(order) <= limit]
    return promising[: trials.planned]


def _expected(order: DecidedOrder) -> float:
    """Estimate the duration of a plan in an order [s]."""
    return order.total if order.expected is None else order.expected


def _is_as_quick(best: Schedule, order: DecidedOrder) -> bool:
    """Return whether a plan matches the expected duration of an order, with all stops."""
    stopping = best.duration + (best.blend_gain or 0.0)
    # Plans are quicker than expected by about 0.2 %.
    return order.expected is not None and stopping <= 0.998 * order.expected


def order_notes(orders: Orders, total: float) -> list[str]:
    """List notes on the order's search and its proven bound.

    Args:
        orders: what the search found.
        total: of the order that was planned, on the search's grid [s].
    """
    note = order_note("found", search=orders.search, total=total)
    if orders.bound is None:
        return [note]
    return [note, order_bound_note("stages", total=total, bound=orders.bound)]
