"""Plans of asynchronous arms are found where nothing but the other arm's idle posture or an arm's own part is near."""

from __future__ import annotations

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan

CELL = """dualarm: cell/1
robot:
  left:  {robot: iiwa7, base: {xyz: [0, 0.6, 0]}}
  right: {robot: iiwa7, base: {xyz: [0, -0.6, 0]}}
"""

BALL = "obstacles: {ball: {sphere: 60 mm, xyz: [0.546, 0.6, 0.486]}}\n"
"""At the left wrist in `home`, where joints 2, 4 and 6 are 30, -90 and 60 degrees."""

TOOL_AT_PART = """tools:
  left: {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 20 mm, length: 60 mm}, xyz: [0, 0, 70 mm]}]}
parts: {cube: {shapes: [{box: [40 mm, 40 mm, 40 mm], xyz: [0, 0, 23 mm]}]}}
clearance: 6 mm
"""
"""The tool ends at its centre point, 3 mm above the cube that it has placed."""

MOVES = """dualarm: tasks/1
cell: cell.yaml
mode: free
start: free
tasks:
  - {id: near, arm: left, move: {xyz: [0.3, 0.9, 0.3], rpy: [180 deg, 0, 0]}}
  - {id: other, arm: right, move: {xyz: [0.5, -0.6, 0.3], rpy: [180 deg, 0, 0]}}
  - {id: last, arm: right, move: {xyz: [0.5, -0.3, 0.3], rpy: [180 deg, 0, 0]}}
"""

PLACE = """dualarm: tasks/1
cell: cell.yaml
mode: free
defaults: {approach: 50 mm, retract: 50 mm, dwell: 0.1, part: cube}
tasks:
  - id: one
    arm: left
    pick: {xyz: [0.5, 0.6, 0.1], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.5, 0.4, 0.1], rpy: [180 deg, 0, 0]}
  - id: two
    arm: left
    pick: {xyz: [0.5, 0.8, 0.1], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.4, 0.4, 0.1], rpy: [180 deg, 0, 0]}
  - {id: other, arm: right, move: {xyz: [0.5, -0.6, 0.3], rpy: [180 deg, 0, 0]}}
"""


@pytest.mark.parametrize(("cell", "tasks"), [(BALL, MOVES), (TOOL_AT_PART, PLACE)])
def test_asynchronous_arms_have_a_plan(tmp_path, cell, tasks):
    """An obstacle where the other arm's `home` would be, and a tool on the retract from what it placed."""
    (tmp_path / "cell.yaml").write_text(CELL + cell)
    (tmp_path / "tasks.yaml").write_text(tasks)
    found = plan(load_job(tmp_path / "tasks.yaml"), PlanSettings(effort="quick"))
    assert any(note.startswith("mode: free: the arms run asynchronously;") for note in found.notes)
