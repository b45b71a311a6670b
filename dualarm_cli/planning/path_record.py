"""What is planned of a job with paths so far: motions one after the other, with stages, segments and events."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from dualarm_cli.model.job import Task
from dualarm_cli.model.schedule import Event, Segment, Stage
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.motion import Motion
from dualarm_cli.planning.path_motion import Followed, PathContext
from dualarm_cli.planning.stage_plan import StagePlan


@dataclass
class Record:
    """What is planned so far."""

    pieces: list[Trajectory] = field(default_factory=list)
    stages: list[Stage] = field(default_factory=list)
    segments: list[Segment] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stage_plans: list[StagePlan] = field(default_factory=list)
    clock: float = 0.0
    cost: float = 0.0

    def add(self, motion: Motion) -> None:
        """Appends a motion as it is."""
        t = self.clock
        self.pieces.append(motion.trajectory)
        self.stages += [replace(s, start=s.start + t, end=s.end + t) for s in motion.stages]
        self.segments += [replace(s, start=s.start + t, end=s.end + t) for s in motion.segments]
        self.events += [replace(e, time=e.time + t) for e in motion.events]
        self.clock += motion.trajectory.duration


def add_transfer(record: Record, motion: Motion, section: tuple[Task, ...]) -> None:
    """Appends the transfer to where a path begins; its stage becomes that of the path."""
    names = {task.arm: task.id for task in section}
    segments = tuple(
        replace(s, kind="transfer", task=names[s.arm], action="path")
        if s.kind == "return" and s.arm in names
        else replace(s, kind="transfer")
        if s.kind == "return"
        else s
        for s in motion.segments
    )
    record.add(replace(motion, segments=segments))


def add_followed(
    record: Record,
    context: PathContext,
    section: tuple[Task, ...],
    found: Followed,
    name: str,
    begin: float,
) -> None:
    """Appends the path itself: one stage with its transfer, one segment per arm, and an event where each tool ends."""
    clock, end = record.clock, record.clock + found.trajectory.duration
    followers = {task.arm: task for task in section}
    for arm in context.job.cell.robot.arms:
        task = followers.get(arm.name)
        if task is None:
            record.segments.append(Segment(arm.name, "wait", "", "", clock, end))
            continue
        record.segments.append(Segment(arm.name, "path", task.id, "path", clock, end))
        path = task.path.paths[arm.name] if task.path is not None else None
        assert path is not None
        pose = path.pose(path.length)
        record.events.append(Event(end, arm.name, task.id, "path", f"{arm.name}_tcp", pose, 0.0))
    transfer = record.stages.pop() if record.clock > begin else None
    columns = context.model.platform_columns
    angle = float(found.trajectory.position[-1, columns[0]]) if len(columns) == 1 else None
    record.stages.append(
        Stage(
            start=begin,
            end=end,
            tasks=(section[0].id,),
            platform_solver=name,
            platform_angle=angle,
            platform_time=transfer.platform_time if transfer else 0.0,
            arm_times=transfer.arm_times if transfer else {},
            joint_times=transfer.joint_times if transfer else {},
            bottleneck=transfer.bottleneck if transfer else "",
        )
    )
    record.pieces.append(found.trajectory)
    record.clock = end
