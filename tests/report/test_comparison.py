"""The comparison's words and tables: order of rows, the winner's sentence, the CSV's columns."""

from __future__ import annotations

import csv
import io

import pytest

from dualarm_cli.page.side_by_side import _table
from dualarm_cli.report.comparison.comparison import comparison_document, winner_sentence
from dualarm_cli.report.comparison.comparison_table import (
    comparison_csv,
    comparison_table,
    reason_lines,
)
from dualarm_cli.report.figures.comparison_figure import draw_comparison


def row(method, cycle, status="verified", reason="", **rest):
    """One row as the document has it: transfers decided by the left arm, 1 s of lines, 0.5 s of dwells."""
    decided = None
    if cycle is not None:
        decided = {"left": cycle - 1.5, "right": 0.0, "lines": 1.0, "dwells": 0.5}
    return {
        "method": method,
        "redundancy": "arm_angle",
        "timing": "ruckig",
        "blend": "lines",
        "status": status,
        "reason": reason,
        "cycle_time": cycle,
        "parts_per_hour": None if cycle is None else 3600.0 / cycle,
        "gap": None,
        "grid_gap": None,
        "clearance": None,
        "clearance_cost": None,
        "elbow_imbalance": None,
        "platform_travel": None,
        "deciding_stages": None if cycle is None else {"left": 3, "right": 1},
        "deciding_time": decided,
        "path_curves": [],
        "caveats": [],
    } | rest


def document(*rows):
    """A document of one task file."""
    section = {
        "tasks": "tasks/=job/tasks.yaml",
        "robot": "a robot",
        "stages": 4,
        "parts": 2,
        "closes": True,
        "lower_bound": 3.0,
        "lower_bound_assumptions": [],
        "rows": list(rows),
        "winner": None,
        "sentence": "",
    }
    clock = [{"planning_time": 0.25 + k} for k in range(len(rows))]
    return comparison_document([section], clock, {"effort": "normal", "seed": 0})


def test_the_sentence_names_winner_next_and_fixed_and_why():
    """4.0 s against 4.5 s and 5.0 s: 11.1 % and 20.0 % less; transfers 2.5 s instead of 3.5 s."""
    text = winner_sentence([row("best", 4.0), row("next", 4.5), row("fixed", 5.0)])
    assert text.startswith(
        "best is the fastest with 4.000 s: 11.1% less than next and 20.0% less than fixed."
    )
    why, decides = "Transfers take 2.50 s (fixed: 3.50 s)", "the left arm decides 3 of 4 transfers"
    assert text.endswith(f". {why}; {decides}")
    assert max(len(sentence.split()) for sentence in text.split(". ")) <= 25


def test_what_saves_most_is_said():
    """Lines 2 s less, transfers 1 s less."""
    other = {"left": 3.5, "right": 0.0, "lines": 3.0, "dwells": 0.5}
    text = winner_sentence([row("best", 4.0), row("fixed", 7.0, deciding_time=other)])
    assert "Lines take 1.00 s (fixed: 3.00 s); the left" in text
    assert max(len(sentence.split()) for sentence in text.split(". ")) <= 25


def test_next_and_fixed_are_named_once_where_they_are_one():
    """Only two rows."""
    text = winner_sentence([row("best", 4.0), row("fixed", 5.0)])
    assert text.count("less than") == 1
    assert "20.0% less than fixed" in text


def test_equal_methods_win_together():
    """Half a microsecond is no difference; what is slower is still named."""
    rows = [row("one", 4.0), row("fixed", 4.0 + 5e-7), row("slow", 8.0)]
    text = winner_sentence(rows)
    assert text.startswith("one and fixed are equally fast with 4.000 s: 50.0% less than slow")
    assert "less than fixed" not in text


def test_a_plan_that_failed_never_wins():
    """However fast it claims to be."""
    text = winner_sentence([row("slow", 9.0), row("broken", 1.0, "failed", "velocity: …")])
    assert text.startswith("slow is the fastest with 9.000 s")
    assert "broken" not in text


def test_without_any_verified_plan_there_is_no_winner():
    """Said in so many words."""
    rows = [row("broken", 1.0, "failed", "x"), row("none", None, "infeasible", "y")]
    assert winner_sentence(rows) == "no method finds a plan that passes verification"


def test_what_differs_between_rows_is_in_their_names():
    """Two timings of one method."""
    text = winner_sentence([row("m", 4.0), row("m", 5.0, timing="trapezoid")])
    assert text.startswith("m (ruckig) is the fastest with 4.000 s: 20.0% less than m (trapezoid)")


def test_a_winner_that_is_not_fully_checked_is_said_to_be():
    """In the sentence in short, above it with the reason."""
    rows = [row("a", 4.0, caveats=["no shapes"]), row("b", 5.0, caveats=["no shapes"])]
    assert "with 4.000 s, not fully checked: 20.0% less" in winner_sentence(rows)
    (section,) = document(*rows)["comparisons"]
    assert reason_lines(section) == ["plans verified, except that no shapes"]


def test_reasons_that_are_alike_are_said_once():
    """Two methods that want a platform."""
    rows = [row("a", 1.0), row("b", None, "not served", "why"), row("c", None, "not served", "why")]
    (section,) = document(*rows)["comparisons"]
    assert reason_lines(section) == ["b, c: not served: why"]


def test_the_csv_keeps_wall_clock_in_its_last_column_alone():
    """Numbers read back as the same doubles; commas and newlines of a reason stay inside their cell."""
    third = 1.0 / 3.0
    made = document(row("a", third), row("=b", None, "infeasible", "no,\nnone"))
    rows = list(csv.DictReader(io.StringIO(comparison_csv(made).decode())))
    assert list(rows[0])[-1] == "planning_time"
    assert [r["planning_time"] for r in rows] == ["0.25", "1.25"]
    assert float(rows[0]["cycle_time"]) == third
    assert float(rows[0]["time_lines"]) == 1.0
    assert rows[1]["reason"] == "no,\nnone"
    assert rows[1]["cycle_time"] == ""
    # A spreadsheet would run a cell that begins with an equals sign.
    assert rows[1]["method"] == "'=b"


def test_what_a_pass_leaves_open_is_in_the_csv_and_amber_in_the_figure():
    """Two caveats in one cell; the plan without any is outlined in white alone."""
    import matplotlib as mpl

    made = document(row("a", 4.0, caveats=["no shapes", "no flange"]), row("b", 5.0))
    rows = csv.DictReader(io.StringIO(comparison_csv(made).decode()))
    assert [r["caveats"] for r in rows] == ["no shapes; no flange", ""]
    with mpl.rc_context({"svg.fonttype": "none"}):
        figures = [draw_comparison(document(one), "svg") for one in made["comparisons"][0]["rows"]]
    for words in (b"#b26a00", b"not fully checked"):
        assert [words in figure for figure in figures] == [True, False]


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_the_figure_is_the_same_bytes_and_knows_no_wall_clock(kind):
    """Planning times differ between the two; failed and missing plans are drawn too."""
    rows = (row("a", 4.0), row("b", 5.0, "failed", "x"), row("c", None, "infeasible", "y\nz"))
    one, two = document(*rows), document(*rows)
    for entry in two["wall_clock"]:
        entry["planning_time"] *= 7.0
    assert draw_comparison(one, kind) == draw_comparison(two, kind)


def test_paths_are_drawn_over_time_by_every_method():
    """Forces and manipulability of both methods under their names; a single plan has nothing to be compared with."""
    import matplotlib as mpl

    def path(slope):
        line = [0.0, slope]
        both = {"left": line, "right": line}
        curves = {"task": "seam", "time": [0.0, 1.0], "force": both, "manipulability": both}
        return [{**curves, "manipulability_together": line}]

    one, two = row("one", 4.0, path_curves=path(1.0)), row("two", 4.5, path_curves=path(2.0))
    with mpl.rc_context({"svg.fonttype": "none"}):
        both, alone = (draw_comparison(document(*rows), "svg") for rows in ((one, two), (one,)))
    titles = (b"path seam (solid: left, dashed: right)", b"contraction force K D [m]")
    for words in titles:
        assert words in both
        assert words not in alone
    # Each name beside its bar and in the legend.
    assert [both.count(b">one<"), both.count(b">two<")] == [2, 2]


def test_the_figure_says_the_bound_the_gain_and_the_reasons():
    """Words of the SVG, which keeps them as text where asked; here by its titles and labels."""
    import matplotlib as mpl

    with mpl.rc_context({"svg.fonttype": "none"}):
        text = draw_comparison(document(row("a", 4.0), row("c", None, "infeasible", "why")), "svg")
    for words in (b"bound 3.00 s", b"4.00 s", b"infeasible: why", b"=job: a robot, 4 stages"):
        assert words in text


def test_plans_that_are_not_fully_checked_are_amber():
    """Their verdict is verified; only the colour of good plans would hide that a tool has no shape."""
    plain, open_row = (
        row("one", 4.0, caveats=[]),
        row("two", 4.5, caveats=["no shapes of left_tool"]),
    )
    section = document(plain | {"platform_slides": False}, open_row | {"platform_slides": False})
    [table] = [comparison_table(one, section["wall_clock"]) for one in section["comparisons"]]
    assert list(table.columns[-1].cells) == ["[green]verified[/]", "[yellow]verified[/]"]
    cells = [found.cells[-1] for found in _table(section["comparisons"][0], {}).rows]
    assert [(cell.text, cell.mark) for cell in cells] == [
        ("verified", "good"),
        ("verified, except that no shapes of left_tool", "warn"),
    ]
