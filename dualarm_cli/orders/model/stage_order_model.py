"""From a job that leaves arms and order open to stages as numbers: one posture of each arm at each stop and angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.model.rest_to_rest import RestToRest
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
"""So many more postures of every stop and angle are looked at in each round; in the end the last number again."""


def cheapest_postures(
    order: OrderModel, name: str, stops: Sequence[tuple[int, int]], angles: IntArray
) -> IntArray:
    """Returns the row of the cheapest collision-free posture of each stop's nodes, -1 for none, shape (s, f).

    The first of `OrderModel.rows` each; what these find for one stop and one angle is looked for in rounds for all.

    Args:
        order: the job's tasks.
        name: the arm.
        stops: task and number of every stop.
        angles: numbers of the platform angles, shape (f,).
    """
    nodes = [order.nodes.get((name, t, s)) for t, s in stops]
    rows, first, last = _by_cost(order, name, nodes, angles)
    found = np.full(len(stops) * len(angles), -1)
    stop, angle = (x.ravel() for x in np.indices((len(stops), len(angles))))
    left = np.flatnonzero(first < last)
    done = first.copy()
    for width in (*WIDTHS, *[WIDTHS[-1]] * (int((last - first).max(initial=0)) // WIDTHS[-1])):
        count = np.minimum(width, last[left] - done[left])
        place = np.repeat(left, count)
        nth = np.arange(len(place)) - np.repeat(np.cumsum(count) - count, count)
        tried = rows[done[place] + nth]
        clear = _clear(order, name, stops, stop[place], angles[angle[place]], tried)
        # Backwards, so that the cheapest one of each is what remains.
        found[place[clear][::-1]] = tried[clear][::-1]
        done[left] += count
        left = left[(found[left] < 0) & (done[left] < last[left])]
        if not len(left):
            break
    return found.reshape(len(stops), len(angles))


def _by_cost(
    order: OrderModel, name: str, nodes: Sequence[Nodes | None], angles: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Returns rows of nodes by stop, angle and cost, and which of them are each stop's and angle's, (s f,) each."""
    rows, first, last = [np.zeros(0, dtype=np.int64)], [], []
    begin = 0
    for own in nodes:
        if own is None:
            first.append(np.full(len(angles), begin))
            last.append(np.full(len(angles), begin))
            continue
        ranked = np.lexsort((order.costs(name, own), own.angle_index))
        sorted_angles = own.angle_index[ranked]
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
    """Returns whether postures of stops are collision-free; `stop` is in rising order."""
    if order.clearance is None or not len(rows):
        return np.ones(len(rows), dtype=np.bool_)
    places: list[list[FloatArray]] = [[], [], []]
    held = np.zeros((3, len(rows)), dtype=np.int64)
    edges = np.flatnonzero(np.diff(stop, prepend=-1, append=len(stops)))
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        k = int(stop[begin])
        own = order.nodes[name, *stops[k]]
        for place, table in zip(places, (own.q_approach, own.q_target, own.q_retract), strict=True):
            place.append(table[rows[begin:end]])
        held[:, begin:end] = np.array(order.held(*stops[k]))[:, None]
    joined = np.concatenate([table for place in places for table in place])
    return order.is_clear(name, joined, np.tile(angle, 3), held.ravel())


@dataclass(frozen=True)
class StageModel:
    """A job's stages as numbers, and what the numbers mean."""

    problem: StageProblem
    """The numbers; behind the job's tasks are those that leave and take tools at their stands."""
    stops: tuple[tuple[int, int], ...]
    """Task and number of every stop."""
    angles: FloatArray
    """Platform angles [rad], shape (f, k)."""
    rows: tuple[IntArray, ...]
    """By arm, each stop's posture at every angle among its nodes, -1 for none, shape (s, f)."""

    def decisions(self, order: OrderModel, found: StageOrder) -> Decisions | None:
        """Returns an order's stages as the search over the whole sequence writes them down.

        None where an arm has no closed form, or a platform of several joints carries both.

        Args:
            order: the job's tasks as each arm may do them.
            found: the order, of the job's own stops.
        """
        if self.angles.shape[1] > 1:
            return None
        arms = []
        for a, (name, rows) in enumerate(zip(order.model.arms, self.rows, strict=True)):
            start = order.start[order.model.arms[name].columns]
            own = ArmDecisions.idle(start, len(found.slots))
            for k, (stop, angle) in enumerate(zip(found.slots[:, a], found.angles, strict=True)):
                if stop == IDLE:
                    continue
                if not order.model.arms[name].kinematics.has_arm_angle:
                    return None
                made = order.nodes[name, *self.stops[stop]].decisions
                own = own.put(np.array([k]), made.take(np.array([rows[stop, angle]])))
            arms.append(own)
        chosen = order.model.platform.is_chosen
        angle = self.angles[found.angles, 0] if chosen else np.zeros(len(found.slots))
        return Decisions(np.asarray(angle), tuple(arms))


def stage_problem(order: OrderModel) -> StageProblem:
    """Returns the stages as numbers, see `stage_model`."""
    return stage_model(order).problem


def stage_model(order: OrderModel) -> StageModel:
    """Returns the stages as numbers with what they mean.

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
    for name, rows_of in zip(model.arms, postures, strict=True):
        joints = len(model.arms[name].columns)
        target = np.full((count, f, joints), np.nan)
        entry = np.full((count, f, joints), np.nan)
        leaving = np.full((count, f, joints), np.nan)
        work = np.full((count, f), np.inf)
        for k, (t, s) in enumerate(stops):
            here = np.flatnonzero(rows_of[k] >= 0)
            if len(here):
                nodes, rows = order.nodes[name, t, s], rows_of[k, here]
                entry[k, here], target[k, here] = nodes.q_approach[rows], nodes.q_target[rows]
                leaving[k, here], work[k, here] = nodes.q_retract[rows], nodes.work[rows]
        works.append(work)
        chosen.append(np.stack([entry, target, leaving]))
    handovers = handovers_of(order)
    works = _met(works, stops, handovers)
    lengths = [
        _lengths(
            order,
            name,
            ways[0],
            _where_idle(ways[2], order.angles[angles]),
            work,
            turn,
        )
        for name, ways, work in zip(model.arms, chosen, works, strict=True)
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
    """Returns which of all stops leave and take which tools; None where no arm changes tools.

    Args:
        order: the job's tasks as each arm may do them.
        whole: its stages, see `stage_problem`.
    """
    cell = order.job.cell
    if not cell.tool_changes:
        return None
    found: list[StageTools | None] = []
    for name in order.model.arms:
        if name not in cell.tool_changes:
            found.append(None)
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
        # Of what an arm does not do the tool does not matter.
        tools = [number.get(task.tool, NO_TOOL) for task in order.job.tasks for _ in task.stops]
        found.append(StageTools(tuple(tools), number[cell.start_tool(name)], leave, take))
    return StageStands(whole, tuple(found))


def _met(
    works: list[FloatArray],
    stops: list[tuple[int, int]],
    handovers: tuple[tuple[int, int], ...],
) -> list[FloatArray]:
    """Returns works (s, f) in which those of two stops that make a hand-over follow one another [s]."""
    found = [np.array(work) for work in works]
    for giving, taking in handovers:
        give, take = stops.index((giving, 1)), stops.index((taking, 0))
        for a, work in enumerate(found):
            work[give] += works[1 - a][take]
            work[take] += works[1 - a][give]
    return found


def _few_angles(order: OrderModel, stops: int) -> IntArray:
    """Returns as many angles as tables have room for, the start first, evenly over those at which work can be done."""
    reached = order.reached().any(axis=(0, 1))
    useful = np.flatnonzero(reached)
    few = NODES.most_angles * (2 if stops <= NODES.few_stops else 1)
    most = min(few, max(3, int(np.sqrt(NODES.most_lengths / ((stops + 1) * (stops + 2))))))
    if len(useful) >= most:
        by_angle = (
            useful[np.argsort(order.angles[useful, 0], kind="stable")]
            if order.angles.size
            else useful
        )
        useful = by_angle[np.unique(np.linspace(0, len(useful) - 1, most - 1).round().astype(int))]
    return np.concatenate([[0], np.sort(useful[useful != 0])])


def _where_idle(leaving: FloatArray, angles: FloatArray) -> FloatArray:
    """Returns joints where retracts end with those at the nearest angle where a stop is out of reach (s, f, joints).

    An arm that is idle while the platform turns on stays as it left its last stop, though from there it may be out of
    reach. For stops that are made there nothing changes: they cannot be.

    Args:
        leaving: the same, NaN where a stop is out of reach.
        angles: the platform's [rad], shape (f, k).
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
    """Returns one arm's part of stages, see StageProblem.length.

    Where the start is free an arm begins where its first transfer would end, and goes back there: the way there counts
    nothing, and the way back what it is at least, to any stop.
    """
    count, f = work.shape
    free = order.job.start == "free"
    start = order.start[order.model.arms[name].columns]
    whole = order.clock.arms[name].law
    # Joint by joint, on long rows of numbers, all is several times quicker.
    laws = _single_joints(whole)
    goals = np.ascontiguousarray(np.moveaxis(entry, 2, 0))[:, :, None, :, None]
    found = np.full((count + 1, count + 2, f, f), np.inf, dtype=np.float32)
    for i in range(count + 1):
        came = np.broadcast_to(start, (f, len(start))) if i == count else leaving[i]
        transfer: FloatArray = np.zeros((count, f, f, 1))
        for law, goal, here in zip(laws, goals, came.T, strict=True):
            np.maximum(transfer, law.per_joint(goal - here[:, None, None]), out=transfer)
        if free and i == count:
            transfer[np.isfinite(transfer)] = 0.0
        found[i, :count] = np.maximum(transfer[..., 0], turn) + work[:, None, :]
        back = whole.duration(start - came) if order.job.returns else np.zeros(f)
        if free and order.job.returns:
            back = np.fmin(back, np.fmin.reduce(transfer[..., 0], axis=(0, 2)))
        found[i, count] = back[:, None]
    found[:, count + 1] = -np.inf
    return np.where(np.isnan(found), np.float32(np.inf), found)


def _single_joints(law: RestToRest) -> list[RestToRest]:
    """Returns the laws of the joints one by one."""
    rows = zip(law.velocity, law.acceleration, law.jerk, strict=True)
    return [RestToRest(*(np.array([value]) for value in row)) for row in rows]


def _windows(
    order: OrderModel, numbers: list[tuple[int, ...]], works: list[FloatArray]
) -> tuple[FloatArray | None, FloatArray | None]:
    """Returns when approaches may begin, and stops must be over, by stop; None where no task has a window.

    A window is for the instant at which a tool is there: lines are taken to last half of what is not dwell each.
    """
    tasks = order.tasks
    if not order.job.moves and all(
        task.not_before == 0.0 and np.isinf(task.not_after) for task in tasks
    ):
        return None, None
    count = sum(len(own) for own in numbers)
    early, late = np.zeros(count), np.full(count, np.inf)
    for task, own in zip(tasks, numbers, strict=True):
        for k, stop in zip(own, task.stops, strict=True):
            line = 0.5 * max(0.0, min(float(work[k].min()) for work in works) - stop.dwell.total)
            if k == own[0]:
                early[k] = max(0.0, task.not_before - line)
            if k == own[-1]:
                late[k] = task.not_after + line
            if stop.moves:
                first, last = stop.window
                early[k], late[k] = max(early[k], first - line), min(late[k], last + line)
    return early, late
