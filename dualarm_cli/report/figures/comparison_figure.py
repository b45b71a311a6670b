"""The figure of `dualarm compare solvers`: components of each cycle time, and the bound."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import PurePath
from typing import Any

from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.records import dataclass
from dualarm_cli.report.comparison.comparison import (
    SHOWN,
    group_name,
    row_namer,
    section_title,
    share_text,
)
from dualarm_cli.report.measures import DWELLS, LINES, NO_TRANSFERS, REMAINDER
from dualarm_cli.report.stage_parts import PLATFORM


@dataclass(frozen=True)
class ComparisonStyle:
    """Sizes and colours of the figure."""

    bar: float = 0.3
    panel: float = 1.0
    """Height of a bar's row and of a panel's title and axis [inch]."""
    curves: float = 3.2
    """Height of the row of a path's curves [inch]."""
    not_fully: str = "#b26a00"
    """Amber of plans with open checks, in a bar's outline and text."""


STYLE = ComparisonStyle()


COLOURS = {
    "left": "#1f5fbf",
    "right": "#c23b22",
    PLATFORM: "#2a7f3f",
    LINES: "#8f8f8f",
    DWELLS: "#d3d3d3",
    "paths": "#8a5fb0",
    "seams": "#d98c2b",
    REMAINDER: "#f0e0a0",
}
"""Colours by deciding group; the arms as in every other figure."""


def draw_comparison(document: Mapping[str, Any], kind: str) -> bytes:
    """Draw a panel per task file with a bar per plan.

    The format is PNG, SVG or PDF.

    Args:
        document: of `dualarm compare solvers`; wall-clock times are not drawn, which keeps the bytes reproducible.
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    sections = document["comparisons"]
    heights = [STYLE.panel + STYLE.bar * max(1, len(section["rows"])) for section in sections]
    curves = [(section, task) for section in sections for task in _compared_paths(section)]
    whole = new_figure(10.0, sum(heights) + 0.5 + STYLE.curves * len(curves))
    parts = whole.subfigures(
        1 + len(curves),
        1,
        squeeze=False,
        height_ratios=[sum(heights) + 0.5, *[STYLE.curves] * len(curves)],
    )[:, 0]
    for part, (section, task) in zip(parts[1:], curves, strict=True):
        _draw_curves(part, section, task)
    figure = parts[0]
    panels = figure.subplots(len(sections), 1, squeeze=False, height_ratios=heights)[:, 0]
    names = _short_names([section["tasks"] for section in sections])
    drawn: dict[str, Any] = {}
    for panel, section, name in zip(panels, sections, names, strict=True):
        drawn |= _draw_section(panel, section, name)
    order = [label for label in _labels() if label in drawn]
    if order:
        figure.legend(
            [drawn[label] for label in order],
            order,
            loc="outside lower center",
            ncols=4,
            frameon=False,
        )
    return rendered(whole, kind)


def _compared_paths(section: dict[str, Any]) -> list[str]:
    """List the paths of a task file that several plans follow."""
    rows = [row["path_curves"] for row in section["rows"] if row["path_curves"]]
    return [path["task"] for path in rows[0]] if len(rows) > 1 else []


def _draw_curves(part: Any, section: dict[str, Any], task: str) -> None:
    """Draw one path by every method.

    Panels are the contraction force ([Choi2020] Fig. 11) and the manipulability ([Zhang2024] Fig.
    4).
    """
    called = row_namer(section["rows"])
    curves = [
        (called(row), path)
        for row in section["rows"]
        for path in row["path_curves"]
        if path["task"] == task
    ]
    sprung = any(path["force"] for _, path in curves)
    panels = part.subplots(1, 3 if sprung else 2)
    for k, (name, path) in enumerate(curves):
        # Later curves are thinner, so that those below them stay visible.
        look = {"color": f"C{k % 10}", "linewidth": 1.0 + 0.5 * (len(curves) - 1 - k)}
        panels[-1].plot(path["time"], path["manipulability_together"], **look, label=name)
        for panel, values in zip(
            panels, [*[path["force"]] * sprung, path["manipulability"]], strict=False
        ):
            for arm, value in values.items():
                panel.plot(path["time"], value, linestyle="--" if arm == "right" else "-", **look)
    titles = ["contraction force K D [m]"] * sprung
    titles += ["M of each arm [m³/rad³]", "M of all tools together"]
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=9)
        panel.set_xlabel("time [s]")
    part.suptitle(f"path {task} (solid: left, dashed: right)", fontsize=10)
    part.legend(*panels[-1].get_legend_handles_labels(), loc="outside right center", fontsize=8)


def _labels() -> list[str]:
    return [_label(name) for name in COLOURS] + [
        "lower bound",
        "not fully checked",
        "fails its verification",
    ]


def _label(name: str) -> str:
    if name in NO_TRANSFERS:
        return "waiting" if name == REMAINDER else name
    return f"transfers, {group_name(name)} decides"


def _draw_section(panel: Any, section: dict[str, Any], name: str) -> dict[str, Any]:
    """Draw one task file's panel; return one artist per label."""
    rows, called = section["rows"], row_namer(section["rows"])
    drawn: dict[str, Any] = {}
    best = next((row["cycle_time"] for row in rows if row["status"] == "verified"), None)
    longest = max((row["cycle_time"] or 0.0 for row in rows), default=0.0) or 1.0
    for place, row in enumerate(rows):
        if row["cycle_time"] is None:
            panel.text(
                0.01 * longest,
                place,
                f"{row['status']}: {_short(row['reason'])}",
                va="center",
                color="0.45",
                style="italic",
            )
            continue
        drawn |= _draw_bar(panel, place, row)
        panel.text(
            row["cycle_time"] + 0.008 * longest,
            place,
            _bar_text(row, best),
            va="center",
            weight="bold" if _is_best(row, best) else "normal",
            color=STYLE.not_fully if row["caveats"] else "black",
        )
    bound = section["lower_bound"]
    if bound is not None:
        drawn["lower bound"] = panel.axvline(bound, color="black", linestyle="--", linewidth=1.2)
        panel.text(bound, -0.62, f"bound {bound:.2f} s", ha="center", va="bottom", fontsize=8)
    panel.set_yticks(range(len(rows)), [called(row) for row in rows])
    panel.set_ylim(len(rows) - 0.4, -0.6)
    panel.set_xlim(0.0, 1.17 * longest)
    panel.spines[["top", "right"]].set_visible(False)
    panel.tick_params(axis="y", length=0)
    panel.set_xlabel("period [s]" if section["closes"] else "duration [s]")
    panel.set_title(
        section_title(section, name),
        loc="left",
        pad=14,
        weight="bold",
    )
    return drawn


def _draw_bar(panel: Any, place: int, row: dict[str, Any]) -> dict[str, Any]:
    """Draw the components of one plan's duration; a failed plan is hatched."""
    drawn: dict[str, Any] = {}
    if row["status"] == "failed":
        bar = panel.barh(
            place, row["cycle_time"], 0.7, color="#ffffff", edgecolor="#c23b22", hatch="///"
        )
        return {"fails its verification": bar}
    left = 0.0
    for name, colour in COLOURS.items():
        time = row["deciding_time"].get(name, 0.0)
        if time > 0.0:
            bar = panel.barh(
                place, time, 0.7, left=left, color=colour, edgecolor="white", linewidth=0.5
            )
            drawn[_label(name)] = bar
            left += time
    if row["caveats"]:
        outline = {"facecolor": "none", "edgecolor": STYLE.not_fully, "linewidth": 1.6}
        drawn["not fully checked"] = panel.barh(place, row["cycle_time"], 0.7, **outline)
    return drawn


def _bar_text(row: dict[str, Any], best: float | None) -> str:
    text = f"{row['cycle_time']:.2f} s"
    if row["status"] == "failed" or best is None:
        return f"{text}, fails"
    if _is_best(row, best):
        return text
    return f"{text}  +{share_text(row['cycle_time'] / best - 1.0)}"


def _is_best(row: dict[str, Any], best: float | None) -> bool:
    return best is not None and row["status"] == "verified" and row["cycle_time"] - best <= SHOWN


def _short(reason: str) -> str:
    """Shorten a reason to its first line and the panel's width."""
    line = reason.split("\n", maxsplit=1)[0]
    return line if len(line) <= 90 else f"{line[:89]}…"


def _short_names(names: list[str]) -> list[str]:
    """Distinguish task files by name, or by folder for equal names."""
    paths = [PurePath(name) for name in names]
    for shorten in (
        lambda path: path.parent.name if path.stem == "tasks" and path.parent.name else path.stem,
        lambda path: "/".join(path.parts[-2:]),
    ):
        short = [shorten(path) for path in paths]
        if len(set(short)) == len(short):
            return short
    return names
