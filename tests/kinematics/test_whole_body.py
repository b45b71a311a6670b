"""Tools, elbows and carried points of a whole body, against finite differences and pinocchio's own placements."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.loading.tasks import load_job

STEP = 1e-6


@pytest.fixture(scope="module")
def body_and_cell(tasks_folder):
    """The packing cell on a base that is turned and moved."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, -0.1, 0.2]))
    cell = dataclasses.replace(cell, base=base)
    return WholeBody(cell), cell


def test_jacobians_are_finite_differences(body_and_cell):
    """Ten random configurations: tools (linear and angular), elbows, and two points that the platform carries."""
    body, cell = body_and_cell
    limits = cell.robot.limits
    random = np.random.default_rng(0)
    points = np.array([[0.3, 0.1, -0.2], [0.0, -0.3, 0.1]])
    for _ in range(10):
        q = random.uniform(limits.lower, limits.upper)
        here = body.at(q)
        places, rates = body.carried(points)
        for joint in range(len(q)):
            ahead, behind = q.copy(), q.copy()
            ahead[joint] += STEP
            behind[joint] -= STEP
            after = body.at(ahead)
            there = body.carried(points)[0]
            before = body.at(behind)
            back = body.carried(points)[0]
            for a in range(2):
                rows = here.J[6 * a : 6 * a + 6, joint]
                slope = (after.p[a] - before.p[a]) / (2 * STEP)
                turn = pin.log3(after.R[a] @ before.R[a].T) / (2 * STEP)
                np.testing.assert_allclose(rows, np.concatenate([slope, turn]), atol=1e-8)
                slope = (after.elbow[a] - before.elbow[a]) / (2 * STEP)
                np.testing.assert_allclose(here.J_elbow[3 * a : 3 * a + 3, joint], slope, atol=1e-8)
            np.testing.assert_allclose(rates[:, :, joint], (there - back) / (2 * STEP), atol=1e-8)
        assert places.shape == (2, 3)
