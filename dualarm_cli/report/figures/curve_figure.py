"""Curves in space with their frames, as Fig. 8 of [Qin2024]."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.report.curve_report import CurveReport
from dualarm_cli.report.figures.figures import new_figure, rendered

FRAMES = 36
"""Frames drawn along a curve at most."""
COLOURS = ("#c23b22", "#2a7f3f", "#1f5fbf")
"""Of x, y and z."""
LABELS = ("x, along the curve", "y", "z, out of the surface")
COLUMNS = 3
"""Curves side by side at most."""


def draw_curves(reports: Sequence[CurveReport], kind: str) -> bytes:
    """Returns the figure of curves in the part's frame, each with some of its frames, as a file.

    Args:
        reports: the curves, one or more.
        kind: one of FIGURE_KINDS.

    Raises:
        MissingDependencyError: matplotlib is not installed.
    """
    columns = min(len(reports), COLUMNS)
    rows = -(-len(reports) // columns)
    figure = new_figure(5.2 * columns, 5.0 * rows)
    for k, report in enumerate(reports, 1):
        axes = figure.add_subplot(rows, columns, k, projection="3d")
        _draw(axes, report)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
    return rendered(figure, kind)


def _draw(axes: Any, report: CurveReport) -> None:
    """Draws one curve through its points, where it begins, and frames at equal distances."""
    points = report.points["arc_length"]
    fine = report.curve.at(np.linspace(0.0, report.curve.length, 721))[1] * 1e3
    extent = float(np.ptp(fine, axis=0).max())
    size = 0.16 * extent
    # The first one anew at the end of a closed curve would only cover it.
    closed = float(np.linalg.norm(points.p[-1] - points.p[0])) < 1e-6
    share = np.linspace(0, len(points.p) - 1, FRAMES + 1)[: FRAMES if closed else None]
    shown = np.unique(share.round().astype(np.int64))
    axes.plot(*fine.T, color="0.25", linewidth=1.2, label="curve")
    for axis, (colour, label) in enumerate(zip(COLOURS, LABELS, strict=True)):
        start = points.p[shown] * 1e3
        ends = start + size * points.R[shown, :, axis]
        # One line with gaps: many short ones would fill the legend.
        gaps = np.full_like(start, np.nan)
        line = np.stack([start, ends, gaps], axis=1).reshape(-1, 3)
        axes.plot(*line.T, color=colour, linewidth=1.1, label=label)
    axes.plot(*(points.p[:1] * 1e3).T, "o", color="black", markersize=4)
    every = np.concatenate([fine, points.p * 1e3 + size * points.R[:, :, 2]])
    centre = 0.5 * (every.max(axis=0) + every.min(axis=0))
    reach = 0.5 * float(np.ptp(every, axis=0).max())
    for name, middle in zip("xyz", centre, strict=True):
        getattr(axes, f"set_{name}lim")(middle - reach, middle + reach)
        getattr(axes, f"set_{name}label")(f"{name} [mm]")
        axes.locator_params(axis=name, nbins=5)
    axes.set_box_aspect((1.0, 1.0, 1.0))
    axes.view_init(elev=28.0, azim=35.0)
    axes.set_title(f"{report.task}: {report.curve.length * 1e3:.3f} mm", parse_math=False)
