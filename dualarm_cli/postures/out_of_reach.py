"""Proofs that no posture at any platform position reaches a stop.

`explain_reach` tests samples of the free quantities. Here a sample covers its neighbourhood: the distance that the arm
moves within it is added. Without a proof the question stays open.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.posture_source import PROVEN_MISS
from dualarm_cli.postures.problem import POSTURES, StopProblem
from dualarm_cli.postures.reach import (
    best_place,
    moved_flanges,
    point_names,
    scanned_positions,
)
from dualarm_cli.refusals import Refusal


def out_of_reach(
    model: CellModel,
    position: FloatArray,
    stop: StopProblem,
    slack: float = PROVEN_MISS,
    turn: float = 0.0,
) -> Refusal | None:
    """Return the proof that an arm has no posture for a stop, or None.

    Args:
        model: the cell.
        position: all joints where the motion starts [rad or m], shape (n,); a platform of one joint may be anywhere.
        stop: the arm's stop with the platform at this position.
        slack: allowed distance of the tool from its target [m].
        turn: allowed angle of the tool from its target [rad].
    """
    if stop.configurations is not None:
        return None
    if turn:
        tip = stop.arm.fixed_point(stop.R_tool_flange, stop.p_tool_flange)
        slack += turn * (float(norm(tip)) + stop.arm.lever)
    names = point_names(stop)
    for moved, gap in _platform_moves(model, position):
        flanges = moved_flanges(stop, model.platform, moved)
        if _are_reached(stop, flanges, slack):
            break
        verdicts = [_all_beyond_reach(model, stop, flange, gap, slack, turn) for flange in flanges]
        for name, is_beyond, number in zip(names, verdicts, range(len(names)), strict=True):
            if is_beyond:
                return _refuse_point(model, position, stop, name, number)
        if None not in verdicts:
            break
    if model.platform.is_chosen or _has_further_yaws(stop) or slack > PROVEN_MISS:
        return None
    for name, (R, p) in zip(names, moved_flanges(stop, model.platform, np.zeros(1)), strict=True):
        if (miss := stop.arm.proven_miss(R[0], p[0])) is not None:
            details = {
                "point": name,
                "degrees": np.degrees(miss[1]),
                "where": best_place(model.platform),
            }
            message = "posture_misses" if any(miss) else "beyond_limits"
            return Refusal(message, measured=miss[0], data=details)
    return None


def _platform_moves(model: CellModel, position: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return coarse, then fine platform moves, each with half its spacing."""
    if not model.platform.is_chosen:
        return [(np.zeros(1), 0.0)]
    limits = model.cell.robot.limits.select(model.platform.joints)
    present = float(position[model.platform_columns][0])
    low, high = float(limits.lower[0]), float(limits.upper[0])
    if not model.platform.is_rail and not high - low < TURN:
        low, high = present - np.pi, present + np.pi
    steps = (model.platform.spacing(step, low, high) for step in POSTURES.proof_steps)
    moves = [np.linspace(low, high, 2 + int((high - low) / step)) - present for step in steps]
    return [(moved, 0.5 * float(moved[1] - moved[0])) for moved in moves]


def _refuse_point(
    model: CellModel, position: FloatArray, stop: StopProblem, name: str, number: int
) -> Refusal:
    """Measure the least distance of a stop's point beyond reach."""
    angles, present = scanned_positions(model, position)
    R, p = moved_flanges(stop, model.platform, angles - present)[number]
    signed = stop.arm.signed_miss(R, p)
    best = int(np.argmin(np.abs(signed)))
    miss = float(signed.flat[best])
    where = best_place(model.platform, angles[best // signed.shape[1]])
    return Refusal(
        stop.arm.why_missed(miss), measured=abs(miss), data={"point": name, "where": where}
    )


def _has_further_yaws(stop: StopProblem) -> bool:
    """Return whether a tool has more yaws than the scanned ones."""
    return stop.free_yaw or len(stop.yaw) > POSTURES.scan_yaws


def _are_reached(
    stop: StopProblem, flanges: Sequence[tuple[FloatArray, FloatArray]], slack: float
) -> bool:
    """Return whether every point may be reached from the middle of its platform positions.

    Nearly every stop is.

    Args:
        stop: the stop.
        flanges: rotations and positions by point, see `_all_beyond_reach`.
        slack: allowed distance of the tool [m].
    """
    middles = []
    for R, p in flanges:
        within_slack = np.argwhere(stop.arm.reach_miss(R, p) <= slack)
        if not len(within_slack):
            return False
        a, y = within_slack[len(within_slack) // 2]
        middles.append((R[a, y], p[a, y]))
    rotations, positions = map(np.array, zip(*middles, strict=True))
    return bool(stop.arm.may_bend(rotations, positions, *np.zeros((2, len(middles)))).all())


def _all_beyond_reach(
    model: CellModel,
    stop: StopProblem,
    flange: tuple[FloatArray, FloatArray],
    gap: float,
    slack: float,
    turn: float,
) -> bool | None:
    """Return whether poses are all beyond reach; None if unknown.

    False as soon as one may be reached.

    Args:
        model: the cell.
        stop: the stop.
        flange: rotations (a, y, 3, 3) and positions (a, y, 3) [m] at a platform positions and y turns.
        gap: largest distance of a platform position from one of these [rad or m].
        slack: allowed distance of the tool [m].
        turn: allowed angle of the tool [rad].
    """
    R, p = flange
    arm = stop.arm
    point, miss = arm.fixed_point(R, p), arm.reach_miss(R, p)
    within_slack = np.argwhere(miss <= slack)
    a, y = within_slack[:: 1 + len(within_slack) // POSTURES.proof_poses].T
    if arm.may_bend(R[a, y], p[a, y], *np.zeros((2, len(a)))).any():
        return False
    moved = np.full(miss.shape, slack)
    if _has_further_yaws(stop):
        # Between two turns the point moves along a circle about the axis of the tool at the target.
        offset = point - p + product(R, product(stop.R_tool_flange.T, stop.p_tool_flange))
        axis = product(R, stop.R_tool_flange[2])
        radial = offset - axis * (offset * axis).sum(axis=-1, keepdims=True)
        aside = norm(stop.directions[0, :, :2], axis=-1) * (stop.approach, stop.retract)
        moved += (norm(radial, axis=-1) + float(aside.max()) + arm.lever) * (np.pi / miss.shape[1])
        turn += np.pi / miss.shape[1]
    if model.platform.is_rail:
        moved += gap
    else:
        moved += (norm(point[..., :2], axis=-1) + arm.lever) * gap
        turn += gap
    beyond = miss > moved
    a, y = np.nonzero(~beyond)
    if len(a):
        beyond[a, y] = ~arm.may_bend(R[a, y], p[a, y], moved[a, y], np.full(len(a), turn))
    return True if bool(beyond.all()) else None
