"""`dualarm compare schedules A B --page`: both pages whole in one file, what differs marked."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.page.page import page_html
from dualarm_cli.page.side_by_side import ComparedStage, side_by_side

EVIL = "</script><img src=x onerror=alert(1)>"


def stage(difference: float) -> ComparedStage:
    return ComparedStage(("1", "2"), (0.0, 0.5), EVIL, ("1.000", "2.000"), difference, EVIL)


def test_both_pages_are_in_it_as_they_are_and_names_stay_text(built: Path) -> None:
    pages = (page_html({"title": EVIL}), page_html({"title": "b"}))
    both = side_by_side(pages, EVIL, EVIL, [stage(1.0)]).decode()
    (text,) = re.findall(r'id="pages">(.*?)</script>', both, re.DOTALL)
    assert json.loads(text) == [page.decode() for page in pages]
    assert "<img" not in both
    assert f"<td>{html.escape(EVIL)}</td>" in both


@pytest.mark.parametrize(
    ("difference", "mark", "text"),
    [(0.25, "slower", "+0.250"), (-0.25, "faster", "−0.250"), (0.0004, "", "0.000")],
)
def test_stages_that_differ_are_marked(
    difference: float, mark: str, text: str, built: Path
) -> None:
    pages = (page_html({"title": "a"}), page_html({"title": "b"}))
    both = side_by_side(pages, "t", "s", [stage(difference)]).decode()
    assert f'<td class="{mark}">{text}</td>' in both
    assert 'data-a="0.0" data-b="0.5"' in both


def test_the_command_writes_it_beside_the_table(
    tmp_path: Path,
    built: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """One plan with another platform method: each has its own page in the file."""
    monkeypatch.chdir(tmp_path)
    plan = ["plan", "01_first_pick", "--effort", "quick", "--no-page", "--quiet"]
    assert run([*plan, "--out", "a"]) == 0
    assert run([*plan, "--out", "b", "--platform", "fixed"]) == 0
    assert run(["compare", "schedules", "a", "b", "--page"]) == 2
    assert "name its folder with --out" in capsys.readouterr().err
    assert run(["compare", "schedules", "a", "b", "--page", "--out", "both", "--quiet"]) == 0
    text = Path("both/schedules.html").read_text()
    (pages,) = re.findall(r'id="pages">(.*?)</script>', text, re.DOTALL)
    found = []
    for page in json.loads(pages):
        (data,) = re.findall(r'id="data">(.*?)</script>', page, re.DOTALL)
        found.append(json.loads(data)["duration"])
    document = json.loads(Path("both/schedules.json").read_text())
    assert found == [document[side]["duration"] for side in ("a", "b")]
    assert text.count("<tr data-a=") == len(document["stages"])
