"""What was measured of paths, for people: sentences of one plan, and the table of `dualarm compare solvers`."""

from __future__ import annotations

import math
from typing import Any

from rich.markup import escape
from rich.table import Table


def path_lines(report: dict[str, Any]) -> list[str]:
    """Returns a sentence for every path of a report.

    Args:
        report: as built by `build_report`.
    """
    lines = []
    for path in report["paths"]:
        springs = path["method"].startswith("virtual_spring")
        least = path["least_elbow_distance"]
        elbows = ", ".join(
            f"{arm} {distance * 1e3:.0f} mm"
            + (
                f" (at least {least[arm] * 1e3:.0f} mm with tools and platform there)"
                if least is not None
                else ""
            )
            for arm, distance in path["elbow_distance"].items()
        )
        each = ", ".join(f"{arm} {value:.4g}" for arm, value in path["manipulability"].items())
        lines.append(
            f"path {path['task']} by {path['method']}: {path['length'] * 1e3:.1f} mm in {path['duration']:.3f} s; "
            f"tools within {_small(path['tool_error'])} of it; "
            + (f"elbows from their critical points on average {elbows}; " if springs else "")
            + f"mean manipulability {each}, together {path['manipulability_together']:.4g}; "
            f"joints travel {math.degrees(path['joint_travel']):.0f} deg in all, "
            f"{path['limit_joint']} comes within {math.degrees(path['limit_room']):.1f} deg of its limit, "
            f"{path['speed_joint']} uses {path['speed_share']:.0%} of its speed"
        )
    return lines


def _small(length: float) -> str:
    """Returns a small length in a unit that shows it; below a nanometre it means nothing."""
    if length >= 1e-4:
        return f"{length * 1e3:.2f} mm"
    if length >= 1e-7:
        return f"{length * 1e6:.1f} um"
    return f"{length * 1e9:.0f} nm" if length >= 1e-9 else "< 1 nm"


def paths_table(section: dict[str, Any]) -> Table | None:
    """Returns the table of how each method follows a task file's paths; None where it has none.

    Args:
        section: one member of the comparison's `comparisons`.
    """
    rows = [row for row in section["rows"] if row["paths"]]
    if not rows:
        return None
    methods = len({row["method"] for row in rows}) > 1
    names = {path["task"] for row in rows for path in row["paths"]}
    what = "paths" if len(names) > 1 else f"path {next(iter(names))}"
    table = Table(title=escape(f"{section['tasks']}: {what}"), title_justify="left")
    texts = [*(["path"] if len(names) > 1 else []), *(["method"] if methods else []), "follower"]
    for name in texts:
        table.add_column(name, no_wrap=True)
    columns = ("tool", "elbow mm", "least", "M", "least M", "travel °", "room °")
    for name in (*columns, "speed", "clear mm"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        for path in row["paths"]:
            elbows = list(path["elbow_distance"].values())
            least = list((path["least_elbow_distance"] or {}).values())
            clear = path["clearance"]
            table.add_row(
                *([escape(path["task"])] if len(names) > 1 else []),
                *([row["method"]] if methods else []),
                path["method"],
                _small(path["tool_error"]),
                f"{sum(elbows) / len(elbows) * 1e3:.1f}",
                f"{sum(least) / len(least) * 1e3:.1f}" if least else "–",
                f"{path['manipulability_together']:.4g}",
                f"{path['least_manipulability_together']:.4g}",
                f"{math.degrees(path['joint_travel']):.0f}",
                f"{math.degrees(path['limit_room']):.1f}",
                f"{path['speed_share']:.0%}",
                "–" if clear is None else f"{clear * 1e3:.1f}",
            )
    return table
