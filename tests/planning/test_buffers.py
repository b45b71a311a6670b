"""Buffers from the job to the plan: levels of stages, the plane of two timelines, plans, and what is said of none."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.buffer.checks import check_buffers
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.model.schedule import Event, Segment
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders.decided_jobs import stage_by_stage
from dualarm_cli.orders.model.buffer_numbers import (
    check_stage_levels,
    keeps_borders,
    with_levels_after,
)
from dualarm_cli.planning.asynchronous.meeting_arms import MeetingBuffers, first_missed
from dualarm_cli.planning.asynchronous.own_clock import ClockSteps, OwnClock
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.planning.section_plans import section_orders
from dualarm_cli.stages.serving import cell_model
from dualarm_cli.timing.composition import hold
from dualarm_cli.verification import verify

QUICK = PlanSettings(effort="quick")


@pytest.fixture(scope="module")
def chute(tasks_folder):
    """Four loads by the left arm into room for two, four unloads and two labels by the right one."""
    return load_job(tasks_folder / "12_chute" / "tasks.yaml")


def only(job, *names, **changes):
    """Returns a job with some of its tasks in a new order."""
    tasks = {task.id: task for task in job.tasks}
    return dataclasses.replace(job, tasks=tuple(tasks[name] for name in names), **changes)


def test_stages_in_which_a_part_is_missing_are_named(chute):
    """Side by side the first unload is before the first load; a stage later it is not."""
    job = dataclasses.replace(chute, mode="paired", order="given")
    with pytest.raises(InfeasibleError) as caught:
        check_stage_levels(job)
    text = str(caught.value)
    unload = next(t for t in job.tasks if t.id == "unload-1").stops[0]
    assert text.startswith(f"{unload.place}: buffer 'chute' holds 0 of at most 2 parts before ")
    assert "before stage 1, in which 'unload-1' takes 1 out" in text
    assert "order: optimise" in text
    good = only(job, "load-1", "label-1", "load-2", "unload-1")
    check_stage_levels(good)
    # A put and a take in one stage: there has to be a part before, and room for one more.
    key = {name: ("left" if "load-" in name[:5] else "right") for name in ("load-1", "unload-1")}
    stage = tuple((arm, name, "place" if arm == "left" else "pick") for name, arm in key.items())
    side = only(job, "load-1", "unload-1", pairing=(stage,))
    for initial, fits in ((0, False), (1, True), (2, False)):
        asked = dataclasses.replace(side, buffers={"chute": Buffer(2, initial)})
        if fits:
            check_stage_levels(asked)
            continue
        with pytest.raises(InfeasibleError, match="and either arm may be the first there"):
            check_stage_levels(asked)


def test_stage_by_stage_an_arm_waits_for_parts_and_room(chute):
    """What is given becomes stages that keep all levels; an order in which arms wait forever is said to be one."""
    job = dataclasses.replace(chute, order="given")
    found = stage_by_stage(job)
    check_stage_levels(found)
    done = [key for stage in found.pairing for key in stage]
    assert sorted(done) == sorted(job.stops_by_key())
    for arm in ("left", "right"):
        asked = [(task.id, stop.action) for task, stop in job.stops_of(arm)]
        assert [key[1:] for key in done if key[0] == arm] == asked
    names = ("load-1", "unload-1")
    tasks = {t.id: t for t in only(job, *names).tasks}
    # The load waits for the unload, the unload for a part.
    tasks["load-1"] = dataclasses.replace(tasks["load-1"], after=("unload-1",))
    stuck = dataclasses.replace(job, tasks=tuple(tasks.values()))
    with pytest.raises(InfeasibleError) as caught:
        stage_by_stage(stuck)
    assert "'load-1' waits for tasks that come later (pick)" in str(caught.value)
    assert "'unload-1' waits for a part in buffer 'chute' (0 of at most 2) (pick)" in str(
        caught.value
    )


def test_what_tasks_leave_in_a_buffer_is_what_the_next_ones_find(chute):
    """Levels carry over; where they cannot, whatever the order, it is said."""
    tasks = {task.id: task for task in chute.tasks}
    done = [tasks["load-1"], tasks["load-2"], tasks["unload-1"]]
    assert with_levels_after(chute, done).buffers["chute"].initial == 1
    with pytest.raises(InfeasibleError, match="'chute' holds 3 parts after 'load-3'"):
        with_levels_after(chute, [tasks["load-1"], tasks["load-2"], tasks["load-3"]])
    with pytest.raises(InfeasibleError, match="holds -1 parts after 'unload-1'"):
        with_levels_after(chute, [tasks["unload-1"]])


@pytest.mark.parametrize(
    ("mode", "order"), [("free", "given"), ("free", "optimise"), ("paired", "optimise")]
)
def test_plans_keep_the_buffer(chute, mode, order):
    """Two loads and unloads of room for one: all checks; put forward in time a pick has no part."""
    names = ("load-1", "load-2", "unload-1", "unload-2", "label-1")
    job = only(chute, *names, mode=mode, order=order, buffers={"chute": Buffer(1)})
    schedule = plan_without_bound(job, QUICK, check_collisions=False)
    judged = verify(schedule, job)
    assert judged.failures == ()
    assert {c.name: c.verdict for c in judged.checks}["buffers"] == "passed"
    first = min(e.time for e in schedule.events if e.task.startswith("load"))
    for k, event in enumerate(schedule.events):
        if event.action == "pick" and event.task.startswith("unload"):
            events = list(schedule.events)
            events[k] = dataclasses.replace(event, time=first)
            moved = dataclasses.replace(schedule, events=tuple(events))
            assert check_buffers(moved, job).verdict == "failed"
    if mode == "free" and order == "given":
        assert "buffer" in {part.reason for part in schedule.segments}


def test_a_buffer_that_no_order_keeps_is_named(chute):
    """Both rules together are impossible: the load after the unload, and a part for the unload."""
    tasks = {t.id: t for t in only(chute, "load-1", "unload-1", "label-1").tasks}
    tasks["load-1"] = dataclasses.replace(tasks["load-1"], after=("unload-1",))
    for mode in ("paired", "free"):
        job = dataclasses.replace(chute, tasks=tuple(tasks.values()), mode=mode)
        with pytest.raises(InfeasibleError) as caught:
            plan_without_bound(job, QUICK, check_collisions=False)
        text = str(caught.value)
        assert "no order keeps these rules together" in text
        assert "'load-1' after 'unload-1'" in text
        assert "buffer chute (room for 2, 0 at the start)" in text


def test_exit_codes(tasks_folder, tmp_path, capsys):
    """3 for stages that do not keep a buffer, 2 for a name that there is not."""
    folder = tasks_folder / "12_chute"
    (tmp_path / ".git").mkdir()
    (tmp_path / "cell.yaml").write_text((folder / "cell.yaml").read_text())
    text = (folder / "tasks.yaml").read_text()
    given_file = text.replace("mode: free", "mode: paired").replace("optimise", "given")
    (tmp_path / "tasks.yaml").write_text(given_file)
    out = ["--out", str(tmp_path / "out"), "--effort", "quick"]
    assert run(["plan", str(tmp_path / "tasks.yaml"), *out]) == 3
    assert "buffer 'chute' holds 0 of at most 2 parts before stage 1" in capsys.readouterr().err
    (tmp_path / "tasks.yaml").write_text(text.replace("  chute: {", "  shute: {"))
    assert run(["plan", str(tmp_path / "tasks.yaml"), *out]) == 2
    assert "there is no buffer 'chute', did you mean 'shute'?" in capsys.readouterr().err


def way(arm, stops):
    """Returns an arm's clock: a transfer, an approach, a dwell and a retract for each (way, line, dwell, action)."""
    segments, events, clock = [], [], 0.0
    for k, (go, line, dwell, action) in enumerate(stops):
        name = f"{arm}{k}"
        for kind, length in (("transfer", go), ("approach", line), ("dwell", dwell), ("retract", line)):  # fmt: skip
            if kind == "dwell":
                events.append(Event(clock, arm, name, action, "", pin.SE3.Identity(), dwell))
            segments.append(Segment(arm, kind, name, action, clock, clock + length))
            clock += length
    still = hold(("joint",), np.zeros(1), clock)
    return OwnClock(arm, still, (), tuple(segments), tuple(events)), clock


ROUNDING = -1e-9
"""What is over at an instant but for rounding is over [s]."""
TIME = st.floats(0.05, 1.0)
STOPS = st.lists(
    st.tuples(TIME, TIME, TIME, st.sampled_from(("pick", "place"))), min_size=1, max_size=4
)


@given(STOPS, STOPS, st.integers(1, 3), st.integers(0, 3), st.floats(0.02, 0.2))
@example(
    [(1.0, 1.0, 1.0, a) for a in ("place", "place", "pick", "pick")],
    [(0.5, 0.05, 0.05, "pick")],
    1,
    0,
    0.02,
)
@example([(1.0, 1.0, 1.0, "pick")], [(0.90625, 0.0625, 1.0, "pick")], 1, 0, 0.125)
@example(
    [(1.0, 1.0, 1.0, "pick")],
    [(0.921875, 1.0, 0.21875, "place"), (1.0, 0.0625, 0.25, "pick")],
    1,
    0,
    0.125,
)
@settings(max_examples=60, deadline=None)
def test_where_nothing_is_blocked_levels_hold(one, other, capacity, initial, step):
    """At every pair of steps, and half a step before and after; where they hold amply nothing is blocked.

    The step of a rest is that rest's own instant, from which the arm goes on.
    """
    initial = min(initial, capacity)
    made = [way("left", one), way("right", other)]
    keys = {
        (c.arm, e.task, e.action): SimpleNamespace(
            buffer="tray", stored=1 if e.action == "place" else -1
        )
        for c, _ in made
        for e in c.events
    }
    task = SimpleNamespace(stops=[SimpleNamespace(buffer="tray")])
    job = SimpleNamespace(
        stops_by_key=lambda: keys, buffers={"tray": Buffer(capacity, initial)}, tasks=[task]
    )
    grids = [ClockSteps.of(clock.rests(), length, step) for clock, length in made]
    steps = tuple(grid.count for grid in grids)
    band = max(steps)
    blocked = MeetingBuffers(job, [c for c, _ in made], grids).blocked(band)

    def holds(times, slack):
        there = room = initial
        for (clock, _), time in zip(made, times, strict=True):
            for e in clock.events:
                over = e.time + e.dwell
                if e.action == "place":
                    there += over <= time - slack
                    room += e.time <= time + slack
                else:
                    there -= e.time <= time + slack
                    room -= over <= time - slack
        return there >= 0 and room <= capacity

    times = [grid.times() for grid in grids]
    rng = np.random.default_rng(len(one) + 7 * len(other))
    for i, j in rng.integers(0, np.array(steps) + 1, (60, 2)).tolist():
        is_blocked = bool(blocked[i, j - i + band])
        if not is_blocked:
            assert holds((times[0][i], times[1][j]), ROUNDING)
            # In between both have gone on as far.
            on = [own[k : k + 2] for own, k in zip(times, (i, j), strict=True)]
            whole = all(len(two) == 2 and np.isclose(np.diff(two)[0], step) for two in on)
            for part in (0.25, 0.75):
                if whole and not blocked[i + 1, j - i + band]:
                    assert holds((on[0][0] + part * step, on[1][0] + part * step), ROUNDING)
        ample = holds((times[0][i], times[1][j]), 2.01 * step)
        assert not (is_blocked and ample and (i, j) != steps) or _near_rest(made, i, j, step)


def _near_rest(made, i, j, step):
    """Says whether an arm is so near to where it may wait that what it gives does not count yet, or at its end."""
    found = False
    for (clock, length), k in zip(made, (i, j), strict=True):
        found |= any(abs(k * step - rest) <= 2.0 * step for rest in clock.rests())
        found |= k * step >= length - step
    return found


def test_what_is_missed_first_is_what_an_arm_waits_for():
    """On the way of both together a buffer is blocked before or after something else is."""
    steps, band = (10, 10), 10
    buffers = np.zeros((11, 21), dtype=bool)
    buffers[5, 5 - 5 + band] = True
    touching = np.zeros_like(buffers)
    touching[7, band] = True
    assert first_missed(buffers | touching, buffers, steps, (2, 2))
    assert not first_missed(buffers | touching, buffers, steps, (6, 6))
    assert not first_missed(touching, np.zeros_like(buffers), steps, (8, 8))
    # The second arm is at its end already: the first one goes on alone.
    buffers[8, 10 - 8 + band] = True
    assert first_missed(buffers | touching, buffers, steps, (6, 10))


def test_sections_in_orders_that_leave_buffers_impossible_are_left_out(tasks_folder):
    """A load and an unload round a path: one that both are on one side of, or that the load is before, keeps levels."""
    job = load_job(tasks_folder / "09_yumi" / "tasks.yaml")
    load, unload, *path = job.tasks

    def with_buffer(task, action):
        stops = (dataclasses.replace(s, buffer="tray" * (s.action == action)) for s in task.stops)
        return dataclasses.replace(task, stops=tuple(stops))

    load, unload = with_buffer(load, "place"), with_buffer(unload, "pick")
    for tasks, initial, kept in (
        ((load, *path, unload), 0, True),
        ((unload, *path, load), 0, False),
        ((unload, *path, load), 1, True),
        ((load, *path, unload), 1, False),
        ((*path, unload, load), 0, True),
    ):
        asked = dataclasses.replace(job, tasks=tasks, buffers={"tray": Buffer(1, initial)})
        assert keeps_borders(asked) == kept
    bad = dataclasses.replace(
        job, tasks=(unload, *path, load), buffers={"tray": Buffer(1)}, order="optimise"
    )
    orders = section_orders(cell_model(job.cell, "arm_angle"), bad, 24)
    assert orders[0].tasks == bad.tasks
    assert len(orders) > 1
    assert all(keeps_borders(one) for one in orders[1:])
    with pytest.raises(
        InfeasibleError, match="buffer 'tray' holds 0 of at most 1 parts before stage 1"
    ):
        plan_without_bound(dataclasses.replace(bad, order="given"), QUICK, check_collisions=False)
