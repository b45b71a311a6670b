"""Planned seams and their records: stages, segments and events."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.kinds.seam.motion import TimedSeam
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Task
from dualarm_cli.model.motion.trajectory import SAME_TIME, Trajectory
from dualarm_cli.model.schedule import Event, Segment, SegmentKind, Stage, WaitReason
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.composition import hold


@dataclass(frozen=True)
class PlannedSeam:
    """Seam with approach, dwells and retract."""

    approach: Trajectory | None
    """Approach to the seam; None without length."""
    dwell_start: Trajectory
    """Dwell at the begin."""
    seam: TimedSeam
    """The seam."""
    dwell_end: Trajectory
    """Dwell at the end."""
    retract: Trajectory | None
    """Retract from the seam; None without length."""
    solver: str
    """Name of the seam solver."""
    chain: Chain
    """Part and tool."""

    @property
    def lead_time(self) -> float:
        """Duration of the approach and the dwell before the seam [s]."""
        return self.dwell_start.duration + (self.approach.duration if self.approach else 0.0)

    @property
    def start_joints(self) -> FloatArray:
        """All joints at the start of the approach [rad], shape (n,)."""
        start: FloatArray = (self.approach or self.seam.trajectory).position[0]
        return start


def quicker_seam(
    first: PlannedSeam | Refusal, second: PlannedSeam | Refusal
) -> PlannedSeam | Refusal:
    """Select the plan with the shorter seam.

    A plan wins over a refusal, and the second refusal over the first.
    """
    if isinstance(second, Refusal):
        return second if isinstance(first, Refusal) else first
    if isinstance(first, Refusal):
        return second
    return min(first, second, key=lambda plan: plan.seam.trajectory.duration)


def add_seam(
    record: MotionBuilder,
    model: CellModel,
    section: tuple[Task, ...],
    planned: PlannedSeam,
    begin: float,
    job_speed: float,
) -> None:
    """Append two stages, up to the first dwell and up to the retract.

    The first begins with the transfer, the second with the seam.

    Args:
        record: the plan so far, with the transfer as its last stage.
        model: the cell model.
        section: the seam's tasks, one per working arm.
        planned: the planned seam.
        begin: start of its first stage, including the transfer [s].
        job_speed: the job's fraction of full speed.
    """
    writer = _Writer(record, model, section)
    transfer = record.take_transfer(begin)
    work = planned.chain.work
    # Without a transfer to stretch, a wait fills the entry's duration.
    entry = begin + (work.entry_duration or 0.0) / job_speed
    wait = max(work.not_before, entry) - record.clock - planned.lead_time
    if wait > SAME_TIME:
        writer.add(
            "wait", "seam_start", hold(model.cell.robot.joints, planned.start_joints, wait), None
        )
    if planned.approach is not None:
        writer.add("approach", "seam_start", planned.approach, "wait")
    writer.event("seam_start", planned.seam.trajectory.position[0], work.dwell_start)
    if work.dwell_start > 0.0:
        writer.add("dwell", "seam_start", planned.dwell_start, "wait")
    writer.stage(planned.solver, begin, transfer, planned.seam.trajectory.position[0])
    begin = record.clock
    writer.add("seam", "seam_end", planned.seam.trajectory, "seam")
    writer.event("seam_end", planned.seam.trajectory.position[-1], work.dwell_end)
    if work.dwell_end > 0.0:
        writer.add("dwell", "seam_end", planned.dwell_end, "wait")
    if planned.retract is not None:
        writer.add("retract", "seam_end", planned.retract, "wait")
    writer.stage(planned.solver, begin, None, record.end)


class _Writer:
    """Writer of the pieces of one seam."""

    def __init__(self, record: MotionBuilder, model: CellModel, section: tuple[Task, ...]) -> None:
        self._record, self._model = record, model
        self._tasks = {task.arm: task for task in section}
        work = section[0].seam
        assert work is not None
        self._work = work

    def add(
        self, kind: SegmentKind, action: str, motion: Trajectory, master: SegmentKind | None
    ) -> None:
        """Append a motion of the slave, with the master's kind of segment.

        None for the same kind.
        """
        record = self._record
        start, end = record.clock, record.clock + motion.duration
        for arm in self._model.cell.robot.arms:
            task = self._tasks.get(arm.name)
            if task is None:
                part = Segment(arm.name, "wait", "", "", start, end, reason="partner")
                record.segments.append(part)
                continue
            arm_kind = kind if master is None or arm.name == self._work.slave else master
            dwell = Dwell(gripper=end - start) if arm_kind == "dwell" else None
            reason: WaitReason = ""
            if arm_kind == "wait":
                reason = "window" if kind == "wait" else "partner"
            part = Segment(arm.name, arm_kind, task.id, action, start, end, dwell, reason)
            record.segments.append(part)
        record.add_whole(motion)

    def event(self, action: str, position: np.ndarray, dwell: float) -> None:
        """Record the tool poses of the working arms."""
        for name, task in self._tasks.items():
            pose = self._model.tool_pose(name, position)
            stands = dwell if name == self._work.slave else 0.0
            self._record.events.append(
                Event(self._record.clock, name, task.id, action, f"{name}_tcp", pose, stands)
            )

    def stage(
        self, solver: str, begin: float, transfer: Stage | None, position: np.ndarray
    ) -> None:
        """Close a stage at a position.

        It has no length if a plan begins on the seam.
        """
        task = next(iter(self._tasks.values())).id
        angle = self._model.platform_angle(position)
        self._record.add_work(task, solver, begin, angle, transfer)
