"""Schedules of thousands of events: the time to judge them grows as they do."""

from __future__ import annotations

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification import verify


def again_and_again(schedule: Schedule, times: int) -> Schedule:
    """Returns a cycle so many times over, each with tasks of its own; ways back are transfers to what follows."""
    one, knots = schedule.trajectory, {}
    duration = float(one.time[-1] - one.time[0])
    later = duration * np.arange(times)
    knots["time"] = np.append((one.time[:-1] + later[:, None]).ravel(), one.time[-1] + later[-1])
    for name in ("position", "velocity", "acceleration"):
        rows = getattr(one, name)
        knots[name] = np.concatenate([np.tile(rows[:-1], (times, 1)), rows[-1:]])
    segments = [
        replace(
            segment,
            task=segment.task and f"{segment.task}-{k}",
            kind="transfer" if segment.kind == "return" and k < times - 1 else segment.kind,
            start=segment.start + begin,
            end=segment.end + begin,
        )
        for k, begin in enumerate(later.tolist())
        for segment in schedule.segments
    ]
    return replace(
        schedule,
        motion=JointMotion.of(replace(one, **knots)),
        stages=tuple(
            replace(
                stage,
                start=stage.start + begin,
                end=stage.end + begin,
                tasks=tuple(f"{task}-{k}" for task in stage.tasks),
            )
            for k, begin in enumerate(later.tolist())
            for stage in schedule.stages
        ),
        segments=tuple(segments),
        events=tuple(
            replace(event, time=event.time + begin, task=f"{event.task}-{k}")
            for k, begin in enumerate(later.tolist())
            for event in schedule.events
        ),
    )


def test_two_thousand_events_are_judged_in_seconds(clean: SimpleNamespace) -> None:
    """Five hundred cycles. To compare every segment with every event took minutes; the rest takes two seconds."""
    long = again_and_again(clean.schedule, 500)
    assert (len(long.events), len(long.segments)) == (2000, 9000)
    begun = time.process_time()
    judged = verify(long)
    assert time.process_time() - begun < 25.0
    assert judged.passed, judged.failures


def test_an_event_off_its_knot_is_found_among_thousands(clean: SimpleNamespace) -> None:
    """The last but one is a millisecond late; the knots next to it are farther."""
    long = again_and_again(clean.schedule, 100)
    late = replace(long.events[-2], time=long.events[-2].time + 1e-3)
    wrong = verify(replace(long, events=(*long.events[:-2], late, long.events[-1])))
    [check] = [check for check in wrong.checks if check.name == "events_at_knots"]
    assert check.verdict == "failed"
    assert check.measured is not None
    assert abs(check.measured - 1e-3) < 1e-9
