"""Gantt chart: a lane of bars for each arm and one for the platform."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from functools import lru_cache
from itertools import chain, groupby
from os.path import commonprefix
from typing import Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinds.drawing import new_figure, rendered
from dualarm_cli.model.job import AT_STANDS, Job
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.motion.waiting import MOVES
from dualarm_cli.records import dataclass
from dualarm_cli.report.report import plan_title, relative_gap


@dataclass(frozen=True)
class GanttStyle:
    """Sizes and thresholds of the figure."""

    most_fit: float = 0.95
    """Fraction of words that must fit; otherwise all are shortened."""
    still: float = 1e-7
    """Speed below which platform joints are at rest [rad/s or m/s]."""
    short: float = 1e-3
    """Shortest platform move that is shown by itself [s]."""
    whole: float = 0.05
    """Tolerance of whole degrees [°]."""
    width: float = 15.0
    left: float = 0.75
    right: float = 0.15
    """Width of the figure and of its margins [inch]."""
    lane: float = 0.36
    above: float = 0.13
    below: float = 0.22
    between: float = 0.08
    title: float = 0.36
    legend: float = 0.42
    """Heights of a lane, stage numbers, time axis, row gap, title and legend [inch]."""
    columns: int = 10
    line: float = 0.2
    """Names in a line of the legend, and the height of every further line [inch]."""
    bar: float = 0.76
    """Height of a bar relative to its lane."""
    least: float = 1e-3
    """Shortest time axis [s]."""
    rounding: float = 1e-6
    """Shortest part that is drawn [s]."""
    word_sizes: tuple[float, float, float] = (8.0, 7.0, 6.0)
    """Font sizes of words, in order of preference [points]."""
    padding: float = 3.0
    """Horizontal margin of a word in its bar, both sides together [points]."""
    inks: tuple[str, str] = ("0.15", "white")
    """Colours of words on bright and on dark bars."""
    number_size: float = 6.5
    stops_a_row: int = 9
    """Stops of an arm in one row of the time axis."""
    most_rows: int = 12
    """Maximum number of rows."""


STYLE = GanttStyle()

POINTS = 72.0  # in an inch
DARK = ("transfer", "return", "path", "seam")
"""Kinds of motion whose bars are dark."""


@dataclass(frozen=True)
class Label:
    """A centred word."""

    time: float
    """Time of its centre [s]."""
    lane: int
    """Index of its lane."""
    text: str
    """The text."""
    size: float
    """Font size [points]."""
    colour: str
    """Colour."""


@dataclass(frozen=True)
class Bar:
    """A bar that can hold a word."""

    rank: int
    """Preference: bars of lower rank first, among equals the longest."""
    start: float
    """Start [s]."""
    end: float
    """End [s]."""
    dark: bool
    """Whether the bar is dark, and its word bright."""


@dataclass(frozen=True)
class Wanted:
    """A word and its candidate bars."""

    text: str
    """The text."""
    lane: int
    """Index of the lane."""
    bars: tuple[Bar, ...]
    """Candidate bars; the best that holds the word is used."""
    whole: bool
    """Whether no bar is cut at the end of a row."""
    short: str = ""
    """Shorter, still unambiguous form; empty for none."""
    number: bool = False
    """Whether it is a number, which must keep its digits."""


def task_words(schedule: Schedule, arms: Sequence[str], start: float, end: float) -> list[Wanted]:
    """List a row's task ids, each stop once, preferably in its transfer.

    Args:
        schedule: with segments.
        arms: names of the arms, by lane.
        start: of the row [s].
        end: of the row [s].
    """
    words = []
    for lane, arm in enumerate(arms):
        shared = _shared_begin({s.task for s in schedule.segments if s.arm == arm and s.task})
        row = [s for s in schedule.segments if s.arm == arm and s.end > start and s.start < end]
        row.sort(key=lambda part: part.start)
        for (task, action), run in groupby(row, key=lambda part: (part.task, part.action)):
            parts = [part for part in run if part.kind != "wait"]
            bars = tuple(
                Bar(p.kind not in MOVES, max(p.start, start), min(p.end, end), p.kind in DARK)
                for p in parts
            )
            if task and bars:
                whole = parts[0].start >= start and parts[-1].end <= end
                # The purpose of a tool change is visible in the next task.
                text = task.split(" (")[0] if action in AT_STANDS else task
                words.append(Wanted(text, lane, bars, whole, text[len(shared) :].strip("]")))
    return words


def _shared_begin(ids: Collection[str]) -> str:
    """Find the common prefix up to separator and zeros: left-0 of left-01, left[ of left[1,2]."""
    if len(ids) < 2:
        return ""
    common = commonprefix(list(ids))  # noqa: RUF071 (letters, no paths)
    begin = re.match(r"[^\[]*\[|[^\[]*[^A-Za-z0-9\[]", common)
    shared = begin[0] if begin is not None else ""
    if not shared or shared in ids:
        return ""
    while all(re.match(r"0\d", name.removeprefix(shared)) for name in ids):
        shared += "0"
    return shared


def labels(words: Sequence[Wanted], inch: float) -> list[Label]:
    """Place words in their bars, at the largest size in which most fit.

    If even the smallest size is too large for many, they are shortened: to the part that differs from the others, then
    to the letters that fit.

    Args:
        words: of all rows.
        inch: length of a second [inch].
    """
    required = sum(word.whole for word in words)
    for size in STYLE.word_sizes:
        placed = [_place(word.text, word, inch, size) for word in words]
        fit = sum(w.whole and bar is not None for w, bar in zip(words, placed, strict=True))
        if fit >= STYLE.most_fit * required:
            break
    shown = [_longest(word, inch, size) for word in words]
    return [
        Label((b.start + b.end) / 2.0, word.lane, text, size, STYLE.inks[b.dark])
        for text, word, b in shown
        if b is not None
    ]


def _place(text: str, word: Wanted, inch: float, size: float) -> Bar | None:
    """Find a word's best bar for a text and size, or None."""
    room = text_width(text) * size + STYLE.padding
    large = [bar for bar in word.bars if (bar.end - bar.start) * inch * POINTS >= room]
    return min(large, key=lambda bar: (bar.rank, round(bar.start - bar.end, 6)), default=None)


def _longest(word: Wanted, inch: float, size: float) -> tuple[str, Wanted, Bar | None]:
    """Find the longest form of a word that fits, and its bar or None."""
    short = word.short or word.text
    counts = () if word.number else range(len(short) - 1, 0, -1)
    for form in (word.text, short, *(f"{short[:count]}…" for count in counts)):
        bar = _place(form, word, inch, size)
        if bar is not None:
            return form, word, bar
    return short, word, None


@lru_cache(maxsize=4096)
def text_width(text: str) -> float:
    """Compute the width of a text at size 1 [points]."""
    from matplotlib.textpath import TextPath

    # Matplotlib parses text between dollars as a formula.
    box = TextPath((0.0, 0.0), text.replace("$", "S"), size=100.0).get_extents()
    return float(box.x1) / 100.0 if text.strip() else 0.0


def platform_moves(schedule: Schedule) -> list[tuple[float, float]]:
    """Find the time spans of platform moves [s], separated by rests."""
    trajectory = schedule.trajectory
    columns = [trajectory.joints.index(name) for name in schedule.robot.platform]
    if not columns:
        return []
    q, v = trajectory.position[:, columns], trajectory.velocity[:, columns]
    step = np.diff(trajectory.time)
    fast: BoolArray = np.any(np.abs(v) > STYLE.still, axis=1)
    far = (np.abs(np.diff(q, axis=0)) > STYLE.still * np.maximum(step, STYLE.short)[:, None]).any(
        axis=1
    )
    moves: BoolArray = (fast[1:] | fast[:-1] | far) & (step > 0.0)
    spans: list[tuple[float, float]] = []
    for k in np.flatnonzero(moves).tolist():
        start, end = float(trajectory.time[k]), float(trajectory.time[k + 1])
        if spans and start <= spans[-1][1] and not _stops(v, k):
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((start, end))
    return spans


def _stops(velocity: FloatArray, knot: int) -> bool:
    """Check whether the platform stops at a knot between two moves."""
    return bool((np.abs(velocity[knot]) <= STYLE.still).all())


def platform_words(
    schedule: Schedule, moves: Sequence[tuple[float, float]], lane: int, start: float, end: float
) -> list[Wanted]:
    """List the platform positions of a row, at each rest.

    Args:
        schedule: the schedule.
        moves: spans of platform moves [s].
        lane: index of its lane.
        start: start of the row [s].
        end: end of the row [s].
    """
    trajectory = schedule.trajectory
    columns = [trajectory.joints.index(name) for name in schedule.robot.platform]
    if not columns:
        return []
    slides = [name in schedule.robot.sliding for name in schedule.robot.platform]
    edges = [float(trajectory.time[0]), *np.ravel(moves).tolist(), float(trajectory.time[-1])]
    words = []
    for stands, leaves in zip(edges[::2], edges[1::2], strict=True):
        a, b = max(stands, start), min(leaves, end)
        if a < b:
            q = trajectory.clamped(np.array([(a + b) / 2.0]))[0][0, columns]
            text = ", ".join(place_text(float(v), s) for v, s in zip(q, slides, strict=True))
            whole = stands >= start and leaves <= end
            words.append(Wanted(text, lane, (Bar(0, a, b, False),), whole, number=True))
    return words


def place_text(value: float, slides: bool) -> str:
    """Format a joint position: degrees, with a tenth if not whole, or mm."""
    shown = value * 1e3 if slides else math.degrees(value)
    digits = 0 if slides or abs(shown - round(shown)) < STYLE.whole else 1
    text = f"{round(shown, digits) + 0.0:.{digits}f}".replace("-", "−")
    return f"{text} mm" if slides else f"{text}°"


KINDS = {
    "transfer": ("transfer", "#6f7e93"),
    "approach": ("approach", "#9aa7b7"),
    "retract": ("retract", "#c3ccd6"),
    "pick": ("dwell: pick", "#07c679"),
    "place": ("dwell: place", "#592b65"),
    "dwell": ("dwell", "#e8a87c"),
    "path": ("path", "#e8cf11"),
    "seam": ("seam", "#97491c"),
    "return": ("return", "#e4e8ec"),
}
"""Names of bars in the legend, and their colours; a dwell's by its action."""
PICKS: Mapping[str, str] = {"pick": "pick", "take": "pick", "place": "place", "give": "place"}
"""Dwell styles by action; other actions are drawn as `dwell`."""
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
"""Names of waits in the legend, with colours and hatches."""
TURNS = ("platform moves", "#5a5a5a")
"""Name of platform moves in the legend, with their colour."""


@dataclass(frozen=True)
class _Style:
    """Look of one kind of bars."""

    name: str
    colour: str
    hatch: str = ""


def draw_gantt(schedule: Schedule, job: Job, kind: str) -> bytes:
    """Draw the activities of arms and platform as bars over time, in several rows.

    Waits are hatched by their reason. Bars have the ids of their tasks if these fit, and the platform's lane has its
    angle at rest.

    Args:
        schedule: with segments.
        job: the planned job.
        kind: one of FIGURE_KINDS.
    """
    lanes = [*schedule.robot.arms, *(["platform"] if schedule.robot.platform else [])]
    count = row_count(schedule)
    span = max(schedule.duration / count, STYLE.least)
    row = STYLE.above + STYLE.lane * len(lanes) + STYLE.below
    bars, moving = _bars(schedule, lanes), platform_moves(schedule)
    present = {style.name: style for _, style in bars}
    legend = STYLE.legend + STYLE.line * max(0, math.ceil(len(present) / STYLE.columns) - 1)
    height = STYLE.title + count * row + (count - 1) * STYLE.between + legend
    figure = new_figure(STYLE.width, height)
    # Axes are placed by hand, because the fit of words in bars must be known in advance.
    figure.set_layout_engine("none")
    inch = (STYLE.width - STYLE.left - STYLE.right) / span
    starts = [number * span for number in range(count)]
    tasks = [task_words(schedule, list(schedule.robot.arms), t, t + span) for t in starts]
    stands = [platform_words(schedule, moving, len(lanes) - 1, t, t + span) for t in starts]
    words = [label for rows in (tasks, stands) for label in labels([*chain(*rows)], inch)]
    for number, start in enumerate(starts):
        bottom = legend + STYLE.below + (count - 1 - number) * (row + STYLE.between)
        place = [
            STYLE.left / STYLE.width,
            bottom / height,
            1.0 - (STYLE.left + STYLE.right) / STYLE.width,
        ]
        axes = figure.add_axes((*place, STYLE.lane * len(lanes) / height))
        _draw_row(axes, bars, start, start + span, schedule.duration)
        _write(axes, [word for word in words if start <= word.time < start + span])
        _dress(axes, lanes, schedule, start, start + span)
        _number_stages(axes, schedule, start, start + span, inch)
    _title_and_legend(figure, title(schedule, job), present, height)
    return rendered(figure, kind)


def row_count(schedule: Schedule) -> int:
    """Compute the number of rows of the time axis: more stops need more rows."""
    stops = [
        len({(s.task, s.action) for s in schedule.segments if s.arm == arm and s.task})
        for arm in schedule.robot.arms
    ]
    return min(STYLE.most_rows, max(1, math.ceil(max(stops, default=0) / STYLE.stops_a_row)))


def _bars(schedule: Schedule, lanes: Sequence[str]) -> dict[tuple[int, _Style], list[Any]]:
    """Collect spans (start, length) [s] by lane and look."""
    bars: dict[tuple[int, _Style], list[Any]] = {}
    for part in schedule.segments:
        if part.arm in lanes and part.end - part.start > STYLE.rounding:
            key = lanes.index(part.arm), _style(part)
            bars.setdefault(key, []).append((part.start, part.end - part.start))
    moves = [(start, end - start) for start, end in platform_moves(schedule)]
    if moves:
        bars[len(lanes) - 1, _Style(*TURNS)] = moves
    return bars


def _style(part: Segment) -> _Style:
    if part.kind == "wait":
        return _Style(*REASONS[part.reason])
    return _Style(*KINDS[PICKS.get(part.action, "dwell") if part.kind == "dwell" else part.kind])


def _draw_row(
    axes: Any, bars: dict[tuple[int, _Style], list[Any]], start: float, end: float, last: float
) -> None:
    """Draw a row's bars, with time after the end in grey."""
    for (lane, style), spans in bars.items():
        inside = [span for span in spans if span[0] < end and sum(span) > start]
        axes.broken_barh(
            inside,
            (lane - STYLE.bar / 2.0, STYLE.bar),
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


def _number_stages(axes: Any, schedule: Schedule, start: float, end: float, inch: float) -> None:
    """Draw numbered stage starts if both arms start stages together."""
    free_from = start
    for number, stage in enumerate(schedule.stages, 1):
        if stage.arm or not start <= stage.start < end:
            continue
        axes.axvline(stage.start, color="0.75", linewidth=0.6, zorder=0.5)
        if stage.start >= free_from:
            style = {"size": STYLE.number_size, "color": "0.4", "clip_on": False}
            axes.text(stage.start, -0.52, f"{number}", ha="left", va="bottom", **style)
            width = text_width(f"{number}") * STYLE.number_size + STYLE.padding
            free_from = stage.start + width / POINTS / inch


def _dress(axes: Any, lanes: Sequence[str], schedule: Schedule, start: float, end: float) -> None:
    """Format a row's axes: lanes from top to bottom, time in s."""
    axes.set_xlim(start, end)
    axes.set_ylim(len(lanes) - 0.5, -0.5)
    axes.set_yticks(range(len(lanes)), lanes)
    axes.tick_params(axis="y", length=0)
    axes.tick_params(axis="x", labelsize=8)
    if end >= schedule.duration:
        axes.set_xlabel("time [s]", fontsize=8, labelpad=1)
    axes.spines[["top", "right", "left"]].set_visible(False)
    axes.set_axisbelow(True)
    axes.grid(axis="x", color="0.88", linewidth=0.6)


def _title_and_legend(figure: Any, heading: str, present: dict[str, _Style], height: float) -> None:
    from matplotlib.patches import Patch

    figure.text(
        STYLE.left / STYLE.width,
        1.0 - 0.5 * STYLE.title / height,
        heading,
        size=11,
        va="center",
        parse_math=False,
    )
    handles = [
        Patch(
            facecolor=present[name].colour,
            hatch=present[name].hatch or None,
            edgecolor="0.55" if present[name].hatch else present[name].colour,
            linewidth=0.0,
            label=name,
        )
        for name in dict.fromkeys(row[0] for row in (*KINDS.values(), *REASONS.values(), TURNS))
        if name in present
    ]
    if handles:
        figure.legend(
            handles=handles,
            loc="lower left",
            bbox_to_anchor=(STYLE.left / STYLE.width, 0.03 / height),
            bbox_transform=figure.transFigure,
            ncols=min(STYLE.columns, len(handles)),
            frameon=False,
            fontsize=8,
            borderaxespad=0.0,
            borderpad=0.0,
            handlelength=1.8,
            columnspacing=1.4,
        )


def title(schedule: Schedule, job: Job) -> str:
    """Compose the figure's heading: job, robot, time, and a meaningful bound and gap."""
    what = "cycle time" if job.returns else "duration"
    names = dict.fromkeys((plan_title(schedule), schedule.robot.name))
    text = f"{', '.join(names)}: {what} {schedule.duration:.3f} s"
    gap = relative_gap(schedule)
    if schedule.lower_bound and gap is not None:
        text += f", bound {schedule.lower_bound:.3f} s, gap {gap:.1%}"
    return text
