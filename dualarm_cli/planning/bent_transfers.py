"""Transfers that are not straight: along a curve, by a posture, or all joints along one path; within a tool's cap."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.planning.curves import curve
from dualarm_cli.planning.stage_plan import StagePlan
from dualarm_cli.planning.transfers import (
    PLATFORM,
    largest_tool_speed,
    slowed,
    transfers_within_tool_speed,
)
from dualarm_cli.timing import TimingSolver
from dualarm_cli.timing.composition import hold
from dualarm_cli.timing.problem import LineProblem

CURVE_POINTS = 65
"""Points of a curve that is passed along."""
CURVE_KNOTS = 48
"""Knots of its motion at least."""


def detour_pieces(
    model: CellModel,
    plan: StagePlan,
    name: str,
    columns: Mapping[str, list[int]],
    limits: JointLimits,
    timing: TimingSolver,
    cap: float | None,
    platform: Trajectory | None,
) -> list[Trajectory]:
    """Returns an arm's way by a posture: there, a pause, and on; or in one curve that does not stop there.

    Args:
        model: the cell.
        plan: the stage, with a detour of the arm.
        name: the arm.
        columns: columns of each joint group within the limits' joints.
        limits: what the joints may do.
        timing: how transfers are timed.
        cap: largest speed of any tool centre point in the world [m/s], or None.
        platform: what the platform does meanwhile; None where it stands.

    Raises:
        InfeasibleError: the tool exceeds its cap however slowly the arm goes, since the platform moves it.
    """
    detour, index = plan.detours[name], columns[name]
    joints = tuple(limits.joints[i] for i in index)
    if detour.pause is None:
        points = curve(plan.start[index], detour.points, plan.arrival[index], CURVE_POINTS)
        late = plan.waits.get(name, 0.0)

        def position_at(piece: Trajectory, time: FloatArray) -> FloatArray:
            q = np.tile(plan.start, (len(time), 1))
            if platform is not None:
                q[:, columns[PLATFORM]] = platform.at(time + late)[0]
            q[:, index] = piece.at(time)[0]
            return q

        return [_along(model, [name], joints, points, limits, timing, cap, position_at)]
    between = np.array(plan.start)
    between[index] = detour.points[0]
    goal = np.array(plan.start)
    goal[index] = plan.arrival[index]
    legs = []
    for start, end in ((plan.start, between), (between, goal)):
        alone = StagePlan(start, end, end, {}, plan.solver, 0.0)
        moved = transfers_within_tool_speed(model, alone, columns, limits, timing, cap)
        legs.append([moved.motion[name]] if name in moved.motion else [])
    # The posture may be the start itself: the pause comes first then.
    pause = [hold(joints, detour.points[0], detour.pause)] if detour.pause > 0.0 else []
    return [*legs[0], *pause, *legs[1]]


def path_pieces(
    model: CellModel,
    plan: StagePlan,
    columns: Mapping[str, list[int]],
    limits: JointLimits,
    timing: TimingSolver,
    cap: float | None,
) -> dict[str, Trajectory]:
    """Returns the motion of every joint group along a stage's common path; arguments as of `detour_pieces`."""
    assert plan.path is not None  # asked for only where there is one

    def position_at(piece: Trajectory, time: FloatArray) -> FloatArray:
        q: FloatArray = piece.at(time)[0]
        return q

    arms = list(model.arms)
    whole = _along(model, arms, limits.joints, plan.path, limits, timing, cap, position_at)
    return {
        name: whole.select([limits.joints[i] for i in index]) for name, index in columns.items()
    }


def _along(
    model: CellModel,
    arms: Sequence[str],
    joints: tuple[str, ...],
    points: FloatArray,
    limits: JointLimits,
    timing: TimingSolver,
    cap: float | None,
    position_at: Callable[[Trajectory, FloatArray], FloatArray],
) -> Trajectory:
    """Returns the quickest motion along points of a curve [rad], shape (m, n), in which no tool exceeds its cap.

    Args:
        model: the cell.
        arms: those whose tools count.
        joints: that move along the curve.
        points: of the curve.
        limits: what the joints may do.
        timing: how curves are timed.
        cap: largest speed of those tool centre points in the world [m/s], or None.
        position_at: all joints (m, columns) [rad] with a motion along the curve at instants (m,) [s].

    Raises:
        InfeasibleError: a tool exceeds its cap at any speed along the curve.
    """
    share, own = np.linspace(0.0, 1.0, len(points)), limits.select(joints)

    def made(factor: float) -> Trajectory:
        slower = replace(own, velocity=own.velocity * factor)
        return timing.line(LineProblem(joints, points, share, slower, None, CURVE_KNOTS))

    if cap is None:
        return made(1.0)

    def speed(piece: Trajectory) -> float:
        return largest_tool_speed(
            model, arms, lambda time: position_at(piece, time), piece.duration
        )

    found = slowed(made, speed, cap)
    if found is None:
        raise InfeasibleError(
            f"limits: tool_speed: along a detour a tool exceeds {cap:g} m/s at any speed of its arm"
        )
    return found
