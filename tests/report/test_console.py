"""The plan's sentences on bound, search and assumed limits."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.report.console import blending_lines, summary_lines
from dualarm_cli.report.report import build_report


@pytest.fixture(scope="module")
def job(tasks_folder):
    """The smallest job with lines."""
    return load_job(tasks_folder / "01_first_pick" / "tasks.yaml")


@pytest.fixture(scope="module")
def schedule(job):
    """Its plan with the platform held."""
    return plan(job, PlanSettings(platform="fixed"))


def test_bound_and_gap_are_said_with_the_effort(job, schedule):
    """A bound of three quarters of the cycle: a quarter could be saved at most."""
    bounded = dataclasses.replace(schedule, lower_bound=0.75 * schedule.duration, grid_gap=0.031)
    report = build_report(bounded, job)
    assert report["gap"] == pytest.approx(0.25)
    (line,) = [line for line in summary_lines(report) if line.startswith("lower bound")]
    assert f"is faster than {bounded.lower_bound:.3f} s; at most 25.0% could be saved" in line
    what = "refinement" if report["blending"] is None else "refinement and blending"
    assert f"before {what} 3.1% above the bound of the search's own grid" in line
    assert line.endswith("effort: normal")


@pytest.mark.parametrize(
    ("gap", "words"),
    [(0.0, "no other order is quicker"), (0.0264, "no other order is more than 2.6% quicker")],
)
def test_what_is_proven_of_an_order_is_said_of_the_grid_and_not_of_plans(job, schedule, gap, words):
    """Nor as a share of nothing, which reads as if no other plan were quicker."""
    report = build_report(dataclasses.replace(schedule, order_grid_gap=gap), job)
    assert report["order_grid_gap"] == gap
    (line,) = [line for line in summary_lines(report) if line.startswith("lower bound")]
    assert f"; on the grid of the search (not among plans) {words};" in line
    assert "0.0%" not in line.split("; on the grid")[1]


@pytest.mark.parametrize(
    ("lines", "targets", "words"),
    [
        (1, 0, "; 1 end is passed in motion"),
        (0, 1, "; 1 target of a move is passed in motion"),
        (2, 1, "; 2 ends and 1 target of a move are passed in motion"),
        (0, 2, "; 2 targets of moves are passed in motion"),
    ],
)
def test_one_end_is_not_told_as_many(lines, targets, words):
    """Ends of lines and targets of moves are counted each by itself."""
    corner = {"joint": "left_s", "limit": "jerk", "beside": 0.0}
    found = [corner | {"line": "retract"}] * lines + [corner | {"line": ""}] * targets
    blending = {"gain": 1.0, "share": 0.1, "largest_deviation": 0.0, "corners": found}
    [line] = blending_lines({"blending": blending})
    assert f"{words}, limited by left_s" in line


def test_where_all_tools_stop_it_is_not_said_that_this_is_as_quick():
    """Nothing is known of plans that were not found."""
    blending = {"gain": 0.0, "share": 0.0, "largest_deviation": 0.0, "corners": []}
    [line] = blending_lines({"blending": blending})
    assert line.endswith("; no faster collision-free plan without these stops was found")


def test_without_a_bound_it_is_said_that_there_is_none(job, schedule):
    """And nothing of a grid."""
    without = dataclasses.replace(schedule, lower_bound=None, grid_gap=None)
    (line,) = [
        line for line in summary_lines(build_report(without, job)) if line.startswith("lower bound")
    ]
    assert line == "lower bound: none computed; effort: normal"


def test_the_report_lists_every_assumed_limit_and_the_console_the_most_telling(job, schedule):
    """All together first, then three; the JSON has all of them."""
    report = build_report(schedule, job)
    entries = json.loads(json.dumps(report["sensitivity"], allow_nan=False))
    assert len(entries) == 2 * len(report["assumed_limits"]) + 3
    assert set(entries[0]) == {"joint", "limit", "value", "lower", "higher"}
    lines = summary_lines(report)
    start = next(k for k, line in enumerate(lines) if line.startswith("sensitivity: "))
    assert lines[start].startswith(
        "sensitivity: all assumed acceleration and jerk limits 10 % lower"
    )
    assert lines[start].endswith("with unchanged postures; a new plan may be faster")
    for line, entry in zip(lines[start + 1 : start + 4], entries[:3], strict=True):
        assert line.startswith(
            f"{entry['joint']} {entry['limit']} 10 % lower: {entry['lower']:.3f} s"
        )


def test_what_the_maker_states_is_not_called_assumed(job, schedule):
    """Of two joints the URDF states the acceleration, of one both."""
    source = ("urdf, jerk assumed", "urdf, jerk assumed", "urdf", *("assumed",) * 12)
    limits = dataclasses.replace(schedule.robot.limits, source=source)
    known = dataclasses.replace(schedule, robot=dataclasses.replace(schedule.robot, limits=limits))
    report = build_report(known, job)
    lines = summary_lines(report)
    first, second, third, *others = limits.joints
    words = "limits are assumed, not the maker's, for"
    assert f"acceleration and jerk {words} 12 joints: {', '.join(others)}" in lines
    assert f"jerk {words} 2 joints: {first}, {second}" in lines
    changed = {(e["joint"], e["limit"]) for e in report["sensitivity"] if e["joint"]}
    assert {(first, "jerk"), (second, "jerk")} <= changed
    assert not {(first, "acceleration"), (third, "acceleration"), (third, "jerk")} & changed


def test_joints_without_a_jerk_limit_are_told(job, schedule):
    """Their jerk limit is not called assumed; with a limit nothing is told."""
    assert not [line for line in summary_lines(build_report(schedule, job)) if "no jerk" in line]
    limits = dataclasses.replace(schedule.robot.limits, jerk=np.full(15, np.inf))
    free = dataclasses.replace(schedule, robot=dataclasses.replace(schedule.robot, limits=limits))
    report = build_report(free, job)
    assert report["without_jerk_limit"] == list(limits.joints)
    lines = summary_lines(report)
    assert f"no jerk limit, as the robot file says: {', '.join(limits.joints)}" in lines
    assert [line for line in lines if line.startswith("acceleration limits are assumed")]


def test_a_plan_of_no_length_has_no_shares(job, schedule):
    """Nothing is divided by zero."""
    report = build_report(schedule, job)
    lines = summary_lines(report | {"cycle_time": 0.0})
    assert not [line for line in lines if "10 %" in line]


def test_limits_from_the_maker_have_no_sensitivity(job, schedule):
    """No sentence, an empty list."""
    limits = dataclasses.replace(schedule.robot.limits, source=("datasheet",) * 15)
    known = dataclasses.replace(schedule, robot=dataclasses.replace(schedule.robot, limits=limits))
    report = build_report(known, job)
    assert report["sensitivity"] == []
    assert not [line for line in summary_lines(report) if "10 %" in line]
