"""Paths drawn: where tools and elbows go, contraction forces, manipulability, and the joints with their limits."""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.reporting.figures import new_figure, rendered
from dualarm_cli.reporting.path_measures import PathSamples, path_samples

PLANES = ((0, 1), (0, 2), (1, 2))
AXES = "xyz"
COLOURS = {"left": "tab:blue", "right": "tab:red"}


def draw_paths(schedule: Schedule, job: Job, kind: str) -> bytes:
    """Returns the figure of a plan's paths, a row of three panels and one of five for each path.

    The quantities of [Choi2020] Figs. 6 to 11 and of [Zhang2024] Figs. 2 to 4.

    Args:
        schedule: the plan.
        job: what it was planned for; with paths.
        kind: one of FIGURE_KINDS.
    """
    samples = path_samples(schedule, job)
    figure = new_figure(15.0, 7.0 * len(samples))
    for part, path in zip(np.atleast_1d(figure.subfigures(len(samples), 1)), samples, strict=True):
        part.suptitle(f"{path.task} by {path.method}")
        upper, lower = part.subfigures(2, 1)
        for axes, plane in zip(upper.subplots(1, 4)[:3], PLANES, strict=True):
            _draw_plane(axes, path, plane)
        if path.method.startswith("virtual_spring"):
            _draw_forces(upper.axes[3], path)
        else:
            _draw_manipulability(upper.axes[3], path, together=True)
        panels = lower.subplots(1, 4)
        _draw_manipulability(panels[0], path)
        for axes, what in zip(panels[1:], ("position", "velocity", "acceleration"), strict=True):
            _draw_joints(axes, path, job, what)
    return rendered(figure, kind)


def _draw_plane(axes: Any, path: PathSamples, plane: tuple[int, int]) -> None:
    """Draws tools, elbows and critical points seen along one axis."""
    i, j = plane
    for m, arm in enumerate(path.arms):
        colour = COLOURS.get(arm, "k")
        axes.plot(path.tool[:, m, i], path.tool[:, m, j], color=colour, label=f"{arm} tool")
        elbow = path.elbow[:, m]
        axes.plot(elbow[:, i], elbow[:, j], "--", color=colour, label=f"{arm} elbow")
        axes.plot(*elbow[0, [i, j]], "o", color=colour, markersize=4)
        axes.plot(*path.tool[0, m, [i, j]], "s", color=colour, markersize=4)
        if path.method.startswith("virtual_spring"):
            critical = path.critical[:, m]
            label = f"{arm} critical point"
            axes.plot(critical[:, i], critical[:, j], ":", color=colour, label=label)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{AXES[i]} [m]")
    axes.set_ylabel(f"{AXES[j]} [m]")
    if plane == PLANES[0]:
        axes.legend(fontsize=7, loc="best")


def _draw_forces(axes: Any, path: PathSamples) -> None:
    for m, arm in enumerate(path.arms):
        axes.plot(path.time, path.force[:, m], color=COLOURS.get(arm, "k"), label=arm)
        if path.least is not None:
            least = path.work.stiffness * path.least[:, m]
            axes.plot(path.time, least, color=COLOURS.get(arm, "k"), linestyle=":")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("contraction force K D (dotted: least)")
    axes.legend(fontsize=7)


def _draw_manipulability(axes: Any, path: PathSamples, *, together: bool = False) -> None:
    """Draws the manipulability of each arm, or of all tools by all joints."""
    if together:
        axes.plot(path.time, path.together, color="k")
        axes.set_ylabel("manipulability of all tools together")
    else:
        for m, arm in enumerate(path.arms):
            axes.plot(path.time, path.alone[:, m], color=COLOURS.get(arm, "k"), label=arm)
        axes.set_ylabel("manipulability of each arm [m³/rad³]")
        axes.legend(fontsize=7)
    highest = float((path.together if together else path.alone).max())
    axes.set_ylim(0.0, 1.1 * highest if highest > 0.0 else 1.0)
    axes.set_xlabel("time [s]")


def _draw_joints(axes: Any, path: PathSamples, job: Job, what: str) -> None:
    """Draws one rate of all joints of the arms as a share of its limits, -1 to 1."""
    limits = job.cell.robot.limits.scaled(job.speed)
    values = getattr(path, what)
    if what == "position":
        middle = (limits.lower + limits.upper) / 2.0
        shares = (values - middle) / np.maximum(limits.upper - middle, 1e-12)
    else:
        shares = values / getattr(limits, what)
    for arm in job.cell.robot.arms:
        if arm.name in path.arms:
            columns = job.cell.robot.columns(arm.joints)
            axes.plot(
                path.time, shares[:, columns], color=COLOURS.get(arm.name, "k"), linewidth=0.8
            )
    platform = job.cell.robot.columns(job.cell.robot.platform)
    if platform:
        axes.plot(path.time, shares[:, platform], color="k", linewidth=1.2)
    for edge in (-1.0, 1.0):
        axes.axhline(edge, color="0.5", linestyle="--")
    axes.set_xlabel("time [s]")
    axes.set_ylabel(f"{what} / limit (black: platform)")
