"""The picture of a job: targets where the arms' tools are, outlines as large as the solids."""

from __future__ import annotations

import coal
import numpy as np
import pytest

from dualarm_cli import load
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.report.figures.cell_figure import _bodies, _corners, _outline, _targets, draw_cell


def test_targets_are_where_tools_are() -> None:
    """Poses as the file states them, configurations by the planner's kinematics."""
    job = load(
        {
            "dualarm": "tasks/1",
            "cell": {"dualarm": "cell/1", "robot": "sda10f", "base": {"xyz": [0.1, 0, 0.2]}},
            "tasks": [
                {"id": "a", "arm": "left", "move": {"xyz": [0.4, 0.2, 0.8]}},
                {"id": "b", "arm": "right", "move": {"joints": [[0.1, -0.2, 0.3, 0.4, 0, 0.1, 0]]}},
            ],
        }
    )
    targets = _targets(job)
    assert targets["left", "move"] == pytest.approx(np.array([[0.4, 0.2, 0.8]]))
    position = job.start_joints.copy()
    columns = [job.cell.robot.joints.index(name) for name in job.cell.robot.arm("right").joints]
    position[columns] = [0.1, -0.2, 0.3, 0.4, 0.0, 0.1, 0.0]
    tool = CellModel.from_cell(job.cell).tool_position("right", position)
    assert targets["right", "move"] == pytest.approx(tool[None], abs=1e-9)
    assert draw_cell(job, "svg").startswith(b"<?xml")


@pytest.mark.parametrize(
    ("solid", "half"),
    [
        (coal.Box(0.2, 0.4, 0.6), (0.1, 0.2, 0.3)),
        (coal.Sphere(0.1), (0.1, 0.1, 0.1)),
        (coal.Cylinder(0.1, 0.6), (0.1, 0.1, 0.3)),
        (coal.Capsule(0.1, 0.6), (0.1, 0.1, 0.4)),
    ],
)
def test_outlines_are_as_large_as_solids(
    solid: coal.CollisionGeometry, half: tuple[float, float, float]
) -> None:
    """By hand; round ones to the spacing of their points, and never larger."""
    points = _corners(solid)
    assert np.abs(points).max(axis=0) == pytest.approx(half, rel=0.02)
    assert (np.abs(points) <= np.array(half) + 1e-12).all()
    outline = _outline(points[:, [0, 2]])
    x, z = outline.T
    area = 0.5 * abs(np.sum(x * np.roll(z, -1) - z * np.roll(x, -1)))
    round_ends = isinstance(solid, coal.Sphere | coal.Capsule)
    cut = (4.0 - np.pi) * half[0] ** 2 if round_ends else 0.0
    assert area == pytest.approx(4.0 * half[0] * half[2] - cut, rel=0.03)


def test_obstacles_have_no_colour_and_planes_no_outline() -> None:
    """A table is drawn under the robot, and does not widen the view."""
    bodies = list(_bodies(load("04_packing")))
    assert sum(not colour for colour, _ in bodies) == len(
        [o for o in load("04_packing").cell.obstacles if o.shape.kind != "half_space"]
    )
    assert _corners(coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)).shape == (0, 3)
