"""Levers of a regression: the changed number behind it, and the largest other lever.

Both are estimated from the new plan (`levers/estimates`); nothing is planned for them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dualarm_cli.errors import DualArmError
from dualarm_cli.model.studies.evaluation import Evaluation, Finding

if TYPE_CHECKING:
    from dualarm_cli.evaluation.request import Request
    from dualarm_cli.levers.changes import Lever
    from dualarm_cli.levers.estimates import Estimate
    from dualarm_cli.scoring.baseline import Recorded
    from dualarm_cli.scoring.verdict import Verdict


def numbers_of(tasks: str) -> dict[str, Any]:
    """Read the values that levers of task and cell file change, by role and JSON pointer."""
    from dualarm_cli.levers.changes import documents_of, levers, value_of

    documents = documents_of(Path(tasks))
    numbers: dict[str, Any] = {}
    for lever in levers(documents):
        for key in lever.values if lever.kind != "robot" else ():
            value = value_of(documents, key)
            if isinstance(value, int | float | str):
                numbers[key] = value
    return dict(sorted(numbers.items()))


def with_levers(verdicts: Sequence[Verdict], requests: Sequence[Request]) -> list[Verdict]:
    """Add to each regression its changed number, and the largest other lever.

    Args:
        verdicts: on all cases.
        requests: of the cases that were planned.
    """
    paths = {request.case: request.path for request in requests}
    return [
        replace(verdict, reasons=(*verdict.reasons, Finding(text, verdict.case)))
        if verdict.state == "regressed" and (text := _levers(verdict, paths[verdict.case]))
        else verdict
        for verdict in verdicts
    ]


def _levers(verdict: Verdict, tasks: str) -> str:
    """Describe the levers of a regression; empty without estimates."""
    evaluation, before = verdict.evaluation, verdict.before
    if evaluation is None or before is None or not evaluation.schedule:
        return ""
    try:
        back, larger = _estimated(evaluation, before, Path(tasks))
    except DualArmError:
        return ""  # an explanation that fails must not hide the regression
    words = []
    if back is not None:
        gain = "" if back.gain is None else f" (set back it gains an estimated {back.gain:.3f} s)"
        words.append(f"made by {back.lever}{gain}")
    if larger is not None:
        lost = (evaluation.cycle_time or 0.0) - before.cycle_time
        words.append(
            f"{larger.lever} would gain an estimated {larger.gain:.3f} s of the {lost:.3f} s lost"
        )
    return "; ".join(words)


def _estimated(
    evaluation: Evaluation, before: Recorded, tasks: Path
) -> tuple[Estimate | None, Estimate | None]:
    """Estimate the levers that set changed numbers back, and all others; select the largest of each."""
    from dualarm_cli.exporting.files import URDF
    from dualarm_cli.exporting.schedule_reader import read_schedule
    from dualarm_cli.interface import load
    from dualarm_cli.levers.changes import documents_of, levers
    from dualarm_cli.levers.estimates import estimated, estimated_levers

    job = load(tasks)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "schedule.json").write_text(evaluation.schedule, encoding="utf-8")
        (Path(folder) / URDF).write_text(job.cell.robot.urdf, encoding="utf-8")
        schedule = read_schedule(folder)
    back = _set_back(levers(documents_of(tasks)), before.numbers, numbers_of(str(tasks)))
    set_back = estimated(schedule, job, tasks, back)
    # A number that makes the plan faster did not make it slower; another order is not estimated.
    suspects = [e for e in set_back if e.gain is None or e.gain > 0.0]
    made_by = max(suspects, key=lambda e: e.gain or 0.0, default=None)
    used = set() if made_by is None else set(made_by.lever.values)
    others = (
        e
        for e in estimated_levers(schedule, job, tasks)
        if e.lever.kind != "robot"
        and e.lever.is_number
        and (e.gain or 0.0) > 0.0
        and used.isdisjoint(e.lever.values)
    )
    return made_by, next(others, None)


def _set_back(
    levers: Sequence[Lever], before: Mapping[str, Any], now: Mapping[str, Any]
) -> list[Lever]:
    """Build the levers that set changed numbers back, if the same numbers exist."""
    if before.keys() != now.keys():
        return []  # other tasks or frames: numbers at the same place may be of another one
    changed: dict[frozenset[str], Lever] = {}
    for lever in levers:
        values = {k: before[k] for k in lever.values if k in now and before[k] != now[k]}
        if values:
            words = dict.fromkeys(_set_to(k, old, now[k]) for k, old in values.items())
            change = next(iter(words)) + (f" and {len(words) - 1} more" if len(words) > 1 else "")
            back = replace(lever, change=change, values=values)
            changed.setdefault(frozenset(values), back)
    return list(changed.values())


def _set_to(key: str, old: Any, new: Any) -> str:
    """Describe a number that is set back, with its unit where a plain number's is known."""
    from dualarm_cli.levers.changes import PLAIN_UNITS

    is_plain = not isinstance(old, str) and not isinstance(new, str)
    unit = PLAIN_UNITS.get(key.rpartition("/")[2], "") if is_plain else ""
    return f"{old} to {new} {unit}".rstrip()
