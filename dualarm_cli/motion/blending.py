"""Blending of lines with transfers: outer ends of lines are passed in motion.

The launches at the ends of a retract and of the approach after it are chosen with the transfer between them
(`timing/line_ends`). What comes before a retract and after an approach does not change: the arm rests at its targets.
So every transfer of every arm is a problem of its own. Our own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import islice

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.stop_motion import (
    joints_along,
    rates_between,
    remember_line,
    timed_line,
    transfers_in_motion,
)
from dualarm_cli.motion.transfers import PLATFORM, Drive, Key, time_transfers, tool_speed_of
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import Launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair, refined_pair
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

WORTH = 1e-4
"""What is gained by passing a line's end in motion that is worth it [s]."""
ROOMS = 0.0, 0.01
"""What transfers keep free of limits of position [rad], one after the other: rates at lines' ends are estimates, and
what was just within the limits with them may not be with exact ones."""


Ways = Mapping[tuple[int, str], tuple[Launch | None, Launch | None]]
"""How an arm passes the ends of the retract before and of the approach after a transfer, by the stage that the transfer
leads to and arm; None: it stops there."""


def passing_ways(
    drive: Drive,
    plans: Sequence[StagePlan],
    stopping: Collection[tuple[int, str]] = (),
    widths: int = 0,
) -> Ways:
    """Returns the ways in which lines' outer ends are passed, each transfer by itself.

    At rest remain what waits there or is bent, the giving arm of a hand-over, and parts on conveyors.

    Args:
        drive: of the job.
        plans: its stages, with all stops.
        stopping: transfers between stops all the same, by the stage that they lead to and arm.
        widths: of steps with which ways are refined, see `refined_pair`.
    """

    def of(stages: Sequence[int]) -> list[dict[str, _Passed]]:
        return [_passed(drive, plans, k, stopping, widths) for k in stages]

    found = {}
    for k, passed in enumerate(map_halves(of, range(len(plans)))):
        for name, one in passed.items():
            found[k, name] = one.ways
            drive.cache.moving.update(one.transfers)
            for at, line, trajectory in one.lines:
                launch = one.ways[line == "approach"]
                assert launch is not None  # only lines that are passed in motion are listed
                plan = _with_pass(plans[at], name, line, launch)
                remember_line(drive, plan, plan.stops[name], line, trajectory)
    return found


@dataclass(frozen=True)
class _Passed:
    """How an arm passes the ends of the lines about one transfer."""

    ways: tuple[Launch | None, Launch | None]
    """Of the retract before it and of the approach after it; None: it stops there."""
    lines: tuple[tuple[int, str, Trajectory], ...]
    """Stage, name and motion of those that are passed in motion."""
    transfers: Mapping[Key, Trajectory | None]
    """What was timed in motion on the way to them, see `MotionCache`."""


def _passed(
    drive: Drive,
    plans: Sequence[StagePlan],
    k: int,
    stopping: Collection[tuple[int, str]],
    widths: int,
) -> dict[str, _Passed]:
    """Returns how arms that need not stop pass the ends of lines about the transfers to a stage, by arm."""
    before, plan, found = plans[k - 1] if k else None, plans[k], {}
    platform = platform_time(drive, before, plan)
    for name in drive.model.arms:
        if (k, name) in stopping or name in plan.waits or name in plan.detours:
            continue
        timed = len(drive.cache.moving)
        tried = _ways(drive, before, plan, name, platform, widths)
        ways = next((one for one in tried if _holds(drive, before, plan, name, one)), None)
        if ways is None:
            continue
        lines = []
        for at, line, launch in ((k - 1, "retract", ways[0]), (k, "approach", ways[1])):
            if launch is not None:
                passing = _with_pass(plans[at], name, line, launch)
                lines.append((at, line, timed_line(drive, passing, passing.stops[name], line)))
        transfers = dict(islice(drive.cache.moving.items(), timed, None))
        found[name] = _Passed(ways, tuple(lines), transfers)
    return found


def with_ways(plans: Sequence[StagePlan], ways: Ways) -> list[StagePlan]:
    """Returns stages whose lines' outer ends are passed in given ways."""
    found = list(plans)
    for (k, name), (retract, approach) in ways.items():
        if retract is not None:
            found[k - 1] = _with_pass(found[k - 1], name, "retract", retract)
        if approach is not None:
            found[k] = _with_pass(found[k], name, "approach", approach)
    return found


def _with_pass(plan: StagePlan, name: str, line: str, launch: Launch) -> StagePlan:
    return replace(plan, passes={**plan.passes, (name, line): launch})


def platform_time(drive: Drive, before: StagePlan | None, plan: StagePlan) -> float:
    """Returns how long the platform takes [s], as it leaves the stage before and arrives."""
    index = drive.columns.get(PLATFORM)
    if index is None:
        return 0.0
    limits = drive.own_limits[PLATFORM]
    start, goal = plan.start[index], plan.arrival[index]
    rest = np.zeros((2, len(index)))
    leaving = rest if before is None else before.through.get(PLATFORM, rest)
    arriving = plan.through.get(PLATFORM, rest)
    if leaving.any() or arriving.any():
        problem = TransferProblem(limits.joints, start, goal, limits)
        return MovingTransfer(problem).duration(leaving, arriving)
    return float(limits.law.duration(goal - start))


def _ends_stage(plan: StagePlan, name: str) -> bool:
    """Returns whether a stage can end as an arm's retract does: in a hand-over the giving arm's is the last."""
    pair = giver_and_taker(plan.stops)
    return pair is None or pair[0].arm == name


def _meets_in_motion(plan: StagePlan) -> bool:
    """Returns whether an arm can come to a target in motion: to a hand-over where nothing holds either arm up."""
    return giver_and_taker(plan.stops) is None or not (plan.waits or plan.detours)


def waits_for_time(plan: StagePlan) -> bool:
    """Returns whether all may have to wait before a stage begins."""
    return any(
        one.stop.belt is not None or one.task.not_before > 0.0 for one in plan.stops.values()
    )


def _ways(
    drive: Drive,
    before: StagePlan | None,
    plan: StagePlan,
    name: str,
    platform: float,
    widths: int,
) -> Iterator[tuple[Launch | None, Launch | None]]:
    """Yield the blends of a transfer with its lines, with increasing room.

    Each is a pair: the launch at the end of the retract and that at the begin of the approach. The iteration ends as
    soon as no pair is faster than stopping at both.
    """
    arm = drive.model.arms[name]
    index, limits = arm.columns, drive.own_limits[name]
    start, goal = plan.start[index], plan.arrival[index]
    retract, approach = passings_beside(drive, before, plan, name)
    platform = max(platform, _giver_time(drive, plan, name))
    if len(retract.ways) == len(approach.ways) == 1 or np.array_equal(start, goal):
        return
    problem = TransferProblem(limits.joints, start, goal, limits, platform)
    law = limits.law
    rest = max(platform, float(law.duration(goal - start)))
    if retract.rates[0].any() or approach.rates[0].any():
        rest = MovingTransfer(problem).duration(retract.rates[0], approach.rates[0])
    for room in ROOMS:
        i, j, time = quickest_pair(retract, approach, problem, rest, room)
        if time > float(retract.time[0] + rest + approach.time[0]) - WORTH:
            return
        yield refined_pair((retract, approach), (i, j, time), problem, widths, room)


def _giver_time(drive: Drive, plan: StagePlan, name: str) -> float:
    """Returns how long the arm that gives a part to this one takes from rest to where it gives it [s], else 0."""
    pair = giver_and_taker(plan.stops)
    if pair is None or pair[1].arm != name:
        return 0.0
    index = drive.columns[pair[0].arm]
    limits = drive.own_limits[pair[0].arm]
    law = limits.law
    return float(law.duration(plan.arrival[index] - plan.start[index]))


def passings_of(drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str) -> Passings:
    """Returns the ways in which the outer end of a stop's `approach` or `retract` is passed."""
    own = drive.own_limits[arm_stop.arm]
    q, length = joints_along(drive, plan, arm_stop, line)
    away = line == "retract"
    problem = LineProblem(own.joints, q if away else q[::-1], length, own, drive.cap)
    rest = timed_line(drive, replace(plan, passes={}), arm_stop, line).duration
    return Passings.along(problem, rest, away=away)


def passings_beside(
    drive: Drive, before: StagePlan | None, plan: StagePlan, name: str
) -> tuple[Passings, Passings]:
    """Returns how an arm can pass the ends of the lines, or targets, before and after its transfer."""
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


def _holds(
    drive: Drive,
    before: StagePlan | None,
    plan: StagePlan,
    name: str,
    ways: tuple[Launch | None, Launch | None],
) -> bool:
    """Returns whether lines and transfer of an arm can be timed as estimated, within the tool's speed."""
    retract, approach = ways
    if before is not None and retract is not None:
        before = _with_pass(before, name, "retract", retract)
    if approach is not None:
        plan = _with_pass(plan, name, "approach", approach)
    try:
        rates = rates_between(drive, before, plan)
        if drive.cap is None and not plan.through and giver_and_taker(plan.stops) is None:
            time_transfers(drive, plan, rates, resting=False)
            return True
        transfers = transfers_in_motion(drive, plan, rates)
    except InfeasibleError:
        return False
    return drive.cap is None or tool_speed_of(drive, plan, transfers) <= drive.cap
