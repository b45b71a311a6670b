"""What arms wait for: windows of tasks to open, parts on conveyors to come, and tasks that theirs come after."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from dualarm_cli.model.schedule import WaitReason
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan

ROUNDS = 3
"""So often arms are held back for their parts: where one stands on the way anyway, that takes some of it up."""
ALIKE, ROUNDING = 2e-3, 1e-12
"""Waits that differ by less are for the same, as parts are met a little later than they could be, or one but for
rounding [s]."""


@dataclass(frozen=True)
class StageWaits:
    """What is waited for."""

    common: float = 0.0
    """How long all wait together before the stage begins [s]."""
    reasons: Mapping[str, WaitReason] = field(default_factory=dict)
    """Why, by arm."""
    held: Mapping[str, float] = field(default_factory=dict)
    """How long one arm waits in the stage before it leaves, so that both meet their parts [s], by arm."""


def waiting_for_tasks(plans: Sequence[StagePlan]) -> list[dict[str, ArmStop]]:
    """Returns by stage the arms without a stop in it whose next task comes after one not yet over, with its first stop.

    Args:
        plans: all stages in order.
    """
    last = {one.task.id: k for k, plan in enumerate(plans) for one in plan.stops.values()}
    following: dict[str, ArmStop] = {}
    found: list[dict[str, ArmStop]] = []
    for k, plan in reversed(list(enumerate(plans))):
        found.append(
            {
                name: one
                for name, one in following.items()
                if name not in plan.stops
                and one.stop.action == one.task.stops[0].action
                and any(last.get(other, -1) >= k for other in one.task.after)
            }
        )
        following |= plan.stops
    return found[::-1]


def stage_waits(
    plan: StagePlan,
    arrivals: Callable[[Mapping[str, float]], dict[str, float]],
    arms: Sequence[str],
    clock: float | None,
) -> StageWaits:
    """Returns what a stage waits for.

    All wait together, so that in the stage itself everything stays as it is. Only where both arms meet parts on
    conveyors does one of them wait in the stage, and does so also where the stage is looked at by itself. What would
    come too late for its part comes too late: the planner sees it from the event.

    Args:
        plan: the stage.
        arrivals: when tools are at their targets, from the stage's begin [s], where arms are held back by so much.
        arms: names of all arms.
        clock: when the stage could begin [s]; None for a stage by itself, which has no time to wait for.
    """
    meets = {
        name: stop.stop.belt.at
        for name, stop in plan.stops.items()
        if stop.tracked is not None and stop.stop.belt is not None
    }
    opens = {
        name: stop.task.not_before
        for name, stop in plan.stops.items()
        if stop.stop.action == stop.task.stops[0].action and stop.task.not_before > (clock or 0.0)
    }
    if not meets and (clock is None or not opens):
        return StageWaits()
    held: dict[str, float] = {}
    there = arrivals(held)
    # On one path all joints move together: nobody is held back.
    if len(meets) > 1 and plan.path is None:
        for _ in range(ROUNDS):
            spare = {name: at - there[name] for name, at in meets.items()}
            least = min(spare.values())
            if max(spare.values()) - least <= ROUNDING:
                break
            held = {name: held.get(name, 0.0) + more - least for name, more in spare.items()}
            there = arrivals(held)
    if clock is None:
        return StageWaits(held=held)
    due: dict[str, tuple[float, WaitReason]] = {
        name: (opens[name] - clock - there[name], "window") for name in opens
    }
    for name, at in meets.items():
        early = at - clock - there[name]
        if name not in due or early >= due[name][0]:
            due[name] = early, "conveyor"
    wait = max(0.0, *(early for early, _ in due.values()))
    reasons: dict[str, WaitReason] = {
        name: due[name][1] if name in due and wait - due[name][0] <= ALIKE else "partner"
        for name in arms
    }
    return StageWaits(wait, reasons, held)
