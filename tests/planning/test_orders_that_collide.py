# ruff: noqa: E501 (a task file, one task a line)
"""Orders that all collide at their stops: the bodies and the tasks are named, not the rules."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan

CELL = """\
dualarm: cell/1
robot:
  left:  {robot: iiwa14, base: {xyz: [0, 0.28, 0]}}
  right: {robot: iiwa14, base: {xyz: [0, -0.28, 0]}}
tools:
  left:  {tcp: {xyz: [0, 0, 150 mm]}}
  right: {tcp: {xyz: [0, 0, 150 mm]}}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
order: optimise
start: free
return: true
tasks:
  - {id: a, arm: left, pick: {xyz: [0.6, -0.03, 0.2], rpy: [180 deg, 0, 0], free: yaw}, place: {xyz: [0.6, 0, 0.2], rpy: [180 deg, 0, 0], free: yaw}}
  - {id: b, arm: right, pick: {xyz: [0.6, 0.03, 0.2], rpy: [180 deg, 0, 0], free: yaw}, place: {xyz: [0.62, 0, 0.2], rpy: [180 deg, 0, 0], free: yaw}}
"""


def test_the_pair_that_collides_and_its_tasks_are_named(tmp_path: Path) -> None:
    """Every target of both arms is within 62 mm of one point, and no arm may stand elsewhere."""
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    job = load_job(tmp_path / "tasks.yaml")
    with pytest.raises(InfeasibleError) as caught:
        plan(job, PlanSettings(effort="quick"))
    text = str(caught.value)
    assert "task 'a'" in text and "task 'b'" in text
    assert "left_link_" in text and "right_link_" in text
    assert "windows" not in text
