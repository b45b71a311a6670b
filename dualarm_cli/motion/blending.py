"""Blending: outer ends of lines are passed in motion.

The launches at the ends of a retract and of the approach after it are chosen with the transfer between them
(`timing/line_ends`). Motion before the retract and after the approach does not change, because the arm rests at its
targets. Therefore every transfer of every arm is an independent problem. The method is ours.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.motion.stop_motion import (
    joints_along,
    line_key,
    rates_between,
    remember_line,
    timed_line,
    transfers_in_motion,
)
from dualarm_cli.motion.transfers import (
    PLATFORM,
    Drive,
    Key,
    time_transfers,
    within_tool_speed,
)
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import Launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair, refined_pair
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

MIN_GAIN = 1e-4
"""Smallest gain by passing a line's end in motion [s]."""
POSITION_MARGINS = 0.0, 0.01
"""Margins to position limits that are tried in order [rad].

Rates at the ends of lines are estimates: a transfer that keeps the limits with them may exceed them with exact rates.
"""


Launches = Mapping[tuple[int, str], tuple[Launch | None, Launch | None]]
"""Launches at the retract before and the approach after a transfer; None at rest.

Keys are the stage at the transfer's end and the arm.
"""


def passing_launches(
    drive: Drive,
    plans: Sequence[StagePlan],
    stopping: Collection[tuple[int, str]] = (),
    widths: int = 0,
) -> Launches:
    """Choose the launches at the outer ends of lines, for each transfer separately.

    The arm stops next to waits and detours, when it gives a part, and next to conveyor parts.

    Args:
        drive: of the job.
        plans: stages of the job, with all stops.
        stopping: transfers that stay at rest, by the stage at their end and the arm.
        widths: number of step widths of the refinement, see `refined_pair`.
    """
    transfers = [
        (k, name)
        for k, plan in enumerate(plans)
        for name in drive.model.arms
        if (k, name) not in stopping and name not in plan.waits and name not in plan.detours
    ]
    keys = {(k, name): _transfer_key(drive, plans, k, name, widths) for k, name in transfers}
    cached = drive.cache.launches
    missing = [transfer for transfer in transfers if keys[transfer] not in cached]

    def of(batch: Sequence[tuple[int, str]]) -> list[_Passed | None]:
        return [_passed(drive, plans, k, name, widths) for k, name in batch]

    # A few transfers take no longer than the start of a second process.
    passed = dict(zip(missing, map_halves(of, missing, 24), strict=True))
    launches = {}
    for k, name in transfers:
        key, blended = keys[k, name], passed.get((k, name))
        pair = None if blended is None else blended.launches
        if key is not None:
            pair = cached.setdefault(key, pair)
        if pair is not None:
            launches[k, name] = pair
        if blended is None:
            continue
        drive.cache.moving.update(blended.transfers)
        for at, line, trajectory in blended.lines:
            launch = blended.launches[line == "approach"]
            assert launch is not None  # only lines that are passed in motion are listed
            plan = _with_pass(plans[at], name, line, launch)
            remember_line(drive, plan, plan.stops[name], line, trajectory)
    return launches


@dataclass(frozen=True)
class _Passed:
    """Launches at the lines around one transfer of an arm, with timed motions."""

    launches: tuple[Launch | None, Launch | None]
    """Launches of the retract before and the approach after it; None at rest."""
    lines: tuple[tuple[int, str, Trajectory], ...]
    """Stage, name and motion of the lines that are passed in motion."""
    transfers: Mapping[Key, Trajectory | None]
    """Transfers in motion that were timed for them, see `MotionCache`."""


def _transfer_key(
    drive: Drive, plans: Sequence[StagePlan], k: int, name: str, widths: int
) -> Key | None:
    """Build the key of the launches around a transfer.

    None where more than the transfer and the lines next to it decides them.
    """
    before, plan = plans[k - 1] if k else None, plans[k]
    # In a return all arms arrive together; a tool's speed depends on the platform as well.
    if (
        not plan.stops
        or drive.to(plan).caps
        or any(
            at.through or giver_and_taker(at.stops) is not None or waits_for_time(at)
            for at in (plan, *([] if before is None else [before]))
        )
    ):
        return None
    index, model = drive.model.arms[name].columns, drive.model
    lines = ((before, "retract"), (plan, "approach"))
    return (
        widths,
        name,
        drive.to(plan).care,
        platform_time(drive, before, plan),
        plan.start[index].tobytes(),
        plan.arrival[index].tobytes(),
        *(
            None
            if at is None or name not in at.stops
            else line_key(model, at, at.stops[name], line)
            for at, line in lines
        ),
    )


def _passed(
    drive: Drive, plans: Sequence[StagePlan], k: int, name: str, widths: int
) -> _Passed | None:
    """Choose the launches around an arm's transfer to a stage; None at rest."""
    before, plan = plans[k - 1] if k else None, plans[k]
    timed = len(drive.cache.moving)
    candidates = _blends(drive, before, plan, name, platform_time(drive, before, plan), widths)
    launches = next(
        (pair for pair in candidates if _is_feasible(drive, before, plan, name, pair)), None
    )
    if launches is None:
        return None
    lines = []
    for at, line, launch in ((k - 1, "retract", launches[0]), (k, "approach", launches[1])):
        if launch is not None:
            passing = _with_pass(plans[at], name, line, launch)
            lines.append((at, line, timed_line(drive, passing, passing.stops[name], line)))
    transfers = dict(islice(drive.cache.moving.items(), timed, None))
    return _Passed(launches, tuple(lines), transfers)


def with_launches(plans: Sequence[StagePlan], launches: Launches) -> list[StagePlan]:
    """Build stages whose lines are passed with given launches."""
    changed = list(plans)
    for (k, name), (retract, approach) in launches.items():
        if retract is not None:
            changed[k - 1] = _with_pass(changed[k - 1], name, "retract", retract)
        if approach is not None:
            changed[k] = _with_pass(changed[k], name, "approach", approach)
    return changed


def _with_pass(plan: StagePlan, name: str, line: str, launch: Launch) -> StagePlan:
    return replace(plan, passes={**plan.passes, (name, line): launch})


def platform_time(drive: Drive, before: StagePlan | None, plan: StagePlan) -> float:
    """Compute the time of the platform's transfer to a stage [s]."""
    index = drive.columns.get(PLATFORM)
    if index is None:
        return 0.0
    limits = drive.to(plan).group_limits[PLATFORM]
    start, goal = plan.start[index], plan.arrival[index]
    at_rest = np.zeros((2, len(index)))
    leaving = at_rest if before is None else before.through.get(PLATFORM, at_rest)
    arriving = plan.through.get(PLATFORM, at_rest)
    if leaving.any() or arriving.any():
        problem = TransferProblem(limits.joints, start, goal, limits)
        return MovingTransfer(problem).duration(leaving, arriving)
    return float(limits.law.duration(goal - start))


def _ends_stage(plan: StagePlan, name: str) -> bool:
    """Check whether a stage can end with an arm's retract; in a hand-over, the giver's."""
    pair = giver_and_taker(plan.stops)
    return pair is None or pair[0].arm == name


def _meets_in_motion(plan: StagePlan) -> bool:
    """Check whether arms can reach their targets in motion.

    In a hand-over this requires that no arm is delayed.
    """
    return giver_and_taker(plan.stops) is None or not (plan.waits or plan.detours)


def waits_for_time(plan: StagePlan) -> bool:
    """Check whether all arms may have to wait before a stage begins."""
    return any(
        arm_stop.stop.belt is not None or arm_stop.task.not_before > 0.0
        for arm_stop in plan.stops.values()
    )


def _blends(
    drive: Drive,
    before: StagePlan | None,
    plan: StagePlan,
    name: str,
    platform: float,
    widths: int,
) -> Iterator[tuple[Launch | None, Launch | None]]:
    """Yield blends of a transfer with its lines, with increasing margin, the refined ones first.

    Each is a pair of launches, at the end of the retract and at the start of the approach. Pairs that are not faster
    than stopping at both are left out.
    """
    arm = drive.model.arms[name]
    index, limits = arm.columns, drive.to(plan).group_limits[name]
    start, goal = plan.start[index], plan.arrival[index]
    retract, approach = adjacent_passings(drive, before, plan, name)
    slower = retract.within(limits)
    # The refinement includes the limits of the line alone.
    retract, widths = slower, widths if slower is retract else 0
    platform = max(platform, _giver_time(drive, plan, name))
    if len(retract.launches) == len(approach.launches) == 1 or np.array_equal(start, goal):
        return
    problem = TransferProblem(limits.joints, start, goal, limits, platform)
    law = limits.law
    at_rest = max(platform, float(law.duration(goal - start)))
    if retract.rates[0].any() or approach.rates[0].any():
        at_rest = MovingTransfer(problem).duration(retract.rates[0], approach.rates[0])
    for margin in POSITION_MARGINS:
        pair = quickest_pair(retract, approach, problem, at_rest, margin)
        if pair[2] > float(retract.time[0] + at_rest + approach.time[0]) - MIN_GAIN:
            return
        # A coarser pair may keep limits that the finest estimate exceeds, and is faster than one with a margin.
        for fewer in (widths, *range(min(widths, 2) - 1, -1, -1)):
            yield refined_pair((retract, approach), pair, problem, fewer, margin)


def _giver_time(drive: Drive, plan: StagePlan, name: str) -> float:
    """Compute the time at which the giving arm has the part ready [s]; 0 without one."""
    pair = giver_and_taker(plan.stops)
    if pair is None or pair[1].arm != name:
        return 0.0
    index = drive.columns[pair[0].arm]
    limits = drive.to(plan).group_limits[pair[0].arm]
    law = limits.law
    return float(law.duration(plan.arrival[index] - plan.start[index]))


def passings_of(drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str) -> Passings:
    """Compute the launches at the outer end of a stop's `approach` or `retract`."""
    drive = drive.along(arm_stop, line)
    limits, cap = drive.group_limits[arm_stop.arm], drive.caps.get(arm_stop.arm)
    q, length = joints_along(drive, plan, arm_stop, line)
    away = line == "retract"
    problem = LineProblem(limits.joints, q if away else q[::-1], length, limits, cap)
    at_rest = timed_line(drive, replace(plan, passes={}), arm_stop, line).duration
    return Passings.along(problem, at_rest, away=away)


def adjacent_passings(
    drive: Drive, before: StagePlan | None, plan: StagePlan, name: str
) -> tuple[Passings, Passings]:
    """Compute the passings of the lines or targets before and after a transfer."""
    joints = len(drive.columns[name])
    retract = approach = Passings.none(joints)
    leaving = None if before is None else before.through.get(name)
    arriving = plan.through.get(name)
    retract = Passings.only(leaving) if leaving is not None else retract
    approach = Passings.only(arriving) if arriving is not None else approach
    last = before.stops.get(name) if before is not None else None
    if (
        before is not None
        and last is not None
        and last.stop.retract > 0.0
        and last.tracked is None
        and _ends_stage(before, name)
        and not waits_for_time(plan)
    ):
        retract = passings_of(drive, before, last, "retract")
    following = plan.stops.get(name)
    if (
        following is not None
        and following.stop.approach > 0.0
        and following.tracked is None
        and _meets_in_motion(plan)
    ):
        approach = passings_of(drive, plan, following, "approach")
    return retract, approach


def _is_feasible(
    drive: Drive,
    before: StagePlan | None,
    plan: StagePlan,
    name: str,
    launches: tuple[Launch | None, Launch | None],
) -> bool:
    """Check whether lines and transfer can be timed as estimated, within the tool's speed."""
    retract, approach = launches
    if before is not None and retract is not None:
        before = _with_pass(before, name, "retract", retract)
    if approach is not None:
        plan = _with_pass(plan, name, "approach", approach)
    try:
        rates, drive = rates_between(drive, before, plan), drive.to(plan)
        if not drive.caps and not plan.through and giver_and_taker(plan.stops) is None:
            time_transfers(drive, plan, rates, resting=False)
            return True
        transfers = transfers_in_motion(drive, plan, rates)
    except InfeasibleError:
        return False
    return within_tool_speed(drive, plan, transfers)
