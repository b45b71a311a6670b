"""The least distance of an elbow from a point while the tool stays: against pinocchio on dense arm angles."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.path.measures import least_elbow_distance
from dualarm_cli.kinematics.srs_arm import SrsArm

ANGLES = 721
"""Arm angles of a scan."""


def test_no_posture_within_limits_is_nearer_and_one_is_as_near(chain, arm):
    """Twelve targets of each arm, 721 arm angles, 8 branches: the scan's least is above, by no more than a step of it.

    What counts as the elbow is where the URDF has joint 4, which need not be where upper arm and forearm meet.
    """
    random = np.random.default_rng(4)
    model = chain.model()
    data = model.createData()
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    # Narrow limits, so that they decide at many targets.
    low, high = 0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high
    arm = SrsArm(arm.geometry, low, high)

    def elbow(q: np.ndarray) -> np.ndarray:
        pin.forwardKinematics(model, data, q)
        return data.oMi[4].translation.copy()

    q = random.uniform(low, high, (12, 7))
    R, p = arm.forward(q)
    middle, axis = arm.elbow(q[0])
    along = float((elbow(q[0]) - middle) @ axis)
    points = np.array([elbow(one) for one in q]) + random.uniform(-0.3, 0.3, (12, 3))
    least = least_elbow_distance(arm, R, p, points, along)
    psi = np.linspace(-np.pi, np.pi, ANGLES)
    bound = 0
    for k in range(12):
        solved = arm.nearest_turns(arm.solve(R[k], p[k], psi[:, None]).q.reshape(-1, 8, 7), q[k])
        inside = arm.within_limits(solved)
        distances = [float(np.linalg.norm(elbow(one) - points[k])) for one in solved[inside]]
        anywhere = [float(np.linalg.norm(elbow(one) - points[k])) for one in solved[::12, 0]]
        assert least[k] <= min(distances, default=np.inf) + 1e-9
        # One step of arm angle moves the elbow by at most its distance from the line, less than 0.5 m.
        assert least[k] == pytest.approx(min(distances), abs=0.5 * 2.0 * np.pi / ANGLES)
        assert least[k] <= float(np.linalg.norm(elbow(q[k]) - points[k])) + 1e-9
        bound += min(anywhere) < least[k] - 5e-3
    assert bound > 0


def test_an_elbow_at_the_point_is_at_no_distance(chain, arm):
    """The point is where the elbow can be: 0, to the rounding of a square root."""
    random = np.random.default_rng(5)
    low, high = np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi)
    q = random.uniform(low, high, (50, 7))
    R, p = arm.forward(q)
    assert least_elbow_distance(arm, R, p, arm.elbow(q)[0]).max() < 1e-6
