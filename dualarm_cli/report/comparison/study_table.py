"""`dualarm sweep` as tables and sentences for the terminal and as CSV."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Column, Table

from dualarm_cli.model.studies.study import OBJECTIVES, Objective
from dualarm_cli.model.verification import exceptions
from dualarm_cli.report.comparison.comparison_table import cell_text, csv_bytes
from dualarm_cli.report.printable import numbers

MAX_ROWS = 25
"""Maximum number of rows in the table; files have all."""
LONGEST_REASON = 300
"""Maximum length of a reason on the terminal and in a cell [characters]."""
STATUS_WORDS = {
    "fails_verification": "failed verification",
    "infeasible": "without a plan",
    "bad_input": "with bad input",
    "internal_error": "ended by an internal error",
    "timed_out": "timed out",
    "crashed": "crashed",
}


def parameter_label(parameter: dict[str, Any]) -> str:
    """Format a parameter's name with its unit."""
    return f"{parameter['name']} [{parameter['unit']}]" if parameter["unit"] else parameter["name"]


def value_text(value: Any) -> str:
    """Format a parameter's value for tables."""
    if isinstance(value, bool):
        return "true" if value else "false"
    return f"{value:.6g}" if isinstance(value, int | float) else str(value)


def rows_table(document: dict[str, Any]) -> Table:
    """Build the table of planned rows, best first, at most MAX_ROWS."""
    named = [OBJECTIVES[entry["name"]] for entry in document["objectives"]]
    others = [objective for name, objective in OBJECTIVES.items() if objective not in named]
    rows = [row for row in document["rows"] if row["rank"] is not None]
    if all(row["torque"] is None for row in rows):
        others = [objective for objective in others if objective.name != "torque"]
    title = f"{document['study']}: {len(rows)} of {document['counts']['points']} points have a plan"
    table = Table(title=escape(title), title_justify="left")
    table.add_column("#", justify="right", no_wrap=True)
    pareto = len(named) > 1
    if pareto:
        table.add_column("P", no_wrap=True)
    for parameter in document["parameters"]:
        side: Any = "right" if parameter["numeric"] else "left"
        table.add_column(escape(parameter_label(parameter)), justify=side)
    for objective in named:
        arrow = {"minimise": "↓", "maximise": "↑"}[objective.sense]
        head = f"{objective_head(objective)} {arrow}"
        table.add_column(head, justify="right", style="bold" if objective is named[0] else "")
    for objective in others:
        table.add_column(objective_head(objective), justify="right", style="dim")
    table.add_column("most time", no_wrap=True)
    for row in rows[:MAX_ROWS]:
        table.add_row(
            str(row["rank"]),
            *(["*" if row["pareto"] else ""] if pareto else []),
            *(escape(value_text(row["values"][p["name"]])) for p in document["parameters"]),
            *(escape(figure_text(o, row)) for o in (*named, *others)),
            escape(most_time(row["jobs"])),
            style="green" if row["pareto"] else "",
        )
    return table


def objective_head(objective: Objective) -> str:
    """Abbreviate an objective for the head of its column."""
    return f"{objective.name.replace('_', ' ')} {objective.shown_unit}"


def figure_text(objective: Objective, row: Mapping[str, Any]) -> str:
    """Format a figure of a row; a torque share has the name of its joint."""
    shown = objective.shown(row[objective.name])
    if objective.name == "torque" and row["torque"] is not None:
        return f"{shown} {torque_joint(row['jobs'])}"
    return shown


def torque_joint(jobs: Sequence[Mapping[str, Any]]) -> str:
    """Name the joint with the largest torque share; empty without torques."""
    worst = max(jobs, key=lambda job: job["torque"] or 0.0)
    return str(worst["torque_joint"])


def most_time(jobs: list[dict[str, Any]]) -> str:
    """Describe the largest share of the cycle."""
    times: dict[str, float] = {}
    for job in jobs:
        for name, time in job["limiting"].items():
            times[name] = times.get(name, 0.0) + time
    whole = sum(times.values())
    if whole <= 0.0:
        return "–"
    name = max(times, key=lambda key: times[key])
    return f"{name} {times[name] / whole:.0%}"


def sentences(document: Mapping[str, Any], every: bool = False) -> list[str]:
    """Compose the sentences with the table: omitted rows, best rows, failures.

    Args:
        document: of `dualarm sweep`.
        every: whether the table has every row.
    """
    planned = [row for row in document["rows"] if row["rank"] is not None]
    lines = []
    if not planned:
        points = document["counts"]["points"]
        lines.append(f"{document['study']}: none of {points} points has a plan")
    if len(planned) > MAX_ROWS and not every:
        lines.append(f"... and {len(planned) - MAX_ROWS} more rows; --csv FILE has all")
    if len(document["objectives"]) > 1 and planned:
        titles = ", ".join(OBJECTIVES[o["name"]].title for o in document["objectives"])
        titles = " and ".join(titles.rsplit(", ", 1))
        lines.append(
            f"*: in the Pareto set ({document['counts']['pareto']}): no other row is as good in {titles} and better in "
            "one of them"
        )
    lines += _best_lines(document, planned)
    caveat_sets = [{caveat for job in row["jobs"] for caveat in job["caveats"]} for row in planned]
    for caveat in sorted(set[str]().union(*caveat_sets)):
        count = sum(caveat in caveats for caveats in caveat_sets)
        lines.append(f"{count} of {len(planned)} plans: verified{exceptions([caveat])}")
    rows = {row["point"]: row for row in document["rows"]}
    for failure in document["failures"]:
        many = f"{failure['count']} point{'s' * (failure['count'] > 1)}"
        prefix = "; of the first" if failure["count"] > 1 else ""
        at = point_text(document, rows[failure["points"][0]])
        lines.append(
            f"{many} {STATUS_WORDS[failure['status']]}{prefix} ({at}): {one_line_reason(failure['example'])}"
        )
    return lines


def one_line_reason(reason: str) -> str:
    """Shorten a reason to one line; the files have all of it."""
    text = ""
    for line in reason.splitlines():
        joint = " " if text.endswith(":") else "; "
        text += f"{joint if text else ''}{line.strip()}"
    return text if len(text) <= LONGEST_REASON else f"{text[:LONGEST_REASON]}…"


def result_line(document: Mapping[str, Any]) -> str:
    """Compose the only line of `sweep --quiet`: planned points and the best row.

    Args:
        document: of `dualarm sweep`.
    """
    planned = [row for row in document["rows"] if row["rank"] is not None]
    count = f"{len(planned)} of {document['counts']['points']} points have a plan"
    return "; ".join([f"{document['study']}: {count}", *_best_lines(document, planned)[:1]])


def _best_lines(document: Mapping[str, Any], planned: list[dict[str, Any]]) -> list[str]:
    """Compose a sentence per objective: its best row, compared with the unchanged files."""
    lines = []
    for entry in document["objectives"]:
        objective = OBJECTIVES[entry["name"]]
        rated = [row for row in planned if row[objective.name] is not None]
        if not rated:
            if planned:
                lines.append(f"{objective.title}: unknown for all plans")
            continue
        best = min(rated, key=lambda row: objective.cost(row[objective.name]))
        of_jobs = f" ({entry['together']} of {len(document['tasks'])} jobs)" * bool(
            entry["together"]
        )
        best_text = _shown(objective, best[objective.name])
        against = _against(objective, best[objective.name], document["reference"])
        if len(rated) > 1 and {_shown(objective, row[objective.name]) for row in rated} == {
            best_text
        }:
            lines.append(f"{objective.title}{of_jobs}: {best_text} for all plans{against}")
        else:
            lines.append(
                f"best {objective.title}{of_jobs}: {best_text} with {point_text(document, best)}{against}"
            )
    return lines


def point_text(document: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """Format the parameter values of a row."""
    return ", ".join(
        f"{p['name']} {value_text(row['values'][p['name']])}{' ' * bool(p['unit'])}{p['unit']}"
        for p in document["parameters"]
    )


def _shown(objective: Objective, value: float) -> str:
    return f"{objective.shown(value)} {objective.shown_unit}"


def _against(objective: Objective, value: float, reference: dict[str, Any]) -> str:
    """Format the improvement over the unchanged files."""
    base = reference[objective.name]
    if base is None:
        return f"; the unchanged files: {STATUS_WORDS[reference['status']]}"
    if objective.name == "cycle_time" and base > 0.0:
        change = value / base - 1.0
        return f"; the unchanged files: {_shown(objective, base)} ({change:+.1%})"
    return f"; the unchanged files: {_shown(objective, base)}"


def sensitivity_table(document: dict[str, Any]) -> Table:
    """Build the table of each parameter's effect on each objective."""
    figures = numbers("main effect", "share", "slope", "rank corr.", no_wrap=True)
    first = Column("objective", no_wrap=True)
    table = Table(first, "parameter", *figures, title="what matters", title_justify="left")
    for section in document["sensitivity"]:
        objective = OBJECTIVES[section["objective"]]
        for k, parameter in enumerate(section["parameters"]):
            effect = parameter["main_effect"]
            table.add_row(
                objective.title if k == 0 else "",
                escape(parameter["name"]),
                "–" if effect is None else _shown(objective, effect),
                _percent(parameter["share"]),
                _signed(parameter["slope"]),
                _signed(parameter["rank_correlation"]),
                end_section=k == len(section["parameters"]) - 1,
            )
    return table


SENSITIVITY_WORDS = (
    "main effect: largest minus least mean over the parameter's values; share: of the variance; "
    "slope: standardised regression; rank corr.: Spearman"
)
"""Legend of the table's columns."""


def sensitivity_sentences(document: dict[str, Any]) -> list[str]:
    """Compose sentences on the reliability of the sensitivities, and on interactions."""
    noted: dict[str, list[str]] = {}
    for section in document["sensitivity"]:
        for note in section["notes"]:
            noted.setdefault(note, []).append(OBJECTIVES[section["objective"]].title)
    lines = []
    for note, titles in noted.items():
        whose = "" if len(titles) == len(document["sensitivity"]) else f"{', '.join(titles)}: "
        lines.append(f"note: {whose}{note}")
    for section in document["sensitivity"]:
        title = OBJECTIVES[section["objective"]].title
        strong = [pair for pair in section["interactions"] if pair["share"] >= 0.05]
        lines += [
            f"{title}: {' and '.join(pair['between'])} act together: {pair['share']:.0%} of the variance"
            for pair in strong
        ]
    return lines


def _percent(share: float | None) -> str:
    return "–" if share is None else f"{share:.0%}"


def _signed(value: float | None) -> str:
    return "–" if value is None else f"{value:+.2f}"


def study_csv(document: dict[str, Any]) -> bytes:
    """Write all rows as CSV: best first, unplanned last; SI units, parameters in theirs."""
    jobs = document["tasks"] if len(document["tasks"]) > 1 else []
    table = [
        [
            "rank",
            "status",
            "pareto",
            *(cell_text(parameter_label(parameter)) for parameter in document["parameters"]),
            *OBJECTIVES,
            *(cell_text(f"cycle_time {job}") for job in jobs),
            "torque_joint",
            "most_time",
            "caveats",
            "reason",
        ]
    ]
    for row in document["rows"]:
        values = [row["values"][parameter["name"]] for parameter in document["parameters"]]
        cells = [row["rank"], row["status"], int(row["pareto"]), *values]
        cells += [row[name] for name in OBJECTIVES]
        cells += [job["cycle_time"] for job in row["jobs"]] if jobs else []
        planned = row["rank"] is not None
        cells += [
            torque_joint(row["jobs"]) or None if planned else None,
            most_time(row["jobs"]) if planned else None,
            "; ".join(dict.fromkeys(text for job in row["jobs"] for text in job["caveats"])),
            one_line_reason("; ".join(row["reasons"])) or None,
        ]
        table.append([cell_text(cell) for cell in cells])
    return csv_bytes(table)
