"""The figure of what arms reach of a table: seen from above, and over the platform's position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from dualarm_cli.model.cell import Cell
from dualarm_cli.report.figures.figures import new_figure, rendered

COLOURS = {"left": "#1f5fbf", "right": "#c23b22", "both": "#2a7f3f"}
"""By who reaches."""
MAPS = {"left": "Blues", "right": "Reds", "both": "Greens"}
"""Scales of colours for how much of the platform's way reaches a point."""
LIGHTEST = 0.25
"""Where in its scale the colour of a point begins that is reached from one position only."""


def draw_reach(document: Mapping[str, Any], cell: Cell, kind: str) -> bytes:
    """Returns the figure as PNG, SVG or PDF: the same bytes for the same input.

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
    names = [f"map {one}" for one in who]
    panels = figure.subplot_mosaic([names, ["areas"] * len(names)], height_ratios=[2.0, 1.0])
    scale, unit = (1000.0, "mm") if document["platform_unit"] == "m" else (math.degrees(1.0), "deg")
    places = scale * np.array(document["platform"])
    step = float(places[1] - places[0]) if len(places) > 1 else 0.0
    for one, name in zip(who, names, strict=True):
        panel = panels[name]
        amount = np.array(document["positions"][one]) * step
        drawn = _mesh(panel, document, np.where(amount > 0, amount, np.nan), _scale(MAPS[one]))
        drawn.set_clim(0.0, max(float(amount.max()), step, 1.0))
        panel.set_title("both arms, from one platform position" if one == "both" else f"{one} arm")
        _draw_cell(panel, document, cell)
        figure.colorbar(
            drawn,
            ax=panel,
            orientation="horizontal",
            shrink=0.9,
            label=f"platform positions [{unit}]",
        )
    for one in who:
        panels["areas"].plot(
            places,
            document["area"][one],
            color=COLOURS[one],
            marker="o",
            markersize=3,
            label="both arms" if one == "both" else f"{one} arm",
        )
    panels["areas"].set_xlabel(f"platform [{unit}]")
    panels["areas"].set_ylabel("reached [m²]")
    panels["areas"].set_ylim(bottom=0.0)
    panels["areas"].grid(alpha=0.3)
    panels["areas"].legend(frameon=False)
    return rendered(figure, kind)


def _scale(name: str) -> Any:
    """Returns a scale of colours whose least value can be seen."""
    from matplotlib import colormaps
    from matplotlib.colors import ListedColormap

    return ListedColormap(colormaps[name](np.linspace(LIGHTEST, 1.0, 128)))


def _draw_sides(panel: Any, document: Mapping[str, Any]) -> None:
    """Draws what each arm and both reach, each in one colour."""
    from matplotlib.colors import ListedColormap

    for one in document["positions"]:
        reached = np.array(document["positions"][one]) > 0
        shown = reached
        if one in ("left", "right") and "both" in document["positions"]:
            shown = reached & ~(np.array(document["positions"]["both"]) > 0)
        _mesh(panel, document, np.where(shown, 1.0, np.nan), ListedColormap([COLOURS[one]]))
        label = {"both": "both arms"}.get(one, f"{one} arm")
        panel.plot([], [], "s", color=COLOURS[one], alpha=0.7, label=label)


def _mesh(panel: Any, document: Mapping[str, Any], values: Any, colours: Any) -> Any:
    """Draws values (ny, nx) on the points of the grid."""
    x, y = np.array(document["x"]), np.array(document["y"])
    drawn = panel.pcolormesh(x, y, values, cmap=colours, shading="nearest", alpha=0.7, linewidth=0)
    drawn.set_edgecolor("face")
    return drawn


def _draw_cell(panel: Any, document: Mapping[str, Any], cell: Cell) -> None:
    """Draws where the robot stands, boxes seen from above, and frames; x to the right, y up."""
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
    reached = np.any([np.array(one) > 0 for one in document["positions"].values()], axis=0)
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
