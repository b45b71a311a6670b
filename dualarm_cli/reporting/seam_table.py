"""What was measured of seams, for people: sentences of one plan, and the table of `dualarm compare solvers`."""

from __future__ import annotations

import math
from typing import Any

from rich.markup import escape
from rich.table import Table

STANDS_WAY, STANDS_TURN = 1e-6, 1e-6
"""A part that moves and turns less stands [m, rad]."""


def seam_lines(report: dict[str, Any]) -> list[str]:
    """Returns a sentence for every seam of a report.

    Args:
        report: as built by `build_report`.
    """
    lines = []
    for seam in report["seams"]:
        least = ", ".join(f"{arm} {m:.4g}" for arm, m in seam["least_manipulability"].items())
        start, end = seam["ramps"]
        lines.append(
            f"seam {seam['task']} by {seam['method']}: {seam['length'] * 1e3:.1f} mm at "
            f"{seam['speed'] * 1e3:.4g} mm/s in {seam['duration']:.3f} s "
            f"(ramps {start:.2f} and {end:.2f} s); chain closed to {_closed(seam)}; {part_words(seam)}; "
            + (
                f"tool leans up to {math.degrees(seam['lean']):.1f} deg; "
                if seam["lean"] > 1e-6
                else ""
            )
            + f"least manipulability {least}; {seam['limit_joint']} comes within "
            f"{math.degrees(seam['limit_room']):.1f} deg of its limit, {seam['speed_joint']} uses "
            f"{seam['speed_share']:.0%} of its speed"
        )
    return lines


def _closed(seam: dict[str, Any]) -> str:
    """Returns how far the chain is open; below a nanometre it means nothing."""
    off = seam["residual"]
    away = f"{off * 1e6:.2f} um" if off >= 1e-8 else f"{max(off * 1e9, 1.0):.0f} nm"
    return f"{away} and {seam['residual_angle'] * 1e6:.2f} urad"


def part_words(seam: dict[str, Any]) -> str:
    """Returns whether the part stands or how far it moves."""
    x, y, z = seam["part_xyz"]
    roll, pitch, yaw = (math.degrees(angle) for angle in seam["part_rpy"])
    where = f"xyz [{x:.4f}, {y:.4f}, {z:.4f}] m, rpy [{roll:.2f}, {pitch:.2f}, {yaw:.2f}] deg"
    if seam["part_way"] < STANDS_WAY and seam["part_turn"] < STANDS_TURN:
        platform = math.degrees(seam["platform_travel"])
        turns = f", the platform turns {platform:.1f} deg" if platform > 0.05 else ""
        return f"the part stands at {where}{turns}"
    way, turn = seam["part_way"] * 1e3, math.degrees(seam["part_turn"])
    return f"the part moves {way:.0f} mm and turns {turn:.0f} deg from {where}"


def seams_table(section: dict[str, Any]) -> Table | None:
    """Returns the table of how each solver works a task file's seams; None where it has none.

    Args:
        section: one member of the comparison's `comparisons`.
    """
    rows = [row for row in section["rows"] if row["seams"]]
    if not rows:
        return None
    names = {seam["task"] for row in rows for seam in row["seams"]}
    what = "seams" if len(names) > 1 else f"seam {next(iter(names))}"
    table = Table(title=escape(f"{section['tasks']}: {what}"), title_justify="left")
    for name in [*(["seam"] if len(names) > 1 else []), "solver"]:
        table.add_column(name, no_wrap=True)
    columns = ("mm/s", "s", "part mm", "part °", "chain um", "M master", "M slave", "travel °")
    for name in (*columns, "room °", "speed", "clear mm"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in rows:
        for seam in row["seams"]:
            least, clear = seam["least_manipulability"], seam["clearance"]
            master = least.get(seam["master"])
            table.add_row(
                *([escape(seam["task"])] if len(names) > 1 else []),
                seam["method"],
                f"{seam['speed'] * 1e3:.4g}",
                f"{seam['duration']:.3f}",
                f"{seam['part_way'] * 1e3:.0f}",
                f"{math.degrees(seam['part_turn']):.0f}",
                f"{seam['residual'] * 1e6:.2f}",
                "–" if master is None else f"{master:.3g}",
                f"{least[seam['slave']]:.3g}",
                f"{math.degrees(seam['joint_travel']):.0f}",
                f"{math.degrees(seam['limit_room']):.1f}",
                f"{seam['speed_share']:.0%}",
                "–" if clear is None else f"{clear * 1e3:.1f}",
            )
    return table
