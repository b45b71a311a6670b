"""Effort levels: every number that trades planning time for a faster plan, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.effort.stages import COARSE, FINE, NEAR, Mesh, SearchEffort, SequenceSettings
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class StageEffort:
    """Effort of the search for orders of paired arms."""

    starts: int
    """Searches from different orders."""
    steps: int
    """How often something is removed and put back in each, times the number of stages."""
    stretches: float
    """Stretches that are improved, by stage of a long order."""
    rounds: int = 0
    """Rounds of annealing; it takes the place of all else where it serves."""
    coolings: int = 1
    """So often it begins anew where orders are not long; less often with more of them."""
    near: int = 0
    """So many orders that are nearly as good as its best one are kept each time."""

    def shorter(self, times: int) -> StageEffort:
        """Returns an effort for a good order to begin with: one start, and so many times less of all else."""
        rounds = self.rounds // times
        return replace(self, starts=1, steps=self.steps // times, rounds=rounds, coolings=1, near=0)


@dataclass(frozen=True)
class TrialEffort:
    """Effort of trying orders that the search found."""

    polished: int
    """So many of all that were looked at are polished."""
    rounds: int
    """Rounds of polishing at first; the most promising ones get more of them."""
    planned: int
    """So many of these are planned."""
    full_stages: int = 24
    """Stages up to which all of these orders are polished."""
    most_stages: int = 120
    """Stages above which only the best order is tried."""
    long: int = 40
    """Stages, or tasks of asynchronous arms, above which only the most promising order is planned."""
    promising: float = 0.04
    """Relative excess over the best order's estimate up to which another order is planned."""
    far_slower: float = 0.08
    """Relative excess of the estimate from which the file's order is slower by far."""
    searches: int = 2
    """Further searches for orders without pairs of stops that turned out to touch."""
    searches_of_long: int = 1
    """Further searches for long orders."""
    separations: int = 3
    """Attempts after these that only separate stops that touch."""

    def of_stages(self, stages: int) -> TrialEffort:
        """Returns the effort for so many stages: polishing more of them takes longer, and fewer orders are."""
        share = min(1.0, self.full_stages / max(1, stages))
        polished = round(self.polished * share * share)
        return replace(self, polished=max(self.planned, polished))


@dataclass(frozen=True)
class ProofEffort:
    """Effort of a proof by dynamic programming over the stops made."""

    steps: int
    """Steps for better prices."""
    labels: int
    """Labels that are kept."""
    first_labels: int = 4000
    """Labels of the first search for a better order."""
    late: float = 1.5
    """Upper bound of an order that keeps all windows, in times of one without windows."""


@dataclass(frozen=True)
class CloseOrders:
    """Effort of looking closely at nearly optimal orders."""

    labels: int
    """Labels that are kept in each round."""
    orders: int
    """Orders that are looked at in each round, and returned at most."""
    rounds: int
    """Number of rounds."""
    excess: float = 0.03
    """Relative excess over the best order of nearly optimal ones."""


@dataclass(frozen=True)
class BoundEffort:
    """Effort of the bound on all orders, and of better orders on the way to it."""

    nodes: int
    """Up to so many stages that may be, dynamic programming over the stops made serves."""
    proof: ProofEffort
    """How hard it tries."""
    near: CloseOrders
    """Search for better orders among nearly optimal ones."""
    seconds: float
    """How long CP-SAT searches at most elsewhere, in its deterministic seconds."""
    most_tasks: int = 60
    """Tasks up to which CP-SAT searches for a bound."""
    time_share: float = 0.2
    """Share of a time limit that is kept for the bound."""
    full_stops: int = 24
    """Stops up to which all of this effort is spent."""

    def of_stops(self, stops: int) -> BoundEffort:
        """Returns the effort for so many stops: with more of them everything takes longer, and less is done of it."""
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
    """How often something is removed and put back at every angle."""
    iterations: int
    """The same at the best angles, for up to a hundred tasks."""
    angles: int
    """How many angles are looked at closely."""
    proof: float
    """How long a bound is looked for at most, in CP-SAT's deterministic seconds."""
    planned: int = 3
    """Orders that are planned, if one of them has a plan."""
    tried: int = 6
    """Orders that are tried until one has a plan."""
    planned_epochs: int = 2
    """Orders with several platform angles that are planned."""
    waited: float = 0.1
    """Share of the time that each arm waits from which paired arms are planned as well, without a platform."""


@dataclass(frozen=True)
class EpochEffort:
    """Effort of the search for epochs of one platform angle each."""

    sets: int
    """Combinations of angles whose tasks are moved about."""
    moves: int
    """How often tasks are moved to another epoch, for each of them."""
    glance: int
    """How often something is removed and put back in an epoch while tasks are moved about."""
    close: int
    """The same for the best ones at last."""
    tasks: int = 20
    """Tasks above which combinations and moves become fewer."""
    most_epochs: int = 3
    """Platform angles that are combined in all ways; more only where fewer do not reach all tasks."""
    combinations: int = 40
    """Maximum number of combinations of angles that are rated."""
    hot: float = 0.1
    """Share of the total that a change may cost at first."""


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
    """Blending gain above which postures chosen for stops do not compete [fraction]. It is a fraction of the blended
    plan's duration."""
    repairs: int = 4
    """Repairs of a stage: one arm after the other, then both."""
    crowded_stages: float = 0.02
    """Fraction of stages with touching lines above which another order is better than repairs."""
    delay_step: float = 0.02
    """Unit of delays at full speed [s]."""
    short_delay: float = 0.1
    """Delay at full speed up to which no curve is searched [s]."""
    curve_rounds: tuple[int, ...] = (17, 49, 49)
    """Points of curves, round by round: more, and with a better estimate of what the others do then."""
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
    """Parts of the circle of elbows."""
    finer: int
    """How many times finer, in both directions, the cells are on which joints are enclosed."""


@dataclass(frozen=True)
class EffortSettings:
    """Settings of one value of `--effort`."""

    orders: StageEffort
    """The search for orders of paired arms."""
    trials: TrialEffort
    """Which of these orders are planned."""
    order_bound: BoundEffort
    """The bound on all orders."""
    clocks: FreeEffort
    """The search for orders of arms that work by themselves."""
    epochs: EpochEffort
    """The search for epochs of one platform angle each."""
    search: SearchEffort
    """The search over the whole sequence."""
    bound: Resolution
    """The lower bound on the cycle time of given stages."""
    hopeless_orders: int
    """No other order is tried after so many in which an arm touches something whatever the other one does."""
    section_orders: int
    """Orders of sections that are planned."""
    section_starts: int
    """Starts of a section that are looked at where the first is dear to reach without a collision."""
    seam_samples: int
    """Configurations that are drawn as starts of a seam."""
    seam_starts: int
    """Those of them that are improved."""
    widths: int = 1
    """Widths of steps with which the ways of passing lines' ends in motion are refined."""
    short_stops: int = 24
    """Stops up to which a job is planned with less effort as well."""
    sequence: SequenceSettings = SequenceSettings()
    """Numbers of the search over the whole sequence."""
    clearing: ClearanceSettings = ClearanceSettings()
    """The clearance loop and its repairs."""

    @property
    def spares(self) -> bool:
        """Whether time is spared where more of it seldom helps."""
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
            rounds=2,
            cycles_in_long=1,
            local_rounds=0,
            near=replace(NEAR, arm_angles=18, most_nodes=1000, width=20, per_angle=3),
            refined=6,
        ),
        bound=Resolution(step=np.radians(15.0), arm_angles=9, finer=3),
        hopeless_orders=2,
        section_orders=2,
        section_starts=1,
        seam_samples=500,
        seam_starts=2,
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
            meshes=(COARSE,), trial_rounds=4, rounds=3, cycles_in_long=2, for_few=FINE
        ),
        bound=Resolution(step=np.radians(10.0), arm_angles=16, finer=2),
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
            cycles_in_long=4,
            passing_rounds=4,
            rivals=6,
            local_rounds=2,
            near=replace(NEAR, width=160),
            begun=np.inf,
            spares=False,
        ),
        bound=Resolution(step=np.radians(4.0), arm_angles=45, finer=2),
        hopeless_orders=12,
        section_orders=24,
        section_starts=12,
        seam_samples=5000,
        seam_starts=12,
        widths=6,
    ),
}
"""Settings of each word of `--effort`; more of everything gives a shorter plan as a rule, not always."""


def less_effort(effort: str) -> str | None:
    """Returns the next word below one of `--effort`; None below the least."""
    words = list(EFFORTS)
    place = words.index(effort)
    return words[place - 1] if place else None
