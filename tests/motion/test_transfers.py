"""Motions slowed for a cap on the tools' speed: as fast as it lets them be, and no faster."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.motion.transfers import (
    MAX_SLOWDOWN,
    SPEED_MARGIN,
    SPEED_TOLERANCE,
    Drive,
    largest_tool_speed,
    slowed,
    transfers_within_tool_speed,
)
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS
from tests.packing_tasks import packing_job


@given(
    top=st.floats(1e-3, 10.0),
    cap=st.floats(1e-2, 5.0),
    power=st.floats(0.3, 3.0),
    flat=st.floats(0.02, 1.0),
)
def test_a_motion_is_slowed_to_its_cap_and_no_farther(top, cap, power, flat):
    """Speeds that follow the factor by a power, and not at all above a level at which other limits decide."""

    def speed(factor):
        return top * min(factor, flat) ** power

    allowed = cap * (1.0 - SPEED_MARGIN)
    factor = slowed(lambda f: f, speed, {"left": cap})
    if top * flat**power <= allowed:
        assert factor == 1.0
        return
    needed = (allowed / top) ** (1.0 / power)
    if needed < 2.0 / MAX_SLOWDOWN:
        return
    assert factor is not None
    assert allowed * (1.0 - 3.0 * SPEED_TOLERANCE) <= speed(factor) <= allowed


def test_what_no_slowness_serves_is_not_slowed():
    """Something else moves the tool, too fast: there is no such motion."""
    assert slowed(lambda f: f, lambda factor: 1.0 + factor, {"left": 0.5}) is None


@pytest.mark.parametrize("cap", [0.25, 0.8])
def test_the_fastest_tool_is_found_between_the_instants_that_are_looked_at_first(tasks_folder, cap):
    """Every transfer of a job under a cap against a scan of 20,000 instants by finite differences of its own."""
    job = packing_job(tasks_folder, 6)
    model = CellModel.from_cell(job.cell)
    capped = dataclasses.replace(job, speed=1.0, tool_speed=cap)
    drive = Drive.of(model, capped, TIMING_SOLVERS["ruckig"])
    slower = 0
    for plan in choose_stages(MethodProblem(model, job, "arm_angle"), "exact", refine=False):
        moved = transfers_within_tool_speed(drive, plan)
        length = max(t.duration for t in moved.motion.values())
        time = np.linspace(0.0, length, 20_001)
        q = np.tile(plan.start, (len(time), 1))
        for group, trajectory in moved.motion.items():
            q[:, drive.columns[group]] = trajectory.clamped(time)[0]
        dense = max(
            float(np.linalg.norm(np.diff(model.tool_position(arm, q), axis=0), axis=1).max())
            for arm in model.arms
        ) / (time[1] - time[0])

        def position_at(t, moved=moved, plan=plan):
            q = np.tile(plan.start, (len(t), 1))
            for group, trajectory in moved.motion.items():
                q[:, drive.columns[group]] = trajectory.clamped(t)[0]
            return q

        found = largest_tool_speed(model, drive.caps, position_at, length)
        assert found == pytest.approx(dense, rel=5e-4)
        assert dense <= cap
        slower += bool(moved.capped)
        assert not moved.capped or dense >= cap * (1.0 - SPEED_MARGIN - 4.0 * SPEED_TOLERANCE)
    assert slower > 3
