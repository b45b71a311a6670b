"""Files that `dualarm sweep` writes: none over what it reads, each whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dualarm_cli.cli.output import print_message
from dualarm_cli.cli.result_files import json_bytes, refuse_folder, write_folder
from dualarm_cli.errors import OutputError, UsageError

DOCUMENT, TABLE, PARETO, EFFECTS = "study.json", "table.csv", "pareto.png", "sensitivity.png"
FILES = (DOCUMENT, TABLE, PARETO, EFFECTS)


def refuse_results(out: str | None, csv: Path | None, force: bool) -> None:
    """Raises before any work is done where results could not be written anyway."""
    if out is not None:
        refuse_folder(out, FILES, force)
    if csv is None:
        return
    if csv.is_dir():
        raise OutputError(f"--csv {csv}: is a folder; name a file")
    if not csv.parent.is_dir():
        raise OutputError(f"--csv {csv}: there is no folder {csv.parent}")
    if csv.exists() and not force:
        raise OutputError(f"--csv {csv}: is there already; add --force to replace it")


def refuse_inputs(out: str | None, csv: Path | None, inputs: Iterable[str]) -> None:
    """Raises where a result would replace a file that the study was read from, or another result: no --force does."""
    read = {os.path.realpath(name) for name in inputs}
    results = {os.path.realpath(Path(out) / name): name for name in FILES} if out else {}
    named = [(f"--out {out}: its {name}", path) for path, name in results.items()]
    if csv is not None:
        named.append((f"--csv {csv}:", os.path.realpath(csv)))
        if results.get(named[-1][1], TABLE) != TABLE:
            raise UsageError(f"--csv {csv}: is a file of --out {out} as well; name another")
    for what, path in named:
        if path in read:
            raise UsageError(f"{what} is a file that the study is read from; name another")


def write_results(document: dict[str, Any], out: str | None, csv: Path | None, quiet: bool) -> None:
    """Writes the files asked for, and says so unless told to be quiet."""
    from dualarm_cli.errors import MissingDependencyError
    from dualarm_cli.exporting.whole_files import write_file
    from dualarm_cli.reporting.study_figure import draw_pareto, draw_sensitivity
    from dualarm_cli.reporting.study_table import study_csv

    if csv is not None:
        write_file(csv, study_csv(document), force=True)
        _say(f"written: {csv}", quiet)
    if out is None:
        return
    files = {TABLE: study_csv(document)}
    try:
        if not document["counts"]["planned"]:
            _say(f"{PARETO} and {EFFECTS} are not drawn: no point has a plan", quiet)
        else:
            files[EFFECTS] = draw_sensitivity(document, "png")
            if len(document["objectives"]) > 1:
                files[PARETO] = draw_pareto(document, "png")
            else:
                _say(f"{PARETO} is not drawn: it takes two objectives", quiet)
    except MissingDependencyError as error:
        _say(f"{PARETO} and {EFFECTS} are not drawn: {error}", quiet)
    for name in {PARETO, EFFECTS} - set(files):
        # Of an earlier study: it would not go with this one.
        (Path(out) / name).unlink(missing_ok=True)
    write_folder(out, files | {DOCUMENT: json_bytes(document)})
    _say(f"written: {out}", quiet)


def _say(text: str, quiet: bool) -> None:
    if not quiet:
        print_message(text)
