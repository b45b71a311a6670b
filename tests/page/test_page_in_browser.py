"""The page in Chromium, from disk, with the network off: what a reader sees and does."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import dualarm_cli
from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.page.page import page_html
from dualarm_cli.page.side_by_side import side_by_side

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


@dataclass(frozen=True)
class Planned:
    """What `dualarm plan` wrote: the schedule as any reader of JSON has it, and the robot's model from its URDF."""

    page: Path
    schedule: dict[str, Any]
    model: pin.Model


@pytest.fixture
def planned(built: Path, tmp_path: Path) -> Callable[[str], Planned]:
    """Returns what plans bundled jobs as users do."""

    def run(name: str) -> Planned:
        out = tmp_path / name
        command = ["plan", bundled_tasks()[name], "--effort", "quick", "--out", out]
        subprocess.run([sys.executable, "-m", "dualarm_cli", *command], check=True)
        schedule = json.loads((out / "schedule.json").read_text())
        return Planned(
            out / "report.html", schedule, pin.buildModelFromUrdf(str(out / "robot.urdf"))
        )

    return run


def data_of(page: Path) -> dict[str, Any]:
    """Returns the data of a page."""
    found = re.search(r'id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    data: dict[str, Any] = json.loads(found[1])
    return data


def seen_in_browser(playwright: Path, page: Path, times: Sequence[float]) -> dict[str, Any]:
    """Returns what `in_browser.mjs` saw on a page."""
    script = Path(__file__).parent / "in_browser.mjs"
    command = ["node", script, playwright, CHROMIUM, page, json.dumps(list(times))]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@pytest.mark.parametrize("name", JOBS)
def test_the_page_shows_the_plan(
    name: str, built: Path, planned: Callable[[str], Planned], plain_motion: ModuleType
) -> None:
    """Joints are the schedule's, tools are pinocchio's, clicks and keys lead there, and nothing is loaded."""
    plan = planned(name)
    schedule = plan.schedule
    inside = np.random.default_rng(1).uniform(0.0, schedule["duration"], 25)
    knots = schedule["motion"]["left"]["time"][::97]
    seen = seen_in_browser(built, plan.page, [0.0, schedule["duration"], *inside.tolist(), *knots])

    assert seen["errors"] == []
    assert [
        url for url in seen["requests"] if not url.startswith(("file:", "data:", "blob:"))
    ] == []
    for layout in seen["layouts"]:
        assert layout["share"] >= 0.5
        assert layout["scrolled"] <= 0
        assert layout["playBarEnds"] <= 0
    assert seen["higherBy"] == seen["stillHigherBy"] == 16.0
    assert seen["curvesShown"] == [False, True]
    assert seen["linkedTime"] == 0.25
    assert seen["playedAlone"] > 0.2
    for state in seen["states"]:
        expected = plain_motion.positions(schedule, state["time"])
        assert state["joints"] == pytest.approx(expected, abs=1e-9)
        assert_tools_are_pinocchios(state, plan, expected)
    assert 0.2 <= seen["playedTo"] <= 2.0
    assert seen["stands"]
    assert 0.3 * schedule["duration"] < seen["clickedTo"] < 0.8 * schedule["duration"]
    expected = plain_motion.positions(schedule, seen["clickedTo"])
    assert seen["clickedJoints"] == pytest.approx(expected, abs=1e-9)
    assert seen["pictureChanged"]
    assert seen["endsAt"] == schedule["duration"]
    assert seen["rowLedTo"] == pytest.approx(schedule["stages"][1]["start"], abs=1e-12)


def assert_tools_are_pinocchios(
    state: dict[str, Any], plan: Planned, joints: dict[str, float]
) -> None:
    """Asserts that tools are where pinocchio has the tool centre points of robot.urdf at joint positions."""
    model, frames, q = plan.model, plan.model.createData(), pin.neutral(plan.model)
    for joint, value in joints.items():
        q[model.joints[model.getJointId(joint)].idx_q] = value
    pin.framesForwardKinematics(model, frames, q)
    assert set(state["tools"]) == set(plan.schedule["robot"]["arms"])
    base = plan.schedule["robot"]["base"]
    T_world_root = pin.XYZQUATToSE3(np.array([*base["xyz"], *base["quat_xyzw"]]))
    for name, shown in state["tools"].items():
        tcp = T_world_root * frames.oMf[model.getFrameId(f"{name}_tcp", pin.FrameType.BODY)]
        assert np.linalg.norm(tcp.translation - shown) < 1e-6, (name, state["time"])


def test_a_robot_without_solids_is_drawn(built: Path, planned: Callable[[str], Planned]) -> None:
    """By its joints and what joins them."""
    page = planned("05_two_robots").page
    page.write_bytes(page_html(data_of(page) | {"solids": [], "objects": []}))
    seen = seen_in_browser(built, page, [0.0])
    assert seen["errors"] == []
    assert seen["pictureChanged"]


def test_names_with_markup_are_shown_as_text(
    built: Path, planned: Callable[[str], Planned]
) -> None:
    plan = planned("05_two_robots")
    task = plan.schedule["events"][0]["task"]
    text = json.dumps(data_of(plan.page)).replace(json.dumps(task), json.dumps(EVIL))
    plan.page.write_bytes(page_html(json.loads(text) | {"title": EVIL}))
    seen = seen_in_browser(built, plan.page, [0.0])
    assert seen["errors"] == []
    assert seen["evil"] is None
    assert seen["elements"] == 0
    assert seen["text"].count(EVIL) >= 3


def test_two_plans_share_one_time_axis(
    built: Path, planned: Callable[[str], Planned], tmp_path: Path
) -> None:
    """Bars for all segments; the shorter plan ends where its share of the longer one is; a click sets both cursors."""
    names = ("05_two_robots", "13_hand_over")
    plans = [planned(name) for name in names]
    page = tmp_path / "both.html"
    page.write_bytes(side_by_side("both", "", [], [data_of(plan.page) for plan in plans], (0, 1)))
    script = Path(__file__).parent / "both_in_browser.mjs"
    command = ["node", script, built, CHROMIUM, page]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    assert seen["errors"] == []
    durations = [plan.schedule["duration"] for plan in plans]
    assert seen["bars"] == sum(len(plan.schedule["segments"]) for plan in plans)
    narrow = seen["narrow"]
    assert narrow["scrolled"] <= 0
    assert narrow["widths"] == [390.0, 390.0]
    assert narrow["below"] >= 0.0
    (long, short), start = seen["ends"], seen["start"]
    assert (short - start) / (long - start) == pytest.approx(durations[1] / durations[0], abs=1e-6)
    clicked = durations[0] / 2.0
    assert seen["times"] == pytest.approx([clicked, min(clicked, durations[1])], abs=0.05)


def test_the_page_is_quick_without_a_graphics_card(
    built: Path, planned: Callable[[str], Planned]
) -> None:
    """With software rendering; only where the machine has two processors to spare, as times are wall-clock times."""
    seen = seen_in_browser(built, planned("04_packing").page, [0.0])
    busy = os.getloadavg()[0] > (os.cpu_count() or 1) - 2
    slack = 2.0 if busy else 1.0
    assert seen["firstPicture"] < 1.5 * slack
    assert seen["framesPerSecond"] > 30.0 / slack
