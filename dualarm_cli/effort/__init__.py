"""Effort levels: every number that trades planning time for a faster plan, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.effort.stages import (
    COARSE,
    FINE,
    MEDIUM,
    NEAR,
    SCALING,
    Mesh,
    SearchEffort,
    SequenceSettings,
)
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StageEffort:
    """Effort of the search for orders of paired arms."""

    starts: int
    """Number of searches from different orders."""
    steps: int
    """Number of ruin-and-recreate steps of a search, times the number of stages."""
    stretches: float
    """Number of improved stretches per stage of a long order."""
    rounds: int = 0
    """Number of annealing rounds; annealing replaces the other searches if it supports the job."""
    coolings: int = 1
    """Number of annealing restarts for short orders, fewer for longer ones."""
    near: int = 0
    """Number of near-optimal orders kept from each annealing run."""
    least_steps: int = 120
    """Minimum number of ruin-and-recreate steps of a search."""
    short_steps: int = 20
    """Number of ruin-and-recreate steps in a short search; in long orders, of improved stretches."""
    whole: int = 30
    """Maximum number of stages of an order improved as a whole.

    Longer ones are improved in stretches as well.
    """
    full_stages: int = 60
    """Number of stages from which an order gets all annealing rounds.

    Shorter ones get a fraction.
    """
    least_share: float = 0.15
    """Least fraction of the annealing rounds, for short orders."""
    most_share: float = 1.6
    """Largest fraction of the annealing rounds, for long orders."""
    cooling_ratio: int = 8
    """Ratio of the rounds of successive coolings.

    The last and slowest cooling has all rounds.
    """
    least_rounds: int = 100
    """Minimum number of rounds of the quick coolings before the last one."""
    warm: float = 0.02
    """Initial temperature from a known order, as a fraction of a stage's mean length."""
    warm_share: float = 0.4
    """Fraction of the annealing rounds from a known order."""

    def shorter(self, times: int) -> StageEffort:
        """Reduce the effort by a factor, with a single start, for an initial order."""
        rounds = self.rounds // times
        return replace(self, starts=1, steps=self.steps // times, rounds=rounds, coolings=1, near=0)


@dataclass(frozen=True)
class TrialEffort:
    """Effort of planning the orders from the search."""

    polished: int
    """Number of evaluated orders that are polished."""
    rounds: int
    """Number of initial polishing rounds; the best orders get more."""
    planned: int
    """Number of polished orders that are planned."""
    full_stages: int = 24
    """Number of stages up to which `polished` applies in full."""
    most_stages: int = 120
    """Stages above which only the best order is tried."""
    long: int = 40
    """Number of stages or asynchronous tasks above which only the best order is planned."""
    promising: float = 0.04
    """Relative excess over the best order's estimate up to which another order is planned."""
    far_slower: float = 0.08
    """Relative excess of the estimate from which the file's order is slower by far."""
    searches: int = 2
    """Number of further searches for orders without the colliding pairs of stops."""
    searches_of_long: int = 1
    """Number of further searches for long orders."""
    separations: int = 3
    """Number of later attempts that only separate colliding stops."""
    random_steps: int = 4
    """Number of random steps per polishing round, for plans whose linear steps collide."""
    fewer: int = 3
    """Divisor of the number of orders from each polishing to the next."""
    longer: int = 2
    """Factor on the number of polishing rounds from each polishing to the next."""
    alike: float = 0.9
    """Fraction of common stages above which two orders count as similar."""
    largest_penalty: float = 10.0
    """Upper bound of an order's collision penalty [s]; such orders are tried last."""

    def of_stages(self, stages: int) -> TrialEffort:
        """Scale the effort to a number of stages: fewer orders are polished in long sequences."""
        share = min(1.0, self.full_stages / max(1, stages))
        polished = round(self.polished * share * share)
        return replace(self, polished=max(self.planned, polished))


@dataclass(frozen=True)
class ProofEffort:
    """Effort of a proof by dynamic programming over the stops made."""

    steps: int
    """Number of steps of the price optimisation."""
    labels: int
    """Maximum number of labels."""
    first_labels: int = 4000
    """Maximum number of labels in the first search for a better order."""
    late: float = 1.5
    """Upper bound of an order with windows, relative to an order without windows."""


@dataclass(frozen=True)
class CloseOrders:
    """Effort of the search among near-optimal orders."""

    labels: int
    """Maximum number of labels in each round."""
    orders: int
    """Number of orders evaluated in each round, and maximum number returned."""
    rounds: int
    """Number of rounds."""
    excess: float = 0.03
    """Relative excess of near-optimal orders over the best order."""


@dataclass(frozen=True)
class BoundEffort:
    """Effort of the bound on all orders, and of better orders during its search."""

    nodes: int
    """Maximum number of possible stages for dynamic programming over the stops made."""
    proof: ProofEffort
    """Effort of dynamic programming."""
    near: CloseOrders
    """Effort of the search for better orders among near-optimal ones."""
    seconds: float
    """Time limit of CP-SAT for larger jobs [deterministic seconds]."""
    most_tasks: int = 60
    """Maximum number of tasks for CP-SAT's search for a bound."""
    time_share: float = 0.2
    """Fraction of a time limit reserved for the bound."""
    full_stops: int = 24
    """Number of stops up to which the whole effort is spent."""

    def of_stops(self, stops: int) -> BoundEffort:
        """Scale the effort to a number of stops: less of everything for large jobs."""
        share = min(1.0, self.full_stops / max(1, stops))
        near = replace(
            self.near,
            labels=round(share * self.near.labels),
            orders=round(share * self.near.orders),
            rounds=max(2, round(share * share * self.near.rounds)),
        )
        proof = replace(self.proof, labels=round(share * self.proof.labels))
        return replace(self, proof=proof, near=near)


@dataclass(frozen=True)
class FreeEffort:
    """Effort of the search for orders of asynchronous arms."""

    glance: int
    """Number of ruin-and-recreate steps at every platform angle."""
    iterations: int
    """Number of ruin-and-recreate steps at the best angles, for up to a hundred tasks."""
    angles: int
    """Number of platform angles searched closely."""
    proof: float
    """Time limit of CP-SAT's search for a bound [deterministic seconds]."""
    planned: int = 3
    """Number of orders that are planned, if one of them has a plan."""
    tried: int = 6
    """Maximum number of orders that are planned until one has a plan."""
    planned_epochs: int = 2
    """Number of orders with several platform angles that are planned."""
    kept: int = 4
    """Maximum number of orders kept per angle; the best ones may be infeasible."""
    rounds: int = 4
    """Number of improvements with penalties for the conflicts of the last order."""
    refined_ratio: float = 1.05
    """Largest first objective of a refined angle, relative to the best angle's."""
    conflict_wait: float = 1.5
    """Extra time of a stop in conflict with every partner stop [s]."""
    most_proven: int = 40
    """Maximum number of tasks for which a lower bound of all orders is computed."""
    waited: float = 0.1
    """Waiting fraction of each arm from which paired arms are planned, too, without a platform."""


@dataclass(frozen=True)
class EpochEffort:
    """Effort of the search for epochs of one platform angle each."""

    sets: int
    """Number of angle combinations whose tasks are moved between epochs."""
    moves: int
    """Number of task moves to another epoch for each combination."""
    glance: int
    """Number of ruin-and-recreate steps of an epoch during task moves."""
    close: int
    """Number of final ruin-and-recreate steps for the best combinations."""
    tasks: int = 20
    """Number of tasks above which combinations and moves become fewer."""
    most_epochs: int = 3
    """Maximum size of angle combinations, exceeded only if smaller ones miss tasks."""
    combinations: int = 40
    """Maximum number of combinations of angles that are rated."""
    hot: float = 0.1
    """Initial annealing temperature as a fraction of the total."""


@dataclass(frozen=True)
class ClearanceSettings:
    """Thresholds of the clearance loop, and numbers of its repairs.

    Costs of clearance are fractions of the unchecked plan's duration.
    """

    negligible_cost: float = 0.005
    """Cost of clearance up to which the repaired unchecked plan is final [fraction]."""
    repairable_stages: float = 0.34
    """Largest fraction of colliding stages at which an unchecked plan is repaired."""
    rounds: int = 3
    """Rounds with collision checking."""
    rounds_while_blocked: int = 12
    """Maximum number of rounds as long as no plan is collision-free."""
    expensive_repair: float = 1.5
    """Added time from which a repaired stage becomes a no-good, at full speed [s]."""
    compare_less_effort: float = 0.03
    """Cost of clearance above which the plan of the next lower effort competes [fraction]."""
    compare_simpler: float = 0.08
    """Cost of clearance above which plans of simpler methods compete [fraction]."""
    blending_rival: float = 0.03
    """Largest lag of an unchecked plan that may be the shortest when blended [fraction]."""
    sufficient_gain: float = 0.03
    """Blending gain above which postures chosen for stops do not compete [fraction].

    It is a fraction of the blended
    plan's duration."""
    cost_of_care: float = 0.02
    """Cost of care and tool speed limit above which a search with them competes [fraction]."""
    repairs: int = 4
    """Repairs of a stage: one arm after the other, then both."""
    crowded_stages: float = 0.02
    """Fraction of stages with touching lines above which another order is better than repairs."""
    delay_step: float = 0.02
    """Unit of delays at full speed [s]."""
    short_delay: float = 0.1
    """Delay at full speed up to which no curve is searched [s]."""
    curve_rounds: tuple[int, ...] = (17, 49, 49)
    """Numbers of curve points by round: more, as estimates of the rest improve."""
    timed_curves: int = 3
    """Curves, quickest first, that are timed in a round."""
    curve_spare: float = 0.004
    """Distance of curves beyond the required clearance, for what is between their points [m]."""


@dataclass(frozen=True)
class Resolution:
    """Resolution of the posture cells of the lower bound."""

    step: float
    """Width of the platform's cells [rad]."""
    arm_angles: int
    """Number of parts of the elbow circle."""
    finer: int
    """Subdivision factor of platform cells on which joints are enclosed."""
    late: float = 0.3
    """Time beyond the least of a line up to which its displacements are enclosed [s]."""
    finer_circle: int | None = None
    """Subdivision factor of the circle's parts on which joints are enclosed; None for `finer`."""


@dataclass(frozen=True)
class EffortSettings:
    """Settings of one value of `--effort`."""

    orders: StageEffort
    """Effort of the search for orders of paired arms."""
    trials: TrialEffort
    """Effort of planning these orders."""
    order_bound: BoundEffort
    """Effort of the bound on all orders."""
    clocks: FreeEffort
    """Effort of the search for orders of asynchronous arms."""
    epochs: EpochEffort
    """Effort of the search for epochs of a platform angle each."""
    search: SearchEffort
    """Effort of the search over the whole sequence."""
    bound: Resolution
    """Resolution of the lower bound of given stages with all stops."""
    passing_bound: Resolution
    """Resolution of that bound where tools pass in motion.

    Narrow platform cells gain more than narrow arm angles: all arms share the platform's angle.
    """
    hopeless_orders: int
    """Number of orders with a collision of an arm alone after which the search ends."""
    section_orders: int
    """Number of orders of sections that are planned."""
    section_starts: int
    """Number of accepted starts of a section that are compared."""
    seam_samples: int
    """Number of random configurations as starts of a seam."""
    seam_starts: int
    """Number of seam starts that are improved."""
    widths: int = 1
    """Number of step widths for the refinement of launches.

    Plans of quick effort keep these launches: 3 instead of 1 make them 0.3 % shorter. Others are refined later.
    """
    short_stops: int = 24
    """Number of stops up to which open orders are planned with less effort, too."""
    sequence: SequenceSettings = SequenceSettings()
    """Settings of the search over the whole sequence."""
    clearing: ClearanceSettings = ClearanceSettings()
    """Settings of the clearance loop and its repairs."""

    @property
    def spares(self) -> bool:
        """Flag of efforts that save time if more search seldom helps."""
        return self.search.spares


EFFORTS: Mapping[str, EffortSettings] = {
    "quick": EffortSettings(
        orders=StageEffort(starts=1, steps=3_000, stretches=0.6, rounds=10_000, near=10),
        trials=TrialEffort(polished=8, rounds=1, planned=2),
        order_bound=BoundEffort(
            nodes=4_000,
            proof=ProofEffort(steps=40, labels=20_000),
            near=CloseOrders(labels=4_000, orders=12, rounds=4),
            seconds=1.0,
        ),
        clocks=FreeEffort(glance=60, iterations=1500, angles=1, proof=1.0),
        epochs=EpochEffort(sets=3, moves=20, glance=20, close=400),
        search=SearchEffort(
            meshes=(replace(COARSE, per_angle=3),),
            trial_rounds=2,
            rounds=1,
            cycles=4,
            passing_rounds=1,
            local_rounds=0,
            near=replace(NEAR, arm_angles=18, most_nodes=1000, width=20, per_angle=3),
            begun=6,
            refined=6,
            quickest_moves_only=True,
        ),
        bound=Resolution(step=np.radians(15.0), arm_angles=9, finer=3),
        passing_bound=Resolution(step=np.radians(12.0), arm_angles=8, finer=3),
        hopeless_orders=2,
        section_orders=2,
        section_starts=1,
        seam_samples=500,
        seam_starts=2,
        widths=3,
    ),
    "normal": EffortSettings(
        orders=StageEffort(
            starts=4, steps=9_000, stretches=1.5, rounds=15_000, coolings=12, near=12
        ),
        trials=TrialEffort(polished=120, rounds=1, planned=3),
        order_bound=BoundEffort(
            nodes=7_000,
            proof=ProofEffort(steps=80, labels=200_000),
            near=CloseOrders(labels=20_000, orders=60, rounds=8),
            seconds=4.0,
        ),
        clocks=FreeEffort(glance=150, iterations=6000, angles=3, proof=4.0),
        epochs=EpochEffort(sets=8, moves=60, glance=40, close=2000),
        search=SearchEffort(
            meshes=(MEDIUM,),
            further_meshes=(
                COARSE,
                Mesh(
                    angle_step=np.radians(7.0),
                    arm_angles=20,
                    most_nodes=2500,
                    width=100,
                    per_angle=8,
                ),
            ),
            trial_rounds=4,
            rounds=3,
            follows_rates=(True, False),
            refinements=4,
            for_few=FINE,
        ),
        bound=Resolution(step=np.radians(7.5), arm_angles=24, finer=2),
        passing_bound=Resolution(step=np.radians(2.0), arm_angles=15, finer=1, finer_circle=3),
        hopeless_orders=4,
        section_orders=4,
        section_starts=4,
        seam_samples=1500,
        seam_starts=5,
    ),
    "thorough": EffortSettings(
        orders=StageEffort(
            starts=8, steps=60_000, stretches=8.0, rounds=150_000, coolings=16, near=20
        ),
        trials=TrialEffort(polished=200, rounds=2, planned=6),
        order_bound=BoundEffort(
            nodes=12_000,
            proof=ProofEffort(steps=150, labels=1_500_000),
            near=CloseOrders(labels=60_000, orders=200, rounds=12),
            seconds=30.0,
        ),
        clocks=FreeEffort(glance=500, iterations=60000, angles=6, proof=40.0),
        epochs=EpochEffort(sets=20, moves=400, glance=100, close=20000),
        search=SearchEffort(
            meshes=(
                *FINE,
                Mesh(angle_step=np.radians(12.0), arm_angles=14, most_nodes=1500, width=40),
                Mesh(angle_step=np.radians(15.0), arm_angles=12, most_nodes=1500, width=20),
            ),
            trial_rounds=4,
            rounds=6,
            random_steps=4,
            cycles=4,
            passing_rounds=4,
            follows_rates=(True, False),
            rivals=6,
            joined="normal",
            refinements=24,
            refinement_rounds=12,
            single_steps=100,
            local_rounds=2,
            near=replace(NEAR, width=160),
            begun=np.inf,
            spares=False,
        ),
        bound=Resolution(step=np.radians(3.0), arm_angles=60, finer=2),
        passing_bound=Resolution(step=np.radians(0.9), arm_angles=30, finer=1, finer_circle=3),
        hopeless_orders=12,
        section_orders=24,
        section_starts=12,
        seam_samples=5000,
        seam_starts=12,
        widths=6,
    ),
}
"""Settings by value of `--effort`; a higher effort usually gives a shorter plan."""


def further_searches(effort: str, stages: int) -> list[tuple[str, tuple[Mesh, ...]]]:
    """List effort and grids of each further search of a sequence.

    No grids stand for those of the effort. Short sequences have all grids of an effort, longer ones the first, long
    ones none.
    """
    if not 0 < stages <= SCALING.long:
        return []
    how = EFFORTS[effort].search
    meshes = how.further_meshes if stages <= SCALING.short else how.further_meshes[:1]
    searches: list[tuple[str, tuple[Mesh, ...]]] = [(effort, (mesh,)) for mesh in meshes]
    if not how.joined:
        return searches
    return [(how.joined, ()), *further_searches(how.joined, stages), *searches]


def less_effort(effort: str) -> str | None:
    """Return the next lower value of `--effort`, or None."""
    words = list(EFFORTS)
    place = words.index(effort)
    return words[place - 1] if place else None
