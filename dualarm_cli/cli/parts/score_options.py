"""Options of `dualarm score`, and their valid combinations."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_job
from dualarm_cli.cli.parts.options import read_quantity
from dualarm_cli.errors import UsageError

DEFAULT_REGRESSION = 1e-3
"""Default allowed relative increase of a cycle time.

Plans are reproducible, so it can be small.
"""
MOST_JOBS = 1024
"""Maximum number of processes."""
_ADDRESS = re.compile(r"((tcp|tls|ucx|wss?)://)?(\[[0-9A-Fa-f:.%]+\]|[^\s:/\[\]]+):[0-9]{1,5}/?")
"""Host and port, with an optional protocol."""

CasesArgument = Annotated[
    list[str],
    typer.Argument(
        metavar="TASKS...",
        help="Task files, bundled jobs, folders, or patterns such as 'cells/**/tasks.yaml' (in quotes).",
        autocompletion=complete_job,
    ),
]
BaselineOption = Annotated[
    Path | None,
    typer.Option(
        "--baseline", help="Scores to compare with (dualarm.scores/1).", show_default=False
    ),
]
RegressionOption = Annotated[
    str | None,
    typer.Option(
        "--max-regression",
        metavar="SHARE",
        help="Allowed increase of a cycle time over the baseline (2%, 0.02); 1 ms is always allowed.",
        show_default="0.1%",
    ),
]
UpdateOption = Annotated[
    bool, typer.Option("--update-baseline", help="Replace the baseline by the new results.")
]
SubsetOption = Annotated[
    bool, typer.Option("--subset", help="Ignore cases of the baseline that are not given here.")
]
JobsOption = Annotated[
    int | None,
    typer.Option(
        "--jobs",
        min=1,
        max=MOST_JOBS,
        help="Number of parallel processes.",
        show_default="all usable cores",
    ),
]
TimeoutOption = Annotated[
    str | None,
    typer.Option(
        "--timeout",
        metavar="DURATION",
        help="Time limit for one plan (60, '60 s', '5 min'). Each plan is tried twice.",
        show_default="no limit",
    ),
]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Plan on a Dask cluster, such as tcp://10.0.0.1:8786.",
    ),
]
CacheOption = Annotated[
    Path | None,
    typer.Option(
        "--cache",
        help="Cache folder, for this purpose only: unchanged cells are not planned again.",
        show_default=".dualarm-cache",
    ),
]
NoCacheOption = Annotated[
    bool, typer.Option("--no-cache", help="Plan everything, without a cache.")
]
JunitOption = Annotated[Path | None, typer.Option("--junit", help="JUnit XML file to write.")]
MarkdownOption = Annotated[Path | None, typer.Option("--markdown", help="Markdown file to write.")]
GithubOption = Annotated[
    bool,
    typer.Option(
        "--github",
        help="Annotations for GitHub on stderr, and the Markdown into the step's summary.",
    ),
]


def read_regression(text: str | None) -> float:
    """Read the allowed relative increase of a cycle time.

    Raises:
        UsageError: not a fraction, negative, or a number above 1 that may be meant as percent.
    """
    from dualarm_cli.files.source.quantities import FRACTION

    if text is None:
        return DEFAULT_REGRESSION
    share = read_quantity("--max-regression", text, FRACTION, "2% or 0.02")
    if share < 0.0:
        raise UsageError(f"--max-regression {text}: must be 0 or more; write one such as 2%")
    if share >= 1.0 and "%" not in text:
        # Taken literally, it would accept any increase.
        raise UsageError(
            f"--max-regression {text}: is {share * 100:g} %; write {share:g}% or {share * 100:g}%"
        )
    return share


def refuse_combinations(
    *,
    baseline: Path | None = None,
    regression: str | None = None,
    update: bool = False,
    subset: bool = False,
    jobs: int | None,
    scheduler: str | None,
    cache: Path | None,
    no_cache: bool,
) -> None:
    """Raise if options exclude each other; none of them is ignored silently.

    Raises:
        UsageError: with both, and what to do.
    """
    if baseline is None:
        needing = {
            "--max-regression": regression is not None,
            "--update-baseline": update,
            "--subset": subset,
        }
        for option, given in needing.items():
            if given:
                raise UsageError(f"{option} needs --baseline FILE, such as --baseline scores.json")
    if update and regression is not None:
        raise UsageError(
            "--max-regression does not go with --update-baseline, which takes every cycle time as it is"
        )
    if scheduler is not None and jobs is not None:
        raise UsageError(
            "--jobs does not go with --scheduler: the cluster sets the number of workers; leave one out"
        )
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise UsageError(
            f"--scheduler '{scheduler}': is not an address; write one such as tcp://10.0.0.1:8786"
        )
    if no_cache and cache is not None:
        raise UsageError("--cache does not go with --no-cache; keep one")
    if cache is not None and cache.exists() and not cache.is_dir():
        raise UsageError(f"--cache {cache}: is a file; name a folder")
    if cache is not None and _belongs_to_others(cache):
        raise UsageError(
            f"--cache {cache}: holds other files, which git would then ignore; name a separate folder, such "
            f"as {cache / '.dualarm-cache'}"
        )


def _belongs_to_others(folder: Path) -> bool:
    """Check whether a folder has files but no cache."""
    try:
        names = {path.name for path in folder.iterdir()}
    except OSError:
        return False
    return bool(names) and not names & {"answers", "files", "making"}
