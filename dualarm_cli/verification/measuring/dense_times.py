"""Instants at which motions are sampled: knots, and instants between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.measuring.tool_model import ToolModel

PER_INTERVAL = 4
"""Number of instants from one knot to the next."""
AT_ONCE = 256
"""Maximum number of spans measured at once, to limit memory."""

ToolSpan = tuple[str, float, float]
"""Arm, and start and end of the span in which its tool is sampled [s]."""


def dense_times(knots: FloatArray, start: float, end: float) -> FloatArray:
    """List the ends of a span, the knots inside and instants between them [s]."""
    return dense_spans(knots, [start], [end])[0]


def dense_spans(
    knots: FloatArray, starts: ArrayLike, ends: ArrayLike
) -> tuple[FloatArray, IntArray]:
    """List the `dense_times` of spans, with the first row of each span.

    Args:
        knots: of the motion [s], rising.
        starts: of the spans [s], shape (s,).
        ends: of the spans [s], shape (s,).

    Returns:
        Instants [s] of one span after the other, and the rows at which spans begin, shape (s + 1,).
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
    is_new = np.diff(edges, append=np.inf) != 0.0
    is_new[last] = True
    edges, span = edges[is_new], span[is_new]
    final = np.cumsum(np.bincount(span, minlength=len(start))) - 1
    fraction = np.arange(PER_INTERVAL) / PER_INTERVAL
    times = edges[:, None] + np.diff(edges, append=0.0)[:, None] * fraction
    times[final, 0] = end
    selected = np.ones(times.shape, dtype=np.bool_)
    selected[final, 1:] = False
    count = np.bincount(span, minlength=len(start)) * PER_INTERVAL - PER_INTERVAL + 1
    return times[selected], np.concatenate([[0], np.cumsum(count)])


def tool_spans(
    trajectory: Trajectory, model: ToolModel, spans: Sequence[ToolSpan]
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the tool's poses at the `dense_times` of each span.

    Args:
        trajectory: the motion.
        model: forward kinematics of the tools.
        spans: in any order; neighbouring ones are measured together.

    Yields:
        Rotations (m, 3, 3) and positions (m, 3) [m].
    """
    for k in range(0, len(spans), AT_ONCE):
        batch = spans[k : k + AT_ONCE]
        times, first = dense_spans(trajectory.time, *np.array([span[1:] for span in batch]).T)
        positions = trajectory.clamped(times)[0]
        poses = {arm: model.poses(arm, positions) for arm in {span[0] for span in batch}}
        for (arm, _, _), (begin, end) in zip(batch, pairwise(first), strict=True):
            R, p = poses[arm]
            yield R[begin:end], p[begin:end]
