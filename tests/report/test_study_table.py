"""What `dualarm sweep` shows: rows, sentences, CSV and figures of a document made by hand."""

from __future__ import annotations

import copy
import csv
import io
from typing import Any

import pytest
from rich.console import Console

from dualarm_cli.kinds.drawing import new_figure
from dualarm_cli.model.studies.study import OBJECTIVES
from dualarm_cli.report.comparison.study_table import (
    MAX_ROWS,
    most_time,
    rows_table,
    sensitivity_sentences,
    sensitivity_table,
    sentences,
    study_csv,
)
from dualarm_cli.report.figures.study_figure import _widen, draw_pareto, draw_sensitivity


def _row(rank: int | None, x: Any, word: str, **figures: Any) -> dict[str, Any]:
    values = {
        "cycle_time": 2.0,
        "gap": 0.25,
        "clearance": 0.02,
        "travel": 3.0,
        "torque": None,
    } | figures
    job = {
        "tasks": "a.yaml",
        "torque_joint": "left_2" if values["torque"] else "",
        "limiting": {"left_s": 0.5, "lines": 1.5},
        "caveats": [],
    } | values
    return {
        "rank": rank, "point": 0, "values": {"=x": x, "[b]arm": word}, "status": "planned", "pareto": rank == 1,
        **values, "jobs": [job], "reasons": [],
    }  # fmt: skip


@pytest.fixture
def document() -> dict[str, Any]:
    """Three rows of four points; names that would be formulas, markup or mathematics."""
    failed = _row(
        None, 30, "right", **dict.fromkeys(("cycle_time", "gap", "clearance", "travel", "torque"))
    )
    failed |= {
        "point": 3,
        "status": "infeasible",
        "reasons": ["a.yaml:3:1: no plan:\n  left: does not reach\n  b.yaml:4:1: right: touches"],
    }
    influence = {"main_effect": 0.5, "share": 0.75, "slope": None, "rank_correlation": -1.0}
    section = {
        "plans": 3, "whole_grid": True, "linear_share": 0.5, "notes": ["3 plans"],
        "interactions": [{"between": ["=x", "[b]arm"], "share": 0.1}],
        "parameters": [influence | {"name": "=x"}, influence | {"name": "[b]arm", "share": None, "main_effect": None}],
    }  # fmt: skip
    return {
        "study": "[s].yaml",
        "tasks": ["a.yaml"],
        "objectives": [
            {"name": "cycle_time", "sense": "minimise", "together": None},
            {"name": "clearance", "sense": "maximise", "together": None},
        ],
        "parameters": [
            {"name": "=x", "unit": "mm", "numeric": True, "values": [10, 20, 30]},
            {"name": "[b]arm", "unit": "", "numeric": False, "values": ["left", "$right"]},
        ],
        "counts": {"points": 4, "planned": 3, "pareto": 1, "infeasible": 1},
        "reference": {
            "status": "planned", "cycle_time": 4.0, "gap": None, "clearance": 0.01, "travel": 1.0, "torque": None,
        },
        "rows": [
            _row(1, 10, "left", cycle_time=3.0),
            _row(2, 20.5, "$right", cycle_time=3.5, clearance=0.015),
            _row(3, 30, "left", cycle_time=3.75, clearance=None),
            failed,
        ],
        "failures": [{"status": "infeasible", "count": 1, "example": failed["reasons"][0], "points": [3]}],
        "sensitivity": [section | {"objective": "cycle_time"}, section | {"objective": "clearance"}],
    }  # fmt: skip


def _shown(thing: Any) -> str:
    console = Console(width=160, file=io.StringIO())
    console.print(thing)
    return console.file.getvalue()


def test_the_table_has_the_rows_with_a_plan_in_shown_units(document) -> None:
    """Names are text, whatever is in them; what is not known is a dash."""
    lines = [line for line in _shown(rows_table(document)).splitlines() if line.startswith("│")]
    assert [[cell.strip() for cell in line.strip("│").split("│")] for line in lines] == [
        ["1", "*", "10", "left", "3.000", "20.0", "25.0", "3.00", "lines 75%"],
        ["2", "", "20.5", "$right", "3.500", "15.0", "25.0", "3.00", "lines 75%"],
        ["3", "", "30", "left", "3.750", "–", "25.0", "3.00", "lines 75%"],
    ]
    text = _shown(rows_table(document))
    assert "=x [mm]" in text and "[b]arm" in text and "[s].yaml: 3 of 4 points have a plan" in text


def test_torque_shares_have_their_joint_where_they_are_known(document) -> None:
    """The joint of the job with the largest share; no column without any."""
    assert "torque" not in _shown(rows_table(document))
    row = document["rows"][0]
    job = row["jobs"][0] | {"torque": 0.5, "torque_joint": "left_2"}
    row |= {"torque": 0.96, "jobs": [job, job | {"torque": 0.96, "torque_joint": "right_7"}]}
    text = _shown(rows_table(document))
    assert "torque %" in text and "│ 96.0 right_7 │" in text
    first, second, *_ = csv.DictReader(io.StringIO(study_csv(document).decode()))
    assert (first["torque"], first["torque_joint"]) == ("0.96", "right_7")
    assert (second["torque"], second["torque_joint"]) == ("", "")


def test_the_sentences_name_the_best_and_what_failed(document) -> None:
    """-25 %: 3 s against 4 s of the unchanged files."""
    lines = sentences(document)
    assert (
        "best cycle time: 3.000 s with =x 10 mm, [b]arm left; the unchanged files: 4.000 s (-25.0%)"
        in lines
    )
    assert (
        "best clearance: 20.0 mm with =x 10 mm, [b]arm left; the unchanged files: 10.0 mm" in lines
    )
    assert (
        "1 point without a plan (=x 30 mm, [b]arm right): a.yaml:3:1: no plan: left: does not reach; "
        "b.yaml:4:1: right: touches" in lines
    )


def test_an_objective_that_looks_the_same_everywhere_has_no_best_row(document) -> None:
    """21.68 and 21.71 mm are 21.7 mm both; of 20.0 and 21.7 one is best."""
    for row, clearance in zip(document["rows"], (0.02168, 0.02171, 0.02166, None), strict=True):
        row["clearance"] = clearance
    assert "clearance: 21.7 mm for all plans; the unchanged files: 10.0 mm" in sentences(document)
    document["rows"][2]["clearance"] = 0.02
    assert any(
        line.startswith("best clearance: 21.7 mm with =x 10") for line in sentences(document)
    )


def test_files_that_have_no_plan_as_they_are_are_said_to_have_none(document) -> None:
    """In the words of the other sentences."""
    document["reference"] = {"status": "infeasible"} | dict.fromkeys(("cycle_time", "clearance"))
    assert any(
        line.endswith("; the unchanged files: without a plan") for line in sentences(document)
    )


def test_a_study_without_any_plan_says_so(document) -> None:
    """There is no table above it."""
    document["rows"] = document["rows"][3:]
    assert sentences(document)[0] == "[s].yaml: none of 4 points has a plan"


def test_rows_beyond_the_most_are_counted(document) -> None:
    """The table stays on a screen."""
    document["rows"][:3] = [_row(k, k, "left") for k in range(1, MAX_ROWS + 4)]
    assert f"│ {MAX_ROWS} " in _shown(rows_table(document))
    assert f"│ {MAX_ROWS + 1} " not in _shown(rows_table(document))
    assert "... and 3 more rows; --csv FILE has all" in sentences(document)


def test_the_csv_gives_every_number_back_and_runs_no_formula(document) -> None:
    """Failed rows last, with their reason on one line."""
    document["rows"][0]["cycle_time"] = 0.1 + 0.2
    head, *rows = csv.reader(io.StringIO(study_csv(document).decode()))
    assert head == [
        "rank", "status", "pareto", "'=x [mm]", "[b]arm", "cycle_time", "gap", "clearance", "travel", "torque",
        "torque_joint", "most_time", "caveats", "reason",
    ]  # fmt: skip
    assert float(rows[0][5]) == 0.1 + 0.2
    assert rows[2][7] == ""
    assert rows[3] == [
        "",
        "infeasible",
        "0",
        "30",
        "right",
        "",
        "",
        "",
        "",
        "",
        "",
        "",
        "",
        "a.yaml:3:1: no plan: left: does not reach; b.yaml:4:1: right: touches",
    ]


def test_the_csv_says_what_a_pass_leaves_open(document) -> None:
    """The caveat of both jobs once."""
    jobs = document["rows"][0]["jobs"]
    document["rows"][0]["jobs"] = [job | {"caveats": ["no shapes"]} for job in (*jobs, *jobs)]
    rows = csv.DictReader(io.StringIO(study_csv(document).decode()))
    assert [row["caveats"] for row in rows][:2] == ["no shapes", ""]


def test_sensitivity_is_shown_with_what_it_rests_on(document) -> None:
    """What is not known is a dash; interactions from 5 % on are told; what holds for all objectives is noted once."""
    document["sensitivity"][1]["notes"] = ["3 plans", "a curve"]
    text = _shown(sensitivity_table(document))
    assert "0.500 s │   75% │     – │      -1.00" in text
    assert "500.0 mm" in text
    assert sensitivity_sentences(document) == [
        "note: 3 plans",
        "note: clearance: a curve",
        "cycle time: =x and [b]arm act together: 10% of the variance",
        "clearance: =x and [b]arm act together: 10% of the variance",
    ]


def test_most_time_adds_jobs_up() -> None:
    """1 + 3 s of lines of 5 s."""
    jobs = [{"limiting": {"lines": 1.0, "left_s": 1.0}}, {"limiting": {"lines": 3.0}}]
    assert most_time(jobs) == "lines 80%"
    assert most_time([{"limiting": {}}]) == "–"


def test_no_drama_is_made_of_what_hardly_differs() -> None:
    """Clearances of 21.68 to 21.71 mm are drawn on an axis of a millimetre, about the same middle."""
    pytest.importorskip("matplotlib")
    panel = new_figure(3.0, 3.0).subplots()
    panel.set_ylim(21.68, 21.71)
    _widen(panel, "y", OBJECTIVES["clearance"])
    assert panel.get_ylim() == pytest.approx((21.195, 22.195))
    panel.set_ylim(20.0, 30.0)
    _widen(panel, "y", OBJECTIVES["clearance"])
    assert panel.get_ylim() == (20.0, 30.0)


@pytest.mark.parametrize(
    "change", ["as it is", "nothing planned", "one plan", "words only", "three objectives"]
)
def test_figures_are_drawn_of_anything_and_are_the_same_every_time(document, change) -> None:
    """PNG; no name is taken for mathematics, nothing planned is no error."""
    pytest.importorskip("matplotlib")
    if change == "nothing planned":
        document["rows"] = document["rows"][3:]
        for section in document["sensitivity"]:
            section["parameters"] = [one | {"share": None} for one in section["parameters"]]
    if change == "one plan":
        document["rows"] = document["rows"][:1]
    if change == "words only":
        document["parameters"] = document["parameters"][1:]
        for section in document["sensitivity"]:
            section["parameters"] = section["parameters"][1:]
    if change == "three objectives":
        document["objectives"].append({"name": "travel", "sense": "minimise", "together": None})
        document["sensitivity"].append(document["sensitivity"][0] | {"objective": "travel"})
    for draw in (draw_pareto, draw_sensitivity):
        first, second = draw(document, "png"), draw(copy.deepcopy(document), "png")
        assert first.startswith(b"\x89PNG")
        assert first == second
        assert len(first) > 5000


def test_a_share_that_is_not_known_is_a_dash_in_the_figure_too(document, monkeypatch) -> None:
    """Not nought: that would say that the parameter does not matter."""
    pytest.importorskip("matplotlib")
    monkeypatch.setattr(
        "dualarm_cli.report.figures.study_figure.rendered", lambda figure, _: figure
    )
    panel = draw_sensitivity(document, "png").axes[0]
    assert [text.get_text() for text in panel.texts] == ["75%", "–", "10%"]


def test_plans_that_are_not_fully_checked_are_counted(document: dict[str, Any]) -> None:
    """Two of three plans lack the shape of a tool."""
    for row in document["rows"][:2]:
        row["jobs"][0]["caveats"] = ["no shapes of left_tool"]
    assert "2 of 3 plans: verified, except that no shapes of left_tool" in sentences(document)
