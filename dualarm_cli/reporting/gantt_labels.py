"""Words in a Gantt chart: which fit into which bars, so that none lies on another or is cut."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby

from dualarm_cli.model.job import AT_STANDS
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.planning.waiting import MOVES

SIZES = {8.0: 0.95, 7.0: 0.95, 6.0: 0.6}
"""Sizes in which words are tried [points], and the share of them that must fit."""
FREE = 3.0
"""What is free beside a word in its bar, both sides together [points]."""
POINTS = 72.0
"""Points in an inch."""
DARK, BRIGHT = "0.15", "white"
ON_DARK = ("transfer", "return", "path", "seam")
"""Bars on which words are bright."""


@dataclass(frozen=True)
class Label:
    """One word, centred."""

    time: float
    """Where it is [s]."""
    lane: int
    """In which lane."""
    text: str
    """What it says."""
    size: float
    """Its size [points]."""
    colour: str
    """Its colour."""


@dataclass(frozen=True)
class Bar:
    """A place for a word."""

    rank: int
    """Bars of lower rank are preferred, among equals the longest."""
    start: float
    """Where it begins [s]."""
    end: float
    """Where it ends [s]."""
    dark: bool
    """Whether words on it are bright."""


@dataclass(frozen=True)
class Wanted:
    """A word, and the bars in which it may be written."""

    text: str
    """What it says."""
    lane: int
    """In which lane."""
    bars: tuple[Bar, ...]
    """Where; the best of those that hold it is taken."""
    whole: bool
    """Whether nothing of them is cut off at the end of a row."""


def task_words(schedule: Schedule, arms: Sequence[str], start: float, end: float) -> list[Wanted]:
    """Returns the ids of tasks for a row: one for each stop, in its transfer rather than in another bar.

    Args:
        schedule: with segments.
        arms: the lanes.
        start: of the row [s].
        end: of the row [s].
    """
    words = []
    for lane, arm in enumerate(arms):
        own = [s for s in schedule.segments if s.arm == arm and s.end > start and s.start < end]
        own.sort(key=lambda part: part.start)
        for (task, action), run in groupby(own, key=lambda part: (part.task, part.action)):
            parts = [part for part in run if part.kind != "wait"]
            bars = tuple(
                Bar(
                    part.kind not in MOVES,
                    max(part.start, start),
                    min(part.end, end),
                    part.kind in ON_DARK,
                )
                for part in parts
            )
            if task and bars:
                whole = parts[0].start >= start and parts[-1].end <= end
                # What a tool is changed for is seen from what follows.
                text = task.split(" (")[0] if action in AT_STANDS else task
                words.append(Wanted(text, lane, bars, whole))
    return words


def labels(words: Sequence[Wanted], inch: float) -> list[Label]:
    """Returns the words that fit into their bars, all of one size: the largest in which nearly all of them fit.

    Where even in the smallest size only few do, there are none: the others would be looked for.

    Args:
        words: of all rows.
        inch: how long a second is [inch].
    """
    asked = sum(word.whole for word in words)
    for size, share in SIZES.items():
        placed = [(word, _place(word, inch, size)) for word in words]
        if sum(word.whole and bar is not None for word, bar in placed) >= share * asked:
            return [
                Label(
                    (bar.start + bar.end) / 2.0,
                    word.lane,
                    word.text,
                    size,
                    BRIGHT if bar.dark else DARK,
                )
                for word, bar in placed
                if bar is not None
            ]
    return []


def _place(word: Wanted, inch: float, size: float) -> Bar | None:
    """Returns the best bar that holds a word of a size, or None."""
    room = text_width(word.text) * size + FREE
    large = [bar for bar in word.bars if (bar.end - bar.start) * inch * POINTS >= room]
    return min(large, key=lambda bar: (bar.rank, round(bar.start - bar.end, 6)), default=None)


@lru_cache(maxsize=4096)
def text_width(text: str) -> float:
    """Returns how wide a text is in size 1 [points]."""
    from matplotlib.textpath import TextPath

    # Dollars would be taken for formulas.
    box = TextPath((0.0, 0.0), text.replace("$", "S"), size=100.0).get_extents()
    return float(box.x1) / 100.0 if text.strip() else 0.0
