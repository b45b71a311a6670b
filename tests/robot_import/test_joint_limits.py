# ruff: noqa: E501 (tables of exact messages, one a line)
"""MoveIt's joint_limits.yaml: what it limits is limited, and what is not taken is told or refused at its line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.robot_import.importing import Imported

Row = Callable[..., str]
Write = Callable[..., Path]
Import = Callable[..., Imported]


def test_positions_narrow_those_of_the_urdf(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """±2.9 rad of the URDF; wider limits of the file do not widen it, and a joint without end gets an end."""
    urdf = write_rows(row("", 0).replace('"joint6" type="revolute"', '"joint6" type="continuous"'))
    found = import_with(
        urdf,
        joint_limits="joint_limits:\n"
        "  joint2: {has_position_limits: true, min_position: -0.5, max_position: 0.25}\n"
        "  joint3: {has_position_limits: true, min_position: -6.2, max_position: 1.0}\n"
        "  joint4: {has_position_limits: false, min_position: -0.1, max_position: 0.1}\n"
        "  joint6: {min_position: -3.0, max_position: 3.0}\n",
    )
    limits = found.loaded.robot.limits
    np.testing.assert_allclose(limits.lower, [-2.9, -0.5, -2.9, -2.9, -2.9, -3.0])
    np.testing.assert_allclose(limits.upper, [2.9, 0.25, 1.0, 2.9, 2.9, 3.0])
    wider = "joint_limits.yaml allows larger positions than the URDF, whose limits hold: joint3"
    assert wider in found.reasons
    home = found.loaded.robot.postures["home"]
    assert ((limits.lower <= home) & (home <= limits.upper)).all()


def test_soft_limits_narrow_positions_and_are_told(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """±2.9 rad in the URDF, ±2 rad its soft limits of joint1; the proposed home is within the narrower range."""
    soft = '<safety_controller k_velocity="1" soft_lower_limit="-2" soft_upper_limit="2"/><limit'
    found = import_with(
        write_rows(row("", 0).replace("<limit", soft, 1)),
        joint_limits="joint_limits:\n"
        "  joint1: {has_soft_limits: true, soft_lower_limit: -1, soft_upper_limit: 2.5, k_position: 20}\n"
        "  joint2: {soft_lower_limit: 0.5, soft_upper_limit: 1}\n"
        "  joint3: {has_soft_limits: false, soft_lower_limit: 0.5, soft_upper_limit: 1}\n",
    )
    robot = found.loaded.robot
    np.testing.assert_allclose(robot.limits.lower, [-1, 0.5, -2.9, -2.9, -2.9, -2.9])
    np.testing.assert_allclose(robot.limits.upper, [2, 1, 2.9, 2.9, 2.9, 2.9])
    home = robot.postures["home"]
    assert ((robot.limits.lower <= home) & (home <= robot.limits.upper)).all()
    told = "position limits are narrowed by soft limits of the URDF: joint1, joint2"
    assert told in found.reasons
    assert told in found.loaded.notes


def test_stated_accelerations_are_not_called_assumed(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """Those of joint_limits.yaml and of the URDF; only what follows from a rule is assumed."""
    stated = '<limit acceleration="5" jerk="50"'
    found = import_with(
        write_rows(row("", 0).replace("<limit", stated, 1)),
        joint_limits="joint_limits:\n"
        "  joint2: {max_acceleration: 4, max_jerk: 40}\n"
        "  joint3: {max_acceleration: 4}\n",
    )
    limits = found.loaded.robot.limits
    three = ("urdf", "joint_limits", "joint_limits, jerk assumed")
    assert limits.source == (*three, "assumed", "assumed", "assumed")
    assert (limits.assumed("acceleration"), limits.assumed("jerk")) == ([3, 4, 5], [2, 3, 4, 5])


def test_the_smaller_of_acceleration_and_deceleration_is_taken(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    """Decelerations are negative in files of Pilz' planner."""
    found = import_with(
        write_rows(row("", 0)),
        joint_limits="joint_limits:\n"
        "  joint1: {has_acceleration_limits: true, max_acceleration: 4, has_deceleration_limits: true, max_deceleration: -3}\n"
        "  joint2: {max_acceleration: 4, max_deceleration: -5}\n",
    )
    assert found.loaded.robot.limits.acceleration[:2].tolist() == [3.0, 4.0]


def test_scaling_factors_of_motions_are_told(
    row: Row, write_rows: Write, import_with: Import
) -> None:
    found = import_with(
        write_rows(row("", 0)),
        joint_limits="default_velocity_scaling_factor: 0.1\n"
        "default_acceleration_scaling_factor: 0.1\n"
        "joint_limits:\n  joint1: {max_velocity: 0.5}\n  joint2: {max_velocity: 2.5}\n",
    )
    told = "\n".join(found.reasons)
    assert "joint_limits.yaml:1: default_velocity_scaling_factor is not taken" in told
    assert "joint_limits.yaml:2: default_acceleration_scaling_factor is not taken" in told
    assert "allows larger velocities than the URDF, whose limits hold: joint2" in told
    assert found.loaded.robot.limits.velocity.tolist() == [0.5, 2, 2, 2, 2, 2]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("  jiont1: {max_velocity: 1}", "2:3: E300 the URDF has no joint 'jiont1', did you mean 'joint1'"),
        ('  joint1: {max_velocity: "1.0"}', "2:26: E200 max_velocity must be a number above 0, not '1.0'; take its quotes away"),
        ("  joint1: {max_velocity: true}", "2:26: E200 max_velocity must be a number above 0, not true"),
        ("  joint1: {max_velocity: -1}", "2:26: E200 max_velocity must be above 0, not -1"),
        ("  joint1: {has_velocity_limits: true}", "2:3: E202 max_velocity is missing; give a number above 0"),
        ("  joint1: {has_velocity_limits: 1, max_velocity: 1}", "2:33: E200 must be true or false, not 1"),
        ("  joint1: {soft_lower_limit: 0}", "2:3: E202 soft_upper_limit is missing; give a number"),
        ("  joint1: {soft_lower_limit: 1, soft_upper_limit: 1}", "2:30: E300 no position of 'joint1' is within 1 to 1 and within the URDF's -2.9 to 2.9"),
        ("  joint1: {min_position: 0}", "2:3: E202 max_position is missing; give a number"),
        ("  joint1: {min_position: 3, max_position: 4}", "2:26: E300 no position of 'joint1' is within 3 to 4 and within the URDF's -2.9 to 2.9"),
        ("  joint1: {max_vel: 1}", "2:12: E201 unknown key 'max_vel'"),
        ("  joint1: 3", "2:11: E200 must be a mapping, not 3"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_at_its_line(
    text: str, message: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    with pytest.raises(InputError) as refused:
        import_with(write_rows(row("", 0)), joint_limits=f"joint_limits:\n{text}\n")
    assert f"joint_limits.yaml:{message}" in str(refused.value)


@pytest.mark.parametrize("text", ["- a\n- b\n", "\n", "limits: {}\n"])
def test_other_files_are_refused(
    text: str, row: Row, write_rows: Write, import_with: Import
) -> None:
    with pytest.raises(InputError, match=r"joint_limits\.yaml: .*joint_limits"):
        import_with(write_rows(row("", 0)), joint_limits=text)
