"""Platform positions worth trying for a stage: the solver's, then the nearest reachable ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.srs_arm import closed_form
from dualarm_cli.platform_angle import PLATFORM_SOLVERS, PlatformProblem
from dualarm_cli.redundancy import StopProblem


def platform_candidates(
    model: CellModel, position: FloatArray, stops: Mapping[str, StopProblem], solver: str
) -> Iterator[tuple[str, FloatArray]]:
    """Yields the solver's platform positions in order of preference, each with the method's name.

    No solver of the family has two elbows to balance, and the platform stays where it is, in a stage of joint
    targets only (they turn with it), in a stage with one arm at work, and where it is not one revolute joint.

    Args:
        model: the cell.
        position: all joints before the stage [rad], shape (n,).
        stops: the arms' stops as seen with the platform where it is.
        solver: name of the platform solver.
    """
    here = position[model.platform_columns]
    in_world = sum(stop.configurations is None for stop in stops.values())
    if not model.platform.is_turntable or len(stops) < 2 or not in_world or solver == "fixed":
        yield "fixed", here
        return
    solution = PLATFORM_SOLVERS[solver].solve(stage_problem(model, position, stops))
    limits = model.cell.robot.limits.select(model.platform.joints)
    for angle in solution.preferred(0):
        turns = 2.0 * np.pi * np.arange(-2, 3)
        inside = [a for a in angle + turns if limits.lower[0] <= a <= limits.upper[0]]
        if inside:
            yield solver, np.array([min(inside, key=lambda a: abs(a - here[0]))])


def stage_problem(
    model: CellModel, position: FloatArray, stops: Mapping[str, StopProblem]
) -> PlatformProblem:
    """Returns the platform-angle problem of one stage with both arms at work.

    The wrist centres are those of the transfer's end (the start of the approach), at the first yaw.
    """
    angle = float(position[model.platform_columns][0])
    shoulder, upper, fore, wrist, elbow = [], [], [], [], []
    for name, stop in stops.items():
        arm = model.arms[name].closed_form
        upper.append(arm.geometry.upper)
        fore.append(arm.geometry.fore)
        before = _wrist_before_approach(stop)
        if stop.configurations is None:
            shoulder.append(arm.geometry.shoulder)
            wrist.append(in_axis_frame(before, angle))
        else:
            # Joint targets turn with the platform: as for a shoulder on the axis, no angle changes the elbow.
            height = arm.geometry.shoulder[2]
            reach = float(np.linalg.norm(before - arm.geometry.shoulder))
            shoulder.append(np.array([0.0, 0.0, height]))
            wrist.append(np.array([reach, 0.0, height]))
        elbow.append(float(arm.elbow_interior_angle(stop.start[3])))
    points = np.array(shoulder)
    return PlatformProblem.broadcast(
        radius=np.hypot(points[:, 0], points[:, 1]),
        offset=np.arctan2(points[:, 1], points[:, 0]),
        height=points[:, 2],
        upper=np.array(upper),
        fore=np.array(fore),
        wrist=np.array(wrist)[None],
        angle_0=np.array([angle]),
        elbow_0=np.array([elbow]),
    )


def _wrist_before_approach(stop: StopProblem) -> FloatArray:
    """Returns the wrist centre at the start of the approach in the carried frame [m], (3,)."""
    R_tool = stop.R_base_tool[0]
    p_tool = stop.p_base_tool[0] - R_tool[:, 2] * stop.approach
    wrist: FloatArray = closed_form(stop.arm).wrist_center(
        R_tool @ stop.R_tool_flange, p_tool + R_tool @ stop.p_tool_flange
    )
    return wrist


def in_axis_frame(point: FloatArray, angle: float) -> FloatArray:
    """Returns a point of the carried frame in the platform's fixed axis frame."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = point
    return np.array([c * x - s * y, s * x + c * y, z])
