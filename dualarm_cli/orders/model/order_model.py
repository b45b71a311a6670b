"""Model of an open job for search: postures, times, collisions by stop.

The search chooses arms and orders.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, JointTarget, Task
from dualarm_cli.orders.asynchronous.problem import ArmTasks, SequencingProblem
from dualarm_cli.orders.model.buffer_numbers import job_stores, stop_lasts
from dualarm_cli.orders.model.tool_changes import stand_tasks
from dualarm_cli.orders.rules.tool_stands import NO_TOOL, ToolStands
from dualarm_cli.postures.stage_problems import Clock
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import Grid, Nodes
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes
from dualarm_cli.stages.sequence_problem import stops_problem


@dataclass(frozen=True)
class OrderNodeSettings:
    """Limits on the postures and candidates that the search for orders samples."""

    min_distance: float = 0.08
    """Distance below which two postures of a stop count as the same [s]."""
    max_extra_cost: float = 0.6
    """Largest cost of a posture above the best one's [s]."""
    hub_rounds: int = 2
    """Number of iterations that compute the centre of an arm's work."""
    most_given: int = 160
    """Maximum number of options of tasks with given joint configurations."""
    arm_angles: int = 12
    """Number of arm angles around the circle."""
    most_nodes: int = 6000
    """Maximum number of nodes of one stop over all platform angles."""
    few_nodes: int = 24
    """Maximum nodes per stop and platform angle for arms without closed forms."""
    angle_step: float = np.radians(15.0)
    """Spacing of the platform angles [rad]; that of a rail is in `PlatformChain.spacing`."""
    candidates: int = 16
    """Postures per stop and platform angle that are checked for collisions first.

    The others are checked if all of these collide.
    """
    most_angles: int = 12
    """Maximum number of platform angles in synchronous stages; twice as many up to `few_stops`."""
    few_stops: int = 200
    """Maximum number of stops with twice as many platform angles."""
    most_lengths: int = 37_000_000
    """Maximum size of one arm's table of stage lengths."""
    options: tuple[tuple[int, ...], ...] = ((12, 6), (40, 4), (120, 2))
    """Options per task as pairs (maximum tasks, options), with a single option beyond."""


NODES = OrderNodeSettings()


@dataclass(frozen=True)
class TaskOptions:
    """Options of one arm for one task, m of them."""

    entry: FloatArray
    """Joints at the start of the first approach [rad], shape (m, joints)."""
    leaving: FloatArray
    """Joints at the end of the last retract [rad], shape (m, joints)."""
    first: FloatArray
    """Time of the first stop, lines and dwell [s], shape (m,)."""
    second: FloatArray
    """Time from there to the second stop's end [s], shape (m,).

    0 for tasks of a single stop.
    """
    lead: float
    """Least duration of the first line [s]; infinite without options."""
    tail: float
    """Least duration of the last line [s]; infinite without options."""

    @classmethod
    def none(cls, joints: int) -> TaskOptions:
        """Build empty options, for an arm of some joints."""
        empty = np.zeros(0)
        return cls(np.zeros((0, joints)), np.zeros((0, joints)), empty, empty, np.inf, np.inf)


def hub(
    model: CellModel,
    job: Job,
    name: str,
    nodes: Mapping[tuple[str, int, int], Nodes],
    clock: Clock,
) -> FloatArray:
    """Compute the centre of an arm's work [rad]: its nearest postures' median.

    The iteration starts at the start posture. Given configurations leave no choice that could gather around the centre.
    """
    start = np.array(job.start_joints)
    hub: FloatArray = start[model.arms[name].columns]
    stops = [stop for (arm, _, _), stop in nodes.items() if arm == name and len(stop.work)]
    for _ in range(NODES.hub_rounds if stops else 0):
        nearest = []
        for stop in stops:
            rows = np.arange(len(stop.work))
            nearest.append(
                stop.q_approach[
                    int(stop_costs(stop, rows, hub, clock.arms[name].law.duration).argmin())
                ]
            )
        hub = np.median(nearest, axis=0)
    return hub


def stop_costs(nodes: Nodes, rows: IntArray, start: FloatArray, duration: object) -> FloatArray:
    """Estimate each posture's time [s]: transfer to it, work, and return."""
    assert callable(duration)
    costs: FloatArray = (
        duration(nodes.q_approach[rows] - start)
        + nodes.work[rows]
        + duration(start - nodes.q_retract[rows])
    )
    return costs


def spread(ends: FloatArray, cost: FloatArray, most: int, duration: object) -> IntArray:
    """Select the cheapest postures with a minimum distance, at most `most`."""
    assert callable(duration)
    order = np.argsort(cost, kind="stable")
    selected: list[int] = []
    for k in order.tolist():
        if len(selected) == most or (
            cost[k] > cost[order[0]] + NODES.max_extra_cost and most != NODES.most_given
        ):
            break
        if (
            selected
            and most != NODES.most_given
            and duration(ends[selected] - ends[k]).min() < NODES.min_distance
        ):
            continue
        selected.append(k)
    return np.array(selected, dtype=np.int64)


def widened(arm: ArmTasks, width: int) -> ArmTasks:
    """Pad the options of tasks to a width, with infeasible ones."""
    missing = width - arm.options
    if missing == 0:
        return arm
    pad = ((0, 0), (0, missing))
    entry = np.pad(arm.entry, (*pad, (0, 0)), constant_values=np.nan)
    leaving = np.pad(arm.leaving, (*pad, (0, 0)), constant_values=np.nan)
    first = np.pad(arm.first, pad, constant_values=np.inf)
    second = np.pad(arm.second, pad)
    return replace(arm, entry=entry, leaving=leaving, first=first, second=second)


@dataclass(frozen=True)
class OrderModel:
    """Tasks of a job as each arm can do them, at every platform angle."""

    model: CellModel
    """Kinematics of the cell."""
    job: Job
    """Job whose arms and order are open."""
    angles: FloatArray
    """Platform angles [rad], shape (f, k), the start first."""
    nodes: Mapping[tuple[str, int, int], Nodes]
    """Postures by arm, task and number of the stop."""
    clearance: CellClearance | None
    """Required clearances; None without collision checks."""
    clock: Clock
    """Closed-form times."""
    hubs: Mapping[str, FloatArray]
    """Centre of each arm's work [rad]; postures near it are close to each other."""
    tasks: tuple[Task, ...]
    """Tasks of the job, then those that leave or take tools."""

    @classmethod
    def of(cls, model: CellModel, job: Job, *, check_collisions: bool = True) -> OrderModel:
        """Prepare a job.

        Args:
            model: kinematics of the cell.
            job: the open job.
            check_collisions: whether to check collisions.
        """
        angles = platform_angles(model, job)
        tasks = (*job.tasks, *stand_tasks(job.cell))
        nodes = stop_nodes(model, replace(job, tasks=tasks), angles)
        clock = Clock.of(model, job)
        return cls(
            model,
            job,
            angles,
            nodes,
            CellClearance.of(job.cell, job.carried()) if check_collisions else None,
            clock,
            {name: hub(model, job, name, nodes, clock) for name in model.arms},
            tasks,
        )

    def reached(self) -> BoolArray:
        """Test which arm reaches which task from which angle, shape (arms, tasks, f)."""
        reached = np.zeros((len(self.model.arms), len(self.job.tasks), len(self.angles)), np.bool_)
        for a, name in enumerate(self.model.arms):
            for t, task in enumerate(self.job.tasks):
                if not task.allows(name):
                    continue
                reached[a, t] = True
                for s in range(len(task.stops)):
                    reachable = np.zeros(len(self.angles), np.bool_)
                    reachable[self.nodes[name, t, s].angle_index] = True
                    reached[a, t] &= reachable
        return reached

    @property
    def start(self) -> FloatArray:
        """All joints before the motion [rad], shape (n,)."""
        return np.array(self.job.start_joints)

    def problem(self, f: int) -> SequencingProblem:
        """Build the sequencing problem at one platform angle."""
        job = self.job
        turn = float(self.clock.platform_times(self.angles[f] - self.angles[0]))
        index = {task.id: t for t, task in enumerate(job.tasks)}
        arms, leads, tails = [], [], []
        for name in self.model.arms:
            options = [self._options(name, t, f) for t in range(len(job.tasks))]
            arms.append(self._arm(name, options))
            leads.append([task.lead for task in options])
            tails.append([task.tail for task in options])
        lead, tail = np.min(leads, axis=0), np.min(tails, axis=0)
        early = np.array([task.not_before for task in job.tasks])
        late = np.array([task.not_after for task in job.tasks])
        width = max(arm.options for arm in arms)
        return SequencingProblem(
            tuple(widened(arm, width) for arm in arms),
            tuple(len(task.stops) for task in job.tasks),
            job.returns,
            tuple((index[name], t) for t, task in enumerate(job.tasks) for name in task.after),
            tuple(tuple(index[name] for name in row) for row in job.sequences),
            np.maximum(0.0, early - np.where(np.isfinite(lead), lead, 0.0)),
            late + np.where(np.isfinite(tail), tail, 0.0),
            job.order == "given",
            (0.0 if job.start == "free" else turn, turn if job.returns else 0.0),
            job_stores(job),
            stop_lasts(job.tasks, list(self.model.arms), self.nodes, f),
            tuple(self._stands(name, f) for name in self.model.arms)
            if job.cell.tool_changes
            else (),
        )

    def _stands(self, name: str, f: int) -> ToolStands | None:
        """Build an arm's tools and stands at a platform angle.

        None without tool changes.
        """
        cell = self.job.cell
        if name not in cell.tool_changes:
            return None
        number = {tool: k - 1 for k, tool in enumerate(cell.tool_names(name))}
        options = [
            [self._options(name, self.stand(name, tool, action), f) for tool in number if tool]
            for action in ("leave_tool", "take_tool")
        ]
        width = max(1, *(len(stand.first) for row in options for stand in row))
        shape = (2, len(number) - 1, width)
        entry = np.full((*shape, len(self.model.arms[name].columns)), np.nan)
        leaving, work = entry.copy(), np.full(shape, np.inf)
        for action, row in enumerate(options):
            for k, stand in enumerate(row):
                m = len(stand.first)
                entry[action, k, :m], leaving[action, k, :m] = stand.entry, stand.leaving
                work[action, k, :m] = stand.first
        # The tools of tasks that the arm cannot do do not matter.
        tool = [number.get(task.tool, NO_TOOL) for task in self.job.tasks]
        start = number[cell.start_tool(name)]
        return ToolStands(np.array(tool), start, start, entry, leaving, work)

    def stand(self, arm: str, tool: str, action: str) -> int:
        """Look up the task that leaves or takes an arm's tool at its stand."""
        first = len(self.job.tasks)
        return next(
            t
            for t, task in enumerate(self.tasks[first:], start=first)
            if (task.arm, task.tool, task.stops[0].action) == (arm, tool, action)
        )

    def _arm(self, name: str, options: list[TaskOptions]) -> ArmTasks:
        width = max(1, *(len(task.first) for task in options))
        n, joints = len(options), len(self.model.arms[name].columns)
        entry = np.full((n, width, joints), np.nan)
        leaving = np.full((n, width, joints), np.nan)
        first, second = np.full((n, width), np.inf), np.zeros((n, width))
        for t, task in enumerate(options):
            m = len(task.first)
            entry[t, :m], leaving[t, :m] = task.entry, task.leaving
            first[t, :m], second[t, :m] = task.first, task.second
        start = self.start[self.model.arms[name].columns]
        law, free = self.clock.arms[name].law, self.job.start == "free"
        return ArmTasks(entry, leaving, first, second, start, law, free=free)

    def _options(self, name: str, t: int, f: int) -> TaskOptions:
        """Build the options of one arm for a task at a platform angle."""
        task = self.tasks[t]
        joints = len(self.model.arms[name].columns)
        if not task.allows(name):
            return TaskOptions.none(joints)
        given = all(isinstance(stop.target, JointTarget) for stop in task.stops)
        width = next((w for most, w in NODES.options if len(self.job.tasks) <= most), 1)
        rows = [self.rows(name, t, s, f) for s in range(len(task.stops))]
        if any(len(row) == 0 for row in rows):
            return TaskOptions.none(joints)
        law = self.clock.arms[name].law
        nodes = [self.nodes[name, t, s] for s in range(len(task.stops))]
        start = self.start[self.model.arms[name].columns]
        first, k = nodes[0], rows[0]
        lead = float(0.5 * (first.work[k].min() - task.stops[0].dwell.total))
        last = nodes[-1].work[rows[-1]].min() - task.stops[-1].dwell.total
        if len(nodes) == 1:
            cost = stop_costs(first, k, start, law.duration)
            selected = k[
                spread(
                    first.q_approach[k],
                    cost,
                    width if not given else NODES.most_given,
                    law.duration,
                )
            ]
            return TaskOptions(
                first.q_approach[selected],
                first.q_retract[selected],
                first.work[selected],
                np.zeros(len(selected)),
                lead,
                float(0.5 * last),
            )
        second, m = nodes[1], rows[1]
        seconds = (
            law.duration(second.q_approach[m][None] - first.q_retract[k][:, None]) + second.work[m]
        )
        i, j = (x.ravel() for x in np.meshgrid(np.arange(len(k)), np.arange(len(m)), indexing="ij"))
        ends = np.concatenate([first.q_approach[k[i]], second.q_retract[m[j]]], axis=1)
        cost = (
            law.duration(first.q_approach[k[i]] - start)
            + first.work[k[i]]
            + seconds[i, j]
            + law.duration(start - second.q_retract[m[j]])
        )

        def distance(difference: FloatArray) -> FloatArray:
            half = difference.shape[-1] // 2
            return np.maximum(
                law.duration(difference[..., :half]), law.duration(difference[..., half:])
            )

        selected = spread(ends, cost, width if not given else NODES.most_given, distance)
        return TaskOptions(
            first.q_approach[k[i[selected]]],
            second.q_retract[m[j[selected]]],
            first.work[k[i[selected]]],
            seconds[i[selected], j[selected]],
            lead,
            float(0.5 * last),
        )

    def costs(self, name: str, nodes: Nodes) -> FloatArray:
        """Estimate the cost of one arm's postures at a stop [s], shape (N,)."""
        law = self.clock.arms[name].law
        return stop_costs(nodes, np.arange(len(nodes.angle_index)), self.hubs[name], law.duration)

    def rows(self, name: str, t: int, s: int, f: int) -> IntArray:
        """Select an arm's collision-free postures at a stop, the other arm ignored.

        Given joint configurations are all checked, of other postures the cheapest ones; the result is sorted by cost.
        """
        nodes = self.nodes[name, t, s]
        rows = np.flatnonzero(nodes.angle_index == f)
        if len(rows) == 0:
            return rows
        cost = stop_costs(nodes, rows, self.hubs[name], self.clock.arms[name].law.duration)
        given = isinstance(self.tasks[t].stops[s].target, JointTarget)
        rows = rows[np.argsort(cost, kind="stable")]
        few = rows if given else rows[: NODES.candidates]
        clear = few[self._is_clear(name, t, s, f, nodes, few)]
        if len(clear) or len(few) == len(rows):
            return clear
        others = rows[NODES.candidates :]
        return others[self._is_clear(name, t, s, f, nodes, others)]

    def _is_clear(
        self, name: str, t: int, s: int, f: int, nodes: Nodes, rows: IntArray
    ) -> BoolArray:
        if self.clearance is None:
            return np.ones(len(rows), dtype=np.bool_)
        places = np.concatenate(
            [nodes.q_approach[rows], nodes.q_target[rows], nodes.q_retract[rows]]
        )
        angle, held = np.full(len(places), f), np.repeat(self.held(t, s), len(rows))
        return self.is_clear(name, places, angle, held)

    def held(self, t: int, s: int) -> tuple[int, int, int]:
        """List the part held at approach start, target and retract end."""
        assert self.clearance is not None  # callers have looked
        number, task = self.clearance.loads.number, self.tasks[t]
        action = task.stops[s].action
        before, after = task.held_before(action), task.held_after(action)
        return number(before), number(before, on_line=True), number(after)

    def is_clear(self, name: str, places: FloatArray, angle: IntArray, held: IntArray) -> BoolArray:
        """Test which stops are collision-free but for the other arm, shape (n,).

        Args:
            name: the arm.
            places: joints at the start of approaches, at targets, and at the end of retracts, shape (3 n, joints).
            angle: number of the platform angle of each, shape (3 n,).
            held: part held at each place, shape (3 n,).
        """
        assert self.clearance is not None  # callers have looked
        position = np.tile(self.start, (len(places), 1))
        position[:, self.model.platform_columns] = self.angles[angle]
        position[:, self.model.arms[name].columns] = places
        margins = self.clearance.arm_margins(self.clearance.arms.index(name), position, held)
        return np.asarray((margins >= 0.0).reshape(3, -1).all(axis=0))


def platform_angles(model: CellModel, job: Job) -> FloatArray:
    """Sample platform angles for the search [rad], shape (f, k), start first.

    One angle if the platform cannot be moved. A platform without limits is turned by at most half a turn to either
    side; a rail is sampled over its whole range [m].
    """
    start = job.start_joints
    start_angle: FloatArray = np.array(start[model.platform_columns])[None]
    if not model.platform.is_chosen:
        return start_angle
    _, low, high = model.platform_around(start)
    step = model.platform.spacing(NODES.angle_step, low, high)
    below, above = int((start_angle[0, 0] - low) / step), int((high - start_angle[0, 0]) / step)
    others = np.delete(np.arange(-below, above + 1), below)
    return np.concatenate([start_angle, start_angle + step * others[:, None]])


def stop_nodes(model: CellModel, job: Job, angles: FloatArray) -> dict[tuple[str, int, int], Nodes]:
    """Sample the postures of every stop, by arm, task and number of the stop.

    Args:
        model: the job's cell.
        job: the open job.
        angles: platform angles, shape (f, k).
    """
    stops = [(t, s, stop) for t, task in enumerate(job.tasks) for s, stop in enumerate(task.stops)]
    problem: SequenceProblem = stops_problem(
        model,
        job,
        {
            name: [stop if job.tasks[t].allows(name) else None for t, _, stop in stops]
            for name in model.arms
        },
    )
    turned = angles[:, 0] if problem.turns else np.zeros(1)
    nodes = {}
    for a, work in enumerate(problem.arms):
        has_arm_angle = work.kinematics.has_arm_angle
        most = NODES.most_nodes if has_arm_angle else NODES.few_nodes * len(turned)
        for k, (t, s, _) in enumerate(stops):
            if work.stops[k] is None:
                continue
            nodes[work.name, t, s] = grid_nodes(problem, a, k, Grid(turned, NODES.arm_angles, most))
    return nodes
