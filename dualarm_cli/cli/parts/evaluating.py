"""Evaluation of many jobs: processes or a cluster, and the cache of answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from dualarm_cli.cli.parts.output import print_message, stderr_console

if TYPE_CHECKING:
    from dualarm_cli.evaluation.answers import Run
    from dualarm_cli.evaluation.cluster import Cluster
    from dualarm_cli.evaluation.crew import Crew
    from dualarm_cli.evaluation.request import Request
    from dualarm_cli.evaluation.store import Store
    from dualarm_cli.model.studies.evaluation import Evaluation


@contextmanager
def progress_bar(
    title: str, total: int, quiet: bool
) -> Iterator[Callable[[int, str], None] | None]:
    """Show a progress bar on a terminal, and yield its update function.

    None is yielded without a bar.
    """
    console = None if quiet else stderr_console()
    if console is None or not console.is_terminal:
        yield None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    words = TextColumn("{task.description}", markup=False)
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), Remaining(), words)
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("", total=total)
        yield lambda done, words: bar.update(task, completed=done, description=words)


def open_store(cache: Path | None, no_cache: bool) -> Store | None:
    """Open the store of answers, or return None."""
    from dualarm_cli.evaluation.store import DEFAULT_FOLDER, Store

    return None if no_cache else Store(cache or Path(DEFAULT_FOLDER))


@contextmanager
def evaluators(
    jobs: int | None, scheduler: str | None, timeout: float | None, until: float | None = None
) -> Iterator[Run]:
    """Yield a function that evaluates requests, on this machine or a cluster.

    Processes or cluster are opened with the first requests.

    Args:
        jobs: processes on this machine, started when there is work for them; None for one per core.
        scheduler: address of a Dask cluster instead.
        timeout: how long one request may take [s]; None for no limit.
        until: instant of the monotonic clock at which processes end unanswered requests [s], or None.
    """
    with ExitStack() as stack:
        opened: list[Crew | Cluster] = []

        def run(requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
            if not opened:
                opened.append(_open(jobs, scheduler, timeout, until))
                stack.callback(opened[0].close)
            return opened[0].run(requests)

        yield run


def _open(
    jobs: int | None, scheduler: str | None, timeout: float | None, until: float | None
) -> Crew | Cluster:
    if scheduler is not None:
        from dualarm_cli.evaluation.cluster import Cluster

        return Cluster(scheduler, timeout)
    from dualarm_cli.background import usable_cores
    from dualarm_cli.evaluation.crew import Crew

    return Crew(jobs or usable_cores(), timeout, until)


def say_unkept(store: Store | None) -> None:
    """Warn once if answers could not be cached."""
    if store is not None and store.problem:
        print_message(
            f"warning: results could not be cached in {store.folder}: {store.problem}; the results are complete, but "
            "will be planned again next time"
        )
