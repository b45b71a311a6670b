"""How far a tool leaves its line, against the arms' own kinematics at many instants."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.compiled import trajectories
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.motion.stop_motion import CHECKS_PER_KNOT, line_deviation
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.timing.spline import rest_to_rest_spline


@pytest.fixture(scope="module", params=["01_first_pick", "03_bottin_planar", "09_yumi"])
def problems(request, tasks_folder):
    """Stops of the first stage: closed forms and general arms."""
    job = load_job(tasks_folder / request.param / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    home = np.asarray(job.cell.robot.postures["home"])
    return list(stop_problems(model, job, home, job.stages()[0]).values())


def test_the_chain_of_constant_steps_is_the_arm(problems):
    """Random postures: products of the steps and turns about z against the arm's forward kinematics."""
    rng = np.random.default_rng(3)
    for problem in problems:
        steps, slides = problem.arm.chain
        for q in rng.uniform(-2, 2, (20, len(slides))):
            T = np.eye(4)
            for k, angle in enumerate([*q, 0.0]):
                c, s = np.cos(angle), np.sin(angle)
                turn = np.array([[c, -s, 0, 0], [s, c, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
                if k < len(slides) and slides[k]:
                    turn = np.eye(4)
                    turn[2, 3] = angle
                T = T @ np.vstack([steps[k], [0, 0, 0, 1]]) @ turn
            R, p = problem.arm.forward(q)
            np.testing.assert_allclose(T[:3, :3], R, atol=1e-12)
            np.testing.assert_allclose(T[:3, 3], p, atol=1e-12)


def test_deviations_are_those_of_the_instants_that_are_looked_at(problems):
    """Random splines: distances from the line between the tips, and angles by the trace of the rotation."""
    rng = np.random.default_rng(4)
    for problem in problems:
        n = len(problem.start)
        # A tool that stands out crookedly, so that no term of its place is nothing.
        R_tool = problem.R_tool_flange
        problem = dataclasses.replace(problem, p_tool_flange=np.array([0.03, -0.02, -0.2]))
        time = np.cumsum(rng.uniform(0.01, 0.1, 9))
        q = problem.start + 0.3 * rng.uniform(-1, 1, (1, n)) + 0.05 * rng.normal(size=(9, n))
        motion = Trajectory(tuple(f"j{k}" for k in range(n)), time, *rest_to_rest_spline(time, q))
        share = np.arange(CHECKS_PER_KNOT) / CHECKS_PER_KNOT
        instants = (time[:-1, None] + np.diff(time)[:, None] * share).ravel()
        R, p = problem.arm.forward(np.vstack([q[[0, -1]], motion.at(instants)[0]]))
        tip = p - R @ R_tool.T @ problem.p_tool_flange
        along = (tip[1] - tip[0]) / np.linalg.norm(tip[1] - tip[0])
        beside = np.linalg.norm(np.cross(tip[2:] - tip[0], along), axis=1)
        trace = np.einsum("kij,ij->k", R[2:], R[0])
        angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        found = line_deviation(problem, q, motion)
        assert found == pytest.approx((beside.max(), angle.max()), rel=1e-9)


def test_a_line_without_length_is_left_by_any_distance(problems):
    """There and back: the tool is at one place at both ends, and away from it in between."""
    for problem in problems:
        n = len(problem.start)
        q = problem.start + 0.2 * np.sin(np.linspace(0.0, np.pi, 9))[:, None] * np.ones(n)
        q[-1], time = q[0], np.linspace(0.0, 1.0, 9)
        motion = Trajectory(tuple(f"j{k}" for k in range(n)), time, *rest_to_rest_spline(time, q))
        tip = -problem.R_tool_flange.T @ problem.p_tool_flange
        R, p = problem.arm.forward(motion.position)
        away = np.linalg.norm(p + R @ tip - (p + R @ tip)[0], axis=1).max()
        assert away > 0.01
        assert line_deviation(problem, q, motion)[0] > 0.99 * away


def test_a_motion_that_is_no_number_leaves_its_line(problems):
    for problem in problems:
        time = np.linspace(0.0, 1.0, 9)
        q = problem.start + np.linspace(0.0, 0.2, 9)[:, None]
        knots = list(rest_to_rest_spline(time, q))
        knots[0][4] = np.nan
        tip = -problem.R_tool_flange.T @ problem.p_tool_flange
        found = trajectories.line_deviation(
            (*problem.arm.chain, tip), q[[0, -1]], (time, *knots), CHECKS_PER_KNOT
        )
        assert found[0] == np.inf
