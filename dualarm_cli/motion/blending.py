"""Where arms need not stop: lines whose outer ends are passed in motion, chosen transfer by transfer.

A retract, the transfer after it and the approach after that take R + X + A. Each line has a family of ways to pass its
outer end (`timing/launch`), which fix the state of motion there; the transfer between two such states is ruckig's.
The pair of ways with the least R + X + A is found by a pattern search over both families. What comes before a retract
and after an approach does not change: the arm rests at its targets. So every transfer of every arm is a problem of its
own. Our own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from dualarm_cli.beside import halves
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.stop_motion import (
    joints_along,
    rates_between,
    remember_line,
    timed_line,
    transfers_in_motion,
)
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers, tool_speed_of
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.timing.launch import CUTS, PROFILES, Launch, launches
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.rest_to_rest import RestToRest
from dualarm_cli.timing.ruckig_ import MovingTransfer

MIDDLE = 2, 5
"""A profile and a cut, as indices, that are quick under jerk limits."""
EVEN = 8, 5
"""Those that are quick without."""
REST = 0, len(CUTS)
"""What stands for rest: the last cut, after the whole profile."""
LATE = (0, 9), (8, 9)
"""Those that leave the line slowly, where limits of position are near, under jerk limits and without."""
STARTS = tuple(
    pair
    for quick, slow in zip((MIDDLE, EVEN), LATE, strict=True)
    for pair in ((quick, quick), (slow, slow), (quick, REST), (REST, quick))
)
"""Pairs from whose best one the search for a pair begins, if rest at both lines is not better."""
STEPS = (2, 4), (1, 2), (1, 1)
"""Steps of that search through PROFILES and CUTS, one width after the other."""
LESS = 1e-9
"""What counts as a shorter time [s]."""
WORTH = 1e-4
"""What is gained by passing a line's end in motion that is worth it [s]."""
ROOMS = 0.0, 0.01
"""What transfers keep free of limits of position [rad], one after the other: rates at lines' ends are estimates, and
what was just within the limits with them may not be with exact ones."""


@dataclass(frozen=True)
class Passings:
    """One line: how long it takes and in which state its outer end is passed; the first is at rest."""

    ways: tuple[Launch | None, ...]
    """What each way is."""
    time: FloatArray
    """How long the line takes [s], shape (g,)."""
    rates: FloatArray
    """Velocities and accelerations at the outer end, in the direction of motion, shape (g, 2, n)."""

    def index(self, profile: int, cut: int) -> int:
        """Returns the way with one of the PROFILES and CUTS; with a cut beyond them, or without a line, rest."""
        return 0 if cut >= len(CUTS) or len(self.ways) == 1 else 1 + profile * len(CUTS) + cut

    @classmethod
    def none(cls, joints: int) -> Passings:
        """Returns those of no line: rest."""
        return cls((None,), np.zeros(1), np.zeros((1, 2, joints)))

    @classmethod
    def only(cls, rates: FloatArray) -> Passings:
        """Returns those of a target that is passed in one state, shape (2, n)."""
        return cls((None,), np.zeros(1), rates[None])

    @classmethod
    def of(cls, drive: Drive, plan: StagePlan, arm_stop: ArmStop, line: str) -> Passings:
        """Returns those of a stop's `approach` or `retract`."""
        own = drive.own_limits[arm_stop.arm]
        q, length = joints_along(drive, plan, arm_stop, line)
        away = line == "retract"
        problem = LineProblem(own.joints, q if away else q[::-1], length, own, drive.cap)
        rest = timed_line(drive, replace(plan, passes={}), arm_stop, line).duration
        return cls.along(problem, rest, away=away)

    @classmethod
    def along(cls, problem: LineProblem, rest: float, *, away: bool) -> Passings:
        """Returns those of a line that is given from its target outwards.

        Args:
            problem: the line.
            rest: how long it takes from rest to rest [s].
            away: whether the tool leaves the target on it; else it comes to it.
        """
        found = launches(problem)
        velocity = found.velocity if away else -found.velocity
        rates = np.stack([velocity, found.acceleration], axis=1)
        return cls(
            (None, *found.ways),
            np.append(rest, found.time),
            np.concatenate([np.zeros((1, *rates.shape[1:])), rates]),
        )


Place = tuple[int, int]
"""A profile and a cut, as indices."""


def quickest_pair(
    before: Passings, after: Passings, problem: TransferProblem, rest: float, room: float = 0.0
) -> tuple[int, int, float]:
    """Returns which ways of two lines go best with the transfer between them, and how long all three take [s].

    A pattern search: from the best of a few pairs to a better neighbour, profile and cut of one line or the cuts of
    both changed, until there is none. Never slower than from rest to rest; no optimality is claimed.

    Args:
        before: of the retract.
        after: of the approach.
        problem: the transfer; its rates do not count.
        rest: how long it takes from rest to rest [s].
        room: what it keeps free of limits of position [rad].
    """
    transfer, platform = MovingTransfer(problem, room), problem.minimum_duration
    least = {(0, 0): float(before.time[0] + rest + after.time[0])}

    def time(pair: tuple[Place, Place], most: float) -> float:
        i, j = before.index(*pair[0]), after.index(*pair[1])
        if (i, j) not in least:
            lines = float(before.time[i] + after.time[j])
            if lines + platform >= most:
                return np.inf
            # What takes longer than the best pair known is not looked at again: that one only becomes better.
            least[i, j] = lines + transfer.duration(before.rates[i], after.rates[j], most - lines)
        return least[i, j]

    best, pair = least[0, 0], (REST, REST)
    for start in STARTS:
        if (found := time(start, best)) < best:
            best, pair = found, start
    for width in STEPS:
        moved = True
        while moved:
            moved = False
            for one, other in _moves(*width):
                tried = _moved(pair[0], one), _moved(pair[1], other)
                if (found := time(tried, best)) < best - LESS:
                    best, pair, moved = found, tried, True
    return before.index(*pair[0]), after.index(*pair[1]), best


@cache
def _moves(profiles: int, cuts: int) -> tuple[tuple[Place, Place], ...]:
    """Returns the changes of a pair that are tried, for steps through profiles and cuts."""
    still, ways = (0, 0), (-1, 1)
    single = [(0, k * cuts) for k in ways]
    both = [(p * profiles, k * cuts) for k in (0, *ways) for p in ways]
    return (
        *((one, still) for one in single),
        *((still, one) for one in single),
        *((one, other) for one in single for other in single),
        *((one, still) for one in both),
        *((still, one) for one in both),
    )


@cache
def _moved(place: Place, by: Place) -> Place:
    profile, cut = place[0] + by[0], place[1] + by[1]
    return min(max(profile, 0), len(PROFILES) - 1), min(max(cut, 0), len(CUTS))


Ways = Mapping[tuple[int, str], tuple[Launch | None, Launch | None]]
"""How an arm passes the ends of the retract before and of the approach after a transfer, by the stage that the transfer
leads to and arm; None: it stops there."""


def passing_ways(
    drive: Drive, plans: Sequence[StagePlan], stopping: Collection[tuple[int, str]] = ()
) -> Ways:
    """Returns the ways in which lines' outer ends are passed, each transfer by itself.

    At rest remain what waits there or is bent, the giving arm of a hand-over, and parts on conveyors.

    Args:
        drive: of the job.
        plans: its stages, with all stops.
        stopping: transfers between stops all the same, by the stage that they lead to and arm.
    """

    def of(stages: Sequence[int]) -> list[dict[str, _Passed]]:
        return [_passed(drive, plans, k, stopping) for k in stages]

    found = {}
    for k, passed in enumerate(halves(of, range(len(plans)))):
        for name, one in passed.items():
            found[k, name] = one.ways
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


def _passed(
    drive: Drive, plans: Sequence[StagePlan], k: int, stopping: Collection[tuple[int, str]]
) -> dict[str, _Passed]:
    """Returns how arms that need not stop pass the ends of lines about the transfers to a stage, by arm."""
    before, plan, found = plans[k - 1] if k else None, plans[k], {}
    platform = platform_time(drive, before, plan)
    for name in drive.model.arms:
        if (k, name) in stopping or name in plan.waits or name in plan.detours:
            continue
        tried = (_ways(drive, before, plan, name, platform, room) for room in ROOMS)
        ways = next(
            (one for one in tried if not one or _holds(drive, before, plan, name, one)), None
        )
        if ways is None:
            continue
        lines = []
        for at, line, launch in ((k - 1, "retract", ways[0]), (k, "approach", ways[1])):
            if launch is not None:
                passing = _with_pass(plans[at], name, line, launch)
                timed = timed_line(drive, passing, passing.stops[name], line)
                lines.append((at, line, timed))
        found[name] = _Passed(ways, tuple(lines))
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
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    return float(law.duration(goal - start))


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
    room: float = 0.0,
) -> tuple[Launch | None, Launch | None] | None:
    """Returns how an arm passes the ends of the lines about its transfer, None where it stops at both."""
    arm = drive.model.arms[name]
    index, limits = arm.columns, drive.own_limits[name]
    start, goal = plan.start[index], plan.arrival[index]
    retract, approach = passings_beside(drive, before, plan, name)
    platform = max(platform, _giver_time(drive, plan, name))
    if len(retract.ways) == len(approach.ways) == 1 or np.array_equal(start, goal):
        return None
    problem = TransferProblem(limits.joints, start, goal, limits, platform)
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    rest = max(platform, float(law.duration(goal - start)))
    if retract.rates[0].any() or approach.rates[0].any():
        rest = MovingTransfer(problem).duration(retract.rates[0], approach.rates[0])
    i, j, time = quickest_pair(retract, approach, problem, rest, room)
    if time > float(retract.time[0] + rest + approach.time[0]) - WORTH:
        return None
    return retract.ways[i], approach.ways[j]


def _giver_time(drive: Drive, plan: StagePlan, name: str) -> float:
    """Returns how long the arm that gives a part to this one takes from rest to where it gives it [s], else 0."""
    pair = giver_and_taker(plan.stops)
    if pair is None or pair[1].arm != name:
        return 0.0
    index = drive.columns[pair[0].arm]
    limits = drive.own_limits[pair[0].arm]
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    return float(law.duration(plan.arrival[index] - plan.start[index]))


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
        retract = Passings.of(drive, before, last, "retract")
    following = plan.stops.get(name)
    if (
        following is not None
        and following.stop.approach > 0.0
        and following.tracked is None
        and _meets_in_motion(plan)
    ):
        approach = Passings.of(drive, plan, following, "approach")
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
