# ruff: noqa: E501 (a table, one case a line)
"""Targets that name a posture of the robot: its joint positions of the arm, by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import JointTarget

Messages = Callable[[Callable[[], object]], list[str]]


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("move: bent", [-1.5, 0.0]),
        ("move: {posture: bent}", [-1.5, 0.0]),
        ("move: home", [0.0, 0.0]),
        ("pick: {posture: bent}\n    place: {xyz: [0.2, -0.5, 0.8]}", [-1.5, 0.0]),
    ],
)
def test_a_posture_stands_for_the_arms_joint_positions(
    target: str, expected: list[float], project: Path, change: Callable[..., None]
) -> None:
    """The tiny robot's posture: l1 at 90 deg, r1 at -1.5 rad, everything else at 0."""
    change("tasks.yaml", "move: {joints: [0.5, -90 deg]}", target)
    stop = load_job("tasks.yaml").tasks[1].stops[0]
    assert isinstance(stop.target, JointTarget)
    assert stop.target.configurations.tolist() == [expected]
    change("tasks.yaml", "arm: right", "arm: left")
    stop = load_job("tasks.yaml").tasks[1].stops[0]
    assert isinstance(stop.target, JointTarget)
    left = [math.pi / 2 if expected[0] else 0.0, 0.0]
    assert stop.target.configurations.tolist() == [left]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("{joints: [0.5, -90 deg]}", "hom", "14:11: E300 Tiny has no posture 'hom', did you mean 'home'? Choose one of: home, bent"),
        ("{joints: [0.5, -90 deg]}", "{posture: hom}", "14:21: E300 Tiny has no posture 'hom', did you mean 'home'? Choose one of: home, bent"),
        ("{joints: [0.5, -90 deg]}", "{posture: home, joints: [0, 0]}", "14:12: E200 'posture' does not go with 'joints'; keep one"),
        ("{joints: [0.5, -90 deg]}", "{posture: home, free: yaw}", "14:27: E200 'free' does not go with 'posture'; keep one"),
        ("{joints: [0.5, -90 deg]}", "[0, 0]", "14:11: E200 'move' must be a mapping, such as {key: value}, not a list of 2"),
        ("arm: right\n    move: {joints: [0.5, -90 deg]}", "arm: any\n    move: home", "14:11: E300 joint configurations belong to one arm; use arm: left or right, or give a pose"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_posture_is_told_at_its_place(
    old: str,
    new: str,
    expected: str,
    project: Path,
    change: Callable[..., None],
    messages: Messages,
) -> None:
    change("tasks.yaml", old, new)
    assert messages(lambda: load_job("tasks.yaml")) == [f"tasks.yaml:{expected}"]
