"""How large and how quick the pages of plans are.

python -m benchmarks.speed.page TASKS...

For each task file: processor time of planning (with verification) and of writing the page, the page's size, the time
until the browser has drawn the first picture, and the pictures per second while the cursor of time moves. The browser
is Chromium with software rendering, on two processors. It needs the page's packages:
`cd dualarm_cli/page/web && npm ci --include=dev --ignore-scripts && npm run build`.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.page.page import page_html
from dualarm_cli.page.page_data import page_data
from dualarm_cli.planning.planner import plan
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify

PLAYWRIGHT = Path("dualarm_cli/page/web/node_modules/playwright-core/index.mjs")
PROCESSORS = 2


def page_of(tasks: Path, page: Path) -> dict[str, float]:
    """Plans a job, writes its page, and returns the processor times [s] and the page's size [MB]."""
    job = load_job(tasks)
    start = time.process_time()
    schedule = plan(job, PlanSettings(effort="quick"))
    schedule = replace(schedule, verification=verify(schedule, job, clearance=True))
    report = build_report(schedule, job)
    planned = time.process_time()
    page.write_bytes(page_html(page_data(schedule, job, report)))
    written = time.process_time()
    return {
        "stages": len(schedule.stages),
        "planning": planned - start,
        "page": written - planned,
        "megabytes": page.stat().st_size / 1e6,
    }


def speed_of(page: Path) -> dict[str, Any]:
    """Returns what `page_speed.mjs` measured."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))))
    script = Path(__file__).with_name("page_speed.mjs")
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:PROCESSORS])
    command = ["node", script, Path.cwd() / PLAYWRIGHT, browser, page]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def main() -> None:
    """Prints a row per job."""
    parser = argparse.ArgumentParser()
    parser.add_argument("tasks", type=Path, nargs="+")
    for tasks in parser.parse_args().tasks:
        with tempfile.TemporaryDirectory() as folder:
            page = Path(folder) / "report.html"
            row = page_of(tasks, page) | speed_of(page)
        figures = ", ".join(f"{name} {value:.3g}" for name, value in row.items())
        print(f"{tasks.parent.name}: {figures}, load of the machine {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
