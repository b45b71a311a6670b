"""Score as an HTML index, each case's row linked to its plan's page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dualarm_cli.page.index_page import FOLDER, index_page, verified_cell
from dualarm_cli.page.tables import PageCell, PageRow, PageTable
from dualarm_cli.scoring.messages import (
    NOTHING,
    advice,
    counted,
    figure_words,
    rule_words,
    verdict_words,
)
from dualarm_cli.scoring.verdict import Verdict

_COLUMNS = (
    ("case", False),
    ("verdict", False),
    ("cycle s", True),
    ("baseline s", True),
    ("change", True),
    ("bound s", True),
    ("above bound", True),
    ("clearance mm", True),
    ("verified", False),
    ("why", False),
)


def score_index(
    verdicts: Sequence[Verdict], pages: Mapping[str, str], max_regression: float, compared: bool
) -> bytes:
    """Build the index page of a score.

    Args:
        verdicts: by name.
        pages: names of the plans' pages, by case; cases without a plan have none.
        max_regression: allowed relative increase of a cycle time.
        compared: whether there is a baseline.
    """
    lines = [counted(verdicts), *([rule_words(max_regression)] if compared else [])]
    rows = [_row(verdict, pages.get(verdict.case)) for verdict in verdicts]
    return index_page("Score", [*lines, *advice(verdicts)], [PageTable("", _COLUMNS, rows)])


def _row(verdict: Verdict, page: str | None) -> PageRow:
    evaluation, before = verdict.evaluation, verdict.before
    case = verdict.case
    name = PageCell(case) if page is None else PageCell("", links={case: f"{FOLDER}/{page}"})
    bound = None if evaluation is None else evaluation.lower_bound
    time, change, gap, clearance = figure_words(verdict)
    mark = "bad" if verdict.failed else "warn" if verdict.caveats else "good"
    return PageRow(
        [
            name,
            PageCell(verdict_words(verdict), mark),
            PageCell(time),
            PageCell(NOTHING if before is None else f"{before.cycle_time:.3f}"),
            PageCell(change),
            PageCell(NOTHING if bound is None else f"{bound:.3f}"),
            PageCell(gap),
            PageCell(clearance),
            verified_cell("" if evaluation is None else evaluation.status, verdict.caveats),
            PageCell("\n".join([*map(str, verdict.reasons), *verdict.caveats])),
        ]
    )
