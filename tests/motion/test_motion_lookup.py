"""Which event is an arm's in a stage, and which segments are lines: looked up as by reading all of them each time."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

from dualarm_cli.motion.builder import LINES, Motion

ARMS = ("left", "right")


def random_motion(seed):
    """Stages of one or two tasks, an event for most of them, some on the border of two, and segments of all kinds."""
    random = np.random.default_rng(seed)
    stages, events, segments, clock = [], [], [], 0.0
    for k in range(30):
        length = float(random.uniform(0.5, 2.0))
        busy = [arm for arm in ARMS if random.random() < 0.7] or ["left"]
        stages.append(SimpleNamespace(tasks=tuple(f"{arm}{k}" for arm in busy), end=clock + length))
        for arm in busy:
            dwell = float(random.choice([0.0, 0.2]))
            at = clock + length - dwell if random.random() < 0.3 else clock + 0.5 * length - 0.2
            events.append(SimpleNamespace(arm=arm, task=f"{arm}{k}", time=at, dwell=dwell))
            cuts = [clock, *np.sort(random.uniform(clock, clock + length, 3)), clock + length]
            for kind, start, end in zip(
                ("transfer", "approach", "dwell", "retract"), cuts, cuts[1:], strict=False
            ):
                segments.append(SimpleNamespace(arm=arm, kind=kind, start=start, end=end))
        clock += length
    events.sort(key=lambda event: event.time)
    segments.sort(key=lambda segment: (segment.arm, segment.start))
    return Motion(None, tuple(stages), tuple(segments), tuple(events))


def event_by_reading(motion, number, arm):
    """The definition: each stage that works at an arm's next event, and ends after it, takes it."""
    left = [event for event in motion.events if event.arm == arm]
    for k, stage in enumerate(motion.stages[: number + 1]):
        if (
            left
            and left[0].task in stage.tasks
            and left[0].time + left[0].dwell <= stage.end + 1e-9
        ):
            event = left.pop(0)
            if k == number:
                return event
    return None


@pytest.mark.parametrize("seed", range(20))
def test_events_and_lines_are_found_as_by_reading_everything(seed):
    """Every arm in every stage, and spans from stage to stage as well as across them."""
    motion = random_motion(seed)
    for k in range(len(motion.stages)):
        for arm in ARMS:
            assert motion.event_of.get((k, arm)) is event_by_reading(motion, k, arm)
    ends = [0.0, *(stage.end for stage in motion.stages)]
    for start, end in [
        *itertools.pairwise(ends),
        (ends[3], ends[9]),
        (0.7, ends[5] - 0.1),
    ]:
        for arms in (("left",), ("right",), ARMS):
            read = [
                s
                for s in motion.segments
                if s.arm in arms
                and s.kind in LINES
                and s.start >= start - 1e-9
                and s.end <= end + 1e-9
            ]
            found = motion.lines_within(arms, start, end)
            assert {id(s) for s in found} == {id(s) for s in read}
