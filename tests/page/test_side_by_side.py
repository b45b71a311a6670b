"""`dualarm compare --page`: plans whole in one file, beside each other; what differs marked."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.page.page import page_html
from dualarm_cli.page.side_by_side import ComparedStage, side_by_side, stages_table

EVIL = "</script><img src=x onerror=alert(1)>"


def stage(difference: float) -> ComparedStage:
    return ComparedStage(("1", "2"), (0.0, 0.5), EVIL, ("1.000", "2.000"), difference, EVIL)


def both_of(stages: list[ComparedStage]) -> str:
    plans = ({"title": EVIL}, {"title": "b"})
    return side_by_side(EVIL, EVIL, [stages_table(stages)], plans, (0, 1)).decode()


def plans_in(text: str) -> list[dict[str, Any]]:
    """Returns the data of all plans that a file holds."""
    return [json.loads(one) for one in re.findall(r'class="plan">(.*?)</script>', text, re.DOTALL)]


def test_each_plan_makes_the_page_that_stands_beside_it_alone(built: Path) -> None:
    """The code once, data of each plan; names stay text."""
    text = both_of([stage(1.0)])
    (ends,) = re.findall(r'id="ends">(.*?)</script>', text, re.DOTALL)
    before, after = json.loads(ends)
    plans = re.findall(r'class="plan">(.*?)</script>', text, re.DOTALL)
    assert f"{before}{plans[0]}{after}".encode() == page_html({"title": EVIL})
    assert plans_in(text) == [{"title": EVIL}, {"title": "b"}]
    assert text.count("const built = 1;") == 1
    assert "<img" not in text
    assert f"<td>{html.escape(EVIL)}</td>" in text


@pytest.mark.parametrize(
    ("difference", "mark", "text"),
    [(0.25, " bad", "+0.250"), (-0.25, " good", "−0.250"), (0.0004, "", "0.000")],
)
def test_stages_that_differ_are_marked(
    difference: float, mark: str, text: str, built: Path
) -> None:
    both = both_of([stage(difference)])
    assert f'<td class="number{mark}">{text}</td>' in both
    assert 'data-a="0.0" data-b="0.5"' in both


def test_schedules_are_written_beside_the_table(
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
    document = json.loads(Path("both/schedules.json").read_text())
    found = [plan["duration"] for plan in plans_in(text)]
    assert found == [document[side]["duration"] for side in ("a", "b")]
    assert [plan["title"][:3] for plan in plans_in(text)] == ["A: ", "B: "]
    assert text.count("<tr data-a=") == len(document["stages"])


def test_methods_are_shown_beside_the_fastest_one(
    tmp_path: Path,
    built: Path,
    tasks_folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Every plan that there is, loss against the first row, why a method has none; the same bytes each time."""
    monkeypatch.chdir(tmp_path)
    task = str(tasks_folder / "03_bottin_planar" / "tasks.yaml")
    methods = [part for name in ("fixed", "exact", "minimum_time") for part in ("--method", name)]
    command = ["compare", "solvers", task, *methods, "--effort", "quick", "--page", "--quiet"]
    assert run(command) == 2
    assert "--page writes comparison.html: name its folder with --out" in capsys.readouterr().err
    assert run([*command, "--out", "one"]) == 0
    assert run([*command, "--out", "two"]) == 0
    text = Path("one/comparison.html").read_text()
    assert text == Path("two/comparison.html").read_text()
    (section,) = json.loads(Path("one/comparison.json").read_text())["comparisons"]
    planned = [row for row in section["rows"] if row["cycle_time"] is not None]
    assert [plan["duration"] for plan in plans_in(text)] == [row["cycle_time"] for row in planned]
    for k, row in enumerate(planned):
        assert f'data-plan="{k}" data-reference="0"><td>{row["method"]}</td>' in text
        loss = row["cycle_time"] - planned[0]["cycle_time"]
        shown = f"+{loss:.3f}" if loss >= 0.0005 else "0.000"
        assert f'{row["cycle_time"]:.3f}</td><td class="number">{shown}</td>' in text
        assert plans_in(text)[k]["title"].endswith(f": {row['method']}")
    for row in section["rows"]:
        assert html.escape(row["reason"]) in text
    assert f"lower bound {section['lower_bound']:.3f} s" in text


def test_a_method_without_a_plan_says_why(
    tmp_path: Path, built: Path, monkeypatch: pytest.MonkeyPatch, tasks_folder: Path
) -> None:
    """An arm without a closed form: `exact` does not serve it; nothing is there to be seen."""
    monkeypatch.chdir(tmp_path)
    task = str(tasks_folder / "09_yumi" / "tasks.yaml")
    command = ["compare", "solvers", task, "--method", "exact", "--page", "--out", "one", "-q"]
    assert run(command) == 2
    text = Path("one/comparison.html").read_text()
    assert "not served: " in text
    assert plans_in(text) == []
    assert "open([]);" in text
