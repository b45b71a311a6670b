"""Quick free curves of one arm: Bezier curves whose control points are drawn ever closer about the best ones."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from math import comb

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.timing.line_profile import estimate_line_durations

CONTROLS = 4
"""Control points between start and goal: curves of degree five."""
TIMED_SAMPLES = 9
"""Points of a curve from which its time is estimated."""
POPULATION = 40
"""Curves of a round."""
ELITE = 8
"""Best ones of a round, about which the next one is drawn."""
ROUNDS = 20
"""Rounds of a search."""
SPREADS = (0.15, 0.3, 0.6, 1.0)
"""Standard deviations of the first control points about the straight way [rad]."""
FIRST = 50
"""First curves of each spread."""
LEAST_SPREAD = 0.01
"""Standard deviation below which nothing is to be gained [rad]."""
MISSING_WEIGHT = 350.0
"""What a metre of missing clearance costs at full speed [s/m]."""

Missing = Callable[[FloatArray], FloatArray]
"""How much clearance curves (c, points, 7) lack, at their points on the average [m], shape (c,); 0 for free ones."""
ToolTimes = Callable[[FloatArray], FloatArray]
"""How long the tool needs along curves (c, points, 7) at least [s], shape (c,)."""


def curve(start: FloatArray, controls: FloatArray, goal: FloatArray, count: int) -> FloatArray:
    """Returns points of Bezier curves, shape (..., count, 7) [rad].

    Args:
        start: where they begin [rad], shape (n,).
        controls: control points between [rad], shape (..., c, 7).
        goal: where they end [rad], shape (n,).
        count: how many points, equally spaced in the parameter.
    """
    basis = _bernstein(controls.shape[-2] + 1, count)
    ends = basis[:, :1] * start + basis[:, -1:] * goal
    points: FloatArray = ends + basis[:, 1:-1] @ controls
    return points


@lru_cache(maxsize=8)
def _bernstein(degree: int, count: int) -> FloatArray:
    """Returns Bernstein polynomials at equally spaced parameters, shape (count, degree + 1)."""
    s = np.linspace(0.0, 1.0, count)[:, None]
    k = np.arange(degree + 1)
    number = np.array([comb(degree, int(i)) for i in k], dtype=np.float64)
    return number * s**k * (1.0 - s) ** (degree - k)


def quick_curves(
    start: FloatArray,
    goal: FloatArray,
    limits: JointLimits,
    least: float,
    missing: Missing,
    samples: int,
    pace: float,
    seed: int,
    tool: ToolTimes | None = None,
) -> list[FloatArray]:
    """Returns control points (CONTROLS, n) of the quickest free curves found, best first; none where none is free.

    The cross-entropy method [Rubinstein1999] over the control points, with what is missing of the clearance as a
    penalty: normal distributions about the best of every round.

    Args:
        start: where they begin [rad], shape (n,).
        goal: where they end [rad], shape (n,).
        limits: of the joints.
        least: time below which a curve gains nothing [s].
        missing: how much clearance curves lack.
        samples: points of a curve that are looked at.
        pace: how much slower than at full speed the joints are.
        seed: of the random curves.
        tool: how long the tool needs along them; None where its speed has no cap.
    """
    random, n = np.random.default_rng(seed), len(start)
    share = np.linspace(0.0, 1.0, CONTROLS + 2)[1:-1, None]
    straight = start + share * (goal - start)
    # Most first curves bulge as a whole; the ends of their bulges differ.
    bulge = random.normal(size=(len(SPREADS), FIRST, 1, n)) + 0.5 * random.normal(
        size=(len(SPREADS), FIRST, CONTROLS, n)
    )
    drawn = straight + (np.array(SPREADS)[:, None, None, None] * bulge).reshape(-1, CONTROLS, n)
    drawn = np.clip(drawn, limits.lower, limits.upper)
    best: FloatArray = np.empty((0, CONTROLS, n))
    worth: FloatArray = np.empty(0)
    lacking: FloatArray = np.empty(0)
    for _ in range(ROUNDS):
        found, lacks = _worth(start, drawn, goal, limits, least, missing, samples, pace, tool)
        best, worth, lacking = (
            np.concatenate(pair) for pair in ((best, drawn), (worth, found), (lacking, lacks))
        )
        order = np.argsort(worth, kind="stable")[:ELITE]
        best, worth, lacking = best[order], worth[order], lacking[order]
        spread = best.std(axis=0) * 1.1 + LEAST_SPREAD
        if spread.max() < 2.0 * LEAST_SPREAD:
            break
        drawn = best.mean(axis=0) + spread * random.normal(size=(POPULATION, CONTROLS, n))
        drawn = np.clip(drawn, limits.lower, limits.upper)
    return [controls for controls, lack in zip(best, lacking, strict=True) if lack == 0.0]


def _worth(
    start: FloatArray,
    controls: FloatArray,
    goal: FloatArray,
    limits: JointLimits,
    least: float,
    missing: Missing,
    samples: int,
    pace: float,
    tool: ToolTimes | None,
) -> tuple[FloatArray, FloatArray]:
    """Returns what curves cost [s], what they lack included, and what they lack [m], both (c,)."""
    few = curve(start, controls, goal, TIMED_SAMPLES)
    share = np.linspace(0.0, 1.0, TIMED_SAMPLES)
    time = np.maximum(estimate_line_durations(few, share, limits), least)
    points = curve(start, controls, goal, samples)
    if tool is not None:
        time = np.maximum(time, tool(points))
    beyond = np.maximum(points - limits.upper, 0.0) + np.maximum(limits.lower - points, 0.0)
    lack = missing(points) + beyond.sum(axis=(1, 2))
    # Of equally quick ones the one that moves least.
    travel = np.abs(np.diff(points, axis=1)).sum(axis=(1, 2))
    return time + pace * MISSING_WEIGHT * lack + 1e-3 * travel, lack
