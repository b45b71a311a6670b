"""Figures of seams: joints and velocities, tool trails, and the chain.

Trails of the tool are in the part and in the world.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.drawing import KindFigures, new_figure, rendered
from dualarm_cli.kinds.seam.measures import SeamSamples, seam_samples
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.tool_model import ToolModel


@dataclass(frozen=True)
class SeamStyle:
    """Resolution and sizes of a seam's figure."""

    per_second: float = 100.0
    """Number of drawn instants per second."""
    most: int = 4000
    """Maximum number of drawn instants."""
    frames: int = 12
    """Number of drawn tool frames along each seam."""
    axis: float = 0.15
    """Length of their axes [fraction of the seam's size]."""
    bins: int = 80
    """Number of intervals whose largest residual is drawn."""
    axis_colours: tuple[str, str, str] = ("tab:red", "tab:green", "tab:blue")


STYLE = SeamStyle()


def draw_seams(schedule: Schedule, job: Job, kind: str) -> bytes:
    """Draw a row of joint curves, then a row of panels per seam.

    The quantities of [Qin2024] Figs. 13 to 18 and 23 to 28.

    Args:
        schedule: the plan.
        job: its job, with seams.
        kind: one of FIGURE_KINDS.
    """
    samples = seam_samples(schedule, job)
    rows = len(samples) + 2
    figure = new_figure(15.0, 4.2 * rows)
    parts = figure.subfigures(rows, 1)
    arms = [arm.name for arm in job.cell.robot.arms]
    for part, rate in zip(parts[:2], ("position", "velocity"), strict=True):
        for axes, arm in zip(np.atleast_1d(part.subplots(1, len(arms))), arms, strict=True):
            _draw_joints(axes, schedule, job, arm, rate, samples)
    for part, seam in zip(parts[2:], samples, strict=True):
        part.suptitle(f"{seam.task}, by {seam.method}", fontsize=10)
        grid = part.add_gridspec(1, 5, width_ratios=[1.0, 1.0, 0.1, 1.0, 1.0])
        _draw_in_part(part.add_subplot(grid[0], projection="3d"), schedule, job, seam)
        _draw_in_world(part.add_subplot(grid[1], projection="3d"), seam)
        _draw_speed(part.add_subplot(grid[3]), seam)
        _draw_chain(part.add_subplot(grid[4]), seam)
    return rendered(figure, kind)


def _draw_joints(
    axes: Any, schedule: Schedule, job: Job, arm: str, rate: str, samples: list[SeamSamples]
) -> None:
    """Draw all joints of one arm in degrees or millimetres, the seams shaded."""
    names = next(a.joints for a in job.cell.robot.arms if a.name == arm)
    motion = schedule.trajectory.select(names)
    count = int(min(STYLE.most, max(2.0, motion.duration * STYLE.per_second)))
    time = np.linspace(0.0, motion.duration, count)
    values = motion.clamped(time)[0 if rate == "position" else 1]
    for k, name in enumerate(names):
        slides = name in job.cell.robot.sliding
        shown = 1e3 * values[:, k] if slides else np.degrees(values[:, k])
        axes.plot(time, shown, label=f"{name} [mm]" if slides else name, linewidth=1.0)
    for seam in samples:
        if arm in seam.work.arms:
            axes.axvspan(*seam.span, color="0.92", zorder=0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("[deg]" if rate == "position" else "[deg/s]")
    axes.set_title(
        f"{arm} arm: joint {'positions' if rate == 'position' else 'velocities'}", fontsize=9
    )
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


def _draw_in_part(axes: Any, schedule: Schedule, job: Job, seam: SeamSamples) -> None:
    """Draw the seam in the part's frame with the tool's frames along it."""
    on, work = seam.on, seam.work
    _, p = work.curve.at(np.linspace(0.0, work.length, 400))
    axes.plot(*(1e3 * p.T), color="k", linewidth=1.0)
    R, tip = ToolModel(schedule).poses(work.slave, schedule.trajectory.clamped(on.time)[0])
    chosen = np.unique(np.searchsorted(on.length, np.linspace(0.0, work.length, STYLE.frames)))
    chosen = chosen[chosen < len(on.time)]
    to_part = np.swapaxes(on.R_part[chosen], -1, -2)
    place = product(to_part, (tip[chosen] - on.p_part[chosen])[..., None])[..., 0]
    turned = product(to_part, R[chosen])
    size = STYLE.axis * float(np.ptp(p, axis=0).max())
    for axis, colour in enumerate(STYLE.axis_colours):
        ends = place + size * turned[:, :, axis] * (-1.0 if axis == 2 else 1.0)
        for a, b in zip(place, ends, strict=True):
            axes.plot(*(1e3 * np.stack([a, b]).T), color=colour, linewidth=0.9)
    _equal(axes, np.concatenate([p, place]), "tool on the part [mm]")


def _draw_in_world(axes: Any, seam: SeamSamples) -> None:
    """Draw the part frame's and the working point's trails in the world."""
    on, work = seam.on, seam.work
    _, p = work.curve.at(on.length)
    tip = on.p_part + product(on.R_part, p[..., None])[..., 0]
    axes.plot(*(1e3 * tip.T), color="tab:red", linewidth=1.0, label="tool")
    axes.plot(*(1e3 * on.p_part.T), color="tab:blue", linewidth=1.0, label="part")
    axes.plot(*(1e3 * on.p_part[:1].T), "o", color="tab:blue", markersize=4)
    axes.plot(*(1e3 * tip[:1].T), "s", color="tab:red", markersize=4)
    axes.legend(fontsize=7, loc="upper left", frameon=False)
    _equal(axes, np.concatenate([tip, on.p_part]), "in the world [mm]")


def _equal(axes: Any, points: FloatArray, title: str) -> None:
    """Set the same scale on all three axes."""
    low, high = points.min(axis=0), points.max(axis=0)
    half = 0.55 * max(float((high - low).max()), 1e-3)
    for name, centre in zip("xyz", (low + high) / 2.0, strict=True):
        getattr(axes, f"set_{name}lim")(1e3 * (centre - half), 1e3 * (centre + half))
        axes.tick_params(labelsize=6)
    axes.set_title(title, fontsize=8)


def _draw_speed(axes: Any, seam: SeamSamples) -> None:
    axes.plot(seam.on.time - seam.on.time[0], 1e3 * seam.speed, color="k")
    if seam.work.speed is not None:
        axes.axhline(1e3 * seam.work.speed, color="0.5", linestyle="--")
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("time [s]")
    axes.set_ylabel("[mm/s]")
    axes.set_title("speed along the seam (dashed: required)", fontsize=9)


def _draw_chain(axes: Any, seam: SeamSamples) -> None:
    """Draw the residual of the chain: the largest value of each of `bins` intervals.

    It oscillates too quickly for a curve.
    """
    time = seam.on.time - seam.on.time[0]
    residuals = (("distance [m]", seam.on.distance), ("angle [rad]", seam.on.angle))
    for name, residual in residuals:
        parts = zip(
            *(np.array_split(row, min(STYLE.bins, len(time))) for row in (time, residual)),
            strict=True,
        )
        middles, largest = np.array([(t.mean(), r.max()) for t, r in parts]).T
        axes.semilogy(middles, np.maximum(largest, 1e-16), label=name, linewidth=1.2)
    axes.axhline(1e-6, color="0.5", linestyle="--")
    axes.set_ylim(3e-17, 1e-5)
    # Powers as plain numbers: superscripts require fonts that may be missing.
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0e}")
    axes.minorticks_off()
    axes.set_xlabel("time [s]")
    axes.set_title("residual of the closed chain", fontsize=9)
    axes.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)


FIGURES = KindFigures("seams", lambda job: job.has_seams, draw_seams)
