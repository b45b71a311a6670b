"""The stages, segments and events of a path that is followed."""

from __future__ import annotations

from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.motion import FollowedPath
from dualarm_cli.model.job import Task
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.motion.builder import MotionBuilder


def add_followed(
    record: MotionBuilder,
    context: PathContext,
    section: tuple[Task, ...],
    found: FollowedPath,
    name: str,
    begin: float,
) -> None:
    """Appends the path itself: one stage with its transfer, one segment per arm, and an event where each tool ends.

    Args:
        record: what is planned so far.
        context: the job.
        section: the path's tasks, one per arm that follows.
        found: the path as it is followed.
        name: of the method.
        begin: when its stage begins, with the transfer where there is one [s].
    """
    clock, end = record.clock, record.clock + found.trajectory.duration
    followers = {task.arm: task for task in section}
    for arm in context.job.cell.robot.arms:
        task = followers.get(arm.name)
        if task is None:
            record.segments.append(Segment(arm.name, "wait", "", "", clock, end, None, "partner"))
            continue
        record.segments.append(Segment(arm.name, "path", task.id, "path", clock, end))
        path = task.path.paths[arm.name] if task.path is not None else None
        assert path is not None
        pose = path.pose(path.length)
        record.events.append(Event(end, arm.name, task.id, "path", f"{arm.name}_tcp", pose, 0.0))
    transfer = record.take_transfer(begin)
    record.add_whole(found.trajectory)
    angle = context.model.platform_angle(found.trajectory.position[-1])
    record.add_work(section[0].id, name, begin, angle, transfer)
