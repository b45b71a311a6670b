"""Transfers of another shape: within limits and torques by the verifier's dynamics, between exact states."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.interface import load, plan
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.motion.torque_transfer import TransferEnds, transfer_within_torques
from dualarm_cli.report.console import summary_lines
from dualarm_cli.verification.motion_checks import position_extrema, velocity_extrema
from dualarm_cli.verification.torque_checks import InverseDynamics

MASS = 3.0
TCP = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.09]))


def heavy_cell() -> Cell:
    """OpenArm with 3 kg at each tool centre point."""
    robot = load_robot("openarm").robot
    tool = Tool(TCP, pin.Inertia(MASS, TCP.translation, np.zeros((3, 3))))
    return Cell(robot, pin.SE3.Identity(), {arm.name: tool for arm in robot.arms})


def test_derivatives_of_torques_are_differences() -> None:
    """By q, v and a against central differences, and the torque itself against the plain one."""
    cell = heavy_cell()
    dynamics, robot = Dynamics(cell, {}), cell.robot
    random = np.random.default_rng(1)
    state = [random.uniform(robot.limits.lower, robot.limits.upper), *random.normal(size=(2, 14))]

    def torque(rates: list[np.ndarray]) -> np.ndarray:
        return sum(dynamics.torques(*(rate[None] for rate in rates)))[0]

    value, *derivatives = dynamics.linearised(*state)
    np.testing.assert_allclose(value, torque(state), atol=1e-12)
    for k, derivative in enumerate(derivatives):
        for joint in range(14):
            ahead, behind = ([rate.copy() for rate in state] for _ in range(2))
            ahead[k][joint] += 1e-6
            behind[k][joint] -= 1e-6
            difference = (torque(ahead) - torque(behind)) / 2e-6
            np.testing.assert_allclose(derivative[:, joint], difference, atol=1e-6)


def test_a_new_shape_keeps_ends_limits_and_torques() -> None:
    """Random moving ends: exact states, all limits between knots, and torques by the verifier's dynamics."""
    cell = heavy_cell()
    dynamics, robot, judge = Dynamics(cell, {}), cell.robot, InverseDynamics(cell)
    limits, random = robot.limits, np.random.default_rng(4)
    columns, home = robot.columns(robot.arms[0].joints), robot.postures["home"]
    shapes = 0
    for _ in range(12):
        start, end = ([home.copy(), np.zeros(14), np.zeros(14)] for _ in range(2))
        start[0][columns] = random.uniform(limits.lower, limits.upper)[columns] * 0.5
        # The sixth joint begins at one of its limits.
        start[0][columns[5]] = random.choice([limits.lower, limits.upper])[columns[5]]
        end[0][columns] = start[0][columns] + random.uniform(-0.6, 0.6, 7)
        end[0][columns] = np.clip(end[0], limits.lower, limits.upper)[columns]
        start[1][columns], end[1][columns] = 0.2 * random.uniform(-1, 1, (2, 7))
        start[1][columns[5]] = end[1][columns[5]] = 0.0
        least, most = np.minimum(start[0], end[0]) - 0.1, np.maximum(start[0], end[0]) + 0.1
        ends = TransferEnds(tuple(start), tuple(end), 0.9, least, most)
        motion = transfer_within_torques(dynamics, columns, ends, limits)
        if motion is None:
            continue
        shapes += 1
        for rate, first, last in zip(
            (motion.position, motion.velocity, motion.acceleration), start, end, strict=True
        ):
            np.testing.assert_allclose(rate[0], first[columns], atol=1e-12)
            np.testing.assert_array_equal(rate[-1], last[columns])
        low, high = position_extrema(motion)
        assert (low >= limits.lower[columns] - 1e-9).all()
        assert (high <= limits.upper[columns] + 1e-9).all()
        assert (velocity_extrema(motion) <= limits.velocity[columns]).all()
        q, v, a = motion.at(np.linspace(0.0, motion.duration, 1001))
        assert (np.abs(a) <= limits.acceleration[columns] * (1 + 1e-9)).all()
        assert (np.abs(motion.jerk) <= limits.jerk[columns] * (1 + 1e-6)).all()
        whole = [np.tile(home, (1001, 1)), np.zeros((1001, 14)), np.zeros((1001, 14))]
        for rate, values in zip(whole, (q, v, a), strict=True):
            rate[:, columns] = values
        share = np.abs(judge.torques(*whole))[:, columns] / robot.torques.effort[columns]
        assert share.max() <= 1.0
        # Knots follow from those before: the motion is one of constant jerk.
        h = np.diff(motion.time)[:, None]
        a0, a1 = motion.acceleration[:-1], motion.acceleration[1:]
        reached = motion.position[:-1] + h * motion.velocity[:-1] + h * h * (2 * a0 + a1) / 6
        np.testing.assert_allclose(reached, motion.position[1:], atol=1e-12)
    assert shapes >= 6


CELL = """\
dualarm: cell/1
robot: openarm
torque: RULE
obstacles: {table: {box: [0.3, 0.65, 0.04], xyz: [0.275, -0.05, 0.355]}}
clearance: 5 mm
tools:
"""
TOOL = (
    "{tcp: {xyz: [0, 0, 0.09]}, mass: 3, center_of_mass: [0, 0, 0.09], "
    "shapes: [{capsule: {radius: 0.02, length: 0.05}, xyz: [0, 0, 0.045]}]}"
)
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
return: true
defaults: {approach: 25 mm, retract: 25 mm, straight: 25 mm, dwell: 0.15 s}
tasks:
"""


@pytest.fixture
def heavy_job(tmp_path):
    """Writes three picks of each arm with 3 kg tools, with a rule for torques."""

    def write(rule: str):
        down = "rpy: [180 deg, 0, 0], free: yaw"
        rows = [
            f"  - {{id: {arm}{k}, arm: {arm}, pick: {{xyz: [0.2, {y + k * 0.05}, 0.4], {down}}}, "
            f"place: {{xyz: [0.3, {y + k * 0.05}, 0.4], {down}}}}}\n"
            for k in range(3)
            for arm, y in (("left", 0.1), ("right", -0.3))
        ]
        tools = "".join(f"  {arm}: {TOOL}\n" for arm in ("left", "right"))
        (tmp_path / "cell.yaml").write_text(CELL.replace("RULE", rule) + tools)
        (tmp_path / "tasks.yaml").write_text(TASKS + "".join(rows))
        return load(tmp_path / "tasks.yaml")

    return write


@pytest.mark.full_effort
def test_heavy_tools_cost_little_time(heavy_job) -> None:
    """Beyond its efforts without a limit; within them with it, for at most 2 % of the time, and verified."""
    free, limited = (plan(heavy_job(rule), effort="quick") for rule in ("checked", "limited"))
    [beyond] = [c for c in free.schedule.verification.checks if c.name == "torque"]
    [within] = [c for c in limited.schedule.verification.checks if c.name == "torque"]
    assert beyond.measured > 1.0
    assert (within.verdict, limited.schedule.verification.passed) == ("passed", True)
    assert limited.schedule.duration <= 1.02 * free.schedule.duration
    assert any("another shape" in note for note in limited.schedule.notes)
    [line] = (text for text in summary_lines(limited.report) if text.startswith("torque: "))
    assert line == f"torque: {within.measured:.0%} of a joint's effort at most, {within.detail}"
    [line] = (text for text in summary_lines(free.report) if text.startswith("torque: "))
    assert line == f"torque: not limited: {beyond.detail}"
