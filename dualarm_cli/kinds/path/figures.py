"""Figures of paths: trails of tools and elbows, contraction forces, manipulability, joints within limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.kinds.drawing import KindFigures, new_figure, rendered
from dualarm_cli.kinds.path.measures import PathSamples, path_samples
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule

PLANES = ((0, 1), (0, 2), (1, 2))
VIEWS = ("from above", "from the side", "from the front")
AXES = "xyz"
RATES = {
    "position": "positions",
    "velocity": "velocities",
    "acceleration": "accelerations",
}
STYLES = {"left": ("tab:blue", 2.2, "-"), "right": ("tab:red", 1.2, (0, (4, 2)))}
"""Colour, width and line of each arm.

Where both coincide, the thin line is visible on the wide one.
"""


def draw_paths(schedule: Schedule, job: Job, kind: str) -> bytes:
    """Draw a plan's paths: trails, forces, manipulability, and all joints.

    The quantities of [Choi2020] Figs. 6 to 11 and of [Zhang2024] Figs. 2 to 4. Legends are to the right of their axes.

    Args:
        schedule: the plan.
        job: its job, with paths.
        kind: one of FIGURE_KINDS.
    """
    samples = path_samples(schedule, job)
    figure = new_figure(16.0, 13.0 * len(samples))
    figure.get_layout_engine().set(w_pad=0.12, h_pad=0.12)
    for part, path in zip(np.atleast_1d(figure.subfigures(len(samples), 1)), samples, strict=True):
        part.suptitle(f"{path.task}, by {path.method}, {path.time[-1]:.3f} s", fontsize=12)
        trails, curves, joints = part.subfigures(3, 1, height_ratios=[1.1, 0.9, 1.2])
        _draw_trails(trails, path)
        sprung = _has_springs(path)
        panels = curves.subplots(1, 3 if sprung else 2)
        if sprung:
            _draw_forces(panels[0], path)
        _draw_manipulability(panels[-2], path)
        _draw_manipulability(panels[-1], path, together=True)
        _add_legend(curves, panels)
        panels = joints.subplots(1, 3)
        for axes, rate in zip(panels, RATES, strict=True):
            _draw_joints(axes, path, job, rate)
        _add_legend(joints, panels[:1], columns=2)
    return rendered(figure, kind)


def _has_springs(path: PathSamples) -> bool:
    """Test whether distances from critical points matter: springs pull, or the file gives points."""
    return path.method.startswith("virtual_spring") or bool(path.work.critical_points)


def _add_legend(part: Any, panels: Any, columns: int = 1) -> None:
    """Add one legend of all labels in the panels, to the right of them."""
    handles_by_label: dict[str, Any] = {}
    for axes in panels:
        handles, labels = axes.get_legend_handles_labels()
        handles_by_label = dict(zip(labels, handles, strict=True)) | handles_by_label
    part.legend(
        list(handles_by_label.values()),
        list(handles_by_label),
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
    """Draw tools, elbows and critical points, in space and along each axis.

    Critical points are drawn where springs pull.
    """
    spatial = part.add_subplot(1, 4, 1, projection="3d")
    flat = [part.add_subplot(1, 4, k) for k in (2, 3, 4)]
    spatial.set_title("tools and elbows (dots: where they begin)", fontsize=10)
    sprung = _has_springs(path)
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
    _add_legend(part, [spatial])


def _draw_forces(axes: Any, path: PathSamples) -> None:
    """Draw the springs' contraction forces, and the least ones at equal poses."""
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
    """Draw the manipulability of each arm, or of all tools by all joints."""
    if together:
        axes.plot(path.time, path.joint_manipulability, color="k", label="both together")
        axes.set_title("manipulability of all tools together", fontsize=10)
        axes.set_ylabel("M")
    else:
        for m, arm in enumerate(path.arms):
            axes.plot(path.time, path.arm_manipulability[:, m], **_style(arm), label=arm)
        axes.set_title("manipulability of each arm", fontsize=10)
        axes.set_ylabel("M [m³/rad³]")
    highest = float((path.joint_manipulability if together else path.arm_manipulability).max())
    axes.set_ylim(0.0, 1.1 * highest if highest > 0.0 else 1.0)
    axes.set_xlabel("time [s]")


def _draw_joints(axes: Any, path: PathSamples, job: Job, rate: str) -> None:
    """Draw a rate of all following joints over its limits, -1 to 1."""
    limits = job.limits
    values = getattr(path, rate)
    if rate == "position":
        middle = (limits.lower + limits.upper) / 2.0
        shares = (values - middle) / np.maximum(limits.upper - middle, 1e-12)
    else:
        shares = values / getattr(limits, rate)
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
    axes.set_title(f"joint {RATES[rate]} (dashed: limits)", fontsize=10)


FIGURES = KindFigures("paths", lambda job: job.has_paths, draw_paths)
