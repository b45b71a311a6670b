"""Signals: keys of task files, the events that set them, files and checks."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from dualarm_cli.errors import InputError
from dualarm_cli.exporting.files import write_schedule_set
from dualarm_cli.exporting.schedule_reader import read_schedule
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.formats import export
from dualarm_cli.formats.request import ExportRequest
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.verification import verify

ROOT = Path(__file__).parents[2]


@pytest.fixture
def changed(tmp_path):
    """Loads a bundled job with changes."""

    def load(name, change):
        shutil.copytree(ROOT / "tasks" / name, tmp_path / "job")
        file = tmp_path / "job" / "tasks.yaml"
        document = yaml.safe_load(file.read_text())
        change(document)
        file.write_text(yaml.safe_dump(document))
        return load_job(file)

    return load


def signals(job):
    """Returns the signals of a job that there are, by arm, task and action."""
    return {
        (task.arm, task.id, stop.action): stop.signal
        for task in job.tasks
        for stop in task.stops
        if stop.signal
    }


def test_grip_is_at_picks_and_release_at_places(changed):
    """Of one task; the others have none."""

    def change(document):
        document["tasks"][0]["signals"] = {"grip": "left_do1", "release": "left_do2"}

    job = changed("01_first_pick", change)
    task = job.tasks[0].id
    assert signals(job) == {
        ("left", task, "pick"): "left_do1",
        ("left", task, "place"): "left_do2",
    }


def test_one_key_leaves_the_other_event_without_a_signal(changed):
    """As in `signals: {grip: left_do1}`."""
    job = changed("01_first_pick", lambda d: d["tasks"][0].update(signals={"grip": "left_do1"}))
    assert set(signals(job).values()) == {"left_do1"}
    assert len(signals(job)) == 1


def test_a_task_overrides_the_defaults_key_by_key(changed):
    """What it does not name is the defaults'; an action's own key comes before grip and release."""

    def change(document):
        document.setdefault("defaults", {})["signals"] = {"grip": "close", "release": "open"}
        document["tasks"][0]["signals"] = {"pick": "vacuum"}

    job = changed("01_first_pick", change)
    first, second = (task.id for task in job.tasks)
    found = signals(job)
    assert found["left", first, "pick"] == "vacuum"
    assert found["left", first, "place"] == "open"
    assert found["right", second, "pick"] == "close"


def test_a_hand_over_has_a_signal_for_each_of_its_four_events(changed):
    """Pick and give of one arm, take and place of the other."""
    names = {"pick": "l1", "give": "l2", "take": "r1", "place": "r2"}

    def change(document):
        document["tasks"][0]["signals"] = names

    job = changed("13_hand_over", change)
    found = {action: name for (_, _, action), name in signals(job).items()}
    assert found == names


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"give": "x"}, "never sets this signal: it has pick and place"),
        ({"move": "x"}, "never sets this signal"),
        ({}, "no signal; give grip, release or both"),
        ({"gripp": "x"}, "gripp"),
        ({"grip": ""}, "must not be empty"),
        ({"grip": 3}, "must be text"),
        ("left_do1", "signals"),
    ],
)
def test_signals_that_make_no_sense_are_refused(changed, given, message):
    """With the key, and what the task has."""
    with pytest.raises(InputError, match=message):
        changed("01_first_pick", lambda d: d["tasks"][0].update(signals=given))


def test_a_path_sets_no_signal(changed):
    """The planner has no instants of its own for what a tool does on its way."""

    def change(document):
        document["tasks"][0]["signals"] = {"grip": "weld"}

    with pytest.raises(InputError, match="never sets this signal: it has seam_end and seam_start"):
        changed("10_seam", change)


def test_signals_are_in_the_schedule_at_their_instants_and_survive_files(changed, tmp_path):
    """In events, in schedule.json, in the bag and in the trace; the verifier knows a wrong one."""

    def change(document):
        document["tasks"][0]["signals"] = {"grip": "left_do1", "release": "left_do2"}

    job = changed("01_first_pick", change)
    schedule = plan(job, PlanSettings(effort="quick"))
    found = {(e.task, e.action): e.signal for e in schedule.events if e.signal}
    first = job.tasks[0].id
    assert found == {(first, "pick"): "left_do1", (first, "place"): "left_do2"}
    assert [c.verdict for c in verify(schedule, job).checks if c.name == "signals"] == ["passed"]
    write_schedule_set(tmp_path / "plan", schedule, {}, False)
    again = read_schedule(tmp_path / "plan")
    assert [e.signal for e in again.events] == [e.signal for e in schedule.events]
    request = ExportRequest(schedule, job, 20.0, "cubic")
    trace = json.loads(b"".join(export("perfetto", request)["gantt.json"]))
    told = [
        row["args"]["signal"] for row in trace["traceEvents"] if "signal" in row.get("args", {})
    ]
    assert told == ["left_do1", "left_do2"]
    wrong = replace(
        schedule,
        events=tuple(replace(e, signal="other" if e.signal else "") for e in schedule.events),
    )
    [check] = [c for c in verify(wrong, job).checks if c.name == "signals"]
    assert (check.verdict, check.measured) == ("failed", 2.0)
    assert f"{first} (pick) sets other instead of left_do1" in check.detail


def test_without_signals_nothing_is_checked_or_written(changed):
    """The schedule of a job without signals has no such check and no such member."""
    job = changed("01_first_pick", lambda document: None)
    schedule = plan(job, PlanSettings(effort="quick"))
    assert "signals" not in [check.name for check in verify(schedule, job).checks]
    assert not any(event.signal for event in schedule.events)
