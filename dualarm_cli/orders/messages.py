"""Message where no order can be found: tasks that no arm reaches, rules that no order keeps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.cell import Buffer
from dualarm_cli.model.job import ANY, Job, Task
from dualarm_cli.orders.model.buffer_numbers import used_buffers
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.paired.problem import StageProblem
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import Relaxation
from dualarm_cli.postures.reach import explain_reach
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.refusals import Refusal


def grid_gap(bound: float | None, total: float) -> float | None:
    """Returns by what share another order may be quicker than one of a total [s], both on the grid of the search.

    None without a bound. An order that takes no time, such as that of a free start alone, has no gap.

    Args:
        bound: what no order takes less than [s], or None.
        total: of the order [s].
    """
    if bound is None:
        return None
    return max(0.0, 1.0 - bound / total) if total > 0.0 else 0.0


def check_reach(order: OrderModel) -> None:
    """Raises InfeasibleError where some task is out of every arm's reach, with why for each arm."""
    reached = order.reached().any(axis=2)
    lost = np.flatnonzero(~reached.any(axis=0)).tolist()
    if not lost:
        _check_stands(order)
        return
    raise InfeasibleError(*(_undone(order, t) for t in lost))


def _undone(order: OrderModel, t: int) -> Refusal:
    """Returns why no arm does a task, with why for each arm that may."""
    task = order.job.tasks[t]
    causes = [
        Refusal("by_arm", arm=name, more={"cause": _why(order, t, name)})
        for name in order.model.arms
        if task.allows(name)
    ]
    return Refusal("out_of_reach", task.place, task.id, more={"causes": causes})


def _check_stands(order: OrderModel) -> None:
    """Raises InfeasibleError where an arm needs another tool than that of the start and does not reach a stand."""
    found = []
    for t, stand in enumerate(order.tasks):
        if not stand.is_change or len(order.nodes[stand.arm, t, 0].angle_index):
            continue
        start = order.job.cell.start_tool(stand.arm)
        own = {task.tool for task in order.job.tasks if task.arm == stand.arm}
        if (
            own <= {start}
            or stand.tool not in {start, *own}
            or stand.stops[0].action == "take_tool"
        ):
            continue
        more = {"tool": stand.tool, "cause": _why(order, t, stand.arm)}
        found.append(Refusal("stand_out_of_reach", stand.place, stand.id, stand.arm, more=more))
    if found:
        raise InfeasibleError(*found)


def _why(order: OrderModel, t: int, name: str) -> Refusal:
    """Returns why one arm cannot do a task."""
    task = order.tasks[t]
    for stop in task.stops:
        seen = stop_problems(order.model, order.job, order.start, {name: (task, stop)})[name]
        reason = explain_reach(order.model, order.start, seen)
        if reason is not None:
            more = {"action": stop.action, "cause": reason}
            return Refusal("at_stop", more=more) if len(task.stops) > 1 else reason
    return Refusal("stops_lack_clearance" if len(task.stops) > 1 else "stop_lacks_clearance")


def check_meetings(order: OrderModel, problem: StageProblem) -> None:
    """Raises InfeasibleError where arms cannot meet for a hand-over at any platform angle, whoever gives."""
    found = []
    for giving, taking in problem.handovers:
        give, take = problem.tasks[giving][-1], problem.tasks[taking][0]
        possible = False
        for giver, pair in enumerate(((give, take), (take, give))):
            # The work of either holds what the other one needs: infinity where that one is out of reach.
            there = np.isfinite(problem.work[giver][give])
            if problem.pair_cost is not None:
                there &= np.isfinite(problem.pair_cost[pair])
            possible |= bool(there.any())
        task = order.job.tasks[giving]
        if not possible and task.handover is not None:
            what = "arms_cannot_meet" if task.arm == ANY else "arm_cannot_give"
            found.append(Refusal(what, task.handover.place, task.id, task.arm))
    if found:
        raise InfeasibleError(*found)


def why_impossible(order: OrderModel, problem: Relaxation) -> InfeasibleError | None:
    """Returns which rules contradict each other: a set of which nothing can be left out; None if none is known to.

    Args:
        order: the job's tasks.
        problem: the same with least times; what is impossible for it is impossible.
    """
    lost = np.flatnonzero(~np.isfinite(problem.least)).tolist()
    if lost:
        return InfeasibleError(*(_undone(order, t) for t in lost))
    rules = _rules(problem, order.job.tasks) | _buffer_rules(problem, order.job)
    if not _is_impossible(problem):
        return None
    kept = list(rules)
    for name in list(kept):
        rest = [other for other in kept if other != name]
        if _is_impossible(_only(problem, [rules[other] for other in rest])):
            kept = rest
    if not kept:
        return InfeasibleError(Refusal("no_order"))
    tasks = [task for task in order.job.tasks if any(f"'{task.id}'" in name for name in kept)]
    buffers = [b for name, b in order.job.buffers.items() if _of_buffer(name, b) in kept]
    places = [task.place for task in tasks] + [buffer.place for buffer in buffers]
    place = min(places, key=lambda place: place.order, default=None)
    what = "rule_broken" if len(kept) == 1 else "rules_contradict"
    return InfeasibleError(Refusal(what, place, more={"rules": kept}))


Rule = Callable[[Relaxation], Relaxation]


def _rules(problem: Relaxation, tasks: Sequence[Task]) -> dict[str, Rule]:
    """Returns everything that can contradict, each with what puts it into a problem without any."""
    found: dict[str, Rule] = {}
    ids = [task.id for task in tasks]
    for pair in problem.before:

        def comes(p: Relaxation, pair: tuple[int, int] = pair) -> Relaxation:
            return replace(p, before=(*p.before, pair))

        _add(found, f"'{ids[pair[1]]}' after '{ids[pair[0]]}'", comes)
    for row in problem.sequences:
        names = ", ".join(f"'{ids[t]}'" for t in row)

        def follows(p: Relaxation, row: tuple[int, ...] = row) -> Relaxation:
            return replace(p, sequences=(*p.sequences, row))

        found[f"{names} by one arm in a row"] = follows
    if problem.not_before is not None:
        for t in np.flatnonzero(problem.not_before > 0.0).tolist():
            value = float(problem.not_before[t])

            def opens(p: Relaxation, t: int = t, value: float = value) -> Relaxation:
                window = np.zeros(p.tasks) if p.not_before is None else p.not_before.copy()
                window[t] = value
                return replace(p, not_before=window)

            _add(found, f"'{ids[t]}' not_before: {tasks[t].not_before:g} s", opens)
    if problem.not_after is not None:
        for t in np.flatnonzero(np.isfinite(problem.not_after)).tolist():
            value = float(problem.not_after[t])

            def closes(p: Relaxation, t: int = t, value: float = value) -> Relaxation:
                window = np.full(p.tasks, np.inf) if p.not_after is None else p.not_after.copy()
                window[t] = value
                return replace(p, not_after=window)

            _add(found, f"'{ids[t]}' not_after: {tasks[t].not_after:g} s", closes)
    return found


def _add(found: dict[str, Rule], name: str, rule: Rule) -> None:
    """Adds a rule; both shares of a hand-over have the same ones, which go together."""
    other = found.get(name)
    found[name] = rule if other is None else lambda problem: rule(other(problem))


def _buffer_rules(problem: Relaxation, job: Job) -> dict[str, Rule]:
    """Returns the buffers, each with what puts it into a problem beside those that are there."""
    found: dict[str, Rule] = {}
    every = problem.stores
    if every is None:
        return found
    for k, name in enumerate(used_buffers(job)):

        def holds(p: Relaxation, k: int = k) -> Relaxation:
            return replace(p, stores=every.only(k).joined(p.stores))

        found[_of_buffer(name, job.buffers[name])] = holds
    return found


def _of_buffer(name: str, buffer: Buffer) -> str:
    """Returns a buffer as a rule that contradicts others."""
    return f"buffer {name} (room for {buffer.capacity}, {buffer.initial} at the start)"


def _only(problem: Relaxation, rules: list[Rule]) -> Relaxation:
    found = replace(problem, before=(), sequences=(), not_before=None, not_after=None, stores=None)
    for rule in rules:
        found = rule(found)
    return found


def _is_impossible(problem: Relaxation) -> bool:
    return prove(problem, None, 4.0, 0).impossible
