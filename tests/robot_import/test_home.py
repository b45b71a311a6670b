"""Posture home of an import: tools down by their own axis, mirrored where the arms mirror, in front."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinematics.cell_model import general_arms
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note
from dualarm_cli.robot_import.contacts import bare_cell
from dualarm_cli.robot_import.home import Rating, propose_home
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
    assert not isinstance(home, Note)
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
    assert not isinstance(home, Note)
    for pose in tools(robot, home, np.eye(3)).values():
        assert np.degrees(np.arccos(-pose.rotation[2, 2])) < 0.2


def test_the_turn_nearest_to_zero_is_preferred(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """A joint at -1.2 rad and a whole turn beyond it, which is nearer to the middle of the range."""
    arm = row("", 0.0).replace('lower="-2.9" upper="2.9"', 'lower="-2" upper="6.28"', 1)
    robot = import_with(write_rows(arm)).loaded.robot
    numeric = general_arms(bare_cell(robot))["left"]
    rating = Rating(robot, "left", numeric, pin.SE3.Identity(), pin.SE3.Identity())
    near, far = np.array(
        [[-1.2, 0.5, 0.5, 0.5, 0.5, 0.5], [-1.2 + 2.0 * np.pi, 0.5, 0.5, 0.5, 0.5, 0.5]]
    )
    np.testing.assert_allclose(numeric.forward(near)[1], numeric.forward(far)[1], atol=1e-9)
    scores = rating.scores(np.array([near, far]))
    assert scores[0] > scores[1]


@pytest.mark.parametrize(("roll", "raised"), [(0.0, 0.0), (-np.pi / 2, 0.3 * np.sin(1.0))])
def test_elbows_above_level_shoulders_count(
    roll: float, raised: float, row: Row, write_rows: Write, import_with: Import
) -> None:
    """The upper arm is 0.3 m long and 1 rad above the level shoulder axis; an arm that stands has none to count."""
    arm = row("", 0.0).replace('xyz="0 0.0 0.2"', f'xyz="0 0.0 0.8" rpy="{roll} 0 0"')
    robot = import_with(write_rows(arm)).loaded.robot
    numeric = general_arms(bare_cell(robot))["left"]
    rating = Rating(robot, "left", numeric, pin.SE3.Identity(), pin.SE3.Identity())
    # About its own level axis the arm turns by 90 degrees, so that the second axis lifts the upper arm.
    up, down = (np.array([[np.pi / 2, sign, -sign, 0.0, 0.0, 0.0]]) for sign in (1.0, -1.0))
    heights = [rating.raised(q, 0.8)[0] for q in (up, down)]
    np.testing.assert_allclose(sorted(heights), [0.0, raised], atol=1e-9)


@pytest.mark.parametrize(
    ("limit", "why"),
    [
        (0.3, "no posture within the joint limits was found that turns the tool straight down"),
        (2.9, "every posture tried with tools down collides"),
    ],
)
def test_the_reason_for_no_home_is_told(
    limit: float,
    why: str,
    row: Row,
    write_rows: Write,
    import_with: Import,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Three joints of 0.3 rad cannot turn an upright arm over; or all postures are said to touch."""
    monkeypatch.setattr(
        "dualarm_cli.robot_import.home.touches", lambda _, q, arms: np.ones(len(q), dtype=bool)
    )
    arm = row("", 0.0).replace('"-2.9" upper="2.9"', f'"{-limit}" upper="{limit}"')
    found = import_with(write_rows(arm))
    assert not found.loaded.robot.postures["home"].any()
    sentence = f"not proposed: {why}; its joints are at 0 or nearest to it; write it under "
    assert any(reason.startswith(f"posture home: {sentence}") for reason in found.reasons)
    assert f"  # {sentence}" in found.files["robot.yaml"].decode()
