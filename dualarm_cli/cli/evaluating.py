"""What commands share that plan many jobs: processes or a cluster, time-outs, the store of answers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dualarm_cli.cli.output import print_message
from dualarm_cli.errors import OutputError, UsageError

if TYPE_CHECKING:
    from dualarm_cli.evaluation.answers import Run
    from dualarm_cli.evaluation.store import Store

JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        "-j",
        min=1,
        help="Processes that plan side by side.",
        show_default="one per core",
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Plan on a Dask cluster, such as tcp://10.0.0.1:8786 (extra `cluster`).",
        show_default=False,
    ),
]
TimeoutOption = Annotated[
    str | None,
    typer.Option(
        "--timeout",
        metavar="DURATION",
        help="How long one plan may take (60, '60 s', '2 min'); it then counts as timed out.",
        show_default="no limit",
    ),
]
CacheOption = Annotated[
    Path | None,
    typer.Option(
        "--cache",
        help="Folder in which finished plans' figures are kept.",
        show_default=".dualarm-cache",
    ),
]
NoCacheOption = Annotated[
    bool, typer.Option("--no-cache", help="Neither use nor keep finished plans.")
]


def read_timeout(text: str | None) -> float | None:
    """Returns a time-out [s], None where there is none.

    Raises:
        UsageError: it is no duration above 0.
    """
    from dualarm_cli.loading.quantities import TIME, QuantityError, parse_quantity

    if text is None:
        return None
    try:
        limit = parse_quantity(text, TIME)
    except QuantityError as error:
        raise UsageError(f"--timeout: {error}") from error
    if limit <= 0.0:
        raise UsageError(f"--timeout {text}: must be above 0 s; write one such as 60 or '2 min'")
    return limit


def open_store(cache: Path | None, no_cache: bool) -> Store | None:
    """Returns the store of answers, None for none.

    Raises:
        OutputError: its name is that of a file.
        UsageError: options that do not go together.
    """
    from dualarm_cli.evaluation.store import DEFAULT_FOLDER, Store

    if no_cache:
        if cache is not None:
            raise UsageError("--cache and --no-cache do not go together; keep one")
        return None
    folder = Path(DEFAULT_FOLDER) if cache is None else cache
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"--cache {folder}: is a file; name a folder")
    return Store(folder)


@contextmanager
def evaluators(jobs: int | None, scheduler: str | None, timeout: float | None) -> Iterator[Run]:
    """Yields what evaluates requests: processes of this machine, or a cluster.

    Args:
        jobs: processes on this machine; None for one per core.
        scheduler: address of a Dask cluster instead.
        timeout: how long one request may take [s]; None for no limit.

    Raises:
        UsageError: options that do not go together.
    """
    from dualarm_cli.evaluation.crew import Crew, usable_cores

    if scheduler is not None:
        if jobs is not None:
            raise UsageError("--jobs counts processes here, --scheduler plans elsewhere; keep one")
        from dualarm_cli.evaluation.cluster import Cluster

        with Cluster(scheduler, timeout) as cluster:
            yield cluster.run
        return
    with Crew(usable_cores() if jobs is None else jobs, timeout) as crew:
        yield crew.run


def say_unkept(store: Store | None) -> None:
    """Says once that answers could not be kept, if that is so."""
    if store is not None and store.problem:
        print_message(f"note: {store.folder}: finished plans are not kept there: {store.problem}")
