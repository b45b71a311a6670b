"""Draws of what varies: by hand, and what they leave as it is."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.evaluation.draws import count_varying, drawn_job
from dualarm_cli.model.dwell import Dwell, TimeRange
from dualarm_cli.model.job import Job
from dualarm_cli.model.part_flow import PoseRange
from tests.packing_tasks import packing_job


def test_a_pose_moves_along_and_turns_about_the_axes_of_its_centre() -> None:
    """By hand: x of the centre is y of the world; a quarter turn about it takes x = 2 to y = 2."""
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, math.pi / 2.0), np.array([1.0, 0.0, 0.0]))
    spread = PoseRange("frame a", turned, 0.01, 0.002, math.pi)
    pose = pin.SE3(np.eye(3), np.array([2.0, 0.0, 0.5]))
    shifted = spread.moved(pose, (1.0, 0.0, -0.5, 0.0))
    assert shifted.translation == pytest.approx([2.0, 0.01, 0.499])
    assert shifted.rotation == pytest.approx(np.eye(3))
    spun = spread.moved(pose, (0.0, 0.0, 0.0, 0.5))
    assert spun.translation == pytest.approx([1.0, 1.0, 0.5])
    assert spun.rotation == pytest.approx(pin.rpy.rpyToMatrix(0.0, 0.0, math.pi / 2.0))


@pytest.fixture
def job(tasks_folder: Path) -> Job:
    """Six tasks: a tray that varies with all picks, each with a range of its own; the first dwell varies."""
    job = packing_job(tasks_folder, 6)
    tray = PoseRange("frame tray", pin.SE3.Identity(), 0.01, 0.0, 0.02)
    cell = replace(job.cell, varying={"tray": (tray,)})
    tasks = []
    for k, task in enumerate(job.tasks):
        pick, place = task.stops
        own = PoseRange(f"{task.id} pick", pick.target.pose, 0.001 * (k % 2), 0.0, 0.0)
        times = (TimeRange(0.1, 0.2, 0.5),) if k == 0 else ()
        pick = replace(pick, ranges=(own, tray), dwell=Dwell(0.2, 0.05), varying=times)
        tasks.append(replace(task, stops=(pick, place)))
    return replace(job, cell=cell, tasks=tuple(tasks))


def test_a_draw_is_within_its_ranges_and_repeats(job: Job) -> None:
    """Parts of one tray keep their places in it, up to their own deviations; places stay."""
    assert count_varying(job) == {"targets": 6, "frames": 1, "dwells": 1}
    seen = []
    for number in range(1, 40):
        drawn = drawn_job(job, 7, number)
        again = drawn_job(job, 7, number)
        tray = None
        for k, (task, before) in enumerate(zip(drawn.tasks, job.tasks, strict=True)):
            pick, nominal = task.stops[0].target.pose, before.stops[0].target.pose
            assert pick == again.tasks[k].stops[0].target.pose
            assert task.stops[1] == before.stops[1]
            moved = pick * nominal.inverse()  # that of the tray, where nothing else varies
            if k % 2 == 0:
                tray = tray or moved
                assert moved.isApprox(tray, 1e-9)
                assert np.abs(moved.translation).max() <= 0.01 + 1e-12
                assert abs(pin.log3(moved.rotation)[2]) <= 0.02 + 1e-12
            else:
                own = tray.inverse() * moved
                assert 0.0 < np.linalg.norm(own.translation) <= 0.001 * math.sqrt(2.0) + 1e-9
        dwell = drawn.tasks[0].stops[0].dwell.total
        assert 0.15 <= dwell <= 0.55
        assert drawn.tasks[1].stops[0].dwell == job.tasks[1].stops[0].dwell
        seen.append((dwell, float(tray.translation[0])))
    assert len(set(seen)) == 39
    assert drawn_job(job, 8, 1).tasks[0].stops[0].dwell.total != seen[0][0]
    assert min(x for _, x in seen) < -0.005 and max(x for _, x in seen) > 0.005


def test_grasps_share_the_deviation_of_their_part(job: Job) -> None:
    """Tools differ by the same transform before and after."""
    task = job.tasks[0]
    lift = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.03]))
    stops = tuple(
        replace(stop, target=replace(stop.target, pose=stop.target.pose * lift))
        for stop in task.stops
    )
    other = replace(task, stops=stops)
    open_job = replace(job, tasks=(replace(task, grasps=(task, other)), *job.tasks[1:]))
    first, second = drawn_job(open_job, 0, 3).tasks[0].grasps
    poses = [grasp.stops[0].target.pose for grasp in (first, second)]
    assert (poses[0].inverse() * poses[1]).isApprox(lift, 1e-9)
    assert first.stops[0].dwell == second.stops[0].dwell
