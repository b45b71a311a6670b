"""Stage problem of an open job: postures by arm, stop, platform angle.

Each arm has a single posture there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.orders.model.buffer_numbers import job_stores
from dualarm_cli.orders.model.meeting import handovers_of, meeting_costs, pair_handover_postures
from dualarm_cli.orders.model.order_model import NODES, OrderModel
from dualarm_cli.orders.paired.changes import StageStands, StageTools
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.orders.rules.tool_stands import NO_TOOL
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.candidates import Nodes
from dualarm_cli.stages.plans.problem import ArmDecisions, Decisions

WIDTHS = (1, 1, 2, 4, 8, 16)
"""Further postures per stop and angle that each round checks; the last number repeats."""


def cheapest_postures(
    order: OrderModel, name: str, stops: Sequence[tuple[int, int]], angles: IntArray
) -> IntArray:
    """Find the cheapest collision-free posture by stop and angle, rows, (s, f).

    -1 for none.

    The first row of `OrderModel.rows` each, computed in rounds for all stops and angles together.

    Args:
        order: the job's tasks.
        name: the arm.
        stops: task and number of every stop.
        angles: numbers of the platform angles, shape (f,).
    """
    nodes = [order.nodes.get((name, t, s)) for t, s in stops]
    rows, first, last = _by_cost(order, name, nodes, angles)
    best = np.full(len(stops) * len(angles), -1)
    stop, angle = (x.ravel() for x in np.indices((len(stops), len(angles))))
    remaining = np.flatnonzero(first < last)
    checked = first.copy()
    for width in (*WIDTHS, *[WIDTHS[-1]] * (int((last - first).max(initial=0)) // WIDTHS[-1])):
        count = np.minimum(width, last[remaining] - checked[remaining])
        place = np.repeat(remaining, count)
        nth = np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)
        candidates = rows[checked[place] + nth]
        clear = _clear(order, name, stops, stop[place], angles[angle[place]], candidates)
        # Assign in reverse order: the cheapest one is assigned last.
        best[place[clear][::-1]] = candidates[clear][::-1]
        checked[remaining] += count
        remaining = remaining[(best[remaining] < 0) & (checked[remaining] < last[remaining])]
        if not len(remaining):
            break
    return best.reshape(len(stops), len(angles))


def _by_cost(
    order: OrderModel, name: str, nodes: Sequence[Nodes | None], angles: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Sort stops' nodes by angle and cost: rows and ranges, shape (s f,).

    Both have this shape.
    """
    rows, first, last = [np.zeros(0, dtype=np.int64)], [], []
    begin = 0
    for stop_nodes in nodes:
        if stop_nodes is None:
            first.append(np.full(len(angles), begin))
            last.append(np.full(len(angles), begin))
            continue
        ranked = np.lexsort((order.costs(name, stop_nodes), stop_nodes.angle_index))
        sorted_angles = stop_nodes.angle_index[ranked]
        rows.append(ranked)
        first.append(begin + np.searchsorted(sorted_angles, angles, side="left"))
        last.append(begin + np.searchsorted(sorted_angles, angles, side="right"))
        begin += len(ranked)
    return np.concatenate(rows), np.concatenate(first), np.concatenate(last)


def _clear(
    order: OrderModel,
    name: str,
    stops: Sequence[tuple[int, int]],
    stop: IntArray,
    angle: IntArray,
    rows: IntArray,
) -> BoolArray:
    """Test whether postures of stops are collision-free; `stop` must be ascending."""
    if order.clearance is None or not len(rows):
        return np.ones(len(rows), dtype=np.bool_)
    places: list[list[FloatArray]] = [[], [], []]
    held = np.zeros((3, len(rows)), dtype=np.int64)
    edges = np.flatnonzero(np.diff(stop, prepend=-1, append=len(stops)))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        k = int(stop[begin])
        stop_nodes = order.nodes[name, *stops[k]]
        for place, table in zip(
            places, (stop_nodes.q_approach, stop_nodes.q_target, stop_nodes.q_retract), strict=True
        ):
            place.append(table[rows[begin:end]])
        held[:, begin:end] = np.array(order.held(*stops[k]))[:, None]
    joined = np.concatenate([table for place in places for table in place])
    return order.is_clear(name, joined, np.tile(angle, 3), held.ravel())


@dataclass(frozen=True)
class StageModel:
    """Stage problem of a job, with the stops, angles and postures behind its numbers."""

    problem: StageProblem
    """Stage problem: the job's tasks, then leaving and taking tools at stands."""
    stops: tuple[tuple[int, int], ...]
    """Task and number of every stop."""
    angles: FloatArray
    """Platform angles [rad], shape (f, k)."""
    rows: tuple[IntArray, ...]
    """Rows of stops' nodes by angle and arm, (s, f), -1 for none."""

    def decisions(self, order: OrderModel, stage_order: StageOrder) -> Decisions | None:
        """Convert an order to the decisions of the search over the whole sequence.

        None if an arm has no closed form, or if both arms are on a platform with several joints.

        Args:
            order: tasks of the job as each arm can do them.
            stage_order: order of the job's own stops.
        """
        if self.angles.shape[1] > 1:
            return None
        arms = []
        for a, (name, rows) in enumerate(zip(order.model.arms, self.rows, strict=True)):
            start = order.start[order.model.arms[name].columns]
            decided = ArmDecisions.idle(start, len(stage_order.slots))
            for k, (stop, angle) in enumerate(
                zip(stage_order.slots[:, a], stage_order.angles, strict=True)
            ):
                if stop == IDLE:
                    continue
                if not order.model.arms[name].kinematics.has_arm_angle:
                    return None
                node_decisions = order.nodes[name, *self.stops[stop]].decisions
                decided = decided.put(
                    np.array([k]), node_decisions.take(np.array([rows[stop, angle]]))
                )
            arms.append(decided)
        chosen = order.model.platform.is_chosen
        angle = self.angles[stage_order.angles, 0] if chosen else np.zeros(len(stage_order.slots))
        return Decisions(np.asarray(angle), tuple(arms))


def stage_problem(order: OrderModel) -> StageProblem:
    """Build the stage problem of a job, see `stage_model`."""
    return stage_model(order).problem


def stage_model(order: OrderModel) -> StageModel:
    """Build the stage problem of a job, with its stops, angles and postures.

    Args:
        order: the job's tasks as each arm may do them.
    """
    job, model = order.job, order.model
    stops = [(t, s) for t, task in enumerate(order.tasks) for s in range(len(task.stops))]
    angles = _few_angles(order, len(stops))
    f, count = len(angles), len(stops)
    works, chosen = [], []
    turn = order.clock.platform_times(
        order.angles[angles][None, :, :] - order.angles[angles][:, None, :]
    )
    cheapest = [cheapest_postures(order, name, stops, angles) for name in model.arms]
    postures = pair_handover_postures(order, stops, angles, cheapest)
    for name, stop_rows in zip(model.arms, postures, strict=True):
        joints = len(model.arms[name].columns)
        target = np.full((count, f, joints), np.nan)
        entry = np.full((count, f, joints), np.nan)
        leaving = np.full((count, f, joints), np.nan)
        work = np.full((count, f), np.inf)
        for k, (t, s) in enumerate(stops):
            seen = np.flatnonzero(stop_rows[k] >= 0)
            if len(seen):
                nodes, rows = order.nodes[name, t, s], stop_rows[k, seen]
                entry[k, seen], target[k, seen] = nodes.q_approach[rows], nodes.q_target[rows]
                leaving[k, seen], work[k, seen] = nodes.q_retract[rows], nodes.work[rows]
        works.append(work)
        chosen.append(np.stack([entry, target, leaving]))
    handovers = handovers_of(order)
    works = _with_partner_work(works, stops, handovers)
    lengths = [
        _lengths(
            order,
            name,
            ends[0],
            _fill_unreachable(ends[2], order.angles[angles]),
            work,
            turn,
        )
        for name, ends, work in zip(model.arms, chosen, works, strict=True)
    ]
    index = {task.id: t for t, task in enumerate(job.tasks)}
    numbers, k = [], 0
    for task in order.tasks:
        numbers.append(tuple(range(k, k + len(task.stops))))
        k += len(task.stops)
    problem = StageProblem(
        tuple(lengths),
        tuple(works),
        turn,
        tuple(numbers),
        job.returns,
        job.start == "free",
        tuple((index[name], t) for t, task in enumerate(job.tasks) for name in task.after),
        tuple(tuple(index[name] for name in row) for row in job.sequences),
        *_windows(order, numbers, works),
        job.order == "given",
        handovers,
        meeting_costs(order, stops, chosen),
        job_stores(replace(job, tasks=order.tasks)),
    )
    return StageModel(problem, tuple(stops), order.angles[angles], tuple(postures))


def stage_stands(order: OrderModel, whole: StageProblem) -> StageStands | None:
    """Number the stops that leave and take each tool.

    None if no arm changes tools.

    Args:
        order: the job's tasks as each arm may do them.
        whole: its stages, see `stage_problem`.
    """
    cell = order.job.cell
    if not cell.tool_changes:
        return None
    tools_by_arm: list[StageTools | None] = []
    for name in order.model.arms:
        if name not in cell.tool_changes:
            tools_by_arm.append(None)
            continue
        number = {tool: k - 1 for k, tool in enumerate(cell.tool_names(name))}
        leave, take = (
            {
                k: whole.tasks[order.stand(name, tool, action)][0]
                for tool, k in number.items()
                if tool
            }
            for action in ("leave_tool", "take_tool")
        )
        # The tools of tasks that the arm cannot do do not matter.
        tools = [number.get(task.tool, NO_TOOL) for task in order.job.tasks for _ in task.stops]
        tools_by_arm.append(StageTools(tuple(tools), number[cell.start_tool(name)], leave, take))
    return StageStands(whole, tuple(tools_by_arm))


def _with_partner_work(
    works: list[FloatArray],
    stops: list[tuple[int, int]],
    handovers: tuple[tuple[int, int], ...],
) -> list[FloatArray]:
    """Add the partner's work to the works (s, f) of hand-over stops [s]."""
    totals = [np.array(work) for work in works]
    for giving, taking in handovers:
        give, take = stops.index((giving, 1)), stops.index((taking, 0))
        for a, work in enumerate(totals):
            work[give] += works[1 - a][take]
            work[take] += works[1 - a][give]
    return totals


def _few_angles(order: OrderModel, stops: int) -> IntArray:
    """Select evenly spaced useful platform angles within table size, the start first."""
    reached = order.reached().any(axis=(0, 1))
    useful = np.flatnonzero(reached)
    preferred = NODES.most_angles * (2 if stops <= NODES.few_stops else 1)
    limit = min(preferred, max(3, int(np.sqrt(NODES.most_lengths / ((stops + 1) * (stops + 2))))))
    if len(useful) >= limit:
        by_angle = (
            useful[np.argsort(order.angles[useful, 0], kind="stable")]
            if order.angles.size
            else useful
        )
        useful = by_angle[np.unique(np.linspace(0, len(useful) - 1, limit - 1).round().astype(int))]
    return np.concatenate([[0], np.sort(useful[useful != 0])])


def _fill_unreachable(leaving: FloatArray, angles: FloatArray) -> FloatArray:
    """Fill retract-end joints from the nearest reachable angle, shape (s, f, joints).

    An arm that is idle while the platform turns keeps the joints of its last stop, which may be out of reach from the
    new angle. Stops that are made at that angle are not affected: they are infeasible there.

    Args:
        leaving: joints at retract ends, NaN for stops out of reach.
        angles: platform angles [rad], shape (f, k).
    """
    away = np.abs(angles[:, None] - angles[None]).max(axis=-1, initial=0.0)
    out = np.isnan(leaving[..., 0])
    distance = np.where(out[:, None, :], np.inf, away)
    nearest = distance.argmin(axis=-1)
    return np.take_along_axis(leaving, nearest[..., None], axis=1)


def _lengths(
    order: OrderModel,
    name: str,
    entry: FloatArray,
    leaving: FloatArray,
    work: FloatArray,
    turn: FloatArray,
) -> FloatArray:
    """Compute one arm's lengths of stages, see StageProblem.length.

    With a free start an arm begins where its first transfer would end and returns there: the first transfer takes no
    time, and the return counts as the shortest transfer to any stop.
    """
    count, f = work.shape
    free = order.job.start == "free"
    start = order.start[order.model.arms[name].columns]
    whole = order.clock.arms[name].law
    # Long rows of a single joint are several times faster.
    laws = _single_joints(whole)
    goals = np.ascontiguousarray(np.moveaxis(entry, 2, 0))[:, :, None, :, None]
    lengths = np.full((count + 1, count + 2, f, f), np.inf, dtype=np.float32)
    for i in range(count + 1):
        leaving_joints = np.broadcast_to(start, (f, len(start))) if i == count else leaving[i]
        transfer: FloatArray = np.zeros((count, f, f, 1))
        for law, goal, joint_angle in zip(laws, goals, leaving_joints.T, strict=True):
            np.maximum(transfer, law.per_joint(goal - joint_angle[:, None, None]), out=transfer)
        if free and i == count:
            transfer[np.isfinite(transfer)] = 0.0
        lengths[i, :count] = np.maximum(transfer[..., 0], turn) + work[:, None, :]
        returning = whole.duration(start - leaving_joints) if order.job.returns else np.zeros(f)
        if free and order.job.returns:
            returning = np.fmin(returning, np.fmin.reduce(transfer[..., 0], axis=(0, 2)))
        lengths[i, count] = returning[:, None]
    lengths[:, count + 1] = -np.inf
    return np.where(np.isnan(lengths), np.float32(np.inf), lengths)


def _single_joints(law: RestToRest) -> list[RestToRest]:
    """Split a law into the laws of single joints."""
    rows = zip(law.velocity, law.acceleration, law.jerk, strict=True)
    return [RestToRest(*(np.array([value]) for value in row)) for row in rows]


def _windows(
    order: OrderModel, numbers: list[tuple[int, ...]], works: list[FloatArray]
) -> tuple[FloatArray | None, FloatArray | None]:
    """Compute stops' earliest approach and latest end [s].

    None without windows.

    A window holds for the instant at which the tool is at its target. The two lines of a stop are assumed to take equal
    times.
    """
    tasks = order.tasks
    if not order.job.moves and all(
        task.not_before == 0.0 and np.isinf(task.not_after) for task in tasks
    ):
        return None, None
    count = sum(len(row) for row in numbers)
    early, late = np.zeros(count), np.full(count, np.inf)
    for task, row in zip(tasks, numbers, strict=True):
        for k, stop in zip(row, task.stops, strict=True):
            line = 0.5 * max(0.0, min(float(work[k].min()) for work in works) - stop.dwell.total)
            if k == row[0]:
                early[k] = max(0.0, task.not_before - line)
            if k == row[-1]:
                late[k] = task.not_after + line
            if stop.moves:
                first, last = stop.window
                early[k], late[k] = max(early[k], first - line), min(late[k], last + line)
    return early, late
