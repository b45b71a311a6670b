"""CellModel: a cell ready for kinematics, with its platform chain and its arms."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import Diagnostic, InputError, UnsupportedError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.joint_axes import SRS_TOLERANCE, SrsGeometry, joint_axes
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.closed_arm import ClosedArm, with_closed_forms
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.parallel_arm import ParallelArm
from dualarm_cli.kinematics.platform_chain import PlatformChain
from dualarm_cli.kinematics.posture_source import PostureSource
from dualarm_cli.kinematics.srs_arm import SrsArm, closed_form
from dualarm_cli.kinematics.wrist_arm import WristArm
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.robot import Arm, Robot
from dualarm_cli.records import dataclass

ROUNDED_ANGLE = 1e-4
"""Largest deviation that rounded angles in a URDF cause [m and rad]."""
CLOSED_ARMS: Mapping[str, type[ClosedArm]] = {
    "spherical_wrist": WristArm,
    "parallel_axes": ParallelArm,
}
"""Closed forms of six axes by kind of arm."""


@dataclass(frozen=True)
class ArmModel:
    """Kinematics of an arm in the carried frame, and its tool."""

    arm: Arm
    """Arm of the data model."""
    kinematics: PostureSource
    """Forward and inverse kinematics in the carried frame.

    A SrsArm for kind srs, and one of CLOSED_ARMS for its kinds if the arm has closed forms.
    """
    columns: list[int]
    """Columns of its joints within the robot's joints."""
    T_flange_tcp: pin.SE3
    """Tool centre point in the flange frame."""

    @property
    def closed_form(self) -> SrsArm:
        """Closed forms over the arm angle.

        Raises:
            UnsupportedError: the arm has none.
        """
        return closed_form(self.kinematics)


@dataclass(frozen=True, eq=False)
class MeasuredRobot:
    """Robot model from a URDF, on which arms are measured."""

    robot: Robot
    """Robot of the data model."""
    model: pin.Model
    """Model of the whole robot."""
    platform: PlatformChain
    """Joints that carry the arms."""
    T_carried_root: pin.SE3
    """Root of the model in the frame that carries the arms, all platform joints at zero."""

    @classmethod
    def of(cls, robot: Robot, base: pin.SE3) -> MeasuredRobot:
        """Read a robot's URDF.

        Args:
            robot: of the data model.
            base: pose of the model's root in the world.
        """
        model = pin.buildModelFromXML(robot.urdf)
        platform = PlatformChain.from_model(model, robot.platform, base)
        return cls(robot, model, platform, platform.T_world_carried.inverse() * base)

    def kinematics(self, arm: Arm, numeric: bool) -> PostureSource:
        """Measure an arm, in closed form if its kind has one."""
        if numeric or arm.kind != "srs":
            general, family = self.general(arm), CLOSED_ARMS.get(arm.kind)
            return general if family is None else with_closed_forms(family, general)
        geometry = self.srs(arm)
        if not geometry.is_srs(SRS_TOLERANCE):
            raise InputError([_false_kind(arm, self._false_srs(arm, geometry))])
        limits = self.robot.limits.select(arm.joints)
        return SrsArm(geometry, limits.lower, limits.upper)

    def general(self, arm: Arm) -> GeneralArm:
        """Measure an arm of six joints or more.

        Raises:
            UnsupportedError: fewer than six joints.
        """
        limits = self.robot.limits.select(arm.joints)
        bounds = limits.lower, limits.upper
        try:
            return GeneralArm.from_model(
                self.model, arm.joints, arm.flange, self.T_carried_root, bounds
            )
        except UnsupportedError as error:
            raise UnsupportedError(f"arm {arm.name} of {self.robot.name}: {error}") from None

    def srs(self, arm: Arm) -> SrsGeometry:
        """Measure the SRS geometry of a 7-axis arm, with its deviations.

        Raises:
            UnsupportedError: the arm does not have seven revolute joints.
        """
        if len(arm.joints) != 7:
            raise UnsupportedError(
                f"arm {arm.name} of {self.robot.name} has {len(arm.joints)} joints; kind srs needs 7"
            )
        axes, points = joint_axes(self.model, arm.joints)
        sliding = np.abs(norm(axes, axis=1) - 1.0) > 1e-9
        if sliding.any():
            name = arm.joints[int(sliding.argmax())]
            raise UnsupportedError(
                f"joint {name} of {self.robot.name} slides; kind srs needs revolute"
            )
        model, data = self.model, self.model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        flange = self.T_carried_root * data.oMf[model.getFrameId(arm.flange)]
        R, p = self.T_carried_root.rotation, self.T_carried_root.translation
        return SrsGeometry.measure(
            product(axes, R.T), product(points, R.T) + p, flange.rotation, flange.translation
        )

    def why_false(self, arm: Arm) -> str:
        """Explain why an arm is not of its stated kind.

        Empty if it is.
        """
        if arm.kind == "srs":
            geometry = self.srs(arm)
            return "" if geometry.is_srs(SRS_TOLERANCE) else self._false_srs(arm, geometry)
        if arm.kind not in CLOSED_ARMS:
            return ""
        general = self.general(arm)
        if arm.kind == "spherical_wrist":
            deviation, unit = general.wrist_gap, "m"
            fault = f"its last three axes miss a common point by {deviation * 1000:.3g} mm"
        else:
            deviation, unit = general.parallel_deviation, "rad"
            fault = f"its axes 2, 3 and 4 are not parallel by {deviation:.3g} rad"
        if deviation <= SRS_TOLERANCE:
            return ""
        return (
            f"arm {arm.name} of {self.robot.name} has kind: {arm.kind}, but {fault} "
            f"(allowed: {SRS_TOLERANCE:g} {unit}); correct the URDF, or use kind: general"
        )

    def _false_srs(self, arm: Arm, geometry: SrsGeometry) -> str:
        """Describe the deviations of an arm that is stated as srs."""
        hint = ""
        if geometry.deviation.largest < ROUNDED_ANGLE:
            hint = " (angles that are rounded, such as 1.5708 for pi/2, do this: write 1.5707963267948966)"
        return (
            f"arm {arm.name} of {self.robot.name} has kind: srs, but is not spherical-revolute-spherical: "
            f"{geometry.deviation} (allowed: {SRS_TOLERANCE:g} m and rad){hint}; correct the URDF, or use kind: "
            "general, which is planned with numeric inverse kinematics"
        )


@dataclass(frozen=True)
class CellModel:
    """A cell ready for kinematics."""

    cell: Cell
    """Cell of the data model."""
    platform: PlatformChain
    """Joints that carry the arms."""
    platform_columns: list[int]
    """Columns of the platform's joints within the robot's joints."""
    arms: Mapping[str, ArmModel]
    """Arms by name."""

    @classmethod
    def from_cell(cls, cell: Cell, *, numeric: bool = False) -> CellModel:
        """Measure the robot's kinematics.

        Args:
            cell: of the data model.
            numeric: whether closed forms over the arm angle are ignored.

        Raises:
            InputError: an arm is stated as srs and is not.
            UnsupportedError: an arm has fewer than six joints.
        """
        robot, measured = cell.robot, MeasuredRobot.of(cell.robot, cell.base)
        arms = {
            arm.name: ArmModel(
                arm,
                measured.kinematics(arm, numeric),
                robot.columns(arm.joints),
                cell.tools[arm.name].tcp,
            )
            for arm in robot.arms
        }
        return cls(cell, measured.platform, robot.columns(robot.platform), arms)

    @property
    def has_arm_angles(self) -> bool:
        """Flag of cells whose arms all have closed forms over an arm angle."""
        return all(arm.kinematics.has_arm_angle for arm in self.arms.values())

    def platform_around(self, position: FloatArray) -> tuple[float, float, float]:
        """Return a one-joint platform's position and the range examined about it [rad or m].

        Args:
            position: all joints of the robot [rad], shape (n,).
        """
        column, limits = self.platform_columns[0], self.cell.robot.limits
        present, lower, upper = (float(x[column]) for x in (position, limits.lower, limits.upper))
        return present, *self.platform.around(present, lower, upper)

    def carried_frame(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute the frame that carries the arms: rotations (..., 3, 3), positions (..., 3).

        Args:
            position: all joints of the robot [rad], shape (..., n).
        """
        return self.platform.pose(position[..., self.platform_columns])

    def platform_angle(self, position: FloatArray) -> float | None:
        """Return a single platform joint's angle at joints (n,) [rad], or None.

        None for a platform that has not exactly one joint.
        """
        angles = position[self.platform_columns]
        return float(angles[0]) if len(angles) == 1 else None

    def tool_position(self, arm: str, position: FloatArray) -> FloatArray:
        """Compute the tool centre point in the world [m], shape (..., 3).

        Args:
            arm: name of the arm.
            position: all joints of the robot [rad], shape (..., n).
        """
        position_of_tool: FloatArray = self.tool_positions([arm], position)[0]
        return position_of_tool

    def tool_positions(self, arms: Sequence[str], position: FloatArray) -> FloatArray:
        """Compute tool centre points of arms in the world [m], shape (a, ..., 3).

        Args:
            arms: names of a arms.
            position: all joints of the robot [rad], shape (..., n).
        """
        R_world, p_world = self.carried_frame(position)
        positions = []
        for model in (self.arms[arm] for arm in arms):
            R, p = model.kinematics.forward(position[..., model.columns])
            tip = p + product(R, model.T_flange_tcp.translation)
            positions.append(p_world + product(R_world, tip[..., None])[..., 0])
        return np.array(positions)

    def tool_pose(self, arm: str, position: FloatArray) -> pin.SE3:
        """Compute the tool centre point's pose in the world at one configuration (n,)."""
        model = self.arms[arm]
        R_world, p_world = self.carried_frame(position)
        R, p = model.kinematics.forward(position[model.columns])
        return pin.SE3(R_world, p_world) * pin.SE3(R, p) * model.T_flange_tcp


def general_arms(cell: Cell) -> dict[str, GeneralArm]:
    """Measure all arms of a cell as arms without closed forms, by name.

    Raises:
        UnsupportedError: an arm has fewer than six joints.
    """
    measured = MeasuredRobot.of(cell.robot, cell.base)
    return {arm.name: measured.general(arm) for arm in cell.robot.arms}


def find_false_kinds(robot: Robot) -> list[Diagnostic]:
    """Diagnose every arm that is not of its stated kind, with what was measured.

    Args:
        robot: of the data model.
    """
    measured, diagnostics = MeasuredRobot.of(robot, pin.SE3.Identity()), []
    for arm in robot.arms:
        try:
            message = measured.why_false(arm)
        except UnsupportedError as error:
            message = str(error)
        if message:
            diagnostics.append(_false_kind(arm, message))
    return diagnostics


def _false_kind(arm: Arm, message: str) -> Diagnostic:
    """Create the diagnostic of an arm that is not of its stated kind."""
    return Diagnostic(arm.place.file, arm.place.line, arm.place.column, "E400", message)
