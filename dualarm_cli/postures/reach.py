"""Reach of an arm to a stop, over all platform positions and arm angles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import PlatformChain, rotation_z
from dualarm_cli.postures.problem import POSTURES, StopProblem
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

REACH_SLACK = 1e-9
"""How far a wrist may be beyond the reach by rounding before the arm angles are looked at [m]."""


@dataclass(frozen=True)
class _PointReach:
    """One point of a stop over all platform angles (a) and yaws (y)."""

    name: str
    """How a person calls it."""
    feasible: BoolArray
    """Whether some arm angle of some branch keeps all joints within limits, shape (a, y)."""
    miss: FloatArray
    """How far the wrist is beyond the reach [m]: positive too far, negative too near, shape (a, y)."""


def reachable_positions(
    model: CellModel, position: FloatArray, stops: Mapping[str, StopProblem]
) -> Iterator[FloatArray]:
    """Yields platform positions, nearest first, at which every arm reaches target and line ends.

    Only a platform of one joint is moved.

    Args:
        model: the cell.
        position: all joints before the stage [rad], shape (n,).
        stops: the arms' stops as seen with the platform where it is.
    """
    if not model.platform.is_chosen:
        return
    angles, here = scanned_positions(model, position)
    turn = angles - here
    near = np.ones(len(angles), dtype=np.bool_)
    for stop in stops.values():
        for R, p in moved_flanges(stop, model.platform, turn):
            near &= (np.abs(stop.arm.signed_miss(R, p)) <= REACH_SLACK).any(axis=1)
    order = np.argsort(np.abs(turn), kind="stable")
    order = order[near[order]]
    tried, first, size = 0, 0, POSTURES.first_scanned
    while first < len(order):
        block = order[first : first + size]
        usable = np.logical_and.reduce(
            [_together(_points(stop, model.platform, turn[block])) for stop in stops.values()]
        )
        for k in block[usable][: POSTURES.tried_angles - tried]:
            yield angles[[k]]
        tried += int(usable.sum())
        if tried >= POSTURES.tried_angles:
            return
        first, size = first + size, 2 * size


def explain_reach(model: CellModel, position: FloatArray, stop: StopProblem) -> Refusal | None:
    """Returns why one arm, whatever the other does, cannot make its stop; None if it can.

    Args:
        model: the cell.
        position: all joints before the stage [rad], shape (n,).
        stop: the arm's stop as seen with the platform where it is.
    """
    angles, here = scanned_positions(model, position)
    points = _points(stop, model.platform, angles - here)
    if _together(points).any():
        return None
    for point in points:
        if point.feasible.any():
            continue
        a, y = np.unravel_index(int(np.argmin(np.abs(point.miss))), point.miss.shape)
        miss = float(point.miss[a, y])
        where = best_place(model.platform, angles[a])
        what, remedy = stop.arm.why_missed(miss), tuple[str, ...]()
        if what in ("flange_not_there", "point_not_turned"):
            remedy = ("move_target" if stop.free_yaw else "move_target_or_free_yaw",)
        more = {"point": point.name, "where": where}
        return Refusal(what, measured=abs(miss), remedy=remedy, more=more)
    return Refusal("not_from_one_place" if model.platform.is_rail else "not_from_one_angle")


def best_place(platform: PlatformChain, position: float = 0.0) -> Refusal:
    """Return where a platform stands at best, as a part of a message.

    Args:
        platform: the chain that carries the arm.
        position: of its joint if it can be chosen [rad or m].
    """
    if not platform.is_chosen:
        return Refusal("platform_stands" if platform.joints else "from_base")
    if platform.is_rail:
        return Refusal("at_platform_place", more={"millimetres": 1e3 * position + 0.0})
    return Refusal("at_platform_angle", more={"degrees": np.degrees(position)})


def scanned_positions(model: CellModel, position: FloatArray) -> tuple[FloatArray, float]:
    """List platform positions to examine (a,) and the present one [rad or m].

    Args:
        model: the cell.
        position: all joints [rad or m], shape (n,).
    """
    if not model.platform.is_chosen:
        return np.zeros(1), 0.0
    here, low, high = model.platform_around(position)
    step = max(arm.kinematics.reach_step for arm in model.arms.values())
    step = model.platform.spacing(step, low, high)
    return np.append(np.arange(low, high, step), high), here


def _together(points: list[_PointReach]) -> BoolArray:
    """Returns the platform angles at which all points are feasible for one yaw, shape (a,)."""
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
    """Returns flange poses at target, approach and retract, (a, y, 3, 3) and (a, y, 3).

    Args:
        stop: the stop as seen with the platform where it is.
        platform: the chain that carries the arm.
        moved: how far its joint moves further [rad or m], shape (a,).
    """
    if stop.configurations is not None:
        # Joint targets move with the platform: what holds at one position holds at all.
        moved = np.zeros(len(moved))
    yaws = stop.yaw[:: max(1, len(stop.yaw) // POSTURES.scan_yaws)]
    R_moved, p_moved = platform.shifted(moved)
    R_tool = product(R_moved[:, None], product(stop.R_base_tool[0], rotation_z(yaws))[None])
    target = (product(R_moved, stop.p_base_tool[0]) + p_moved)[:, None]
    R = product(R_tool, stop.R_tool_flange)
    depths = [0.0, *(depth for depth in (stop.approach, stop.retract) if depth > 0)]
    return [
        (R, target - R_tool[..., :, 2] * depth + product(R_tool, stop.p_tool_flange))
        for depth in depths
    ]
