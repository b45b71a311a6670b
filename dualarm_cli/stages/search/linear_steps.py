"""Successive linear programming over all continuous decisions of a plan."""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from dualarm_cli.background import map_halves
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.programs import least_cost
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans import passing
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import (
    Evaluated,
    TransferChain,
    left_with,
    places_on_transfers,
    start_angle,
    start_joints,
)
from dualarm_cli.stages.search.variables import Slopes, Variables, slopes


@dataclass
class Rows:
    """Constraint rows `matrix @ x <= bound`, collected piece by piece."""

    row: list[IntArray] = field(default_factory=list)
    column: list[IntArray] = field(default_factory=list)
    value: list[FloatArray] = field(default_factory=list)
    bound: list[FloatArray] = field(default_factory=list)
    stage: list[IntArray] = field(default_factory=list)
    count: int = 0

    def add(
        self, columns: IntArray, values: FloatArray, bound: FloatArray, stage: IntArray
    ) -> None:
        """Append m rows; columns of -1 are ignored."""
        rows = np.broadcast_to(np.arange(len(bound))[:, None] + self.count, columns.shape)
        used = (columns >= 0) & (values != 0.0)
        self.row.append(rows[used])
        self.column.append(columns[used])
        self.value.append(values[used])
        self.bound.append(bound)
        self.stage.append(stage)
        self.count += len(bound)

    def by_stage(self) -> LinearProgram:
        """Sort all rows by stage."""
        stage = np.concatenate(self.stage)
        order = np.argsort(stage, kind="stable")
        place = np.empty_like(order)
        place[order] = np.arange(len(order))
        row = place[np.concatenate(self.row)]
        entries = np.argsort(row, kind="stable")
        return LinearProgram(
            row[entries],
            np.concatenate(self.column)[entries],
            np.concatenate(self.value)[entries],
            np.concatenate(self.bound)[order],
            stage[order],
        )


@dataclass(frozen=True)
class LinearProgram:
    """Constraint rows sorted by stage."""

    row: IntArray
    """Row of each entry, ascending."""
    column: IntArray
    """Column of each entry."""
    value: FloatArray
    """Value of each entry."""
    bound: FloatArray
    """Bound of each row."""
    stage: IntArray
    """Stage of each row, ascending."""

    def within(self, first: int, past: int) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
        """Return entries and bounds of the stages from `first` to before `past`."""
        low, high = np.searchsorted(self.stage, [first, past])
        begin, end = np.searchsorted(self.row, [low, high])
        entries = slice(begin, end)
        return (
            self.row[entries] - low,
            self.column[entries],
            self.value[entries],
            self.bound[low:high],
        )


def timed_slopes(law: RestToRest, moved: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Compute joint times [s] and their slopes by displacement [s/rad], shape (..., n)."""
    time, step = law.per_joint(moved), 1e-7
    ahead = law.per_joint(np.abs(moved) + step)
    return time, np.sign(moved) * (ahead - time) / step


def _through(by_joint: FloatArray, rates: FloatArray) -> FloatArray:
    """Chain slopes by joints and platform with slopes of the joints, shape (m, 1, v).

    Args:
        by_joint: slopes by the n joints and by the platform, shape (m, n + 1).
        rates: slopes of the joints by variables, the platform's first, shape (m, n, v).
    """
    by_variable = product(by_joint[:, None, :-1], rates)
    by_variable[:, 0, 0] += by_joint[:, -1]
    return np.asarray(by_variable)


def _by_variables(
    rates: Slopes, slope: FloatArray, chain: TransferChain
) -> tuple[FloatArray, FloatArray]:
    """Chain slopes of transfer times with those of their goals and starts, (m, joints, v) each.

    Args:
        rates: slopes of the arm's stops by variables.
        slope: slopes of its joints' times, see `passing.timed_slopes`, shape (m, 1 or 5, joints).
        chain: its transfers.
    """
    k, came, by = chain.active, chain.previous[chain.active], slope[..., None]
    here, there = by[:, 0] * rates.q_approach[k], -by[:, 0] * rates.q_retract[came]
    if by.shape[1] > 1:
        here += (by[:, 3:] * rates.rates[k, 0]).sum(axis=1)
        there += (by[:, 1:3] * rates.rates[came, 1]).sum(axis=1)
    there[came < 0] = 0.0
    return here, there


@dataclass(frozen=True)
class _LinearisedPlan:
    """Linearisation of a feasible plan: slopes of its joints and times, and constraint rows."""

    problem: SequenceProblem
    """The sequence."""
    variables: Variables
    """Numbering of the variables."""
    best: Evaluated
    """The plan."""
    rates: list[Slopes]
    """Slopes of each arm's joints and line times."""
    follows_rates: bool
    """Whether transfer times follow the rates at line ends."""
    rows: Rows = field(default_factory=Rows)
    """Rows so far."""

    @property
    def near_critical(self) -> float:
        """Fraction of the longest time above which a joint gets a row."""
        return self.problem.settings.near_critical

    def program(self, radius: FloatArray) -> LinearProgram:
        """Linearise the plan over (variables, lengths of stages and return, times of lines).

        Args:
            radius: trust-region radius of each stage's variables [rad], shape (n + 1,).
        """
        for a in range(len(self.problem.arms)):
            self.add_transfers(a)
            self.add_lines(a)
            self.add_limits(a, radius)
        if self.problem.returns:
            self.add_return()
        return self.rows.by_stage()

    def add_transfers(self, a: int) -> None:
        """Append, per stage and slow joint: transfer + lines + dwell <= stage duration."""
        problem, rates = self.problem, self.rates[a]
        chain = TransferChain.of(problem.arms[a])
        k, came = chain.active, chain.previous[chain.active]
        time, slope = self._transfer_slopes(a, chain)
        here, there = _by_variables(rates, slope, chain)
        if self.problem.arms[a].slowing is not None:
            # A tool's speed limit is one more joint.
            tool, by_joint = self._tool_slopes(a, chain)
            time = np.column_stack([time, tool])
            ends = ((here, k, 1.0, rates.q_approach), (there, came, -1.0, rates.q_retract))
            here, there = (
                np.concatenate([rows, sign * _through(by_joint, slopes[at])], axis=1)
                for rows, at, sign, slopes in ends
            )
            there[came < 0] = 0.0
        # A free start moves with the first stop: its transfer takes no time, and only its work counts.
        if problem.free_start and len(k) and k[0] == 0:
            here[0] = 0.0
        before = np.where(came[:, None] >= 0, self._columns(a, came), -1)
        columns = np.column_stack([self._columns(a, k), before])
        longest = time.max(axis=1)
        platform = None
        if problem.platform_law is not None:
            platform = self._platform_move(problem.platform_law, k)
            longest = np.maximum(longest, platform[2])
        lines, dwell = self._line_columns(a, k), self.problem.arms[a].stop_table.dwell[k]
        if len(problem.handover_stages):
            # In a hand-over the other arm's lines and dwell count as well.
            other_arm, met = 1 - a, np.isin(k, problem.handover_stages)
            theirs = np.where(met[:, None], self._line_columns(other_arm, k), -1)
            lines = np.column_stack([lines, theirs])
            dwell = dwell + np.where(met, self.problem.arms[other_arm].stop_table.dwell[k], 0.0)
        if platform is not None:
            of_platform, values, turn = platform
            of_platform = np.column_stack([of_platform, lines])
            values = np.column_stack([values, np.ones(lines.shape)])
            watched = turn >= self.near_critical * longest
            self._add(of_platform, values, turn + dwell, k, watched)
        joint, row = np.nonzero(self.near_critical * longest <= time.T)
        columns = np.column_stack([columns, lines])[row]
        ones = np.ones((len(row), lines.shape[1]))
        values = np.column_stack([here[row, joint], there[row, joint], ones])
        self._add(columns, values, time[row, joint] + dwell[row], k[row])

    def _transfer_slopes(self, a: int, chain: TransferChain) -> tuple[FloatArray, FloatArray]:
        """Time an arm's joints on its transfers, with slopes by displacements, and by rates if followed.

        Times [s] have shape (m, joints), slopes (m, 1 or 5, joints), see `passing.timed_slopes`.
        """
        problem, work, best = self.problem, self.problem.arms[a], self.best.arms[a]
        k, before = chain.active, chain.previous[chain.active]
        q_from = self._left(a, chain)
        law = work.law if work.slowing is None else work.slowing.joint_law(k, work.joints)
        timed = timed_slopes(law, best.q_approach[k] - q_from)
        if problem.launches is None:
            return timed[0], timed[1][:, None]
        leaving = q_from, left_with(best, before)
        arriving, by_rates = (best.q_approach[k], best.rates[k, 0]), self.follows_rates
        return passing.timed_slopes(work, leaving, arriving, timed, by_rates=by_rates)

    def _tool_slopes(self, a: int, chain: TransferChain) -> tuple[FloatArray, FloatArray]:
        """Time an arm's transfers whose tool is at its speed limit, with slopes by joints.

        Times [s] have shape (m,), 0 where no tool slows, slopes [s/rad] of the arm's joints and of the platform
        (m, joints + 1).
        """
        problem, k, angle = self.problem, chain.active, self.best.decisions.angle
        slowing = problem.arms[a].slowing
        assert slowing is not None  # callers have looked
        turned = np.concatenate([[start_angle(problem, angle)], angle[:-1]])[k]
        ends = (self._left(a, chain), turned), (self.best.arms[a].q_approach[k], angle[k])
        places = places_on_transfers(problem, slowing, *ends)
        time, factor = slowing.transfer_times(k, places)
        slope = np.zeros((len(k), problem.arms[a].joints + 1))
        of_joints = slowing.slopes(k, places)
        slope[:, : of_joints.shape[1]] = of_joints
        return np.where(factor < 1.0, time, 0.0), slope

    def _left(self, a: int, chain: TransferChain) -> FloatArray:
        """Select the joints from which an arm's transfers start [rad], shape (m, joints)."""
        best, before = self.best.arms[a], chain.previous[chain.active]
        start = start_joints(self.problem, self.problem.arms[a], chain, best)
        return np.where(before[:, None] >= 0, best.q_retract[before], start)

    def _platform_move(
        self, law: RestToRest, k: IntArray
    ) -> tuple[IntArray, FloatArray, FloatArray]:
        """Time the platform's moves into given stages, with columns and slopes.

        Columns and slopes have shape (m, 2); the times [s], which come last, have shape (m,).
        """
        angle = self.best.decisions.angle
        before = np.concatenate([[start_angle(self.problem, angle)], angle[:-1]])
        time, slope = timed_slopes(law, (angle - before)[k, None])
        column = self.variables.angle
        columns = np.column_stack([column[k], np.where(k > 0, column[k - 1], -1)])
        return columns, np.column_stack([slope, -slope]), time[:, 0]

    def add_lines(self, a: int) -> None:
        """Append, per line and slow joint: joint time <= line time."""
        work, postures, rates = self.problem.arms[a], self.best.arms[a], self.rates[a]
        k = TransferChain.of(work).active
        columns, lines = self._columns(a, k), self._line_columns(a, k)
        pairs = ((postures.approach, rates.approach), (postures.retract, rates.retract))
        for end, (time, rate) in enumerate(pairs):
            # A line that is passed in motion changes as it does from rest to rest.
            share = postures.shares[:, end, None]
            time, rate = time * share, rate * share[:, :, None]
            watched = (time[k] >= self.near_critical * time[k].max(axis=1, keepdims=True)) & (
                time[k] > 0
            )
            joint, row = np.nonzero(watched.T)
            self.rows.add(
                np.column_stack([columns, lines[:, end]])[row],
                np.column_stack([rate[k[row], joint], -np.ones(len(row))]),
                -time[k[row], joint],
                k[row],
            )

    def add_return(self) -> None:
        """Append the rows of the return: every slow joint and the platform."""
        problem, variables, best = self.problem, self.variables, self.best
        last = np.array([problem.stages])
        angle = best.decisions.angle
        if problem.platform_law is not None:
            back = np.array([[start_angle(problem, angle) - angle[-1]]])
            time, slope = timed_slopes(problem.platform_law, back)
            first = variables.angle[0] if problem.free_start else -1
            columns = np.array([[variables.angle[-1], first]])
            values = np.column_stack([-slope, slope])
            watched = time[:, 0] >= self.near_critical * best.closing
            self._add(columns, values, time[:, 0], last, watched)
        for a, work in enumerate(problem.arms):
            chain, postures, rates = TransferChain.of(work), best.arms[a], self.rates[a]
            if not len(chain.active):
                continue
            k = int(chain.active[-1])
            start = start_joints(problem, work, chain, postures)
            time, slope = timed_slopes(work.law, start - postures.q_retract[k])
            moves = problem.free_start and chain.active[0] == 0
            for joint in range(work.joints):
                columns = self._columns(a, np.array([k]))
                values = (-slope[joint] * rates.q_retract[k, joint])[None]
                if moves:
                    columns = np.column_stack([columns, self._columns(a, np.array([0]))])
                    values = np.column_stack([values, slope[joint] * rates.q_approach[:1, joint]])
                watched = time[[joint]] >= self.near_critical * best.closing
                self._add(columns, values, time[[joint]], last, watched)

    def add_limits(self, a: int, radius: FloatArray) -> None:
        """Append position limits that a step within the radius may reach."""
        work, postures, rates = self.problem.arms[a], self.best.arms[a], self.rates[a]
        k = TransferChain.of(work).active
        columns = self._columns(a, k)
        for q, rate in (
            (postures.q_approach, rates.q_approach),
            (postures.q_target, rates.q_target),
            (postures.q_retract, rates.q_retract),
        ):
            swing = np.abs(rate[k]).sum(axis=2) * radius[k, None]
            room = np.stack([work.limits.upper - q[k], q[k] - work.limits.lower]) - 1e-6  # rounding
            joint, side, row = np.nonzero((room < swing).transpose(2, 0, 1))
            values = (1.0 - 2.0 * side)[:, None] * rate[k[row], joint]
            bound = np.maximum(room[side, row, joint], 0.0)
            self.rows.add(columns[row], values, bound, k[row])

    def _columns(self, a: int, stages: IntArray) -> IntArray:
        """Return the columns of (platform angle, FIELDS) in given stages, shape (m, 5)."""
        return np.column_stack([self.variables.angle[stages], self.variables.arms[a][stages]])

    def _line_columns(self, a: int, stages: IntArray) -> IntArray:
        """Return the columns of approach and retract times in given stages, shape (m, 2)."""
        first = self.variables.count + self.problem.stages + 1 + 2 * a * self.problem.stages
        return np.column_stack([first + 2 * stages, first + 2 * stages + 1])

    def _add(
        self,
        columns: IntArray,
        values: FloatArray,
        now: FloatArray,
        stage: IntArray,
        watched: BoolArray | None = None,
    ) -> None:
        """Append now + values @ step <= stage duration for selected rows, or for all."""
        columns = np.column_stack([columns, self.variables.count + stage])
        values = np.column_stack([values, np.full(len(stage), -1.0)])
        rows = slice(None) if watched is None else watched
        self.rows.add(columns[rows], values[rows], -now[rows], stage[rows])


def linear_step(
    problem: SequenceProblem,
    variables: Variables,
    best: Evaluated,
    radius: FloatArray,
    round_number: int,
    *,
    follows_rates: bool = False,
) -> FloatArray:
    """Compute the best linearised step of all variables within a radius [rad], shape (count,).

    Joints at the ends of all transfers, transfer times and line times are linear in the platform angles, arm angles and
    free yaws; a linear program per window of stages then finds the step. (A transfer's time is concave in its
    distance: its tangent lies above it, so that a promised gain is on the safe side.)

    Args:
        problem: the sequence.
        variables: numbering of its variables.
        best: a possible plan.
        radius: trust-region radius of each stage's variables [rad], shape (n + 1,).
        round_number: odd rounds shift the windows by half a window.
        follows_rates: whether the rates at line ends change with the postures; else only lines and displacements do.
    """
    windows = _windows(problem.stages, problem.settings.window, round_number)
    # Times of lines that are passed in motion are taken to change as from rest to rest.
    sloped = problem if follows_rates else replace(problem, launches=None)
    rates = [slopes(sloped, a, best.decisions, postures) for a, postures in enumerate(best.arms)]
    program = _LinearisedPlan(problem, variables, best, rates, follows_rates).program(radius)
    return _solve(problem, variables, best, program, windows, radius)


def _windows(stages: int, window: int, round_number: int) -> list[tuple[int, int]]:
    """Return (first, past) of each window; odd rounds shift by half a window."""
    if stages <= window + window // 2:
        return [(0, stages)]
    edges = list(range(0 if round_number % 2 == 0 else window // 2, stages, window))
    edges = [0, *edges[(edges[0] == 0) :]]
    if stages - edges[-1] < window // 3:
        edges.pop()
    return list(zip(edges, [*edges[1:], stages], strict=True))


def _stage_of_variable(variables: Variables) -> IntArray:
    stage = np.zeros(variables.count, dtype=np.int64)
    for rows in (variables.angle[:, None], *variables.arms):
        k, column = np.nonzero(rows >= 0)
        stage[rows[k, column]] = k
    return stage


def _solve(
    problem: SequenceProblem,
    variables: Variables,
    best: Evaluated,
    program: LinearProgram,
    windows: list[tuple[int, int]],
    radius: FloatArray,
) -> FloatArray:
    """Solve every window's linear program for its best step [rad]."""
    n, v = problem.stages, variables.count
    of_variable = _stage_of_variable(variables)
    lower, upper = _bounds(problem, variables, best, radius[of_variable])
    of_time = np.concatenate([np.arange(n + 1), *[np.repeat(np.arange(n), 2)] * len(problem.arms)])
    step = np.zeros(v)
    local = np.full(v + len(of_time), -1, dtype=np.int64)
    inner_of = np.split(
        np.argsort(of_variable, kind="stable"), np.bincount(of_variable, minlength=n).cumsum()
    )

    def solved(window: tuple[int, int]) -> FloatArray | None:
        first, end = window
        # The stage after a window starts from it; the last window has the return.
        past = end + 1
        inner = np.concatenate(inner_of[first:end])
        if not len(inner):
            return None
        times = _time_columns(n, len(problem.arms), first, past)
        columns = np.concatenate([inner, v + times])
        local[columns] = np.arange(len(columns))
        row, column, value, bound = program.within(first, past)
        kept = local[column] >= 0
        matrix = row[kept], local[column[kept]], value[kept]
        local[columns] = -1
        least = np.concatenate([lower[inner], np.zeros(len(times))])
        most = np.concatenate([upper[inner], np.full(len(times), np.inf)])
        cost = np.concatenate([np.zeros(len(inner)), times <= n])
        solution = least_cost(cost, matrix, bound, least, most)
        return None if solution is None else solution[: len(inner)]

    least = problem.settings.shared_windows
    solution = map_halves(lambda block: [solved(window) for window in block], windows, least)
    for (first, end), part in zip(windows, solution, strict=True):
        if part is not None:
            step[np.concatenate(inner_of[first:end])] = part
    return step


def _bounds(
    problem: SequenceProblem, variables: Variables, best: Evaluated, radius: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Compute lower and upper bounds of every variable's step [rad]."""
    lower, upper = -radius, radius.copy()
    if problem.turns:
        low, high = problem.platform_range
        free = variables.angle >= 0
        columns, here = variables.angle[free], best.decisions.angle[free]
        lower[columns] = np.maximum(lower[columns], low - here)
        upper[columns] = np.minimum(upper[columns], high - here)
    return lower, upper


def _time_columns(stages: int, arms: int, first: int, past: int) -> IntArray:
    """Return time columns of stages `first` to before `past`, after the variables."""
    lengths = np.arange(first, past)
    lines = np.arange(2 * first, 2 * min(past, stages))
    return np.concatenate([lengths, *(stages + 1 + 2 * a * stages + lines for a in range(arms))])
