"""Effort levels: every number that trades planning time for a faster plan, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LengthScaling:
    """Rules that fit an effort to the number of stages or stops."""

    long: int = 24
    """Stages above which a sequence is long: fewer nodes, fewer polished plans."""
    short: int = 12
    """Maximum number of stages of a short sequence."""
    min_node_fraction: float = 0.7
    """Smallest fraction of a grid's nodes that is kept in long sequences."""
    min_rounds: int = 3
    """Minimum number of polishing rounds of a short sequence, before they are multiplied."""
    max_factor: int = 4
    """Largest factor of rounds and plans in short sequences."""
    further_grids_factor: int = 4
    """Factor from which a sequence gets the grids for short ones as well."""
    full_trial_stages: int = 24
    """Stages up to which all orders of an effort are polished."""
    full_bound_stops: int = 24
    """Stops up to which the bound on orders gets its whole effort."""

    def damping(self, stages: int) -> float:
        """Return the weight of single stages' luck: 1 up to `long`, less in longer sequences."""
        return min(1.0, float(np.sqrt(self.long / stages)))

    def factor(self, stages: int) -> int:
        """Return the factor of rounds and plans in a sequence, 1 or more."""
        return min(self.max_factor, max(1, self.long // stages))


SCALING = LengthScaling()


@dataclass(frozen=True)
class Mesh:
    """Resolution of a grid of nodes, and width of the beam through it."""

    angle_step: float
    """Spacing of the platform angles [rad]."""
    arm_angles: int
    """Arm angles around the circle."""
    most_nodes: int
    """Most nodes of one stop."""
    width: int
    """States that the beam keeps."""
    per_angle: int = 4
    """Nodes of each arm that the beam pairs at each platform angle."""
    around: int = 0
    """Platform angles to either side of a plan's own that are looked at; 0 for the whole range."""

    def thinned(self, share: float) -> Mesh:
        """Returns the mesh with a share of its nodes."""
        return replace(self, most_nodes=round(share * self.most_nodes))


NEAR = Mesh(angle_step=np.radians(6.0), arm_angles=24, most_nodes=1500, width=40, around=3)
"""Grid around a plan that collides, at normal effort; and around the best plan of sequences that are not shorter than
`SCALING.long`: at 24 stages plans are 0.8 to 3.5 % shorter than with a grid as narrow as LOCAL."""
LOCAL = Mesh(angle_step=np.radians(3.0), arm_angles=36, most_nodes=1500, width=40, around=1)
"""Grid around the best plan of shorter sequences."""
COARSE = Mesh(angle_step=np.radians(12.0), arm_angles=14, most_nodes=1000, width=20)
"""Grid of all sequences at normal effort."""
FINE = (
    Mesh(angle_step=np.radians(8.0), arm_angles=22, most_nodes=3000, width=200, per_angle=8),
    Mesh(angle_step=np.radians(10.0), arm_angles=18, most_nodes=3000, width=100, per_angle=8),
)
"""Grids of short sequences at normal effort, and of all at thorough effort."""


@dataclass(frozen=True)
class SearchEffort:
    """Effort of the search over a whole sequence of stages."""

    meshes: tuple[Mesh, ...]
    """Grids of nodes, each with a plan of its own; the first one's bound is reported."""
    trial_rounds: int
    """Rounds of polishing of every plan before they are combined."""
    rounds: int
    """Rounds of polishing of the combination."""
    random_steps: int
    """Random steps that are offered in each round."""
    cycles: int
    """How often a plan is polished for motion through the outer ends of lines, where tools may pass them: first with
    one way of passing all, from the second time on with those that go best with it."""
    cycles_in_long: int
    """Polishing cycles for motion through line ends, in sequences that are not short."""
    passing_rounds: int
    """Rounds of polishing each time."""
    rivals: int
    """So many other plans are polished so as well, and what is best of all of them once more."""
    for_few: tuple[Mesh, ...]
    """Further grids for short sequences."""
    local: Mesh
    """The grid around the best plan so far, in sequences of fewer stages than `SCALING.long`."""
    local_rounds: int = 1
    """How often there is such a grid, at most; arms without closed forms have one in any case."""
    plans: int = 1
    """Plans of every grid that are polished: different in branches, targets or yaws."""
    near: Mesh = NEAR
    """The grid around a plan that collides."""
    begun: float = 12
    """Sequences of so many stages or fewer are searched from simpler methods' plans as well; longer ones only where no
    grid has a plan."""
    refined: int = 12
    """Blended sequences of so many stages or fewer are compared with the refined plan of `minimum_time` in any case: at
    8 and 12 stages that is a quarter of quick effort's time, and gave nothing."""
    spares: bool = True
    """Flag of efforts that save time where more search seldom helps.

    Long sequences get fewer nodes and fewer of their plans polished, and simpler plans are not refined beside a good
    one.
    """

    def for_stages(self, stages: int) -> SearchEffort:
        """Scale the effort to the number of stages.

        More of everything for short sequences, where it takes little time, and fewer nodes for long ones.
        """
        local = NEAR if stages >= SCALING.long else self.local
        cycles = self.cycles if stages <= SCALING.short else self.cycles_in_long
        if stages > SCALING.long and self.spares:
            share = max(SCALING.min_node_fraction, SCALING.damping(stages))
            meshes = tuple(mesh.thinned(share) for mesh in self.meshes)
            return replace(self, meshes=meshes, cycles=cycles, local=local.thinned(share))
        factor = SCALING.factor(stages)
        is_short, further = stages <= SCALING.short, factor >= SCALING.further_grids_factor
        return replace(
            self,
            meshes=(*self.meshes, *self.for_few) if further else self.meshes,
            trial_rounds=self.trial_rounds * min(factor, 2),
            rounds=factor * (max(self.rounds, SCALING.min_rounds) if is_short else self.rounds),
            cycles=cycles,
            random_steps=self.random_steps * factor,
            local=local,
            local_rounds=self.local_rounds * factor,
            plans=self.plans * factor,
        )

    def for_general_arms(self, stages: int) -> SearchEffort:
        """Returns less of all for arms without closed forms, whose postures take some thirty times as long.

        One grid, the finer one for short sequences, another one around its plan, and little polishing.
        """
        few = SCALING.max_factor * stages <= SCALING.long and self.for_few
        return replace(
            self,
            meshes=(self.for_few if few else self.meshes)[:1],
            trial_rounds=max(1, self.trial_rounds // 2),
            rounds=max(self.rounds, SCALING.min_rounds),
            cycles=self.cycles if stages <= SCALING.short else self.cycles_in_long,
            plans=max(2, self.plans),
            local_rounds=max(1, self.local_rounds),
        )


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

    def of_stages(self, stages: int) -> TrialEffort:
        """Returns the effort for so many stages: polishing more of them takes longer, and fewer orders are."""
        share = min(1.0, SCALING.full_trial_stages / max(1, stages))
        polished = round(self.polished * share * share)
        return replace(self, polished=max(self.planned, polished))


@dataclass(frozen=True)
class ProofEffort:
    """Effort of a proof by dynamic programming over the stops made."""

    steps: int
    """Steps for better prices."""
    labels: int
    """Labels that are kept."""


@dataclass(frozen=True)
class CloseOrders:
    """Effort of looking closely at nearly optimal orders."""

    labels: int
    """Labels that are kept in each round."""
    orders: int
    """Orders that are looked at in each round, and returned at most."""
    rounds: int
    """Number of rounds."""


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

    def of_stops(self, stops: int) -> BoundEffort:
        """Returns the effort for so many stops: with more of them everything takes longer, and less is done of it."""
        share = min(1.0, SCALING.full_bound_stops / max(1, stops))
        near = CloseOrders(
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
    widths: int
    """Widths of steps with which the ways of passing lines' ends in motion are refined."""

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
            random_steps=0,
            cycles=2,
            cycles_in_long=1,
            passing_rounds=2,
            rivals=0,
            for_few=(),
            local=LOCAL,
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
        widths=1,
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
            meshes=(COARSE,),
            trial_rounds=4,
            rounds=3,
            random_steps=0,
            cycles=2,
            cycles_in_long=2,
            passing_rounds=2,
            rivals=0,
            for_few=FINE,
            local=LOCAL,
        ),
        bound=Resolution(step=np.radians(10.0), arm_angles=16, finer=2),
        hopeless_orders=4,
        section_orders=4,
        section_starts=4,
        seam_samples=1500,
        seam_starts=5,
        widths=1,
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
            for_few=(),
            local=LOCAL,
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
