"""The arms' closed-form kinematics as CasADi expressions."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.stages.plans.problem import ArmWork


def turned_pose(
    work: ArmWork, R: Any, p: Any, turn: Any, yaw: Any, *, slides: bool
) -> tuple[Any, Any]:
    """Returns a flange pose in the carried frame after the platform has moved and the tool has turned.

    Args:
        work: the arm, with its tool.
        R: flange rotation in the carried frame before, shape (3, 3).
        p: flange position likewise [m], shape (3,).
        turn: how far the platform turns [rad], or slides [m].
        yaw: how far the tool turns about its own z axis through its centre point [rad].
        slides: whether the platform slides.
    """
    tool = ca.DM(work.R_tool_flange)
    spin = ca.mtimes([tool.T, rotation(yaw), tool])
    tcp = -ca.mtimes(tool.T, ca.DM(work.p_tool_flange))
    R_yawed = ca.mtimes(R, spin)
    p_yawed = p + ca.mtimes(R, tcp) - ca.mtimes(R_yawed, tcp)
    if slides:
        return R_yawed, p_yawed - ca.vertcat(0, 0, turn)
    back = rotation(-turn)
    return ca.mtimes(back, R_yawed), ca.mtimes(back, p_yawed)


def forward(arm: SrsArm, q: Any) -> tuple[Any, Any]:
    """Returns the flange's rotation (3, 3) and position (3,) [m] at joints (7,), as `SrsArm.forward` has them."""
    geometry, canonical = arm.geometry, arm.canonical
    frame, links = ca.SX.eye(3), ca.SX.zeros(3)
    for joint in range(7):
        theta = canonical.sign[joint] * q[joint] + canonical.offset[joint]
        frame = ca.mtimes(frame, _bend(theta) if joint % 2 else rotation(theta))
        if joint in (1, 3):
            links += (geometry.upper if joint == 1 else geometry.fore) * frame[:, 2]
    B, C = ca.DM(canonical.B), ca.DM(canonical.C)
    R = ca.mtimes([B, frame, C])
    wrist = ca.mtimes(B, links) + ca.DM(geometry.shoulder)
    return R, wrist - ca.mtimes(R, ca.DM(geometry.p_flange_wrist))


def chain_function(arm: SrsArm) -> Any:
    """Returns `forward` of one arm as a CasADi function: written once, used at many stops."""
    q = ca.SX.sym("q", 7)
    return ca.Function("chain", [q], list(forward(arm, q)))


def inverse(arm: SrsArm, R: Any, p: Any, psi: Any, branch: int, near: Any) -> Any:
    """Returns joints (7,) of one branch as `SrsArm.solve_branch` has them, each on the turn nearest to a reference.

    Args:
        arm: which arm.
        R: flange rotation in the carried frame, shape (3, 3).
        p: flange position likewise [m], shape (3,).
        psi: arm angle [rad].
        branch: which of the eight.
        near: the reference [rad], shape (7,).
    """
    geometry, canonical = arm.geometry, arm.canonical
    B, C = ca.DM(canonical.B), ca.DM(canonical.C)
    wrist = p + ca.mtimes(R, ca.DM(geometry.p_flange_wrist))
    w = ca.mtimes(B.T, wrist - ca.DM(geometry.shoulder))
    shoulder, fore, bend = _arm_plane(w, psi, geometry.upper, geometry.fore)
    outer = ca.mtimes(fore, ca.mtimes([B.T, R, C.T]))
    elbow, flip, wrist_bit = branch // 4, branch // 2 % 2, branch % 2
    theta: list[Any] = [None] * 7
    for first, triple, mine in ((0, shoulder, flip), (4, outer, wrist_bit)):
        sign = 1 - 2 * mine
        theta[first] = ca.atan2(sign * triple[1, 2], sign * triple[0, 2])
        size = ca.sqrt(triple[0, 2] ** 2 + triple[1, 2] ** 2)
        theta[first + 1] = sign * ca.atan2(size, triple[2, 2])
        theta[first + 2] = ca.atan2(sign * triple[2, 1], -sign * triple[2, 0])
    theta[2] += np.pi * elbow
    theta[4] += np.pi * elbow
    theta[3] = (1 - 2 * elbow) * bend
    q = []
    for joint in range(7):
        gap = canonical.sign[joint] * (theta[joint] - canonical.offset[joint]) - near[joint]
        # On the turn of the reference, without a jump where it crosses half a turn.
        q.append(near[joint] + ca.atan2(ca.sin(gap), ca.cos(gap)))
    return ca.vertcat(*q)


def rotation(angle: Any) -> Any:
    """Returns a rotation about z, shape (3, 3)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, -s, 0), ca.horzcat(s, c, 0), ca.horzcat(0, 0, 1))


def _bend(angle: Any) -> Any:
    """Returns a rotation about y, shape (3, 3)."""
    c, s = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(ca.horzcat(c, 0, s), ca.horzcat(0, 1, 0), ca.horzcat(-s, 0, c))


def _arm_plane(w: Any, psi: Any, upper: float, fore: float) -> tuple[Any, Any, Any]:
    """Returns the shoulder triple, the transposed frame of the forearm, and the bend; see `ArmPlane`."""
    d = ca.sqrt(ca.dot(w, w))
    u = w / d
    cos_bend = (d * d - upper**2 - fore**2) / (2.0 * upper * fore)
    bend = ca.acos(ca.fmin(ca.fmax(cos_bend, -1.0 + 1e-12), 1.0 - 1e-12))
    a = ca.atan2(fore * ca.sin(bend), upper + fore * ca.cos(bend))
    f = bend - a
    # reference_directions without its division: v c² = x²/(1+z), v c s = x y/(1+z).
    x, y, z = u[0], u[1], u[2]
    r = ca.vertcat(1 - x * x / (1 + z), -x * y / (1 + z), -x)
    t = ca.vertcat(-x * y / (1 + z), 1 - y * y / (1 + z), -y)
    h, m = r * ca.cos(psi) + t * ca.sin(psi), t * ca.cos(psi) - r * ca.sin(psi)
    shoulder = ca.horzcat(ca.sin(a) * u - ca.cos(a) * h, -m, ca.cos(a) * u + ca.sin(a) * h)
    forearm = ca.vertcat(
        (-ca.cos(f) * h - ca.sin(f) * u).T, -m.T, (ca.cos(f) * u - ca.sin(f) * h).T
    )
    return shoulder, forearm, bend
