"""Problem and solution of a whole method."""

from __future__ import annotations

from collections.abc import Callable

from dualarm_cli.effort import EFFORTS, EffortSettings
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.blending import STOPPING, Blending
from dualarm_cli.model.job import Job
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.stages.plans.clearance import NoGood
from dualarm_cli.stages.plans.problem import Decisions


@dataclass(frozen=True)
class MethodProblem:
    """A job, and how hard to try."""

    model: CellModel
    """The job's cell, ready for kinematics."""
    job: Job
    """What is to be done."""
    redundancy: str
    """Name of the redundancy solver."""
    effort: str = "normal"
    """quick, normal or thorough; greedy methods have one effort only."""
    seed: int = 0
    """Seed of all randomness."""
    holding: Holding | None = None
    """What has to be collision-free; None where nothing has to."""
    no_goods: tuple[NoGood, ...] = ()
    """Stages that turned out to collide; only methods over the whole sequence avoid them."""
    unchecked: tuple[StagePlan, ...] = ()
    """The method's own plan for the same job that collides, if there is one."""
    colliding_stages: tuple[int, ...] = ()
    """Its stages that do not, or only at a cost; the number of stages stands for the return."""
    neighbourhood_only: bool = False
    """Whether a plan is asked for only if there is one near that one: a good one is known that is collision-free.
    Thorough effort, and methods that look at no plan, heed it not."""
    start: Decisions | None = None
    """A plan to begin a search with: that which an order was chosen by."""
    without_margin: MethodProblem | None = None
    """The same problem with the robot's own limits, where this one keeps joints away from them; None where it does not.
    A method may plan with both. Where it finds no plan on its grid it tries nothing else: this one is solved next."""
    blending: Blending = STOPPING
    """Law of where tools pass in motion."""
    repair_touching_stops: bool = True
    """Whether stages in which arms touch at their stops are repaired and decided once more; else the order
    will be changed, which is what helps most."""

    @property
    def settings(self) -> EffortSettings:
        """Settings of the effort."""
        return EFFORTS[self.effort]

    @property
    def blends(self) -> bool:
        """Flag of jobs with targets or line ends that tools may pass in motion."""
        return any(self.blending.passes(stop) for task in self.job.tasks for stop in task.stops)

    @property
    def turns_for_both(self) -> bool:
        """Whether there is a platform angle to choose for two arms."""
        return self.model.platform.is_turntable and len(self.model.arms) == 2

    @property
    def simpler(self) -> list[str]:
        """Names of the greedy methods that serve this robot and differ on it."""
        return (
            ["fixed", "exact", "linearised"]
            if self.turns_for_both and self.model.has_arm_angles
            else ["fixed"]
        )


@dataclass(frozen=True)
class Decided:
    """A method's answer."""

    stages: list[StagePlan]
    """In their order, the return last where there is one."""
    grid_gap: float | None = None
    """How far the best plan on the method's own grid was from that grid's bound, as a share, before it was refined;
    None for methods without a grid. It says nothing about plans off the grid."""
    alternatives: tuple[list[StagePlan], ...] = ()
    """Other plans that may turn out to be faster when they are timed exactly."""
    is_infeasible: bool = False
    """Whether something has to touch at a stop whatever the method does: the plan only shows what."""
    simpler: Callable[[], list[list[StagePlan]]] | None = None
    """Simpler methods' plans, for where avoiding collisions costs much; None where they were tried."""
