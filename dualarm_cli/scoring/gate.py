"""The gate: every case held against the baseline and its budget; what is not known to be good does not pass."""

from __future__ import annotations

import math
from collections.abc import Mapping

from dualarm_cli.loading.text_source import quote
from dualarm_cli.model.evaluation import Evaluation, Finding
from dualarm_cli.scoring.baseline import Recorded
from dualarm_cli.scoring.causes import why_slower
from dualarm_cli.scoring.verdict import STATES, State, Verdict

FLOOR = 1e-3
"""Cycle times that differ by less are the same, whatever share that is [s]: the last digits differ between machines."""
NOTICEABLE = 1e-3
"""An improvement by less than this share is none that anybody has to be told."""


def judge_all(
    evaluations: Mapping[str, Evaluation],
    baseline: Mapping[str, Recorded] | None,
    max_regression: float,
    *,
    subset: bool = False,
) -> list[Verdict]:
    """Returns a verdict on every case that was planned or is in the baseline, by name.

    Args:
        evaluations: what the cases came to.
        baseline: what they came to then; None where there is none.
        max_regression: by what share a cycle time may be longer than it was.
        subset: whether cases of the baseline that were not planned are left out, instead of missing.
    """
    recorded = baseline or {}
    known = set(evaluations) | (set() if subset else set(recorded))
    fresh = {
        _files(e.inputs): case
        for case, e in evaluations.items()
        if case not in recorded and e.inputs
    }
    return [
        judge(
            case,
            evaluations.get(case),
            recorded.get(case),
            max_regression,
            compared=baseline is not None,
            renamed=fresh.get(_files(recorded[case].inputs), "") if case in recorded else "",
        )
        for case in sorted(known)
    ]


def _files(inputs: Mapping[str, str]) -> frozenset[tuple[str, str]]:
    """Returns what files a case was read from, by name from its folder and content."""
    return frozenset(inputs.items())


def judge(
    case: str,
    evaluation: Evaluation | None,
    before: Recorded | None,
    max_regression: float,
    *,
    compared: bool,
    renamed: str = "",
) -> Verdict:
    """Returns the verdict on one case.

    Args:
        case: its name.
        evaluation: what it came to; None where it was not planned.
        before: what it came to then; None where it is not in the baseline.
        max_regression: by what share its cycle time may be longer than it was.
        compared: whether there is a baseline at all.
        renamed: a case that is new and has the very files of this one; empty for none.
    """
    if evaluation is None:
        text = (
            "is in the baseline, but was not scored; --update-baseline takes it out, "
            "--subset leaves out what is not named"
        )
        if renamed:
            text = f"is now {quote(renamed)}, with the same files; --update-baseline takes the new name"
        return Verdict(case, "missing", None, before, (Finding(text, case),))
    if evaluation.status != "planned":
        return Verdict(case, evaluation.status, evaluation, before, evaluation.findings)
    time = evaluation.cycle_time
    if time is None or not math.isfinite(time) or time < 0.0:
        reason = Finding("the cycle time is no number, or negative", case)
        return Verdict(case, "internal_error", evaluation, before, (reason,))
    states: list[State] = []
    reasons: list[Finding] = []
    for line in evaluation.budgets:
        if not line.kept:
            states.append("over_budget")
            text = str(line).rpartition(": MISSED")[0]
            reasons.append(Finding(f"{text} (budget)", line.file, line.line, line.column))
    if before is not None:
        slower = time - before.cycle_time
        if slower > max(FLOOR, max_regression * before.cycle_time):
            states.append("regressed")
            reasons.insert(0, Finding(why_slower(before, evaluation), case))
        elif -slower > max(FLOOR, NOTICEABLE * before.cycle_time):
            states.append("improved")
    elif compared:
        states.append("new")
    state: State = min(states, key=STATES.index, default="pass")
    return Verdict(case, state, evaluation, before, tuple(reasons))
