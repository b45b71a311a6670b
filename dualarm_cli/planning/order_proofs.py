"""Bounds on all orders of paired arms on the search's grid, and the orders that are found on the way to them."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dualarm_cli.planning.order_model import OrderModel
from dualarm_cli.planning.order_moves import OrderMoves
from dualarm_cli.planning.stage_order_model import StageModel
from dualarm_cli.planning.watch import Watch
from dualarm_cli.sequencing.cp_sat import prove
from dualarm_cli.sequencing.relaxation import of_stages
from dualarm_cli.sequencing.stage_near import near_orders
from dualarm_cli.sequencing.stage_pairs import pair_bound
from dualarm_cli.sequencing.stage_problem import StageOrder, StageProblem
from dualarm_cli.sequencing.stage_proof import ProofEffort, StageProof, can_prove, prove_order

FULL = 24
"""Up to so many stops everything is done that an effort says."""
MOST_TASKS = 60
"""Of so many tasks at most CP-SAT looks for a bound."""


@dataclass(frozen=True)
class BoundEffort:
    """How hard a bound is looked for, and orders on the way to it."""

    nodes: int
    """Up to so many stages that may be, dynamic programming over the stops made serves."""
    proof: ProofEffort
    """How hard it tries."""
    near: tuple[int, int, int]
    """Labels, orders and rounds of looking closely at orders that are nearly as good."""
    seconds: float
    """How long CP-SAT searches at most elsewhere, in its deterministic seconds."""

    def of_stops(self, stops: int) -> BoundEffort:
        """Returns the effort for so many stops: with more of them everything takes longer, and less is done of it."""
        share = min(1.0, FULL / max(1, stops))
        labels, count, rounds = self.near
        near = round(share * labels), round(share * count), max(2, round(share**2 * rounds))
        return replace(
            self, proof=replace(self.proof, labels=round(share * self.proof.labels)), near=near
        )


EFFORTS = {
    "quick": BoundEffort(4_000, ProofEffort(40, 20_000), (4_000, 12, 4), 1.0),
    "normal": BoundEffort(7_000, ProofEffort(80, 200_000), (20_000, 60, 8), 4.0),
    "thorough": BoundEffort(12_000, ProofEffort(150, 1_500_000), (60_000, 200, 12), 30.0),
}
"""How hard bounds are looked for."""


def is_provable(problem: StageProblem, effort: str) -> bool:
    """Returns whether orders are bounded, and better ones found, by dynamic programming over the stops made."""
    return can_prove(problem, EFFORTS[effort].nodes)


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
        watch: is told how it goes, and may end it.
    """
    watch.tell("bounding all orders, and looking for better ones on the way")
    how = EFFORTS[effort].of_stops(problem.stops)
    waits = bool(order.job.cell.tool_changes)
    told = (lambda _: None) if waits else watch.bounded
    proven = prove_order(problem, best, how.proof, watch.stop, watch.found, told)
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

    None where nothing has to keep clear, and where more than the order decides what is done between stops.
    """
    more = order.job.has_handovers or order.job.cell.tool_changes or problem.stores is not None
    if proven.graph is None or proven.prices is None or order.clearance is None or more:
        return []
    labels, count, rounds = EFFORTS[effort].of_stops(problem.stops).near
    return near_orders(
        proven.graph,
        proven.prices,
        proven.order,
        OrderMoves.of(order, stages).costs,
        labels=labels,
        count=count,
        rounds=rounds,
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
        watch: is told how it goes, and may end it.
    """
    watch.tell("bounding all orders")
    found = 0.0
    if not order.job.cell.tool_changes:
        # While one arm changes its tool the other one may work: that is in no pair of stops.
        found = pair_bound(problem)
        watch.bounded(found)
    if len(problem.tasks) <= MOST_TASKS:
        seconds = EFFORTS[effort].seconds
        relaxed = of_stages(problem)
        found = max(found, prove(relaxed, None, seconds, seed, watch.stop, watch.bounded).bound)
    return found
