"""The cluster: what workers say counts only if they saw the same files and would plan alike; what is lost is told."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from dualarm_cli.errors import UsageError
from dualarm_cli.evaluation import cluster as module
from dualarm_cli.evaluation.cluster import Cluster, evaluate_there
from dualarm_cli.evaluation.fingerprint import digest, hashes_now, programs
from dualarm_cli.model.studies.evaluation import Evaluation

distributed = pytest.importorskip("distributed")


class Future:
    """What became of one task of a stand-in cluster."""

    def __init__(self, status, result=None, error=None):
        """Stores it."""
        self.status, self._result, self._error = status, result, error

    def result(self):
        """Returns the result, or raises what getting it comes to."""
        if isinstance(self._result, BaseException):
            raise self._result
        return self._result

    def exception(self):
        """Returns the error of a task that has one."""
        return self._error

    def done(self):
        """All are."""
        return True


class Client:
    """A cluster whose tasks end as they are told."""

    loop = None
    futures: tuple[Future, ...] = ()

    def __init__(self, *_, **__):
        """Takes the tasks' ends in turn."""
        self.left = list(self.futures)

    def run(self, function):
        """Asks the one worker."""
        return {"tcp://worker": function()}

    def submit(self, *_, **__):
        """Returns the next end."""
        return self.left.pop(0)

    def nthreads(self):
        """There are no workers any more."""
        return {}

    def cancel(self, _):
        """Nothing is left."""

    def close(self, timeout):
        """Nothing to close."""


class Done:
    """Tasks that are done at once but for those that are pending."""

    def __init__(self, futures, **_):
        """Stores them."""
        self.ready = [future for future in futures if future.status != "pending"]
        self.pending = len(futures) - len(self.ready)

    def count(self):
        """Returns how many have not been returned."""
        return len(self.ready) + self.pending

    def next_batch(self, block):
        """Returns all that are done."""
        assert not block
        batch, self.ready = self.ready, []
        return batch


@pytest.fixture
def answered(monkeypatch):
    """Returns what a cluster's answers come to, by tasks that have ended in given ways."""
    monkeypatch.setattr(distributed, "Client", Client)
    monkeypatch.setattr(module, "_ask", lambda _: None)
    monkeypatch.setattr(distributed, "as_completed", Done)

    def call(requests, *futures):
        monkeypatch.setattr(Client, "futures", futures)
        with Cluster("tcp://x:1") as cluster:
            found = dict(cluster.run(requests))
        return [found[k] for k in range(len(requests))]

    return call


@pytest.fixture
def request_and_answer(cells, request_for):
    """A request, and an answer that was made from what its files hold."""
    request = request_for(cells(1)[0])
    inputs = hashes_now(["cell.yaml", "tasks.yaml"], request.folder, {})
    return request, Evaluation(request.case, "planned", cycle_time=1.0, inputs=inputs)


def test_an_answer_from_the_same_files_is_taken(request_and_answer, answered):
    """As it is."""
    request, answer = request_and_answer
    assert answered([request], Future("finished", answer.as_document())) == [answer]


@pytest.mark.parametrize("status", ["planned", "infeasible", "bad_input", "internal_error"])
def test_an_answer_from_other_files_is_none(request_and_answer, answered, status):
    """Another content of a file there, or one that is there only; it is named."""
    request, answer = request_and_answer
    for name in ("cell.yaml", "elsewhere.yaml"):
        inputs = dict(answer.inputs) | {name: "0" * 64}
        document = replace(answer, status=status, inputs=inputs).as_document()
        (found,) = answered([request], Future("finished", document))
        assert found.status == "bad_input"
        assert (
            "a worker of the cluster lacks this file or has another version of it"
            in found.findings[0].message
        )
        assert f"({name})" in found.findings[0].message


def test_a_task_file_that_is_only_here_is_told_and_one_that_is_nowhere_as_without_a_cluster(
    request_and_answer, answered
):
    """So that the same mistake is the same bytes everywhere."""
    request, _ = request_and_answer
    unread = Evaluation(request.case, "bad_input")
    (found,) = answered([request], Future("finished", unread.as_document()))
    assert "give workers the same files" in found.findings[0].message
    Path(request.path).unlink()
    assert answered([request], Future("finished", unread.as_document())) == [unread]


def test_what_the_cluster_gives_up_is_crashed_and_says_why(request_and_answer, answered):
    """An error of the task, and a result that cannot be fetched."""
    request, answer = request_and_answer
    ends = (
        Future("error", error=RuntimeError("worker killed")),
        Future("finished", OSError("no route")),
        Future("finished", answer.as_document()),
    )
    found = answered([request] * 3, *ends)
    assert [one.status for one in found] == ["crashed"] * 2 + ["planned"]
    texts = [one.findings[0].message for one in found[:2]]
    assert "worker killed" in texts[0]
    assert "no route" in texts[1]
    for logger in ("distributed.client", "distributed.worker"):
        assert not logging.getLogger(logger).isEnabledFor(logging.ERROR)


@pytest.mark.parametrize(
    "end", [Future("cancelled"), Future("lost"), Future("finished", asyncio.CancelledError())]
)
def test_a_scheduler_that_ends_is_told_in_a_sentence(request_and_answer, answered, end):
    """With how much is done; nothing counts as crashed, so that the same command goes on."""
    request, answer = request_and_answer
    words = r"it has ended or cannot be reached, with 1 of 3 plans done; those are in the cache"
    with pytest.raises(UsageError, match=words):
        answered([request] * 3, Future("finished", answer.as_document()), end, Future("cancelled"))


@pytest.mark.parametrize(
    "said", [b"HTTP/1.1 400 Bad Request\r\n\r\n", bytes(4000), b"\x93\x01" * 900, b""]
)
def test_what_is_no_scheduler_is_refused_in_a_sentence(said):
    """Something else listens there, or closes at once; no traceback when the process ends."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]

        def speak():
            with contextlib.suppress(OSError):
                while True:
                    caller, _ = server.accept()
                    with caller:
                        caller.sendall(said)
                        time.sleep(0.1)

        threading.Thread(target=speak, daemon=True).start()
        program = (
            "import dualarm_cli.evaluation.cluster as c\nc.CONNECTING = 3.0\n"
            f"try:\n    c.Cluster('tcp://127.0.0.1:{port}')\n"
            "except c.UsageError as error:\n    print(error)"
        )
        ended = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=False
        )
    assert f"--scheduler tcp://127.0.0.1:{port}: no scheduler answers there" in ended.stdout
    assert len(ended.stdout.splitlines()) == 1
    assert ended.stderr == ""
    assert ended.returncode == 0


def test_a_worker_that_came_later_with_other_programs_plans_nothing(
    request_and_answer, answered, monkeypatch
):
    """All are compared at the beginning, but a cluster may grow."""
    request, _ = request_and_answer

    def never(*_):
        raise AssertionError("planned")

    monkeypatch.setattr(module, "Crew", never)
    assert evaluate_there(request.as_document(), None, "another") is None
    with pytest.raises(AssertionError, match="planned"):
        evaluate_there(request.as_document(), None, digest(dict(programs())))
    (found,) = answered([request], Future("finished", None))
    assert found.status == "bad_input"
    assert "may plan differently" in found.findings[0].message


def test_a_cluster_that_has_lost_all_workers_is_given_up(request_and_answer, answered, monkeypatch):
    """Instead of waiting forever; one that has some, or does not say, is waited for."""
    request, answer = request_and_answer
    monkeypatch.setattr(module, "WAITS", replace(module.WAITS, look=0.01, deserted=0.2))
    good, pending = Future("finished", answer.as_document()), Future("pending")
    with pytest.raises(UsageError, match=r"it has had no workers for 0.2 s; start some"):
        answered([request] * 2, good, pending)
    looks = []

    def busy(_):
        looks.append(1)
        if len(looks) > 30:
            raise KeyboardInterrupt  # by whoever waits
        if len(looks) % 2:
            raise OSError("busy")
        return {"tcp://worker": 1}

    monkeypatch.setattr(Client, "nthreads", busy)
    with pytest.raises(KeyboardInterrupt):
        answered([request] * 2, good, pending)
