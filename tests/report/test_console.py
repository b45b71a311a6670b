"""The plan's sentences on bound, search and assumed limits."""

from __future__ import annotations

import dataclasses
import json
from io import StringIO

import numpy as np
import pytest
from rich.console import Console
from rich.text import Text

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.notes import order_note
from dualarm_cli.planning.planner import plan
from dualarm_cli.report.console import (
    blending_lines,
    result_lines,
    sensitivity_lines,
    shown_stages,
    summary_lines,
)
from dualarm_cli.report.printable import print_lines
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify


@pytest.fixture(scope="module")
def job(tasks_folder):
    """The smallest job with lines."""
    return load_job(tasks_folder / "01_first_pick" / "tasks.yaml")


@pytest.fixture(scope="module")
def schedule(job):
    """Its plan with the platform held."""
    return plan(job, PlanSettings(platform="fixed"))


def test_bound_and_gap_are_said_with_the_effort(job, schedule):
    """A bound is what is proven; the distance to it is no saving and stays in report.json."""
    bounded = dataclasses.replace(schedule, lower_bound=0.75 * schedule.duration, grid_gap=0.031)
    report = build_report(bounded, job)
    assert report["gap"] == pytest.approx(0.25)
    (line,) = [line for line in summary_lines(report) if line.startswith("proven: no ")]
    assert f"is faster than {bounded.lower_bound:.3f} s; before" in line
    assert "25.0%" not in line
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
    (line,) = [line for line in summary_lines(report) if line.startswith("proven: no ")]
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
    """And nothing of a grid, or of limits that it ignores."""
    without = dataclasses.replace(schedule, lower_bound=None, grid_gap=None)
    report = build_report(without, job)
    for cap in (None, 0.5):
        lines = summary_lines(report | {"tool_speed_cap": cap})
        (line,) = [line for line in lines if line.startswith("lower bound")]
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


@pytest.mark.parametrize(("number", "shown"), [(12, 12), (13, 7), (40, 7)])
def test_a_long_plan_shows_its_first_longest_and_last_stages(number, shown):
    """Stages of which every third takes longer, the later the longer; two digits of them at most fit a screen."""
    stages = [{"duration": 1.0 + k * (k % 3 == 0)} for k in range(number)]
    report = {"stages": stages}
    chosen = shown_stages(report)
    assert len(chosen) == shown
    assert (chosen[0], chosen[-1]) == (0, number - 1)
    left_out = set(range(number)) - set(chosen)
    inner = [stages[k]["duration"] for k in chosen[1:-1]]
    assert max((stages[k]["duration"] for k in left_out), default=0.0) <= min(inner)
    assert shown_stages(report, every=True) == list(range(number))


def test_the_result_says_what_it_assumes_and_which_wishes_it_does_not_fulfil(job, schedule):
    """Limits, parts, clearance; a time limit without effect comes first, other notes with the details only."""
    notes = (order_note("fixed"), order_note("best"))
    verified = verify(schedule, job)
    judged = dataclasses.replace(schedule, notes=notes, verification=verified)
    report = build_report(judged, job)
    unmet, cycle, verdict = result_lines(report)
    assert unmet == f"note: {notes[0]}"
    assert cycle.startswith("cycle time (period): ")
    assert "assumed: limits of 15 joints" in verdict
    everything = summary_lines(report)
    assert everything[-3:] == [unmet, cycle, verdict]
    assert everything.count(unmet) == everything.count(f"note: {notes[1]}") == 1


def test_sentences_wrap_at_spaces_and_source_lines_do_not():
    """At 80 columns no word is broken; in a pipe a sentence is a line; only a terminal gets colours."""
    words = [f"left_joint_{k}" for k in range(1, 30)]
    sentence, source = f"verification: passed ({' '.join(words)})", f"  5 | {'x' * 90}"
    for terminal in (True, False):
        text = StringIO()
        colours = "standard" if terminal else None
        console = Console(file=text, width=80, force_terminal=terminal, color_system=colours)
        print_lines(console, sentence, source)
        plain = Text.from_ansi(text.getvalue()).plain
        *lines, last = plain.splitlines()
        assert last == source
        assert " ".join(line.strip() for line in lines) == sentence
        assert (max(map(len, lines)) <= 80) is terminal
        assert ("\x1b[32mpassed\x1b[0m" in text.getvalue()) is terminal


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


def test_asynchronous_arms_get_the_cycle_of_the_slowed_motion():
    """0.81 s / sqrt(0.9) = 0.8538 s: 5.4 % longer; nothing where no limit is assumed, or a belt does not wait."""
    report = {
        "mode": "free",
        "cycle_time": 0.81,
        "sensitivity": [],
        "assumed_limits": ["left_1"],
        "conveyors": [],
    }
    [line] = sensitivity_lines(report)
    assert line.endswith("the same motion, slowed, takes 0.854 s (+5.4%)")
    assert sensitivity_lines(report | {"assumed_limits": []}) == []
    assert sensitivity_lines(report | {"conveyors": [{}]}) == []
