"""Limits that the tests of motions share."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.robot import JointLimits


@pytest.fixture
def limits() -> JointLimits:
    """An SDA10F arm: speeds of the maker, time to top speed 0.3 s, jerk ten times that a second."""
    velocity = np.radians([170.0, 170, 170, 170, 200, 200, 400])
    joints = ("s", "l", "e", "u", "r", "b", "t")
    return JointLimits(
        joints,
        np.full(7, -3.2),
        np.full(7, 3.2),
        velocity,
        velocity / 0.3,
        velocity / 0.03,
        ("assumed",) * 7,
    )
