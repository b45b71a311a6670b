"""Parts that lie while arms move by their own clocks."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.clearance import CellClearance
from dualarm_cli.collision.crowding import crowded_stops, is_same_spot
from dualarm_cli.collision.rooms import rooms_of
from dualarm_cli.collision.scenes import timed_scenes
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.job import Job, StopKey
from dualarm_cli.model.lying import Visit, lying_parts
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.waiting import SAME_TIME


def others_parts(job: Job, arm: str) -> tuple[Visit, ...]:
    """List the other arm's parts that lie away from an arm's own stops.

    They may lie at any time.

    Args:
        job: decided.
        arm: the one whose motion is planned alone.
    """
    visits = [(task, stop) for task in job.tasks for stop in task.stops]
    keys = {lying.key[1:] for lying in lying_parts(job, visits) if lying.task.arm != arm}
    keys -= {one.room.key for one in crowded_stops(job) if one.task.arm == arm}
    own = [stop for task, stop in visits if task.arm == arm]
    return tuple(
        (room.task, room.stop)
        for room in rooms_of(job)
        if room.key in keys and not any(is_same_spot(stop, room) for stop in own)
    )


def with_motion_scenes(
    job: Job, cell: CellClearance, motion: Motion, time: FloatArray
) -> tuple[CellClearance, IntArray]:
    """Add scenes of lying parts to a test; return their numbers (t,) by instant.

    Args:
        job: decided.
        cell: its test.
        motion: of all arms.
        time: instants [s], shape (t,).
    """
    stops: dict[StopKey, Visit] = {
        (t.arm, t.id, s.action): (t, s) for t in job.tasks for s in t.stops
    }
    events = {
        (e.arm, e.task, e.action): e.changes_held
        for e in sorted(motion.events, key=lambda e: e.changes_held)
        if (e.arm, e.task, e.action) in stops and e.action in ("pick", "place")
    }
    changes = np.array(list(events.values()))
    begins, leaves = dict(events), dict(events)
    for part in motion.segments:
        key = part.arm, part.task, part.action
        if part.kind == "approach" and key in begins:
            begins[key] = min(begins[key], part.start)
        if part.kind == "retract" and part.action == "place" and key in leaves:
            leaves[key] = part.end
    first = np.searchsorted(changes, np.array(list(begins.values())) - SAME_TIME, side="right")
    coming = dict(zip(begins, first.tolist(), strict=True))
    # A scene also ends where a retract does: the tool may touch there what it has placed.
    bounds = np.unique(np.concatenate([[-np.inf], changes, np.array(list(leaves.values()))]))
    spans = []
    for begin, done in zip(bounds, np.searchsorted(changes, bounds, side="right"), strict=True):
        leaving = {key[0] for key in events if events[key] <= begin < leaves[key]}
        spans.append((int(done), leaving))
    scenes = timed_scenes(job, cell.rooms, [stops[key] for key in events], coming, spans)
    return cell.in_scenes(scenes), np.searchsorted(bounds, time + SAME_TIME, side="right") - 1
