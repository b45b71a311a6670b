"""Curves of one arm: what they are, and that they go round what is in the way without wasting time."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.robot import JointLimits
from dualarm_cli.motion.curved_transfers import CurveCost, curve, quick_curves

JOINTS = tuple("abcdefg")
LIMITS = JointLimits(
    JOINTS,
    np.full(7, -3.0),
    np.full(7, 3.0),
    np.full(7, 2.0),
    np.full(7, 10.0),
    np.full(7, 100.0),
    ("assumed",) * 7,
)
START, GOAL = np.zeros(7), np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_a_curve_is_de_casteljaus():
    """Repeated halving of the control polygon gives the point in the middle."""
    controls = np.random.default_rng(0).normal(size=(4, 7))
    polygon = np.vstack([START, controls, GOAL])
    while len(polygon) > 1:
        polygon = 0.5 * (polygon[1:] + polygon[:-1])
    points = curve(START, controls, GOAL, 9)
    np.testing.assert_allclose(points[4], polygon[0], atol=1e-12)
    np.testing.assert_array_equal(points[[0, -1]], [START, GOAL])


def lacking(curves):
    """A ball of 0.3 about the middle of the straight way, in the first three joints."""
    middle = np.array([0.5, 0.0, 0.0])
    depth = 0.3 - np.linalg.norm(curves[..., :3] - middle, axis=-1)
    return np.maximum(depth, 0.0)[:, 1:-1].mean(axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_the_best_curve_goes_round_a_ball_and_hardly_farther(seed):
    """Free at its points; bulging by less than twice the radius; other joints hardly moved; within the limits."""
    found = quick_curves(START, GOAL, CurveCost(LIMITS, 0.0, lacking, 33, 1.0), seed)
    assert found
    points = curve(START, found[0], GOAL, 33)
    assert lacking(points[None])[0] == 0.0
    bulge = np.linalg.norm(points[:, 1:3], axis=1).max()
    assert 0.28 < bulge < 0.6
    assert np.abs(points[:, 3:]).max() < 0.4
    assert (points >= LIMITS.lower).all()
    assert (points <= LIMITS.upper).all()


def test_there_is_no_curve_where_nothing_is_free():
    """Everything lacks a millimetre."""
    cost = CurveCost(LIMITS, 0.0, lambda c: np.full(len(c), 1e-3), 9, 1.0)
    found = quick_curves(START, GOAL, cost, 0)
    assert found == []


@pytest.mark.parametrize("seed", range(3))
def test_under_a_cap_the_curve_is_short_for_the_tool(seed):
    """Joints b and c carry the tool together with a: where it is slow, less is bulged than where it is not."""

    def tool(curves):
        way = np.diff(curves[..., :3], axis=1) * np.array([0.1, 1.0, 1.0])
        return np.linalg.norm(way, axis=-1).sum(axis=1) / 0.05

    free = quick_curves(START, GOAL, CurveCost(LIMITS, 0.0, lacking, 33, 1.0), seed)[0]
    capped = quick_curves(START, GOAL, CurveCost(LIMITS, 0.0, lacking, 33, 1.0, tool), seed)[0]
    times = [float(tool(curve(START, one, GOAL, 33)[None])[0]) for one in (free, capped)]
    assert times[1] < times[0]
    assert lacking(curve(START, capped, GOAL, 33)[None])[0] == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_the_clearance_of_slow_curves_is_not_measured(seed, monkeypatch):
    """The curves are those that measuring all of them gives; more than a third are never measured."""
    measured = [0]

    def counted(curves):
        measured[0] += len(curves)
        return lacking(curves)

    cost = CurveCost(LIMITS, 0.0, counted, 33, 1.0)
    found, of, some = quick_curves(START, GOAL, cost, seed), CurveCost.of, measured[0]
    monkeypatch.setattr(CurveCost, "of", lambda *args: of(*args[:-1], np.empty(0)))
    every = quick_curves(START, GOAL, cost, seed)
    np.testing.assert_array_equal(found, every)
    assert some < 2 / 3 * (measured[0] - some)
