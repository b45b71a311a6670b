"""Posture home of an import: tools down by their own axis, mirrored where the arms mirror, in front."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.robot import Robot
from dualarm_cli.robot_import.home import propose_home
from dualarm_cli.robot_import.importing import Imported

Row = Callable[..., str]
Write = Callable[..., Path]
Import = Callable[..., Imported]
TURNS = {
    "+z": np.eye(3),
    "-z": np.diag([1.0, -1.0, -1.0]),
    "+x": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
}
"""Rotations of a tool whose z axis points along an axis of the flange."""


def tools(robot: Robot, home: np.ndarray, turn: np.ndarray) -> dict[str, pin.SE3]:
    """Returns the tool poses of all arms, by pinocchio."""
    model = pin.buildModelFromXML(robot.urdf)
    data, q = model.createData(), pin.neutral(model)
    for name, value in zip(robot.joints, home, strict=True):
        q[model.idx_qs[model.getJointId(name)]] = value
    pin.framesForwardKinematics(model, data, q)
    tcp = pin.SE3(turn, 0.1 * turn[:, 2])
    return {arm.name: data.oMf[model.getFrameId(arm.flange)] * tcp for arm in robot.arms}


@pytest.mark.parametrize("axis", TURNS)
def test_tools_point_down_by_their_own_axis(
    axis: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    """Also where the tool is on the other side of the flange, or off to its side; mirrored to 1 mm, in front.

    The arms of these rows mirror in the plane y = 0: their joints about z and those about y turn in opposite and in
    the same directions.
    """
    robot = import_with(write_rows(row("left_", 0.3), row("right_", -0.3))).loaded.robot
    turn = TURNS[axis]
    tcp = pin.SE3(turn, 0.1 * turn[:, 2])
    home = propose_home(robot, {"left": tcp, "right": tcp}, 0)
    assert home is not None
    left, right = tools(robot, home, turn).values()
    for pose in (left, right):
        angle = np.degrees(np.arccos(-pose.rotation[2, 2]))
        assert angle < 0.2
        assert pose.translation[0] > 0.1
    assert left.translation[1] > 0.0
    if axis != "+x":
        np.testing.assert_allclose(left.translation * (1, -1, 1), right.translation, atol=1e-3)
        columns = [robot.columns(arm.joints) for arm in robot.arms]
        np.testing.assert_allclose(home[columns[1]], home[columns[0]] * (-1, 1, 1, -1, 1, -1))


def test_arms_that_do_not_mirror_have_tools_down(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """The right arm stands 100 mm higher than the left one."""
    right = row("right_", -0.3).replace('xyz="0 -0.3 0.2"', 'xyz="0 -0.3 0.3"')
    robot = import_with(write_rows(row("left_", 0.3), right)).loaded.robot
    tcp = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.1]))
    home = propose_home(robot, {"left": tcp, "right": tcp}, 0)
    assert home is not None
    for pose in tools(robot, home, np.eye(3)).values():
        assert np.degrees(np.arccos(-pose.rotation[2, 2])) < 0.2
