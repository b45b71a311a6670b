"""A second process gives what this one would, fails as this one would, and is gone when it is no longer needed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import dualarm_cli.background as background
from dualarm_cli.background import (
    BackgroundCall,
    _reap,
    _unreaped,
    allow_workers,
    map_halves,
    run_both,
    usable_cores,
)
from dualarm_cli.interface import planned
from dualarm_cli.model.settings import PlanSettings
from tests.packing_tasks import packing_job


def children() -> set[str]:
    """Returns the numbers of this process's children, running or waited for."""
    found = set()
    for process in Path("/proc").glob("[0-9]*"):
        try:
            # After the name, which is in brackets: state and parent.
            state = (process / "stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(state[1]) == os.getpid():
            found.add(process.name)
    return found


@pytest.fixture(autouse=True)
def _no_copy_is_left():
    """Looks for copies of this process after a test, running or waited for; other tests may have left processes."""
    before = children()
    yield
    _reap()
    assert children() <= before


@pytest.mark.parametrize("copied", [False, True])
def test_a_result_is_that_of_the_function(copied):
    """Of more bytes than a pipe holds."""
    with allow_workers(copied), BackgroundCall(lambda: (os.getpid(), np.arange(1_000_000))) as call:
        made_by, numbers = call.result()
    assert (made_by != os.getpid()) == copied
    np.testing.assert_array_equal(numbers, np.arange(1_000_000))


@pytest.mark.parametrize("copied", [False, True])
def test_two_functions_are_called_by_two_processes(copied):
    """Each once; where copies are not allowed, both by this one."""
    with allow_workers(copied):
        one, other = run_both(os.getpid, os.getpid)
    assert one == os.getpid()
    assert (other != os.getpid()) == copied


@pytest.mark.parametrize("copied", [False, True])
@pytest.mark.parametrize("count", range(5))
def test_halves_are_joined_in_order(copied, count):
    """The second half is another process's, if there are two of anything."""

    def made(items):
        return [(3 * item, os.getpid()) for item in items]

    with allow_workers(copied):
        found = map_halves(made, range(count))
    assert [value for value, _ in found] == [3 * item for item in range(count)]
    theirs = [process != os.getpid() for _, process in found]
    assert sum(theirs) == (count // 2 if copied else 0)
    assert theirs == sorted(theirs)


def test_few_items_are_not_shared_and_copies_make_no_copies():
    def made(items):
        inner = map_halves(lambda some: [os.getpid()] * len(some), range(4))
        return [(os.getpid(), inner) for _ in items]

    with allow_workers(True):
        assert {own for own, _ in map_halves(made, range(3), least=4)} == {os.getpid()}
        own, inner = map_halves(made, range(2))[1]
    assert own != os.getpid()
    assert set(inner) == {own}


@pytest.mark.parametrize("broken", [0, 3])
def test_an_error_of_either_half_is_raised(broken):
    def made(items):
        if broken in items:
            raise ValueError(f"item {broken}")
        return list(items)

    with allow_workers(True), pytest.raises(ValueError, match=f"item {broken}"):
        map_halves(made, range(4))


def test_no_copy_is_made_where_the_system_refuses_one(monkeypatch):
    def refused():
        raise BlockingIOError("no more processes")

    monkeypatch.setattr(os, "fork", refused)
    with allow_workers(True), BackgroundCall(os.getpid) as call:
        assert call.result() == os.getpid()


def test_an_error_is_raised_where_the_result_is_asked_for():
    def made():
        raise ValueError("nothing reaches it")

    with (
        allow_workers(True),
        BackgroundCall(made) as call,
        pytest.raises(ValueError, match="reaches"),
    ):
        call.result()


@pytest.mark.parametrize("by", [signal.SIGKILL, signal.SIGTERM])
def test_a_copy_that_is_killed_is_replaced(by):
    here = os.getpid()

    def made():
        if os.getpid() != here:
            os.kill(os.getpid(), by)
            time.sleep(60.0)
        return 7

    with allow_workers(True), BackgroundCall(made) as call:
        assert call.result() == 7


def test_copies_that_have_ended_are_reaped_as_the_next_one_is_made():
    with allow_workers(True):
        for _ in range(3):
            before = set(_unreaped)
            for copy in before:
                os.waitid(os.P_PID, copy, os.WEXITED | os.WNOWAIT)
            with BackgroundCall(os.getpid) as call:
                own = call.result()
            assert own != os.getpid()
            assert _unreaped == [own]
            assert not before & {int(child) for child in children()}


def refusing():
    raise ValueError("nothing reaches it")


@pytest.mark.parametrize("made", [refusing, lambda: time.sleep(60.0)])
def test_ended_copies_may_be_reaped_by_the_system(made):
    """As where this process was started by one that ignores SIGCHLD: those with a result, without, and at work."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        with allow_workers(True):
            assert map_halves(lambda some: [2 * one for one in some], range(4)) == [0, 2, 4, 6]
            assert run_both(lambda: 1, lambda: 2) == (1, 2)
            with BackgroundCall(made):
                time.sleep(0.1)
            with pytest.raises(ValueError, match="reaches"), BackgroundCall(refusing) as call:
                time.sleep(0.1)
                call.result()
    finally:
        signal.signal(signal.SIGCHLD, before)


INTERRUPTED = """
import os, signal, sys, threading, time
from dualarm_cli.background import BackgroundCall, allow_workers
fork = os.fork
def forked():
    child = fork()
    if child:
        print(child, flush=True)
    # As Ctrl-C on a terminal, which reaches both before either knows of the other.
    os.kill(os.getpid(), signal.Signals[sys.argv[1]])
    time.sleep(0.3)
    return child
def ended(number, frame):
    raise KeyboardInterrupt
os.fork = forked
signal.signal(signal.Signals[sys.argv[1]], ended)
if sys.argv[2] == "threads":
    # The signal is this thread's, as the first one has blocked it.
    threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
try:
    with allow_workers(True), BackgroundCall(lambda: time.sleep(60.0)):
        print("within", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
"""


@pytest.mark.parametrize("threads", ["threads", "no"])
@pytest.mark.parametrize("number", ["SIGINT", "SIGTERM"])
def test_a_signal_while_a_copy_is_made_leaves_none(number, threads):
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, number, threads],
        capture_output=True,
        text=True,
        check=True,
        timeout=30,
    )
    copy, what = done.stdout.split()
    assert (what, done.stderr) == ("interrupted", "")
    end = time.monotonic() + 10.0
    while Path(f"/proc/{copy}").exists():
        assert time.monotonic() < end, f"{copy} still works"
        time.sleep(0.01)


OUTLIVED = """
import os, sys, time
from dualarm_cli.background import BackgroundCall, allow_workers
fork = os.fork
def forked():
    child = fork()
    if child:
        print(child, flush=True)
        os._exit(0)
    while os.getppid() == int(sys.argv[1]):
        time.sleep(0.01)
    return child
sys.argv.append(str(os.getpid()))
os.fork = forked
with allow_workers(True), BackgroundCall(lambda: time.sleep(60.0)):
    pass
"""


def test_a_copy_whose_process_has_ended_before_it_began_ends_too():
    done = subprocess.run(
        [sys.executable, "-c", OUTLIVED], capture_output=True, text=True, check=True, timeout=30
    )
    end = time.monotonic() + 10.0
    while Path(f"/proc/{done.stdout.strip()}").exists():
        assert time.monotonic() < end, "the copy still works"
        time.sleep(0.01)


def test_ctrl_c_is_left_to_the_first_process():
    def made():
        os.kill(os.getpid(), signal.SIGINT)
        return os.getpid()

    with allow_workers(True), BackgroundCall(made) as call:
        assert call.result() != os.getpid()


def test_a_result_that_nobody_asks_for_is_not_waited_for():
    begin = time.monotonic()
    with pytest.raises(KeyError), allow_workers(True), BackgroundCall(lambda: time.sleep(60.0)):
        raise KeyError
    assert time.monotonic() - begin < 30.0


@pytest.mark.parametrize("effort", ["quick", "normal"])
def test_a_plan_is_the_same_with_a_second_process(tasks_folder, effort):
    """And both have a bound; normal effort searches on several grids, and refines two plans."""
    job = packing_job(tasks_folder, 2)
    settings = PlanSettings(effort=effort)
    found = []
    for copied in (False, True):
        with allow_workers(copied):
            found.append(planned(job, settings))
    one, other = found
    assert one.schedule.lower_bound is not None
    assert one.report == other.report


@pytest.mark.parametrize(
    ("quotas", "cores"),
    [
        ({}, 8),
        ({"": "max 100000"}, 8),
        ({"": "200000 100000"}, 2),
        ({"": "250000 100000"}, 3),
        ({"": "20000 100000"}, 1),
        ({"": "400000 100000", "a": "300000 100000", "a/b": "max 100000"}, 3),
        ({"a/b": "1600000 100000"}, 8),
        ({"": "damaged"}, 8),
    ],
)
def test_no_more_processes_than_the_container_is_given_cores(tmp_path, monkeypatch, quotas, cores):
    """Of 8 that the machine has: the least quota of the group and those around it, rounded up."""
    own = "0::/a/b\n"
    read = Path.read_text
    monkeypatch.setattr(
        Path, "read_text", lambda p: own if str(p) == "/proc/self/cgroup" else read(p)
    )
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)))
    monkeypatch.setattr(background, "CONTROL_GROUPS", tmp_path)
    (tmp_path / "a" / "b").mkdir(parents=True)
    for folder, text in quotas.items():
        (tmp_path / folder / "cpu.max").write_text(f"{text}\n")
    assert usable_cores() == cores
