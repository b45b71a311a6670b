"""Schedules taken apart: parts add up to stages, also where the file does not state them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.report.report import build_report
from dualarm_cli.report.stage_parts import stage_parts
from tests.packing_tasks import packing_job


@pytest.fixture(scope="module")
def schedule(tasks_folder):
    """The packing job, its first four tasks, planned."""
    job = packing_job(tasks_folder, 4)
    return plan(job, PlanSettings(platform="exact"))


def test_the_critical_arms_parts_add_up_to_the_stage(schedule):
    """And no other arm's parts add up to more."""
    kinds = ("transfer", "return", "approach", "dwell", "retract")
    parts = stage_parts(schedule)
    assert len(parts) == len(schedule.stages) == 5
    for part in parts:
        length = part.stage.end - part.stage.start
        assert part.length(part.critical, *kinds) == pytest.approx(length, abs=1e-9)
        assert all(part.length(arm, *kinds) <= length + 1e-9 for arm in part.arms)


def test_the_arm_that_ends_last_is_critical_whoever_is_the_bottleneck(schedule):
    """With the platform named, nothing but the ends says which arm it is."""
    stages = tuple(dataclasses.replace(stage, bottleneck="torso_b1") for stage in schedule.stages)
    for part in stage_parts(dataclasses.replace(schedule, stages=stages)):
        end = max(parts[-1].end for parts in part.arms.values())
        assert part.arms[part.critical][-1].end == pytest.approx(end, abs=1e-9)


def test_the_deciding_group_is_that_of_the_bottleneck(schedule):
    """The stage's stated bottleneck is one of the group's joints."""
    robot = schedule.robot
    joints = {"platform": robot.platform, **{n: a.joints for n, a in robot.arms.items()}}
    for part in stage_parts(schedule):
        assert part.stage.bottleneck in joints[part.group]


def test_without_stages_the_kth_events_of_the_arms_make_stage_k(schedule):
    """As many stages as the file had, each ending with a dwell, and the return after them."""
    parts = stage_parts(dataclasses.replace(schedule, stages=(), segments=()))
    assert len(parts) == 5
    for k, part in enumerate(parts[:-1]):
        ends = [e.time + e.dwell for e in schedule.events if e.task in part.stage.tasks]
        assert part.stage.end in ends
        assert {segment.kind for segment in part.arms["left"]} <= {"transfer", "dwell", "retract"}
        assert part.stage.start == (parts[k - 1].stage.end if k else 0.0)
    assert parts[-1].stage.tasks == ()
    assert parts[-1].stage.end == schedule.duration


def test_without_segments_parts_are_cut_at_the_events(schedule):
    """Transfer up to the event, its dwell, and what the arm moves after it."""
    parts = stage_parts(dataclasses.replace(schedule, segments=()))
    for part in parts[:-1]:
        for name, found in part.arms.items():
            event = next(
                e
                for e in schedule.events
                if e.arm == name and part.stage.start < e.time < part.stage.end
            )
            assert [p.kind for p in found] == ["transfer", "dwell", "retract"]
            assert found[0].end == found[1].start == event.time
            # The retract ends where the segments of the file say that it does.
            stated = [s for s in schedule.segments if s.arm == name and s.kind == "retract"]
            assert np.abs(np.array([s.end for s in stated]) - found[2].end).min() < 1e-6


def test_a_schedule_that_states_nothing_has_no_parts_but_its_way(schedule):
    """No events: one stage in which everything moves."""
    empty = dataclasses.replace(schedule, stages=(), segments=(), events=())
    (part,) = stage_parts(empty)
    assert (part.stage.start, part.stage.end) == (0.0, schedule.duration)
    assert part.length("left", "return") == pytest.approx(schedule.duration, abs=1e-6)


def test_a_stop_that_takes_no_time_is_work(tmp_path):
    """With a free start and without lines and dwell an arm picks at time 0, and the report says so."""
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: iiwa7\n")
    (tmp_path / "tasks.yaml").write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nstart: free\ntasks:\n  - id: p\n    arm: left\n"
        "    pick: {xyz: [0.5, 0.1, 0.3], rpy: [180 deg, 0, 0]}\n"
        "    place: {xyz: [0.5, -0.1, 0.3], rpy: [180 deg, 0, 0]}\n"
    )
    job = load_job(tmp_path / "tasks.yaml")
    stages = build_report(plan(job, PlanSettings(effort="quick")), job)["stages"]
    work = [[(one["action"], one["task"]) for one in stage["work"]] for stage in stages]
    assert work == [[("pick", "p")], [("place", "p")]]
