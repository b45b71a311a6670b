"""Indexes and plans side by side in Chromium, from disk, with the network off."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import pytest

import dualarm_cli
from dualarm_cli.cli.run import run

WEB = Path(dualarm_cli.__file__).parent / "page" / "web"
CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), ""
)
METHODS = ("fixed", "exact", "linearised")

pytestmark = pytest.mark.slow


def test_rows_lead_to_plans(
    tmp_path: Path, tasks_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two plans on one clock; a row shows its plan beside the fastest, the fastest alone; nothing is loaded."""
    playwright = WEB / "node_modules" / "playwright-core"
    if not playwright.is_dir():
        subprocess.run(["npm", "ci", "--include=dev", "--ignore-scripts"], cwd=WEB, check=True)
    subprocess.run(["npm", "run", "build"], cwd=WEB, check=True)
    monkeypatch.chdir(tmp_path)
    tasks = str(tasks_folder / "03_bottin_planar" / "tasks.yaml")
    methods = [part for name in METHODS for part in ("--method", name)]
    assert run(["compare", "solvers", tasks, *methods, "--page", "--out", "both", "-q"]) == 0
    score = ["score", tasks, "--platform", "fixed", "--no-cache", "--jobs", "1"]
    assert run([*score, "--pages", "scored", "-q"]) == 0
    script = Path(__file__).parent / "indexes_in_browser.mjs"
    files = [Path("both/comparison.html").absolute(), Path("scored/index.html").absolute()]
    command = ["node", script, playwright / "index.mjs", CHROMIUM, *files]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    seen = json.loads(done.stdout)
    (section,) = json.loads(Path("both/comparison.json").read_text())["comparisons"]
    names = [row["method"] for row in section["rows"]]

    def methods_of(frames: list[dict[str, str]]) -> list[str]:
        return [frame["title"].rpartition(": ")[2] for frame in frames]

    assert methods_of(seen["first"]) == names[:2]
    assert [frame["time"] for frame in seen["moved"]] == [0.5, 0.5]
    assert methods_of(seen["third"]) == [names[0], names[2]]
    assert [frame["time"] for frame in seen["third"]] == [0.5, 0.5]
    assert methods_of(seen["alone"]) == names[:1]
    assert seen["marked"] == ["alone", "", ""]
    # Half of the window is as wide as a page needs: it is drawn smaller instead of cut off.
    assert all(frame["width"] >= 960 for frame in seen["first"])
    assert seen["led"].endswith("03_bottin_planar/tasks.yaml")
    assert seen["errors"] == []
    assert [u for u in seen["requests"] if not u.startswith(("file:", "data:", "blob:"))] == []
