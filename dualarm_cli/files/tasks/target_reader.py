"""Reader of targets: poses in the world, or joint configurations within the arm's limits."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from dualarm_cli.files.cells.cell_frames import frame_pose
from dualarm_cli.files.robots.robot_joints import joint_position
from dualarm_cli.files.robots.urdf import UrdfJoint
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import FramedPose, to_se3
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_tasks import TargetSection
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import JointTarget, PoseTarget, Target
from dualarm_cli.model.part_flow import PoseRange
from dualarm_cli.model.robot import Robot


class TargetReader:
    """Converter of the targets of one task file to data."""

    def __init__(
        self, document: Document, cell: Cell, findings: Findings, places: Mapping[Loc, pin.SE3]
    ) -> None:
        """Store a file, its cell and the list of errors.

        Args:
            document: the task file.
            cell: provides frames and arms.
            findings: where errors are noted.
            places: poses of places in the frames of targets, by location of the target.
        """
        self._document, self._findings = document, findings
        self.cell, self._places = cell, places
        self._frames = dict(cell.frames)
        self._robot = cell.robot
        self._joints = {arm.name: _arm_joints(cell.robot, arm.joints) for arm in cell.robot.arms}

    def target(self, section: TargetSection, loc: Loc, arm: str) -> Target | None:
        """Read a target; None after noting an error.

        Args:
            section: the target as the file has it; a posture is one that the robot has.
            loc: where it stands.
            arm: the arm that goes there.
        """
        if section.posture is not None:
            return JointTarget(self._of_posture(section.posture, arm))
        if section.joints is not None:
            return self._configurations(section.joints, (*loc, "joints"), self._joints[arm])
        pose = self.pose(section, section.at, loc)
        if pose is None:
            return None
        free_yaw = section.free is not None and section.free.turn is not None
        return PoseTarget(pose, free_yaw, section.symmetry or 1)

    def ranges(self, section: TargetSection, target: Target, of: str) -> tuple[PoseRange, ...]:
        """List the ranges of a target's pose, its own first; joint positions have none.

        Args:
            section: the target as the file has it.
            target: the same in the world.
            of: name of its own range.
        """
        if not isinstance(target, PoseTarget):
            return ()
        frame = section.at or section.in_ or ""
        alone: tuple[PoseRange, ...] = ()
        if section.varies is not None:
            axes = self._frames.get(frame, pin.SE3.Identity()).rotation
            alone = (section.varies.about(of, pin.SE3(axes, target.pose.translation)),)
        return (*alone, *self.cell.varying.get(frame, ()))

    def _of_posture(self, name: str, arm: str) -> FloatArray:
        """Look up an arm's joint positions in a named posture [rad], shape (1, n)."""
        columns = [self._robot.joints.index(joint.name) for joint in self._joints[arm]]
        return self._robot.postures[name][None, columns]

    def pose(self, section: FramedPose, at: str | None, loc: Loc) -> pin.SE3 | None:
        """Transform a pose into the world frame; None after noting an unknown frame.

        Args:
            section: the pose as the file has it.
            at: its frame where that is not named by `in`.
            loc: where it stands.
        """
        key, name = ("at", at) if at is not None else ("in", section.in_)
        T_world_frame = frame_pose(self._document, (*loc, key), name, self._frames, self._findings)
        if T_world_frame is None:
            return None
        T_frame_target = to_se3(section)
        if loc in self._places:
            T_frame_target = self._places[loc] * T_frame_target
            # Decimal numbers of a file stay decimal: 0.12 - 0.09 is 0.03.
            T_frame_target.translation = np.round(T_frame_target.translation, 12)
        return T_world_frame * T_frame_target

    def _configurations(
        self, values: list[object], loc: Loc, joints: list[UrdfJoint]
    ) -> Target | None:
        """Read alternative configurations; a flat list is a single one."""
        if not any(isinstance(value, list) for value in values):
            rows = [self._configuration(values, loc, joints)]
        else:
            rows = [self._configuration(row, (*loc, k), joints) for k, row in enumerate(values)]
        good = [row for row in rows if row is not None]
        return JointTarget(np.array(good)) if len(good) == len(rows) else None

    def _configuration(self, row: object, loc: Loc, joints: list[UrdfJoint]) -> list[float] | None:
        if not isinstance(row, list):
            message = f"must be a list of {len(joints)} joint positions, not {quote(row)}"
            self._findings.add(self._document, loc, message, "E200")
            return None
        if len(row) != len(joints):
            names = ", ".join(joint.name for joint in joints)
            message = f"{len(row)} joint positions; the arm has {len(joints)} joints: {names}"
            self._findings.add(self._document, loc, message)
            return None
        positions = [
            joint_position(self._document, (*loc, k), value, joint, self._findings)
            for k, (value, joint) in enumerate(zip(row, joints, strict=True))
        ]
        good = [position for position in positions if position is not None]
        return good if len(good) == len(row) else None


def _arm_joints(robot: Robot, names: tuple[str, ...]) -> list[UrdfJoint]:
    """Return an arm's joints with their position and velocity limits."""
    limits = robot.limits.select(names)
    return [
        UrdfJoint(name, name in robot.sliding, float(low), float(high), float(velocity))
        for name, low, high, velocity in zip(
            names, limits.lower, limits.upper, limits.velocity, strict=True
        )
    ]
