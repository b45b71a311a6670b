"""Reach of an arm to a stop, over all platform positions and arm angles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.geometry.rotations import outward
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import PlatformChain, rotation_z
from dualarm_cli.postures.problem import POSTURES, StopProblem
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

REACH_SLACK = 1e-9
"""Rounding tolerance of the reach before arm angles are tested [m]."""


@dataclass(frozen=True)
class _PointReach:
    """Reach to a point of a stop over platform angles (a) and yaws (y)."""

    name: str
    """Name of the point in messages."""
    feasible: BoolArray
    """Flags of poses with a posture within joint limits, shape (a, y)."""
    miss: FloatArray
    """Distance of the wrist beyond reach [m], positive too far, negative too near, (a, y)."""


def reachable_positions(
    model: CellModel, position: FloatArray, stops: Mapping[str, StopProblem]
) -> Iterator[FloatArray]:
    """Yield platform positions, nearest first, from which all arms reach their stops.

    Only a platform of one joint is moved.

    Args:
        model: the cell.
        position: all joints before the stage [rad], shape (n,).
        stops: the arms' stops with the platform at its present position.
    """
    if not model.platform.is_chosen:
        return
    angles, present = scanned_positions(model, position)
    turn = angles - present
    is_near = np.ones(len(angles), dtype=np.bool_)
    for stop in stops.values():
        for R, p in moved_flanges(stop, model.platform, turn):
            is_near &= (np.abs(stop.arm.signed_miss(R, p)) <= REACH_SLACK).any(axis=1)
    order = np.argsort(np.abs(turn), kind="stable")
    order = order[is_near[order]]
    solved, first, size = 0, 0, POSTURES.first_scanned
    while first < len(order):
        block = order[first : first + size]
        usable = np.logical_and.reduce(
            [_common_angles(_points(stop, model.platform, turn[block])) for stop in stops.values()]
        )
        for k in block[usable][: POSTURES.max_angles - solved]:
            yield angles[[k]]
        solved += int(usable.sum())
        if solved >= POSTURES.max_angles:
            return
        first, size = first + size, 2 * size


def explain_reach(model: CellModel, position: FloatArray, stop: StopProblem) -> Refusal | None:
    """Explain why one arm cannot reach its stop, or return None.

    Args:
        model: the cell.
        position: all joints before the stage [rad], shape (n,).
        stop: the arm's stop with the platform at its present position.
    """
    angles, present = scanned_positions(model, position)
    points = _points(stop, model.platform, angles - present)
    if _common_angles(points).any():
        return None
    for point in points:
        if point.feasible.any():
            continue
        a, y = np.unravel_index(int(np.argmin(np.abs(point.miss))), point.miss.shape)
        miss = float(point.miss[a, y])
        where = best_place(model.platform, angles[a])
        message, remedy = stop.arm.why_missed(miss), tuple[str, ...]()
        if message in ("flange_not_there", "point_not_turned"):
            remedy = ("move_target" if stop.free_yaw else "move_target_or_free_yaw",)
        details = {"point": point.name, "where": where}
        return Refusal(message, measured=abs(miss), remedy=remedy, data=details)
    if not model.platform.joints:
        return Refusal("not_from_one_turn")
    return Refusal("not_from_one_place" if model.platform.is_rail else "not_from_one_angle")


def best_place(platform: PlatformChain, position: float = 0.0) -> Refusal:
    """Describe the best platform position in a message.

    Args:
        platform: the chain that carries the arm.
        position: of its joint if it can be chosen [rad or m].
    """
    if not platform.is_chosen:
        return Refusal("platform_stands" if platform.joints else "from_base")
    if platform.is_rail:
        return Refusal("at_platform_place", data={"millimetres": 1e3 * position + 0.0})
    return Refusal("at_platform_angle", data={"degrees": np.degrees(position)})


def scanned_positions(model: CellModel, position: FloatArray) -> tuple[FloatArray, float]:
    """List platform positions to examine (a,) and the present one [rad or m].

    Args:
        model: the cell.
        position: all joints [rad or m], shape (n,).
    """
    if not model.platform.is_chosen:
        return np.zeros(1), 0.0
    present, low, high = model.platform_around(position)
    step = max(arm.kinematics.reach_step for arm in model.arms.values())
    step = model.platform.spacing(step, low, high)
    return np.append(np.arange(low, high, step), high), present


def _common_angles(points: list[_PointReach]) -> BoolArray:
    """Flag platform angles at which all points are feasible for one yaw, shape (a,)."""
    feasible = np.logical_and.reduce([point.feasible for point in points])
    return np.asarray(feasible.any(axis=1))


def point_names(stop: StopProblem) -> list[str]:
    """Name the points of a stop: target and outer ends of lines."""
    names = ["the target"]
    if stop.approach > 0:
        names.append(f"the start of the {stop.approach * 1000:g} mm approach")
    if stop.retract > 0:
        names.append(f"the end of the {stop.retract * 1000:g} mm retract")
    return names


def _points(stop: StopProblem, platform: PlatformChain, turn: FloatArray) -> list[_PointReach]:
    """Compute reach of a stop's points after further platform moves (a,)."""
    flanges = zip(point_names(stop), moved_flanges(stop, platform, turn), strict=True)
    return [_PointReach(name, *stop.arm.reached(R, p)) for name, (R, p) in flanges]


def moved_flanges(
    stop: StopProblem, platform: PlatformChain, moved: FloatArray
) -> list[tuple[FloatArray, FloatArray]]:
    """Compute flange poses at target, approach and retract, (a, y, 3, 3) and (a, y, 3).

    Args:
        stop: the stop with the platform at its present position.
        platform: the chain that carries the arm.
        moved: displacements of its joint [rad or m], shape (a,).
    """
    if stop.configurations is not None:
        # Joint targets move with the platform, so that one position stands for every other.
        moved = np.zeros(len(moved))
    yaws = stop.yaw[:: max(1, len(stop.yaw) // POSTURES.scan_yaws)]
    R_moved, p_moved = platform.shifted(moved)
    R_tool = product(R_moved[:, None], product(stop.R_base_tool[0], rotation_z(yaws))[None])
    target = (product(R_moved, stop.p_base_tool[0]) + p_moved)[:, None]
    R = product(R_tool, stop.R_tool_flange)
    away = outward(stop.directions, R_tool, R_moved[:, None])
    shifts = [
        away[..., k, :] * length for k, length in enumerate((stop.approach, stop.retract)) if length
    ]
    flange = product(R_tool, stop.p_tool_flange)
    return [(R, target + shift + flange) for shift in (np.zeros(3), *shifts)]
