"""From a job that leaves arms and order open to the numbers that orders are searched with."""

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
    """Numbers of postures and candidates that the search for orders samples."""

    similar: float = 0.08
    """Postures of a stop that are nearer to one another than this are one [s]."""
    dearer: float = 0.6
    """Postures that cost more than this beyond the best one's are left out [s]."""
    hub_rounds: int = 2
    """So often the middle of an arm's work is looked for from the one before."""
    most_given: int = 160
    """Most ways of tasks whose targets are joint configurations."""
    arm_angles: int = 12
    """Arm angles around the circle."""
    most_nodes: int = 6000
    """Nodes of one stop over all platform angles at most."""
    few_nodes: int = 24
    """Nodes of one stop and platform angle at most, of arms without closed forms."""
    angle_step: float = np.radians(15.0)
    """Spacing of the platform angles [rad]; of a rail as `PlatformChain.spacing` has it."""
    candidates: int = 16
    """Postures per stop and platform angle that are checked for collisions first.

    The others are checked if all of these collide.
    """
    most_angles: int = 12
    """Platform angles in synchronous stages at most; twice as many up to `few_stops`: better orders are found."""
    few_stops: int = 200
    """Stops up to which twice as many platform angles are sampled."""
    most_lengths: int = 37_000_000
    """Maximum size of one arm's table of stage lengths."""
    options: tuple[tuple[int, ...], ...] = ((12, 6), (40, 4), (120, 2))
    """Ways of every task, by up to how many tasks; one beyond."""


NODES = OrderNodeSettings()


@dataclass(frozen=True)
class TaskOptions:
    """One arm's ways to do one task; m of them."""

    entry: FloatArray
    """Joints where its first approach begins [rad], shape (m, joints)."""
    leaving: FloatArray
    """Joints where its last retract ends [rad], shape (m, joints)."""
    first: FloatArray
    """Time of its first stop, lines and dwell [s], shape (m,)."""
    second: FloatArray
    """Time from there to the end of its second stop [s], 0 for tasks of one stop, shape (m,)."""
    lead: float
    """How long its first line takes at least [s], infinite without any way."""
    tail: float
    """How long its last line takes at least [s], infinite without any way."""

    @classmethod
    def none(cls, joints: int) -> TaskOptions:
        """Returns that there is no way, for an arm of some joints."""
        empty = np.zeros(0)
        return cls(np.zeros((0, joints)), np.zeros((0, joints)), empty, empty, np.inf, np.inf)


def hub(
    model: CellModel,
    job: Job,
    name: str,
    nodes: Mapping[tuple[str, int, int], Nodes],
    clock: Clock,
) -> FloatArray:
    """Returns the joints in the middle of one arm's work [rad]: medians of its stops' postures nearest to them.

    From the start; given configurations have no choice that could gather about it.
    """
    start = np.array(job.start_joints)
    hub: FloatArray = start[model.arms[name].columns]
    own = [one for (arm, _, _), one in nodes.items() if arm == name and len(one.work)]
    for _ in range(NODES.hub_rounds if own else 0):
        nearest = []
        for one in own:
            rows = np.arange(len(one.work))
            nearest.append(
                one.q_approach[
                    int(stop_costs(one, rows, hub, clock.arms[name].law.duration).argmin())
                ]
            )
        hub = np.median(nearest, axis=0)
    return hub


def stop_costs(nodes: Nodes, rows: IntArray, start: FloatArray, duration: object) -> FloatArray:
    """Returns what postures cost about: from the start, the work, and back [s]."""
    assert callable(duration)
    found: FloatArray = (
        duration(nodes.q_approach[rows] - start)
        + nodes.work[rows]
        + duration(start - nodes.q_retract[rows])
    )
    return found


def spread(ends: FloatArray, cost: FloatArray, most: int, duration: object) -> IntArray:
    """Returns the cheapest postures that are not too near to one another, at most so many."""
    assert callable(duration)
    order = np.argsort(cost, kind="stable")
    kept: list[int] = []
    for k in order.tolist():
        if len(kept) == most or (
            cost[k] > cost[order[0]] + NODES.dearer and most != NODES.most_given
        ):
            break
        if (
            kept
            and most != NODES.most_given
            and duration(ends[kept] - ends[k]).min() < NODES.similar
        ):
            continue
        kept.append(k)
    return np.array(kept, dtype=np.int64)


def widened(arm: ArmTasks, width: int) -> ArmTasks:
    """Returns the same with more ways, which there are not."""
    more = width - arm.options
    if more == 0:
        return arm
    pad = ((0, 0), (0, more))
    entry = np.pad(arm.entry, (*pad, (0, 0)), constant_values=np.nan)
    leaving = np.pad(arm.leaving, (*pad, (0, 0)), constant_values=np.nan)
    first = np.pad(arm.first, pad, constant_values=np.inf)
    second = np.pad(arm.second, pad)
    return replace(arm, entry=entry, leaving=leaving, first=first, second=second)


@dataclass(frozen=True)
class OrderModel:
    """A job's tasks as each arm may do them, from any platform angle."""

    model: CellModel
    """The job's cell."""
    job: Job
    """What is to be done."""
    angles: FloatArray
    """Platform angles, where it starts first [rad], shape (f, k)."""
    nodes: Mapping[tuple[str, int, int], Nodes]
    """Postures by arm, task and number of the stop."""
    clearance: CellClearance | None
    """What has to be collision-free, None where nothing has to."""
    clock: Clock
    """Closed-form times."""
    hubs: Mapping[str, FloatArray]
    """By arm, joints in the middle of its work [rad]: postures near them are near to one another."""
    tasks: tuple[Task, ...]
    """The job's, and after them one for every tool that an arm may leave or take at its stand."""

    @classmethod
    def of(cls, model: CellModel, job: Job, *, clear: bool = True) -> OrderModel:
        """Prepares a job.

        Args:
            model: its cell.
            job: what is to be done.
            clear: whether anything has to be collision-free.
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
            CellClearance.of(job.cell, job.carried()) if clear else None,
            clock,
            {name: hub(model, job, name, nodes, clock) for name in model.arms},
            tasks,
        )

    def reached(self) -> BoolArray:
        """Returns which tasks which arm reaches from which angle, shape (arms, tasks, f)."""
        found = np.zeros((len(self.model.arms), len(self.job.tasks), len(self.angles)), np.bool_)
        for a, name in enumerate(self.model.arms):
            for t, task in enumerate(self.job.tasks):
                if not task.allows(name):
                    continue
                found[a, t] = True
                for s in range(len(task.stops)):
                    there = np.zeros(len(self.angles), np.bool_)
                    there[self.nodes[name, t, s].angle_index] = True
                    found[a, t] &= there
        return found

    @property
    def start(self) -> FloatArray:
        """All joints before the motion [rad], shape (n,)."""
        return np.array(self.job.start_joints)

    def problem(self, f: int) -> SequencingProblem:
        """Returns the tasks with the platform standing at one of the angles."""
        job = self.job
        turn = float(self.clock.platform_times(self.angles[f] - self.angles[0]))
        index = {task.id: t for t, task in enumerate(job.tasks)}
        arms, least, most = [], [], []
        for name in self.model.arms:
            ways = [self._options(name, t, f) for t in range(len(job.tasks))]
            arms.append(self._arm(name, ways))
            least.append([one.lead for one in ways])
            most.append([one.tail for one in ways])
        lead, tail = np.min(least, axis=0), np.min(most, axis=0)
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
        """Returns what changing tools is to one arm with the platform at an angle; None where it changes none."""
        cell = self.job.cell
        if name not in cell.tool_changes:
            return None
        number = {tool: k - 1 for k, tool in enumerate(cell.tool_names(name))}
        ways = [
            [self._options(name, self.stand(name, tool, action), f) for tool in number if tool]
            for action in ("leave_tool", "take_tool")
        ]
        width = max(1, *(len(one.first) for row in ways for one in row))
        shape = (2, len(number) - 1, width)
        entry = np.full((*shape, len(self.model.arms[name].columns)), np.nan)
        leaving, work = entry.copy(), np.full(shape, np.inf)
        for action, row in enumerate(ways):
            for k, one in enumerate(row):
                m = len(one.first)
                entry[action, k, :m], leaving[action, k, :m] = one.entry, one.leaving
                work[action, k, :m] = one.first
        # Of what an arm does not do the tool does not matter.
        tool = [number.get(task.tool, NO_TOOL) for task in self.job.tasks]
        start = number[cell.start_tool(name)]
        return ToolStands(np.array(tool), start, start, entry, leaving, work)

    def stand(self, arm: str, tool: str, action: str) -> int:
        """Returns the number of the task that is to leave or to take an arm's tool at its stand."""
        first = len(self.job.tasks)
        return next(
            t
            for t, task in enumerate(self.tasks[first:], start=first)
            if (task.arm, task.tool, task.stops[0].action) == (arm, tool, action)
        )

    def _arm(self, name: str, ways: list[TaskOptions]) -> ArmTasks:
        width = max(1, *(len(one.first) for one in ways))
        n, joints = len(ways), len(self.model.arms[name].columns)
        entry = np.full((n, width, joints), np.nan)
        leaving = np.full((n, width, joints), np.nan)
        first, second = np.full((n, width), np.inf), np.zeros((n, width))
        for t, one in enumerate(ways):
            m = len(one.first)
            entry[t, :m], leaving[t, :m] = one.entry, one.leaving
            first[t, :m], second[t, :m] = one.first, one.second
        start = self.start[self.model.arms[name].columns]
        law, free = self.clock.arms[name].law, self.job.start == "free"
        return ArmTasks(entry, leaving, first, second, start, law, free=free)

    def _options(self, name: str, t: int, f: int) -> TaskOptions:
        """Returns the ways of one arm to do a task with the platform at an angle."""
        task = self.tasks[t]
        joints = len(self.model.arms[name].columns)
        if not task.allows(name):
            return TaskOptions.none(joints)
        given = all(isinstance(stop.target, JointTarget) for stop in task.stops)
        few = next((w for most, w in NODES.options if len(self.job.tasks) <= most), 1)
        rows = [self.rows(name, t, s, f) for s in range(len(task.stops))]
        if any(len(row) == 0 for row in rows):
            return TaskOptions.none(joints)
        law = self.clock.arms[name].law
        nodes = [self.nodes[name, t, s] for s in range(len(task.stops))]
        start = self.start[self.model.arms[name].columns]
        one, k = nodes[0], rows[0]
        lead = float(0.5 * (one.work[k].min() - task.stops[0].dwell.total))
        last = nodes[-1].work[rows[-1]].min() - task.stops[-1].dwell.total
        if len(nodes) == 1:
            cost = stop_costs(one, k, start, law.duration)
            kept = k[
                spread(
                    one.q_approach[k], cost, few if not given else NODES.most_given, law.duration
                )
            ]
            return TaskOptions(
                one.q_approach[kept],
                one.q_retract[kept],
                one.work[kept],
                np.zeros(len(kept)),
                lead,
                float(0.5 * last),
            )
        other, m = nodes[1], rows[1]
        way = law.duration(other.q_approach[m][None] - one.q_retract[k][:, None]) + other.work[m]
        i, j = (x.ravel() for x in np.meshgrid(np.arange(len(k)), np.arange(len(m)), indexing="ij"))
        ends = np.concatenate([one.q_approach[k[i]], other.q_retract[m[j]]], axis=1)
        cost = (
            law.duration(one.q_approach[k[i]] - start)
            + one.work[k[i]]
            + way[i, j]
            + law.duration(start - other.q_retract[m[j]])
        )

        def apart(moved: FloatArray) -> FloatArray:
            half = moved.shape[-1] // 2
            return np.maximum(law.duration(moved[..., :half]), law.duration(moved[..., half:]))

        kept = spread(ends, cost, few if not given else NODES.most_given, apart)
        return TaskOptions(
            one.q_approach[k[i[kept]]],
            other.q_retract[m[j[kept]]],
            one.work[k[i[kept]]],
            way[i[kept], j[kept]],
            lead,
            float(0.5 * last),
        )

    def costs(self, name: str, nodes: Nodes) -> FloatArray:
        """Returns what one arm's postures at a stop cost about [s], shape (N,)."""
        law = self.clock.arms[name].law
        return stop_costs(nodes, np.arange(len(nodes.angle_index)), self.hubs[name], law.duration)

    def rows(self, name: str, t: int, s: int, f: int) -> IntArray:
        """Returns the postures of one arm at a stop, seen from an angle, that are clear of all but the other arm.

        Given joint configurations are all looked at; of postures the cheapest ones, cheapest first.
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
        """Returns what an arm holds where an approach begins, at the target, and where the retract ends."""
        assert self.clearance is not None  # callers have looked
        number, task = self.clearance.loads.number, self.tasks[t]
        action = task.stops[s].action
        came, goes = task.held_before(action), task.held_after(action)
        return number(came), number(came, on_line=True), number(goes)

    def is_clear(self, name: str, places: FloatArray, angle: IntArray, held: IntArray) -> BoolArray:
        """Returns which stops are clear of all but the other arm, shape (n,).

        Args:
            name: the arm.
            places: its joints where all approaches begin, at targets, and where retracts end, shape (3 n, joints).
            angle: number of the platform angle of each, shape (3 n,).
            held: what is held at each, shape (3 n,).
        """
        assert self.clearance is not None  # callers have looked
        position = np.tile(self.start, (len(places), 1))
        position[:, self.model.platform_columns] = self.angles[angle]
        position[:, self.model.arms[name].columns] = places
        margins = self.clearance.own_margins(self.clearance.arms.index(name), position, held)
        return np.asarray((margins >= 0.0).reshape(3, -1).all(axis=0))


def platform_angles(model: CellModel, job: Job) -> FloatArray:
    """Returns the platform angles that orders are looked at with, where it starts first [rad], shape (f, k).

    One where it cannot be moved. A platform without limits is turned by half a turn each way at most; a rail is looked
    at in all of its range [m].
    """
    start = job.start_joints
    here: FloatArray = np.array(start[model.platform_columns])[None]
    if not model.platform.is_chosen:
        return here
    _, low, high = model.platform_around(start)
    step = model.platform.spacing(NODES.angle_step, low, high)
    below, above = int((here[0, 0] - low) / step), int((high - here[0, 0]) / step)
    others = np.delete(np.arange(-below, above + 1), below)
    return np.concatenate([here, here + step * others[:, None]])


def stop_nodes(model: CellModel, job: Job, angles: FloatArray) -> dict[tuple[str, int, int], Nodes]:
    """Returns the postures of every arm at every stop that it may make, by arm, task and number of the stop.

    Args:
        model: the job's cell.
        job: what is to be done.
        angles: platform angles, shape (f, k).
    """
    every = [(t, s, stop) for t, task in enumerate(job.tasks) for s, stop in enumerate(task.stops)]
    problem: SequenceProblem = stops_problem(
        model,
        job,
        {
            name: [stop if job.tasks[t].allows(name) else None for t, _, stop in every]
            for name in model.arms
        },
    )
    turned = angles[:, 0] if problem.turns else np.zeros(1)
    found = {}
    for a, work in enumerate(problem.arms):
        has_arm_angle = work.kinematics.has_arm_angle
        most = NODES.most_nodes if has_arm_angle else NODES.few_nodes * len(turned)
        for k, (t, s, _) in enumerate(every):
            if work.stops[k] is None:
                continue
            found[work.name, t, s] = grid_nodes(problem, a, k, Grid(turned, NODES.arm_angles, most))
    return found
