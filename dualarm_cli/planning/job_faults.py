"""Proven faults: reasons why no plan of a job exists.

`dualarm check` prints them, and the planner refuses them before it searches. Only what is proven is a fault: a target
that no posture reaches at any platform position and turn of the tool, or at which the tool or part, whose pose it
gives, is inside an obstacle. Everything else is for the planner to find out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from dualarm_cli.clearing.blocked import grip_faults, reaches_into, start_faults
from dualarm_cli.errors import InfeasibleError, UnsupportedError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.planning import Section, kind_of, with_needs
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.posture_source import PROVEN_MISS
from dualarm_cli.model.curves.tool_path import TURN_LENGTH
from dualarm_cli.model.job import ANY, Job, PoseTarget, Stop, Task
from dualarm_cli.model.lying import lying_throughout
from dualarm_cli.model.process_work import PathWork
from dualarm_cli.orders.model.tool_changes import with_changes
from dualarm_cli.planning.room_rules import RoomRules
from dualarm_cli.postures.holding import Holding, too_near_obstacle
from dualarm_cli.postures.out_of_reach import out_of_reach
from dualarm_cli.postures.stage_problems import Clock, StageStops
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class FaultSettings:
    """Resolution of the search for faults of a job."""

    belt_step: float = 0.02
    """Spacing of a conveyor's places at which targets are examined [m]."""
    stretches: int = 16
    """Number of equal stretches of a path whose ends are examined."""
    most_junctions: int = 64
    """Maximum number of junctions of a path that are examined."""
    far: float = 2.0
    """Distance beyond reach from which a wrong unit is the likely cause [m]."""
    upwards: float = 0.5
    """Vertical part of a tool's z axis from which the tool points up."""


FAULTS = FaultSettings()


def job_faults(
    job: Job,
    model: CellModel | None = None,
    *,
    check_collisions: bool = True,
    rules: RoomRules | None = None,
) -> list[Refusal]:
    """List all proven reasons why a job is impossible, by file and line.

    Nothing for a robot that is not planned.

    Args:
        job: of a file, with its lines as long as they have to be straight.
        model: its cell with closed forms; None to measure it.
        check_collisions: whether collisions are checked.
        rules: of its parts' rooms, where they are at hand.
    """
    try:
        model = model or CellModel.from_cell(job.cell)
    except UnsupportedError:
        return []
    refusals = (rules or RoomRules.of(job)).faults() if check_collisions else []
    try:
        job = with_needs(job) if job.is_decided and job.mode == "paired" else with_changes(job)
    except InfeasibleError as error:
        refusals += error.refusals
    faults = _Faults(model, job, check_collisions)
    refusals += [*faults.of_tasks(), *faults.of_sections()]
    if check_collisions:
        waiting = lying_throughout(job, (), ())
        empty = replace(job, tasks=(), pairing=None, lying=waiting)
        refusals += start_faults(job, Holding.of(empty))
        refusals += grip_faults(job)
    unique: dict[object, Refusal] = {}
    for refusal in refusals:
        # A stand is visited more than once, and its fault is the same each time.
        unique.setdefault((refusal.place, refusal.arm, refusal.key, refusal.measured), refusal)
    return sorted(unique.values(), key=lambda r: r.place.order if r.place else ("", 0, 0))


@dataclass(frozen=True)
class _Faults:
    """Faults of a job, target by target."""

    model: CellModel
    """The job's cell, with all closed forms."""
    job: Job
    """The job with its tool changes."""
    check_collisions: bool
    """Flag of plans that have to be collision-free."""

    @cached_property
    def _start(self) -> FloatArray:
        """All joints where the motion starts [rad or m], shape (n,)."""
        return np.array(self.job.start_joints)

    @cached_property
    def _clock(self) -> Clock:
        """Joint times with which targets are examined."""
        return Clock.of(self.model, self.job)

    @cached_property
    def _is_placed(self) -> bool:
        """Whether all platform positions are known or can be examined."""
        platform = self.model.platform
        moves = self.job.start == "free" or self.job.in_sections
        return platform.is_chosen or not platform.joints or not moves

    def _arms_with(self, tool: str) -> list[str]:
        """Return the arms that may have a changed tool on; all for no tool."""
        return [arm for arm in self.model.arms if tool in self.job.cell.tool_names(arm)]

    def of_tasks(self) -> Iterator[Refusal]:
        """Iterate over the faults of picks, places, moves, hand-overs and stands."""
        for task in self.job.tasks:
            arms = [arm for arm in self._arms_with(task.tool) if task.allows(arm)]
            if task.alone:
                continue
            by_arm = [[self._fault(arm, task, stop) for stop in task.stops] for arm in arms]
            arm_faults = [[fault for fault in faults if fault is not None] for faults in by_arm]
            if task.arm != ANY:
                yield from (fault for faults in arm_faults for fault in faults)
            elif arm_faults and all(arm_faults):
                yield _by_no_arm(task, arms, [faults[0] for faults in arm_faults])

    def of_sections(self) -> Iterator[Refusal]:
        """Iterate over faults of paths and seams: at their ends, else between."""
        for section in self.job.sections():
            faults = [*self._at(section, "section_begins", 0.0)]
            faults += self._at(section, "section_ends", 1.0)
            if not faults:
                shares = _shares(section[0].path)
                faults = [fault for s in shares for fault in self._at(section, "section_passes", s)]
                faults = sorted(faults, key=lambda fault: -(fault.measured or 0.0))[:1]
            yield from faults

    def _at(self, section: Section, what: str, share: float) -> Iterator[Refusal]:
        """Iterate over the faults at a share of a path or seam."""
        kind = kind_of(section)
        poses = {} if kind is None else kind.along(self.job, section, share)
        for task in (task for task in section if task.arm in poses):
            stop = replace(task.stops[0], target=poses[task.arm], approach=0.0, retract=0.0)
            path = task.path
            slack = PROVEN_MISS if path is None else path.tolerance + path.blend
            turn = 0.0 if path is None else slack / TURN_LENGTH
            if cause := self._unreached(task.arm, task, stop, slack, turn):
                fault = _impossible(what, task.arm, task, stop, cause)
                yield replace(fault, data={**fault.data, "share": share})

    def _fault(self, arm: str, task: Task, stop: Stop) -> Refusal | None:
        """Return the proven reason against a stop of an arm, with remedies, or None."""
        fault = self._bare_fault(arm, task, stop)
        if fault is None or not isinstance(stop.target, PoseTarget):
            return fault
        remedy, pose = fault.remedy, stop.target.pose
        if task.arm == arm and not task.shared and not task.is_change:
            cell, arms = self.job.cell, self._arms_with(task.tool)
            fits = [name for name in arms if cell.opens_to(name, task.tool, cell.width(task.part))]
            others = [name for name in fits if name != arm]
            tried = [self._bare_fault(name, task, s) for name in others for s in task.stops]
            if tried and not any(tried):
                remedy = ("any_arm", *remedy)
        T_own_tool = self.job.cell.T_own_tool(arm, task.tool)
        if (pose * T_own_tool).rotation[2, 2] > FAULTS.upwards:
            half_turn = pin.SE3(pin.utils.rotate("x", np.pi), np.zeros(3))
            over = pose * T_own_tool * half_turn * T_own_tool.inverse()
            turned = replace(stop, target=replace(stop.target, pose=over))
            if self._bare_fault(arm, task, turned) is None:
                remedy = ("turn_over", *remedy)
        return replace(fault, remedy=remedy)

    def _bare_fault(self, arm: str, task: Task, stop: Stop) -> Refusal | None:
        """Return the proven reason against a stop of an arm, or None."""
        if cause := self._unreached(arm, task, stop):
            return _impossible("stop_impossible", arm, task, stop, cause)
        if not self.check_collisions or stop.moves:
            return None
        obstacle = too_near_obstacle(self.job.cell, arm, task, stop)
        return None if obstacle is None else reaches_into(task, stop, arm, obstacle)

    def _unreached(
        self, arm: str, task: Task, stop: Stop, slack: float = PROVEN_MISS, turn: float = 0.0
    ) -> Refusal | None:
        """Return the proof that a target is out of reach, or None.

        On a conveyor it is out of reach wherever it may be.
        """
        if not self._is_placed:
            return None
        places = [stop]
        if stop.belt is not None:
            count = 2 + int(stop.belt.within / FAULTS.belt_step)
            times = np.linspace(stop.belt.passes, stop.belt.last, count)
            places, slack = (
                [stop.met(time) for time in times.tolist()],
                slack + 0.5 * FAULTS.belt_step,
            )
        first: Refusal | None = None
        for place in places:
            stops = StageStops(self.model, self._clock, {arm: (task, place)}, False, None)
            cause = out_of_reach(
                self.model, self._start, stops.at_start(self._start)[arm], slack, turn
            )
            if cause is None:
                return None
            first = first or cause
        return first


def _shares(work: PathWork | None) -> list[float]:
    """List progress values of a path or seam to examine, junctions included."""
    shares = [k / FAULTS.stretches for k in range(1, FAULTS.stretches)]
    for path in () if work is None else work.paths.values():
        step = -(-len(path.junctions) // FAULTS.most_junctions) or 1
        shares += [at / path.length for at in path.junctions[::step]]
    return sorted(set(shares))


def _impossible(key: str, arm: str, task: Task, stop: Stop, cause: Refusal) -> Refusal:
    """Build the fault of a stop or path that is out of reach."""
    remedy: tuple[str, ...] = ("check_unit",) if (cause.measured or 0.0) > FAULTS.far else ()
    if key != "stop_impossible":
        remedy += ("move_work",)
    elif task.is_change or (isinstance(stop.target, PoseTarget) and stop.target.free_yaw):
        remedy += ("move_target",)
    else:
        remedy += ("move_target_or_free_yaw",)
    data = {"action": stop.action.split("_")[0], "cause": cause}
    return Refusal(key, stop.place, task.id, arm, cause.measured, remedy=remedy, data=data)


def _by_no_arm(task: Task, arms: list[str], faults: list[Refusal]) -> Refusal:
    """Build the fault of a task that no arm can do, with reasons."""
    causes = []
    for arm, fault in zip(arms, faults, strict=True):
        cause = fault.data.get("cause")
        if cause is None:  # its sentence names arm and action
            causes.append(replace(fault, place=None, remedy=()))
            continue
        data = {"action": fault.data["action"], "cause": cause}
        at = Refusal("at_stop", data=data) if len(task.stops) > 1 else cause
        causes.append(Refusal("by_arm", arm=arm, data={"cause": at}))
    remedy = tuple(dict.fromkeys(key for fault in faults for key in fault.remedy))
    data = {"causes": causes}
    return Refusal(
        "out_of_reach", task.place, task.id, measured=faults[0].measured, remedy=remedy, data=data
    )
