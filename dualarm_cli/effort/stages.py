"""Settings of the search over a sequence of stages: its effort, and settings of all efforts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LengthScaling:
    """Rules that scale an effort to the number of stages or stops."""

    long: int = 24
    """Stages above which a sequence is long: fewer nodes, fewer polished plans."""
    short: int = 12
    """Maximum number of stages of a short sequence."""
    very_short: int = 6
    """Maximum number of stages of a very short sequence."""
    min_node_fraction: float = 0.7
    """Smallest fraction of a grid's nodes that is kept in long sequences."""
    max_factor: int = 4
    """Largest factor of rounds and plans in short sequences."""

    def damping(self, stages: int) -> float:
        """Compute the damping of thresholds: 1 up to `long`, less in longer sequences."""
        return min(1.0, float(np.sqrt(self.long / stages)))

    def factor(self, stages: int) -> int:
        """Compute the factor of rounds and plans in a sequence, 1 or more."""
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
    """Maximum number of nodes of a stop."""
    width: int
    """Number of states of the beam."""
    per_angle: int = 4
    """Number of nodes of each arm that the beam pairs at each platform angle."""
    around: int = 0
    """Number of platform angles to either side of a plan's angle; 0 for the whole range."""

    def thinned(self, share: float) -> Mesh:
        """Reduce the mesh to a fraction of its nodes."""
        return replace(self, most_nodes=round(share * self.most_nodes))


NEAR = Mesh(angle_step=np.radians(6.0), arm_angles=24, most_nodes=1500, width=40, around=3)
"""Grid around a plan that collides, at normal effort.

It also surrounds the best plan of sequences that are not shorter than
`SCALING.long`: at 24 stages plans are 0.8 to 3.5 % shorter than with a grid as narrow as LOCAL."""
LOCAL = Mesh(angle_step=np.radians(3.0), arm_angles=36, most_nodes=1500, width=40, around=1)
"""Grid around the best plan of shorter sequences."""
COARSE = Mesh(angle_step=np.radians(12.0), arm_angles=14, most_nodes=1000, width=20)
"""Grid of all sequences at quick effort."""
MEDIUM = Mesh(angle_step=np.radians(9.0), arm_angles=17, most_nodes=1500, width=60, per_angle=6)
"""Grid of all sequences at normal effort.

With 12° four of 24 stages are 0.6 % longer (mean), in the same time."""
FINE = (
    Mesh(angle_step=np.radians(8.0), arm_angles=22, most_nodes=3000, width=200, per_angle=8),
    Mesh(angle_step=np.radians(10.0), arm_angles=18, most_nodes=3000, width=100, per_angle=8),
)
"""Further grids of very short sequences at normal effort, and grids of all at thorough effort."""


@dataclass(frozen=True)
class SearchEffort:
    """Effort of the search over a whole sequence of stages."""

    meshes: tuple[Mesh, ...]
    """Grids of nodes, each with a plan of its own; the first one's bound is reported."""
    trial_rounds: int
    """Rounds of polishing of every plan before they are combined."""
    rounds: int
    """Rounds of polishing of the combination, at rest."""
    random_steps: int = 0
    """Random steps that are offered in each round."""
    cycles: int = 2
    """Number of polishing cycles for motion through the outer ends of lines.

    The first cycle has the same launch at every end, the following ones the best launches of the plan. Long sequences
    that are timed with all stops have as many further rounds at rest, which gain 1 % at 100 stages of quick effort.
    """
    passing_rounds: int = 2
    """Number of polishing rounds in each cycle.

    At quick effort four cycles of one make 33 jobs of 4 to 100 stages 0.4 % shorter (mean) than one or two of two, in
    1.08 times the processor time.
    """
    follows_rates: tuple[bool, ...] = (False,)
    """Whether these cycles follow the rates at line ends; both variants compete if both are listed.

    At normal effort both make 15 jobs of 4 to 24 stages 0.3 % shorter (mean) than the cycles without rates alone, the
    best by 2.1 %, the worst longer by 0.8 %.
    """
    rivals: int = 0
    """Number of other plans polished in the same cycles, and combined."""
    refinements: int = 0
    """Number of refinements of the collision-free plan, each checked exactly."""
    refinement_rounds: int = 8
    """Rounds of random steps in each refinement; more for short sequences."""
    single_steps: int = 0
    """Number of random steps of single stages after the refinements, in short sequences alone.

    100 shorten plans of thorough effort of 4 and 8 stages by 0.1 to 0.3 % in 5 to 12 s of processor time.
    """
    for_few: tuple[Mesh, ...] = ()
    """Further grids of very short sequences, within the first search.

    With them, of 16 jobs one of six stages whose tool speeds are limited is 6 % shorter, the others by at most 0.3 %.
    """
    further_meshes: tuple[Mesh, ...] = ()
    """Grids of further whole searches, whose blended plans compete.

    Short sequences use all, others up to `SCALING.long` stages the first. Which grid leads to the shortest plan is
    chance: three make 18 jobs of up to twelve stages 0.4 % shorter (mean), the best by 2.3 %. Beyond, the second one
    prevents bad luck for 1.25 times the time: with the first alone one job of 24 stages is 3 % longer.
    """
    joined: str = ""
    """Lower effort whose searches are further ones; empty for none.

    All plans are refined at the higher effort. One search may be behind those of a lower effort, even if it takes
    longer than all of them.
    """
    local: Mesh = LOCAL
    """Grid around the best plan, for fewer stages than `SCALING.long`."""
    local_rounds: int = 1
    """Maximum number of local grids; arms without closed forms have at least 1."""
    plans: int = 1
    """Number of polished plans of a grid, different in branches, targets or yaws."""
    near: Mesh = NEAR
    """The grid around a plan that collides."""
    begun: float = 12
    """Number of stages up to which simpler methods' plans are starts of the search, too.

    Longer sequences have these starts only if no grid has a plan.
    """
    refined: int = 12
    """Number of stages up to which the refined plan of `minimum_time` always competes, blended.

    At 8 and 12 stages this is a quarter of quick effort's time, and gained nothing.
    """
    quickest_moves_only: bool = False
    """Whether `minimum_time` alone is the simpler method, where a grid has a plan.

    On 34 jobs of up to six stages the plans of the others changed no cycle of quick effort.
    """
    spares: bool = True
    """Flag of efforts that save time where more search seldom helps.

    Long sequences get fewer nodes and fewer polished plans, and simpler plans are not refined next to a better one.
    """

    def for_stages(self, stages: int) -> SearchEffort:
        """Scale the effort to the number of stages.

        More of everything for short sequences, where it takes little time, and fewer nodes for long ones.
        """
        local = NEAR if stages >= SCALING.long else self.local
        if stages > SCALING.long and self.spares:
            share = max(SCALING.min_node_fraction, SCALING.damping(stages))
            meshes = tuple(mesh.thinned(share) for mesh in self.meshes)
            return replace(self, meshes=meshes, local=local.thinned(share))
        factor = SCALING.factor(stages)
        return replace(
            self,
            meshes=(*self.meshes, *self.for_few) if stages <= SCALING.very_short else self.meshes,
            single_steps=self.single_steps if stages <= SCALING.short else 0,
            trial_rounds=self.trial_rounds * min(factor, 2),
            rounds=self.rounds * factor,
            random_steps=self.random_steps * factor,
            local=local,
            refinement_rounds=self.refinement_rounds * min(factor, 2),
            local_rounds=self.local_rounds * factor,
            plans=self.plans * factor,
        )

    def for_general_arms(self, stages: int) -> SearchEffort:
        """Reduce the effort for arms without closed forms.

        Their postures take some thirty times as long. They get a single grid, a finer one for very short sequences, a
        grid around its plan, and little polishing.
        """
        finer = self.for_few if stages <= SCALING.very_short else ()
        return replace(
            self,
            meshes=(finer or self.meshes)[:1],
            trial_rounds=max(1, self.trial_rounds // 2),
            refinement_rounds=self.refinement_rounds // 2,
            single_steps=0,
            plans=max(2, self.plans),
            local_rounds=max(1, self.local_rounds),
        )


@dataclass(frozen=True)
class RefinementSettings:
    """Random steps that refine a collision-free plan with the launches that suit it.

    At 12 stages 60 rounds shorten plans of normal effort by 0.9 to 1.6 % in 1.5 s; half of that is gained in 8 rounds.
    """

    steps: int = 4
    """Number of random steps in each round; each moves every stage."""
    largest_step: float = 0.2
    """Largest standard deviation of a step [rad]."""
    halvings: int = 7
    """Number of standard deviations, each half of the one before."""
    moved: float = 0.5
    """Fraction of the variables that a step moves."""
    renewal: int = 4
    """Number of rounds after which the launches are chosen again."""
    widths: int = 6
    """Number of step widths for the refinement of the final launches."""
    tries: int = 10
    """Number of steps of a single stage before the next stage is chosen."""
    least: float = 1e-5
    """Smallest estimated gain of a step of a single stage that is driven [s]."""


@dataclass(frozen=True)
class SequenceSettings:
    """Settings of the search over a sequence, in every `SequenceProblem`."""

    neighbours: int = 1
    """Number of stages to either side of a colliding one that are re-planned with it."""
    further_neighbours: int = 4
    """Further stages to either side that are re-planned in the second attempt."""
    least_grid_gain: float = 2e-3
    """Relative gain below which a finer grid is the last one."""
    least_rounds: int = 3
    """Minimum number of rounds of the last polishing with all stops.

    With one, a job of 24 stages takes 4 % longer at quick effort.
    """
    promising: float = 0.06
    """Relative excess over the best plan above which a plan is not polished."""
    same_angle: float = 1e-3
    """Difference of platform angles below which two plans are the same [rad]."""
    in_parts: int = 2 * SCALING.long
    """Number of stages from which a sequence is decided in parts."""
    polished_in_long: int = 2
    """Number of plans of a long sequence that are polished before their combination."""
    part: int = 100
    """Approximate number of stages of a long sequence that are decided together."""
    part_overlap: int = 4
    """Number of stages to either side of a part's border that are decided in both parts."""
    clear_tries: int = 24
    """Maximum number of combinations that are tested for clearance."""

    node_yaws: int = 6
    """Number of yaws of nodes with free yaw that moves further joints."""
    line_factor: float = 1.08
    """Approximate ratio of a line's time to the rest-to-rest time of its joints' displacements.

    Joints on a line start and stop together along a curve.
    """
    swing_steps: int = 3
    """Maximum change of the arm angle along a line [half steps]."""
    thorough_angles: int = 3
    """Number of platform angles up to which general arms sample the whole self-motion."""
    refinement: RefinementSettings = RefinementSettings()
    """Random steps that refine the collision-free plan."""
    general_node_share: float = 0.5
    """Fraction of a grid's nodes that is searched for arms without closed forms."""
    general_sideways: tuple[float, ...] = (0.5, -0.5, 1.0, -1.0)
    """Offsets of further nodes along the self-motion [rad], as many as needed."""
    general_around: tuple[float, ...] = (0.0, -0.3, -0.1, 0.1, 0.3)
    """Places on the self-motion of nodes around a plan [rad]."""
    general_drift: float = 0.2
    """Variation of the drift of either line there [rad]."""
    passing: tuple[int, int] = (0, 6)
    """Indices of the initial profile and cut of launches, under jerk limits."""
    passing_without_jerk: tuple[int, int] = (8, 6)
    """Indices of the initial profile and cut of launches, without jerk limits."""
    shared_transfers: int = 16
    """Number of transfers from which two processes choose launches."""

    step_shares: tuple[float, ...] = (0.25, 0.5, 1.0, 1.7)
    """Fractions of the linear step that every stage may take."""
    first_radius: float = 0.15
    """Trust radius of a variable in the first round of polishing [rad]."""
    radius_factor: float = 0.85
    """Shrink factor of the trust radius after a round with little gain."""
    least_gain: float = 3e-4
    """Fraction of the cycle time below which a round's gain is small."""
    smallest_radius: float = 2e-3
    """Trust radius below which polishing ends [rad]."""
    near_critical: float = 0.55
    """Fraction of the transfer time from which a joint's time constrains the linear program."""
    window: int = 24
    """Number of stages improved together; the next round's windows are shifted by a half."""
    shared_windows: int = 10
    """Number of windows from which two processes improve them."""

    repair_swings: tuple[float, ...] = (1.0, 0.95, 0.8, 0.5, 0.0)
    """Factors on the change of the arm angle along lines in repaired plans."""
    repair_shifts: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.3)
    """Shifts of a stop's arm angle to either side in repaired plans [rad]."""
    repair_yaws: int = 48
    """Number of candidate yaws if the distributed yaw is infeasible."""
    last_joint_margin: float = 0.02
    """Margin to the last joint's limits for its motion along lines [rad]."""
    shared_stages: int = 48
    """Number of stages from which two processes compute the arms' nodes."""
    beam_repeats: int = 12
    """Maximum number of beams, each without nodes whose lines were infeasible."""

    first_scan_step: float = float(np.radians(12.0))
    """Spacing of the platform angles that long sequences try first [rad]."""
    scan_step: float = float(np.radians(1.0))
    """Spacing of the platform angles scanned for a stage [rad]."""
    scan_rounds: int = 4
    """Number of rounds that cut the bracket of an interval's end, to 1e-6."""
    coarse_scan_step: float = float(np.radians(3.0))
    """Spacing of scanned platform angles for arms without closed forms [rad]."""
    coarse_scan_rounds: int = 2
    """Number of rounds that cut brackets for arms without closed forms, to 1e-3."""
    angles_in_reach: int = 65
    """Number of platform angles scanned along each arc within reach of a stop."""
    scan_yaws: int = 8
    """Number of scanned yaws if yaw is free."""
    interval_shares: tuple[float, ...] = (0.1, 0.5, 0.9)
    """Relative positions of nodes in an arm-angle interval."""
    scan_arm_angles: int = 24
    """Number of arm angles for lines to given configurations."""
    node_oversampling: int = 3
    """Ratio of nodes with tested lines to selected nodes."""
    every_node: int = 12_000
    """Node limit that is never reached, to test whether a platform angle has nodes."""
    exact_angles: int = 48
    """Number of exact platform angles of a stage without a common grid angle."""
    paired_nodes: int = 8
    """Number of nodes of each arm that are paired at each exact platform angle."""

    oversampling: int = 4
    """Oversampling factor of a beam's pairs, because several steps lead to the same pair."""
    clearance_oversampling: int = 8
    """Further oversampling factor of sorted pairs with collision checking."""
    first_per_kind: int = 2
    """Number of pairs of a kind rated first; the best may share a collision."""
    fallback_per_angle: int = 16
    """Number of nodes of each arm paired at each platform angle in the fallback search.

    It extends the best state alone, if all rated pairs collide.
    """
    varied_states: int = 64
    """Minimum number of states of a varied beam: the branch pairs of two arms."""
    varied_pairs: int = 4096
    """Number of node pairs that a varied beam rates in a stage."""
    varied_options: int = 1_000_000
    """Number of node pairs that a varied beam sorts in a stage."""
    quadrant_border: float = 0.3
    """Offset of quadrant borders from multiples of a quarter turn, which are common values [rad]."""

    alike: float = 0.08
    """Relative excess of a simpler method's estimate below which its plan is timed exactly.

    Estimates of lines are a few percent off, and a third of a cycle is lines. In longer sequences the errors of single
    lines average out.
    """
    refined: float = 0.08
    """Relative excess of a simpler method's plan below which it is refined.

    Refinement gains 1 to 7 percent.
    """
    refined_moves: float = 0.03
    """Relative excess of the plan of `minimum_time` below which it is refined.

    Its refinement takes as long as the search.
    """
    few_stages: int = 12
    """Number of stages up to which the refined plan of `minimum_time` competes.

    Without blending, and in repairs.
    """
    given_stages: int = 50
    """Number of stages above which an order is planned from its trial plan alone."""
