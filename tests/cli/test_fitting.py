"""Tables on narrow terminals: every cell is there, no line is too long, and words that are always the same go."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from rich.table import Table

from dualarm_cli.cli.parts.fitting import fitted
from dualarm_cli.cli.run import run

JOBS = (
    "01_first_pick",
    "05_two_robots",
    "10_seam",
    "13_hand_over",
    "14_two_grippers",
    "15_conveyor",
)
MORE = ("02_two_trays", "09_yumi")
ACTIONS = ("pick", "place", "move", "path", "seam", "give", "take", "leave", "(return)")


def printed(table: Table, width: int) -> str:
    console = Console(width=width, color_system=None)
    with console.capture() as capture:
        console.print(fitted(table, console))
    return capture.get()


def made(heads: list[tuple[str, bool]], rows: list[list[str]]) -> Table:
    """Returns a table; a head has whether its column holds numbers."""
    table = Table(title="t")
    for head, number in heads:
        table.add_column(head, justify="right" if number else "left", no_wrap=number)
    for row in rows:
        table.add_row(*row)
    return table


@pytest.mark.parametrize("seed", range(20))
def test_nothing_is_cut_off(seed: int) -> None:
    """Random tables of 4 to 8 columns in 80 characters, of words of at most six letters: all are printed."""
    rng = random.Random(seed)
    heads = [
        ("name", False),
        *((f"h{k} unit", rng.random() < 0.7) for k in range(rng.randint(3, 7))),
    ]
    rows = [
        [
            f"{rng.uniform(-1e3, 1e3):.3f}" if number else " ".join(
                "abcdef"[: rng.randint(2, 6)] for _ in range(rng.randint(1, 3))
            )
            for _, number in heads
        ]
        for _ in range(rng.randint(3, 6))
    ]  # fmt: skip
    text = printed(made(heads, rows), 80)
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= 80
    for row in rows:
        for cell in row:
            assert all(word in text for word in cell.split()), cell


def test_a_table_that_fits_stays_as_it_is() -> None:
    heads, rows = [("name", False), ("cycle s", True)], [["a", "1.0"], ["b", "1.0"]]
    console = Console(width=80)
    table = made(heads, rows)
    assert fitted(table, console) is table


def test_the_same_words_in_every_row_stand_below_and_nothing_is_left_out() -> None:
    """Columns in which nothing stands are not even named; the first column names the rows, whatever it says."""
    heads = [("name", False), ("plan", False), ("gap", True), ("note", False), ("cycle s", True)]
    rows = [["x", "verified", "–", "", "1.0"], ["x", "verified", "–", "", "1.0"]]
    text = printed(made(heads, rows), 80)
    assert "in every row: plan verified" in " ".join(text.split())
    assert "gap" not in text
    assert "note" not in text
    assert text.count("│ x    │     1.0 │") == 2


def test_one_row_keeps_its_words() -> None:
    text = printed(made([("name", False), ("plan", False)], [["x", "verified"]]), 80)
    assert "│ x    │ verified │" in text


def test_the_same_numbers_go_only_where_there_is_no_room() -> None:
    heads = [("name", False), *((f"h{k}", True) for k in range(8))]
    rows = [[name, *(f"{k}.{'0' * 9}" for k in range(7)), value] for name, value in ("a7", "b8")]
    text = printed(made(heads, rows), 80)
    assert "in every row: " in text
    assert "h6 6.000000000" in text.replace("\n", " ")
    assert "│ 0.000000000 │" in text
    assert printed(made(heads, rows), 200).count("6.000000000") == 2


@pytest.mark.parametrize("name", [*JOBS, *(pytest.param(n, marks=pytest.mark.slow) for n in MORE)])
def test_plans_say_what_is_done_in_80_columns(
    name: str, planned_files: Callable[[str], Path]
) -> None:
    """In each row what the arms do, and no head or word cut off."""
    out = (planned_files(name) / "stdout.txt").read_text()
    table = re.split(r"\n\w+ arm: busy", out)[0]
    assert "…" not in table
    assert max(map(len, table.splitlines())) <= 80
    lines = [line.replace("│", " ").strip() for line in table.splitlines()]
    rows = [line for line in lines if re.match(r"\d+ ", line)]
    assert rows
    for row in rows:
        assert any(f" {action}" in row for action in ACTIONS), row


def test_the_limits_of_a_robot_are_whole_in_80_columns(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where each limit comes from is said once, as it is the same of all."""
    monkeypatch.setenv("COLUMNS", "80")
    assert run(["robot", "show", "sda10f"]) == 0
    out = capsys.readouterr().out
    assert max(len(line) for line in out.splitlines() if "│" in line) <= 80
    assert "in every row: source assumed" in out
    assert "…" not in out
    assert "torso_b1" in out


@pytest.mark.parametrize("columns", ["0", "wide"])
def test_a_width_that_is_none_leaves_pipes_as_they_are(
    columns: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With 0, which programs without a terminal set, tables would be empty."""
    assert run(["robot", "show", "sda10f"]) == 0
    out = capsys.readouterr().out
    monkeypatch.setenv("COLUMNS", columns)
    assert run(["robot", "show", "sda10f"]) == 0
    assert capsys.readouterr().out == out
