"""Messages of jobs without feasible order: tasks out of reach, contradictory rules."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import ANY, Job, Task
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.orders.model.buffer_numbers import used_buffers
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.paired.problem import StageProblem
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import Relaxation
from dualarm_cli.postures.reach import explain_reach
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.refusals import Refusal


def grid_gap(bound: float | None, total: float) -> float | None:
    """Compute the optimality gap of an order on the search's grid.

    None without a bound. An order of zero duration, such as that of a free start alone, has no gap.

    Args:
        bound: lower bound of all orders [s], or None.
        total: duration of the order [s].
    """
    if bound is None:
        return None
    return max(0.0, 1.0 - bound / total) if total > 0.0 else 0.0


def check_reach(order: OrderModel) -> None:
    """Raise InfeasibleError if no arm reaches a task, or an arm no tool stand."""
    reached = order.reached().any(axis=2)
    unreachable = np.flatnonzero(~reached.any(axis=0)).tolist()
    if not unreachable:
        _check_stands(order)
        return
    raise InfeasibleError(*(_out_of_reach(order, t) for t in unreachable))


def _out_of_reach(order: OrderModel, t: int) -> Refusal:
    """Refuse a task that no arm can do, with causes by arm."""
    task = order.job.tasks[t]
    causes = [
        Refusal("by_arm", arm=name, data={"cause": _why(order, t, name)})
        for name in order.model.arms
        if task.allows(name)
    ]
    return Refusal("out_of_reach", task.place, task.id, data={"causes": causes})


def _check_stands(order: OrderModel) -> None:
    """Raise InfeasibleError if an arm cannot reach a stand that it requires."""
    refusals = []
    for t, stand in enumerate(order.tasks):
        if not stand.is_change or len(order.nodes[stand.arm, t, 0].angle_index):
            continue
        start = order.job.cell.start_tool(stand.arm)
        tools = {task.tool for task in order.job.tasks if task.arm == stand.arm}
        if (
            tools <= {start}
            or stand.tool not in {start, *tools}
            or stand.stops[0].action == "take_tool"
        ):
            continue
        details = {"tool": stand.tool, "cause": _why(order, t, stand.arm)}
        refusals.append(
            Refusal("stand_out_of_reach", stand.place, stand.id, stand.arm, data=details)
        )
    if refusals:
        raise InfeasibleError(*refusals)


def _why(order: OrderModel, t: int, name: str) -> Refusal:
    """Explain why one arm cannot do a task."""
    task = order.tasks[t]
    for stop in task.stops:
        seen = stop_problems(order.model, order.job, order.start, {name: (task, stop)})[name]
        reason = explain_reach(order.model, order.start, seen)
        if reason is not None:
            details = {"action": stop.action, "cause": reason}
            return Refusal("at_stop", data=details) if len(task.stops) > 1 else reason
    return Refusal("stops_lack_clearance" if len(task.stops) > 1 else "stop_lacks_clearance")


def check_meetings(order: OrderModel, problem: StageProblem) -> None:
    """Raise InfeasibleError if the arms of a hand-over cannot meet at any platform angle."""
    refusals = []
    for giving, taking in problem.handovers:
        give, take = problem.tasks[giving][-1], problem.tasks[taking][0]
        possible = False
        for giver, pair in enumerate(((give, take), (take, give))):
            # The work of each arm includes the partner's, which is infinite if that is out of reach.
            reachable = np.isfinite(problem.work[giver][give])
            if problem.pair_cost is not None:
                reachable &= np.isfinite(problem.pair_cost[pair])
            possible |= bool(reachable.any())
        task = order.job.tasks[giving]
        if not possible and task.handover is not None:
            code = "arms_cannot_meet" if task.arm == ANY else "arm_cannot_give"
            refusals.append(Refusal(code, task.handover.place, task.id, task.arm))
    if refusals:
        raise InfeasibleError(*refusals)


def why_impossible(order: OrderModel, problem: Relaxation) -> InfeasibleError | None:
    """Explain by minimal contradictory rules that no order exists; None if unproven.

    Args:
        order: the job's tasks.
        problem: relaxation of the job; if it is infeasible, the job is.
    """
    infeasible = np.flatnonzero(~np.isfinite(problem.least)).tolist()
    if infeasible:
        return InfeasibleError(*(_out_of_reach(order, t) for t in infeasible))
    rules = _rules(problem, order.job.tasks) | _buffer_rules(problem, order.job)
    if not _is_impossible(problem):
        return None
    contradictory = list(rules)
    for name in list(contradictory):
        others = [rule for rule in contradictory if rule != name]
        if _is_impossible(_only(problem, [rules[rule] for rule in others])):
            contradictory = others
    if not contradictory:
        return InfeasibleError(Refusal("no_order"))
    tasks = [
        task for task in order.job.tasks if any(f"'{task.id}'" in name for name in contradictory)
    ]
    buffers = [b for name, b in order.job.buffers.items() if _of_buffer(name, b) in contradictory]
    places = [task.place for task in tasks] + [buffer.place for buffer in buffers]
    place = min(places, key=lambda place: place.order, default=None)
    code = "rule_broken" if len(contradictory) == 1 else "rules_contradict"
    return InfeasibleError(Refusal(code, place, data={"rules": contradictory}))


Rule = Callable[[Relaxation], Relaxation]


def _rules(problem: Relaxation, tasks: Sequence[Task]) -> dict[str, Rule]:
    """List the rules that can contradict each other.

    They are functions that add the rule to a problem.
    """
    rules: dict[str, Rule] = {}
    ids = [task.id for task in tasks]
    for pair in problem.before:

        def comes(p: Relaxation, pair: tuple[int, int] = pair) -> Relaxation:
            return replace(p, before=(*p.before, pair))

        _add(rules, f"'{ids[pair[1]]}' after '{ids[pair[0]]}'", comes)
    for row in problem.sequences:
        names = ", ".join(f"'{ids[t]}'" for t in row)

        def follows(p: Relaxation, row: tuple[int, ...] = row) -> Relaxation:
            return replace(p, sequences=(*p.sequences, row))

        rules[f"{names} by one arm in a row"] = follows
    if problem.not_before is not None:
        for t in np.flatnonzero(problem.not_before > 0.0).tolist():
            value = float(problem.not_before[t])

            def opens(p: Relaxation, t: int = t, value: float = value) -> Relaxation:
                window = np.zeros(p.tasks) if p.not_before is None else p.not_before.copy()
                window[t] = value
                return replace(p, not_before=window)

            _add(rules, f"'{ids[t]}' not_before: {tasks[t].not_before:g} s", opens)
    if problem.not_after is not None:
        for t in np.flatnonzero(np.isfinite(problem.not_after)).tolist():
            value = float(problem.not_after[t])

            def closes(p: Relaxation, t: int = t, value: float = value) -> Relaxation:
                window = np.full(p.tasks, np.inf) if p.not_after is None else p.not_after.copy()
                window[t] = value
                return replace(p, not_after=window)

            _add(rules, f"'{ids[t]}' not_after: {tasks[t].not_after:g} s", closes)
    return rules


def _add(rules: dict[str, Rule], name: str, rule: Rule) -> None:
    """Add a rule; the equal rules of both tasks of a hand-over become one."""
    equal_rule = rules.get(name)
    rules[name] = rule if equal_rule is None else lambda problem: rule(equal_rule(problem))


def _buffer_rules(problem: Relaxation, job: Job) -> dict[str, Rule]:
    """List the buffers, each as a function that adds it to a problem."""
    rules: dict[str, Rule] = {}
    stores = problem.stores
    if stores is None:
        return rules
    for k, name in enumerate(used_buffers(job)):

        def holds(p: Relaxation, k: int = k) -> Relaxation:
            return replace(p, stores=stores.only(k).joined(p.stores))

        rules[_of_buffer(name, job.buffers[name])] = holds
    return rules


def _of_buffer(name: str, buffer: Buffer) -> str:
    """Name a buffer as a rule."""
    return f"buffer {name} (room for {buffer.capacity}, {buffer.initial} at the start)"


def _only(problem: Relaxation, rules: list[Rule]) -> Relaxation:
    restricted = replace(
        problem, before=(), sequences=(), not_before=None, not_after=None, stores=None
    )
    for rule in rules:
        restricted = rule(restricted)
    return restricted


def _is_impossible(problem: Relaxation) -> bool:
    return prove(problem, None, 4.0, 0).impossible
