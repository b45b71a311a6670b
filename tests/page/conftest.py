"""Plans whose pages are looked at."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.page.page_data import page_data
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify


@dataclass(frozen=True)
class Shown:
    """A plan and the data of its page, as a browser would read them."""

    job: Job
    schedule: Schedule
    data: dict[str, Any]


JOBS = ("01_first_pick", "05_two_robots", "13_hand_over", "14_two_grippers", "15_conveyor")


@pytest.fixture(scope="module", params=JOBS)
def shown(request: pytest.FixtureRequest, quick_plan: Callable[[str], Schedule]) -> Shown:
    """Returns plans with a platform, two robots, a hand-over, tool changes and a conveyor."""
    job = load_job(bundled_tasks()[request.param])
    schedule = quick_plan(request.param)
    schedule = replace(schedule, verification=verify(schedule, job, clearance=True))
    data = page_data(schedule, job, build_report(schedule, job))
    return Shown(job, schedule, json.loads(json.dumps(data, allow_nan=False)))


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Puts small files in place of the page's own code."""
    folder = tmp_path / "built"
    folder.mkdir()
    (folder / "page.js").write_text("const built = 1;")
    (folder / "page.css").write_text("body { margin: 0 }")
    monkeypatch.setattr("dualarm_cli.page.page.built_folder", lambda: folder)
    return folder
