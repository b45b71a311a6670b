"""`--pages DIR` of score and sweep: an index with a row for each case or point, and the pages that it leads to."""

from __future__ import annotations

import html
import json
import os
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.page.index_page import index_page, page_names, study_index
from dualarm_cli.page.tables import PageCell, PageRow, PageTable

EVIL = """<img src=x onerror="window.evil=1">'</td></table><script>window.evil=1</script>"""
SCORE = ["score", "--platform", "fixed", "--effort", "quick", "--jobs", "1"]
STUDY = """\
dualarm: study/1
tasks: cells/000/tasks.yaml
objectives: [cycle_time, travel]
settings: {effort: quick, platform: fixed}
parameters:
  <b>x</b>:
    tasks: tasks.P1.move.xyz[0]
    values: [70 mm, 80 mm, 5 m]
"""


class Index(HTMLParser):
    """What a browser reads in an index: cells by row, links, and every element."""

    def __init__(self, text: str) -> None:
        """Reads a file's text."""
        super().__init__()
        self.rows: list[list[str]] = []
        self.links: dict[str, str] = {}
        self.elements: set[str] = set()
        self._link = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Notes an element, its row and its link."""
        self.elements.add(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        self._link = dict(attrs).get("href") or "" if tag == "a" else ""

    def handle_data(self, data: str) -> None:
        """Notes what is read in a cell."""
        if self._link:
            self.links[unquote(self._link)] = data
            self._link = ""
        if self.rows and self.rows[-1]:
            self.rows[-1][-1] += data.strip("\n")

    def row(self, first: str) -> dict[str, str]:
        """Returns the row whose first cell is that, by the heads of the columns."""
        (found,) = [row for row in self.rows[1:] if row[0] == first]
        return dict(zip(self.rows[0], found, strict=True))


def index_in(folder: str) -> Index:
    return Index((Path(folder) / "index.html").read_text())


def data_of(page: Path) -> dict[str, Any]:
    """Returns the data of a plan's page."""
    (text,) = re.findall(r'id="data">(.*?)</script>', page.read_text(), re.DOTALL)
    found: dict[str, Any] = json.loads(text)
    return found


def test_names_in_an_index_are_text_and_it_has_no_script() -> None:
    table = PageTable(
        EVIL, [(EVIL, False)], [PageRow([PageCell(EVIL, links={EVIL: f"plans/{EVIL}"})])]
    )
    text = index_page(EVIL, [EVIL], [table]).decode()
    found = Index(text)
    allowed = {
        "html",
        "head",
        "meta",
        "title",
        "style",
        "body",
        "h1",
        "p",
        "main",
        "table",
        "caption",
        "thead",
    }
    assert found.elements <= allowed | {"div", "tbody", "tr", "th", "td", "a"}
    assert found.links == {f"plans/{EVIL}": EVIL}
    assert found.rows[1] == [EVIL * 2]
    assert "default-src 'none'" in text
    assert "script-src" not in text


def test_columns_in_which_nothing_stands_are_left_out() -> None:
    rows = [PageRow([PageCell("a"), PageCell("–"), PageCell("")])]
    table = PageTable("", [("one", False), ("two", False), ("three", False)], rows)
    assert Index(index_page("t", [], [table]).decode()).rows == [["one"], ["a"]]


def test_pages_have_names_of_their_own_that_any_file_system_takes() -> None:
    """Also where only case or signs tell cases apart, where a name is long, or has no letter."""
    cases = ["a/b/tasks.yaml", "a/B/tasks.yaml", "a-b", "../x y.yaml", "ä", "'\"<>", "z" * 300]
    names = page_names(cases)
    assert names[:4] == ["a-b.html", "a-b-2.html", "a-b-3.html", "x-y-yaml.html"]
    assert len({name.lower() for name in names}) == len(cases)
    assert all(re.fullmatch(r"[a-z0-9-]{1,90}\.html", name) for name in names)


def test_a_score_leads_to_its_plans_and_says_why_there_is_none(
    cells: Callable[..., list[str]], built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Planned, out of reach, a wrong file; the same bytes from the cache, without it and by another process."""
    names = cells(3)
    for name, old, new in ((names[1], "80 mm", "1080 mm"), (names[2], "return", "retrun")):
        path = Path(name)
        path.write_text(path.read_text().replace(old, new))
    assert run([*SCORE, "cells", "--pages", "p"]) == 2
    err = capsys.readouterr().err
    assert re.search(r"written: p/index.html, which leads to 1 plan \([0-9.]+ MB\)", err)
    index = index_in("p")
    assert index.links == {"plans/cells-000.html": names[0]}
    good, far, wrong = (index.row(name) for name in names)
    page = data_of(Path("p/plans/cells-000.html"))
    assert page["title"] == names[0]
    assert good["cycle s"] == f"{page['duration']:.3f}"
    assert good["bound s"] == f"{page['report']['lower_bound']:.3f}"
    assert (good["verdict"], good["verified"], good["why"]) == ("pass", "yes", "")
    assert (far["verdict"], far["cycle s"], far["verified"]) == ("infeasible", "–", "–")
    assert "beyond the arm's reach" in far["why"]
    assert wrong["verdict"] == "bad input"
    assert re.match(rf"{names[2]}:\d+:\d+: .*retrun", wrong["why"])
    assert "baseline s" not in index.rows[0]

    assert run([*SCORE, "cells", "--pages", "again"]) == 2
    assert "unchanged and not planned again: 2 of 3" in capsys.readouterr().err
    assert run([*SCORE, "cells", "--pages", "anew", "--no-cache", "-q", "--jobs", "2"]) == 2
    for folder in ("again", "anew"):
        files = [path.relative_to("p") for path in Path("p").rglob("*.html")]
        assert len(files) == len(list(Path(folder).rglob("*.html"))) == 2
        assert all((Path(folder) / f).read_bytes() == (Path("p") / f).read_bytes() for f in files)


def test_a_known_case_without_its_page_is_planned_once_more(
    cells: Callable[..., list[str]], built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What was scored without pages; a score without pages knows what one with them has planned."""
    cells(1)
    known = "unchanged and not planned again: "
    for more, count in (([], 0), (["--pages", "p"], 0), (["--pages", "p"], 1), ([], 1)):
        assert run([*SCORE, "cells", *more]) == 0
        assert f"{known}{count} of 1" in capsys.readouterr().err


def test_pages_of_an_earlier_index_go_and_other_files_stay(
    cells: Callable[..., list[str]], built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    names = cells(2)
    Path("p/plans").mkdir(parents=True)
    Path("p/plans/mine.html").write_text("mine")
    Path("p/index.html").write_text("mine")
    assert run([*SCORE, *names, "--pages", "p"]) == 2
    assert (
        "--pages p: already holds an index.html that is no index of plans"
        in capsys.readouterr().err
    )
    assert Path("p/index.html").read_text() == "mine"
    Path("p/index.html").unlink()
    for cases, left in ((names, ["cells-000", "cells-001"]), (names[1:], ["cells-001"])):
        assert run([*SCORE, *cases, "--pages", "p", "-q"]) == 0
        assert sorted(p.stem for p in Path("p/plans").iterdir()) == [*left, "mine"]
    Path("file").touch()
    assert run([*SCORE, *names, "--pages", "file"]) == 2
    assert "--pages file: is a file; name a folder" in capsys.readouterr().err


def test_names_in_an_earlier_index_delete_nothing_elsewhere(
    cells: Callable[..., list[str]], built: Path
) -> None:
    """Steps up, also encoded ones, absolute paths, folders; a plain name of the folder's own is what it is about."""
    names = cells(1)
    precious = [Path("precious.html").absolute(), Path("p/near.html").absolute()]
    Path("p/plans/folder.html").mkdir(parents=True)
    for path in (*precious, Path("p/plans/old.html"), Path("p/plans/other.html")):
        path.write_text("precious")
    steps = "..%2F..%2Fprecious.html", "..%2Fnear.html", str(precious[0]).replace("/", "%2F")
    links = "".join(f'<a href="plans/{name}">' for name in (*steps, "folder.html", "old.html"))
    Path("p/index.html").write_text(f"<!doctype html>\n<!-- dualarm index -->\n{links}")
    assert run([*SCORE, *names, "--pages", "p", "-q"]) == 0
    assert all(path.read_text() == "precious" for path in precious)
    left = sorted(path.name for path in Path("p/plans").iterdir())
    assert left == ["cells-000.html", "folder.html", "other.html"]


@pytest.mark.parametrize("link", ["plans", "plans/cells-000.html", "index.html"])
def test_pages_are_not_written_where_a_link_leads(
    cells: Callable[..., list[str]], built: Path, capsys: pytest.CaptureFixture[str], link: str
) -> None:
    names = cells(1)
    (Path("p") / link).parent.mkdir(parents=True)
    Path("elsewhere").mkdir()
    target = Path("elsewhere" if link == "plans" else "elsewhere/kept.html")
    if link != "plans":
        target.write_text("<!doctype html>\n<!-- dualarm index -->\n")
    (Path("p") / link).symlink_to(target.absolute())
    before = {path: path.read_text() for path in Path("elsewhere").iterdir()}
    assert run([*SCORE, *names, "--pages", "p", "-q"]) == 2
    assert f"p: {link} leads out of the folder" in capsys.readouterr().err
    assert {path: path.read_text() for path in Path("elsewhere").iterdir()} == before


def test_an_index_that_is_a_pipe_is_not_waited_for(
    cells: Callable[..., list[str]], built: Path
) -> None:
    names = cells(1)
    Path("p").mkdir()
    os.mkfifo("p/index.html")
    assert run([*SCORE, *names, "--pages", "p", "-q"]) == 2


def test_without_the_build_nothing_is_planned(
    cells: Callable[..., list[str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = cells(1)
    monkeypatch.setattr("dualarm_cli.page.page.built_folder", lambda: tmp_path / "none")
    assert run([*SCORE, *names, "--pages", "p"]) == 2
    assert "was not built into this installation" in capsys.readouterr().err
    assert not Path("p").exists()


def test_a_study_leads_to_its_best_plans(
    cells: Callable[..., list[str]], built: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """All points have a row, the best one and the files as they are have a page; the same on two processes."""
    cells(1)
    Path("study.yaml").write_text(STUDY)
    sweep = ["sweep", "study.yaml", "--out", "out", "--force"]
    assert run(["sweep", "study.yaml", "--best", "1"]) == 2
    assert "--best 1: goes with --pages DIR only" in capsys.readouterr().err
    assert run([*sweep, "--pages", "p", "--best", "1", "--jobs", "1"]) == 0
    assert "2 planned once more for their pages" in capsys.readouterr().err
    rows = json.loads(Path("out/study.json").read_text())["rows"]
    index = index_in("p")
    assert sorted(index.links) == ["plans/as-it-is.html", "plans/rank-1.html"]
    assert len(index.rows) == 1 + 1 + len(rows)
    best = data_of(Path("p/plans/rank-1.html"))
    assert best["duration"] == rows[0]["cycle_time"]
    assert best["title"] == f"<b>x</b> {rows[0]['values']['<b>x</b>']:g} mm: study.yaml"
    first = index.row("1")
    assert (first["cycle time s"], first["verified"]) == (f"{best['duration']:.3f}", "yes")
    assert first["bound s"] == f"{best['report']['lower_bound']:.3f}"
    failed = index.row("–")
    assert failed["verified"] == "without a plan"
    assert failed["<b>x</b> [m]" if "<b>x</b> [m]" in failed else "<b>x</b> [mm]"]
    assert html.unescape(rows[-1]["reasons"][0]).splitlines()[0] in failed["why not"]
    assert run([*sweep, "--pages", "again", "--best", "1", "--jobs", "2", "--no-cache", "-q"]) == 0
    for file in ("index.html", "plans/rank-1.html", "plans/as-it-is.html"):
        assert (Path("p") / file).read_bytes() == (Path("again") / file).read_bytes()


def test_an_index_of_many_points_stays_small() -> None:
    """2,000 rows in less than two megabytes: only pages are large."""
    job = {"lower_bound": 1.0, "limiting": {"lines": 1.0}, "cycle_time": 2.0, "caveats": []}
    job |= {"torque": None, "torque_joint": ""}
    figures = {
        "cycle_time": 2.0,
        "gap": 0.5,
        "clearance": 0.1,
        "travel": 3.0,
        "torque": None,
        "jobs": [job],
    }
    figures["status"] = "planned"
    row = {"values": {"a": 1.0}, "pareto": False, "reasons": [], **figures}
    document = {
        "study": "study.yaml",
        "tasks": ["tasks.yaml"],
        "objectives": [{"name": "cycle_time", "together": None}],
        "parameters": [{"name": "a", "unit": "mm", "numeric": True}],
        "reference": figures,
        "counts": {"points": 2000, "planned": 2000, "pareto": 1},
        "failures": [],
        "rows": [{**row, "point": k, "rank": k + 1} for k in range(2000)],
    }
    open_job = {**job, "caveats": ["no shapes of left_tool"]}
    document["rows"][7]["jobs"] = [open_job]
    text = study_index(document, {(0, 0): "rank-1.html"})
    assert text.count(b'<td class="warn">not fully</td>') == 1
    assert text.count(b"no shapes of left_tool</td>") == 1
    assert text.count(b'<td class="good">yes</td>') == 2000
    assert len(Index(text.decode()).rows) == 2002
    assert len(text) < 2e6
