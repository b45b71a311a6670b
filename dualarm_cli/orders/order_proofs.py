"""Lower bounds of paired orders on the search's grid, with near-optimal orders.

The arms are paired in stages.
"""

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
    """Positions around transfers, in the postures of the search for orders.

    They are those before and after each transfer.
    """

    order: OrderModel
    """Tasks as each arm can do them; with collision checks."""
    stages: StageModel
    """Stages of the job as numbers."""
    entry: tuple[FloatArray, ...]
    """Joints at approach starts by arm [rad], (s, f, joints), NaN without posture."""
    leaving: tuple[FloatArray, ...]
    """Joints at retract ends by arm [rad], (s, f, joints), NaN without posture."""
    held: IntArray
    """Part held on the transfer to each stop, and after it, shape (2, s)."""

    @classmethod
    def of(cls, order: OrderModel, stages: StageModel) -> OrderMoves:
        """Prepare the postures that a search for orders uses."""
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
        """Estimate the extra time of collision-free transfers [s]; see `proof/near_optimal.py`."""
        delays = np.zeros(len(moves))
        idle = np.append((graph.stops == IDLE).any(axis=1), False)
        checked = np.flatnonzero(~idle[moves].any(axis=1))
        if not self.order.job.returns:
            checked = checked[moves[checked, 1] != ENDS]
        size = 20_000
        for k in range(0, len(checked), size):
            rows = checked[k : k + size]
            delays[rows] = self._costs(graph, moves[rows])
        return delays

    def _costs(self, graph: StageGraph, moves: IntArray) -> FloatArray:
        order = self.order
        clearance = order.clearance
        assert clearance is not None  # see the class
        before = self._positions(graph, moves[:, 0], self.leaving)
        after = self._positions(graph, moves[:, 1], self.entry)
        fraction = (np.arange(SAMPLES) + 1.0) / (SAMPLES + 1.0)
        path = before[:, None] + fraction[:, None] * (after - before)[:, None]
        position = path.reshape(-1, before.shape[1])
        # The part held on the transfer to a stop; on the return, the part after the last stop.
        back = moves[:, 1] == ENDS
        held = np.where(
            back[:, None],
            self.held[1][graph.stops[moves[:, 0]]],
            self.held[0][graph.stops[moves[:, 1]]],
        )
        carried = np.repeat(held, SAMPLES, axis=0)
        margins = np.full(len(position), np.inf)
        for a in range(len(order.model.arms)):
            margins = np.minimum(margins, clearance.arm_margins(a, position, carried[:, a]))
        cross = clearance.cross_margins(position, carried)
        shape = len(moves), SAMPLES
        deficits = np.maximum(-margins, 0.0).reshape(shape).max(axis=1)
        arms_clear = np.all((cross >= 0.0).reshape(shape), axis=1)
        return move_waits(1.0 / order.job.speed, deficits, arms_clear)

    def _positions(
        self, graph: StageGraph, nodes: IntArray, tables: tuple[FloatArray, ...]
    ) -> FloatArray:
        """Compute all joints at nodes, at the start for ENDS [rad], shape (k, columns)."""
        model = self.order.model
        positions = np.tile(self.order.start, (len(nodes), 1))
        visited = np.flatnonzero(nodes != ENDS)
        stops, angle = graph.stops[nodes[visited]], graph.angle[nodes[visited]]
        positions[visited[:, None], model.platform_columns] = self.stages.angles[angle]
        for a, (arm, table) in enumerate(zip(model.arms.values(), tables, strict=True)):
            positions[visited[:, None], arm.columns] = table[stops[:, a], angle]
        return positions


def is_provable(problem: StageProblem, effort: str) -> bool:
    """Test whether dynamic programming over finished stops can bound all orders."""
    return can_prove(problem, EFFORTS[effort].order_bound.nodes)


def proven_orders(
    order: OrderModel,
    stages: StageModel,
    problem: StageProblem,
    best: StageOrder,
    effort: str,
    watch: Watch,
) -> tuple[list[StageOrder], float | None]:
    """Improve the best order, list near-optimal ones, bound all orders below [s].

    The bound is None if arms change tools: in the stages of the search the other arm waits for whole tool changes.

    Args:
        order: the job's tasks as each arm may do them.
        stages: stages of the job as numbers.
        problem: stages as the search uses them; `is_provable`.
        best: the best order known.
        effort: one of EFFORTS.
        watch: receives progress, and may end it.
    """
    watch.report("bounding all orders and searching for better ones")
    limits = EFFORTS[effort].order_bound.of_stops(problem.stops)
    has_tool_changes = bool(order.job.cell.tool_changes)
    report_bound = (lambda _: None) if has_tool_changes else watch.record_bound
    proven = prove_order(problem, best, limits.proof, watch.stop, watch.record, report_bound)
    orders = [proven.order, *_near_optimal(order, stages, problem, proven, effort, watch)]
    return orders, None if has_tool_changes else proven.bound


def _near_optimal(
    order: OrderModel,
    stages: StageModel,
    problem: StageProblem,
    proven: StageProof,
    effort: str,
    watch: Watch,
) -> list[StageOrder]:
    """List near-optimal orders whose transfers cost little for clearance.

    Empty without collision checks, and if more than the order decides what is done between stops.
    """
    depends_on_more = (
        order.job.has_handovers or order.job.cell.tool_changes or problem.stores is not None
    )
    if proven.graph is None or proven.prices is None or order.clearance is None or depends_on_more:
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
    """Compute a lower bound of all orders from least times [s].

    It holds for any number of stops; 0 if unknown.

    Args:
        order: the job's tasks as each arm may do them.
        problem: its stages.
        effort: one of EFFORTS.
        seed: random seed of CP-SAT.
        watch: receives progress, and may end it.
    """
    watch.report("bounding all orders")
    bound = 0.0
    if not order.job.cell.tool_changes:
        # While one arm changes its tool the other one may work, which no pair of stops includes.
        bound = pair_bound(problem)
        watch.record_bound(bound)
    limits = EFFORTS[effort].order_bound
    if len(problem.tasks) <= limits.most_tasks:
        relaxed = relax_stages(problem)
        bound = max(
            bound, prove(relaxed, None, limits.seconds, seed, watch.stop, watch.record_bound).bound
        )
    return bound
