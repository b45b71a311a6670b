"""Proofs that no posture at any platform position reaches a stop.

`explain_reach` looks at samples of what is free. Here a sample stands for all that is nearer to it than to others:
it counts with the distance that the arm moves in between. What is not proven is left open.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import arccos, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.closed_arm import ClosedArm
from dualarm_cli.kinematics.general_arm import TURN, GeneralArm
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs.arm_angle_intervals import feasible_arm_angles
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.kinematics.srs.srs_limits import some_turn_within
from dualarm_cli.kinematics.wrist_arm import WristArm
from dualarm_cli.postures.problem import StopProblem
from dualarm_cli.postures.reach import (
    SCAN_YAWS,
    at_platform,
    moved_flanges,
    point_names,
    scanned_positions,
    srs_miss,
)
from dualarm_cli.refusals import Refusal

ROUNDING = 1e-6
"""Distance beyond reach [m], and turn [rad], that prove nothing."""
ELBOWS, SAMPLES, TINY = 60, 64, 1e-9
"""Elbows looked at on their circle, poses tried first, and least divisor [m]."""
COARSE, FINE = np.radians(6.0), np.radians(0.5)
"""Coarse and fine spacing of the platform positions examined [rad]."""


def out_of_reach(
    model: CellModel,
    position: FloatArray,
    stop: StopProblem,
    slack: float = ROUNDING,
    turn: float = 0.0,
) -> Refusal | None:
    """Return the proof that an arm has no posture for a stop, or None.

    Args:
        model: the cell.
        position: all joints where the motion starts [rad or m], shape (n,); a platform of one joint may be anywhere.
        stop: the arm's stop as seen with the platform there.
        slack: how far the tool may stay away from its target [m].
        turn: how far it may turn away from it [rad].
    """
    if stop.configurations is not None:
        return None
    if turn:
        lever, _ = _miss(stop.arm, stop.R_tool_flange, stop.p_tool_flange)
        slack += turn * (float(norm(lever)) + _last_link(stop.arm))
    names = point_names(stop)
    for moved, gap in _platform_moves(model, position):
        flanges = moved_flanges(stop, model.platform, moved)
        verdicts = [_beyond(model, stop, flange, gap, slack, turn) for flange in flanges]
        for name, beyond, number in zip(names, verdicts, range(len(names)), strict=True):
            if beyond:
                return _how_far(model, position, stop, name, number)
        if None not in verdicts:
            break
    if model.platform.is_chosen or _turns(stop) or slack > ROUNDING:
        return None
    for name, (R, p) in zip(names, moved_flanges(stop, model.platform, np.zeros(1)), strict=True):
        if (miss := _least_miss(stop.arm, R[0], p[0])) is not None:
            more = {"point": name, "degrees": np.degrees(miss[1]), "where": _stands(model)}
            what = "beyond_limits" if isinstance(stop.arm, SrsArm) else "posture_misses"
            return Refusal(what, measured=miss[0], more=more)
    return None


def _platform_moves(model: CellModel, position: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return coarse, then fine platform moves, each with half its spacing."""
    if not model.platform.is_chosen:
        return [(np.zeros(1), 0.0)]
    limits = model.cell.robot.limits.select(model.platform.joints)
    here = float(position[model.platform_columns][0])
    low, high = float(limits.lower[0]), float(limits.upper[0])
    if not model.platform.is_rail and not high - low < 2.0 * np.pi:
        low, high = here - np.pi, here + np.pi
    steps = (model.platform.spacing(step, low, high) for step in (COARSE, FINE))
    moves = [np.linspace(low, high, 2 + int((high - low) / step)) - here for step in steps]
    return [(moved, 0.5 * float(moved[1] - moved[0])) for moved in moves]


def _how_far(
    model: CellModel, position: FloatArray, stop: StopProblem, name: str, number: int
) -> Refusal:
    """Measure how far a point of a stop is beyond reach at best."""
    angles, here = scanned_positions(model, position)
    R, p = moved_flanges(stop, model.platform, angles - here)[number]
    signed = srs_miss(stop.arm, R, p) if isinstance(stop.arm, SrsArm) else _miss(stop.arm, R, p)[1]
    best = int(np.argmin(np.abs(signed)))
    miss = float(signed.flat[best])
    where = _stands(model)
    if model.platform.is_chosen:
        where = at_platform(model.platform, angles[best // signed.shape[1]])
    what = "too_near_shoulder" if miss < 0.0 else "beyond_reach" if miss else "beyond_limits"
    if isinstance(stop.arm, GeneralArm):
        what = "flange_not_there"
    return Refusal(what, measured=abs(miss), more={"point": name, "where": where})


def _stands(model: CellModel) -> Refusal:
    """Return where an arm stands whose platform does not move."""
    return Refusal("platform_stands" if model.platform.joints else "from_base")


def _turns(stop: StopProblem) -> bool:
    """Return whether a tool may also be turned otherwise than is looked at."""
    return stop.free_yaw or len(stop.yaw) > SCAN_YAWS


def _least_miss(
    arm: SrsArm | GeneralArm, R: FloatArray, p: FloatArray
) -> tuple[float, float] | None:
    """Measure the miss of poses [m] and [rad] by closed-form kinematics.

    None where a posture within limits reaches one of them. Where a joint is free, as in a singular posture of six axes,
    only samples of it are known: that is no proof, and None as well.

    Args:
        arm: kinematics and limits.
        R: flange rotations in the carried frame, shape (y, 3, 3).
        p: flange positions [m], shape (y, 3).
    """
    if isinstance(arm, SrsArm):
        # At the ends of its limits an arm has single arm angles, which rounding takes away.
        wider = replace(arm, lower=arm.lower - ROUNDING, upper=arm.upper + ROUNDING)
        return None if feasible_arm_angles(wider, R, p).count.any() else (0.0, 0.0)
    if not isinstance(arm, ClosedArm) or arm.solve(R, p).singular.any():
        return None
    miss = arm.closed_postures(R, p).miss
    distance, angle = miss[int(np.argmin(miss.sum(axis=1)))].tolist()
    return (distance, angle) if distance + angle > ROUNDING else None


def _beyond(
    model: CellModel,
    stop: StopProblem,
    flange: tuple[FloatArray, FloatArray],
    gap: float,
    slack: float,
    turn: float,
) -> bool | None:
    """Return whether poses are all beyond reach; None if unknown.

    False as soon as one is reached, as far as this proof can tell.

    Args:
        model: the cell.
        stop: the stop.
        flange: rotations (a, y, 3, 3) and positions (a, y, 3) [m] at a platform positions and y turns.
        gap: largest distance of a platform position from one of these [rad or m].
        slack: how far the tool may stay away [m].
        turn: how far it may turn away [rad].
    """
    R, p = flange
    point, miss = _miss(stop.arm, R, p)
    near = np.argwhere(miss <= slack)
    if len(near):
        a, y = near[:: 1 + len(near) // SAMPLES].T
        if (
            not isinstance(stop.arm, SrsArm)
            or _elbow_fits(stop.arm, R[a, y], p[a, y], *np.zeros((2, len(a)))).any()
        ):
            return False
    moved = np.full(miss.shape, slack)
    if _turns(stop):
        # Between two turns the point moves along a circle about the tool's axis.
        away = point - p + product(R, product(stop.R_tool_flange.T, stop.p_tool_flange))
        axis = product(R, stop.R_tool_flange[2])
        across = away - axis * (away * axis).sum(axis=-1, keepdims=True)
        moved += (norm(across, axis=-1) + _last_link(stop.arm)) * (np.pi / miss.shape[1])
        turn += np.pi / miss.shape[1]
    if model.platform.is_rail:
        moved += gap
    else:
        moved += (norm(point[..., :2], axis=-1) + _last_link(stop.arm)) * gap
        turn += gap
    beyond = miss > moved
    if isinstance(stop.arm, SrsArm) and not beyond.all():
        a, y = np.nonzero(~beyond)
        turned = np.full(len(a), turn)
        beyond[a, y] = ~_elbow_fits(stop.arm, R[a, y], p[a, y], moved[a, y], turned)
    return True if bool(beyond.all()) else None


def _elbow_fits(
    arm: SrsArm, R: FloatArray, p: FloatArray, moved: FloatArray, turned: FloatArray
) -> BoolArray:
    """Return whether joints 2 and 6 may be within limits near poses (k,).

    The elbow is on a circle about the line from shoulder to wrist; both joints bend by what its place says.

    Args:
        arm: geometry and limits.
        R: flange rotations, shape (k, 3, 3).
        p: flange positions [m], shape (k, 3).
        moved: how far the wrist may be from there [m], shape (k,).
        turned: how far the flange may be turned from there [rad], shape (k,).
    """
    upper, fore = arm.geometry.upper, arm.geometry.fore
    to_wrist = arm.wrist_center(R, p) - arm.geometry.shoulder
    distance = np.maximum(norm(to_wrist, axis=1), TINY)
    along = to_wrist / distance[:, None]
    # The circle's middle on the line, its radius, and how far the wrist's motion shifts and widens it.
    links = upper * upper - fore * fore
    middle = 0.5 * (distance + links / distance)
    radius = np.sqrt(np.maximum(0.0, upper * upper - middle * middle))
    shifted = 0.5 * moved * (1.0 + abs(links) / np.square(np.maximum(distance - moved, TINY)))
    change = shifted * (2.0 * np.maximum(upper, np.abs(middle)) + shifted)
    wider = np.minimum(np.sqrt(change), change / np.maximum(radius, TINY))
    aside = np.where(np.abs(along[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    aside = np.cross(along, aside)
    aside = aside / norm(aside, axis=1, keepdims=True)
    psi = np.linspace(-np.pi, np.pi, ELBOWS, endpoint=False)[:, None]
    circle = cos(psi) * aside[:, None] + sin(psi) * np.cross(along, aside)[:, None]
    elbow = (middle[:, None] * along)[:, None] + radius[:, None, None] * circle
    # From any elbow to the next one that is looked at: along the circle, by shift and width, and turned with the line.
    off = radius * (np.pi / ELBOWS) + shifted + wider + 2.0 * upper * moved / distance
    first_axis, last_axis = arm.canonical.B[:, 2], product(R, arm.canonical.C[2])[:, None]
    fits = np.ones(elbow.shape[:2], dtype=np.bool_)
    for joint, link, axis, slack in (
        (1, elbow, first_axis, off / upper),
        (5, to_wrist[:, None] - elbow, last_axis, (off + moved) / fore + turned),
    ):
        bend = arccos(np.clip((link * axis).sum(axis=-1) / norm(link, axis=-1), -1.0, 1.0))
        # A chord is at least 2 / pi of its arc.
        fits &= bend <= _largest_bend(arm, joint) + ROUNDING + 0.5 * np.pi * slack[:, None]
    return np.asarray(fits.any(axis=1))


def _largest_bend(arm: SrsArm, joint: int) -> float:
    """Return the largest angle between the two links that a joint bends [rad]."""
    low, high, zero = arm.lower[joint], arm.upper[joint], arm.canonical.offset[joint]
    if some_turn_within(np.array(np.pi - zero), float(low), float(high)):
        return np.pi
    ends = np.array([low, high]) + zero
    return float(np.abs(ends - TURN * np.round(ends / TURN)).max())


def _miss(arm: SrsArm | GeneralArm, R: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a point fixed by flange poses and its least distance beyond reach [m]."""
    if isinstance(arm, SrsArm | WristArm):
        return arm.wrist_center(R, p), arm.reach_miss(R, p)
    # The last joint's origin, which that joint does not move: no farther from the first than all links together.
    R_last = product(R, arm.R_last_flange.T)
    point = p - product(R_last, arm.p_last_flange)
    links = norm(arm.p_parent_joint, axis=1)
    slides = list(arm.slides)
    ways = np.maximum(np.abs(arm.lower[slides]), np.abs(arm.upper[slides])).sum()
    distance = norm(point - arm.p_parent_joint[0], axis=-1) - links[1:].sum() - ways
    last = len(links) - 1
    if not {0, last} & set(slides):
        # The joint before it is on a circle about the last axis, the second joint on one about the first.
        low, high = _turns_within(arm, last)
        angles = np.linspace(low, high, 2 + int((high - low) / COARSE))
        link = product(arm.R_parent_joint[last].T, arm.p_parent_joint[last])
        turned = product(rotation_z(-angles), link)
        before = point[..., None, :] - np.einsum("...ij,gj->...gi", R_last, turned)
        step = 0.5 * (angles[1] - angles[0]) * float(norm(link[:2]))
        nearest = _distance_to_second(arm, before).min(axis=-1) - step
        distance = np.maximum(distance, nearest - links[2:last].sum() - ways)
    return point, np.maximum(0.0, distance)


def _distance_to_second(arm: GeneralArm, point: FloatArray) -> FloatArray:
    """Compute the distance of points (..., 3) from the second joint's arc [m]."""
    v = product(point - arm.p_parent_joint[0], arm.R_parent_joint[0])
    x, y, z = arm.p_parent_joint[1].tolist()
    low, high = _turns_within(arm, 0)
    away = arctan2(v[..., 1], v[..., 0]) - float(arctan2(y, x)) - 0.5 * (low + high)
    away = np.abs(away - TURN * np.round(away / TURN))
    bend = np.maximum(0.0, away - 0.5 * (high - low))
    radius, far = float(norm(np.array([x, y]))), norm(v[..., :2], axis=-1)
    along = far - radius * cos(bend)
    squared = np.square(along) + np.square(radius * sin(bend)) + np.square(v[..., 2] - z)
    return np.asarray(np.sqrt(squared))


def _turns_within(arm: GeneralArm, joint: int) -> tuple[float, float]:
    """Return a joint's limits [rad], one whole turn where it has more."""
    low, high = float(arm.lower[joint]), float(arm.upper[joint])
    return (low, high) if high - low < TURN else (-np.pi, np.pi)


def _last_link(arm: SrsArm | GeneralArm) -> float:
    """Return the distance between the point of `_miss` and those examined [m]."""
    return 0.0 if isinstance(arm, SrsArm | WristArm) else float(norm(arm.p_parent_joint[-1]))
