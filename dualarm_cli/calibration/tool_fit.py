"""Least-squares fit of tool and base height to joint readings.

The model is tip = p(q) + R(q) tool + height z.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.calibration.spread import look
from dualarm_cli.errors import UsageError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.touches import TouchSide
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Flanges:
    """Flange poses of one robot in its base frame."""

    rotation: FloatArray
    """R_base_flange, shape (n, 3, 3)."""
    position: FloatArray
    """p_base_flange [m], shape (n, 3)."""

    def tips(self, tool: FloatArray, height: float = 0.0) -> FloatArray:
        """Compute the tips (n, 3) [m] of a raised tool (3,) [m].

        `height` raises the tips along z [m].
        """
        tips: FloatArray = self.position + self.rotation @ tool + np.array([0.0, 0.0, height])
        return tips


def flange_poses(robot: Robot, joints: FloatArray) -> Flanges:
    """Compute the flange poses of a single-arm robot.

    Args:
        robot: a robot of one arm.
        joints: positions in the arm's order [rad], shape (n, k).
    """
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    frame = model.getFrameId(robot.arms[0].flange)
    columns = robot.columns(robot.arms[0].joints)
    rotations, positions = np.empty((len(joints), 3, 3)), np.empty((len(joints), 3))
    for k, values in enumerate(joints):
        q = np.zeros(model.nq)
        q[columns] = values
        pin.framesForwardKinematics(model, data, q)
        rotations[k], positions[k] = data.oMf[frame].rotation, data.oMf[frame].translation
    return Flanges(rotations, positions)


def second_joint_height(robot: Robot) -> float | None:
    """Compute the height of the second joint above the base [m].

    None unless the first joint turns about the vertical.
    """
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    joints = [model.getJointId(name) for name in robot.arms[0].joints]
    pin.forwardKinematics(model, data, pin.neutral(model))
    if len(joints) < 2:
        return None
    q = pin.neutral(model)
    height = float(data.oMi[joints[1]].translation[2])
    q[model.idx_qs[joints[0]]] = 1.0
    pin.forwardKinematics(model, data, q)
    upright = abs(float(data.oMi[joints[1]].translation[2]) - height) < 1e-9
    return height if upright else None


def touched_points(
    side: str, touch: TouchSide, use: str, tool: FloatArray, height: float = 0.0
) -> FloatArray:
    """Compute a robot's points in its base frame [m], shape (n, 3).

    Args:
        side: `left` or `right`, for messages.
        touch: its readings.
        use: `joints` or `xyz`: the reading that is used if a point has both.
        tool: tip of the tool in the flange frame [m], shape (3,).
        height: added along the base frame's z [m].

    Raises:
        UsageError: no point has the requested kind of reading.
    """
    has = {"joints": touch.read, "xyz": touch.measured}
    if not has[use].any() and not has["xyz" if use == "joints" else "joints"].all():
        raise UsageError(f"the {side} robot has no {use} for any point")
    points = touch.xyz.copy()
    by_joints = touch.read & ((use == "joints") | ~touch.measured)
    if by_joints.any() and touch.robot is not None:
        points[by_joints] = flange_poses(touch.robot, touch.joints[by_joints]).tips(tool, height)
    return points


TOOL = ("tool x", "tool y", "tool z")
"""Names of the tool's coordinates."""
HEIGHT = "base height"
"""Name of the robot's shift along its base frame's z."""


@dataclass(frozen=True)
class ToolFit:
    """Fitted tool and base height of one robot."""

    names: tuple[str, ...]
    """Names of the fitted parameters: tool x, tool y, tool z, base height."""
    values: FloatArray
    """Fitted values [m], shape (k,); undetermined ones keep their previous value."""
    determined: BoolArray
    """Mask of determined parameters, shape (k,)."""
    covariance: FloatArray | None
    """Covariance [m^2], shape (k, k); None if the noise is unknown."""
    degrees: int | None
    """Degrees of freedom of the noise estimate; None for stated noise."""
    rms: float
    """Root mean square residual distance [m]."""
    unseen: tuple[str, ...]
    """Unobservable directions, as text."""

    def value(self, name: str, default: float) -> float:
        """Return a value [m], or the default for a parameter that was not fitted."""
        return float(self.values[self.names.index(name)]) if name in self.names else default

    def tool(self, before: FloatArray) -> FloatArray:
        """Return the tool's tip (3,) [m]; `before` if it was not fitted."""
        values = [self.value(name, float(v)) for name, v in zip(TOOL, before, strict=True)]
        return readonly(values)


def fit_tool(
    flanges: Flanges,
    xyz: FloatArray,
    tool: FloatArray,
    fitted: tuple[str, ...],
    noise: float | None,
) -> ToolFit:
    """Fit tool and base height by least squares.

    The model xyz = p(q) + R(q) tool + height z is linear.

    Args:
        flanges: flange poses at n points.
        xyz: measured coordinates of the tip [m], shape (n, 3).
        tool: tool in the file [m], shape (3,); undetermined parameters keep its values.
        fitted: `tool`, `base_height` or both.
        noise: standard deviation of each coordinate [m]; None to estimate it from the residuals.
    """
    n = len(xyz)
    upward = np.broadcast_to(np.array([[0.0], [0.0], [1.0]]), (n, 3, 1))
    columns = [flanges.rotation] if "tool" in fitted else []
    columns += [upward] if "base_height" in fitted else []
    names = (TOOL if "tool" in fitted else ()) + ((HEIGHT,) if "base_height" in fitted else ())
    A = np.concatenate(columns, axis=2).reshape(3 * n, -1)
    sight = look(A, np.ones(len(names)))
    before = np.concatenate([tool if "tool" in fitted else [], np.zeros(len(names) % 3)])
    residuals = (xyz - flanges.tips(tool)).ravel()
    step = sight.inverse @ residuals
    residuals = residuals - A @ step
    degrees = 3 * n - sight.rank
    covariance = None
    if noise is not None:
        covariance = sight.covariance(noise**2)
    elif degrees > 0:
        covariance = sight.covariance(float(residuals @ residuals) / degrees)
    return ToolFit(
        names,
        readonly(before + step),
        sight.seen,
        covariance,
        None if noise is not None else degrees,
        float(np.sqrt(residuals @ residuals / n)),
        tuple(sight.in_words(names)),
    )
