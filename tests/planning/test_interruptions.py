"""Ctrl-C at any place of what finds orders and plans them: what has been found is never lost."""

from __future__ import annotations

import signal
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from dualarm_cli.cli.parts.while_planning import Interrupts
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders import watch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning import free_ordered_plan, ordered_plan, planner, section_plans
from dualarm_cli.planning.planner import plan
from dualarm_cli.verification import verify

WATCHED = {
    str(Path(module.__file__))
    for module in (free_ordered_plan, ordered_plan, planner, section_plans, watch)
}
"""Files whose lines are counted."""
SETTINGS = PlanSettings(effort="quick", platform="fixed")


def task(name, y, **more):
    """A move in front of the robot, for any arm."""
    return {
        "id": name,
        "arm": "any",
        "move": {"xyz": [0.5, y, 0.85], "rpy": ["180 deg", 0, 0]},
    } | more


JOBS = {
    "paired": {"mode": "paired", "tasks": [task("a", 0.3), task("b", -0.3), task("c", 0.1)]},
    "free": {
        "mode": "free",
        "tasks": [task("a", 0.3), task("b", -0.3), task("c", 0.1, after=["a"])],
    },
}


@pytest.fixture(params=JOBS)
def job(request, tmp_path):
    """A small job with an open order."""
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    document = {"dualarm": "tasks/1", "cell": "cell.yaml", "order": "optimise", "return": True}
    (tmp_path / "tasks.yaml").write_text(yaml.safe_dump(document | JOBS[request.param]))
    return load_job(tmp_path / "tasks.yaml")


class Interrupted:
    """A job that is planned, with Ctrl-C at the n-th line of the watched files."""

    def __init__(self, job, at, settings=SETTINGS):
        """Plans it."""
        self.lines, self.at, self.had, self.kept = 0, at, False, None
        self.watch = Watch()
        self.interrupts = Interrupts(self.watch, quiet=True)
        self.watch.enough = lambda: self.interrupts.asked
        self.schedule = None
        before = sys.gettrace()
        sys.settrace(self.calls)
        try:
            self.schedule = plan(job, settings, self.watch)
        except KeyboardInterrupt:
            pass
        finally:
            sys.settrace(before)

    def calls(self, frame, _event, _argument):
        """Follows the lines of watched files alone."""
        return self.line if frame.f_code.co_filename in WATCHED else None

    def line(self, frame, event, _argument):
        """Interrupts at its line, as a signal would."""
        if event == "line":
            self.lines += 1
            if self.lines == self.at:
                self.kept = self.watch.best_plan
                self.had = self.kept is not None or self.watch.best is not None
                self.interrupts._interrupt(signal.SIGINT, frame)
        return self.line


def check(job, at, whole, settings=SETTINGS):
    """Interrupts a job at a line: without anything found it is given up, else there is a plan that passes.

    It says that it was interrupted, unless all was done then that is done without.
    """
    seen = Interrupted(job, at, settings)
    if seen.schedule is None:
        assert not seen.had, f"line {at}: what was found is lost"
        return
    assert verify(seen.schedule, job, clearance=True).failures == ()
    if seen.kept is not None:
        assert seen.schedule.duration <= seen.kept.duration
    said = any("was interrupted" in note for note in seen.schedule.notes)
    assert said or seen.schedule.notes == whole.notes, f"line {at}: it is not said"


def every(job, count):
    """Interrupts a job at so many of its lines, evenly from the first to the last."""
    whole = Interrupted(job, 0)
    assert whole.schedule is not None
    for k in range(count):
        check(job, 1 + round(k * (whole.lines - 1) / (count - 1)), whole.schedule)


def test_what_was_found_is_planned_and_verified_wherever_it_is_interrupted(job):
    every(job, 4)


def test_the_plan_of_less_effort_is_interrupted_as_any_other(job):
    """On one core this process makes it, after the one asked for: that one is kept."""
    settings = replace(SETTINGS, effort="normal")
    whole = Interrupted(job, 0, settings)
    for share in (0.6, 0.7):
        check(job, round(share * whole.lines), whole.schedule, settings)


@pytest.mark.slow
def test_no_line_loses_what_was_found(job):
    every(job, 120)
