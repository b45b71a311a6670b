"""A seam as it is planned, and what is recorded of it: stages, segments, events, and what a reader should know."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.motion import TimedSeam
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Dwell, Task
from dualarm_cli.model.joint_motion import SAME_TIME
from dualarm_cli.model.schedule import Event, Segment, SegmentKind, Stage, WaitReason
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.composition import hold


@dataclass(frozen=True)
class PlannedSeam:
    """A seam with the tool's way to it and from it."""

    approach: Trajectory | None
    """To where it begins; None for no length."""
    dwell_start: Trajectory
    """Standing where it begins."""
    seam: TimedSeam
    """The seam."""
    dwell_end: Trajectory
    """Standing where it ends."""
    retract: Trajectory | None
    """Away from it; None for no length."""
    solver: str
    """Name of the seam solver."""
    chain: Chain
    """Part and tool."""

    @property
    def coming(self) -> float:
        """How long the tool's approach and its dwell before the seam take [s]."""
        return self.dwell_start.duration + (self.approach.duration if self.approach else 0.0)

    @property
    def first(self) -> FloatArray:
        """All joints where the tool's approach begins [rad], shape (n,)."""
        start: FloatArray = (self.approach or self.seam.trajectory).position[0]
        return start


def quicker(one: PlannedSeam | Refusal, other: PlannedSeam | Refusal) -> PlannedSeam | Refusal:
    """Returns the quicker of two answers; a plan before any reason, the later reason before the earlier one."""
    if isinstance(other, Refusal):
        return other if isinstance(one, Refusal) else one
    if isinstance(one, Refusal):
        return other
    return min(one, other, key=lambda plan: plan.seam.trajectory.duration)


def add_seam(
    record: MotionBuilder,
    model: CellModel,
    section: tuple[Task, ...],
    found: PlannedSeam,
    begin: float,
    job_speed: float,
) -> None:
    """Appends a seam: a stage up to where it begins, with the transfer there, and a stage for itself.

    Args:
        record: what is planned so far, the transfer as its last stage.
        model: the job's cell.
        section: the seam's tasks, one per arm that works.
        found: the seam as it is worked.
        begin: when its first stage begins, with the transfer where there is one [s].
        job_speed: the job's share of full speed.
    """
    writer = _Writer(record, model, section)
    transfer = record.take_transfer(begin)
    work = found.chain.work
    # Where there is no transfer that takes the time of the way there, it is waited for.
    entry = begin + (work.entry_duration or 0.0) / job_speed
    late = max(work.not_before, entry) - record.clock - found.coming
    if late > SAME_TIME:
        writer.add("wait", "seam_start", hold(model.cell.robot.joints, found.first, late), None)
    if found.approach is not None:
        writer.add("approach", "seam_start", found.approach, "wait")
    writer.event("seam_start", found.seam.trajectory.position[0], work.dwell_start)
    if work.dwell_start > 0.0:
        writer.add("dwell", "seam_start", found.dwell_start, "wait")
    writer.stage(found.solver, begin, transfer, found.seam.trajectory.position[0])
    begin = record.clock
    writer.add("seam", "seam_end", found.seam.trajectory, "seam")
    writer.event("seam_end", found.seam.trajectory.position[-1], work.dwell_end)
    if work.dwell_end > 0.0:
        writer.add("dwell", "seam_end", found.dwell_end, "wait")
    if found.retract is not None:
        writer.add("retract", "seam_end", found.retract, "wait")
    writer.stage(found.solver, begin, None, record.end)


class _Writer:
    """Appends the pieces of one seam."""

    def __init__(self, record: MotionBuilder, model: CellModel, section: tuple[Task, ...]) -> None:
        self._record, self._model = record, model
        self._tasks = {task.arm: task for task in section}
        work = section[0].seam
        assert work is not None
        self._work = work

    def add(
        self, kind: SegmentKind, action: str, motion: Trajectory, master: SegmentKind | None
    ) -> None:
        """Appends a motion: what the slave does, and what the master does meanwhile, the same if None."""
        record = self._record
        start, end = record.clock, record.clock + motion.duration
        for arm in self._model.cell.robot.arms:
            task = self._tasks.get(arm.name)
            if task is None:
                part = Segment(arm.name, "wait", "", "", start, end, reason="partner")
                record.segments.append(part)
                continue
            own = kind if master is None or arm.name == self._work.slave else master
            dwell = Dwell(gripper=end - start) if own == "dwell" else None
            reason: WaitReason = ""
            if own == "wait":
                reason = "window" if kind == "wait" else "partner"
            part = Segment(arm.name, own, task.id, action, start, end, dwell, reason)
            record.segments.append(part)
        record.add_whole(motion)

    def event(self, action: str, position: np.ndarray, dwell: float) -> None:
        """Notes where the working arms' tools are now."""
        for name, task in self._tasks.items():
            pose = self._model.tool_pose(name, position)
            stands = dwell if name == self._work.slave else 0.0
            self._record.events.append(
                Event(self._record.clock, name, task.id, action, f"{name}_tcp", pose, stands)
            )

    def stage(
        self, solver: str, begin: float, transfer: Stage | None, position: np.ndarray
    ) -> None:
        """Closes a stage in which the robot comes to a position; it has no length where a plan begins on the seam."""
        task = next(iter(self._tasks.values())).id
        angle = self._model.platform_angle(position)
        self._record.add_work(task, solver, begin, angle, transfer)
