"""Faults that are small from knot to knot and large together."""

from __future__ import annotations

import dataclasses

import numpy as np

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion import stop_motion
from dualarm_cli.motion.stop_motion import solve_line
from dualarm_cli.planning.planner import plan
from dualarm_cli.postures.stop_lines import flange_poses
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.verification import verify


def failures(schedule, job):
    """Names of the failed checks."""
    return {check.name for check in verify(schedule, job).failures}


def test_a_tool_that_rams_beyond_its_target_and_comes_back_is_found(tasks_folder, monkeypatch):
    """A smooth plunge 16 mm too deep on a straight approach, on so many knots that each step is tiny."""

    def plunging(drive, arm_stop, line, path, launch=None):
        if line != "approach" or arm_stop.arm != "left":
            return solve_line(drive, arm_stop, line, path, launch)
        limits = drive.limits.select(drive.model.arms["left"].arm.joints)
        problem, posture = arm_stop.problem, arm_stop.posture
        share = np.linspace(0, 1, 65)
        depth = problem.approach * (1 - share) - 0.03 * np.sin(np.pi * share**3)
        R, p, outward = flange_poses(problem, np.array([posture.target]), np.array([posture.yaw]))
        psi = posture.psi_target + (posture.psi_approach - posture.psi_target) * (1 - share)
        q, _ = problem.arm.solve_branch(
            R, p + outward[:, 0] * depth[:, None], psi, np.full(65, posture.branch)
        )
        q = np.unwrap(q, axis=0)
        q += posture.q_target - q[-1]
        length = np.linspace(0, problem.approach, 65)
        timed = drive.timing.line(LineProblem(limits.joints, q, length, limits, None, 384))
        share = np.arange(6) / 6
        dense = (timed.time[:-1, None] + np.diff(timed.time)[:, None] * share).ravel()
        times = np.append(dense, timed.time[-1])
        return Trajectory(timed.joints, times, *timed.at(times))

    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    monkeypatch.setattr(stop_motion, "solve_line", plunging)
    schedule = plan(job, PlanSettings(platform="fixed"))
    assert failures(schedule, job) == {"line_lengths"}


def test_a_joint_that_creeps_through_knots_of_one_instant_is_found(tasks_folder):
    """Two thousand knots at one time, each within tolerance, carry a joint 10 microradians away and back."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    schedule = plan(job, PlanSettings(platform="fixed"))
    t = schedule.trajectory
    k, half = len(t.time) // 2, 1000
    creep = 0.9e-8 * np.concatenate([np.arange(half), np.arange(half)[::-1]])
    extra = np.repeat(k, 2 * half)
    index = np.concatenate([np.arange(k + 1), extra, np.arange(k + 1, len(t.time))])
    position = t.position[index].copy()
    position[k + 1 : k + 1 + 2 * half, 1] += creep
    forged = Trajectory(t.joints, t.time[index], position, t.velocity[index], t.acceleration[index])
    found = failures(dataclasses.replace(schedule, motion=JointMotion.of(forged)), job)
    assert "position_agreement" in found
