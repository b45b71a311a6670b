"""The pattern of 245 holes: its geometry, and that every hole is in reach."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel

Script = Callable[[str], ModuleType]


@pytest.fixture
def airbus(script: Script) -> ModuleType:
    """The script."""
    return script("airbus")


def test_the_pattern_has_three_blocks_of_seven_rows(airbus) -> None:
    """56 + 133 + 56 holes; y and z as far as published."""
    holes = airbus.holes()
    z = holes[:, 2]
    blocks = [holes[(z > low) & (z < low + 0.2)] for low in (0.55, 0.35, 0.15)]
    assert [len(block) for block in blocks] == [56, 133, 56]
    spans = [(*block[:, 1:].min(axis=0), *block[:, 1:].max(axis=0)) for block in blocks]
    np.testing.assert_allclose(spans[0], (0.05, 0.57, 0.225, 0.72))
    np.testing.assert_allclose(spans[1], (-0.225, 0.37, 0.225, 0.52))
    np.testing.assert_allclose(spans[2], (-0.225, 0.17, -0.05, 0.32))


def test_no_closed_tour_is_shorter_than_its_pitch_allows(airbus) -> None:
    """Every hole's nearest neighbour is 25 mm away, so 245 moves are 6.125 m or more; the row-by-row tour is longer."""
    holes = airbus.holes()
    apart = np.linalg.norm(holes[:, None] - holes, axis=-1) + np.eye(len(holes))
    np.testing.assert_allclose(apart.min(axis=1), airbus.PITCH)
    tour = np.linalg.norm(holes - np.roll(holes, 1, axis=0), axis=1).sum()
    assert 245 * airbus.PITCH < airbus.SHORTEST_TOUR < tour < 2 * airbus.SHORTEST_TOUR


def test_every_hole_is_in_reach_of_the_arm_of_its_side(airbus, tmp_path: Path) -> None:
    """Torso at 0, target and start of the approach, some turn about the tool, within joint limits.

    126 holes lie at y >= 0 (56 of the top block, 7 rows of 10), 119 at y < 0. Twelve turns and 24 arm angles are enough
    to find a posture for each.
    """
    job = load_job(airbus.write_instance(tmp_path / "job", "split", "given"))
    model = CellModel.from_cell(job.cell)
    R_world, p_world = model.platform.pose(np.zeros(1))
    angles = np.linspace(-np.pi, np.pi, 24, endpoint=False)
    counts = {}
    for side in ("left", "right"):
        poses = [task.stops[0].target.pose for task in job.tasks if task.arm == side]
        counts[side] = len(poses)
        arm = model.arms[side]
        turns = [
            np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]])
            for a in angles[::2]
        ]
        found = np.ones((len(poses), len(turns), len(angles), 8), dtype=bool)
        for back in (0.0, 0.02):
            tip = np.array([pose.translation - back * pose.rotation[:, 2] for pose in poses])
            R = np.array([[pose.rotation @ turn for turn in turns] for pose in poses])
            p = tip[:, None] - R @ arm.T_flange_tcp.translation
            solutions = arm.kinematics.solve(
                (R_world.T @ R)[:, :, None], ((p - p_world) @ R_world)[:, :, None], angles
            )
            within = arm.kinematics.within_limits(
                arm.kinematics.nearest_turns(solutions.q, np.zeros(7))
            )
            found &= within & solutions.reachable[..., None]
        assert found.any(axis=(1, 2, 3)).all()
    assert counts == {"left": 126, "right": 119}
