"""The links of a schedule's URDF as a tree of frames, as tf has it."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.schedule import ScheduleRobot
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class LinkFrame:
    """One link and where it is in the link that carries it."""

    name: str
    """Of the link."""
    parent: str
    """The link that carries it; the world of the root link."""
    pose: pin.SE3
    """Of its frame in the parent's, at position 0 of its joint."""
    joint: str = ""
    """The moving joint between the two; empty where it is fixed."""
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Of the joint, in the link's frame."""
    slides: bool = False
    """Whether the joint slides along its axis instead of turning about it."""

    def poses(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Returns translations (m, 3) [m] and quaternions x, y, z, w (m, 4) in the parent at joint positions (m,)."""
        count, axis = len(positions), np.array(self.axis)
        translation = np.tile(self.pose.translation, (count, 1))
        own = pin.Quaternion(self.pose.rotation)
        if self.slides or not self.joint:
            way = self.pose.rotation @ axis
            translation = translation + positions[:, None] * way if self.joint else translation
            return translation, np.tile(own.coeffs(), (count, 1))
        s, c = np.sin(positions / 2.0), np.cos(positions / 2.0)
        vector, scalar = own.coeffs()[:3], own.coeffs()[3]
        turned = scalar * s[:, None] * axis + c[:, None] * vector
        turned = turned + s[:, None] * np.cross(vector, axis)
        return translation, np.column_stack([turned, scalar * c - s * (vector @ axis)])


def link_frames(robot: ScheduleRobot) -> tuple[str, list[LinkFrame]]:
    """Returns the name of the fixed frame, and the frames of all links, parents first.

    Args:
        robot: of a schedule.
    """
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    links = [k for k, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    names = {model.frames[k].name for k in links}
    world = next(name for name in ("world", "cell", "cell_world") if name not in names)
    found = []
    for k in links:
        frame = model.frames[k]
        above = frame.parentFrame
        while above > 0 and model.frames[above].type != pin.FrameType.BODY:
            above = model.frames[above].parentFrame
        if above == 0:
            found.append(LinkFrame(frame.name, world, robot.base * data.oMf[k]))
            continue
        parent = model.frames[above]
        pose = data.oMf[above].actInv(data.oMf[k])
        if frame.parentJoint == parent.parentJoint:
            found.append(LinkFrame(frame.name, parent.name, pose))
            continue
        motion = np.asarray(data.joints[frame.parentJoint].S).ravel()
        slides = bool(np.any(motion[:3]))
        about = frame.placement.rotation.T @ (motion[:3] if slides else motion[3:])
        axis = (float(about[0]), float(about[1]), float(about[2]))
        joint = model.names[frame.parentJoint]
        found.append(LinkFrame(frame.name, parent.name, pose, joint, axis, slides))
    return world, found
