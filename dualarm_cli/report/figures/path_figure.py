"""Paths drawn: where tools and elbows go, contraction forces, manipulability, and the joints with their limits.

Curves in space with their frames, as Fig. 8 of [Qin2024].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from dualarm_cli.kinds.path.measures import PathSamples, path_samples
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.report.curve_report import CurveReport
from dualarm_cli.report.figures.figures import new_figure, rendered

WIDTH, HEIGHT = 16.0, 13.0
"""Size of one path's part [inch]."""
PLANES = ((0, 1), (0, 2), (1, 2))
VIEWS = ("from above", "from the side", "from the front")
AXES = "xyz"
RATES = {
    "position": "positions",
    "velocity": "velocities",
    "acceleration": "accelerations",
}
STYLES = {"left": ("tab:blue", 2.2, "-"), "right": ("tab:red", 1.2, (0, (4, 2)))}
"""Colour, width and line of each arm: where both do the same the thin one is seen on the wide one."""


def draw_paths(schedule: Schedule, job: Job, kind: str) -> bytes:
    """Returns the figure of a plan's paths: for each the trails, forces and manipulability, and all joints.

    The quantities of [Choi2020] Figs. 6 to 11 and of [Zhang2024] Figs. 2 to 4. Legends are beside what is drawn.

    Args:
        schedule: the plan.
        job: what it was planned for; with paths.
        kind: one of FIGURE_KINDS.
    """
    samples = path_samples(schedule, job)
    figure = new_figure(WIDTH, HEIGHT * len(samples))
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    for part, path in zip(np.atleast_1d(figure.subfigures(len(samples), 1)), samples, strict=True):
        part.suptitle(f"{path.task}, by {path.method}, {path.time[-1]:.3f} s", fontsize=12)
        trails, curves, joints = part.subfigures(3, 1, height_ratios=[1.1, 0.9, 1.2])
        _draw_trails(trails, path)
        sprung = _sprung(path)
        panels = curves.subplots(1, 3 if sprung else 2)
        if sprung:
            _draw_forces(panels[0], path)
        _draw_manipulability(panels[-2], path)
        _draw_manipulability(panels[-1], path, together=True)
        _beside(curves, panels)
        panels = joints.subplots(1, 3)
        for axes, what in zip(panels, RATES, strict=True):
            _draw_joints(axes, path, job, what)
        _beside(joints, panels[:1], columns=2)
    return rendered(figure, kind)


def _sprung(path: PathSamples) -> bool:
    """Returns whether distances from critical points say something: springs pull, or the file gives the points."""
    return path.method.startswith("virtual_spring") or bool(path.work.critical_points)


def _beside(part: Any, panels: Any, columns: int = 1) -> None:
    """Adds one legend of all that is named in panels, to the right of them, each name once."""
    found: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        found = dict(zip(labels, handles, strict=True)) | found
    part.legend(
        list(found.values()),
        list(found),
        loc="outside right center",
        fontsize=9,
        frameon=False,
        ncols=columns,
        handlelength=3.5,
    )


def _style(arm: str) -> dict[str, Any]:
    colour, width, line = STYLES.get(arm, ("k", 1.5, "-"))
    return {"color": colour, "linewidth": width, "linestyle": line}


def _draw_trails(part: Any, path: PathSamples) -> None:
    """Draws tools, elbows and, where springs pull, critical points: in space and seen along each axis."""
    spatial = part.add_subplot(1, 4, 1, projection="3d")
    flat = [part.add_subplot(1, 4, k) for k in (2, 3, 4)]
    spatial.set_title("tools and elbows (dots: where they begin)", fontsize=10)
    sprung = _sprung(path)
    for m, arm in enumerate(path.arms):
        colour = _style(arm)["color"]
        trails = {"tool": (path.tool[:, m], "-"), "elbow": (path.elbow[:, m], "--")}
        if sprung:
            trails["critical point"] = (path.critical[:, m], ":")
        for name, (trail, line) in trails.items():
            width = _style(arm)["linewidth"]
            look = {"color": colour, "linestyle": line, "linewidth": width}
            spatial.plot(*trail.T, **look, label=f"{arm} {name}")
            spatial.scatter(*trail[0], color=colour, s=14)
            for axes, (i, j) in zip(flat, PLANES, strict=True):
                axes.plot(trail[:, i], trail[:, j], **look)
                axes.plot(trail[0, i], trail[0, j], "o", color=colour, markersize=4)
    for axes, (i, j), view in zip(flat, PLANES, VIEWS, strict=True):
        axes.set_title(view, fontsize=10)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(f"{AXES[i]} [m]")
        axes.set_ylabel(f"{AXES[j]} [m]")
    spatial.set_aspect("equal")
    for name in AXES:
        getattr(spatial, f"set_{name}label")(f"{name} [m]")
        spatial.tick_params(axis=name, labelsize=7)
    _beside(part, [spatial])


def _draw_forces(axes: Any, path: PathSamples) -> None:
    """Draws the contraction forces of virtual springs, and the least ones with tools and platform where they are."""
    for m, arm in enumerate(path.arms):
        look = _style(arm)
        axes.plot(path.time, path.force[:, m], **look, label=arm)
        if path.least is not None:
            least = path.work.stiffness * path.least[:, m]
            look |= {"linestyle": ":", "alpha": 0.7}
            axes.plot(path.time, least, **look, label=f"{arm}, least force with tools there")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("K D [m]")
    axes.set_title(f"contraction force, stiffness K = {path.work.stiffness:g}", fontsize=10)


def _draw_manipulability(axes: Any, path: PathSamples, *, together: bool = False) -> None:
    """Draws the manipulability of each arm, or of all tools by all joints."""
    if together:
        axes.plot(path.time, path.together, color="k", label="both together")
        axes.set_title("manipulability of all tools together", fontsize=10)
        axes.set_ylabel("M")
    else:
        for m, arm in enumerate(path.arms):
            axes.plot(path.time, path.alone[:, m], **_style(arm), label=arm)
        axes.set_title("manipulability of each arm", fontsize=10)
        axes.set_ylabel("M [m³/rad³]")
    highest = float((path.together if together else path.alone).max())
    axes.set_ylim(0.0, 1.1 * highest if highest > 0.0 else 1.0)
    axes.set_xlabel("time [s]")


def _draw_joints(axes: Any, path: PathSamples, job: Job, what: str) -> None:
    """Draws one rate of all joints that follow as a share of its limits, -1 to 1."""
    limits = job.limits
    values = getattr(path, what)
    if what == "position":
        middle = (limits.lower + limits.upper) / 2.0
        shares = (values - middle) / np.maximum(limits.upper - middle, 1e-12)
    else:
        shares = values / getattr(limits, what)
    groups = [arm for arm in job.cell.robot.arms if arm.name in path.arms]
    lines = [
        (joint, f"C{k % 10}", *STYLES.get(arm.name, ("k", 1.5, "-"))[1:])
        for arm in groups
        for k, joint in enumerate(arm.joints)
    ]
    lines += [(joint, "k", 1.0 + k, "-.") for k, joint in enumerate(job.cell.robot.platform)]
    for joint, colour, width, line in lines:
        column = job.cell.robot.columns([joint])[0]
        axes.plot(
            path.time, shares[:, column], color=colour, linewidth=width, linestyle=line, label=joint
        )
    for edge in (-1.0, 1.0):
        axes.axhline(edge, color="0.5", linestyle="--")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("share of its limit")
    axes.set_title(f"joint {RATES[what]} (dashed: limits)", fontsize=10)


FRAMES = 36
"""Frames drawn along a curve at most."""
COLOURS = ("#c23b22", "#2a7f3f", "#1f5fbf")
"""Colours of the axes x, y and z of a frame."""
LABELS = ("x, along the curve", "y", "z, out of the surface")
COLUMNS = 3
"""Curves side by side at most."""


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
