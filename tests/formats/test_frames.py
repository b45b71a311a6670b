"""Frames of links: trees of joints that turn and slide about any axes, compared with pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.formats.markers import link_frames
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.schedule import ScheduleRobot


def urdf(rng, count):
    """Returns a random tree: each link hangs on an earlier one by a joint that turns, slides or is fixed."""
    parts, moving = ['<robot name="tree"><link name="world"/>'], []
    for k in range(count):
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        kind = ("revolute", "prismatic", "fixed")[k % 3]
        parent = "world" if k == 0 else f"l{rng.integers(0, k)}"
        words = " ".join(repr(float(x)) for x in axis)
        xyz, rpy = (" ".join(repr(float(x)) for x in rng.normal(size=3)) for _ in range(2))
        parts.append(
            f'<link name="l{k}"/><joint name="j{k}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="l{k}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{words}"/>'
            '<limit lower="-3" upper="3" velocity="1" effort="0"/></joint>'
        )
        moving += [] if kind == "fixed" else [f"j{k}"]
    return "".join(parts) + "</robot>", tuple(moving)


@pytest.mark.parametrize("seed", range(8))
def test_chained_frames_are_pinocchios(seed):
    """A root link called world gets a fixed frame of another name."""
    rng = np.random.default_rng(seed)
    text, joints = urdf(rng, 9)
    base = pin.SE3.Random()
    free = np.full(len(joints), np.inf)
    limits = JointLimits(joints, -free, free, free, free, free, ("unstated",) * len(joints))
    world, frames = link_frames(ScheduleRobot("tree", text, base, {}, limits))
    assert world == "cell"
    model = pin.buildModelFromXML(text)
    data = model.createData()
    values = dict(zip(joints, rng.uniform(-3, 3, len(joints)), strict=True))
    q = np.zeros(model.nq)
    for name, value in values.items():
        q[model.idx_qs[model.getJointId(name)]] = value
    pin.framesForwardKinematics(model, data, q)
    poses = {world: pin.SE3.Identity()}
    for frame in frames:  # parents first
        positions = np.array([0.0, values.get(frame.joint, 0.0)])
        translations, quaternions = frame.poses(positions)
        turn = pin.Quaternion(quaternions[1])
        assert turn.norm() == pytest.approx(1.0, abs=1e-12)
        poses[frame.name] = poses[frame.parent] * pin.SE3(turn.matrix(), translations[1])
    assert len(frames) == 10
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            expected = base * data.oMf[model.getFrameId(frame.name, pin.FrameType.BODY)]
            np.testing.assert_allclose(
                poses[frame.name].homogeneous, expected.homogeneous, atol=1e-12
            )
