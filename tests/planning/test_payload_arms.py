"""Which arm takes a heavy part, in a cell with a strong and a weak arm."""

from __future__ import annotations

from pathlib import Path

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

ROBOT = Path(__file__).parents[2] / "robots/iiwa14"
CELL = """\
dualarm: cell/1
robot:
  left: {robot: weak/robot.yaml, base: {xyz: [-680 mm, 0, 0]}}
  right: {robot: iiwa14, base: {xyz: [680 mm, 0, 0], rpy: [0, 0, 180 deg]}}
tools:
  left: {tcp: {xyz: [0, 0, 150 mm]}, mass: 1 kg}
  right: {tcp: {xyz: [0, 0, 150 mm]}, mass: 1 kg}
parts:
  casting: {mass: 14 kg, shapes: [{sphere: {radius: 10 mm}, xyz: [0, 0, 20 mm]}]}
  cover: {mass: 500 g, shapes: [{sphere: {radius: 10 mm}, xyz: [0, 0, 20 mm]}]}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: free
order: given
defaults: {approach: 50 mm, retract: 50 mm, dwell: 0.2 s}
tasks:
  - id: casting
    arm: any
    part: casting
    pick: {xyz: [-0.02, -0.25, 0.25], rpy: [180 deg, 0, 0], free: yaw}
    place: {xyz: [-0.02, -0.12, 0.25], rpy: [180 deg, 0, 0], free: yaw}
  - id: cover
    arm: any
    part: cover
    pick: {xyz: [0.02, 0.25, 0.25], rpy: [180 deg, 0, 0], free: yaw}
    place: {xyz: [0.02, 0.12, 0.25], rpy: [180 deg, 0, 0], free: yaw}
"""


def test_the_heavy_part_goes_to_the_arm_that_bears_it(tmp_path):
    """The casting is nearer to the left arm, whose motors give 40 %: 15 kg at 0.6 m and the arm need 150 of 128 N m."""
    weak = tmp_path / "weak"
    weak.mkdir()
    for file in ("iiwa14.urdf", "robot.yaml"):
        (weak / file).write_text((ROBOT / file).read_text())
    with (weak / "robot.yaml").open("a") as file:
        file.write("torques: {default: {derating: 40 %}}\n")
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    job = load_job(tmp_path / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    arms = {event.task: event.arm for event in schedule.events}
    assert arms == {"casting": "right", "cover": "left"}
    assert verify(schedule, job, clearance=True).failures == ()
