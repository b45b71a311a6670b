"""The crew: processes that die, hang or never start cost their own request only, and none outlives its parent."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dualarm_cli.evaluation import crew as module
from dualarm_cli.evaluation.crew import Crew, WorkersFailedError
from dualarm_cli.evaluation.request import Request
from dualarm_cli.model.studies.evaluation import Evaluation

# What a worker does, without libraries to load: what it is told by the name of the case.
STAND_IN = """
import json, os, signal, sys, time
from pathlib import Path
sys.path[:] = json.loads(sys.argv[1])
from dualarm_cli.model.studies.evaluation import Evaluation
out = os.fdopen(int(sys.argv[2]), "wb")
signal.signal(signal.SIGINT, signal.SIG_IGN)
out.write(b'"ready"\\n'); out.flush()
for line in sys.stdin.buffer:
    case = json.loads(line)["case"]
    once = Path(f"{case}.tried")
    tried = once.exists()
    once.touch()
    if case.startswith("die") or (case.startswith("once") and not tried):
        os.kill(os.getpid(), signal.SIGKILL)
    if case.startswith("exit"):
        print("no more\\n" + "what has happened", file=sys.stderr, flush=True)
        os._exit(7)
    print(f"warning of {case}", file=sys.stderr, flush=True)
    if case.startswith("hang") or (case.startswith("late") and not tried):
        time.sleep(600)
    if case.startswith("slow"):
        time.sleep(0.3)
    print("noise on stdout", flush=True)
    answer = Evaluation(case, "planned", cycle_time=float(len(case)), travel=float(os.getpid()))
    out.write(json.dumps(answer.as_document()).encode() + b"\\n"); out.flush()
"""


@pytest.fixture
def stand_in(monkeypatch, tmp_path):
    """Workers that do as they are told, in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(module, "_START", STAND_IN)


def asked(*cases):
    """Requests for cases."""
    return [Request(case, str(Path(case).resolve())) for case in cases]


def outcome(crew, *cases):
    """Returns status and cycle time by case; each exactly once."""
    requests = asked(*cases)
    found = list(crew.run(requests))
    assert sorted(index for index, _ in found) == list(range(len(cases)))
    for index, evaluation in found:
        assert evaluation.case == requests[index].case
    return {e.case: e.status for _, e in found}


def alive(pid):
    """Returns whether a process runs; one that has ended and waits to be noticed does not."""
    try:
        status = Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize("processes", [1, 2, 5])
def test_every_request_is_answered_once_by_any_number_of_processes(stand_in, processes):
    """Also none, and a crew works for several rounds with the same processes."""
    with Crew(processes) as crew:
        assert list(crew.run([])) == []
        for _ in range(2):
            found = outcome(crew, *(f"case{k}" for k in range(12)))
            assert set(found.values()) == {"planned"}
        again = list(crew.run(asked("a", "b")))
        assert {e.travel for _, e in again} <= {float(w.process.pid) for w in crew._workers}
    assert crew._workers == []


def test_a_process_that_dies_costs_its_own_request_only_after_a_second_try(stand_in):
    """By a signal or by itself; one that dies once is answered; the others go on."""
    with Crew(2) as crew:
        found = list(
            crew.run(requests := asked("a", "die1", "once1", "b", "exit1", "once2", "c", "d"))
        )
    states = {requests[index].case: e for index, e in found}
    assert len(found) == 8
    assert {case for case, e in states.items() if e.status == "crashed"} == {"die1", "exit1"}
    assert "SIGKILL" in states["die1"].findings[0].message
    assert "SIGKILL; possibly out of memory" in states["die1"].findings[0].message
    assert states["exit1"].findings[0].message == (
        "its process ended 2 times, the last time by exit code 7 (what has happened)"
    )
    assert all(e.status == "planned" for c, e in states.items() if c not in ("die1", "exit1"))


def test_a_process_that_takes_too_long_is_ended_and_tried_once_more(stand_in):
    """Within twice the time; what is late once only is answered."""
    begin = time.monotonic()
    with Crew(2, timeout=0.5) as crew:
        found = outcome(crew, "hang", "a", "late", "b", "c")
    assert time.monotonic() - begin < 5.0
    assert found == {
        "hang": "timed_out",
        "a": "planned",
        "late": "planned",
        "b": "planned",
        "c": "planned",
    }


def test_what_runs_when_the_time_is_over_is_not_answered(stand_in):
    """Nor is what waits; its processes are ended, those that idle remain until the crew closes."""
    begin = time.monotonic()
    with Crew(2, until=begin + 2.0) as crew:
        found = {e.case: e.status for _, e in crew.run(asked("a", "hang", "hang2", "b"))}
        assert 2.0 <= time.monotonic() - begin < 5.0
        assert found == {"a": "planned"}
        assert not [worker for worker in crew._workers if worker.attempt]
        assert list(crew.run(asked("c"))) == []


def test_processes_that_are_never_ready_are_given_up(monkeypatch):
    """Instead of starting them forever; why is in their last words. Whoever asks again is answered again."""
    monkeypatch.setattr(module, "_START", "import sys; print('lost'); sys.exit('no library')")
    with Crew(2) as crew:
        for _ in range(2):
            with pytest.raises(WorkersFailedError, match=r"exit code 1 \(no library\)"):
                list(crew.run(asked("a", "b", "c")))
    assert crew._workers == []


def test_what_is_done_is_told_before_it_is_given_up(stand_in, monkeypatch):
    """An answer that comes together with the last start that fails is not lost with it."""

    def both(requests, again, wait):
        if not wait:
            return []
        crew._failed_starts += ["x"] * 3
        return [(0, Evaluation("a", "planned"))]

    with Crew(2) as crew:
        monkeypatch.setattr(crew, "_collect", both)
        run = crew.run(asked("a", "b"))
        assert next(run) == (0, Evaluation("a", "planned"))
        with pytest.raises(WorkersFailedError):
            next(run)


def test_processes_start_before_anybody_listens(stand_in):
    """As many as there is work for, so that the caller's own preparations cost no time; close ends them."""
    with Crew(5) as crew:
        answers = crew.run(asked("a", "b", "c"))
        workers = list(crew._workers)
        assert len(workers) == 3
        assert all(alive(worker.process.pid) for worker in workers)
        assert len(list(answers)) == 3
        assert crew._workers == workers
    with Crew(2) as crew:
        crew.run(asked("a"))
        (worker,) = crew._workers
    assert not alive(worker.process.pid)


def test_a_process_that_died_while_it_had_nothing_to_do_costs_no_try(stand_in):
    """The next request dies once by itself and is answered all the same."""
    with Crew(1) as crew:
        outcome(crew, "a")
        (worker,) = crew._workers
        os.kill(worker.process.pid, signal.SIGKILL)
        os.waitid(os.P_PID, worker.process.pid, os.WEXITED | os.WNOWAIT)
        assert outcome(crew, "once") == {"once": "planned"}


def test_a_limit_of_months_is_one(stand_in):
    """More than the kernel counts."""
    with Crew(1, timeout=1e9) as crew:
        assert outcome(crew, "a", "b") == {"a": "planned", "b": "planned"}


def test_a_process_that_cannot_be_started_leaves_no_file_open(monkeypatch):
    """Where there is no memory for one more, say."""
    before = len(list(Path("/proc/self/fd").iterdir()))

    def none(*_, **__):
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(module.subprocess, "Popen", none)
    with Crew(1) as crew, pytest.raises(OSError, match="unavailable"):
        list(crew.run(asked("a")))
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_whoever_stops_early_leaves_no_answers_for_the_next(stand_in):
    """A run that is dropped in the middle, then another one of the same crew."""
    with Crew(2) as crew:
        outcome(crew, "slow8", "slow9")  # both are ready then
        run = crew.run(asked("a", "slow", "b"))
        assert next(run)[1].case == "a"
        run.close()
        assert set(outcome(crew, "x", "y", "slow2", "z").values()) == {"planned"}


BUSY = (
    "import sys, time, types; stand_in = types.ModuleType('dualarm_cli.evaluation.evaluate'); "
    "stand_in.evaluate = lambda _: time.sleep(600); "
    "sys.modules['dualarm_cli.evaluation.evaluate'] = stand_in; "
)
"""A worker that is the real one but for what it does, which takes long."""
PARENT = """
import sys, threading, time
import dualarm_cli.evaluation.crew as module
from dualarm_cli.evaluation.crew import Crew
from dualarm_cli.evaluation.request import Request
module._START = sys.argv[1] + module._START
crew = Crew(2)
def tell():
    while len(crew._workers) < 2 or not all(w.attempt for w in crew._workers):
        time.sleep(0.01)
    print(*(worker.process.pid for worker in crew._workers), flush=True)
threading.Thread(target=tell, daemon=True).start()
list(crew.run([Request("a", "a")] * 2))
"""


def test_workers_do_not_outlive_a_parent_that_is_killed():
    """Not even in the middle of something long: they ask the kernel to end with it."""
    parent = subprocess.Popen(
        [sys.executable, "-c", PARENT, BUSY], stdout=subprocess.PIPE, text=True
    )
    pids = [int(word) for word in parent.stdout.readline().split()]
    assert len(pids) == 2
    assert all(alive(pid) for pid in pids)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    end = time.monotonic() + 5.0
    while any(alive(pid) for pid in pids) and time.monotonic() < end:
        time.sleep(0.02)
    assert not any(alive(pid) for pid in pids)
    parent.stdout.close()


def test_the_working_directory_is_no_place_for_modules(cells, request_for):
    """A file that is called like a library there is not loaded by workers."""
    case = cells(1)[0]
    for name in ("numpy", "json", "yaml", "dualarm_cli"):
        Path(f"{name}.py").write_text("raise SystemExit(9)\n")
    with Crew(1) as crew:
        found = list(crew.run([request_for(case)]))
    assert found[0][1].status == "planned"
    assert os.environ.get("PYTHONPATH") is None or str(Path.cwd()) not in os.environ["PYTHONPATH"]
