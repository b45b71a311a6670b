"""Paths of robots with lifts and of arms on slides: followed, verified, and told in the units of each joint."""

from __future__ import annotations

import json
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from dualarm_cli.bound.bound import bound_note
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.cli.run import run
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.asynchronous.free_epochs import FreeEpochs
from dualarm_cli.planning.free_ordered_plan import epoch_notes
from dualarm_cli.planning.planner import plan
from dualarm_cli.verification import verify

PATH = """\
dualarm: tasks/1
cell: cell.yaml
return: true
tasks:
  - {id: a, arm: left, move: {xyz: [0.5, 0.3, 0.8], rpy: [180 deg, 0, 180 deg]}}
  - id: up
    path:
      arm: left
      speed: SPEED
      REDUNDANCY
      through: [{xyz: [0.55, 0.25, 0.75], rpy: [180 deg, 0, 180 deg]}, {xyz: [0.55, 0.25, 0.95]}]
  - {id: b, arm: right, move: {xyz: [0.5, -0.3, 0.85], rpy: [180 deg, 0, 180 deg]}}
"""


def path_job(
    folder: Path,
    sliding_robots: ModuleType,
    platform: dict[str, Any],
    speed: str = "100 mm/s",
    redundancy: str = "slower: allowed",
    **robot: Any,
) -> str:
    """Writes a job of two moves and a straight path of 200 mm upward; returns its file."""
    sliding_robots.write_robot(folder, platform, **robot)
    (folder / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot: robot.yaml\ntools: {left: {tcp: {}}, right: {tcp: {}}}\n"
    )
    tasks = folder / "tasks.yaml"
    tasks.write_text(PATH.replace("SPEED", speed).replace("REDUNDANCY", redundancy))
    return str(tasks)


def test_stages_beside_paths_on_several_joints_are_not_bounded(tmp_path, sliding_robots):
    """The whole body follows the path, lift and waist with it: later stages start from elsewhere, and count as zero."""
    both = {"lift": sliding_robots.LIFT, "waist": None}
    job = load_job(path_job(tmp_path, sliding_robots, both))
    schedule = plan(job, PlanSettings(effort="quick"))
    assert verify(schedule, job, clearance=True).passed
    bound = job_bound(job, "quick")
    assert bound_note("paths_alone") in bound.assumptions
    assert bound.value is not None
    assert 2.0 * (1.0 - 2e-5) <= bound.value <= schedule.duration
    # The path alone: 200 mm at 100 mm/s.
    alone = load_job(path_job(tmp_path, sliding_robots, {"waist": None}))
    assert bound_note("paths_alone") not in job_bound(alone, "quick").assumptions


@pytest.mark.parametrize("own", [False, True])
def test_a_path_of_sliding_joints_tells_their_ways_apart(
    own, tmp_path, sliding_robots, plain_motion, capsys
):
    """Ways of turning joints in rad, of sliding ones in m, against the trajectory; people see deg and mm."""
    slide = sliding_robots.Slide("0 0 1", -0.3, 0.3) if own else None
    tasks = path_job(tmp_path, sliding_robots, {"lift": sliding_robots.LIFT}, joints=6, own=slide)
    out = tmp_path / "out"
    assert run(["plan", tasks, "--out", str(out), "--effort", "quick", "-v"]) == 0
    said = capsys.readouterr().out
    [row] = json.loads((out / "report.json").read_text())["paths"]
    document = json.loads((out / "schedule.json").read_text())
    [segment] = [s for s in document["segments"] if s["kind"] == "path"]
    travel = {True: 0.0, False: 0.0}
    for group, joints in document["robot"]["groups"].items():
        rows = plain_motion.knots(document, group)
        ends = segment["start"] - 1e-9, segment["end"] + 1e-9
        position = np.array([row.position for row in rows if ends[0] <= row.time <= ends[1]])
        for name, way in zip(joints, np.abs(np.diff(position, axis=0)).sum(axis=0), strict=True):
            travel["lift" in name or "slide" in name] += way
    assert row["slide_travel"] == pytest.approx(travel[True], rel=0.02, abs=1e-4)
    assert row["joint_travel"] == pytest.approx(travel[False], rel=0.02)
    assert row["platform_slides"] is True
    assert f"joints travel {np.degrees(row['joint_travel']):.0f} deg and" in said
    assert f"{1e3 * row['slide_travel']:.0f} mm" in said
    unit = "mm" if row["limit_slides"] else "deg"
    assert f"{unit} of its limit" in said


@pytest.mark.slow
def test_a_slide_that_is_too_slow_for_a_path_is_told_in_millimetres(
    tmp_path, sliding_robots, capsys
):
    """The lift alone follows it upward with the arm's joints nearly fixed by tiny speeds: 0.5 m/s are not enough."""
    tasks = path_job(
        tmp_path, sliding_robots, {"lift": sliding_robots.LIFT}, "3 m/s", "redundancy: min_norm"
    )
    urdf = tmp_path / "robot.urdf"
    urdf.write_text(urdf.read_text().replace('velocity="0.5"', 'velocity="0.05"'))
    assert run(["plan", tasks, "--out", str(tmp_path / "out"), "--effort", "quick"]) == 3
    said = capsys.readouterr().err
    assert "joint lift would need" in said
    assert "mm/s" in said


def test_places_where_a_rail_stands_are_told_in_millimetres(tmp_path, sliding_robots):
    """Of asynchronous arms, whose platform stands while they work."""
    job = load_job(path_job(tmp_path, sliding_robots, {"lift": sliding_robots.LIFT}))
    epochs = ((np.array([0.25]), job.tasks[:1]), (np.array([-0.1]), job.tasks[2:]))
    found = FreeEpochs(job, epochs, 3.0)
    [note, *_] = epoch_notes(found, None, rail=True)
    assert "stands at 250 mm for 1 task, then at -100 mm for 1 task;" in note
    [note, *_] = epoch_notes(found, None, rail=False)
    assert "stands at 14 deg for 1 task, then at -6 deg for 1 task;" in note
