"""The document of `dualarm sweep`: rows best first, Pareto set, what failed and why, what matters.

Nothing in it was measured by a clock, and nothing depends on processes or on what a store knew.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from dualarm_cli import __version__
from dualarm_cli.files.source.diagnostics import MAX_SHOWN
from dualarm_cli.model.evaluation import Evaluation
from dualarm_cli.model.study import Amount, Objective, Parameter, Study
from dualarm_cli.studies.requests import input_problems
from dualarm_cli.studies.rows import TOGETHER, Ranking, StudyRow, rank
from dualarm_cli.studies.sensitivity import (
    Factor,
    StudySensitivity,
    numeric_factor,
    sensitivity,
    word_factor,
)

FORMAT = "dualarm.sweep/1"
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")
_TOGETHER = {sum: "sum", max: "largest", min: "least"}


def study_document(
    study: Study, rows: Sequence[StudyRow], reference: StudyRow, method: Mapping[str, Any]
) -> dict[str, Any]:
    """Returns the whole document, JSON-ready; SI units but for parameters, which have their own.

    Args:
        study: what was varied.
        rows: one per point.
        reference: what the files come to as they are.
        method: how the points were found.
    """
    ranking = rank(rows, study.objectives)
    planned = {row.number for row in ranking.rows}
    failed = [row for row in rows if row.number not in planned]
    reasons = {row.number: _reasons(study, row) for row in failed}
    sampled = method["name"] == "optimise"
    return {
        "format": FORMAT,
        "version": __version__,
        "study": study.name,
        "tasks": [tasks.name for tasks in study.tasks],
        "objectives": [_objective(study, objective) for objective in study.objectives],
        "parameters": [_parameter(parameter) for parameter in study.parameters],
        "settings": dict(study.settings),
        "method": dict(method),
        "counts": _counts(rows, ranking),
        "reference": {"status": reference.status, **_figures(reference)},
        "rows": [_row(study, row, ranking, place) for place, row in enumerate(ranking.rows, 1)]
        + [_row(study, row, ranking, None) | {"reasons": reasons[row.number]} for row in failed],
        "failures": _failures(failed, reasons),
        "sensitivity": [
            _sensitivity(study, objective, ranking.rows, sampled) for objective in study.objectives
        ],
        "inputs": dict(study.inputs),
    }


def _objective(study: Study, objective: Objective) -> dict[str, Any]:
    return {
        "name": objective.name,
        "sense": objective.sense,
        "unit": objective.unit,
        "together": _TOGETHER[TOGETHER[objective.name]] if len(study.tasks) > 1 else None,
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    span = parameter.span
    return {
        "name": parameter.name,
        "unit": parameter.unit,
        "numeric": parameter.is_numeric,
        "targets": [
            {"file": target.role, "path": target.path, "apply": target.apply}
            for target in parameter.targets
        ],
        "values": None if span is not None else [_value(level) for level in parameter.levels],
        "range": None if span is None else [span.low.number, span.high.number],
    }


def _value(level: Any) -> Any:
    return level.number if isinstance(level, Amount) else level


def _counts(rows: Sequence[StudyRow], ranking: Ranking) -> dict[str, int]:
    counts = {"points": len(rows), "planned": len(ranking.rows), "pareto": len(ranking.pareto)}
    for row in rows:
        if not row.is_planned:
            counts[row.status] = counts.get(row.status, 0) + 1
    return counts


def _row(study: Study, row: StudyRow, ranking: Ranking, place: int | None) -> dict[str, Any]:
    names = [parameter.name for parameter in study.parameters]
    return {
        "rank": place,
        "point": row.number,
        "values": {name: _value(level) for name, level in zip(names, row.point, strict=True)},
        "status": row.status,
        "pareto": row.number in ranking.pareto,
        **_figures(row),
        "reasons": [],
    }


def _figures(row: StudyRow) -> dict[str, Any]:
    """Returns what a row came to, and each task file's share of it."""
    return {**row.figures, "jobs": [_job(evaluation) for evaluation in row.evaluations]}


def _job(evaluation: Evaluation) -> dict[str, Any]:
    limiting = sorted(evaluation.limiting.items(), key=lambda item: (-item[1], item[0]))
    return {
        "tasks": evaluation.case,
        "status": evaluation.status,
        "cycle_time": evaluation.cycle_time,
        "lower_bound": evaluation.lower_bound,
        "gap": evaluation.gap,
        "clearance": evaluation.clearance,
        "travel": evaluation.travel,
        "limiting": dict(limiting),
        "caveats": list(evaluation.caveats),
    }


def _reasons(study: Study, row: StudyRow) -> list[str]:
    """Returns why a row has no plan, as sentences."""
    if row.status == "bad_input":
        problems = input_problems(study, row.point)
        if problems:
            return [str(problem) for problem in problems[:MAX_SHOWN]]
    return [
        str(finding)
        for evaluation in row.evaluations
        if evaluation.status == row.status
        for finding in evaluation.findings[:MAX_SHOWN]
    ]


def _failures(failed: Sequence[StudyRow], reasons: Mapping[int, list[str]]) -> list[dict[str, Any]]:
    """Returns what failed: rows of one status whose first lines differ in numbers only, counted together."""
    groups: dict[tuple[str, str], list[StudyRow]] = {}
    for row in failed:
        first = reasons[row.number][0] if reasons[row.number] else ""
        kind = _NUMBER.sub("#", first.partition("\n")[0])
        groups.setdefault((row.status, kind), []).append(row)
    found = [
        {
            "status": status,
            "count": len(rows),
            "example": (reasons[rows[0].number] or [""])[0],
            "points": [row.number for row in rows],
        }
        for (status, _), rows in groups.items()
    ]
    return sorted(found, key=lambda entry: (-len(entry["points"]), entry["points"]))


def _sensitivity(
    study: Study, objective: Objective, rows: Sequence[StudyRow], searched: bool
) -> dict[str, Any]:
    """Returns what an objective depends on, by all rows that have it."""
    known = [(row, value) for row in rows if (value := row.figures[objective.name]) is not None]
    known.sort(key=lambda pair: pair[0].number)
    factors = [_factor(p, k, [row for row, _ in known]) for k, p in enumerate(study.parameters)]
    stepped = all(parameter.span is None for parameter in study.parameters)
    values = np.array([value for _, value in known], dtype=np.float64)
    found: StudySensitivity = sensitivity(factors, values, stepped, objective.step)
    notes = list(found.notes)
    if searched and not found.is_grid:
        notes.append("the search tried good points more often than others")
    return {
        "objective": objective.name,
        "plans": found.plans,
        "whole_grid": found.is_grid,
        "parameters": [
            {
                "name": one.parameter,
                "main_effect": one.effect,
                "share": one.share,
                "slope": one.slope,
                "rank_correlation": one.rank_correlation,
            }
            for one in found.influences
        ],
        "interactions": [
            {"between": [one, other], "share": share} for one, other, share in found.pairs
        ],
        "linear_share": found.linear_share,
        "notes": notes,
    }


def _factor(parameter: Parameter, k: int, rows: Sequence[StudyRow]) -> Factor:
    """Returns a parameter as columns of numbers."""
    levels = [row.point[k] for row in rows]
    if not parameter.is_numeric:
        places = [parameter.levels.index(level) for level in levels]
        return word_factor(parameter.name, places, len(parameter.levels))
    known = [level.number for level in parameter.levels if isinstance(level, Amount)]
    numbers = [level.number for level in levels if isinstance(level, Amount)]
    return numeric_factor(parameter.name, np.array(numbers, dtype=np.float64), known)
