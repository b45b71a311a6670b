"""Jobs whose sections are blended: a path depends on how the stops before it end."""

from __future__ import annotations

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [0, 0, 120 mm]}}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
defaults: {approach: 80 mm, retract: 80 mm, dwell: 0.15}
tasks:
  - id: first
    arm: left
    path:
      speed: 150 mm/s
      slower: allowed
      through:
        - {xyz: [0.441, 0.314, 0.912], rpy: [180 deg, 0, 0]}
        - {xyz: [0.406, 0.344, 0.912]}
  - id: between
    arm: left
    pick: {xyz: [0.423, 0.219, 0.915], rpy: [180 deg, 0, -49 deg]}
    place: {xyz: [0.504, 0.391, 0.796], rpy: [180 deg, 0, -53 deg]}
  - id: second
    arm: left
    path:
      speed: 150 mm/s
      slower: allowed
      through:
        - {xyz: [0.465, 0.317, 0.885], rpy: [180 deg, 0, 0]}
        - {xyz: [0.478, 0.347, 0.885]}
"""


@pytest.mark.full_effort
def test_sections_are_not_slower_blended_than_with_stops(tmp_path):
    """Postures for passing lines' ends were quicker up to the second path, which began far from them."""
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    job = load_job(tmp_path / "tasks.yaml")
    blended, stopping = (
        plan_without_bound(job, PlanSettings(effort="quick", blend=blend))
        for blend in ("lines", "none")
    )
    assert verify(blended, job).passed
    assert blended.duration <= stopping.duration
    # What is gained counts from stops at the same postures.
    assert blended.blend_gain > 0.0
