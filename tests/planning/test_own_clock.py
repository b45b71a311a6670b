"""One arm's way with waits in it: the same motion, later."""

from __future__ import annotations

import dataclasses
from itertools import pairwise

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.motion.builder import Motion
from dualarm_cli.planning.asynchronous.own_clock import OwnClock, Wait, piece, with_holds
from dualarm_cli.planning.planner import plan_without_bound


@pytest.fixture(scope="module")
def job(tasks_folder):
    """A pick and place, a bare move, and another pick and place of the left robot, from a free start."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    return dataclasses.replace(job, tasks=tuple(t for t in job.tasks if t.arm == "left"))


@pytest.fixture(scope="module")
def clock(job):
    """Its way through them."""
    return own_clock(job)


def own_clock(job):
    """Returns the left robot's way through its tasks."""
    found = plan_without_bound(
        job, PlanSettings(effort="quick", blend="none"), check_collisions=False
    )
    motion = Motion(found.trajectory, found.stages, found.segments, found.events)
    arm = next(arm for arm in job.cell.robot.arms if arm.name == "left")
    return OwnClock.of(motion, "left", arm.joints)


def some_waits(clock, rng):
    """Returns waits of random lengths at some of the places to rest."""
    rests = sorted(set(clock.rests()))
    some = [at for at in rests if rng.random() < 0.6]
    return [Wait(at, float(rng.uniform(0.05, 3.0)), "shared_zone") for at in some]


def test_an_arm_rests_where_it_may_wait(clock):
    """Before every transfer and before every first line: its joints stand still."""
    rests = clock.rests()
    assert len(rests) >= 8
    assert np.abs(clock.trajectory.at(np.array(rests))[1]).max() < 1e-9
    assert rests[0] == 0.0
    moves = [p.start for p in clock.segments if p.kind in ("transfer", "return")]
    assert set(moves) <= set(rests)


def test_lines_begin_after_a_transfer_and_a_bare_move_with_it(clock):
    """Each task's approach; of the bare move, which is over as soon as it is there, its transfer."""
    begins = clock.line_begins()
    approach = {}
    for part in clock.segments:
        if part.kind == "approach":
            approach.setdefault(part.task, part.start)
    assert {name: begins[name] for name in approach} == approach
    move = next(p for p in clock.segments if p.task == "c" and p.kind == "transfer")
    assert begins["c"] == move.start
    assert set(begins) == {"a", "c", "d"}
    assert set(begins.values()) <= set(clock.rests())


@pytest.mark.parametrize("seed", range(6))
def test_with_waits_all_is_as_before_but_later(clock, seed):
    """Positions at shifted instants, standing still in between."""
    rng = np.random.default_rng(seed)
    waits = some_waits(clock, rng)
    later = clock.with_waits(waits[::-1])
    total = sum(wait.length for wait in waits)
    assert later.duration == pytest.approx(clock.duration + total, abs=1e-9)
    time = rng.uniform(0.0, clock.duration, 400)
    shift = np.array([sum(w.length for w in waits if w.at < t) for t in time])
    for old, new in zip(clock.trajectory.at(time), later.trajectory.at(time + shift), strict=True):
        np.testing.assert_allclose(new, old, rtol=0, atol=1e-7)
    gone = 0.0
    for wait in waits:
        inside = wait.at + gone + wait.length * rng.random(5)
        q, v = later.trajectory.at(inside)[:2]
        expected = clock.trajectory.at(np.array([wait.at]))[0]
        np.testing.assert_allclose(q, np.repeat(expected, 5, axis=0), rtol=0, atol=1e-9)
        assert np.abs(v).max() < 1e-9
        gone += wait.length


@pytest.mark.parametrize("seed", range(6))
def test_segments_follow_one_another_with_the_waits_among_them(clock, seed):
    """No gaps; what is no wait lasts as long as before and has its names."""
    waits = some_waits(clock, np.random.default_rng(10 + seed))
    later = clock.with_waits(waits)
    parts = later.segments
    assert parts[0].start == 0.0
    assert parts[-1].end == pytest.approx(later.duration, abs=1e-9)
    for one, other in pairwise(parts):
        assert other.start == pytest.approx(one.end, abs=1e-9)
    old = [(p.kind, p.task, p.action, p.end - p.start) for p in clock.segments]
    new = [(p.kind, p.task, p.action, p.end - p.start) for p in parts if p.kind != "wait"]
    assert [row[:3] for row in new] == [row[:3] for row in old]
    np.testing.assert_allclose([row[3] for row in new], [row[3] for row in old], atol=1e-9)
    idle = [p.end - p.start for p in parts if p.kind == "wait"]
    np.testing.assert_allclose(idle, [w.length for w in waits], atol=1e-9)
    # What comes after an event, and each stage's segments, stay with it.
    kinds = {(p.task, p.action, p.kind): p for p in parts}
    assert len(later.events) == len(clock.events)
    for event in later.events:
        dwell = kinds.get((event.task, event.action, "dwell"))
        if dwell is not None:
            assert event.time == pytest.approx(dwell.start, abs=1e-9)
    for stage in later.stages:
        own = [e for e in later.events if e.task in stage.tasks]
        assert any(stage.start - 1e-9 <= e.time <= stage.end + 1e-9 for e in own) or not own
    assert len(later.stages) == len(clock.stages)


def test_a_wait_before_a_bare_move_begins_delays_its_event(clock):
    """By its length; a wait where it leaves again does not."""
    begin = clock.line_begins()["c"]
    at = {event.task: event.time for event in clock.events}["c"]
    before = clock.with_waits([Wait(begin, 2.0, "window")])
    after = clock.with_waits([Wait(at, 2.0, "partner")])
    assert {e.task: e.time for e in before.events}["c"] == pytest.approx(at + 2.0)
    assert {e.task: e.time for e in after.events}["c"] == pytest.approx(at)


def test_a_bare_move_to_where_the_arm_begins_comes_after_what_it_waits_for(job):
    """With a free start the first task's move takes no time: event and stage begin when the wait of 2 s is over."""
    first = own_clock(dataclasses.replace(job, tasks=(job.tasks[1], job.tasks[0])))
    assert job.start == "free" and first.line_begins()["c"] == 0.0
    later = first.with_waits([Wait(0.0, 2.0, "window")])
    assert {e.task: e.time for e in later.events}["c"] == pytest.approx(2.0)
    (stage,) = (s for s in later.stages if "c" in s.tasks)
    assert (stage.start, stage.end) == pytest.approx((2.0, 2.0))
    waited = [p for p in later.segments if p.kind == "wait"]
    assert [(p.start, p.end) for p in waited] == [(0.0, pytest.approx(2.0))]


def test_no_waits_are_no_change(clock):
    """Nor are waits of no length."""
    assert clock.with_waits([]) is clock
    assert clock.with_waits([Wait(0.0, 0.0, "partner")]) is clock


def test_pieces_put_together_are_the_whole(clock):
    """Between any two rests, from time 0; all pieces one after the other last as long as all."""
    rests = [*sorted(set(clock.rests())), clock.duration]
    lengths = []
    for start, end in pairwise(rests):
        if end - start < 1e-6:
            continue
        own = piece(clock.trajectory, start, end)
        lengths.append(own.duration)
        assert own.time[0] == 0.0
        assert own.duration == pytest.approx(end - start, abs=1e-9)
        time = np.linspace(0.0, own.duration, 50)
        for k, (part, whole) in enumerate(
            zip(own.at(time), clock.trajectory.at(start + time), strict=True)
        ):
            # Accelerations may jump at the very ends.
            rows = slice(None) if k < 2 else slice(1, -1)
            np.testing.assert_allclose(part[rows], whole[rows], rtol=0, atol=1e-6)
    assert sum(lengths) == pytest.approx(clock.duration, abs=1e-9)


def test_holds_at_the_very_ends_are_holds(clock):
    """Before it begins and after it is over."""
    end = clock.duration
    longer = with_holds(clock.trajectory, [Wait(0.0, 1.0, "window"), Wait(end, 0.5, "partner")])
    assert longer.duration == pytest.approx(end + 1.5)
    q = longer.at(np.array([0.0, 0.5, 1.0, end + 1.0, end + 1.5]))[0]
    np.testing.assert_allclose(q[:3], clock.trajectory.position[[0, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(q[3:], clock.trajectory.position[[-1, -1]], atol=1e-9)
