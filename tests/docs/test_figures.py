"""Numbers and pictures of the docs against the table that `docs/figures.py` writes, and the table against the tool."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
CHEAP = 3.0
"""Processor time of plans whose tests are not marked slow [s]."""
RESEARCH = ["measurements.md", "papers.md", "methods.md"]
"""Pages whose figures come from the scripts that they name."""
PROSE = re.compile(
    r"^ *```.*?^ *```$|``[^\n]*?``|`[^`\n]*`|<!-- rows: .*?<!-- end -->", re.MULTILINE | re.DOTALL
)


def figures_script() -> ModuleType:
    """Returns `docs/figures.py` as a module."""
    spec = importlib.util.spec_from_file_location("figures", DOCS / "figures.py")
    assert spec is not None
    assert spec.loader is not None
    loaded = importlib.util.module_from_spec(spec)
    sys.modules["figures"] = loaded
    spec.loader.exec_module(loaded)
    return loaded


figures = figures_script()
ROWS = figures.table()


def test_the_table_has_every_plan_and_every_bundled_job() -> None:
    jobs = {path.parent.name for path in (ROOT / "tasks").glob("*/tasks.yaml")}
    assert set(figures.JOBS) == jobs
    assert list(ROWS) == list(figures.PLANS)


@pytest.mark.full_effort
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if row["processor_time"] < CHEAP else pytest.mark.slow)
        for name, row in ROWS.items()
    ],
)
def test_the_table_is_what_the_tool_gives(name: str, tmp_path: Path) -> None:
    (tmp_path / "tasks").symlink_to(ROOT / "tasks", target_is_directory=True)
    assert figures.differences(name, ROWS[name], tmp_path) == []


@pytest.mark.parametrize("page", figures.PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_numbers_of_a_page_are_those_of_the_table(page: Path) -> None:
    """To the digit; and no cycle time of a page for users is without its row."""
    text = page.read_text(encoding="utf-8")
    assert figures.filled(text, ROWS) == text, "python docs/figures.py pages"
    if page.name not in RESEARCH:
        assert re.findall(r"[^\n]*\d\.\d{3} s\b(?!<!-- figure: )[^\n]*", PROSE.sub("", text)) == []


def test_a_wrong_number_is_not_what_is_filled_in() -> None:
    rows = {"job": {"cycle_time": 31.54249, "gap": 0.46512, "clearance": 0.01766}}
    text = "31.542 s<!-- figure: job cycle_time -->, 46.5 %<!-- figure: job gap -->"
    text += ", 18 mm<!-- figure: job clearance -->"
    assert figures.filled(text, rows) == text
    assert figures.filled(text.replace("31.542", "31.543").replace("18", "17"), rows) == text


@pytest.mark.parametrize("picture", sorted(DOCS.rglob("*.png")), ids=lambda path: path.name)
def test_a_picture_shows_what_the_table_has(picture: Path) -> None:
    """Screen pictures are of their job; drawings of a plan in the table carry its row."""
    screen = figures.HERO if picture.stem == "hero" else picture.stem
    name = screen if picture.parent == figures.PICTURES else figures.drawn_row(picture.name)
    with Image.open(picture) as image:
        carried = image.info.get("dualarm")
    if name is not None:
        assert carried is not None, "python docs/figures.py screens"
        assert json.loads(carried) == figures.shown(ROWS[name])


def test_every_measurement_is_of_a_benchmark_and_made() -> None:
    """Each names a module of `benchmarks/`, and has its table below."""
    text = figures.MEASUREMENTS.read_text(encoding="utf-8")
    found = list(figures.MEASURED.finditer(text))
    assert len(found) == text.count("<!-- measured")
    for match in found:
        module = match["words"].split()[0]
        assert (ROOT / f"{module.replace('.', '/')}.py").exists()
        assert "| --- |" in match[0], "python docs/figures.py measurements"
    assert re.search(r"Measured at commit \w{8} on 20\d\d-\d\d-\d\d", text)


def test_every_drawing_has_its_command_on_a_page() -> None:
    assert {figure.name for figure in DOCS.glob("*.png")} == set(figures.DRAWINGS)
    text = "\n".join(page.read_text(encoding="utf-8") for page in figures.PAGES)
    for command, file in figures.DRAWINGS.values():
        asked = re.sub("_(paths|seams)", "", file.split("/")[0])
        option = rf"--(?:plot|out) {re.escape(asked)}"
        assert re.search(rf"^{re.escape(command)}\b.*{option}", text, re.MULTILINE), file
