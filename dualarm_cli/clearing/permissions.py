"""What tasks permit to move while tools stand or are on lines, and the notes on where that is not used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dualarm_cli.model.job import Job, PoseTarget, Stop

KEYS = ("dwell_motion", "line_motion")
"""Keys of task files: motion while tools dwell, and motion of the platform while they are on lines."""
NOT_POSSIBLE = {
    "handover": "hand-overs",
    "joints": "targets given as joints",
    "passed": "moves with `blend`, whose targets tools may pass in motion",
    "no dwell": "stops without a dwell",
    "no line": "stops without approach and retract",
}
"""Where such motion is not used, in words."""
ASYNCHRONOUS = "not used, as the arms run asynchronously"
"""Note on asynchronous arms."""
CONVEYORS = "not used in tasks with conveyors"
"""Note on jobs with targets on conveyors."""
NO_PLATFORM = "line_motion: not used, as no platform of one joint can be moved"
"""Note on robots whose platform stands."""
SENSITIVITY = {
    "dwell_motion": "sensitivity: motion in dwells is taken to fit into them with other limits too",
    "line_motion": "sensitivity: on lines on which the platform turns only the joints of the arm count",
}
"""Notes on assumed limits."""


def permitted(job: Job) -> tuple[str, ...]:
    """Returns the KEYS that some stop of a job permits."""
    stops = [stop for task in job.tasks for stop in task.stops]
    return tuple(key for key in KEYS if any(getattr(stop, key) for stop in stops))


def without_permissions(job: Job) -> Job:
    """Returns a job in which nothing may move in dwells, and no platform on lines."""
    tasks = tuple(
        replace(
            task,
            stops=tuple(
                replace(stop, dwell_motion=False, line_motion=False) for stop in task.stops
            ),
        )
        for task in job.tasks
    )
    return replace(job, tasks=tasks)


def why_not(key: str, stop: Stop) -> str:
    """Returns why a stop does not use what it permits, as a key of NOT_POSSIBLE; empty where it can.

    Args:
        key: one of the KEYS.
        stop: which permits it.
    """
    if stop.action in ("give", "take"):
        return "handover"
    if not isinstance(stop.target, PoseTarget):
        return "joints"
    if stop.blend > 0.0:
        return "passed"
    if key == "dwell_motion":
        return "" if stop.dwell.total > 0.0 else "no dwell"
    return "" if stop.approach > 0.0 or stop.retract > 0.0 else "no line"


def unused_notes(job: Job, why: str) -> list[str]:
    """Returns the notes of a job that uses nothing of what it permits, for one reason."""
    return [f"{key}: {why}" for key in permitted(job)]


def permission_notes(job: Job, gain: float | None, *, platform: bool) -> list[str]:
    """Returns where a job's permissions are not used and why, and what they mean for the sensitivity.

    Args:
        job: what is to be done.
        gain: what such motion gains [s], None where nothing may move.
        platform: whether its platform can be moved.
    """
    notes = []
    for key in permitted(job):
        if key == "line_motion" and not platform:
            notes.append(NO_PLATFORM)
        else:
            notes += _not_used(job, key)
    return notes + [SENSITIVITY[key] for key in permitted(job) if gain]


def _not_used(job: Job, key: str) -> list[str]:
    found: dict[str, list[str]] = {}
    for task in job.tasks:
        for stop in task.stops:
            if getattr(stop, key) and (why := why_not(key, stop)):
                found.setdefault(why, []).append(f"{task.id} ({stop.action})")
    return [
        f"{key}: not used at {NOT_POSSIBLE[why]}: {_some(names)}" for why, names in found.items()
    ]


def _some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (", …" if len(names) > 3 else "")
