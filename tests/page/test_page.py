"""The page as a file: one piece, nothing from elsewhere, and names that stay text."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.page.page import PageNotBuiltError, page_html

EVIL = "</script><script>alert(1)</script><!--&amp;'\"\u2028"


def test_names_with_markup_stay_in_the_data(built: Path) -> None:
    data = {"title": EVIL, "tasks": [EVIL], "text": "ü"}
    page = page_html(data).decode()
    assert page.count("<script") == 2
    assert "alert(1)</script>" not in page.replace("const built", "")
    (text,) = re.findall(r'id="data">(.*?)</script>', page, re.DOTALL)
    assert json.loads(text) == data
    (title,) = re.findall(r"<title>(.*?)</title>", page, re.DOTALL)
    assert "<" not in title


def test_the_page_loads_nothing(built: Path) -> None:
    """Its policy forbids it, and it names no address."""
    page = page_html({"title": "a"}).decode()
    assert "default-src 'none'" in page
    assert not re.findall(r"(?:src|href)=", page)


def test_a_missing_build_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dualarm_cli.page.page.built_folder", lambda: tmp_path)
    with pytest.raises(PageNotBuiltError, match="install dualarm again with a network"):
        page_html({"title": "a"})


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns an empty folder, the working folder."""
    folder = tmp_path / "project"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def planned(*more: str) -> int:
    return run(["plan", "01_first_pick", "--effort", "quick", "--out", "p", "--quiet", *more])


def test_a_plan_has_its_page_unless_it_is_not_wanted(project: Path, built: Path) -> None:
    assert planned("--no-page") == 0
    assert not Path("p/report.html").exists()
    assert planned("--force") == 0
    assert "const built = 1;" in Path("p/report.html").read_text()


def test_without_the_build_the_plan_is_whole(
    project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("dualarm_cli.page.page.built_folder", lambda: project)
    assert planned() == 0
    assert "no report.html: the page was not built" in capsys.readouterr().err
    assert sorted(p.name for p in Path("p").iterdir()) == [
        "events.csv", "report.json", "robot.urdf", "schedule.csv", "schedule.json", "targets.csv",
    ]  # fmt: skip
    assert run(["report", "p"]) == 2
    assert "was not built" in capsys.readouterr().err


def test_a_plan_that_exists_gets_its_page(
    project: Path, built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same bytes as beside the plan; a task file that has changed is not taken."""
    assert planned() == 0
    first = Path("p/report.html").read_bytes()
    Path("p/report.html").unlink()
    assert run(["report", "p"]) == 0
    assert Path("p/report.html").read_bytes() == first
    schedule = json.loads(Path("p/schedule.json").read_text())
    name = next(iter(schedule["provenance"]["inputs"]))
    schedule["provenance"]["inputs"][name] = "0" * 64
    Path("p/schedule.json").write_text(json.dumps(schedule))
    assert run(["report", "p"]) == 2
    assert "name it with --tasks" in capsys.readouterr().err
    for elsewhere in (str(Path(name).absolute()), f"../{Path.cwd().name}/{name}", "a\0b"):
        schedule["provenance"]["inputs"] = {elsewhere: "0" * 64}
        Path("p/schedule.json").write_text(json.dumps(schedule))
        assert run(["report", "p"]) == 2
        assert "its name leads elsewhere" in capsys.readouterr().err


def test_a_page_of_a_plan_that_fails_is_written_and_told(
    project: Path, built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Velocities at the left arm's anchors are 1 % of a rad/s off."""
    assert planned() == 0
    schedule = json.loads(Path("p/schedule.json").read_text())
    for row in schedule["motion"]["left"]["velocity"]:
        row[:] = [v + 0.01 for v in row]
    Path("p/schedule.json").write_text(json.dumps(schedule))
    assert run(["report", "p"]) == 1
    assert "verification: FAILED" in capsys.readouterr().err
    assert Path("p/report.html").exists()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s["segments"][0].update(arm=""), "cannot be shown: arms: segment of"),
        (lambda s: s["segments"][1].update(start=1e6, end=1e6), "cannot be shown: segments: "),
        (
            lambda s: s["motion"]["left"]["acceleration"][2].__setitem__(0, float("nan")),
            "cannot be shown: finite: ",
        ),
    ],
)
def test_a_plan_that_holds_together_in_no_way_gets_no_page(
    project: Path,
    built: Path,
    capsys: pytest.CaptureFixture[str],
    change: Callable[[dict[str, Any]], None],
    words: str,
) -> None:
    """Exit 2 with what is wrong, and no page; figures of it would mean nothing."""
    assert planned("--no-page") == 0
    schedule = json.loads(Path("p/schedule.json").read_text())
    change(schedule)
    Path("p/schedule.json").write_text(json.dumps(schedule))
    assert run(["report", "p"]) == 2
    assert words in capsys.readouterr().err
    assert not Path("p/report.html").exists()
