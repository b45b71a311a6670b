"""Plans of further kinds of jobs go round a part that was placed before."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

CUBE, TOWER = 0.11, 0.31
"""Heights of the tool centre point over the table when a cube or tower stands on it [m]."""
START, MIDDLE, END = (0.45, 0.10), (0.52, 0.30), (0.45, 0.50)
"""Where a cube is picked, where the tower lies, and where the cube is placed [m]."""
QUICK = PlanSettings(effort="quick", blend="none").naming(platform="fixed")


def in_a_buffer(task: str) -> str:
    """Both stops at the tower's place are of one buffer."""
    x, y = MIDDLE
    pose = f"xyz: [{x}, {y}, 0.7900], rpy: [180 deg, 0, 0]"
    return task.replace(pose, f"{pose}, buffer: shelf")


@pytest.mark.parametrize("kind", ["free", "buffer", "sections"])
def test_a_part_goes_round_the_one_that_was_placed(job_of, task, kind):
    """The straight way of the cube is through the tower; one that knows nothing of parts fails the verifier."""
    tower = task("tower", (0.70, 0.30, TOWER), (*MIDDLE, TOWER), ", part: tower")
    cube = task("cube", (*START, CUBE), (*END, CUBE))
    tasks, head = [tower, cube], ""
    if kind == "free":
        head = "mode: free"
    elif kind == "buffer":
        take = task("take", (*MIDDLE, TOWER), (0.70, 0.30, TOWER), ", part: tower")
        tasks = [in_a_buffer(tower), cube, in_a_buffer(take)]
        head = "buffers: {shelf: {capacity: 1}}"
    else:
        through = "[{xyz: [0.6, 0.1, 0.85], rpy: [180 deg, 0, 0]}, {xyz: [0.6, 0.05, 0.85]}]"
        tasks.insert(1, f"{{id: path, arm: left, path: {{speed: 0.1, through: {through}}}}}")
    job = job_of(*tasks, head=head)
    made = plan_without_bound(job, QUICK)
    assert verify(made, job, clearance=True).passed
    blind = replace(
        job, cell=replace(job.cell, parts={}), tasks=tuple(replace(t, part="") for t in job.tasks)
    )
    verdict = verify(plan_without_bound(blind, QUICK), job, clearance=True)
    worst = min(verdict.clearances, key=lambda one: one.margin)
    assert worst.bodies[1] == "tower of tower"
    assert worst.margin < -0.01
