"""Bounds on all orders of paired arms on the search's grid, and the orders that are found on the way to them."""

from __future__ import annotations

import numpy as np

from dualarm_cli.effort import EFFORTS
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.stage_order_model import StageModel
from dualarm_cli.orders.paired.problem import IDLE, StageOrder, StageProblem
from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.graph import ENDS, StageGraph
from dualarm_cli.orders.proof.near_optimal import near_optimal_orders
from dualarm_cli.orders.proof.proof import StageProof, can_prove, prove_order
from dualarm_cli.orders.proof.relaxation import pair_bound, relax_stages
from dualarm_cli.orders.watch import Watch
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import SAMPLES
from dualarm_cli.stages.search.plan_clearance import move_waits


@dataclass(frozen=True)
class OrderMoves:
    """Where the arms are before and after moves, in the postures of the search for orders."""

    order: OrderModel
    """The job's tasks as each arm may do them; something has to be collision-free."""
    stages: StageModel
    """Its stages, and what their numbers mean."""
    entry: tuple[FloatArray, ...]
    """By arm, joints where approaches begin [rad], NaN where there is no posture, shape (s, f, joints)."""
    leaving: tuple[FloatArray, ...]
    """The same where retracts end."""
    held: IntArray
    """What is held on the way to each stop, and after it, shape (2, s)."""

    @classmethod
    def of(cls, order: OrderModel, stages: StageModel) -> OrderMoves:
        """Prepares the postures that a search for orders counts on."""
        entry, leaving = [], []
        for name, rows in zip(order.model.arms, stages.rows, strict=True):
            tables = np.full((2, *rows.shape, len(order.model.arms[name].columns)), np.nan)
            for stop, (t, s) in enumerate(stages.stops):
                there = np.flatnonzero(rows[stop] >= 0)
                if len(there):
                    nodes = order.nodes[name, t, s]
                    tables[0, stop, there] = nodes.q_approach[rows[stop, there]]
                    tables[1, stop, there] = nodes.q_retract[rows[stop, there]]
            entry.append(tables[0])
            leaving.append(tables[1])
        held = np.array([order.held(t, s) for t, s in stages.stops], dtype=np.int64)
        return cls(order, stages, tuple(entry), tuple(leaving), held[:, [0, 2]].T)

    def costs(self, graph: StageGraph, moves: IntArray) -> FloatArray:
        """Returns about how much longer moves take, so that all is collision-free [s]; see `proof/near_optimal.py`."""
        found = np.zeros(len(moves))
        idle = np.append((graph.stops == IDLE).any(axis=1), False)
        asked = np.flatnonzero(~idle[moves].any(axis=1))
        if not self.order.job.returns:
            asked = asked[moves[asked, 1] != ENDS]
        size = 20_000
        for k in range(0, len(asked), size):
            rows = asked[k : k + size]
            found[rows] = self._costs(graph, moves[rows])
        return found

    def _costs(self, graph: StageGraph, moves: IntArray) -> FloatArray:
        order = self.order
        clearance = order.clearance
        assert clearance is not None  # see the class
        before = self._positions(graph, moves[:, 0], self.leaving)
        after = self._positions(graph, moves[:, 1], self.entry)
        share = (np.arange(SAMPLES) + 1.0) / (SAMPLES + 1.0)
        way = before[:, None] + share[:, None] * (after - before)[:, None]
        position = way.reshape(-1, before.shape[1])
        # On the way to a stop; on the way back as after the last one.
        back = moves[:, 1] == ENDS
        held = np.where(
            back[:, None],
            self.held[1][graph.stops[moves[:, 0]]],
            self.held[0][graph.stops[moves[:, 1]]],
        )
        carried = np.repeat(held, SAMPLES, axis=0)
        own = np.full(len(position), np.inf)
        for a in range(len(order.model.arms)):
            own = np.minimum(own, clearance.own_margins(a, position, carried[:, a]))
        cross = clearance.cross_margins(position, carried)
        shape = len(moves), SAMPLES
        lacks = np.maximum(-own, 0.0).reshape(shape).max(axis=1)
        apart = np.all((cross >= 0.0).reshape(shape), axis=1)
        return move_waits(1.0 / order.job.speed, lacks, apart)

    def _positions(
        self, graph: StageGraph, nodes: IntArray, tables: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Returns all joints at nodes, at the start for ENDS [rad], shape (k, columns)."""
        model = self.order.model
        found = np.tile(self.order.start, (len(nodes), 1))
        there = np.flatnonzero(nodes != ENDS)
        stops, angle = graph.stops[nodes[there]], graph.angle[nodes[there]]
        found[there[:, None], model.platform_columns] = self.stages.angles[angle]
        for a, (arm, table) in enumerate(zip(model.arms.values(), tables, strict=True)):
            found[there[:, None], arm.columns] = table[stops[:, a], angle]
        return found


def is_provable(problem: StageProblem, effort: str) -> bool:
    """Returns whether orders are bounded, and better ones found, by dynamic programming over the stops made."""
    return can_prove(problem, EFFORTS[effort].order_bound.nodes)


def proven_orders(
    order: OrderModel,
    stages: StageModel,
    problem: StageProblem,
    best: StageOrder,
    effort: str,
    watch: Watch,
) -> tuple[list[StageOrder], float | None]:
    """Returns the best order known and others that are nearly as good, and what no order takes less than [s].

    None for that where arms change tools: in the stages that are searched the other arm waits for whole changes.

    Args:
        order: the job's tasks as each arm may do them.
        stages: its stages, and what their numbers mean.
        problem: the stages as the search has them; `is_provable`.
        best: the best order known.
        effort: one of EFFORTS.
        watch: receives progress, and may end it.
    """
    watch.report("bounding all orders and searching for better ones")
    how = EFFORTS[effort].order_bound.of_stops(problem.stops)
    waits = bool(order.job.cell.tool_changes)
    told = (lambda _: None) if waits else watch.record_bound
    proven = prove_order(problem, best, how.proof, watch.stop, watch.record, told)
    found = [proven.order, *_near(order, stages, problem, proven, effort, watch)]
    return found, None if waits else proven.bound


def _near(
    order: OrderModel,
    stages: StageModel,
    problem: StageProblem,
    proven: StageProof,
    effort: str,
    watch: Watch,
) -> list[StageOrder]:
    """Returns orders that are nearly as good as the best one, and cost little for clearance between stops.

    None where nothing has to be collision-free, and where more than the order decides what is done between stops.
    """
    more = order.job.has_handovers or order.job.cell.tool_changes or problem.stores is not None
    if proven.graph is None or proven.prices is None or order.clearance is None or more:
        return []
    return near_optimal_orders(
        proven.graph,
        proven.prices,
        proven.order,
        OrderMoves.of(order, stages).costs,
        sizes=EFFORTS[effort].order_bound.of_stops(problem.stops).near,
        stop=watch.stop,
    )


def least_total(
    order: OrderModel, problem: StageProblem, effort: str, seed: int, watch: Watch
) -> float:
    """Returns what no order takes less than [s], by least times: for any number of stops; 0 where nothing is known.

    Args:
        order: the job's tasks as each arm may do them.
        problem: its stages.
        effort: one of EFFORTS.
        seed: of CP-SAT's randomness.
        watch: receives progress, and may end it.
    """
    watch.report("bounding all orders")
    found = 0.0
    if not order.job.cell.tool_changes:
        # While one arm changes its tool the other one may work: that is in no pair of stops.
        found = pair_bound(problem)
        watch.record_bound(found)
    how = EFFORTS[effort].order_bound
    if len(problem.tasks) <= how.most_tasks:
        relaxed = relax_stages(problem)
        found = max(
            found, prove(relaxed, None, how.seconds, seed, watch.stop, watch.record_bound).bound
        )
    return found
