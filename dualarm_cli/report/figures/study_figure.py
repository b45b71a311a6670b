"""Figures of `dualarm sweep`: trade-offs (Pareto set) and effects of parameters (sensitivity)."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.model.studies.study import OBJECTIVES, Objective
from dualarm_cli.records import dataclass
from dualarm_cli.report.comparison.study_table import parameter_label, value_text


@dataclass(frozen=True)
class StudyStyle:
    """Sizes and limits of a study's figure."""

    most_panels: int = 5
    """Maximum number of parameters with a panel, those with the largest effect."""
    most_labels: int = 10
    """Maximum number of points of the Pareto set with a label."""
    most_ticks: int = 7
    """Maximum number of parameter values written below an axis."""
    least_steps: int = 10
    """Smallest span of an axis, in steps of its objective.

    Small differences do not fill the figure.
    """
    wide: float = 8.0
    """Minimum width for a title in one line [inch]."""
    longest: int = 24
    """Maximum length of a name [characters]."""
    best: str = "#c23b22"
    neutral: str = "#9a9a9a"
    reference: str = "black"
    colours: tuple[str, ...] = ("#1f5fbf", "#2a7f3f", "#c23b22", "#8a5fb0")
    """Colours by objective."""
    words: tuple[str, ...] = ("#1f5fbf", "#d98c2b", "#2a7f3f", "#8a5fb0", "#5fb0a8", "#8f6f4f")
    """Colours by value of a parameter with words."""


STYLE = StudyStyle()


def draw_pareto(document: dict[str, Any], kind: str) -> bytes:
    """Draw the trade-offs: one panel for the first objective with each other one.

    Args:
        document: of `dualarm sweep`, with two objectives or more.
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    objectives = [OBJECTIVES[entry["name"]] for entry in document["objectives"]]
    pairs = [(objectives[0], objective) for objective in objectives[1:]]
    figure = new_figure(6.2 * len(pairs), 5.0)
    panels = figure.subplots(1, len(pairs), squeeze=False)[0]
    drawn: dict[str, Any] = {}
    colour = _colour_parameter(document)
    mapped = None
    for panel, (x, y) in zip(panels, pairs, strict=True):
        mapped = _draw_pair(panel, document, (x, y), colour, drawn) or mapped
    if mapped is not None and colour is not None:
        figure.colorbar(mapped, ax=list(panels), label=_short(parameter_label(colour)), shrink=0.9)
    if drawn:
        figure.legend(
            list(drawn.values()), list(drawn), loc="outside lower center", ncols=4, frameon=False
        )
    counts = document["counts"]
    title = f"{counts['planned']} of {counts['points']} points have a plan, {counts['pareto']} in the Pareto set"
    figure.suptitle(title, x=0.01, ha="left", weight="bold", fontsize=10)
    return rendered(figure, kind)


def _draw_pair(
    panel: Any,
    document: dict[str, Any],
    pair: tuple[Objective, Objective],
    colour: dict[str, Any] | None,
    drawn: dict[str, Any],
) -> Any:
    """Draw all rows by two objectives.

    Returns the source of a colour bar, if any.
    """
    x, y = pair
    rows = [
        row for row in document["rows"] if row["rank"] and None not in (row[x.name], row[y.name])
    ]
    best = [row for row in rows if row["pareto"]]
    mapped = _draw_rows(panel, rows, pair, colour, drawn)
    if best:
        drawn["Pareto set"] = panel.scatter(
            _column(best, x), _column(best, y), s=90, facecolors="none", edgecolors=STYLE.best,
            linewidths=1.6, zorder=3,
        )  # fmt: skip
        if len(document["objectives"]) == 2:
            _draw_front(panel, best, pair)
        _label(panel, best, pair)
    reference = document["reference"]
    if None not in (reference[x.name], reference[y.name]):
        drawn["the unchanged files"] = panel.scatter(
            _column([reference], x), _column([reference], y), s=70, marker="x", color=STYLE.reference,
            linewidths=1.8, zorder=4,
        )  # fmt: skip
    for axis, objective in (("x", x), ("y", y)):
        arrow = "◂ better" if objective.sense == "minimise" else "better ▸"
        getattr(panel, f"set_{axis}label")(f"{objective.label}   {arrow}")
    panel.grid(color="0.92", zorder=0)
    panel.set_axisbelow(True)
    panel.margins(0.09)
    _widen(panel, "x", x)
    _widen(panel, "y", y)
    panel.spines[["top", "right"]].set_visible(False)
    return mapped


def _widen(panel: Any, axis: str, objective: Objective) -> None:
    """Widen an axis about its middle to `least_steps` steps of its objective."""
    low, high = getattr(panel, f"get_{axis}lim")()
    least = STYLE.least_steps * objective.step * objective.shown_factor
    if high - low < least:
        middle = (low + high) / 2.0
        getattr(panel, f"set_{axis}lim")(middle - least / 2.0, middle + least / 2.0)


def _draw_rows(
    panel: Any,
    rows: list[dict[str, Any]],
    pair: tuple[Objective, Objective],
    colour: dict[str, Any] | None,
    drawn: dict[str, Any],
) -> Any:
    """Draw a point per row, coloured by a parameter.

    Numbers use a colour scale, which is returned; words use one colour each.
    """
    x, y = pair
    if colour is None or not rows:
        if rows:
            drawn["plans"] = panel.scatter(
                _column(rows, x), _column(rows, y), s=34, c=STYLE.neutral
            )
        return None
    name = colour["name"]
    if colour["numeric"]:
        hues = [row["values"][name] for row in rows]
        return panel.scatter(
            _column(rows, x), _column(rows, y), s=34, c=hues, cmap="viridis", linewidths=0, zorder=2
        )
    for k, value in enumerate(colour["values"]):
        matching = [row for row in rows if row["values"][name] == value]
        label = _short(f"{name}: {value_text(value)}")
        drawn[label] = panel.scatter(
            _column(matching, x),
            _column(matching, y),
            s=34,
            color=STYLE.words[k],
            linewidths=0,
            zorder=2,
        )
    return None


def _draw_front(panel: Any, best: list[dict[str, Any]], pair: tuple[Objective, Objective]) -> None:
    """Draw the boundary of the Pareto set as steps."""
    x, y = pair
    rows = sorted(best, key=lambda row: (row[x.name], row[y.name]))
    # Between two points only the worse y of both is reachable: with rising x, the previous y.
    where = "post" if x.sense == "minimise" else "pre"
    panel.step(
        _column(rows, x), _column(rows, y), where=where, color=STYLE.best, linewidth=1.0, alpha=0.6
    )


def _label(panel: Any, best: list[dict[str, Any]], pair: tuple[Objective, Objective]) -> None:
    """Label points with their ranks, each position once."""
    x, y = pair
    places: dict[tuple[float, float], list[str]] = {}
    for row in best[: STYLE.most_labels]:
        place = round(row[x.name] * x.shown_factor, 6), round(row[y.name] * y.shown_factor, 6)
        places.setdefault(place, []).append(f"#{row['rank']}")
    for place, words in places.items():
        text = ", ".join(words[:3]) + ("…" if len(words) > 3 else "")
        panel.annotate(
            text, place, xytext=(7, 6), textcoords="offset points", fontsize=8, color=STYLE.best, zorder=5,
            bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "alpha": 0.75, "linewidth": 0},
        )  # fmt: skip


def _column(rows: list[dict[str, Any]], objective: Objective) -> list[float]:
    return [row[objective.name] * objective.shown_factor for row in rows]


def _colour_parameter(document: dict[str, Any]) -> dict[str, Any] | None:
    """Find the parameter with the largest effect that colours can distinguish."""
    by_name = {parameter["name"]: parameter for parameter in document["parameters"]}
    ordered = [by_name[effect["name"]] for effect in document["sensitivity"][0]["parameters"]]
    return next((p for p in ordered if p["numeric"] or len(p["values"]) <= len(STYLE.words)), None)


def draw_sensitivity(document: dict[str, Any], kind: str) -> bytes:
    """Draw the effects of parameters: a row per objective, with shares and main effects.

    Args:
        document: of `dualarm sweep`.
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    sections = document["sensitivity"]
    order = [effect["name"] for effect in sections[0]["parameters"]][: STYLE.most_panels]
    width = 2.9 + 2.7 * len(order)
    figure = new_figure(width, 0.5 + 2.7 * len(sections))
    grid = figure.subplots(
        len(sections),
        1 + len(order),
        squeeze=False,
        width_ratios=[1.1, *([1.0] * len(order))],
    )
    by_name = {parameter["name"]: parameter for parameter in document["parameters"]}
    for k, (section, panels) in enumerate(zip(sections, grid, strict=True)):
        objective = OBJECTIVES[section["objective"]]
        rows = [r for r in document["rows"] if r["rank"] and r[objective.name] is not None]
        colour = STYLE.colours[k % len(STYLE.colours)]
        _draw_shares(panels[0], section, objective, colour)
        for panel, name in zip(panels[1:], order, strict=True):
            _draw_effect(panel, rows, by_name[name], objective, colour)
            if panel is not panels[1]:
                panel.sharey(panels[1])
                panel.tick_params(labelleft=False)
            panel.set_xlabel(_short(parameter_label(by_name[name])))
        panels[1].set_ylabel(objective.label)
        _widen(panels[1], "y", objective)
    omitted = len(sections[0]["parameters"]) - len(order)
    more = f"; the {omitted} with the smallest effect have no panel" if omitted else ""
    figure.suptitle(
        f"what matters: shares of the variance;{' ' if width >= STYLE.wide else chr(10)}"
        f"every plan (points) with the means per value (bars){more}",
        x=0.01, ha="left", weight="bold", fontsize=10,
    )  # fmt: skip
    return rendered(figure, kind)


def _draw_shares(panel: Any, section: dict[str, Any], objective: Objective, colour: str) -> None:
    """Draw bars of the variance's shares, with interactions if known."""
    bars = [(_short(effect["name"]), effect["share"], colour) for effect in section["parameters"]]
    together = sum(pair["share"] for pair in section["interactions"])
    if section["interactions"]:
        bars.append(("pairs together", together, STYLE.neutral))
    names = [bar[0] for bar in bars]
    panel.barh(
        range(len(bars)), [bar[1] or 0.0 for bar in bars], 0.62, color=[bar[2] for bar in bars]
    )
    for place, (_, share, _colour) in enumerate(bars):
        text = "–" if share is None else f"{share:.0%}"
        panel.text((share or 0.0) + 0.02, place, text, va="center", fontsize=8)
    panel.set_yticks(range(len(bars)), names)
    panel.set_ylim(max(len(bars), 3) - 0.4, -0.6)
    panel.set_xlim(0.0, 1.18)
    panel.set_xticks([0.0, 0.5, 1.0], ["0", "50%", "100%"])
    panel.tick_params(axis="y", length=0)
    panel.spines[["top", "right"]].set_visible(False)
    panel.set_title(objective.title, loc="left", fontsize=9)


def _draw_effect(
    panel: Any,
    rows: list[dict[str, Any]],
    parameter: dict[str, Any],
    objective: Objective,
    colour: str,
) -> None:
    """Draw an objective over one parameter: every plan, and the mean of each value."""
    values = parameter["values"]
    row_values = [row["values"][parameter["name"]] for row in rows]
    x = np.array(
        row_values if parameter["numeric"] else [values.index(v) for v in row_values],
        dtype=np.float64,
    )
    y = np.array(_column(rows, objective))
    panel.scatter(x, y, s=16, color=colour, alpha=0.45, linewidths=0)
    centres, means = _means(x, y, None if values is None else len(values))
    # Words have no order, so no line connects them.
    width = 1.6 if parameter["numeric"] else 0.0
    panel.plot(
        centres, means, color=colour, linewidth=width, marker="_", markersize=13, markeredgewidth=2
    )
    if not parameter["numeric"]:
        panel.set_xticks(range(len(values)), [_short(value_text(value)) for value in values])
    elif values is not None and len(values) <= STYLE.most_ticks:
        panel.set_xticks(sorted(values), [value_text(value) for value in sorted(values)])
    panel.margins(0.1)
    panel.grid(axis="y", color="0.92")
    panel.set_axisbelow(True)
    panel.spines[["top", "right"]].set_visible(False)


def _means(x: Any, y: Any, levels: int | None) -> tuple[Any, Any]:
    """Compute means of y by x value, or in up to four bins."""
    if not len(x):
        return [], []
    if levels is not None:
        centres, places = np.unique(x, return_inverse=True)
    else:
        parts = int(np.clip(len(x) // 4, 1, 4))
        edges = np.linspace(x.min(), x.max(), parts + 1)
        places = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, parts - 1)
        centres = (edges[:-1] + edges[1:]) / 2.0
    counts = np.bincount(places, minlength=len(centres))
    there = counts > 0
    sums = np.bincount(places, y, len(centres))
    return centres[there], sums[there] / counts[there]


def _short(text: str) -> str:
    """Shorten a name and escape formulas."""
    short = text if len(text) <= STYLE.longest else f"{text[: STYLE.longest - 1]}…"
    return short.replace("$", r"\$")
