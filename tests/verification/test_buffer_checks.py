"""Parts and room of buffers, from the events alone."""

from __future__ import annotations

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.kinds.buffer.checks import check_buffers
from dualarm_cli.model.part_flow import Buffer


@pytest.fixture(scope="module")
def made(clean):
    """Makes a job and a schedule of events at one buffer: (time, dwell, action, arm), tasks named by their number."""
    blank, template = clean.schedule.events[0], clean.job.tasks[0]

    def both(rows, capacity, initial, *, arm=None, **job):
        tasks, events = [], []
        for k, (time, dwell, action, by) in enumerate(rows):
            stop = dataclasses.replace(template.stops[0], action=action, buffer="tray")
            tasks.append(dataclasses.replace(template, id=f"t{k}", arm=arm or by, stops=(stop,)))
            events.append(
                dataclasses.replace(
                    blank, time=time, dwell=dwell, action=action, arm=by, task=f"t{k}"
                )
            )
        asked = dataclasses.replace(
            clean.job, tasks=tuple(tasks), buffers={"tray": Buffer(capacity, initial)}, **job
        )
        return dataclasses.replace(clean.schedule, events=tuple(events[::-1])), asked

    return both


PUT, TAKE = "place", "pick"


@pytest.mark.parametrize(
    ("rows", "capacity", "initial", "detail"),
    [
        ([(1.0, 0.5, PUT, "left"), (1.5, 0.5, TAKE, "right")], 1, 0, ""),
        ([(1.0, 0.5, PUT, "left"), (1.4, 0.5, TAKE, "right")], 1, 0,
         "buffer tray: at 1.400 s the right arm's t1 pick takes a part "
             "from an empty buffer: 0 can be taken (capacity 1)"),
        ([(1.0, 0.5, TAKE, "left"), (1.5, 0.5, PUT, "right")], 1, 1, ""),
        ([(1.0, 0.5, TAKE, "left"), (1.4, 0.5, PUT, "right")], 1, 1,
         "buffer tray: at 1.400 s the right arm's t1 place has no room: 1 of 1 places are taken"),
        ([(1.0, 0.5, PUT, "left"), (2.0, 0.5, PUT, "left"), (3.0, 0.1, PUT, "right")], 2, 0,
         "buffer tray: at 3.000 s the right arm's t2 place has no room: 2 of 2 places are taken"),
        ([(1.0, 0.5, PUT, "left"), (1.1, 0.5, TAKE, "right")], 2, 1, ""),
        # Both faults, the first one in time is told.
        ([(1.0, 0.0, TAKE, "left"), (2.0, 0.0, PUT, "left"), (3.0, 0.0, PUT, "right")], 1, 0,
         "buffer tray: at 1.000 s the left arm's t0 pick takes a part "
             "from an empty buffer: 0 can be taken (capacity 1)"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("order", ["given", "optimise"])
def test_what_lacks_a_part_or_room_is_named(made, rows, capacity, initial, detail, order):
    """From a place's event to the end of a pick's dwell there is no room, from the end of its dwell a part."""
    schedule, job = made(rows, capacity, initial, order=order)
    check = check_buffers(schedule, job)
    assert check.verdict == ("failed" if detail else "passed")
    assert check.detail == (detail or "a part for every pick, and room for every place")


@pytest.mark.parametrize("action", [PUT, TAKE])
def test_each_event_that_lacks_a_part_or_room_is_one_fault(made, action):
    """Three alike, half a second each, at a buffer that serves one of them, then one the other way: two are faults."""
    other = PUT if action == TAKE else TAKE
    rows = [(float(t), 0.5, action, "left") for t in (1, 2, 3)] + [(4.0, 0.5, other, "right")]
    check = check_buffers(*made(rows, 1, int(action == TAKE)))
    assert (check.verdict, check.measured) == ("failed", 2)


@pytest.mark.parametrize(("share", "expected"), [(0.9, "passed"), (1.1, "failed")])
@pytest.mark.parametrize(("one", "other", "initial"), [(PUT, TAKE, 0), (TAKE, PUT, 1)])
def test_what_gives_may_be_a_nanosecond_late(made, share, expected, one, other, initial):
    """A part is there, or room is, when a dwell is over, and is needed that much earlier."""
    rows = [(1.0, 0.5, one, "left"), (1.5 - share * 1e-9, 0.5, other, "right")]
    assert check_buffers(*made(rows, 1, initial)).verdict == expected


def test_who_does_it_is_for_the_order_to_judge(made):
    """A part counts whichever arm put it there; what any arm may do too."""
    rows = [(1.0, 0.5, PUT, "left"), (1.4, 0.5, TAKE, "right")]
    for arm in ("any", "left"):
        assert check_buffers(*made(rows, 1, 0, arm=arm)).verdict == "failed"


def test_where_no_task_uses_a_buffer_nothing_is_checked(clean, made):
    """And nothing passes; nor where nothing of it is done."""
    assert check_buffers(clean.schedule, clean.job).verdict == "not checked"
    schedule, job = made([(1.0, 0.5, PUT, "left")], 1, 0)
    nothing = dataclasses.replace(schedule, events=())
    assert check_buffers(nothing, job).verdict == "not checked"


EVENT = st.tuples(
    st.integers(0, 30), st.integers(0, 5), st.sampled_from((PUT, TAKE)), st.sampled_from(("left", "right"))
)  # fmt: skip


@given(st.lists(EVENT, min_size=1, max_size=8), st.integers(1, 3), st.integers(0, 3))
@settings(max_examples=200, deadline=None)
def test_it_passes_just_where_levels_hold_at_all_instants(made, rows, capacity, initial):
    """Against levels at every tenth of a tick just after it, of events at whole ticks."""
    initial = min(initial, capacity)
    schedule, job = made([(float(t), float(d), *rest) for t, d, *rest in rows], capacity, initial)
    good = True
    for tick in range(40):
        # What begins at an instant has begun right after it, what ends then is over.
        there = initial + sum(
            (t + d <= tick) if action == PUT else -(t <= tick) for t, d, action, _ in rows
        )
        room = initial + sum(
            (t <= tick) if action == PUT else -(t + d <= tick) for t, d, action, _ in rows
        )
        good = good and there >= 0 and room <= capacity
    assert (check_buffers(schedule, job).verdict == "passed") == good


def test_what_uses_no_buffer_excuses_nothing(made):
    """A pick from an empty tray beside a spare one, and beside a task without a buffer."""
    schedule, job = made([(1.0, 0.2, TAKE, "left")], 1, 0)
    spare = dataclasses.replace(job, buffers={"spare": Buffer(1, 0), **job.buffers})
    plain = dataclasses.replace(job.tasks[0].stops[0], buffer="")
    other = dataclasses.replace(job.tasks[0], id="other", stops=(plain,))
    more = dataclasses.replace(job, tasks=(other, *job.tasks))
    for asked in (job, spare, more):
        assert check_buffers(schedule, asked).verdict == "failed"
