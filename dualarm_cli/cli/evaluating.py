"""Where plans of many jobs come from: processes or a cluster, and the store of answers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dualarm_cli.cli.output import print_message

if TYPE_CHECKING:
    from dualarm_cli.evaluation.answers import Run
    from dualarm_cli.evaluation.store import Store


def open_store(cache: Path | None, no_cache: bool) -> Store | None:
    """Returns the store of answers, None for none."""
    from dualarm_cli.evaluation.store import DEFAULT_FOLDER, Store

    return None if no_cache else Store(cache or Path(DEFAULT_FOLDER))


@contextmanager
def evaluators(jobs: int | None, scheduler: str | None, timeout: float | None) -> Iterator[Run]:
    """Yields what evaluates requests: processes of this machine, or a cluster.

    Args:
        jobs: processes on this machine, started when there is work for them; None for one per core.
        scheduler: address of a Dask cluster instead.
        timeout: how long one request may take [s]; None for no limit.
    """
    if scheduler is not None:
        from dualarm_cli.evaluation.cluster import Cluster

        with Cluster(scheduler, timeout) as cluster:
            yield cluster.run
        return
    from dualarm_cli.evaluation.crew import Crew, usable_cores

    with Crew(jobs or usable_cores(), timeout) as crew:
        yield crew.run


def say_unkept(store: Store | None) -> None:
    """Says once that answers could not be kept, if that is so."""
    if store is not None and store.problem:
        print_message(
            f"warning: answers could not be kept in {store.folder}: {store.problem}; the results are whole, but are "
            "planned again the next time"
        )
