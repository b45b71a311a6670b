"""Score as a JSON document, independent of the clock and of the cache."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from dualarm_cli.report.printable import printable
from dualarm_cli.scoring.gate import FLOOR
from dualarm_cli.scoring.verdict import STATES, Verdict, exit_code


def score_document(
    verdicts: Sequence[Verdict],
    settings: Mapping[str, Any],
    max_regression: float,
    baseline: str | None,
) -> dict[str, Any]:
    """Build the document of a score.

    Args:
        verdicts: by name.
        settings: of the plans.
        max_regression: allowed relative increase of a cycle time.
        baseline: name of the baseline's file, or None.
    """
    states = [verdict.state for verdict in verdicts]
    code = exit_code(verdicts)
    document: dict[str, Any] = printable(
        {
            "format": "dualarm.score/1",
            "passed": code == 0,
            "exit_code": code,
            "settings": dict(settings),
            "baseline": baseline,
            "max_regression": max_regression,
            "floor": FLOOR,
            "counts": {state: states.count(state) for state in STATES},  # type: ignore[arg-type]
            "cases": [_row(verdict) for verdict in verdicts],
        }
    )
    return document


def _row(verdict: Verdict) -> dict[str, Any]:
    evaluation, before = verdict.evaluation, verdict.before
    figures: dict[str, Any] = dict.fromkeys(
        ("cycle_time", "lower_bound", "gap", "clearance", "required_clearance", "travel")
    )
    if evaluation is not None:
        figures = {name: getattr(evaluation, name) for name in figures}
    return {
        "case": verdict.case,
        "state": verdict.state,
        **figures,
        "baseline_cycle_time": None if before is None else before.cycle_time,
        "change": verdict.change,
        "limiting": {} if evaluation is None else dict(evaluation.limiting),
        "budgets": [] if evaluation is None else [asdict(line) for line in evaluation.budgets],
        "reasons": [asdict(reason) for reason in verdict.reasons],
        "caveats": list(verdict.caveats),
    }
