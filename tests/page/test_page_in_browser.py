"""The page in Chromium, from disk, with the network off: what a reader sees and does."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import dualarm_cli
from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.page.page import page_html
from dualarm_cli.page.page_data import page_data
from dualarm_cli.plan.planner import plan
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify

WEB = Path(dualarm_cli.__file__).parent / "page" / "web"
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
EVIL = """<img src=x onerror="window.evil=1">'</script><script>window.evil=1</script>"""
JOBS = (
    "04_packing",
    "05_two_robots",
    "10_seam",
    "13_hand_over",
    "14_two_grippers",
    "15_conveyor",
)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def built() -> Path:
    """Builds the page with its tools, and returns the folder of Playwright."""
    playwright = WEB / "node_modules" / "playwright-core"
    if not playwright.is_dir():
        subprocess.run(["npm", "ci", "--include=dev", "--ignore-scripts"], cwd=WEB, check=True)
    subprocess.run(["npm", "run", "build"], cwd=WEB, check=True)
    return playwright / "index.mjs"


def planned(name: str) -> tuple[Job, Schedule, dict[str, Any]]:
    """Returns a bundled job, its verified plan and the data of its page."""
    job = load_job(bundled_tasks()[name])
    schedule = plan(job, PlanSettings(effort="quick"))
    schedule = replace(schedule, verification=verify(schedule, job, clearance=True))
    return job, schedule, page_data(schedule, job, build_report(schedule, job))


def seen_in_browser(
    playwright: Path, data: Mapping[str, Any], times: np.ndarray, folder: Path
) -> dict[str, Any]:
    """Returns what `in_browser.mjs` saw on the page of some data."""
    page = folder / "report.html"
    page.write_bytes(page_html(data))
    script = Path(__file__).parent / "in_browser.mjs"
    command = ["node", script, playwright, CHROMIUM, page, json.dumps(times.tolist())]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("name", JOBS)
def test_the_page_shows_the_plan(name: str, built: Path, tmp_path: Path) -> None:
    """Joints are the schedule's, tools are pinocchio's, clicks and keys lead there, and nothing is loaded."""
    job, schedule, data = planned(name)
    rng = np.random.default_rng(1)
    inside = rng.uniform(0.0, schedule.duration, 25)
    times = np.concatenate([[0.0, schedule.duration], inside, schedule.trajectory.time[::97]])
    seen = seen_in_browser(built, data, times, tmp_path)

    assert seen["errors"] == []
    assert [
        url for url in seen["requests"] if not url.startswith(("file:", "data:", "blob:"))
    ] == []
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    for state in seen["states"]:
        assert_state_is_the_schedules(state, schedule, model, job)
    assert 0.2 <= seen["playedTo"] <= 2.0
    assert seen["stands"]
    assert 0.3 * schedule.duration < seen["clickedTo"] < 0.8 * schedule.duration
    assert_joints_are_the_schedules(seen["clickedJoints"], seen["clickedTo"], schedule)
    assert seen["pictureChanged"]
    assert seen["endsAt"] == schedule.duration
    assert seen["rowLedTo"] == pytest.approx(schedule.stages[1].start, abs=1e-12)


def assert_joints_are_the_schedules(
    joints: dict[str, float], time: float, schedule: Schedule
) -> None:
    """Asserts that joint positions are those of the schedule."""
    position = schedule.trajectory.at(np.array([time]))[0][0]
    assert set(joints) == set(schedule.robot.limits.joints)
    for joint, value in joints.items():
        expected = position[schedule.trajectory.joints.index(joint)]
        assert value == pytest.approx(expected, abs=1e-9), (joint, time)


def assert_state_is_the_schedules(
    state: dict[str, Any], schedule: Schedule, model: pin.Model, job: Job
) -> None:
    """Asserts that joints and tools are where schedule and pinocchio say."""
    assert_joints_are_the_schedules(state["joints"], state["time"], schedule)
    position = schedule.trajectory.at(np.array([state["time"]]))[0][0]
    q = pin.neutral(model)
    for joint, value in zip(schedule.trajectory.joints, position, strict=True):
        q[model.joints[model.getJointId(joint)].idx_q] = value
    frames = model.createData()
    pin.framesForwardKinematics(model, frames, q)
    assert set(state["tools"]) == set(schedule.robot.arms)
    for name, arm in schedule.robot.arms.items():
        flange = frames.oMf[model.getFrameId(arm.flange, pin.FrameType.BODY)]
        tool = (job.cell.base * flange * arm.tcp).translation
        assert np.linalg.norm(tool - state["tools"][name]) < 1e-6, (name, state["time"])


def test_a_robot_without_solids_is_drawn(built: Path, tmp_path: Path) -> None:
    """By its joints and what joins them."""
    _, _, data = planned("05_two_robots")
    bare = data | {"solids": [], "things": []}
    seen = seen_in_browser(built, bare, np.array([0.0]), tmp_path)
    assert seen["errors"] == []
    assert seen["pictureChanged"]


def test_names_with_markup_are_shown_as_text(built: Path, tmp_path: Path) -> None:
    _, schedule, data = planned("05_two_robots")
    task = schedule.events[0].task
    text = json.dumps(data).replace(json.dumps(task), json.dumps(EVIL))
    seen = seen_in_browser(built, json.loads(text) | {"title": EVIL}, np.array([0.0]), tmp_path)
    assert seen["errors"] == []
    assert seen["evil"] is None
    assert seen["elements"] == 0
    assert seen["text"].count(EVIL) >= 3


def test_the_page_is_quick_without_a_graphics_card(built: Path, tmp_path: Path) -> None:
    """With software rendering; only where the machine has two processors to spare, as times are wall-clock times."""
    _, _, data = planned("04_packing")
    seen = seen_in_browser(built, data, np.array([0.0]), tmp_path)
    busy = os.getloadavg()[0] > (os.cpu_count() or 1) - 2
    slack = 2.0 if busy else 1.0
    assert seen["firstPicture"] < 1.5 * slack
    assert seen["framesPerSecond"] > 30.0 / slack
