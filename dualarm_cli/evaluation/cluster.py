"""The same evaluations on a Dask cluster: each thread of its workers has a crew of one process."""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Any

from dualarm_cli.errors import MissingDependencyError, UsageError
from dualarm_cli.evaluation.crew import Crew
from dualarm_cli.evaluation.fingerprint import GONE, digest, hashes_now, programs
from dualarm_cli.evaluation.request import Request
from dualarm_cli.model.evaluation import Evaluation, Finding
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ClusterSettings:
    """Times that a cluster is given [s]."""

    connecting: float = 10.0
    """Longest time in which a scheduler has to answer [s]."""
    poll: float = 0.02
    """Interval between checks for finished requests [s]."""
    look: float = 5.0
    """Interval between checks for workers while no request is finished [s]."""
    deserted: float = 60.0
    """Longest time that a cluster may be without workers [s].

    Workers that die may be started again meanwhile.
    """
    closing: float = 1.0
    """Longest time in which the connection has to close [s]."""


WAITS = ClusterSettings()

ELSEWHERE = (
    "a worker of the cluster lacks this file or has another version of it; give workers the same files at the same "
    "paths, such as in a shared folder"
)
"""Message of a case whose files other machines lack or have otherwise."""
OTHER_PROGRAMS = (
    "a worker that joined the cluster later has another version of dualarm, of Python or of a library, and may plan "
    "differently; install the same versions there"
)
"""Message of a case that came to a worker which was not there when all were compared."""
_here = threading.local()


class Cluster:
    """A Dask cluster whose workers have this very version of dualarm."""

    def __init__(self, address: str, timeout: float | None = None) -> None:
        """Connects, and compares what plans there with what plans here.

        Args:
            address: of the scheduler, such as `tcp://10.0.0.1:8786`.
            timeout: how long one request may take [s]; None for no limit.

        Raises:
            MissingDependencyError: `distributed` is not installed.
            UsageError: there is no such scheduler, it has no workers, or they would plan otherwise.
        """
        try:
            from distributed import Client
        except ImportError:
            raise MissingDependencyError("distributed", "cluster") from None
        _ask(address)
        self._address, self._timeout = address, timeout
        # What it logs are tracebacks of its own; the cases report what they come to.
        for logger in ("distributed", "distributed.client"):
            logging.getLogger(logger).setLevel(logging.CRITICAL)
        try:
            self._client = Client(address, timeout=WAITS.connecting, set_as_default=False)
        except Exception as error:
            raise _no_scheduler(address, error) from None
        try:
            self._check(address)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Cluster:
        """Returns itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Takes leave of the cluster."""
        self.close()

    def close(self) -> None:
        """Takes leave of the cluster; what it is doing for this client it does no longer, as soon as it can stop."""
        with suppress(Exception):
            self._client.close(timeout=WAITS.closing)

    def _check(self, address: str) -> None:
        """Raises UsageError where no worker is there, or one would plan otherwise."""
        try:
            there: Mapping[str, Mapping[str, str]] = self._client.run(_programs_there)
        except Exception as error:
            raise UsageError(
                f"--scheduler {address}: its workers cannot run this version of dualarm "
                f"({type(error).__name__}: {error}); install the same one there"
            ) from None
        if not there:
            raise UsageError(
                f"--scheduler {address}: it has no workers; start some by `dask worker {address}`"
            )
        own = dict(programs())
        for worker, found in sorted(there.items()):
            other = [name for name in own if found.get(name) != own[name]]
            if other:
                named = ", ".join(
                    f"{name} {str(found.get(name))[:12]} there, {own[name][:12]} here"
                    for name in other[:4]
                )
                raise UsageError(
                    f"--scheduler {address}: worker {worker} may plan differently: "
                    f"{named}; install the same versions there"
                )

    def run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        """Yields the place of each request and what it came to, in the order in which they are done.

        Args:
            requests: any number; their files are read by the workers, at the same paths.

        Raises:
            UsageError: all workers have gone, or the scheduler has.
        """
        from distributed import as_completed

        wanted = digest(dict(programs()))
        places = {
            self._client.submit(
                evaluate_there, request.as_document(), self._timeout, wanted, pure=False
            ): index
            for index, request in enumerate(requests)
        }
        known: dict[str, str] = {}
        try:
            done = as_completed(list(places), loop=self._client.loop)
            seen = looked = time.monotonic()
            answered = 0
            while done.count():
                for future in done.next_batch(block=False):
                    index = places[future]
                    answer = _answer(future, requests[index], known)
                    if answer is None:
                        raise UsageError(
                            f"--scheduler {self._address}: it has ended or cannot be reached, with {answered} "
                            f"of {len(requests)} plans done; those are in the cache (unless --no-cache): start it "
                            "again, and run the same command again"
                        )
                    yield index, answer
                    answered += 1
                    seen = looked = time.monotonic()
                time.sleep(WAITS.poll)
                if time.monotonic() > looked + WAITS.look:
                    looked = time.monotonic()
                    seen = looked if self._has_workers() else seen
                    self._refuse_deserted(seen)
        finally:
            with suppress(Exception):
                self._client.cancel([future for future in places if not future.done()])

    def _has_workers(self) -> bool:
        """Returns whether there are workers; true where nobody answers, as the client itself gives that up."""
        try:
            return bool(self._client.nthreads())
        except Exception:
            return True

    def _refuse_deserted(self, seen: float) -> None:
        """Raises UsageError where the last worker was seen too long ago."""
        if time.monotonic() > seen + WAITS.deserted:
            raise UsageError(
                f"--scheduler {self._address}: it has had no workers for {WAITS.deserted:g} s; start some by "
                f"`dask worker {self._address}` and run the same command again"
            )


def _ask(address: str) -> None:
    """Makes sure that a scheduler answers at an address, before a client of its own kind waits for it.

    Raises:
        UsageError: nobody answers, or something else than a scheduler.
    """
    from distributed import Security
    from distributed.core import rpc

    async def ask() -> Any:
        arguments = Security().get_connection_args("client")
        async with rpc(address, timeout=WAITS.connecting, connection_args=arguments) as there:
            return await there.identity()

    try:
        found = asyncio.run(asyncio.wait_for(ask(), WAITS.connecting))
    except Exception as error:
        raise _no_scheduler(address, error) from None
    if not isinstance(found, dict) or found.get("type") != "Scheduler":
        raise _no_scheduler(address, "another program does")


def _no_scheduler(address: str, why: object) -> UsageError:
    said = str(why) or type(why).__name__
    said = " ".join("".join(c if c.isprintable() else " " for c in said).split())[:200]
    return UsageError(
        f"--scheduler {address}: no scheduler answers there ({said}); start one by `dask scheduler`"
    )


def _programs_there() -> dict[str, str]:
    """Returns what plans on a worker."""
    return dict(programs())


def evaluate_there(
    request: Mapping[str, Any], timeout: float | None, wanted: str
) -> dict[str, Any] | None:
    """Returns what a request comes to, as a document; runs on a worker of the cluster.

    A process of its own does it, as it would without a cluster: one that dies or takes too long does not take the
    worker with it, and threads of a worker do not share a planner.

    Args:
        request: as a document.
        timeout: how long it may take [s]; None for no limit.
        wanted: hash of the programs that are to plan; None is returned where others would.
    """
    if digest(dict(programs())) != wanted:
        return None
    crew = getattr(_here, "crew", None)
    if crew is None or _here.timeout != timeout:
        if crew is not None:
            crew.close()
        crew = Crew(1, timeout)
        _here.crew, _here.timeout = crew, timeout
    found = list(crew.run([Request.of_document(request)]))
    return found[0][1].as_document()


def _answer(future: Any, request: Request, known: dict[str, str]) -> Evaluation | None:
    """Returns what a request came to, or why the cluster has no answer that counts here; None if it has gone.

    Args:
        future: of its evaluation, done in one way or the other.
        request: what was asked.
        known: hashes of files here, added to.
    """
    try:
        if future.status == "finished":
            document = future.result()
            if document is None:
                return _refused(request, OTHER_PROGRAMS)
            return _seen_alike(Evaluation.of_document(document), request, known)
        if future.status in ("cancelled", "lost"):
            return None  # nobody here cancels: the client does so when the scheduler ends
        why = future.exception()
    except asyncio.CancelledError:
        return None
    except Exception as error:
        why = error
    finding = Finding(f"the cluster dropped it: {why}", request.case)
    return Evaluation(request.case, "crashed", findings=(finding,))


def _seen_alike(answer: Evaluation, request: Request, known: dict[str, str]) -> Evaluation:
    """Returns an answer if it was made from what the files hold here; what is wrong otherwise."""
    if answer.status in ("timed_out", "crashed"):
        return answer
    # A task file that nobody can read is reported as without a cluster.
    names = answer.inputs or [request.file]
    here = hashes_now(names, request.folder, known)
    other = [name for name in names if answer.inputs.get(name, GONE) != here[name]]
    return _refused(request, f"{ELSEWHERE} ({', '.join(other)})") if other else answer


def _refused(request: Request, text: str) -> Evaluation:
    return Evaluation(request.case, "bad_input", findings=(Finding(text, request.case),))
