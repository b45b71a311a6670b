"""Who does what when, drawn: a lane of bars for each arm and one for the platform, over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.reporting.figures import new_figure, rendered
from dualarm_cli.reporting.gantt_labels import Label, labels, task_words
from dualarm_cli.reporting.gantt_platform import platform_moves, platform_words
from dualarm_cli.reporting.report import relative_gap

WIDTH, LEFT, RIGHT = 15.0, 0.75, 0.15
"""Width of the figure and of what is free beside its axes [inch]."""
LANE, BELOW, BETWEEN, TITLE, LEGEND = 0.36, 0.22, 0.12, 0.36, 0.42
"""Heights: of a lane, of a row's time axis, of what is free between rows, of the title, of the legend [inch]."""
COLUMNS, LINE = 10, 0.2
"""Names in a line of the legend, and the height of every further line [inch]."""
BAR = 0.76
"""Height of a bar, as a share of its lane."""
STOPS_A_ROW, MOST_ROWS = 9, 6
"""An arm's stops in one row of the time axis, and how many rows there are at most."""
LEAST = 1e-3
"""Shortest time axis [s]."""
ROUNDING = 1e-6
"""Shorter parts are not drawn [s]."""
KINDS = {
    "transfer": ("transfer", "#4c78a8"),
    "approach": ("approach, retract", "#72b7b2"),
    "retract": ("approach, retract", "#72b7b2"),
    "dwell": ("dwell", "#f2a541"),
    "path": ("path", "#9d6fb0"),
    "seam": ("seam", "#d45087"),
    "return": ("return", "#8a97a8"),
}
"""What bars are called in the legend, and their colours."""
REASONS = {
    "platform": ("waits: platform", "#d9d9d9", "////"),
    "partner": ("waits: partner", "#dbe9f6", "\\\\\\\\"),
    "shared_zone": ("waits: shared zone", "#fbd5d0", "xxxx"),
    "after": ("waits: task before", "#e6dcf0", "||||"),
    "window": ("waits: time window", "#fdf0c4", "----"),
    "buffer": ("waits: buffer", "#d9efdc", "++++"),
    "conveyor": ("waits: conveyor", "#d2e7ec", "////"),
    "end": ("waits: work is done", "#f4f4f4", "...."),
    "": ("waits", "#efefef", ""),
}
"""The same of waits, with their hatches."""
TURNS = ("platform moves", "#5a5a5a")
"""The same of the platform."""


@dataclass(frozen=True)
class _Style:
    """How bars of one sort look."""

    name: str
    colour: str
    hatch: str = ""


def draw_gantt(schedule: Schedule, job: Job, kind: str) -> bytes:
    """Returns the figure of who does what when: arms and platform as bars over time, in up to MOST_ROWS rows.

    Waits are hatched by what they are for. Where they fit, bars bear the ids of their tasks, and the platform's lane
    the angle at which it stands.

    Args:
        schedule: with segments.
        job: what it was planned for.
        kind: one of FIGURE_KINDS.
    """
    lanes = [*schedule.robot.arms, *(["platform"] if schedule.robot.platform else [])]
    count = row_count(schedule)
    span = max(schedule.duration / count, LEAST)
    row = LANE * len(lanes) + BELOW
    bars, moving = _bars(schedule, lanes), platform_moves(schedule)
    present = {style.name: style for _, style in bars}
    legend = LEGEND + LINE * max(0, math.ceil(len(present) / COLUMNS) - 1)
    height = TITLE + count * row + (count - 1) * BETWEEN + legend
    figure = new_figure(WIDTH, height)
    # Axes are placed by hand: only then is it known beforehand which words fit into which bars.
    figure.set_layout_engine("none")
    inch = (WIDTH - LEFT - RIGHT) / span
    starts = [number * span for number in range(count)]
    tasks = [task_words(schedule, list(schedule.robot.arms), t, t + span) for t in starts]
    stands = [platform_words(schedule, moving, len(lanes) - 1, t, t + span) for t in starts]
    words = [label for rows in (tasks, stands) for label in labels([*chain(*rows)], inch)]
    for number, start in enumerate(starts):
        bottom = legend + BELOW + (count - 1 - number) * (row + BETWEEN)
        place = [LEFT / WIDTH, bottom / height, 1.0 - (LEFT + RIGHT) / WIDTH]
        axes = figure.add_axes((*place, LANE * len(lanes) / height))
        _draw_row(axes, bars, start, start + span, schedule.duration)
        _write(axes, [word for word in words if start <= word.time < start + span])
        _dress(axes, lanes, schedule, start, start + span)
    _title_and_legend(figure, title(schedule, job), present, height)
    return rendered(figure, kind)


def row_count(schedule: Schedule) -> int:
    """Returns into how many rows the time axis is broken: more where an arm has more stops."""
    stops = [
        len({(s.task, s.action) for s in schedule.segments if s.arm == arm and s.task})
        for arm in schedule.robot.arms
    ]
    return min(MOST_ROWS, max(1, math.ceil(max(stops, default=0) / STOPS_A_ROW)))


def _bars(schedule: Schedule, lanes: Sequence[str]) -> dict[tuple[int, _Style], list[Any]]:
    """Returns spans (start, length) [s] by lane and look."""
    bars: dict[tuple[int, _Style], list[Any]] = {}
    for part in schedule.segments:
        if part.arm in lanes and part.end - part.start > ROUNDING:
            key = lanes.index(part.arm), _style(part)
            bars.setdefault(key, []).append((part.start, part.end - part.start))
    moves = [(start, end - start) for start, end in platform_moves(schedule)]
    if moves:
        bars[len(lanes) - 1, _Style(*TURNS)] = moves
    return bars


def _style(part: Segment) -> _Style:
    return _Style(*(REASONS[part.reason] if part.kind == "wait" else KINDS[part.kind]))


def _draw_row(
    axes: Any, bars: dict[tuple[int, _Style], list[Any]], start: float, end: float, last: float
) -> None:
    """Draws what of the bars lies in a row; an axis that goes beyond the end of the motion is grey there."""
    for (lane, style), spans in bars.items():
        inside = [span for span in spans if span[0] < end and sum(span) > start]
        axes.broken_barh(
            inside,
            (lane - BAR / 2.0, BAR),
            facecolors=style.colour,
            hatch=style.hatch or None,
            edgecolor="0.55" if style.hatch else "white",
            linewidth=0.0 if style.hatch else 0.3,
        )
    if last < end:
        axes.axvspan(last, end, color="0.93", linewidth=0.0)


def _write(axes: Any, words: Sequence[Label]) -> None:
    for label in words:
        axes.text(
            label.time,
            label.lane,
            label.text,
            size=label.size,
            color=label.colour,
            ha="center",
            va="center_baseline",
            clip_on=True,
            parse_math=False,
        )


def _dress(axes: Any, lanes: Sequence[str], schedule: Schedule, start: float, end: float) -> None:
    """Sets a row's axes: lanes from top to bottom, time in s, thin lines where stages begin that do not overlap."""
    axes.set_xlim(start, end)
    axes.set_ylim(len(lanes) - 0.5, -0.5)
    axes.set_yticks(range(len(lanes)), lanes)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=8)
    if end >= schedule.duration:
        axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
    for side in ("top", "right", "left"):
        axes.spines[side].set_visible(False)
    axes.set_axisbelow(True)
    axes.grid(axis="x", color="0.88", linewidth=0.6)


def _title_and_legend(figure: Any, heading: str, present: dict[str, _Style], height: float) -> None:
    from matplotlib.patches import Patch

    figure.text(
        LEFT / WIDTH,
        1.0 - 0.5 * TITLE / height,
        heading,
        size=11,
        va="center",
        parse_math=False,
    )
    order = [*KINDS.values(), *REASONS.values(), TURNS]
    names = [name for name in dict.fromkeys(row[0] for row in order) if name in present]
    handles = [
        Patch(
            facecolor=present[name].colour,
            hatch=present[name].hatch or None,
            edgecolor="0.55" if present[name].hatch else present[name].colour,
            linewidth=0.0,
            label=name,
        )
        for name in names
    ]
    if handles:
        figure.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(LEFT / WIDTH, 0.03 / height),
            bbox_transform=figure.transFigure,
            ncols=min(COLUMNS, len(handles)),
            frameon=False,
            fontsize=8,
            borderaxespad=0.0,
            borderpad=0.0,
            handlelength=1.8,
            columnspacing=1.4,
        )


def title(schedule: Schedule, job: Job) -> str:
    """Returns the figure's heading: robot, time, bound and gap where there are such; a bound of 0 s says nothing."""
    what = "cycle time" if job.returns else "time of one pass"
    text = f"{schedule.robot.name}: {what} {schedule.duration:.3f} s"
    gap = relative_gap(schedule)
    if schedule.lower_bound and gap is not None:
        text += f", bound {schedule.lower_bound:.3f} s, gap {gap:.1%}"
    return text
