"""The platform's lane of a Gantt chart: when it moves, and where it stands in between."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.reporting.gantt_labels import Bar, Wanted
from dualarm_cli.reporting.measures import sliding_joints

STILL = 1e-7
"""Platform joints that are slower than this stand [rad/s or m/s]."""
SHORT = 1e-3
"""Shortest time in which a way counts by itself [s]."""
WHOLE = 0.05
"""Angles nearer than this to whole degrees are written as such [°]."""


def platform_moves(schedule: Schedule) -> list[tuple[float, float]]:
    """Returns when any joint of the platform moves, as spans [s] with standing between them."""
    trajectory = schedule.trajectory
    columns = [trajectory.joints.index(name) for name in schedule.robot.platform]
    if not columns:
        return []
    q, v = trajectory.position[:, columns], trajectory.velocity[:, columns]
    step = np.diff(trajectory.time)
    fast: BoolArray = np.any(np.abs(v) > STILL, axis=1)
    far = (np.abs(np.diff(q, axis=0)) > STILL * np.maximum(step, SHORT)[:, None]).any(axis=1)
    moves: BoolArray = (fast[1:] | fast[:-1] | far) & (step > 0.0)
    spans: list[tuple[float, float]] = []
    for k in np.flatnonzero(moves).tolist():
        start, end = float(trajectory.time[k]), float(trajectory.time[k + 1])
        if spans and start <= spans[-1][1] and not _stops(v, k):
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((start, end))
    return spans


def _stops(velocity: FloatArray, knot: int) -> bool:
    """Returns whether the platform comes to rest at a knot between two moves."""
    return bool((np.abs(velocity[knot]) <= STILL).all())


def platform_words(
    schedule: Schedule, moves: Sequence[tuple[float, float]], lane: int, start: float, end: float
) -> list[Wanted]:
    """Returns where the platform stands for a row, wherever it stands.

    Args:
        schedule: the schedule.
        moves: when the platform moves [s].
        lane: its lane.
        start: of the row [s].
        end: of the row [s].
    """
    trajectory = schedule.trajectory
    columns = [trajectory.joints.index(name) for name in schedule.robot.platform]
    if not columns:
        return []
    sliding = sliding_joints(schedule.robot.urdf)
    slides = [name in sliding for name in schedule.robot.platform]
    edges = [float(trajectory.time[0]), *np.ravel(moves).tolist(), float(trajectory.time[-1])]
    words = []
    for stands, leaves in zip(edges[::2], edges[1::2], strict=True):
        a, b = max(stands, start), min(leaves, end)
        if a < b:
            q = trajectory.at(np.array([(a + b) / 2.0]))[0][0, columns]
            text = ", ".join(place_text(float(v), s) for v, s in zip(q, slides, strict=True))
            whole = stands >= start and leaves <= end
            words.append(Wanted(text, lane, (Bar(0, a, b, False),), whole))
    return words


def place_text(value: float, slides: bool) -> str:
    """Returns where a joint stands: an angle [rad] in degrees, to a tenth where it is not whole; a way [m] in mm."""
    shown = value * 1e3 if slides else math.degrees(value)
    digits = 0 if slides or abs(shown - round(shown)) < WHOLE else 1
    text = f"{round(shown, digits) + 0.0:.{digits}f}".replace("-", "−")
    return f"{text} mm" if slides else f"{text}°"
