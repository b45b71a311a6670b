"""The posture of a stop: feasible, on its lines, and not beaten by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.postures import REDUNDANCY_SOLVERS, NoPosture
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.postures.stop_lines import line_path

SOLVE = REDUNDANCY_SOLVERS["arm_angle"].solve


@pytest.fixture(scope="module")
def problems(tasks_folder):
    """First stops of the packing job, seen from home."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    home = job.cell.robot.postures["home"]
    return [
        problem
        for work in job.stages()[:6]
        for problem in stop_problems(model, job, home, work).values()
    ]


def tool(problem, q):
    """Tool rotation and position of joints (..., 7) in the base frame."""
    R, p = problem.arm.forward(q)
    tip = -problem.R_tool_flange.T @ problem.p_tool_flange
    return R @ problem.R_tool_flange.T, p + R @ tip


def test_the_posture_reaches_its_target_within_limits(problems):
    """Tool position to 1e-9 m, tool axis to 1e-9, all joints inside."""
    for problem in problems:
        posture = SOLVE(problem)
        R, p = tool(problem, posture.q_target)
        assert np.abs(p - problem.p_base_tool[0]).max() < 1e-9
        assert np.abs(R[:, 2] - problem.R_base_tool[0][:, 2]).max() < 1e-9
        assert problem.arm.within_limits(posture.q_target)


def test_lines_are_straight_continuous_and_end_in_the_posture(problems):
    """Every sample is on the line through the target along the tool's z axis."""
    for problem in problems:
        posture = SOLVE(problem)
        for line, ends in (
            ("approach", (posture.q_approach, posture.q_target)),
            ("retract", (posture.q_target, posture.q_retract)),
        ):
            q, length = line_path(problem, posture, line, 33)
            assert np.abs(q[[0, -1]] - np.array(ends)).max() < 1e-9
            _, p = tool(problem, q)
            depth = length[::-1] if line == "approach" else length
            axis = problem.R_base_tool[0][:, 2]
            assert np.abs(p - (problem.p_base_tool[0] - depth[:, None] * axis)).max() < 1e-9
            assert np.abs(np.diff(q, axis=0)).max() < 0.2
            assert problem.arm.within_limits(q).all()


def test_no_constant_arm_angle_beats_the_chosen_posture(problems):
    """Brute force over branches, 360 arm angles and yaws, lines at constant arm angle."""
    for problem in problems[:6]:
        posture = SOLVE(problem)
        psi = np.radians(np.arange(0.0, 360.0, 2.0))
        best = np.inf
        for yaw in problem.yaw:
            c, s = np.cos(yaw), np.sin(yaw)
            R_tool = problem.R_base_tool[0] @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            R = R_tool @ problem.R_tool_flange
            p = problem.p_base_tool[0] + R_tool @ problem.p_tool_flange
            depth = np.linspace(0, problem.approach, 7)
            points = p - depth[:, None] * R_tool[:, 2]
            q = problem.arm.solve(R, points[:, None], psi).q  # (7, psi, 8, 7)
            q = np.moveaxis(q, 0, 2).reshape(-1, 7, 7)
            q = np.unwrap(q, axis=1)
            ok = problem.arm.within_limits(q).all(axis=1)
            line = problem.line_time(q[ok], depth)
            transfer = problem.transfer_time(q[ok][:, -1] - problem.start)
            best = min(best, float((np.maximum(transfer, problem.waiting) + 2 * line).min()))
        # The posture's cost also has a small term for travel.
        assert posture.cost <= best * 1.02


def test_a_target_out_of_reach_is_refused_with_a_reason(problems):
    """Ten metres away."""
    import dataclasses

    far = dataclasses.replace(problems[0], p_base_tool=np.array([[10.0, 0.0, 0.0]]))
    answer = SOLVE(far)
    assert isinstance(answer, NoPosture)
    assert "out of the arm's reach" in str(answer.reason)


def test_a_posture_between_the_grids_arm_angles_is_found(problems):
    """Limits closed in around one posture, half a degree either way: the grid misses it."""
    import dataclasses

    from dualarm_cli.kinematics.srs_arm import SrsArm

    for problem in problems[:4]:
        wide = SOLVE(dataclasses.replace(problem, approach=0.0, retract=0.0))
        cell = dataclasses.replace(problem, yaw=np.array([wide.yaw]), free_yaw=False)
        arm = problem.arm
        narrow = SrsArm(
            arm.geometry,
            np.maximum(arm.lower, wide.q_target - np.radians(0.5)),
            np.minimum(arm.upper, wide.q_target + np.radians(0.5)),
        )
        found = SOLVE(dataclasses.replace(cell, arm=narrow, approach=0.0, retract=0.0))
        assert not isinstance(found, NoPosture)
        assert np.abs(found.q_target - wide.q_target).max() <= np.radians(0.5) + 1e-9
