"""What is said of parts on conveyors that cannot be met."""

from __future__ import annotations

from collections.abc import Iterable

from dualarm_cli.errors import InfeasibleError, millimetres
from dualarm_cli.model.conveyor import OnBelt
from dualarm_cli.planning.stage_plan import ArmStop


def too_late(arm_stop: ArmStop, time: float, late: float) -> str:
    """Returns that a part is beyond its window at a time at which the arm can be there at the earliest.

    Args:
        arm_stop: the stop.
        time: when the arm can be there [s].
        late: how much of that is to keep clear of the other arm [s].
    """
    belt, stop = _belt(arm_stop), arm_stop.stop
    gone = belt.gone(time) - belt.within
    why = f" ({late:.3f} s of it to keep clear)" if late > 0.0 else ""
    return (
        f"{stop.place}: task '{arm_stop.task.id}': the {arm_stop.arm} arm cannot be at the {stop.action} before "
        f"{time:.3f} s{why}, when it is {millimetres(gone)} beyond what 'within' allows: {_window(belt)}; what helps: "
        "a later 'passes', a longer 'within', a slower conveyor, another arm or order (arm: any, order: optimise), or "
        "less before it"
    )


def unfollowed(arm_stop: ArmStop, time: float, error: InfeasibleError) -> str:
    """Returns that no posture was found that follows a part from a time [s] on, and why the decided one does not."""
    belt, stop = _belt(arm_stop), arm_stop.stop
    return (
        f"{stop.place}: task '{arm_stop.task.id}': no way was found for the {arm_stop.arm} arm to follow the "
        f"{stop.action} from {time:.3f} s on: {error}; {_window(belt)}; what helps: a 'passes' pose and 'within' "
        "that leave room before and behind it, a slower conveyor, a shorter approach, retract or dwell, another arm"
    )


def no_time(stops: Iterable[ArmStop]) -> str:
    """Returns that no times were found at which the arms of a stage meet their parts."""
    moving = [stop for stop in stops if stop.stop.belt is not None]
    which = " and ".join(f"'{stop.task.id}' ({stop.stop.action})" for stop in moving)
    return (
        f"{moving[0].stop.place}: no times were found at which the arms meet the parts of {which}: "
        f"{'; '.join(_window(_belt(stop)) for stop in moving)}; what helps: a slower conveyor, or parts that do not "
        "come at the same time for both arms"
    )


def _window(belt: OnBelt) -> str:
    return (
        f"conveyor '{belt.conveyor.name}' ({belt.conveyor.speed:g} m/s) passes at {belt.passes:g} s and is "
        f"{belt.within:g} m on at {belt.last:.3f} s"
    )


def _belt(arm_stop: ArmStop) -> OnBelt:
    belt = arm_stop.stop.belt
    assert belt is not None  # callers have looked
    return belt
