"""How large and how quick the pages of plans are.

python -m benchmarks.speed.page TASKS...

For each task file: processor time of planning (with verification) and of writing the page, the page's size, the time
until the browser has drawn the first picture, and the pictures per second while the cursor of time moves. The browser
is Chromium with software rendering, on two processors; its figures go to standard error. It needs the page's packages:
`cd dualarm_cli/page/web && npm ci --include=dev --ignore-scripts && npm run build`, and is left out without them.
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

from benchmarks.tables import print_head, print_row, tell
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
    print_head("job", "stages", "planned in", "page written in", "size")
    for tasks in parser.parse_args().tasks:
        with tempfile.TemporaryDirectory() as folder:
            page = Path(folder) / "report.html"
            row = page_of(tasks, page)
            if PLAYWRIGHT.exists():
                speed = speed_of(page).items()
                tell(", ".join(f"{name} {value:.3g}" for name, value in speed))
            else:
                tell(f"without the browser: {PLAYWRIGHT} is missing")
        times = f"{row['planning']:.1f} s", f"{row['page']:.2f} s"
        size = f"{row['megabytes']:.1f} MB"
        print_row(f"`{tasks.parent.name}`", f"{row['stages']:.0f}", *times, size)


if __name__ == "__main__":
    main()
