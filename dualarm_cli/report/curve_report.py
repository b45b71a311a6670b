"""Report of a curve: points by two methods, their quality, a figure.

The curve is in a controller.

Curves in space with their frames, as Fig. 8 of [Qin2024].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dualarm_cli.geometry.products import norm
from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.model.curves.discretisation import Points, Quality, by_euler, by_length, judge
from dualarm_cli.model.curves.feature_curve import MeasuredCurve, PoseCurve
from dualarm_cli.records import dataclass
from dualarm_cli.report.printable import numbers, print_lines

if TYPE_CHECKING:
    from rich.console import Console

LEAST_SHOWN = 0.001
"""Display resolution of errors [um]."""
TITLES = {"arc_length": "arc length", "euler": "Euler as printed"}


@dataclass(frozen=True)
class CurveReport:
    """The points of one task's curve."""

    task: str
    """The task."""
    curve: MeasuredCurve
    """Its curve in the part's frame."""
    step: float
    """Nominal length of a step [m]."""
    interval: float | None
    """Time of a step [s]; None if the step was given as a length."""
    speed: float | None
    """Speed of the tool along the curve [m/s], or None."""
    mean: bool
    """Whether the speed is length over duration, because the file gives a duration."""
    points: Mapping[str, Points]
    """Points by method: arc_length, and euler for a parametric curve."""
    quality: Mapping[str, Quality]
    """Quality by method."""


def curve_report(
    task: str,
    curve: MeasuredCurve,
    step: float,
    interval: float | None,
    speed: float | None,
    mean: bool,
) -> CurveReport:
    """Compute and rate the points of a curve by every method that applies.

    Args:
        task: task of the curve.
        curve: in the part's frame.
        step: length of a step [m].
        interval: time for it [s], or None.
        speed: along the curve [m/s], or None.
        mean: whether the speed is length over duration.
    """
    points = {"arc_length": by_length(curve, step)}
    if not isinstance(curve, PoseCurve):
        points["euler"] = by_euler(curve, step)
    quality = {name: judge(curve, method_points) for name, method_points in points.items()}
    return CurveReport(task, curve, step, interval, speed, mean, points, quality)


def print_curves(reports: Sequence[CurveReport], console: Console) -> None:
    """Print a table of each curve.

    Args:
        reports: one of each curve.
        console: output.
    """
    from rich.table import Table

    for report in reports:
        print_lines(console, _title(report))
        table = Table("", *numbers(*(TITLES[name] for name in report.points)))
        for label, cells in _rows(report):
            table.add_row(label, *cells)
        console.print(table)
        print_lines(console, *_remarks(report))


def _title(report: CurveReport) -> str:
    step = f"a point every {report.step * 1e3:.6g} mm"
    if report.interval is not None and report.speed is not None:
        mean = " on average" if report.mean else ""
        step += f" (every {report.interval * 1e3:.6g} ms at {report.speed * 1e3:.6g} mm/s{mean})"
    return f"{report.task}: {report.curve.length * 1e3:.3f} mm, {step}"


def _rows(report: CurveReport) -> list[tuple[str, list[str]]]:
    quality = list(report.quality.values())
    rows = [
        ("points", [str(len(points.parameter)) for points in report.points.values()]),
        ("spacing error um", [_um(q.spacing_error) for q in quality]),
        ("speed error %", [_small(100.0 * q.speed_error) for q in quality]),
        ("drift at the end um", [_um(q.drift) for q in quality]),
        ("last step mm", [f"{q.last_step * 1e3:.4f}" for q in quality]),
        ("chord error um", [_um(q.chord_error) for q in quality]),
        ("  at most, proven um", [_um(q.chord_bound) for q in quality]),
        ("largest turn of the frame deg", [f"{math.degrees(q.turn):.4f}" for q in quality]),
        ("smallest cosine of an axis", [f"{q.least_dot:.7f}" for q in quality]),
    ]
    if isinstance(report.curve, PoseCurve):
        rows.append(("x off the curve deg", [f"{math.degrees(q.lean):.4f}" for q in quality]))
    return rows


def _remarks(report: CurveReport) -> list[str]:
    kappa = report.quality["arc_length"].curvature_bound
    if kappa == 0.0:
        lines = ["the curve is straight"]
    elif math.isinf(kappa):
        lines = ["the least radius is not known, as the curve bends too sharply somewhere"]
    else:
        lines = [f"the curve bends with a radius of {1e3 / kappa:.3f} mm or more (proven)"]
    if isinstance(report.curve, PoseCurve):
        lines.append("no Euler steps: a curve through poses has no parameter of its own")
    else:
        lines.append("Euler as printed stops a last step short of the end; the end is added here")
    return lines


def _um(value: float) -> str:
    return _small(1e6 * value)


def _small(value: float) -> str:
    return f"< {LEAST_SHOWN}" if value < LEAST_SHOWN else f"{value:.3f}"


def _numbers(quality: Quality) -> dict[str, float | None]:
    return {key: v if math.isfinite(v) else None for key, v in vars(quality).items()}


def curves_document(reports: Sequence[CurveReport]) -> dict[str, Any]:
    """Return the reports as JSON: m, s, rad.

    Args:
        reports: one of each curve.
    """
    return {
        "format": "dualarm.curve/1",
        "curves": [
            {
                "task": report.task,
                "length": report.curve.length,
                "step": report.step,
                "interval": report.interval,
                "speed": report.speed,
                "speed_is": "mean" if report.mean else "constant",
                "methods": {
                    name: {"points": len(report.points[name].parameter), **_numbers(quality)}
                    for name, quality in report.quality.items()
                },
            }
            for report in reports
        ],
    }


FRAMES = 36
"""Frames drawn along a curve at most."""
COLOURS = ("#c23b22", "#2a7f3f", "#1f5fbf")
"""Colours of the axes x, y and z of a frame."""
LABELS = ("x, along the curve", "y", "z, out of the surface")
COLUMNS = 3
"""Maximum number of curves side by side."""


def draw_curves(reports: Sequence[CurveReport], kind: str) -> bytes:
    """Draw curves in the part's frame, each with some of its frames.

    Args:
        reports: the curves, one or more.
        kind: one of FIGURE_KINDS.

    Returns:
        The figure as the content of a file.

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
    """Draw one curve through its points, its start, and frames at equal distances."""
    points = report.points["arc_length"]
    fine = report.curve.at(np.linspace(0.0, report.curve.length, 721))[1] * 1e3
    extent = float(np.ptp(fine, axis=0).max())
    size = 0.16 * extent
    # Repeating the first frame at the end of a closed curve would only cover it.
    closed = norm(points.p[-1] - points.p[0]) < 1e-6
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
