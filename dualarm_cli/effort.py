"""What `--effort` means: every number that trades planning time for a faster plan, in one table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.records import dataclass

WHOLE = 24
"""Sequences of so many stages or more take as long as they are."""

LEAST_NODES = 0.7
"""Share of a grid's nodes that is left of it in the longest sequences, where an effort spares them."""

FEW = 4
"""So many times more rounds and further grids."""

MOST = 4
"""The shortest ones get so many times more rounds and plans."""

SHORT = 12
"""Sequences of so many stages or fewer are short."""

LEAST_ROUNDS = 3
"""Least rounds of polishing of a short sequence, before they are multiplied."""

FULL_STAGES = 24
"""Up to so many stages as many orders are polished as an effort says."""

FULL_STOPS = 24
"""Up to so many stops everything is done that an effort says."""


@dataclass(frozen=True)
class Mesh:
    """How finely one grid of nodes is set, and how wide a beam goes through it."""

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


NEAR = Mesh(np.radians(6.0), 24, 1500, 40, 4, around=3)
"""The grid around a plan that collides, at normal effort, which others vary; and around the best plan of sequences of
WHOLE stages or more: at 24 stages plans are 0.8 to 3.5 % shorter than with a grid as narrow as LOCAL."""
LOCAL = Mesh(np.radians(3.0), 36, 1500, 40, 4, around=1)


def evening(stages: int) -> float:
    """Returns how much less luck at single stages counts in a sequence that is longer than WHOLE, 1 in others."""
    return min(1.0, float(np.sqrt(WHOLE / stages)))


@dataclass(frozen=True)
class SearchEffort:
    """How hard the search tries."""

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
    """The same in sequences of more than SHORT stages."""
    passing_rounds: int
    """Rounds of polishing each time."""
    rivals: int
    """So many other plans are polished so as well, and what is best of all of them once more."""
    for_few: tuple[Mesh, ...]
    """Further grids for short sequences."""
    local: Mesh
    """The grid around the best plan so far, in sequences of fewer than WHOLE stages."""
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
    """Whether time is spared where more of it seldom helps: sequences longer than WHOLE get fewer nodes and fewer of
    their plans polished, and simpler plans are not refined beside a good one."""

    def for_stages(self, stages: int) -> SearchEffort:
        """Returns more of all for short sequences, where it takes little time, and fewer nodes for long ones."""
        more = min(MOST, max(1, WHOLE // stages))
        local = NEAR if stages >= WHOLE else self.local
        if stages > WHOLE and self.spares:
            share = max(LEAST_NODES, evening(stages))
            return replace(
                self,
                meshes=tuple(mesh.thinned(share) for mesh in self.meshes),
                cycles=self.cycles_in_long,
                local=local.thinned(share),
            )
        return replace(
            self,
            meshes=self.meshes if more < FEW else (*self.meshes, *self.for_few),
            trial_rounds=self.trial_rounds * min(more, 2),
            rounds=more * (max(self.rounds, LEAST_ROUNDS) if stages <= SHORT else self.rounds),
            cycles=self.cycles if stages <= SHORT else self.cycles_in_long,
            random_steps=self.random_steps * more,
            local=local,
            local_rounds=self.local_rounds * more,
            plans=self.plans * more,
        )

    def for_general_arms(self, stages: int) -> SearchEffort:
        """Returns less of all for arms without closed forms, whose postures take some thirty times as long.

        One grid, the finer one for short sequences, another one around its plan, and little polishing.
        """
        few = MOST * stages <= WHOLE and self.for_few
        return replace(
            self,
            meshes=(self.for_few if few else self.meshes)[:1],
            trial_rounds=max(1, self.trial_rounds // 2),
            rounds=max(self.rounds, LEAST_ROUNDS),
            cycles=self.cycles if stages <= SHORT else self.cycles_in_long,
            plans=max(2, self.plans),
            local_rounds=max(1, self.local_rounds),
        )


@dataclass(frozen=True)
class StageEffort:
    """How hard orders are searched for."""

    starts: int
    """Searches from different orders."""
    steps: int
    """How often something is removed and put back in each, times the number of stages."""
    stretches: float
    """Stretches that are improved, by stage of a long order."""
    rounds: int = 0
    """Rounds of annealing, for FULL stages; it takes the place of all else where it serves."""
    coolings: int = 1
    """So often it begins anew where orders have WHOLE stages or fewer; less often with more of them."""
    near: int = 0
    """So many orders that are nearly as good as its best one are kept each time."""

    def shorter(self, times: int) -> StageEffort:
        """Returns an effort for a good order to begin with: one start, and so many times less of all else."""
        rounds = self.rounds // times
        return replace(self, starts=1, steps=self.steps // times, rounds=rounds, coolings=1, near=0)


@dataclass(frozen=True)
class TrialEffort:
    """How many orders are tried, and how."""

    polished: int
    """So many of all that were looked at are polished."""
    rounds: int
    """Rounds of polishing at first; the most promising ones get more of them."""
    planned: int
    """So many of these are planned."""

    def of_stages(self, stages: int) -> TrialEffort:
        """Returns the effort for so many stages: polishing more of them takes longer, and fewer orders are."""
        share = min(1.0, FULL_STAGES / max(1, stages))
        polished = round(self.polished * share * share)
        return replace(self, polished=max(self.planned, polished))


@dataclass(frozen=True)
class ProofEffort:
    """How hard a proof is tried."""

    steps: int
    """Steps for better prices."""
    labels: int
    """Labels that are kept."""


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
        share = min(1.0, FULL_STOPS / max(1, stops))
        labels, count, rounds = self.near
        near = round(share * labels), round(share * count), max(2, round(share * share * rounds))
        return replace(
            self, proof=replace(self.proof, labels=round(share * self.proof.labels)), near=near
        )


@dataclass(frozen=True)
class FreeEffort:
    """How hard orders are searched for."""

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
    """How hard epochs are searched for."""

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
    """How finely postures are cut into cells."""

    step: float
    """Width of the platform's cells [rad]."""
    arm_angles: int
    """Parts of the circle of elbows."""
    finer: int
    """How many times finer, in both directions, the cells are on which joints are enclosed."""


@dataclass(frozen=True)
class EffortSettings:
    """All that one word of `--effort` decides."""

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
        orders=StageEffort(1, 3_000, 0.6, 10_000, 1, 10),
        trials=TrialEffort(8, 1, 2),
        order_bound=BoundEffort(4_000, ProofEffort(40, 20_000), (4_000, 12, 4), 1.0),
        clocks=FreeEffort(60, 1500, 1, 1.0),
        epochs=EpochEffort(3, 20, 20, 400),
        search=SearchEffort(
            meshes=(Mesh(np.radians(12.0), 14, 1000, 20, 3),),
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
        bound=Resolution(np.radians(15.0), 9, 3),
        hopeless_orders=2,
        section_orders=2,
        section_starts=1,
        seam_samples=500,
        seam_starts=2,
        widths=1,
    ),
    "normal": EffortSettings(
        orders=StageEffort(4, 9_000, 1.5, 15_000, 12, 12),
        trials=TrialEffort(120, 1, 3),
        order_bound=BoundEffort(7_000, ProofEffort(80, 200_000), (20_000, 60, 8), 4.0),
        clocks=FreeEffort(150, 6000, 3, 4.0),
        epochs=EpochEffort(8, 60, 40, 2000),
        search=SearchEffort(
            meshes=(Mesh(np.radians(12.0), 14, 1000, 20),),
            trial_rounds=4,
            rounds=3,
            random_steps=0,
            cycles=2,
            cycles_in_long=2,
            passing_rounds=2,
            rivals=0,
            for_few=(
                Mesh(np.radians(8.0), 22, 3000, 200, 8),
                Mesh(np.radians(10.0), 18, 3000, 100, 8),
            ),
            local=LOCAL,
        ),
        bound=Resolution(np.radians(10.0), 16, 2),
        hopeless_orders=4,
        section_orders=4,
        section_starts=4,
        seam_samples=1500,
        seam_starts=5,
        widths=1,
    ),
    "thorough": EffortSettings(
        orders=StageEffort(8, 60_000, 8.0, 150_000, 16, 20),
        trials=TrialEffort(200, 2, 6),
        order_bound=BoundEffort(12_000, ProofEffort(150, 1_500_000), (60_000, 200, 12), 30.0),
        clocks=FreeEffort(500, 60000, 6, 40.0),
        epochs=EpochEffort(20, 400, 100, 20000),
        search=SearchEffort(
            meshes=(
                Mesh(np.radians(8.0), 22, 3000, 200, 8),
                Mesh(np.radians(10.0), 18, 3000, 100, 8),
                Mesh(np.radians(12.0), 14, 1500, 40),
                Mesh(np.radians(15.0), 12, 1500, 20),
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
        bound=Resolution(np.radians(4.0), 45, 2),
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
