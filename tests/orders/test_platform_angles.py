"""Platform angles that orders are examined with."""

from __future__ import annotations

import numpy as np

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.orders.model.order_model import platform_angles


def test_angles_are_fifteen_degrees_apart_over_the_whole_range(tasks_folder):
    """The start first; nothing wider than a step is left at either limit, nor half a turn away."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    limits = job.cell.robot.limits.select(job.cell.robot.platform)
    here = float(job.start_joints[model.platform_columns][0])
    low, high = max(limits.lower[0], here - np.pi), min(limits.upper[0], here + np.pi)
    angles = platform_angles(model, job)[:, 0]
    assert angles[0] == here
    step = np.radians(15.0)
    np.testing.assert_allclose(np.diff(np.sort(angles)), step, atol=1e-12)
    assert 0.0 <= angles.min() - low < step
    assert 0.0 <= high - angles.max() < step
