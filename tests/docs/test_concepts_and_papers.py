"""Pages against the code that they describe: figures of papers, what cannot be combined, solvers, tolerances."""

from __future__ import annotations

import re
from itertools import takewhile
from pathlib import Path
from typing import get_args

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.kinds import KINDS
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS
from dualarm_cli.model.schedule import SegmentKind, WaitReason
from dualarm_cli.model.verification import Verdict
from dualarm_cli.platform_angle import PLATFORM_SOLVERS
from dualarm_cli.postures import REDUNDANCY_SOLVERS
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.torque_checks import SAMPLING

DOCS = Path(__file__).parents[2] / "docs"
PAPERS = "tasks/papers/"


def page(name: str) -> str:
    """Returns the text of a page, minus signs as programs print them."""
    return (DOCS / name).read_text(encoding="utf-8").replace("−", "-")


def rows(text: str, title: str) -> list[list[str]]:
    """Returns the cells of the first table under a title, without its head."""
    lines = text.split(f"\n## {title}\n")[1].splitlines()
    first = next(k for k, line in enumerate(lines) if line.startswith("| ---")) + 1
    table = takewhile(lambda line: line.startswith("|"), lines[first:])
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in table]


@pytest.mark.parametrize(
    ("command", "figures"),
    [
        (["platform"], "-113.63 59.14 58.17 -40.43 4.62 5.24 -26.57 6.87 7.61 39.49 45.01 33.88"),
        (["platform"], "-114.85 59.76 -40.96 5.06 -25.69 7.60 48.04 43.17"),
        (
            ["calibrate", f"{PAPERS}qin_calibration/points.yaml"],
            "5.0 9.0 4.0 6.4 90.8 104.1 1156 4.4",
        ),
        (
            ["calibrate", f"{PAPERS}qin_calibration/points.yaml", "--method", "frame"],
            "4.4 0.0 28.7 16.8",
        ),
        (
            ["calibrate", f"{PAPERS}qin_calibration/points.yaml", "--fit", "tool,base_height"],
            "346.95 335.07",
        ),
        (["curve", f"{PAPERS}qin_curves/tasks.yaml"], "308.745 3.285 4.079 0.001"),
        (["curve", f"{PAPERS}qin_curves/tasks.yaml", "--step", "10ms"], "20.601"),
    ],
)
def test_figures_of_the_papers_are_what_their_commands_print(
    command: list[str],
    figures: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The page has the command, its figures, and the command prints them."""
    monkeypatch.chdir(DOCS.parent)
    monkeypatch.setenv("COLUMNS", "200")
    text = page("papers.md")
    assert " ".join(["dualarm", *command]) in text
    assert run(command) == 0
    printed = "".join(capsys.readouterr())
    for figure in figures.split():
        whole = rf"(?<![\d.]){re.escape(figure)}(?![\d]|\.\d)"
        assert re.search(whole, text), f"{figure} is not on the page"
        assert re.search(whole, printed), f"{figure} is not printed"


def test_what_cannot_be_combined_is_the_list_of_kinds() -> None:
    """Each row of the table in limits.md, and no kind without one."""
    columns = ["free", "window", "any", "sequence", "conveyor", "tool_change"]
    names = {"seam (`coordinate`)": "seam", "hand-over": "handover", "tool changes": "tool_change"}
    table = rows(page("limits.md"), "What cannot be combined in one file")
    said = {names.get(row[0], row[0]): row[1:] for row in table}
    assert set(said) == set(KINDS)
    for kind, cells in said.items():
        apart = {column for column, cell in zip(columns, cells, strict=True) if cell == "no"}
        assert apart == set(KINDS[kind]), kind


def test_the_glossary_has_every_reason_segment_and_verdict() -> None:
    """The words of schedule.json that a reader meets."""
    text = page("glossary.md")
    reasons = rows(text, "Reasons for waiting")
    assert {row[0].strip("`") for row in reasons} == {one for one in get_args(WaitReason) if one}
    segment = next(line for line in text.splitlines() if line.startswith("| segment |"))
    assert set(get_args(SegmentKind)) <= set(re.findall(r"[a-z]+", segment))
    check = next(line for line in text.splitlines() if line.startswith("| check |"))
    assert set(get_args(Verdict)) <= set(re.findall(r"`([a-z ]+)`", check))


def test_terms_of_the_glossary_are_used() -> None:
    """Each term is on another page, in a message or in the code."""
    files = [*DOCS.rglob("*.md"), *(DOCS.parent / "dualarm_cli").rglob("*.py")]
    used = " ".join(
        file.read_text(encoding="utf-8") for file in files if file.name != "glossary.md"
    )
    used = re.sub(r"[\s\"_]+", " ", used).lower()
    heads = re.findall(r"^\| ([^|]+) \|", page("glossary.md"), re.MULTILINE)
    terms = [
        term.strip(" `*")
        for head in heads
        if not head.startswith("---")
        for term in re.sub(r"\([^)]*\)", "", head).split(",")
    ]
    assert len(terms) > 50
    assert [term for term in terms if term.lower().replace("_", " ") not in used] == []


def test_concepts_name_every_solver() -> None:
    """Platform angles on their page; resolvers of stops, paths and seams on another."""
    pages = {
        "concepts/platform-angle.md": [PLATFORM_SOLVERS],
        "concepts/redundancy.md": [REDUNDANCY_SOLVERS, PATH_SOLVERS, SEAM_SOLVERS],
    }
    for name, families in pages.items():
        missing = [
            one.name for each in families for one in each if f"`{one.name}`" not in page(name)
        ]
        assert not missing, name


def test_tolerances_of_the_page_are_the_verifiers() -> None:
    """The table of what is measured, in the units of the page."""
    text = page("concepts/verification.md")
    assert "| tool pose at events | 1 µm, 1 µrad |" in text
    assert (TOL.pose_distance, TOL.pose_angle) == (1e-6, 1e-6)
    assert "| straightness of lines | 0.1 mm, 0.1 mrad |" in text
    assert (TOL.line_distance, TOL.line_angle) == (1e-4, 1e-4)
    assert "| tool on a seam; pose of the part | 1 µm, 1 µrad |" in text
    assert (TOL.chain_distance, TOL.chain_angle) == (1e-6, 1e-6)
    assert "at 1 kHz and all knots, 0.01 % |" in text
    assert TOL.tool_speed_slack == 1e-4
    assert "of every joint | at all knots and every 8 ms, 0.1 % |" in text
    assert SAMPLING.step == 0.008
    assert TOL.torque_slack == 1e-3
