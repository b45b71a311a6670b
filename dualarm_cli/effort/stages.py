"""Numbers of the search over a sequence of stages: its effort, and what all efforts share."""

from __future__ import annotations

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
    cycles_in_long: int
    """Polishing cycles for motion through line ends, in sequences that are not short."""
    random_steps: int = 0
    """Random steps that are offered in each round."""
    cycles: int = 2
    """How often a plan is polished for motion through the outer ends of lines, where tools may pass them: first with
    one way of passing all, from the second time on with those that go best with it."""
    passing_rounds: int = 2
    """Rounds of polishing each time."""
    rivals: int = 0
    """So many other plans are polished so as well, and what is best of all of them once more."""
    for_few: tuple[Mesh, ...] = ()
    """Further grids for short sequences."""
    local: Mesh = LOCAL
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
class SequenceSettings:
    """Numbers of the search over a sequence; every `SequenceProblem` has them."""

    neighbours: int = 1
    """Stages to either side of a colliding one that are re-planned with it."""
    further_neighbours: int = 4
    """Further stages to either side that are re-planned in the second attempt."""
    least_grid_gain: float = 2e-3
    """Relative gain below which a finer grid is the last one."""
    promising: float = 0.06
    """Relative excess over the best plan above which a plan is not polished."""
    same_angle: float = 1e-3
    """Difference of platform angles below which two plans are the same [rad]."""
    in_parts: int = 2 * SCALING.long
    """Stages from which a sequence is decided part by part, where an effort saves time."""
    polished_in_long: int = 2
    """Plans of a long sequence that are polished before they are combined, where an effort saves time."""
    part: int = 100
    """Approximate number of stages of a long sequence that are decided together."""
    part_overlap: int = 4
    """Stages to either side of where two parts meet that are decided in both."""
    clear_tries: int = 24
    """Maximum number of combinations that are tested for clearance."""

    node_yaws: int = 6
    """Yaws of a node set where any will do and yaw changes more than the last joint."""
    line_factor: float = 1.08
    """Approximate ratio of a line's time to the rest-to-rest time of its joints' displacements.

    Joints on a line start and stop together along a curve.
    """
    swing_steps: int = 3
    """Half steps of the arm angle that a line may swing to either side."""
    thorough_angles: int = 3
    """Platform angles up to which all of the self-motion is sampled, for arms without closed forms."""
    general_node_share: float = 0.5
    """Share of a grid's nodes that is searched for these arms: they take longer than in closed form."""
    general_sideways: tuple[float, ...] = (0.5, -0.5, 1.0, -1.0)
    """Further nodes along the self-motion of those that are found, as many as are needed [rad]."""
    general_around: tuple[float, ...] = (0.0, -0.3, -0.1, 0.1, 0.3)
    """Places on the self-motion of nodes around a plan [rad]."""
    general_drift: float = 0.2
    """Variation of the drift of either line there [rad]."""
    passing: tuple[int, int] = (0, 6)
    """Profile and cut, as indices, by which postures are chosen at first, under jerk limits."""
    passing_without_jerk: tuple[int, int] = (8, 6)
    """Profile and cut by which postures are chosen at first without jerk limits."""
    shared_transfers: int = 16
    """Transfers from which two processes choose the ways of passing lines' ends."""

    step_shares: tuple[float, ...] = (0.25, 0.5, 1.0, 1.7)
    """Shares of the linear step that every stage may take."""
    first_radius: float = 0.15
    """Trust radius of a variable in the first round of polishing [rad]."""
    radius_factor: float = 0.85
    """Shrink factor of the trust radius after a round with little gain."""
    least_gain: float = 3e-4
    """Share of the cycle time below which a round's gain is little."""
    smallest_radius: float = 2e-3
    """Trust radius below which polishing ends [rad]."""
    near_critical: float = 0.55
    """Share of a stage's transfer time from which a joint's own time has a row in the linear program."""
    window: int = 24
    """Stages that are improved together; the windows of the next round lie half a window further on."""
    shared_windows: int = 10
    """Windows from which two processes improve them."""

    repair_yaws: int = 48
    """Yaws around the circle that are tried where the shared-out yaw is impossible."""
    last_joint_margin: float = 0.02
    """Distance to the last joint's limits that its motion along the lines may use [rad]."""
    shared_stages: int = 48
    """Stages from which the arms' nodes are made in two processes."""
    beam_repeats: int = 12
    """Maximum number of beams, each without nodes whose lines turned out to be impossible."""

    scan_step: float = float(np.radians(1.0))
    """Spacing of the platform angles scanned for one stage, besides those within the arm's reach [rad]."""
    scan_rounds: int = 4
    """Rounds in which the bracket about an interval's end is cut: to 1e-6 of it."""
    coarse_scan_step: float = float(np.radians(3.0))
    """Spacing of the platform angles scanned for arms without closed forms, which take long [rad]."""
    coarse_scan_rounds: int = 2
    """Rounds in which brackets are cut for arms without closed forms: to 1e-3."""
    angles_in_reach: int = 65
    """Platform angles scanned along each arc from which a stop is within reach."""
    scan_yaws: int = 8
    """Yaws that are scanned where any will do."""
    interval_shares: tuple[float, ...] = (0.1, 0.5, 0.9)
    """Places of nodes in an interval of arm angles."""
    scan_arm_angles: int = 24
    """Arm angles around the circle for lines to given configurations."""
    node_oversampling: int = 3
    """Ratio of nodes whose lines are examined to nodes kept, since not all lines can be followed."""
    every_node: int = 12_000
    """Number of nodes that is never reached, to see whether a platform angle has any."""
    own_angles: int = 48
    """Platform angles that are examined in a stage whose arms share none of the grid's."""
    own_pairs: int = 8
    """Nodes of each arm that are paired at each of these angles."""

    oversampling: int = 4
    """Pairs per arm and kept state of a beam: several steps lead to the same pair of nodes."""
    clearance_oversampling: int = 8
    """Further factor of the pairs that are sorted with collision checking."""
    first_per_kind: int = 2
    """Pairs of a kind that are rated first: else all the best ones share one collision."""
    fallback_per_angle: int = 16
    """Nodes of each arm paired at each platform angle in the fallback search.

    It extends the best state alone, if all rated pairs collide.
    """
    varied_states: int = 64
    """Minimum number of states that a varied beam keeps: the pairs of eight branches of two arms."""
    varied_pairs: int = 4096
    """Pairs of nodes that a varied beam rates in a stage."""
    varied_options: int = 1_000_000
    """Pairs of nodes that a varied beam sorts in a stage."""
    quadrant_border: float = 0.3
    """Offset of the quadrants' borders from the multiples of a quarter turn, where many joints are [rad]."""

    alike: float = 0.08
    """Relative excess of a simpler method's estimate below which its plan is timed exactly as well.

    Estimates of lines are a few percent off, and a third of a cycle is lines. In longer sequences what is wrong with
    single lines evens out.
    """
    refined: float = 0.08
    """Relative excess of a simpler method's plan below which it is refined: refining gains 1 to 7 percent."""
    refined_moves: float = 0.03
    """The same of the rough plan of `minimum_time`, whose refinement takes as long as the search."""
    few_stages: int = 12
    """Stages up to which the refined plan of `minimum_time` competes if all stop at lines' ends, and in repairs."""
    given_stages: int = 50
    """Stages above which an order is planned from the plan that it was chosen by alone."""
