"""The least distance over time, with the two bodies that are nearest to what is required of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import geometry_model
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.page.packed import packed
from dualarm_cli.verification.clearance_checks import watched_pairs

PER_STAGE = 10
"""Instants that are looked at, per stage."""
FEWEST, MOST = 100, 3000
"""Instants that are looked at."""


def clearance_curve(schedule: Schedule, job: Job) -> dict[str, Any] | None:
    """Returns samples of the least distance as the page reads them; None where no two bodies can touch.

    What may lie on something is left out on the lines where it does. The verifier's proof is between the samples, too;
    this curve proves nothing.

    Args:
        schedule: a verified one.
        job: as it was done (`job_as_done`).
    """
    model, solids, pairs, windows = watched_pairs(schedule, job)
    kept = [k for k, pair in enumerate(pairs) if pair.required >= 0.0]
    if not kept:
        return None
    times = _instants(schedule)
    places = list(dict.fromkeys((pairs[k].first, pairs[k].second) for k in kept))
    column = {place: number for number, place in enumerate(places)}
    own = np.array([column[pairs[k].first, pairs[k].second] for k in kept])
    required = np.array([pairs[k].required for k in kept])
    counts = np.array([_during(windows[k], times) for k in kept])
    geometry = geometry_model(solids, places)
    found, data = pin.GeometryData(geometry), model.createData()
    order = [schedule.trajectory.joints.index(name) for name in model.names[1:]]
    postures = schedule.trajectory.at(times)[0][:, order]
    base = job.cell.base
    distance, number, points = np.full(len(times), np.inf), np.zeros(len(times)), []
    for row, q in enumerate(postures):
        pin.computeDistances(model, data, geometry, found, q)
        all_distances = np.array([result.min_distance for result in found.distanceResults])
        margins = np.where(counts[:, row], all_distances[own] - required, np.inf)
        least = int(np.argmin(margins))
        result = found.distanceResults[int(own[least])]
        distance[row], number[row] = result.min_distance, least
        ends = (base.act(result.getNearestPoint1()), base.act(result.getNearestPoint2()))
        points.append(np.concatenate(ends))
    used, pair = np.unique(number.astype(np.int64), return_inverse=True)
    bodies = [
        [solids[i].label for i in (pairs[kept[k]].first, pairs[kept[k]].second)] for k in used
    ]
    return {
        "time": packed(times, "f64"),
        "distance": packed(distance, "f32"),
        "pair": packed(pair, "u32"),
        "points": packed(np.array(points), "f32"),
        "pairs": bodies,
        "required": [float(required[k]) for k in used],
    }


def _instants(schedule: Schedule) -> FloatArray:
    """Returns the instants that are looked at [s]: evenly over the motion, and those of the least clearances."""
    time = schedule.trajectory.time
    count = int(np.clip(PER_STAGE * len(schedule.stages), FEWEST, MOST))
    even = np.linspace(float(time[0]), float(time[-1]), count)
    proven = schedule.verification.clearances if schedule.verification is not None else ()
    return np.unique(np.concatenate([even, [stage.time for stage in proven]]))


def _during(windows: Any, times: FloatArray) -> BoolArray:
    """Returns at which times a pair counts, shape (n,)."""
    if windows is None:
        return np.ones(len(times), dtype=np.bool_)
    inside = np.zeros(len(times), dtype=np.bool_)
    for start, end in windows:
        inside |= (start <= times) & (times <= end)
    return inside
