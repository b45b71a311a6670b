"""Jobs with drawn poses and dwells, as a cell meets them from cycle to cycle."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task


def drawn_job(job: Job, seed: int, number: int) -> Job:
    """Draw what varies in a job: poses evenly within their ranges, dwells as triangles.

    A draw depends on seed and number alone, not on how many there are. Ranges of one name, such as of a frame, and
    all grasps of a task have the same deviations.

    Args:
        job: with ranges.
        seed: of all draws.
        number: of the draw, from 1.
    """
    random = np.random.default_rng([seed, number])
    stops = [(task.id, stop) for task in job.tasks for stop in task.stops]
    names = dict.fromkeys(spread.of for _, stop in stops for spread in stop.ranges)
    deviations = {name: random.uniform(-1.0, 1.0, 4).tolist() for name in names}
    dwells: dict[tuple[str, str], Dwell] = {}
    for task_id, stop in stops:
        if stop.varying:
            longer = sum(
                float(part.drawn(random.random(1))[0]) - part.nominal for part in stop.varying
            )
            dwells[task_id, stop.action] = Dwell(stop.dwell.total + longer)

    def drawn_stop(task_id: str, stop: Stop) -> Stop:
        # In a hand-over the giver stands as long as the taker grips.
        action = "take" if stop.action == "give" else stop.action
        stop = replace(stop, dwell=dwells.get((task_id, action), stop.dwell), varying=())
        if not isinstance(stop.target, PoseTarget):
            return stop
        pose = stop.target.pose
        for spread in stop.ranges:
            pose = spread.moved(pose, deviations[spread.of])
        return replace(stop, target=replace(stop.target, pose=pose), ranges=())

    def drawn(task: Task) -> Task:
        return replace(
            task,
            stops=tuple(drawn_stop(task.id, stop) for stop in task.stops),
            grasps=tuple(map(drawn, task.grasps)),
        )

    return replace(job, tasks=tuple(map(drawn, job.tasks)))


def count_varying(job: Job) -> dict[str, int]:
    """Count what varies in a job: targets, frames and dwells."""
    stops = [stop for task in job.tasks for stop in task.stops]
    names = {spread.of for stop in stops for spread in stop.ranges}
    frames = {spread.of for ranges in job.cell.varying.values() for spread in ranges} & names
    dwells = sum(bool(stop.varying) for stop in stops)
    return {"targets": len(names) - len(frames), "frames": len(frames), "dwells": dwells}
