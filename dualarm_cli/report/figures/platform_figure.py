"""Figures of one platform move, and of the reach of both arms.

The figure of a move has the arms before and after, and the platform angle's effect on the elbows. That of the reach has
a table seen from above, and its areas over the platform's position.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.model.cell import Cell
from dualarm_cli.platform_angle.problem import (
    Kind,
    PlatformProblem,
    cosine_coefficients,
    elbow_cosine,
)
from dualarm_cli.platform_angle.table import MethodRow

COLOURS = ("#1f5fbf", "#c23b22")
"""Colours of arm 1 and arm 2."""
BALANCE = "#2a7f3f"
REACH = {"left": ("#1f5fbf", "Blues"), "right": ("#c23b22", "Reds"), "both": ("#2a7f3f", "Greens")}
"""Colours by reaching arms, and colour scales for the number of platform positions."""


def draw_move(
    problem: PlatformProblem, rows: list[MethodRow], start: FloatArray, kind: str
) -> bytes:
    """Draw one move as PNG, SVG or PDF, with reproducible bytes.

    For the paper's input its panels are Figures 2 to 5 of [Bottin2021].

    Args:
        problem: the move.
        rows: candidates of all methods.
        start: wrist centres before the move in the platform's axis frame [m], shape (2, 3).
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    figure = new_figure(12, 8)
    axes = figure.subplot_mosaic(
        [["before", "equation", "equation"], ["one", "two", "elbows"]],
        width_ratios=[1, 1, 1.15],
    )
    chosen = _shown(rows)
    angle_0 = float(problem.angle_0[0])
    _draw_arms(axes["before"], problem, start, angle_0)
    _draw_targets(axes["before"], problem)
    axes["before"].set_title("before the move (crosses: targets)")
    _draw_equation(axes["equation"], problem, rows)
    _draw_elbows(axes["elbows"], problem, rows)
    numbers = [row for row in rows if row.method == "linearised"]
    for name, row in zip(("one", "two"), chosen, strict=False):
        ax = axes[name]
        _draw_shoulder_before(ax, problem, angle_0)
        _draw_arms(ax, problem, start, angle_0, faint=True)
        _draw_arms(ax, problem, problem.wrist[0], row.angle)
        _draw_targets(ax, problem)
        number = numbers.index(row) + 1
        ax.set_title(f"{row.method}, N = {number}: turn {np.degrees(row.turn):+.2f}°")
    for name in ("before", "one", "two"):
        axes[name].set_aspect("equal")
        axes[name].set_xlabel("x [m]")
    axes["before"].set_ylabel("y [m]")
    axes["one"].set_ylabel("y [m]")
    # One legend below all panels, which hides no curve.
    named = [axes[name].get_legend_handles_labels() for name in ("one", "equation", "elbows")]
    entries = {
        label: line for lines, labels in named for line, label in zip(lines, labels, strict=True)
    }
    figure.legend(list(entries.values()), list(entries), loc="outside lower center", ncols=5)
    return rendered(figure, kind)


def _draw_shoulder_before(ax: Any, problem: PlatformProblem, angle: float) -> None:
    """Draw the shoulder before the move, green as in [Bottin2021] Figure 5.

    It is the first shoulder.
    """
    azimuth, radius = angle + problem.offset[0, 0], problem.radius[0, 0]
    x, y = radius * np.cos(azimuth), radius * np.sin(azimuth)
    ax.plot([0.0, x], [0.0, y], color=BALANCE, linewidth=2, label="first shoulder before the move")


def _shown(rows: list[MethodRow]) -> list[MethodRow]:
    """Select the two drawn candidates: the paper's first root and its choice.

    For the paper's input these are numbers 1 and 3 of its Table 2, as in its Figure 5.
    """
    roots = [r for r in rows if r.method == "linearised" and r.difference is not None]
    chosen = [row for row in roots if row.chosen]
    others = [row for row in roots if not row.chosen]
    return (others[:1] + chosen)[:2]


def _draw_arms(
    ax: Any, problem: PlatformProblem, wrist: FloatArray, angle: float, faint: bool = False
) -> None:
    """Draw platform, shoulders and both arms along the platform's axis."""
    style = {"alpha": 0.3, "linestyle": "--"} if faint else {"linestyle": "-"}
    turn = np.linspace(0.0, TURN, 181)
    # Both elbows point away from the other arm.
    outward = -1.0 if np.sin(problem.offset[0, 1] - problem.offset[0, 0]) > 0 else 1.0
    for radius in sorted(set(problem.radius[0].tolist())):
        ax.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.7", linewidth=1)
    for arm in (0, 1):
        azimuth = angle + problem.offset[0, arm]
        shoulder = problem.radius[0, arm] * np.array([np.cos(azimuth), np.sin(azimuth)])
        elbow = _elbow(problem, arm, shoulder, wrist[arm], outward if arm == 0 else -outward)
        line = np.array([[0.0, 0.0], shoulder, elbow, wrist[arm][:2]])
        colour = COLOURS[arm]
        ax.plot(line[:2, 0], line[:2, 1], color="0.5", linewidth=1, **style)
        label = f"arm {arm + 1} before the move" if faint else None
        look = {"color": colour, "linewidth": 3, "marker": "o", "markersize": 5, **style}
        ax.plot(line[1:, 0], line[1:, 1], label=label, **look)


def _elbow(
    problem: PlatformProblem, arm: int, shoulder: FloatArray, wrist: FloatArray, side: float
) -> FloatArray:
    """Compute the top-view elbow for a level arm plane, left or right.

    Left is 1, right is -1.
    """
    flat = wrist[:2] - shoulder
    rise = wrist[2] - problem.height[0, arm]
    reach = float(np.hypot(np.linalg.norm(flat), rise))
    a1, a2 = problem.upper[0, arm], problem.fore[0, arm]
    along = (reach**2 + a1**2 - a2**2) / (2.0 * reach) if reach > 0 else 0.0
    across = np.sqrt(max(0.0, a1**2 - along**2))
    left = np.array([-flat[1], flat[0]]) / max(float(np.linalg.norm(flat)), 1e-12)
    elbow: FloatArray = shoulder + flat * (along / max(reach, 1e-12)) + side * across * left
    return elbow


def _draw_targets(ax: Any, problem: PlatformProblem) -> None:
    for arm in (0, 1):
        x, y, _ = problem.wrist[0, arm]
        ax.plot(x, y, "x", color=COLOURS[arm], markersize=9, markeredgewidth=2)


def _turns(problem: PlatformProblem) -> tuple[FloatArray, FloatArray]:
    """Sample turns within ±180° [deg], and platform angles [rad]."""
    turn = np.linspace(-np.pi, np.pi, 1441)
    return np.degrees(turn), problem.angle_0[0] + turn


def _mark(ax: Any, rows: list[MethodRow], method: str) -> None:
    """Draw the candidates as dashed lines: roots black, the others red, as in the paper."""
    for row in rows:
        if row.method == method:
            root = row.kind in (Kind.ROOT_SAME, Kind.ROOT_OPPOSITE)
            colour = "black" if root else "#c23b22"
            ax.axvline(np.degrees(row.turn), color=colour, linestyle="--", linewidth=0.9)


def _draw_equation(ax: Any, problem: PlatformProblem, rows: list[MethodRow]) -> None:
    """Draw both functions of Eq. 5, each normalised by its largest absolute value."""
    degrees, angle = _turns(problem)
    u, v, w = np.moveaxis(cosine_coefficients(problem)[0], -1, 0)
    x = u[:, None] + v[:, None] * np.cos(angle) + w[:, None] * np.sin(angle)
    gain = x - np.cos(problem.elbow_0[0])[:, None]
    for sign, label, colour in (
        (1.0, "elbows turn in the same direction", "#7a3fa0"),
        (-1.0, "elbows turn in opposite directions", "#e08a1e"),
    ):
        value = gain[0] - sign * gain[1]
        ax.plot(degrees, value / np.abs(value).max(), color=colour, label=label)
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    _mark(ax, rows, "linearised")
    ax.set_xlim(-180, 180)
    ax.set_title("equation 5, normalised (dashed: candidates of `linearised`)")
    ax.set_xlabel("platform turn [deg]")


def _draw_elbows(ax: Any, problem: PlatformProblem, rows: list[MethodRow]) -> None:
    """Draw both elbow displacements and the difference of their magnitudes."""
    degrees, angle = _turns(problem)
    x = elbow_cosine(problem, angle[None])[0]
    delta = np.degrees(np.arccos(np.clip(x, -1, 1)) - problem.elbow_0[0])
    delta = np.where(np.abs(x) <= 1.0, delta, np.nan)
    for arm in (0, 1):
        ax.plot(degrees, delta[:, arm], color=COLOURS[arm], label=f"arm {arm + 1}")
    balance = np.abs(delta[:, 0]) - np.abs(delta[:, 1])
    ax.plot(degrees, balance, color=BALANCE, label="|Δ1| − |Δ2|")
    ax.axhline(0.0, color="0.5", linewidth=0.8)
    _mark(ax, rows, "linearised")
    for row in rows:
        if row.method == "exact" and row.kind in (Kind.ROOT_SAME, Kind.ROOT_OPPOSITE):
            ax.plot(np.degrees(row.turn), 0.0, "o", color=BALANCE, markersize=5)
    ax.set_xlim(-180, 180)
    ax.set_title("elbow displacements (dots: roots of `exact`)")
    ax.set_xlabel("platform turn [deg]")
    ax.set_ylabel("displacement [deg]")


def draw_reach(document: Mapping[str, Any], cell: Cell, kind: str) -> bytes:
    """Draw a reach map as PNG, SVG or PDF.

    The same input gives the same bytes.

    Args:
        document: of `reach_document`.
        cell: whose obstacles and frames are drawn.
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    who, turns = list(document["positions"]), document["platform"][0] is not None
    figure = new_figure(4.2 * len(who) if turns else 6.4, 7.4 if turns else 6.0)
    tilt = f", tilted by {math.degrees(document['tilt']):.3g}°" if document["tilt"] else ""
    figure.suptitle(
        f"{document['name']}: reach {document['height']:.3g} m high, tools down{tilt}",
        x=0.01,
        ha="left",
        weight="bold",
        fontsize=10,
    )
    if not turns:
        panel = figure.subplots()
        _draw_sides(panel, document)
        _draw_cell(panel, document, cell)
        figure.legend(loc="outside lower center", ncols=4, frameon=False)
        return rendered(figure, kind)
    names = [f"map {arm}" for arm in who]
    panels = figure.subplot_mosaic([names, ["areas"] * len(names)], height_ratios=[2.0, 1.0])
    scale, unit = (1000.0, "mm") if document["platform_unit"] == "m" else (math.degrees(1.0), "deg")
    places = scale * np.array(document["platform"])
    step = float(places[1] - places[0]) if len(places) > 1 else 0.0
    for arm, name in zip(who, names, strict=True):
        panel = panels[name]
        amount = np.array(document["positions"][arm]) * step
        drawn = _mesh(panel, document, np.where(amount > 0, amount, np.nan), _scale(REACH[arm][1]))
        drawn.set_clim(0.0, max(float(amount.max()), step, 1.0))
        panel.set_title("both arms, from one platform position" if arm == "both" else f"{arm} arm")
        _draw_cell(panel, document, cell)
        figure.colorbar(
            drawn,
            ax=panel,
            orientation="horizontal",
            shrink=0.9,
            label=f"platform positions [{unit}]",
        )
    for arm in who:
        panels["areas"].plot(
            places,
            document["area"][arm],
            color=REACH[arm][0],
            marker="o",
            markersize=3,
            label="both arms" if arm == "both" else f"{arm} arm",
        )
    panels["areas"].set_xlabel(f"platform [{unit}]")
    panels["areas"].set_ylabel("reached [m²]")
    panels["areas"].set_ylim(bottom=0.0)
    panels["areas"].grid(alpha=0.3)
    panels["areas"].legend(frameon=False)
    return rendered(figure, kind)


def _scale(name: str) -> Any:
    """Build a colour scale whose least value is visible."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    # The lightest quarter is omitted, so that points reached from a single platform position stay visible.
    return ListedColormap(colormaps[name](np.linspace(0.25, 1.0, 128)))


def _draw_sides(panel: Any, document: Mapping[str, Any]) -> None:
    """Draw the reach of each arm and of both, each in one colour."""
    from matplotlib.colors import ListedColormap

    for arm in document["positions"]:
        reached = np.array(document["positions"][arm]) > 0
        shown = reached
        if arm in ("left", "right") and "both" in document["positions"]:
            shown = reached & ~(np.array(document["positions"]["both"]) > 0)
        _mesh(panel, document, np.where(shown, 1.0, np.nan), ListedColormap([REACH[arm][0]]))
        label = {"both": "both arms"}.get(arm, f"{arm} arm")
        panel.plot([], [], "s", color=REACH[arm][0], alpha=0.7, label=label)


def _mesh(panel: Any, document: Mapping[str, Any], values: Any, colours: Any) -> Any:
    """Draw values (ny, nx) on the points of the grid."""
    x, y = np.array(document["x"]), np.array(document["y"])
    drawn = panel.pcolormesh(x, y, values, cmap=colours, shading="nearest", alpha=0.7, linewidth=0)
    drawn.set_edgecolor("face")
    return drawn


def _draw_cell(panel: Any, document: Mapping[str, Any], cell: Cell) -> None:
    """Draw base, boxes and frames in top view, x right, y up."""
    from matplotlib.patches import Polygon

    for obstacle in cell.obstacles:
        if obstacle.shape.kind == "box":
            a, b, _ = (0.5 * side for side in obstacle.shape.size)
            corners = [
                obstacle.shape.pose.act(np.array([sx * a, sy * b, 0.0]))[:2]
                for sx, sy in ((1, 1), (-1, 1), (-1, -1), (1, -1))
            ]
            panel.add_patch(Polygon(corners, fill=False, edgecolor="0.3", linewidth=1.0))
    base = cell.base.translation
    panel.plot(base[0], base[1], "k+", markersize=10)
    for name, pose in cell.frames.items():
        x, y, _ = pose.translation
        panel.plot(x, y, "k.", markersize=4)
        panel.annotate(name, (x, y), fontsize=7, xytext=(3, 3), textcoords="offset points")
    reached = np.any(
        [np.array(positions) > 0 for positions in document["positions"].values()], axis=0
    )
    if reached.any():
        iy, ix = np.nonzero(reached)
        for limit, side, k, at in (
            (panel.set_xlim, document["x"], ix, base[0]),
            (panel.set_ylim, document["y"], iy, base[1]),
        ):
            margin = 1.5 * document["step"]
            limit(min(side[k.min()], at) - margin, max(side[k.max()], at) + margin)
    panel.set_aspect("equal")
    panel.set_xlabel("x [m]")
    panel.set_ylabel("y [m]")
