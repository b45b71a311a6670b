"""Two arms whose only pairing of stops collides: one waits for the other one."""

from __future__ import annotations

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 25 mm, length: 80 mm}, xyz: [0, 0, 55 mm]}]}
  right: {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 25 mm, length: 80 mm}, xyz: [0, 0, 55 mm]}]}
clearance: 5 mm
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
order: optimise
start: free
defaults: {approach: 60 mm, retract: 60 mm}
tasks:
  - {id: a, arm: left, pick: {xyz: [0.55, 0.4, 0.78], rpy: [180 deg, 0, 0]},
     place: {xyz: [0.6, 0.03, 0.78], rpy: [180 deg, 0, 0]}}
  - {id: b, arm: right, pick: {xyz: [0.5, -0.45, 0.78], rpy: [180 deg, 0, 0]},
     place: {xyz: [0.6, -0.02, 0.78], rpy: [180 deg, 0, 0]}}
"""


def test_tools_that_have_no_room_side_by_side_take_turns(tmp_path):
    """Both places 50 mm apart, tools of 50 mm: refused where only the k-th stops of both arms were tried together."""
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick", blend="none"))
    assert verify(schedule, job).failures == ()
    places = [event.time for event in schedule.events if event.action == "place"]
    assert abs(places[1] - places[0]) > 0.3
    assert not any("all orders of 2 tasks" in note for note in schedule.notes)
