"""Targets of tasks: poses in the world, or joint configurations within the arm's limits."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.files.cells.cell_frames import frame_pose
from dualarm_cli.files.robots.robot_joints import joint_position
from dualarm_cli.files.robots.urdf import UrdfJoint
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import to_se3
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_tasks import HandoverSection, TargetSection
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.conveyor import OnBelt
from dualarm_cli.model.job import JointTarget, PoseTarget, Target
from dualarm_cli.model.robot import Robot


class TargetReader:
    """Turns the targets of one task file into nouns."""

    def __init__(self, document: Document, cell: Cell, findings: Findings) -> None:
        """Prepares for a file and its cell.

        Args:
            document: the task file.
            cell: where frames and arms come from.
            findings: where errors are noted.
        """
        self._document, self._findings = document, findings
        self._frames = dict(cell.frames)
        self._conveyors = dict(cell.conveyors)
        self._joints = {arm.name: _arm_joints(cell.robot, arm.joints) for arm in cell.robot.arms}

    def target(self, section: TargetSection, loc: Loc, arm: str) -> Target | None:
        """Returns a target, or None after noting what is wrong.

        Args:
            section: the target as the file has it.
            loc: where it stands.
            arm: the arm that goes there.
        """
        if section.joints is not None:
            return self._configurations(section.joints, (*loc, "joints"), self._joints[arm])
        pose = self._pose(section, loc)
        if pose is None:
            return None
        return PoseTarget(pose, section.free == "yaw", section.symmetry or 1)

    def meeting(self, section: HandoverSection, loc: Loc) -> pin.SE3 | None:
        """Returns the giving tool's pose in a hand-over in the world, or None after noting what is wrong.

        Args:
            section: the hand-over as the file has it.
            loc: where it stands.
        """
        return self._pose(section, loc)

    def _pose(self, section: TargetSection | HandoverSection, loc: Loc) -> pin.SE3 | None:
        """Returns a pose in the world, or None after noting a frame that there is not."""
        key = "at" if section.at is not None else "in"
        name = section.at if section.at is not None else section.in_
        T_world_frame = frame_pose(self._document, (*loc, key), name, self._frames, self._findings)
        return None if T_world_frame is None else T_world_frame * to_se3(section)

    def belt(self, section: TargetSection, loc: Loc, action: str) -> OnBelt | None:
        """Returns how a target moves with a conveyor, or None where it does not or after noting what is wrong.

        Args:
            section: the target as the file has it.
            loc: where it stands.
            action: what is done there.
        """
        if section.conveyor is None or section.passes is None or section.within is None:
            return None
        place: Loc = (*loc, "conveyor")
        if action == "move":
            message = "a move goes to a place that stands; 'conveyor' goes with pick and place"
            self._findings.add(self._document, place, message)
            return None
        if section.conveyor not in self._conveyors:
            known = list(self._conveyors)
            hint = suggest(section.conveyor, known, "it has") if known else "; it has none"
            message = f"the cell has no conveyor {quote(section.conveyor)}{hint}"
            self._findings.add(self._document, place, message)
            return None
        conveyor = self._conveyors[section.conveyor]
        return OnBelt(conveyor, section.passes, section.within, section.passes)

    def _configurations(
        self, values: list[object], loc: Loc, joints: list[UrdfJoint]
    ) -> Target | None:
        """Returns alternatives to choose from; a flat list is one."""
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
    """Returns an arm's joints with their limits."""
    sliding = _sliding(robot.urdf)
    limits = robot.limits.select(names)
    return [
        UrdfJoint(name, name in sliding, float(low), float(high), float(velocity))
        for name, low, high, velocity in zip(
            names, limits.lower, limits.upper, limits.velocity, strict=True
        )
    ]


def _sliding(urdf: str) -> set[str]:
    """Returns the joints that slide."""
    model = pin.buildModelFromXML(urdf)
    return {
        name
        for name, joint in zip(model.names, model.joints, strict=True)
        if joint.shortname().startswith("JointModelP")
    }
