"""What torque limits cost: random transfers of an arm, of another shape within torques, against IPOPT's optimum.

    python -m benchmarks.quality.torques openarm --mass 3

The optimum keeps torques as well as velocities, accelerations and jerks. Ruckig's time without torques bounds every
transfer within them from below. Toppra times the straight line within velocities, accelerations and torques; it knows
no limit of jerks.
"""

from __future__ import annotations

import argparse
from time import process_time

import numpy as np
import pinocchio as pin
import ruckig
import toppra
import toppra.algorithm
import toppra.constraint

from benchmarks.nonlinear.torque_optimum import optimal_duration
from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.motion.torque_transfer import TransferEnds, transfer_within_torques

TOOL = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.09]))
MOST_STATIC = 0.8
"""Largest share of an effort that holding still takes on the way, as beyond it the posture is at fault."""


def fastest(start: np.ndarray, end: np.ndarray, limits: object) -> tuple[float, np.ndarray]:
    """Ruckig's duration [s], and positions, velocities and accelerations at 100 instants, shape (3, 100, n)."""
    n = len(start)
    asked = ruckig.InputParameter(n)
    asked.current_position, asked.target_position = start, end
    asked.max_velocity, asked.max_acceleration = limits.velocity, limits.acceleration
    asked.max_jerk = limits.jerk
    motion = ruckig.Trajectory(n)
    ruckig.Ruckig(n).calculate(asked, motion)
    rows = [motion.at_time(t)[:3] for t in np.linspace(0.0, motion.duration, 100)]
    return motion.duration, np.array(rows).transpose(1, 0, 2)


def straight(
    dynamics: Dynamics, columns: list[int], start: np.ndarray, end: np.ndarray, limits: object
) -> float:
    """Toppra's duration of the straight line within velocities, accelerations and torques [s]; NaN without one.

    Args:
        dynamics: of the robot with its loads.
        columns: of the arm's joints.
        start: all joints (n,) at the start [rad].
        end: those at the end.
        limits: of the arm's joints.
    """

    def torques(q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        whole = np.array([start, 0.0 * start, 0.0 * start])
        whole[:, columns] = q, v, a
        return sum(part[0, columns] for part in dynamics.torques(*whole[:, None]))

    effort = dynamics.limit[columns]
    rates = [np.column_stack([-most, most]) for most in (limits.velocity, limits.acceleration)]
    constraints = [
        toppra.constraint.JointVelocityConstraint(rates[0]),
        toppra.constraint.JointAccelerationConstraint(rates[1]),
        toppra.constraint.JointTorqueConstraint(
            torques, np.column_stack([-effort, effort]), np.zeros(len(columns))
        ),
    ]
    path = toppra.SplineInterpolator([0.0, 1.0], np.array([start[columns], end[columns]]))
    found = toppra.algorithm.TOPPRA(
        constraints, path, gridpoints=np.linspace(0.0, 1.0, 101), solver_wrapper="seidel"
    ).compute_trajectory()
    return np.nan if found is None else float(found.duration)


def main() -> None:
    """Draws transfers until enough are beyond their torques, and prints the ratios of the durations."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("robot")
    parser.add_argument("--mass", type=float, default=3.0)
    parser.add_argument("--count", type=int, default=30)
    given = parser.parse_args()
    robot = load_robot(given.robot).robot
    tool = Tool(TOOL, pin.Inertia(given.mass, TOOL.translation, np.zeros((3, 3))))
    cell = Cell(robot, pin.SE3.Identity(), {arm.name: tool for arm in robot.arms})
    dynamics, random, limits = Dynamics(cell, {}), np.random.default_rng(1), robot.limits
    columns = robot.columns(robot.arms[0].joints)
    own = limits.select(robot.arms[0].joints)
    ratios, optimal, on_line, seconds, refused = [], [], [], [], 0
    while len(ratios) + refused < given.count:
        start, end = robot.postures["home"].copy(), robot.postures["home"].copy()
        start[columns] = random.uniform(own.lower, own.upper)
        turned = start[columns] + random.uniform(-1, 1, len(columns))
        end[columns] = np.clip(turned, own.lower, own.upper)
        duration, motion = fastest(start[columns], end[columns], own)
        whole = np.zeros((3, 100, len(start)))
        whole[0] = start
        whole[:, :, columns] = motion
        at_rest, moving, viscous = (part[:, columns] for part in dynamics.torques(*whole))
        effort = dynamics.limit[columns]
        if (np.abs(at_rest) > MOST_STATIC * effort).any():
            continue
        if (np.abs(at_rest + moving + viscous) <= effort).all():
            continue
        zero = np.zeros(len(start))
        span = whole[0].min(axis=0), whole[0].max(axis=0)
        ends = TransferEnds((start, zero, zero), (end, zero, zero), duration, *span)
        begun = process_time()
        shape = transfer_within_torques(dynamics, columns, ends, limits)
        seconds.append(process_time() - begun)
        if shape is None:
            refused += 1
        else:
            ratios.append(shape.duration / duration)
            least = optimal_duration(cell, robot.arms[0], start[columns], end[columns], shape)
            optimal.append(np.nan if least is None else shape.duration / least)
            line = straight(dynamics, columns, start, end, own)
            on_line.append(np.nan if least is None else line / least)
    tell(f"{refused} without another shape, {np.isnan(optimal).sum()} without an optimum")
    tell(
        f"time / ruckig's without torques: median {np.median(ratios):.3f}, worst {max(ratios):.3f}"
    )
    against = "time / IPOPT's optimum, median", "worst", "toppra's straight line, median", "worst"
    print_head("arm", "mass", "transfers", *against, "processor time of each")
    numbers = (np.nanmedian(optimal), np.nanmax(optimal), np.nanmedian(on_line), np.nanmax(on_line))
    shown = (f"{number:.3f}" for number in numbers)
    print_row(robot.name, f"{given.mass:g} kg", len(ratios), *shown, f"{np.mean(seconds):.2f} s")


if __name__ == "__main__":
    main()
