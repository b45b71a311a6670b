"""Stretches of a motion between the starts and ends of its stages, which may overlap."""

from __future__ import annotations

from bisect import bisect, insort
from itertools import pairwise

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification import tolerances as tol


def edges_of(schedule: Schedule) -> FloatArray:
    """Returns the starts and ends of the stages and of the motion [s]; one stretch where no stages are stated."""
    time = schedule.trajectory.time
    first, last = float(time[0]), float(time[-1])
    edges = sorted({first, *(s.start for s in schedule.stages if first < s.start < last)})
    for end in sorted(stage.end for stage in schedule.stages):
        # An end that only rounding parts from where the next stage starts is no edge of its own.
        place = bisect(edges, end)
        near = (*edges[place - 1 : place + 1], last)
        if first < end < last and all(abs(end - edge) > tol.SAME_TIME for edge in near):
            insort(edges, end)
    return np.array([*edges, last])


def stages_of(schedule: Schedule, edges: FloatArray) -> list[list[int]]:
    """Returns the stages that each stretch between two edges is part of.

    What is between stages counts with the last that has begun: no motion is left out.
    """
    starts = np.array([stage.start for stage in schedule.stages])
    ends = np.array([stage.end for stage in schedule.stages])
    found = []
    for start, end in pairwise(edges.tolist()):
        inside = np.flatnonzero((starts <= start) & (end <= ends + tol.SAME_TIME)).tolist()
        begun = np.flatnonzero(starts <= start)
        last = int(begun[np.argmax(starts[begun])]) if len(begun) else 0
        found.append(inside or [last])
    return found
