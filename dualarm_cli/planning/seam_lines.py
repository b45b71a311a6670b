"""How the tool comes to a seam and leaves it: straight along its axis while the part stands."""

from __future__ import annotations

import numpy as np

from dualarm_cli.closed_chain.chain import Chain
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.problem import LineProblem

SAMPLES = 65
"""Places along a line at which joints are solved for."""
STEPS = 6
"""Newton steps from one place to the next."""
EXACT = 1e-9
"""Residual that counts as none [m and rad]."""
KNOTS = (24, 48, 96, 192, 384)
"""Numbers of knots that are tried until the tool stays near enough to its line."""
NEAR = 5e-5
"""How far the tool may leave its line [m] and its orientation [rad]: half of what is verified."""


def drawn_back(
    chain: Chain, limits: JointLimits, position: FloatArray, length: float
) -> FloatArray | str:
    """Returns joints (SAMPLES, n) [rad] while the tool is drawn back along its axis, or why it cannot be.

    Only the slave's own joints move, by Newton steps of least norm.

    Args:
        chain: part and tool.
        limits: of all joints.
        position: where the tool is [rad], shape (n,).
        length: how far it is drawn back [m].
    """
    here = chain.bodies(position[None])
    R, p, back = here.R_tool[0], here.p_tool[0], -here.R_tool[0, :, 2]
    weight = limits.velocity**2 * chain.slave_joints
    found = np.empty((SAMPLES, len(position)))
    found[0] = q = np.array(position)
    for k in range(1, SAMPLES):
        there = p + back * (length * k / (SAMPLES - 1))
        if k > 1:
            q = 2.0 * found[k - 1] - found[k - 2]
        for _ in range(STEPS):
            bodies = chain.bodies(q[None])
            left = np.append(bodies.p_tool[0] - there, log_rotation(bodies.R_tool[0] @ R.T))
            if np.abs(left).max() < EXACT:
                break
            JW = bodies.J_tool[0] * weight
            gram = JW @ bodies.J_tool[0].T
            q = q - JW.T @ np.linalg.solve(gram + 1e-12 * np.eye(6), left)
        share = f"{length * k / (SAMPLES - 1) * 1e3:.1f} mm from the seam"
        if np.abs(left).max() > 100.0 * EXACT:
            return f"the {chain.work.slave} arm does not reach farther than {share}"
        beyond = np.maximum(limits.lower - q, q - limits.upper) * chain.slave_joints
        if beyond.max() > 0.0:
            return f"joint {limits.joints[int(np.argmax(beyond))]} comes to its limit {share}"
        found[k] = q
    return found


def line_motion(
    chain: Chain,
    position: FloatArray,
    length: float,
    limits: JointLimits,
    timing: TimingSolver,
    tool_speed: float | None,
) -> Trajectory | str:
    """Returns the motion along a line, or why there is none.

    Args:
        chain: part and tool.
        position: joints along it, in the order of the motion [rad], shape (k, n).
        length: of the line [m].
        limits: of all joints.
        timing: how lines are timed.
        tool_speed: cap on the tool's speed [m/s], or None.
    """
    way = np.linspace(0.0, length, len(position))
    ends = chain.bodies(position[[0, -1]])
    R, start = ends.R_tool[0], ends.p_tool[0]
    along = (ends.p_tool[1] - start) / length
    off = np.inf
    for knots in KNOTS:
        found = timing.line(LineProblem(limits.joints, position, way, limits, tool_speed, knots))
        middle = (found.time[1:] + found.time[:-1]) / 2.0
        bodies = chain.bodies(found.at(middle)[0])
        gone = bodies.p_tool - start
        beside = gone - (gone @ along)[:, None] * along
        turned = log_rotation(bodies.R_tool @ R.T)
        off = max(
            float(np.linalg.norm(beside, axis=1).max()),
            float(np.linalg.norm(turned, axis=1).max()),
        )
        if off <= NEAR:
            return found
    return f"its line is left by {off * 1e3:.3f} mm (or mrad)"
