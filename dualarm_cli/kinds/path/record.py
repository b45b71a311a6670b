"""The stages, segments and events of a path that is followed."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.kinds.path.context import PathContext
from dualarm_cli.kinds.path.motion import FollowedPath
from dualarm_cli.model.job import Task
from dualarm_cli.model.schedule import DURATION, Event, Segment
from dualarm_cli.motion.builder import Motion, MotionBuilder
from dualarm_cli.timing.composition import drawn_out


def drawn_out_transfer(motion: Motion, duration: float) -> Motion:
    """Returns a transfer that takes a longer time [s], on the same way."""
    factor = duration / motion.trajectory.duration
    return replace(
        motion,
        trajectory=drawn_out(motion.trajectory, factor),
        stages=tuple(
            replace(s, start=s.start * factor, end=s.end * factor, bottleneck=DURATION)
            for s in motion.stages
        ),
        segments=tuple(
            replace(s, start=s.start * factor, end=s.end * factor) for s in motion.segments
        ),
    )


def add_transfer(record: MotionBuilder, motion: Motion, section: tuple[Task, ...]) -> None:
    """Appends the transfer to where a path begins; its stage becomes that of the path.

    Args:
        record: what is planned so far.
        motion: the transfer, one stage.
        section: the path's tasks, one per arm that follows.
    """
    names = {task.arm: task.id for task in section}
    segments = tuple(
        replace(
            s,
            kind="transfer" if s.kind == "return" else s.kind,
            task=names.get(s.arm, ""),
            action=section[0].stops[0].action if s.arm in names else "",
        )
        for s in motion.segments
    )
    record.append(replace(motion, segments=segments))


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
