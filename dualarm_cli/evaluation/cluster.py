"""Evaluations on a Dask cluster: each worker thread has a crew of one process."""

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
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ClusterSettings:
    """Time limits of a cluster [s]."""

    connecting: float = 10.0
    """Maximum time for a scheduler to answer [s]."""
    poll: float = 0.02
    """Interval between checks for finished requests [s]."""
    look: float = 5.0
    """Interval between checks for workers while no request is finished [s]."""
    deserted: float = 60.0
    """Maximum time of a cluster without workers [s].

    Workers that died may be restarted meanwhile.
    """
    closing: float = 1.0
    """Maximum time to close the connection [s]."""


WAITS = ClusterSettings()

ELSEWHERE = (
    "a worker of the cluster lacks this file or has another version of it; give workers the same files at the same "
    "paths, such as in a shared folder"
)
"""Message on a case whose files differ on a worker."""
OTHER_PROGRAMS = (
    "a worker that joined the cluster later has another version of dualarm, of Python or of a library, and may plan "
    "differently; install the same versions there"
)
"""Message on a case that a later, different worker received."""
_here = threading.local()


class Cluster:
    """Dask cluster whose workers have the same versions of all programs."""

    def __init__(self, address: str, timeout: float | None = None) -> None:
        """Connect, and compare the workers' programs with those here.

        Args:
            address: of the scheduler, such as `tcp://10.0.0.1:8786`.
            timeout: maximum time of one request [s]; None for no limit.

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
        # Its log has only tracebacks; the evaluations report errors.
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
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Disconnect from the cluster."""
        self.close()

    def close(self) -> None:
        """Disconnect from the cluster; running requests stop as soon as they can."""
        with suppress(Exception):
            self._client.close(timeout=WAITS.closing)

    def _check(self, address: str) -> None:
        """Raise UsageError if there are no workers, or one has different programs."""
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
        here = dict(programs())
        for worker, versions in sorted(there.items()):
            different = [name for name in here if versions.get(name) != here[name]]
            if different:
                named = ", ".join(
                    f"{name} {str(versions.get(name))[:12]} there, {here[name][:12]} here"
                    for name in different[:4]
                )
                raise UsageError(
                    f"--scheduler {address}: worker {worker} may plan differently: "
                    f"{named}; install the same versions there"
                )

    def run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        """Yield the index and evaluation of each request on completion.

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
        hashes: dict[str, str] = {}
        try:
            done = as_completed(list(places), loop=self._client.loop)
            seen = looked = time.monotonic()
            answered = 0
            while done.count():
                for future in done.next_batch(block=False):
                    index = places[future]
                    answer = _answer(future, requests[index], hashes)
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
        """Test whether the cluster has workers; true if the scheduler does not answer.

        The client itself gives up on the scheduler then.
        """
        try:
            return bool(self._client.nthreads())
        except Exception:
            return True

    def _refuse_deserted(self, seen: float) -> None:
        """Raise UsageError if the last worker was seen too long ago."""
        if time.monotonic() > seen + WAITS.deserted:
            raise UsageError(
                f"--scheduler {self._address}: it has had no workers for {WAITS.deserted:g} s; start some by "
                f"`dask worker {self._address}` and run the same command again"
            )


def _ask(address: str) -> None:
    """Check that a scheduler answers at an address, before a client waits for it.

    Raises:
        UsageError: no answer, or one of another program.
    """
    from distributed import Security
    from distributed.core import rpc

    async def ask() -> Any:
        arguments = Security().get_connection_args("client")
        async with rpc(address, timeout=WAITS.connecting, connection_args=arguments) as there:
            return await there.identity()

    try:
        identity = asyncio.run(asyncio.wait_for(ask(), WAITS.connecting))
    except Exception as error:
        raise _no_scheduler(address, error) from None
    if not isinstance(identity, dict) or identity.get("type") != "Scheduler":
        raise _no_scheduler(address, "another program does")


def _no_scheduler(address: str, why: object) -> UsageError:
    said = str(why) or type(why).__name__
    said = " ".join("".join(c if c.isprintable() else " " for c in said).split())[:200]
    return UsageError(
        f"--scheduler {address}: no scheduler answers there ({said}); start one by `dask scheduler`"
    )


def _programs_there() -> dict[str, str]:
    """Return the versions of a worker's programs."""
    return dict(programs())


def evaluate_there(
    request: Mapping[str, Any], timeout: float | None, wanted: str
) -> dict[str, Any] | None:
    """Evaluate a request in a worker's own process, and return a document.

    As without a cluster, a separate process isolates the worker from crashes and timeouts, and threads of a worker do
    not share a planner.

    Args:
        request: as a document.
        timeout: maximum time [s]; None for no limit.
        wanted: required hash of the programs; None is returned for another hash.
    """
    if digest(dict(programs())) != wanted:
        return None
    crew = getattr(_here, "crew", None)
    if crew is None or _here.timeout != timeout:
        if crew is not None:
            crew.close()
        crew = Crew(1, timeout)
        _here.crew, _here.timeout = crew, timeout
    evaluations = list(crew.run([Request.of_document(request)]))
    return evaluations[0][1].as_document()


def _answer(future: Any, request: Request, hashes: dict[str, str]) -> Evaluation | None:
    """Collect the evaluation of a request, or the reason why it is invalid.

    Returns None if the cluster has gone.

    Args:
        future: of its evaluation, finished or failed.
        request: the request.
        hashes: of local files, extended.
    """
    try:
        if future.status == "finished":
            document = future.result()
            if document is None:
                return _refused(request, OTHER_PROGRAMS)
            return _with_same_files(Evaluation.of_document(document), request, hashes)
        if future.status in ("cancelled", "lost"):
            return None  # cancelled by the client when the scheduler ends
        why = future.exception()
    except asyncio.CancelledError:
        return None
    except Exception as error:
        why = error
    finding = Finding(f"the cluster dropped it: {why}", request.case)
    return Evaluation(request.case, "crashed", findings=(finding,))


def _with_same_files(answer: Evaluation, request: Request, hashes: dict[str, str]) -> Evaluation:
    """Return an answer if its files equal the local ones, or else an error."""
    if answer.status in ("timed_out", "crashed"):
        return answer
    # An unreadable task file is reported as without a cluster.
    names = answer.inputs or [request.file]
    local_hashes = hashes_now(names, request.folder, hashes)
    different = [name for name in names if answer.inputs.get(name, GONE) != local_hashes[name]]
    return _refused(request, f"{ELSEWHERE} ({', '.join(different)})") if different else answer


def _refused(request: Request, text: str) -> Evaluation:
    return Evaluation(request.case, "bad_input", findings=(Finding(text, request.case),))
