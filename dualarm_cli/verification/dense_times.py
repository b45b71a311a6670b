"""Instants at which a motion is looked at, of many spans at once: knots, and instants between all of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.verification.tolerances import TOL
from dualarm_cli.verification.tool_model import ToolModel

PER_INTERVAL = 4
"""Instants looked at between two knots."""
AT_ONCE = 256
"""Spans measured at once, so that long motions need no more memory than short ones."""

ToolSpan = tuple[str, float, float]
"""An arm, and from when to when its tool is looked at [s]."""


def dense_times(knots: FloatArray, start: float, end: float) -> FloatArray:
    """Returns the knots between two instants, the ends, and instants between all of them."""
    return dense_spans(knots, [start], [end])[0]


def dense_spans(
    knots: FloatArray, starts: ArrayLike, ends: ArrayLike
) -> tuple[FloatArray, IntArray]:
    """Returns the `dense_times` of spans one after the other, and where each span's begin in them, shape (s + 1,).

    Args:
        knots: of the motion [s], rising.
        starts: of the spans [s], shape (s,).
        ends: of the spans [s], shape (s,).
    """
    start, end = np.asarray(starts, dtype=np.float64), np.asarray(ends, dtype=np.float64)
    first = np.searchsorted(knots, start + TOL.same_time)
    inside = np.maximum(np.searchsorted(knots, end - TOL.same_time) - first, 0)
    # The edges of each span: its start, the knots inside, its end; each once.
    last = np.cumsum(inside + 2) - 1
    span = np.repeat(np.arange(len(start)), inside + 2)
    place = np.arange(len(span)) - (last - inside - 1)[span]
    edges = knots[np.clip(first[span] + place - 1, 0, len(knots) - 1)]
    edges[last - inside - 1], edges[last] = np.minimum(start, end), np.maximum(start, end)
    kept = np.diff(edges, append=np.inf) != 0.0
    kept[last] = True
    edges, span = edges[kept], span[kept]
    final = np.cumsum(np.bincount(span, minlength=len(start))) - 1
    share = np.arange(PER_INTERVAL) / PER_INTERVAL
    times = edges[:, None] + np.diff(edges, append=0.0)[:, None] * share
    times[final, 0] = end
    wanted = np.ones(times.shape, dtype=np.bool_)
    wanted[final, 1:] = False
    count = np.bincount(span, minlength=len(start)) * PER_INTERVAL - PER_INTERVAL + 1
    return times[wanted], np.concatenate([[0], np.cumsum(count)])


def tool_spans(
    trajectory: Trajectory, model: ToolModel, spans: Sequence[ToolSpan]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yields rotations (m, 3, 3) and positions (m, 3) [m] of the tool at the `dense_times` of each span.

    Args:
        trajectory: the motion.
        model: where the tools are.
        spans: in any order; those next to each other are measured together.
    """
    for k in range(0, len(spans), AT_ONCE):
        some = spans[k : k + AT_ONCE]
        times, first = dense_spans(trajectory.time, *np.array([span[1:] for span in some]).T)
        positions = trajectory.at(times)[0]
        poses = {arm: model.poses(arm, positions) for arm in {span[0] for span in some}}
        for (arm, _, _), (begin, end) in zip(some, pairwise(first), strict=True):
            R, p = poses[arm]
            yield R[begin:end], p[begin:end]
