"""Problem and result of a planning method."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import field

from dualarm_cli.effort import EFFORTS, EffortSettings
from dualarm_cli.effort.stages import Mesh
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import STOPPING, Blending
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion_limits import is_slowed
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import NoGood
from dualarm_cli.stages.plans.problem import Decisions


@dataclass(frozen=True)
class MethodProblem:
    """A job with the settings under which a method plans it."""

    model: CellModel
    """Kinematics of the job's cell."""
    job: Job
    """Tasks and limits."""
    redundancy: str
    """Name of the redundancy solver."""
    effort: str = "normal"
    """Effort: quick, normal or thorough; greedy methods ignore it."""
    seed: int = 0
    """Seed of all randomness."""
    holding: Holding | None = None
    """Bodies that must not collide; None disables collision checking."""
    no_goods: tuple[NoGood, ...] = ()
    """Excluded stages; only methods over the whole sequence use them."""
    unchecked: tuple[StagePlan, ...] = ()
    """Colliding plan of the method for the same job; empty if none."""
    colliding_stages: tuple[int, ...] = ()
    """Stages of `unchecked` that collide or are expensive; the return is the last one."""
    neighbourhood_only: bool = False
    """Whether the search is limited to plans near `unchecked`.

    Set once a cheap collision-free plan is known; ignored by thorough effort and by greedy methods."""
    meshes: tuple[Mesh, ...] = ()
    """Grids of the search in place of its effort's; empty for those."""
    start: Decisions | None = None
    """Initial plan of the search, from the choice of the order."""
    without_margin: MethodProblem | None = None
    """Same problem without a margin to joint limits, or None.

    None if this problem has no margin.

    A method may plan with both. If its grid has no plan it refuses, and this problem is solved next.
    """
    blending: Blending = STOPPING
    """Rule for passing targets and line ends in motion."""
    limits_torques: bool = False
    """Flag of plans that have to stay within the joints' torques."""
    keeps_room: bool = False
    """Whether a plan with stops is blended later, and keeps room for that from joint limits."""
    refine: Refine | None = None
    """Refinement of the method's collision-free plans; None if it has none."""
    compares_care: bool = False
    """Whether the method can search with care, so that searches without and with it compete."""
    is_careful: bool = False
    """Whether the search over the whole sequence includes care and the tool speed limit."""
    repair_touching_stops: bool = True
    """Whether stages with colliding stops are repaired and re-planned; otherwise the order is changed."""
    progress: Callable[[str], None] = field(default=lambda _: None, compare=False, repr=False)
    """Receiver of progress messages; that of a method adds its share of the work."""

    @property
    def settings(self) -> EffortSettings:
        """Settings of the effort."""
        return EFFORTS[self.effort]

    @property
    def blends(self) -> bool:
        """Whether tools may pass any target or line end in motion."""
        return any(self.blending.passes(stop) for task in self.job.tasks for stop in task.stops)

    @property
    def is_timed_whole(self) -> bool:
        """Whether searches can time whole plans: without tool speed limits, care and conveyors."""
        belts = any(stop.belt is not None for task in self.job.tasks for stop in task.stops)
        return not is_slowed(self.job) and not belts

    @property
    def refines(self) -> bool:
        """Whether the method has grids, and refines collision-free plans of this job."""
        is_asked = self.refine is not None and self.settings.search.refinements > 0
        return is_asked and bool(self.job.tasks) and self.is_timed_whole

    @property
    def turns_for_both(self) -> bool:
        """Whether one platform angle is chosen for two arms."""
        return self.model.platform.is_turntable and len(self.model.arms) == 2

    @property
    def simpler(self) -> list[str]:
        """Names of the greedy methods that support this robot and differ on it."""
        return (
            ["fixed", "exact", "linearised"]
            if self.turns_for_both and self.model.has_arm_angles
            else ["fixed"]
        )


@dataclass(frozen=True)
class DrivenStages:
    """Stages of a plan as they are driven."""

    lengths: FloatArray
    """Duration of each stage, the return included [s]; empty if stages collide."""
    colliding: tuple[int, ...] = ()
    """Indices of the stages that collide."""

    @property
    def duration(self) -> float:
        """Cycle time [s]; infinite if stages collide."""
        return float("inf") if self.colliding else float(self.lengths.sum())


Driver = Callable[[list[StagePlan], int | None], DrivenStages | None]
"""Timing of stages as they are driven; it keeps the shortest collision-free plan.

Arguments are the stages and the number of step widths for the refinement of launches, or None for that of the effort.
The result is None for stages that cannot be timed.
"""
Refine = Callable[[MethodProblem, Sequence[StagePlan], DrivenStages, Driver], None]
"""Refinement of a plan's stages.

Arguments are the problem with the bodies that must not collide, the stages, how these are driven, and the driver of
changed ones.
"""


@dataclass(frozen=True)
class Decided:
    """Result of a planning method."""

    stages: list[StagePlan]
    """Stages in order; the return, if any, is the last one."""
    grid_gap: float | None = None
    """Relative gap of the grid's best plan to its lower bound.

    It is computed before refinement.

    None for methods without a grid. Plans off the grid may be faster.
    """
    alternatives: tuple[list[StagePlan], ...] = ()
    """Further plans that exact timing may show to be faster."""
    is_infeasible: bool = False
    """Whether every plan on the grid collides at a stop; the plan shows where."""
    simpler: Callable[[], list[list[StagePlan]]] | None = None
    """Plans of simpler methods, computed if clearance is expensive; None if already compared."""
