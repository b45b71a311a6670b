"""Collision check of a plan: at stops, on moves and on the return."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SAMPLES, SequenceClearance
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.times import Evaluated, TransferChain, start_angle, start_joints


@dataclass(frozen=True)
class PlanClearanceSettings:
    """Penalties of postures that lack clearance."""

    meeting: float = 0.4
    """About how long one arm waits for the other where their moves meet [s]."""
    turns: float = 1.0
    """About how long it waits where they cannot be at their targets at once [s]."""
    stops: int = 7
    """Number of sampled places per stop: two per line, target, and the lines' ends."""
    detour: float = 0.1
    """Approximate fixed cost of a curved transfer [s]."""
    depth: float = 10.0
    """Approximate cost of a curved transfer per missing clearance [s/m]."""


PENALTY = PlanClearanceSettings()


@dataclass(frozen=True)
class PlanClearance:
    """Collision check of a plan of n stages."""

    stops: BoolArray
    """Flags of stages with collision-free lines, targets and retract ends, shape (n,)."""
    moves: BoolArray
    """Flags of moves into stages and return that are no no-goods, (n + 1,).

    The return is last.
    """
    waits: FloatArray
    """Estimated cost of collisions by stage, last the return [s], shape (n + 1,)."""

    @property
    def penalty(self) -> float:
        """Penalty of a plan's collisions [s]; infinite if it is infeasible."""
        if not (self.stops.all() and self.moves.all()):
            return np.inf
        return float(self.waits.sum())


def plan_clearance(problem: SequenceProblem, plan: Evaluated) -> PlanClearance:
    """Check a plan for collisions; all clear if checking is disabled.

    Both arms are checked at equal places of their lines and where they wait. If they collide at the targets, one arm
    goes after the other; the ends of their retracts must be collision-free. Moves are straight in joint space.

    Args:
        problem: the sequence.
        plan: joints of all stages.
    """
    n = problem.stages
    test = problem.clearance
    if test is None:
        yes = np.ones(n + 1, dtype=np.bool_)
        return PlanClearance(yes[:-1], yes, np.zeros(n + 1))
    holding = test.holding
    arrive, work, leave, lines = _joints(problem, test, plan)
    before = np.concatenate([_start(problem, test, plan)[None], leave[:-1]])
    if problem.free_start:
        before[0] = arrive[0]
    after = before[:1] if problem.returns else leave[-1:]
    starts, ends = np.concatenate([before, leave[-1:]]), np.concatenate([arrive, after])
    position = np.concatenate([*lines, work, arrive, leave, test.along(starts, ends)])
    moving = np.repeat(np.concatenate([holding.before, holding.after[-1:]]), SAMPLES, axis=0)
    on_lines = (*(test.coming,) * 2, *(test.leaving,) * 2, holding.at_targets)
    held = np.concatenate([*on_lines, holding.before, holding.after, moving])
    cross = holding.cell.cross_margins(position, held)
    arm_margins = np.full(len(position), np.inf)
    for a, arm in enumerate(problem.arms):
        margin = holding.cell.arm_margins(a, position, held[:, a])
        # An idle arm does not move: it needs no slack beyond the required clearance.
        idle = np.array([stop is None for stop in arm.stops], dtype=np.bool_)
        margin[: PENALTY.stops * n] += np.where(np.tile(idle, PENALTY.stops), SLACK, 0.0)
        arm_margins = np.minimum(arm_margins, margin)
    stops = PENALTY.stops * n
    alone = (arm_margins[:stops] >= SLACK).reshape(PENALTY.stops, n)
    both = (cross[:stops] >= SLACK).reshape(PENALTY.stops, n)
    lacks = np.maximum(-arm_margins[stops:], 0.0).reshape(n + 1, SAMPLES).max(axis=1)
    apart = np.all((cross[stops:] >= 0.0).reshape(n + 1, SAMPLES), axis=1)
    no_good_waits = np.zeros(n + 1)
    for k in {no_good.stage for no_good in test.no_goods}:
        [no_good_waits[k]] = test.no_good_costs(k, starts[k, None], ends[k, None])
    waits = move_waits(holding.pace, lacks, apart)
    waits = np.maximum(waits, np.where(np.isfinite(no_good_waits), no_good_waits, 0.0))
    waits[:n] += np.where(both[:-1].all(axis=0), 0.0, holding.pace * PENALTY.turns)
    # In a hand-over the arms cannot go one after the other.
    simultaneous = both[-1] & (both.all(axis=0) | ~holding.is_handover)
    stops_clear = np.asarray(alone.all(axis=0) & simultaneous)
    stops_clear[list(test.settled)] = True
    return PlanClearance(stops_clear, np.isfinite(no_good_waits), waits)


def step_waits(
    test: SequenceClearance,
    stage: int,
    start: FloatArray,
    arrival: FloatArray,
    target: FloatArray,
    end: FloatArray,
) -> FloatArray:
    """Estimate n steps' clearance cost into a stage [s], infinite if blocked, (n,).

    Stops are nodes, where each arm alone is collision-free. Checked are each arm on its straight move, and both arms
    together there and at their stops, as in `plan_clearance`.

    Args:
        test: collision test of the sequence.
        stage: its number.
        start: all joints before it [rad], shape (n, columns).
        arrival: after the transfer, shape (n, columns).
        target: at the targets, shape (n, columns).
        end: after the retracts, shape (n, columns).
    """
    holding, waits = test.holding, np.full(len(start), np.inf)
    # Where the arms touch after the stage, nothing else of a step counts.
    held = np.tile(holding.after[stage], (len(end), 1))
    clear = holding.cell.cross_margins(end, held) >= SLACK
    rows = np.flatnonzero(clear | (stage in test.settled))
    start, arrival, target = start[rows], arrival[rows], target[rows]
    n, before = len(rows), holding.before[stage]
    moves = test.along(start, arrival)
    held = np.repeat([before, holding.at_targets[stage]], [len(moves) + n, n], axis=0)
    cross = holding.cell.cross_margins(np.concatenate([moves, arrival, target]), held)
    lacks = np.zeros(n)
    for a in range(len(before)):
        lacks = np.maximum(lacks, _missing_alone(test, a, int(before[a]), start, arrival))
    apart = np.all((cross[: len(moves)] >= 0.0).reshape(n, SAMPLES), axis=1)
    stops = (cross[len(moves) :] >= SLACK).reshape(2, n)
    costs = move_waits(holding.pace, lacks, apart)
    costs = np.maximum(costs, test.no_good_costs(stage, start, arrival))
    must = holding.is_handover[stage] and stage not in test.settled
    turns = np.inf if must else holding.pace * PENALTY.turns
    waits[rows] = costs + np.where(stops.all(axis=0), 0.0, turns)
    return waits


def _missing_alone(
    test: SequenceClearance, a: int, held: int, start: FloatArray, arrival: FloatArray
) -> FloatArray:
    """Compute what an arm lacks of clearance by itself on straight moves [m], shape (n,).

    Steps of both arms share the moves of each: every move is tested once.
    """
    columns = [*test.platform_columns, *test.holding.cell.columns[a]]
    moves = np.concatenate([start[:, columns], arrival[:, columns]], axis=1)
    _, first, step = np.unique(moves, axis=0, return_index=True, return_inverse=True)
    samples = test.along(start[first], arrival[first])
    margins = test.holding.cell.arm_margins(a, samples, np.full(len(samples), held))
    return np.asarray((-margins).reshape(len(first), SAMPLES).max(axis=1)[step])


def move_waits(pace: float, lacks: FloatArray, apart: BoolArray) -> FloatArray:
    """Estimate the clearance cost of n straight moves [s], shape (n,).

    Args:
        pace: how much slower than at full speed everything moves.
        lacks: what an arm lacks of clearance by itself, at most [m], shape (n,).
        apart: where the arms are clear of each other, shape (n,).
    """
    detours = np.where(lacks > 0.0, PENALTY.detour + PENALTY.depth * lacks, 0.0)
    return pace * (detours + np.where(apart, 0.0, PENALTY.meeting))


def _start(problem: SequenceProblem, test: SequenceClearance, plan: Evaluated) -> FloatArray:
    """Return all joints before the first stage [rad]."""
    joints = [
        start_joints(problem, work, TransferChain.of(work), postures)[None]
        for work, postures in zip(problem.arms, plan.arms, strict=True)
    ]
    angle = np.array([start_angle(problem, plan.decisions.angle)])
    return test.positions(angle, joints)[0]


def _joints(
    problem: SequenceProblem, test: SequenceClearance, plan: Evaluated
) -> tuple[FloatArray, FloatArray, FloatArray, list[FloatArray]]:
    """Return joints at move ends, targets, retract ends, lines, (n, columns) each."""
    n = problem.stages
    at_end, at_target, after = [], [], []
    on_lines: list[list[FloatArray | None]] = [[], [], [], []]
    for work, postures in zip(problem.arms, plan.arms, strict=True):
        chain = TransferChain.of(work)
        # An idle arm waits where it ended last.
        last = np.where(np.isin(np.arange(n), chain.active), np.arange(n), chain.previous)
        start = start_joints(problem, work, chain, postures)
        waits = np.where(last[:, None] >= 0, postures.q_retract[last], start)
        active = np.isin(np.arange(n), chain.active)[:, None]
        at_end.append(np.where(active, postures.q_approach, waits))
        at_target.append(np.where(active, postures.q_target, waits))
        after.append(waits)
        for k, place in enumerate(on_lines):
            place.append(np.where(active, postures.q_between[:, k], waits))
    angle = plan.decisions.angle
    return (
        test.positions(angle, at_end),
        test.positions(angle, at_target),
        test.positions(angle, after),
        [test.positions(angle, place) for place in on_lines],
    )
