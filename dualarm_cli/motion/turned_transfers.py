"""Transfers between lines on which the platform turns: retract, transfer and approach of platform and arms together.

The arms rest at their targets before the retract and after the approach, so every transfer is a problem of its own:
where the platform is at the outer ends of both lines. A pattern search over these two places compares the real times:
each line timed as one path of platform and arms, the transfer as one from state to state of all their joints, with the
best pair of ways to pass the lines' ends (`blending`), or from rest to rest. Our own.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.motion.blending import waits_for_time
from dualarm_cli.motion.line_motion import (
    groups_on_line,
    line_length,
    turned_line,
    turned_problem,
    with_turned_line,
)
from dualarm_cli.motion.stop_motion import rates_between
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers, tool_speed_of
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import Launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair, refined_pair
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.rest_to_rest import RestToRest

FIRST_SHARES = (0.0, 0.1, 0.2, 0.3)
"""Shares of the platform's way between two targets that each line takes over, from which the search starts."""
STEPS = (1.0, 0.5, 0.25)
"""Steps of the search, in what the platform does on a line from rest to rest."""
MOST_ROUNDS = 4
"""So often it goes on from a better place with the same step."""
LESS = 1e-5
"""What counts as a shorter time [s]."""


@dataclass(frozen=True)
class TurnedTransfer:
    """A transfer on whose lines the platform turns."""

    outer: tuple[float, float]
    """Where the platform is at the outer ends of the retract before and of the approach after it [rad or m]."""
    ways: tuple[Launch | None, Launch | None]
    """How platform and arms pass these ends; None: at rest."""
    time: float
    """From leaving the targets to being at the next ones, or back at the start [s]."""

    def put(
        self, drive: Drive, before: StagePlan | None, plan: StagePlan
    ) -> tuple[StagePlan | None, StagePlan]:
        """Returns both stages with this transfer between them; the first one is None where there is none.

        Raises:
            InfeasibleError: an arm cannot keep its tool on its line.
        """
        if before is not None:
            before = self._on_line(drive, before, "retract")
            plan = replace(plan, start=before.end)
        return before, self._on_line(drive, plan, "approach") if plan.stops else plan

    def _on_line(self, drive: Drive, plan: StagePlan, line: str) -> StagePlan:
        side, columns = int(line == "approach"), drive.model.platform_columns
        target = plan.platform_at(line, columns)
        outer = np.array(self.outer[side : side + 1])
        turned = with_turned_line(drive, _at_rest(plan, line), line, outer, target)
        return _passing(turned, line, self.ways[side])


def can_be_turned(plan: StagePlan, line: str) -> bool:
    """Returns whether all arms of a stage have such a line, to or from targets at which they stand.

    Whether the platform may turn on it is another question; where it may not it stands.
    """
    stops = plan.stops.values()
    return bool(stops) and all(
        isinstance(one.stop.target, PoseTarget)
        and one.stop.action not in ("give", "take")
        and one.tracked is None
        and not one.stop.moves
        and one.arm not in plan.through
        and line_length(one, line) > 0.0
        for one in stops
    )


def may_turn(drive: Drive, plan: StagePlan, line: str) -> bool:
    """Returns whether the platform may turn on a stage's lines: all stops allow it, and no cap counts an idle tool."""
    capped = drive.cap is not None and len(plan.stops) < len(drive.model.arms)
    allowed = all(one.stop.line_motion for one in plan.stops.values())
    return can_be_turned(plan, line) and allowed and not capped


def can_take_over(before: StagePlan | None, plan: StagePlan) -> bool:
    """Returns whether lines beside a transfer can be such that the platform turns on them.

    They cannot where an arm waits or makes a detour, passes its target, or stands in the second stage while it works in
    the first.

    Args:
        before: the stage before, None for none.
        plan: the stage that it leads to, or the return.
    """
    if plan.waits or plan.detours or plan.through or waits_for_time(plan):
        return False
    if plan.stops and not can_be_turned(plan, "approach"):
        return False
    if before is None:
        # Where a free start is follows from the first stage.
        return not np.array_equal(plan.start, plan.arrival)
    works_on = not plan.stops or set(before.stops) <= set(plan.stops)
    return works_on and not before.through and can_be_turned(before, "retract")


def turned_transfer(
    drive: Drive,
    before: StagePlan | None,
    plan: StagePlan,
    first: tuple[float, float] = (0.0, 0.0),
    *,
    blend: bool,
    widths: int = 0,
) -> TurnedTransfer | None:
    """Returns the quickest transfer found on whose lines the platform turns, None where there is none.

    Args:
        drive: of the job.
        before: the stage before, None for none.
        plan: the stage that it leads to, or the return.
        first: how far the platform may move on both lines to begin with, from the targets outwards [rad or m].
        blend: whether the lines' outer ends may be passed in motion.
        widths: of steps with which the ways of passing them are refined, see `refined_pair`.
    """
    if not can_take_over(before, plan):
        return None
    search = _Search.of(drive, before, plan, blend)
    return search.best(first, widths) if search.free.any() else None


@dataclass(frozen=True)
class _Line:
    """One line for one place of the platform at its outer end."""

    plan: StagePlan
    """Its stage."""
    ways: Passings
    """How its outer end can be passed, as platform and arms of its stage."""


@dataclass
class _Search:
    """The search for the two places of the platform."""

    drive: Drive
    before: StagePlan | None
    plan: StagePlan
    blend: bool
    targets: FloatArray
    """Where the platform is at the targets before and after [rad or m], shape (2,)."""
    free: FloatArray
    """By how much it may be moved on either line at most from rest to rest, the unit of steps; 0: not at all."""
    lines: dict[tuple[str, float], _Line | None]
    times: dict[tuple[float, float], float]

    @classmethod
    def of(cls, drive: Drive, before: StagePlan | None, plan: StagePlan, blend: bool) -> _Search:
        [column] = drive.model.platform_columns
        first = plan.start[column] if before is None else 0.0
        if before is not None:
            first = before.platform_at("retract", [column])[0]
        last = plan.platform_at("approach", [column])[0]
        search = cls(drive, before, plan, blend, np.array([first, last]), np.zeros(2), {}, {})
        for side, (one, line) in enumerate(((before, "retract"), (plan, "approach"))):
            if one is not None and may_turn(drive, one, line):
                search.free[side] = search.step(line)
        return search

    def step(self, line: str) -> float:
        """Returns how far the platform gets from rest to rest while a line takes as long as it does when it stands."""
        found = self.line(line, 0.0)
        if found is None:
            return 0.0
        return float(_law(self.drive, (PLATFORM,)).reachable_distance(found.ways.time[:1])[0])

    def best(self, first: tuple[float, float], widths: int) -> TurnedTransfer | None:
        """Returns the quickest transfer found, with `first` among the starts of the search, and its ways refined."""
        way = float(self.targets[1] - self.targets[0])
        movable = self.free > 0.0
        starts = [share * way * np.array([1.0, -1.0]) for share in FIRST_SHARES]
        starts = [np.where(movable, one, 0.0) for one in (*starts, np.array(first))]
        place = min(starts, key=self.time)
        for step in STEPS:
            for _ in range(MOST_ROUNDS):
                near = [place + step * self.free * np.array(by) for by in _DIRECTIONS]
                quickest = min(near, key=self.time)
                if not self.time(quickest) < self.time(place) - LESS:
                    break
                place = quickest
        return self.made(place, widths)

    def line(self, line: str, moved: float) -> _Line | None:
        """Returns a line on which the platform moves so far [rad or m] from its target outwards; None for none."""
        key = line, moved
        if key not in self.lines:
            self.lines[key] = self._line(line, moved)
        return self.lines[key]

    def _line(self, line: str, moved: float) -> _Line | None:
        drive, side = self.drive, int(line == "approach")
        plan, away = (self.before, True) if line == "retract" else (self.plan, False)
        assert plan is not None  # asked for where there is one
        target = self.targets[side : side + 1]
        limits = drive.limits.select(drive.joints(PLATFORM))
        if not limits.lower[0] <= target[0] + moved <= limits.upper[0]:
            return None
        plan = _at_rest(plan, line)
        try:
            plan = with_turned_line(drive, plan, line, target + moved, target)
            problem = turned_problem(drive, plan, line)
            rest = turned_line(drive, plan, line)[PLATFORM].duration
        except InfeasibleError:
            return None
        if self.blend:
            return _Line(plan, Passings.along(problem, rest, away=away))
        resting = Passings.none(len(problem.joints))
        return _Line(plan, replace(resting, time=np.array([rest])))

    def time(self, place: FloatArray) -> float:
        """Returns how long a transfer takes whose lines move the platform so far [s]; infinite where there is none."""
        key = float(place[0]), float(place[1])
        if key not in self.times:
            found = self._quickest(place)
            self.times[key] = np.inf if found is None else found[2]
        return self.times[key]

    def _ends(self, place: FloatArray) -> tuple[_Line | None, _Line | None] | None:
        """Returns both lines, None for one that is not there; None where one cannot be."""
        retract = approach = None
        if self.before is not None:
            retract = self.line("retract", float(place[0]))
        if self.plan.stops:
            approach = self.line("approach", float(place[1]))
        missing = (self.before is not None and retract is None) or (
            bool(self.plan.stops) and approach is None
        )
        return None if missing else (retract, approach)

    def _quickest(
        self, place: FloatArray, widths: int = 0
    ) -> tuple[Launch | None, Launch | None, float] | None:
        """Returns how the lines' ends are passed at best, and how long all takes before ways are refined [s]."""
        ends = self._ends(place)
        if ends is None:
            return None
        drive, (retract, approach) = self.drive, ends
        start = self.plan.start if retract is None else retract.plan.end
        goal = self.plan.arrival if approach is None else approach.plan.arrival
        groups = _moving(drive, start, goal, self.before, self.plan)
        names = tuple(joint for group in groups for joint in drive.joints(group))
        index = [column for group in groups for column in drive.columns[group]]
        limits = drive.limits.select(names)
        problem = TransferProblem(names, start[index], goal[index], limits)
        rest = float(_law(drive, groups).duration(goal[index] - start[index]))
        columns = {group: drive.columns[group] for group in groups}
        before, after = _spread(retract, columns), _spread(approach, columns)
        pair = quickest_pair(before, after, problem, rest)
        return *refined_pair((before, after), pair, problem, widths), pair[2]

    def made(self, place: FloatArray, widths: int) -> TurnedTransfer | None:
        """Returns a transfer whose lines move the platform so far, as it is really timed; None where there is none."""
        found, drive = self._quickest(place, widths), self.drive
        if found is None:
            return None
        first, last = (self.targets + place).tolist()
        made = TurnedTransfer((first, last), found[:2], found[2])
        try:
            before, plan = made.put(drive, self.before, self.plan)
            transfers = time_transfers(drive, plan, rates_between(drive, before, plan))
            if drive.cap is not None and tool_speed_of(drive, plan, transfers) > drive.cap:
                return None
            time = max(motion.duration for motion in transfers.motion.values())
            if before is not None:
                time += turned_line(drive, before, "retract")[PLATFORM].duration
            if plan.stops:
                time += turned_line(drive, plan, "approach")[PLATFORM].duration
        except InfeasibleError:
            return None
        return replace(made, time=time)


_DIRECTIONS = tuple((a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0) if a or b)
"""Changes of both places that the search tries."""


def _at_rest(plan: StagePlan, line: str) -> StagePlan:
    """Returns a stage whose outer ends of one line are at rest."""
    passes = {key: way for key, way in plan.passes.items() if key[1] != line}
    return replace(plan, passes=passes)


def _passing(plan: StagePlan, line: str, launch: Launch | None) -> StagePlan:
    """Returns a stage in which platform and arms pass the outer end of a line in one way."""
    if launch is None:
        return plan
    ways = {(group, line): launch for group in groups_on_line(plan)}
    return replace(plan, passes={**plan.passes, **ways})


def _moving(
    drive: Drive,
    start: FloatArray,
    goal: FloatArray,
    before: StagePlan | None,
    plan: StagePlan,
) -> list[str]:
    """Returns the groups that take part in a transfer, in the order of the drive."""
    working = {PLATFORM, *plan.stops, *(before.stops if before is not None else ())}
    return [
        group
        for group, columns in drive.columns.items()
        if group in working or not np.array_equal(start[columns], goal[columns])
    ]


def _spread(line: _Line | None, columns: Mapping[str, list[int]]) -> Passings:
    """Returns the ways of a line's platform and arms as those of more groups, whose others are at rest."""
    count = sum(len(own) for own in columns.values())
    if line is None:
        return Passings.none(count)
    first, begins = 0, {}
    for group, own in columns.items():
        begins[group] = first
        first += len(own)
    places = np.concatenate(
        [begins[group] + np.arange(len(columns[group])) for group in groups_on_line(line.plan)]
    )
    rates = np.zeros((len(line.ways.ways), 2, count))
    rates[:, :, places] = line.ways.rates
    return replace(line.ways, rates=rates, places=places)


def _law(drive: Drive, groups: tuple[str, ...] | list[str]) -> RestToRest:
    limits = drive.limits.select([joint for group in groups for joint in drive.joints(group)])
    return RestToRest(limits.velocity, limits.acceleration, limits.jerk)
