"""Random jobs whose tasks come after tasks of the other arm: every plan passes all checks, `after` in time as well."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")
CELLS = {
    "sda10f": "robot: sda10f",
    "iiwas": "robot:\n  left: {robot: iiwa14, base: {xyz: [-0.8, 0, 0]}}\n"
    "  right: {robot: iiwa14, base: {xyz: [0.8, 0, 0], rpy: [0, 0, 180 deg]}}",
}
TOOLS = "\ntools:\n  left: {tcp: {xyz: [0, 0, 0.12]}}\n  right: {tcp: {xyz: [0, 0, 0.12]}}\n"
SAME_TIME = 1e-6
"""Instants nearer than this are one [s]."""


def pose(rng, robot, arm):
    """Returns a target with the tool down where an arm reaches, far from the other one's."""
    side = 1.0 if arm == "left" else -1.0
    if robot == "sda10f":
        x, y = rng.uniform(0.25, 0.5), side * rng.uniform(0.3, 0.6)
        z = rng.uniform(0.75, 0.95)
    else:
        x, y = -side * rng.uniform(0.2, 0.35), rng.uniform(-0.3, 0.3)
        z = rng.uniform(0.15, 0.35)
    return f"{{xyz: [{x:.3f}, {y:.3f}, {z:.3f}], rpy: [180 deg, 0, 0], free: yaw}}"


def random_job(rng, robot, mode):
    """Returns a task file of two to five tasks; each but the first may come after some of those before it."""
    order = str(rng.choice(["given", "given", "optimise"]))
    tasks = []
    for k in range(int(rng.integers(2, 6))):
        arm = str(rng.choice(["left", "right"]))
        after = [f"t{j}" for j in range(k) if rng.random() < 0.45]
        kind = "move" if rng.random() < 0.25 else "carry"
        work = (
            f"move: {pose(rng, robot, arm)}"
            if kind == "move"
            else f"pick: {pose(rng, robot, arm)}, place: {pose(rng, robot, arm)}"
        )
        extra = f"after: [{', '.join(after)}], " if after else ""
        if rng.random() < 0.15:
            extra += f"not_before: {rng.uniform(0.5, 4.0):.2f} s, "
        tasks.append(f"  - {{id: t{k}, arm: {arm}, {extra}{work}}}")
    lines = rng.choice(["80 mm", "30 mm"])
    dwell = rng.choice(["0.1", "0", "{gripper: 0.1 s, settle: 30 ms}"])
    return "\n".join(
        [
            "dualarm: tasks/1",
            "cell: cell.yaml",
            f"mode: {mode}",
            f"order: {order}",
            f"start: {rng.choice(['home', 'free'])}",
            f"return: {rng.choice(['true', 'false'])!s}",
            f"defaults: {{approach: {lines}, retract: {lines}, dwell: {dwell}}}",
            "tasks:",
            *tasks,
            "",
        ]
    )


def begins_and_ends(schedule):
    """Returns when each task begins its first line and when its last dwell and line are over [s], by its id."""
    begins, ends = {}, {}
    for event in schedule.events:
        begins[event.task] = min(event.time, begins.get(event.task, np.inf))
        ends[event.task] = max(event.time + event.dwell, ends.get(event.task, 0.0))
    for part in schedule.segments:
        if part.kind in ("approach", "dwell", "retract"):
            begins[part.task] = min(part.start, begins[part.task])
            ends[part.task] = max(part.end, ends[part.task])
    return begins, ends


def check_job(folder, text, robot, *, check_collisions):
    """Plans a job; returns how often `after` was kept between two arms, None where there is no plan."""
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\n{CELLS[robot]}{TOOLS}")
    (folder / "tasks.yaml").write_text(text)
    job = load_job(folder / "tasks.yaml")
    try:
        schedule = plan_without_bound(job, QUICK, check_collisions=check_collisions)
    except InfeasibleError:
        return None
    checks = (
        verify(schedule, job).checks
        if check_collisions
        else _but_clearance(verify(schedule, job).checks)
    )
    assert [check for check in checks if check.verdict == "failed"] == [], text
    begins, ends = begins_and_ends(schedule)
    arms = {event.task: event.arm for event in schedule.events}
    kept = 0
    for task in job.tasks:
        for name in task.after:
            assert begins[task.id] >= ends[name] - SAME_TIME, (task.id, name, text)
            kept += arms[task.id] != arms[name]
    return kept


def _but_clearance(checks):
    return [check for check in checks if check.name not in ("clearance", "self_collision")]


HEAD = """\
dualarm: tasks/1
cell: cell.yaml
mode: free
SETTINGS
defaults: {approach: 80 mm, retract: 80 mm, dwell: 0.1}
tasks:
"""
A = "{id: a, arm: left, pick: {xyz: [0.45, 0.35, 0.8], DOWN}, place: {xyz: [0.25, 0.55, 0.8], DOWN}}"
B = "{id: b, arm: right, after: [a], pick: {xyz: [0.45, -0.35, 0.8], DOWN}, place: {xyz: [0.25, -0.55, 0.8], DOWN}}"
C = "{id: c, arm: left, after: [b], pick: {xyz: [0.45, 0.3, 0.8], DOWN}, place: {xyz: [0.3, 0.5, 0.8], DOWN}}"
MOVE = "{id: b, arm: right, after: [a], move: {xyz: [0.45, -0.35, 0.8], DOWN}}"


@pytest.mark.parametrize(
    ("settings", "tasks", "waits"),
    [
        ("start: home", [A, B], 1),
        ("start: home\nreturn: true", [A, B, C], 2),
        ("start: free", [A, MOVE], 1),
    ],
)
def test_own_clocks_let_tasks_begin_when_the_last_retract_is_over(tmp_path, settings, tasks, waits):
    """An arm that has nothing to do afterwards; lines beside a turning platform; a bare move that takes no time."""
    rows = "".join(f"  - {row.replace('DOWN', 'rpy: [180 deg, 0, 0]')}\n" for row in tasks)
    text = HEAD.replace("SETTINGS", settings) + rows
    assert check_job(tmp_path, text, "sda10f", check_collisions=True) == waits


@pytest.mark.parametrize(
    ("mode", "robot"),
    [
        ("paired", "sda10f"),
        ("free", "iiwas"),
        pytest.param("free", "sda10f", marks=pytest.mark.slow),
        pytest.param("paired", "iiwas", marks=pytest.mark.slow),
    ],
)
def test_tasks_wait_for_those_before_them(tmp_path, robot, mode):
    """A few random jobs, planned without clearance: targets are far apart."""
    rng = np.random.default_rng(7)
    kept = [
        check_job(tmp_path, random_job(rng, robot, mode), robot, check_collisions=False)
        for _ in range(2)
    ]
    assert None not in kept
    assert sum(kept) > 0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize("robot", CELLS)
@pytest.mark.parametrize("mode", ["free", "paired"])
def test_random_jobs_keep_after(tmp_path, robot, mode, seed):
    """120 random jobs; the arms work far apart, so that each of them has a plan."""
    rng = np.random.default_rng([20, seed])
    assert (
        check_job(tmp_path, random_job(rng, robot, mode), robot, check_collisions=True) is not None
    )
