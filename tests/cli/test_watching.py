"""A search for orders that is watched: its time limit, Ctrl-C, what a terminal shows."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

import pytest

from dualarm_cli.cli.parts import while_planning
from dualarm_cli.cli.parts.while_planning import STOPPING, StatusLine, lines_of_progress
from dualarm_cli.cli.run import run
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.notes import order_note

AT_ONCE = 6.0
"""Two seconds by the contract [s]; the rest is for a machine that does other things meanwhile."""

LONG = ("--effort", "thorough", "--platform", "linearised")
"""Searches for some twenty seconds, and then plans soon; `fixed` would not keep every order clear."""


@pytest.fixture(scope="module")
def open_order(tasks_folder, tmp_path_factory):
    """Eight picks of the packing cell, in any order: more than are timed one and all."""
    folder = tmp_path_factory.mktemp("open")
    (folder / ".git").mkdir()
    source = tasks_folder / "04_packing"
    (folder / "cell.yaml").write_text((source / "cell.yaml").read_text())
    text = (source / "tasks.yaml").read_text().replace("order: given", "order: optimise")
    kept = text.replace("each: place", "each: {first: 4}")
    assert kept.count("first: 4") == 4
    (folder / "tasks.yaml").write_text(kept)
    return folder / "tasks.yaml"


class Watched:
    """`dualarm plan` in a process of its own whose stderr is a terminal."""

    def __init__(self, task, out, *options):
        """Starts it."""
        ours, theirs = pty.openpty()
        self._terminal, self.seen = ours, ""
        self.process = subprocess.Popen(
            [sys.executable, "-m", "dualarm_cli", "plan", str(task), "--out", str(out), *options],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=theirs,
            env=os.environ | {"TERM": "xterm", "COLUMNS": "100"},
        )
        os.close(theirs)

    def read(self, until=None, seconds=120.0):
        """Reads on until a pattern has been seen; to the end without one."""
        give_up = time.monotonic() + seconds
        begin = len(self.seen)
        while until is None or not re.search(until, self.seen[begin:]):
            if time.monotonic() > give_up:
                self.process.kill()
                pytest.fail(f"{until} was not seen in {self.seen[-2000:]!r}")
            if not select.select([self._terminal], [], [], 0.5)[0]:
                continue
            try:
                some = os.read(self._terminal, 65536)
            except OSError:  # so a terminal says that the other side has gone
                some = b""
            if not some:
                assert until is None, f"{until} was not seen in {self.seen[-2000:]!r}"
                break
            self.seen += some.decode(errors="replace")

    def end(self):
        """Returns the exit code."""
        self.read()
        os.close(self._terminal)
        return self.process.wait(timeout=60)

    def interrupt(self):
        """Presses Ctrl-C."""
        self.process.send_signal(signal.SIGINT)


def notes_of(out):
    """Notes of a report."""
    return json.loads((out / "report.json").read_text())["notes"]


def test_ctrl_c_ends_the_search_and_the_best_order_so_far_is_planned(open_order, tmp_path):
    """What happens now is said at once; files are written, verified, and say that it was interrupted."""
    watched = Watched(open_order, tmp_path / "out", *LONG)
    watched.read(r"putting tasks in order: estimate \d+\.\d\d s, after \d+ s")
    watched.interrupt()
    watched.read(re.escape(STOPPING), seconds=AT_ONCE)
    code = watched.end()
    assert code in (0, 1), watched.seen
    assert "bounding all orders" not in watched.seen  # what would have come next
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert code == (0 if report["verification"]["passed"] else 1)
    assert [note for note in notes_of(tmp_path / "out") if "as it was interrupted" in note]


def test_a_second_ctrl_c_gives_up(open_order, tmp_path):
    """130 within two seconds; no file is written."""
    watched = Watched(open_order, tmp_path / "out", *LONG)
    watched.read(r"order: estimate")
    watched.interrupt()
    watched.read(re.escape(STOPPING))
    watched.interrupt()
    begin = time.monotonic()
    assert watched.end() == 130
    assert time.monotonic() - begin < AT_ONCE
    assert "interrupted" in watched.seen
    assert "Traceback" not in watched.seen
    assert not (tmp_path / "out").exists()


def test_sigterm_ends_a_search_at_once(open_order, tmp_path):
    """143 within two seconds, whatever has been found."""
    watched = Watched(open_order, tmp_path / "out", *LONG)
    watched.read(r"order: estimate")
    watched.process.send_signal(signal.SIGTERM)
    begin = time.monotonic()
    assert watched.end() == 143
    assert time.monotonic() - begin < AT_ONCE
    assert not (tmp_path / "out").exists()


def test_ctrl_c_after_the_search_gives_up_and_leaves_old_files_alone(tasks_folder, tmp_path):
    """An order that is given is not searched for: nothing is known until all is."""
    out = tmp_path / "out"
    out.mkdir()
    (out / "schedule.json").write_text("{}")
    task = tasks_folder / "04_packing" / "tasks.yaml"
    watched = Watched(task, out, "--force", "--effort", "thorough")
    watched.read("deciding platform angles")
    watched.interrupt()
    begin = time.monotonic()
    assert watched.end() == 130
    assert time.monotonic() - begin < AT_ONCE
    assert STOPPING not in watched.seen
    assert [f.name for f in out.iterdir()] == ["schedule.json"]
    assert (out / "schedule.json").read_text() == "{}"


def test_a_time_limit_ends_the_search_and_is_recorded(open_order, tmp_path):
    """Without a terminal only lines of progress; the schedule has the limit, the report that it was over."""
    out = tmp_path / "out"
    command = [sys.executable, "-m", "dualarm_cli", "plan", str(open_order), "--out", str(out)]
    result = subprocess.run(
        [*command, *LONG, "--time-limit", "1.5 s"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert result.returncode in (0, 1), result.stderr
    # A slow machine takes longer than the interval of these lines.
    progress = re.compile(r"[a-z].*: .*after \d+ s.*")
    assert all(progress.fullmatch(line) for line in result.stderr.splitlines()), result.stderr
    settings = json.loads((out / "schedule.json").read_text())["provenance"]["settings"]
    assert settings["time_limit"] == 1.5
    assert [note for note in notes_of(out) if "as its time limit is 1.5 s" in note]


def test_a_time_limit_is_said_to_have_had_nothing_to_limit(tasks_folder, tmp_path, capsys):
    """A note, no error, where the task file gives the order."""
    task = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    out = tmp_path / "out"
    assert run(["plan", str(task), "--out", str(out), "-q", "--time-limit", "2 min"]) == 0
    assert capsys.readouterr().err == ""
    assert order_note("fixed") in notes_of(out)


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ("0", "--time-limit 0: must be above 0 s"),
        ("-3 s", "--time-limit -3 s: must be above 0 s"),
        ("inf", "--time-limit: 'inf' is not a number"),
        ("nan", "--time-limit: 'nan' is not a number"),
        ("2 m", "allowed: s, ms, min"),
        ("", "--time-limit: '' is not a number"),
        ("1e9", "outside the range of time"),
    ],
)
def test_a_time_limit_that_is_none_is_refused(limit, words, capsys):
    """Exit 2 before anything is read, with what is allowed."""
    assert run(["plan", "x.yaml", f"--time-limit={limit}"]) == 2
    assert words in capsys.readouterr().err


def test_the_status_line_says_what_a_search_has_and_for_how_long(monkeypatch):
    """Totals of a search are estimates, "best" is the cycle time of a plan; of counted steps what is left."""
    now = 100.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    watch = Watch(limit=30.0)
    line = StatusLine(watch, "planning")
    assert line.words() == "planning: after 0 s"
    watch.begin()
    watch.report("putting tasks in order")
    assert line.words() == "putting tasks in order: after 0 s of 30 s"
    for total, bound in ((38.0, 30.0), (37.6, 33.1), (39.0, 32.0)):
        watch.record(total)
        watch.record_bound(bound)
    figures = "estimate 37.60 s, bound of the search 33.10 s"
    assert line.words() == f"putting tasks in order: {figures}, after 0 s of 30 s"
    watch.count(1, 4)
    assert line.words() == f"putting tasks in order: order 1 of 4, {figures}, after 0 s of 30 s"
    now = 108.0
    watch.keep(SimpleNamespace(duration=40.5))
    watch.count(3, 4)
    watch.report("avoiding collisions in 2 of 9 stages")
    # Two orders took 8 s, two are left.
    assert line.words() == (
        "avoiding collisions in 2 of 9 stages: order 3 of 4, best 40.50 s, "
        "bound of the search 33.10 s, after 8 s of 30 s, at most about 8 s left"
    )
    watch.end()
    watch.report("verifying")
    assert line.words() == "verifying: best 40.50 s, after 8 s"


@pytest.mark.slow
def test_a_limit_that_is_not_reached_changes_nothing_but_its_record(open_order, tmp_path):
    """The same joints and times, to the last bit; only the settings differ."""
    written = []
    for name, options in (("without", ()), ("with", ("--time-limit", "1000 min"))):
        quick = ("--effort", "quick", "--platform", "fixed", "-q")
        run(["plan", str(open_order), "--out", str(tmp_path / name), *quick, *options])
        schedule = json.loads((tmp_path / name / "schedule.json").read_text())
        del schedule["files"]["report.json"]  # its hash: the settings stand there as well
        written.append((schedule, (tmp_path / name / "schedule.csv").read_bytes()))
    assert written[0][0]["provenance"]["settings"].pop("time_limit") is None
    assert written[1][0]["provenance"]["settings"].pop("time_limit") == 60_000.0
    assert written[0] == written[1]


def test_without_a_terminal_progress_is_a_line_from_time_to_time(monkeypatch, capfd):
    """None before the interval has passed, and none after the plan."""
    line = StatusLine(Watch(), "planning")
    with lines_of_progress(line):
        pass
    monkeypatch.setattr(while_planning, "INTERVAL", 0.02)
    with lines_of_progress(line):
        line.tell("verifying")
        time.sleep(0.2)
    time.sleep(0.05)
    lines = capfd.readouterr().err.splitlines()
    assert set(lines) == {"verifying: after 0 s"} and 1 < len(lines) <= 10
    time.sleep(0.05)
    assert capfd.readouterr().err == ""


def test_planning_begins_within_a_tenth_of_a_second_of_a_change(tmp_path, monkeypatch):
    """The file is saved during the first wait; what follows it until the second plan is waited for."""
    (tmp_path / ".git").mkdir()
    tasks, page = tmp_path / "tasks.yaml", tmp_path / "page.html"
    tasks.write_text("dualarm: tasks/1\n")
    page.write_text("<html></html>")
    waits, plans = [], []

    def sleep(seconds):
        waits.append(seconds)
        if len(waits) == 1:
            tasks.write_text("dualarm: tasks/1  # saved\n")

    def plan():
        plans.append(len(waits))
        if len(plans) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(while_planning.time, "sleep", sleep)
    while_planning.keep_planning(tasks, page, plan, open_page=False)
    assert plans == [0, 2]
    assert sum(waits) <= 0.1 + 1e-9
