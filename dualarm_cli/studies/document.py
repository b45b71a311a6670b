"""Document of `dualarm sweep`: ranked rows, Pareto set, failures, and each parameter's influence.

It has no measured times, and depends neither on processes nor on the store.

The influence of a parameter on an objective is estimated from the plans of the study. It has three measures:

* Main effects: the mean of the objective at each level of a parameter. `effect` is the largest of these means minus the
  least; `share` is the part of the objective's variance that they explain. On a whole grid shares add up with those of
  interactions to 1 (analysis of variance, exact as there is no noise). Otherwise a parameter explains something by
  chance alone; what chance explains on average is taken off (epsilon squared).
* Standardised regression: the coefficients of a linear fit by least squares, in standard deviations of the objective
  per standard deviation of the parameter, with a level of its own for each word; `linear_share` (R^2) says how much of
  the variance the fit explains.
* Rank correlation (Spearman): whether the objective rises with the parameter, along whatever monotone curve.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from dualarm_cli import __version__
from dualarm_cli.files.source.diagnostics import MAX_SHOWN
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.model.studies.evaluation import Evaluation, Status
from dualarm_cli.model.studies.study import Amount, Objective, Parameter, Study
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.report import comparisons as members
from dualarm_cli.studies.requests import input_problems
from dualarm_cli.studies.rows import TOGETHER, Ranking, StudyRow, rank

_note = NoteTable(
    "sensitivity",
    too_few="no sensitivity: fewer than two plans",
    constant="no sensitivity: the objective is constant",
    few="{plans} plans for {parameters:# parameter|# parameters}: the result is only an indication",
    left_out="values without any plan are left out",
    estimates="shares are estimates, because the plans do not fill the grid",
    linear="a linear fit explains {share:.0%}: slopes are more reliable than shares",
    not_linear="a linear fit explains {share:.0%} only: use the main effects instead of the slopes",
    searched="the search tried good points more often than others",
)
_NUMBER = re.compile(r"-?\d+(\.\d+)?(e-?\d+)?")
_TOGETHER = {sum: "sum", max: "largest", min: "least"}


def study_document(
    study: Study, rows: Sequence[StudyRow], reference: StudyRow, method: Mapping[str, Any]
) -> members.StudyReport:
    """Compose the JSON-ready document; SI units, except for parameters with their own units.

    Args:
        study: the study.
        rows: one per point.
        reference: row of the unchanged files.
        method: the choice of points.
    """
    ranking = rank(rows, study.objectives)
    planned = {row.number for row in ranking.rows}
    failed = [row for row in rows if row.number not in planned]
    reasons = {row.number: _reasons(study, row) for row in failed}
    sampled = method["name"] == "optimise"
    return {
        "format": "dualarm.sweep/1",
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
        "failures": failure_groups(failed, reasons),
        "sensitivity": [
            _sensitivity(study, objective, ranking.rows, sampled) for objective in study.objectives
        ],
        "inputs": dict(study.inputs),
    }


def _objective(study: Study, objective: Objective) -> members.StudyObjective:
    return {
        "name": objective.name,
        "sense": objective.sense,
        "unit": objective.unit,
        "together": _TOGETHER[TOGETHER[objective.name]] if len(study.tasks) > 1 else None,
    }


def _parameter(parameter: Parameter) -> members.StudyParameter:
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


def _row(study: Study, row: StudyRow, ranking: Ranking, place: int | None) -> members.StudyPoint:
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


def _figures(row: StudyRow) -> members.StudyFigures:
    """Collect a row's figures, and those of each task file."""
    return cast("members.StudyFigures", {**row.figures, "jobs": [*map(_job, row.evaluations)]})


def _job(evaluation: Evaluation) -> members.StudyJob:
    return {
        "tasks": evaluation.case,
        "status": evaluation.status,
        "cycle_time": evaluation.cycle_time,
        "lower_bound": evaluation.lower_bound,
        "gap": evaluation.gap,
        "clearance": evaluation.clearance,
        "travel": evaluation.travel,
        "torque": evaluation.torque,
        "torque_joint": evaluation.torque_joint,
        "limiting": dict(sorted(evaluation.limiting.items(), key=lambda item: (-item[1], item[0]))),
        "caveats": list(evaluation.caveats),
    }


def _reasons(study: Study, row: StudyRow) -> list[str]:
    """List the reasons why a row has no plan, as sentences."""
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


def failure_groups(
    failed: Sequence[StudyRow], reasons: Mapping[int, list[str]]
) -> list[members.StudyFailure]:
    """Group failed rows by status and first line of their `reasons`; numbers may differ."""
    groups: dict[tuple[Status, str], list[StudyRow]] = {}
    for row in failed:
        first = reasons[row.number][0] if reasons[row.number] else ""
        kind = _NUMBER.sub("#", first.partition("\n")[0])
        groups.setdefault((row.status, kind), []).append(row)
    failures: list[members.StudyFailure] = [
        {
            "status": status,
            "count": len(rows),
            "example": (reasons[rows[0].number] or [""])[0],
            "points": [row.number for row in rows],
        }
        for (status, _), rows in groups.items()
    ]
    return sorted(failures, key=lambda entry: (-len(entry["points"]), entry["points"]))


def _sensitivity(
    study: Study, objective: Objective, rows: Sequence[StudyRow], searched: bool
) -> members.StudySensitivities:
    """Analyse the sensitivity of an objective, over all rows that have its value."""
    valued = [(row, value) for row in rows if (value := row.figures[objective.name]) is not None]
    valued.sort(key=lambda pair: pair[0].number)
    factors = [_factor(p, k, [row for row, _ in valued]) for k, p in enumerate(study.parameters)]
    stepped = all(parameter.span is None for parameter in study.parameters)
    values = np.array([value for _, value in valued], dtype=np.float64)
    result: StudySensitivity = sensitivity(factors, values, stepped, objective.step)
    notes = [*result.notes, *([_note("searched")] if searched and not result.is_grid else [])]
    return {
        "objective": objective.name,
        "plans": result.plans,
        "whole_grid": result.is_grid,
        "parameters": [
            {
                "name": influence.parameter,
                "main_effect": influence.effect,
                "share": influence.share,
                "slope": influence.slope,
                "rank_correlation": influence.rank_correlation,
            }
            for influence in result.influences
        ],
        "interactions": [
            {"between": [name_a, name_b], "share": share} for name_a, name_b, share in result.pairs
        ],
        "linear_share": result.linear_share,
        "notes": [*notes],
    }


def _factor(parameter: Parameter, k: int, rows: Sequence[StudyRow]) -> Factor:
    """Encode a parameter as a factor."""
    levels = [row.point[k] for row in rows]
    if not parameter.is_numeric:
        places = [parameter.levels.index(level) for level in levels]
        return word_factor(parameter.name, places, len(parameter.levels))
    steps = [level.number for level in parameter.levels if isinstance(level, Amount)]
    numbers = [level.number for level in levels if isinstance(level, Amount)]
    return numeric_factor(parameter.name, np.array(numbers, dtype=np.float64), steps)


@dataclass(frozen=True)
class EffectSettings:
    """Settings of the sensitivity analysis."""

    bins: int = 4
    """Maximum number of bins of a range without steps, for main effects."""
    per_bin: int = 4
    """Minimum mean number of plans per bin."""
    min_plans_per_parameter: int = 5
    """Number of plans per parameter below which the result is only an indication."""
    min_linear_share: float = 0.7
    """Part of the variance that a linear fit must explain for meaningful slopes."""
    spread_tolerance: float = 1e-9
    """Relative spread below which an objective counts as constant."""


EFFECT = EffectSettings()


@dataclass(frozen=True)
class Factor:
    """Factor of the analysis: a parameter's value in each plan."""

    name: str
    """Name of the parameter."""
    levels: IntArray
    """Index of each plan's value or bin, shape (n,)."""
    count: int
    """Number of values or bins."""
    numbers: FloatArray | None
    """Numeric values, shape (n,); None for words."""


@dataclass(frozen=True)
class Influence:
    """Influence of one parameter on an objective."""

    parameter: str
    """Name of the parameter."""
    effect: float | None
    """Largest minus least level mean of the objective, in the objective's unit."""
    share: float | None
    """Fraction of the objective's variance that the parameter explains alone."""
    slope: float | None
    """Standardised regression coefficient; None for words, or if not separable from others."""
    rank_correlation: float | None
    """Spearman's rank correlation; None for words or a constant parameter."""


@dataclass(frozen=True)
class StudySensitivity:
    """Sensitivity of an objective to the parameters of a study."""

    plans: int
    """Number of analysed plans."""
    is_grid: bool
    """Flag of plans that form a whole grid of the values that occur.

    Fractions are exact then.
    """
    influences: tuple[Influence, ...]
    """Influences of all parameters, the one with the largest share first."""
    pairs: tuple[tuple[str, str, float], ...]
    """Interaction fractions of parameter pairs on a whole grid, largest first."""
    linear_share: float | None
    """Fraction of the variance that a linear fit explains."""
    notes: tuple[Note, ...] = ()
    """Remarks on the reliability of the analysis."""


def numeric_factor(name: str, numbers: ArrayLike, levels: Sequence[float]) -> Factor:
    """Build the factor of a parameter with numbers as values.

    Args:
        name: of the parameter.
        numbers: values of the plans, shape (n,).
        levels: values of the parameter; empty for a range without steps, which is cut into parts.
    """
    values = np.asarray(numbers, dtype=np.float64)
    if len(levels):
        steps = np.asarray(levels, dtype=np.float64)
        nearest = np.abs(values[:, None] - steps[None, :]).argmin(axis=1)
        return Factor(name, nearest, len(steps), values)
    parts = int(np.clip(len(values) // EFFECT.per_bin, 1, EFFECT.bins))
    span = np.ptp(values) if len(values) else 0.0
    shares = (values - values.min()) / span if span > 0.0 else np.zeros(len(values))
    bins = np.minimum((shares * parts).astype(np.int64), parts - 1)
    return Factor(name, bins, parts, values)


def word_factor(name: str, chosen: Sequence[int], count: int) -> Factor:
    """Build the factor of a parameter with words as values.

    Args:
        name: of the parameter.
        chosen: index of the value of each plan.
        count: number of values.
    """
    return Factor(name, np.asarray(chosen, dtype=np.int64), count, None)


def sensitivity(
    factors: Sequence[Factor], values: FloatArray, stepped: bool, step: float = 0.0
) -> StudySensitivity:
    """Analyse the sensitivity of an objective to parameters.

    Args:
        factors: the parameters, all with n plans.
        values: the objective, shape (n,).
        stepped: whether all parameters have steps; with a plan for every combination that occurs, fractions are exact.
        step: spread of the objective up to which it counts as constant.
    """
    count = len(values)
    grid = stepped and _is_grid(factors, count)
    whole = grid and count == int(np.prod([factor.count for factor in factors]))
    varied = [factor for factor in factors if len(np.unique(factor.levels)) > 1]
    spread = float(np.ptp(values)) if count else 0.0
    if count < 2 or spread <= max(step, EFFECT.spread_tolerance * float(np.abs(values).max())):
        note = _note("too_few" if count < 2 else "constant")
        effect = 0.0 if count > 1 else None
        flat = tuple(Influence(f.name, effect, None, None, None) for f in factors)
        return StudySensitivity(count, grid, flat, (), None, (note,))
    slopes, linear_share = _regression(factors, values)
    influences = [
        Influence(
            factor.name,
            _effect(factor, values),
            _share(factor, values, grid),
            slopes.get(factor.name),
            _rank_correlation(factor, values),
        )
        for factor in factors
    ]
    influences.sort(key=lambda influence: -(influence.share or 0.0))
    pairs = _pairs(varied, values) if grid else ()
    notes = _notes(count, factors, linear_share, grid, whole)
    return StudySensitivity(count, grid, tuple(influences), pairs, linear_share, notes)


def _is_grid(factors: Sequence[Factor], count: int) -> bool:
    """Check that every combination of occurring values has exactly one plan."""
    if count == 0:
        return False
    present = [len(np.unique(factor.levels)) for factor in factors]
    combinations_there = np.unique(np.column_stack([f.levels for f in factors]), axis=0)
    return count == int(np.prod(present)) == len(combinations_there)


def level_means(factor: Factor, values: FloatArray) -> tuple[IntArray, FloatArray, IntArray]:
    """Average the objective at each level of a parameter.

    Returns:
        Levels that plans have, the objective's mean at each, and the number of plans at each.
    """
    sums = np.bincount(factor.levels, values, factor.count)
    counts = np.bincount(factor.levels, minlength=factor.count)
    there = np.flatnonzero(counts)
    return there, sums[there] / counts[there], counts[there]


def _effect(factor: Factor, values: FloatArray) -> float | None:
    _, means, _ = level_means(factor, values)
    return float(np.ptp(means)) if len(means) > 1 else None


def _share(factor: Factor, values: FloatArray, grid: bool) -> float | None:
    """Compute the fraction of the variance between a parameter's levels.

    Off a grid, the fraction expected by chance is subtracted.
    """
    _, means, counts = level_means(factor, values)
    if len(means) < 2:
        return None
    total = float(((values - values.mean()) ** 2).sum())
    between = float((counts * (means - values.mean()) ** 2).sum())
    freedom = len(values) - len(means)
    if not grid:
        if freedom < 1:
            return None
        between -= (len(means) - 1) * (total - between) / freedom
    return float(np.clip(between / total, 0.0, 1.0))


def _pairs(factors: Sequence[Factor], values: FloatArray) -> tuple[tuple[str, str, float], ...]:
    """Compute the variance fractions of pairwise interactions on a whole grid.

    The largest comes first.
    """
    total = float(((values - values.mean()) ** 2).sum())
    interactions = []
    for a, b in combinations(factors, 2):
        both = Factor("", a.levels * b.count + b.levels, a.count * b.count, None)
        _, means, counts = level_means(both, values)
        between = float((counts * (means - values.mean()) ** 2).sum()) / total
        main = (_share(a, values, True) or 0.0) + (_share(b, values, True) or 0.0)
        interactions.append((a.name, b.name, float(np.clip(between - main, 0.0, 1.0))))
    return tuple(sorted(interactions, key=lambda pair: -pair[2]))


def _regression(
    factors: Sequence[Factor], values: FloatArray
) -> tuple[dict[str, float], float | None]:
    """Fit a linear regression with standardised coefficients.

    Returns:
        Coefficients by parameter, and the part of the variance that the fit explains. Nothing where there are too few
        plans, or where the plans vary parameters only together.
    """
    columns: list[tuple[str, FloatArray]] = []
    for factor in factors:
        if factor.numbers is not None:
            columns.append((factor.name, factor.numbers))
        else:
            # Every word except the first has an indicator column, so that slopes of numbers are partial.
            columns += [
                ("", (factor.levels == level).astype(np.float64))
                for level in np.unique(factor.levels)[1:]
            ]
    columns = [(name, x) for name, x in columns if np.ptp(x) > 0.0]
    if not columns or len(values) < len(columns) + 2:
        return {}, None
    x = np.column_stack([(c - c.mean()) / c.std() for _, c in columns])
    y = (values - values.mean()) / values.std()
    if np.linalg.matrix_rank(x, tol=1e-6 * len(values)) < x.shape[1]:
        return {}, None
    coefficients = np.linalg.lstsq(x, y, rcond=None)[0]
    share = 1.0 - float(((y - x @ coefficients) ** 2).sum()) / float((y**2).sum())
    slopes = {name: float(b) for (name, _), b in zip(columns, coefficients, strict=True) if name}
    return slopes, float(np.clip(share, 0.0, 1.0))


def _rank_correlation(factor: Factor, values: FloatArray) -> float | None:
    if factor.numbers is None or np.ptp(factor.numbers) <= 0.0:
        return None
    x, y = _ranks(factor.numbers), _ranks(values)
    x, y = x - x.mean(), y - y.mean()
    scale = float(np.sqrt((x @ x) * (y @ y)))
    return float(np.clip((x @ y) / scale, -1.0, 1.0)) if scale > 0.0 else None


def _ranks(values: FloatArray) -> FloatArray:
    """Rank values from 1; values equal up to rounding have their mean rank."""
    from scipy.stats import rankdata

    scale = float(np.abs(values).max()) or 1.0
    return np.asarray(rankdata(np.round(values / scale, 9)))


def _notes(
    count: int, factors: Sequence[Factor], linear_share: float | None, grid: bool, whole: bool
) -> tuple[Note, ...]:
    notes = []
    if count < EFFECT.min_plans_per_parameter * len(factors):
        notes.append(_note("few", plans=count, parameters=len(factors)))
    if grid and not whole:
        notes.append(_note("left_out"))
    if not grid:
        notes.append(_note("estimates"))
    if linear_share is not None and (not grid or linear_share < EFFECT.min_linear_share):
        is_linear = linear_share >= EFFECT.min_linear_share
        notes.append(_note("linear" if is_linear else "not_linear", share=linear_share))
    return tuple(notes)
