"""The least distances over time, with the two bodies that are nearest to what is required of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import WORLD, Solid, geometry_model
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, distinct
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.page.packed import packed
from dualarm_cli.verification.clearance_checks import watched_pairs

PER_STAGE = 20
"""Instants that are looked at, per stage."""
FEWEST, MOST = 200, 3000
"""Instants that are looked at."""
NEAR = 3
"""Bodies of the robot with no more joints between them are near links."""
CLEARANCE, NEAR_LINKS = "clearance", "near links"
"""What the curves are called."""


def clearance_curves(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Returns samples of the least distance as the page reads them, of all pairs together but those of near links.

    Near links have a curve of their own: a few joints alone set their distance, which often stays the same during the
    whole plan and then hides how far arms, tools, parts and obstacles are from each other.
    What may lie on something is left out on the lines where it does. The verifier's proof is between the samples, too;
    these curves prove nothing.

    Args:
        schedule: a verified one.
        job: as it was done (`job_as_done`).

    Returns:
        The curves that have pairs: two, one or none.
    """
    watched = watched_pairs(schedule, job)
    model, solids, pairs, windows = watched.model, watched.solids, watched.pairs, watched.windows
    proven = schedule.verification.clearances if schedule.verification is not None else ()
    nearest = {name for stage in proven for name in stage.bodies}
    # Most parts that wait or lie are never the nearest.
    kept = [
        k
        for k, pair in enumerate(pairs)
        if pair.required >= 0.0 and solids[pair.second].lying in {"", *nearest}
    ]
    if not kept:
        return []
    times = _instants(schedule)
    places = list(dict.fromkeys((pairs[k].first, pairs[k].second) for k in kept))
    column = {place: number for number, place in enumerate(places)}
    own = np.array([column[pairs[k].first, pairs[k].second] for k in kept])
    required = np.array([pairs[k].required for k in kept])
    counts = np.array([_during(windows[k], times) for k in kept])
    near = np.array(
        [_are_near(model, solids[pairs[k].first], solids[pairs[k].second]) for k in kept]
    )
    names = [[solids[i].label for i in (pairs[k].first, pairs[k].second)] for k in kept]
    geometry = geometry_model(solids, places)
    found, data = pin.GeometryData(geometry), model.createData()
    # Kept, as pinocchio fills the same ones each time, and each would be wrapped anew otherwise.
    results = list(found.distanceResults)
    order = [watched.trajectory.joints.index(name) for name in model.names[1:]]
    curves = [(CLEARANCE, ~near), (NEAR_LINKS, near)]
    samples = {name: _Samples() for name, own_pairs in curves if own_pairs.any()}
    for row, q in enumerate(watched.trajectory.at(times)[0][:, order]):
        pin.computeDistances(model, data, geometry, found, q)
        distances = np.array([result.min_distance for result in results])
        for name, own_pairs in curves:
            margins = np.where(counts[:, row] & own_pairs, distances[own] - required, np.inf)
            least = int(np.argmin(margins))
            if np.isfinite(margins[least]):
                result = results[int(own[least])]
                samples[name].add(times[row], least, result, job.cell.base)
    return [
        {"name": name} | some.packed(names, required) for name, some in samples.items() if some.time
    ]


class _Samples:
    """Samples of one curve."""

    def __init__(self) -> None:
        """Begins without any."""
        self.time: list[float] = []
        self.pair: list[int] = []
        self.distance: list[float] = []
        self.points: list[FloatArray] = []

    def add(self, time: float, pair: int, result: Any, base: pin.SE3) -> None:
        """Adds the pair that is nearest to what is required of it at a time [s]."""
        self.time.append(time)
        self.pair.append(pair)
        self.distance.append(result.min_distance)
        ends = (base.act(result.getNearestPoint1()), base.act(result.getNearestPoint2()))
        self.points.append(np.concatenate(ends))

    def packed(self, names: list[list[str]], required: FloatArray) -> dict[str, Any]:
        """Returns the samples as the page reads them, with those pairs only that are in them."""
        used, pair = np.unique(self.pair, return_inverse=True)
        return {
            "time": packed(self.time, "f64"),
            "distance": packed(self.distance, "f32"),
            "pair": packed(pair, "u32"),
            "points": packed(self.points, "f32"),
            "pairs": [names[k] for k in used],
            "required": [float(required[k]) for k in used],
        }


def _are_near(model: pin.Model, one: Solid, other: Solid) -> bool:
    """Returns whether both are the robot's own, or on it, with few joints between them."""
    if WORLD in (one.joint, other.joint) and not {one.body, other.body} <= _links(model):
        return False
    joints = set(model.supports[one.joint]) ^ set(model.supports[other.joint])
    return len(joints) <= NEAR


def _links(model: pin.Model) -> set[str]:
    return {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}


def _instants(schedule: Schedule) -> FloatArray:
    """Returns the instants that are looked at [s]: evenly over the motion, and those of the least clearances."""
    time = schedule.trajectory.time
    count = int(np.clip(PER_STAGE * len(schedule.stages), FEWEST, MOST))
    even = np.linspace(float(time[0]), float(time[-1]), count)
    proven = schedule.verification.clearances if schedule.verification is not None else ()
    return distinct(np.concatenate([even, [stage.time for stage in proven]]))


def _during(windows: Any, times: FloatArray) -> BoolArray:
    """Returns at which times a pair counts, shape (n,)."""
    if windows is None:
        return np.ones(len(times), dtype=np.bool_)
    inside = np.zeros(len(times), dtype=np.bool_)
    for start, end in windows:
        inside |= (start <= times) & (times <= end)
    return inside
