"""How far a score has come: a bar on a terminal, otherwise a line for each case that is done; on stderr."""

from __future__ import annotations

from types import TracebackType
from typing import TYPE_CHECKING

from dualarm_cli.cli.parts.output import print_message, stderr_console
from dualarm_cli.model.evaluation import Evaluation
from dualarm_cli.report.printable import one_line

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class ScoreProgress:
    """Receives every case that is done, within its `with` block."""

    def __init__(self, cases: int, quiet: bool) -> None:
        """Prepares for a number of cases; `quiet` says nothing at all."""
        self._cases, self._quiet, self._done = cases, quiet, 0
        self._bar: tuple[Progress, TaskID] | None = None

    def __enter__(self) -> ScoreProgress:
        """Shows the bar where there is a terminal."""
        console = None if self._quiet else stderr_console()
        if console is not None and console.is_terminal:
            from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

            progress = Progress(
                TextColumn("scoring"),
                BarColumn(),
                MofNCompleteColumn(),
                TextColumn("{task.description}", markup=False),
                console=console,
                transient=True,
            )
            self._bar = progress, progress.add_task("", total=self._cases)
            progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Takes the bar away."""
        if self._bar is not None:
            self._bar[0].stop()

    def tell(self, evaluation: Evaluation, known: bool) -> None:
        """Says that a case is done.

        Args:
            evaluation: what it came to.
            known: whether nothing had changed, so that nothing was planned.
        """
        self._done += 1
        if self._quiet:
            return
        name = one_line(evaluation.case)
        if self._bar is not None:
            progress, task = self._bar
            progress.update(task, advance=1, description=name)
            return
        time = evaluation.cycle_time
        what = evaluation.status.replace("_", " ") + ("" if time is None else f", {time:.3f} s")
        print_message(
            f"[{self._done}/{self._cases}] {name}: {what}{' (unchanged)' if known else ''}"
        )
