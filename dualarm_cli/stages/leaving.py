"""Leaving stops otherwise than they were come to: what changes while tools stand, and while they are on lines.

Every stop gets a second set of decisions, with which its retract begins, and both lines a platform angle of their own
at their outer ends. All are improved together by successive linear programs over the whole sequence: joints at both
ends of all transfers, transfer times and line times are linear in all decisions nearby, as in `search/linear_steps`,
and what changes at a stop or on a line is bounded by what each joint can do from rest to rest in the time that is
there. Local, as the plan that it starts from; rest to rest, without collisions:
whether a real plan becomes shorter is for the caller to find out. Our own.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.linear_programs import least_cost
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.postures import StopPosture
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import CandidatePostures
from dualarm_cli.stages.plans.problem import Decisions, SequenceProblem
from dualarm_cli.stages.plans.source import anchored
from dualarm_cli.stages.plans.stops import StopTable
from dualarm_cli.stages.plans.times import (
    TransferChain,
    platform_times,
    start_angle,
    start_joints,
)
from dualarm_cli.stages.search.linear_steps import LIMIT_MARGIN, NEAR_CRITICAL, Rows, timed_slopes
from dualarm_cli.stages.search.variables import Slopes, Variables, shifted
from dualarm_cli.stages.sequence import decisions_of, stage_plans
from dualarm_cli.stages.turned_lines import LINES, turned_postures, turned_slopes
from dualarm_cli.timing.stage_length import stage_length

PATH_FACTOR = 1.08
"""Time of a motion in which the tool stands over the rest-to-rest time of what its joints move, roughly."""
ROUNDS = 40
"""So many linear programs are solved at most."""
FIRST_RADIUS, SMALLEST_RADIUS = 0.1, 3e-4
"""How far a variable may move in the first round, and below which the search ends [rad]."""
STEPS = (1.0, 0.5, 0.2)
"""Shares of a step that are tried."""
SHRINK, LITTLE = 0.7, 3e-4
"""How the radius changes after a round that gained less than this share of the cycle time."""


@dataclass(frozen=True)
class Leaving:
    """A plan whose stops may be left otherwise than they were come to."""

    arriving: Decisions
    """With which arms come to their targets."""
    leaving: Decisions
    """With which they leave them: targets, yaws and branches are the same."""
    outer: FloatArray
    """How far the platform is, at the outer ends of approach and retract, from where it is at the targets [rad or m],
    shape (n, 2)."""

    def put(self, rows: IntArray, other: Leaving) -> Leaving:
        """Returns this plan with some stages as another one has them."""
        arriving, outer = self.arriving.put(rows, other.arriving), np.array(self.outer)
        outer[rows] = other.outer[rows]
        return Leaving(arriving, self.leaving.put(rows, other.leaving), outer)

    def nearer(self, share: float) -> Leaving:
        """Returns a plan in which only a share of this changes at stops, which are come to as here."""
        arms = []
        for one, other in zip(self.arriving.arms, self.leaving.arms, strict=True):
            values = {
                name: getattr(one, name) + share * (getattr(other, name) - getattr(one, name))
                for name in ("psi_target", "psi_approach", "psi_retract", "near")
            }
            arms.append(replace(other, **values))
        come, gone = self.arriving.angle, self.leaving.angle
        left = Decisions(come + share * (gone - come), tuple(arms))
        return Leaving(self.arriving, left, self.outer)

    @property
    def changes(self) -> BoolArray:
        """In which stages anything moves while tools stand, shape (n,)."""
        changed = self.arriving.angle != self.leaving.angle
        for one, other in zip(self.arriving.arms, self.leaving.arms, strict=True):
            changed = changed | (one.psi_target != other.psi_target)
            changed |= (one.near != other.near).any(axis=1)
        return changed


@dataclass(frozen=True)
class MotionRoom:
    """How long platform and arms may move while tools stand, and the platform while they are on lines; 0: never."""

    platform: FloatArray
    """By stage [s], shape (n,)."""
    arms: tuple[FloatArray, ...]
    """By arm and stage [s], shape (n,) each."""
    lines: FloatArray
    """How long the platform may move on approach and retract, by stage [s], shape (n, 2)."""

    @property
    def none(self) -> MotionRoom:
        """No room in as many stages."""
        arms = tuple(np.zeros_like(own) for own in self.arms)
        return MotionRoom(np.zeros_like(self.platform), arms, np.zeros_like(self.lines))


@dataclass(frozen=True)
class MadePlan:
    """A plan and what it means at every stage, by arm."""

    plan: Leaving
    arriving: list[CandidatePostures]
    leaving: list[CandidatePostures]


class LeavingSearch:
    """Successive linear programs over decisions of arriving and leaving."""

    def __init__(self, problem: SequenceProblem, room: MotionRoom) -> None:
        """Numbers the variables: those of `Variables`, then what changes at stops."""
        self.problem, self.room = problem, room
        self.tables = tuple(StopTable.of(work) for work in problem.arms)
        self.mean = Variables.of(problem)
        count = self.mean.count
        self.turn = np.full(problem.stages, -1, dtype=np.int64)
        swings = []
        free = np.flatnonzero(room.platform > 0.0) if problem.turns else np.zeros(0, dtype=np.int64)
        self.turn[free] = count + np.arange(len(free))
        count += len(free)
        for a, work in enumerate(problem.arms):
            own = self.mean.arms[a][:, 0] >= 0
            rows = np.flatnonzero(own & (room.arms[a] > 0.0))
            column = np.full(problem.stages, -1, dtype=np.int64)
            if work.spare > 0:
                column[rows] = count + np.arange(len(rows))
                count += len(rows)
            swings.append(column)
        self.swing, self.count = tuple(swings), count
        self.reach = tuple(
            work.law.reachable_distance(
                np.where(self.turn >= 0, room.platform, own)[:, None] / PATH_FACTOR
            )
            for work, own in zip(problem.arms, room.arms, strict=True)
        )
        self.turned, self.most_outer = np.zeros(problem.stages), np.zeros((problem.stages, 2))
        if problem.platform_law is not None:
            law = problem.platform_law
            self.turned = law.reachable_distance(room.platform[:, None] / PATH_FACTOR)[:, 0]
            most = law.reachable_distance(room.lines.reshape(-1, 1) / PATH_FACTOR)[:, 0]
            self.most_outer = most.reshape(-1, 2)
        self.outer = np.full((problem.stages, 2), -1, dtype=np.int64)
        lines = self.most_outer > 0.0
        self.outer[lines] = self.count + np.arange(int(lines.sum()))
        self.count += int(lines.sum())

    def improved(self, start: Leaving) -> Leaving:
        """Returns a plan that takes no longer by closed forms from rest to rest.

        Args:
            start: a possible plan.
        """
        best = MadePlan(start, *self.postures(start))
        total, radius = self.total(best), FIRST_RADIUS
        for _ in range(ROUNDS):
            if radius < SMALLEST_RADIUS or not np.isfinite(total):
                break
            step = self._step(best, radius)
            tried = [self.made(self._moved(best.plan, share * step)) for share in STEPS]
            tried.append(self._combined([best, *tried]))
            quickest = min(tried, key=self.total)
            before, time = total, self.total(quickest)
            if time < total:
                best, total = self.made(self._anchored(quickest)), time
            if before - total < LITTLE * before:
                radius *= SHRINK
        return best.plan

    def made(self, plan: Leaving) -> MadePlan:
        """Returns a plan with its postures and line times."""
        return MadePlan(plan, *self.postures(plan))

    def _combined(self, plans: Sequence[MadePlan]) -> MadePlan:
        """Returns the best combination of some plans, stage by stage, by dynamic programming.

        What lies farther apart than two stages, such as arms that are idle between, counts as if it were of one plan.
        """
        n, m = self.problem.stages, len(plans)
        length = np.array([[self._lengths(one, other) for other in plans] for one in plans])
        least, came = length[0, :, 0], np.zeros((n, m), dtype=np.int64)
        for k in range(1, n):
            sums = least[:, None] + length[:, :, k]
            came[k] = sums.argmin(axis=0)
            least = sums.min(axis=0)
        least = least + [self._closing(plans[0], one) for one in plans]
        choice = int(np.argmin(least))
        found = plans[0].plan
        for k in range(n - 1, -1, -1):
            found = found.put(np.array([k]), plans[choice].plan)
            choice = int(came[k, choice])
        return self.made(found)

    def postures(self, plan: Leaving) -> tuple[list[CandidatePostures], list[CandidatePostures]]:
        """Returns joints and line times of all stages, by arm, of arriving and of leaving."""
        rows = np.arange(self.problem.stages)
        arriving, leaving = (
            [
                turned_postures(self.problem, a, table, rows, side, plan.outer[:, end], LINES[end])
                for a, table in enumerate(self.tables)
            ]
            for end, side in enumerate((plan.arriving, plan.leaving))
        )
        return arriving, leaving

    def total(self, made: MadePlan) -> float:
        """Returns the cycle time by closed forms from rest to rest [s], infinite where it cannot be."""
        return float(self._lengths(made, made).sum()) + self._closing(made, made)

    def _lengths(self, before: MadePlan, made: MadePlan) -> FloatArray:
        """Returns the length of each stage [s], infinite where it cannot be, as one plan has it after another's."""
        problem, plan, n = self.problem, made.plan, self.problem.stages
        came_to = plan.arriving.angle + plan.outer[:, 0]
        first = start_angle(problem, before.plan.arriving.angle)
        gone = before.plan.leaving.angle + before.plan.outer[:, 1]
        left = np.concatenate([[first], gone[:-1]])
        if problem.free_start:
            left[0] = came_to[0]
        waiting = platform_times(problem, came_to - left)
        arrived, spent = np.zeros((2, len(problem.arms), n))
        lines, dwell = np.zeros((2, len(problem.arms), n)), np.zeros((len(problem.arms), n))
        for a, work in enumerate(problem.arms):
            chain = TransferChain.of(work)
            k = chain.active
            if not len(k):
                continue
            here = made.arriving[a]
            came, start = chain.previous[k], start_joints(problem, work, chain, here)
            q_from = np.where(came[:, None] >= 0, before.leaving[a].q_retract[came], start)
            arrived[a, k] = np.maximum(work.law.duration(here.q_approach[k] - q_from), waiting[k])
            possible = here.possible[k] & made.leaving[a].possible[k]
            dwell[a, k] = np.where(possible, self.tables[a].dwell[k], np.inf)
            lines[0, a, k] = here.approach[k].max(axis=1)
            lines[1, a, k] = made.leaving[a].retract[k].max(axis=1)
        # On a line on which the platform turns all arms of the stage are together.
        active = np.array([table.active for table in self.tables])
        turned = plan.outer != 0.0
        turning = PATH_FACTOR * platform_times(problem, plan.outer)
        begun = np.where(active & turned[:, 0], arrived.max(axis=0), arrived)
        for end in (0, 1):
            longest = np.maximum(lines[end].max(axis=0), turning[:, end])
            lines[end] = np.where(active & turned[:, end], longest, lines[end])
        leaves = begun + lines[0] + dwell
        leaves = np.where(active & turned[:, 1], leaves.max(axis=0), leaves)
        alone = lines[0] + lines[1] + dwell
        spent = np.where(turned.any(axis=1), leaves + lines[1] - arrived, alone)
        return np.array(stage_length(arrived, spent, together=problem.hands_over))

    def _closing(self, first: MadePlan, last: MadePlan) -> float:
        """Returns the length of the return [s], from the end of one plan to the start of another; 0 without one."""
        problem = self.problem
        if not problem.returns:
            return 0.0
        begin = start_angle(problem, first.plan.arriving.angle)
        back = np.array([begin - last.plan.leaving.angle[-1] - last.plan.outer[-1, 1]])
        closing = float(platform_times(problem, back)[0])
        for a, work in enumerate(problem.arms):
            chain = TransferChain.of(work)
            if len(chain.active):
                start = start_joints(problem, work, chain, first.arriving[a])
                moved = start - last.leaving[a].q_retract[chain.active[-1]]
                closing = max(closing, float(work.law.duration(moved)))
        return closing

    def _moved(self, plan: Leaving, step: FloatArray) -> Leaving:
        """Returns a plan after a step of all variables, shape (count,)."""
        padded = np.append(step, 0.0)
        mean, turn = step[: self.mean.count], 0.5 * padded[self.turn]
        sides = []
        for side, sign in ((plan.arriving, -1.0), (plan.leaving, 1.0)):
            one = self.mean.moved(side, mean)
            arms = []
            for a, arm in enumerate(one.arms):
                change = np.zeros((self.problem.stages, 4))
                change[:, 0] = sign * 0.5 * padded[self.swing[a]]
                arms.append(shifted(arm, change))
            angle = one.angle + sign * turn
            if self.problem.turns:
                angle = np.clip(angle, *self.problem.platform_range)
            sides.append(Decisions(angle, tuple(arms)))
        outer = plan.outer + padded[self.outer]
        if self.problem.turns:
            at_target = np.stack([side.angle for side in sides], axis=1)
            outer = np.where(
                self.outer >= 0,
                np.clip(at_target + outer, *self.problem.platform_range) - at_target,
                plan.outer,
            )
        return Leaving(sides[0], sides[1], outer)

    def _anchored(self, made: MadePlan) -> Leaving:
        """Returns a plan counted from its own postures where these matter."""
        sides = []
        both = (made.plan.arriving, made.arriving), (made.plan.leaving, made.leaving)
        for side, found in both:
            arms = zip(self.problem.arms, side.arms, found, strict=True)
            sides.append(Decisions(side.angle, tuple(anchored(*one) for one in arms)))
        return Leaving(sides[0], sides[1], made.plan.outer)

    def _step(self, made: MadePlan, radius: float) -> FloatArray:
        """Returns the best step of all variables within a radius, everything taken as linear, shape (count,)."""
        rows, plan, found = Rows(), made.plan, (made.arriving, made.leaving)
        sides = plan.arriving, plan.leaving
        rates = [
            [
                turned_slopes(
                    self.problem, a, table, sides[end], plan.outer[:, end], LINES[end], own[a]
                )
                for a, table in enumerate(self.tables)
            ]
            for end, own in enumerate(found)
        ]
        for a in range(len(self.tables)):
            self._add_transfers(rows, plan, found, rates, a)
            self._add_lines(rows, found, rates, a)
            self._add_limits(rows, found, rates, a, radius)
            self._add_reach(rows, found, rates, a)
        if self.problem.returns:
            self._add_return(rows, plan, found, rates)
        program = rows.by_stage()
        n, arms = self.problem.stages, len(self.tables)
        times = n + 1 + 2 * arms * n
        most = np.full(self.count, radius)
        lower, upper = -most, most
        if self.problem.turns:
            k = np.flatnonzero(self.turn >= 0)
            now = (plan.leaving.angle - plan.arriving.angle)[k]
            columns = self.turn[k]
            lower[columns] = np.maximum(lower[columns], np.minimum(0.0, -self.turned[k] - now))
            upper[columns] = np.minimum(upper[columns], np.maximum(0.0, self.turned[k] - now))
            k, end = np.nonzero(self.outer >= 0)
            columns, now, far = self.outer[k, end], plan.outer[k, end], self.most_outer[k, end]
            lower[columns] = np.maximum(lower[columns], np.minimum(0.0, -far - now))
            upper[columns] = np.minimum(upper[columns], np.maximum(0.0, far - now))
        found_step = least_cost(
            np.concatenate([np.zeros(self.count), np.arange(times) <= n]),
            (program.row, program.column, program.value),
            program.bound,
            np.concatenate([lower, np.zeros(times)]),
            np.concatenate([upper, np.full(times, np.inf)]),
        )
        return np.zeros(self.count) if found_step is None else found_step[: self.count]

    def _columns(self, a: int, k: IntArray) -> IntArray:
        """Returns the columns of the angle, the arm's fields, and what changes in some stages, shape (m, 9)."""
        changes = self.turn[k], self.swing[a][k], self.outer[k]
        return np.column_stack([self.mean.angle[k], self.mean.arms[a][k], *changes])

    def _line_columns(self, a: int, k: IntArray) -> IntArray:
        """Returns the columns of the times of approach and retract, shape (m, 2)."""
        first = self.count + self.problem.stages + 1 + 2 * a * self.problem.stages
        return np.column_stack([first + 2 * k, first + 2 * k + 1])

    def _add_length(
        self,
        rows: Rows,
        columns: IntArray,
        values: FloatArray,
        time: FloatArray,
        stage: IntArray,
        watched: BoolArray,
    ) -> None:
        """Appends time + values @ step <= length of the stage, for watched rows."""
        columns = np.column_stack([columns, self.count + stage])
        values = np.column_stack([values, np.full(len(stage), -1.0)])
        rows.add(columns[watched], values[watched], -time[watched], stage[watched])

    def _add_transfers(
        self,
        rows: Rows,
        plan: Leaving,
        found: tuple[list[CandidatePostures], list[CandidatePostures]],
        rates: list[list[Slopes]],
        a: int,
    ) -> None:
        """Appends, per stage and slow joint: transfer + lines + dwell <= length of the stage."""
        problem, work = self.problem, self.problem.arms[a]
        chain = TransferChain.of(work)
        k, here, left = chain.active, found[0][a], found[1][a]
        if not len(k):
            return
        came = chain.previous[k]
        follows = came[:, None] >= 0
        start = start_joints(problem, work, chain, here)
        q_from = np.where(follows, left.q_retract[came], start)
        time, slope = timed_slopes(work.law, here.q_approach[k] - q_from)
        longest = time.max(axis=1)
        lines, dwell = self._line_columns(a, k), self.tables[a].dwell[k]
        if len(problem.together):
            other, met = 1 - a, np.isin(k, problem.together)
            theirs = np.where(met[:, None], self._line_columns(other, k), -1)
            lines = np.column_stack([lines, theirs])
            dwell = dwell + np.where(met, self.tables[other].dwell[k], 0.0)
        ones = np.ones(lines.shape)
        if problem.platform_law is not None:
            first = start_angle(problem, plan.arriving.angle)
            gone = plan.leaving.angle + plan.outer[:, 1]
            before = np.concatenate([[first], gone[:-1]])
            moved = (plan.arriving.angle + plan.outer[:, 0] - before)[k, None]
            turning, rate = timed_slopes(problem.platform_law, moved)
            longest = np.maximum(longest, turning[:, 0])
            columns = np.column_stack(
                [
                    self.mean.angle[k],
                    self.turn[k],
                    np.where(k > 0, self.mean.angle[k - 1], -1),
                    np.where(k > 0, self.turn[k - 1], -1),
                    self.outer[k, 0],
                    np.where(k > 0, self.outer[k - 1, 1], -1),
                    lines,
                ]
            )
            values = np.column_stack([rate, -0.5 * rate, -rate, -0.5 * rate, rate, -rate, ones])
            watched = turning[:, 0] >= NEAR_CRITICAL * longest
            self._add_length(rows, columns, values, turning[:, 0] + dwell, k, watched)
        to = slope[:, :, None] * _sided(rates[0][a].q_approach[k], -1.0)
        origin = np.where(
            follows[:, :, None], -slope[:, :, None] * _sided(rates[1][a].q_retract[came], 1.0), 0.0
        )
        if problem.free_start and k[0] == 0:
            to[0] = 0.0
        columns = np.column_stack(
            [self._columns(a, k), np.where(follows, self._columns(a, came), -1), lines]
        )
        for joint in range(work.joints):
            values = np.column_stack([to[:, joint], origin[:, joint], ones])
            watched = time[:, joint] >= NEAR_CRITICAL * longest
            self._add_length(rows, columns, values, time[:, joint] + dwell, k, watched)

    def _add_lines(
        self,
        rows: Rows,
        found: tuple[list[CandidatePostures], list[CandidatePostures]],
        rates: list[list[Slopes]],
        a: int,
    ) -> None:
        """Appends, per line and slow joint: what the joint asks for <= time of the line."""
        k = TransferChain.of(self.problem.arms[a]).active
        columns, lines = self._columns(a, k), self._line_columns(a, k)
        both = (
            (found[0][a].approach, rates[0][a].approach, -1.0),
            (found[1][a].retract, rates[1][a].retract, 1.0),
        )
        for end, (time, rate, sign) in enumerate(both):
            own = _sided(rate[k], sign)
            longest = time[k].max(axis=1)
            for joint in range(time.shape[1]):
                used = (time[k, joint] >= NEAR_CRITICAL * longest) & (time[k, joint] > 0)
                rows.add(
                    np.column_stack([columns, lines[:, end]])[used],
                    np.column_stack([own[:, joint], -np.ones(len(k))])[used],
                    -time[k, joint][used],
                    k[used],
                )

    def _add_limits(
        self,
        rows: Rows,
        found: tuple[list[CandidatePostures], list[CandidatePostures]],
        rates: list[list[Slopes]],
        a: int,
        radius: float,
    ) -> None:
        """Appends position limits of joints that a step could bring there."""
        work = self.problem.arms[a]
        k = TransferChain.of(work).active
        columns = self._columns(a, k)
        ends = [
            (found[side][a], rates[side][a], sign, name)
            for side, sign, names in (
                (0, -1.0, ("q_approach", "q_target")),
                (1, 1.0, ("q_target", "q_retract")),
            )
            for name in names
        ]
        for made, rate, sign, name in ends:
            q, own = getattr(made, name)[k], _sided(getattr(rate, name)[k], sign)
            swing = np.abs(own).sum(axis=2) * radius
            for joint, way, limit in _limits(work.limits.lower, work.limits.upper):
                room = way * (limit - q[:, joint]) - LIMIT_MARGIN
                near = room < swing[:, joint]
                rows.add(
                    columns[near], way * own[near, joint], np.maximum(room[near], 0.0), k[near]
                )

    def _add_reach(
        self,
        rows: Rows,
        found: tuple[list[CandidatePostures], list[CandidatePostures]],
        rates: list[list[Slopes]],
        a: int,
    ) -> None:
        """Appends: no joint moves farther at a stop than it can in the time that is there."""
        k = np.flatnonzero((self.swing[a] >= 0) | ((self.turn >= 0) & self.tables[a].active))
        columns = self._columns(a, k)
        moved = found[1][a].q_target[k] - found[0][a].q_target[k]
        rate = _sided(rates[1][a].q_target[k], 1.0) - _sided(rates[0][a].q_target[k], -1.0)
        for joint in range(moved.shape[1]):
            for way in (1.0, -1.0):
                room = self.reach[a][k, joint] - way * moved[:, joint]
                rows.add(columns, way * rate[:, joint], np.maximum(room, 0.0), k)

    def _add_return(
        self,
        rows: Rows,
        plan: Leaving,
        found: tuple[list[CandidatePostures], list[CandidatePostures]],
        rates: list[list[Slopes]],
    ) -> None:
        """Appends the return's rows: every joint and the platform, back to the start."""
        problem, last = self.problem, np.array([self.problem.stages])
        end = last - 1
        if problem.platform_law is not None:
            first = start_angle(problem, plan.arriving.angle)
            back = np.array([[first - plan.leaving.angle[-1] - plan.outer[-1, 1]]])
            time, slope = timed_slopes(problem.platform_law, back)
            free = problem.free_start
            columns = np.array(
                [
                    [
                        self.mean.angle[-1],
                        self.turn[-1],
                        self.outer[-1, 1],
                        self.mean.angle[0] if free else -1,
                        self.turn[0] if free else -1,
                    ]
                ]
            )
            values = np.column_stack([-slope, -0.5 * slope, -slope, slope, -0.5 * slope])
            everything = np.ones(1, dtype=np.bool_)
            self._add_length(rows, columns, values, time[:, 0], last, everything)
        for a, work in enumerate(problem.arms):
            chain = TransferChain.of(work)
            if not len(chain.active):
                continue
            end = chain.active[-1:]
            here, left = found[0][a], found[1][a]
            start = start_joints(problem, work, chain, here)
            time, slope = timed_slopes(work.law, start - left.q_retract[end[0]])
            own = -slope[:, None] * _sided(rates[1][a].q_retract[end], 1.0)[0]
            columns = self._columns(a, end)
            if problem.free_start and chain.active[0] == 0:
                begin = slope[:, None] * _sided(rates[0][a].q_approach[:1], -1.0)[0]
                own = np.column_stack([own, begin])
                columns = np.column_stack([columns, self._columns(a, np.zeros(1, dtype=np.int64))])
            for joint in range(work.joints):
                everything = np.ones(1, dtype=np.bool_)
                self._add_length(rows, columns, own[joint][None], time[[joint]], last, everything)


def _sided(rate: FloatArray, sign: float) -> FloatArray:
    """Returns derivatives by the mean decisions, by what changes at the stop, and on its lines, (..., 9).

    Args:
        rate: derivatives by the decisions of one side, and by the platform's way on its line, shape (..., 6).
        sign: -1 of arriving, 1 of leaving.
    """
    none = np.zeros_like(rate[..., :1])
    outer = [rate[..., 5:], none] if sign < 0.0 else [none, rate[..., 5:]]
    return np.concatenate([rate[..., :5], 0.5 * sign * rate[..., :2], *outer], axis=-1)


def _limits(lower: FloatArray, upper: FloatArray) -> Iterator[tuple[int, float, float]]:
    """Yields joints, directions and limits in these."""
    for joint, (low, high) in enumerate(zip(lower.tolist(), upper.tolist(), strict=True)):
        yield joint, 1.0, high
        yield joint, -1.0, low


def leaving_of(problem: SequenceProblem, model: CellModel, plans: Sequence[StagePlan]) -> Leaving:
    """Returns decided stages in which nothing moves while tools stand."""
    same = decisions_of(problem, model, list(plans))
    return Leaving(same, same, np.zeros((problem.stages, 2)))


def leaving_plans(
    model: CellModel, job: Job, problem: SequenceProblem, plan: Leaving, before: Sequence[StagePlan]
) -> list[StagePlan]:
    """Returns the stages of a plan whose stops may be left otherwise than they were come to.

    Args:
        model: the job's cell.
        job: what is to be done.
        problem: the same as numbers.
        plan: what was decided; on lines the platform stands, whatever that says.
        before: the stages of the plan that it came from: who waits and makes detours stays as it is there.
    """
    come = stage_plans(model, job, problem, plan.arriving, "")
    gone = stage_plans(model, job, problem, plan.leaving, "")
    turns, found = plan.arriving.angle != plan.leaving.angle, list[StagePlan]()
    for k, (one, other, old) in enumerate(zip(come, gone, before, strict=True)):
        start = found[-1].end if found else one.start
        if not one.stops:
            found.append(replace(old, start=start, arrival=one.arrival, end=one.end))
            continue
        arrival = np.array(start)
        arrival[model.platform_columns] = one.arrival[model.platform_columns]
        end = np.array(arrival)
        end[model.platform_columns] = other.arrival[model.platform_columns]
        for name in one.stops:
            columns = model.arms[name].columns
            arrival[columns], end[columns] = one.arrival[columns], other.end[columns]
        leaving = {
            name: left
            for name, left in other.stops.items()
            if turns[k] or _moves(one.stops[name].posture, left.posture)
        }
        found.append(
            replace(old, start=start, arrival=arrival, end=end, stops=one.stops, leaving=leaving)
        )
    return found


def _moves(come: StopPosture, left: StopPosture) -> bool:
    return not np.array_equal(come.q_target, left.q_target)
