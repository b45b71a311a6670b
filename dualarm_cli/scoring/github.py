"""A score as GitHub's workflow commands: annotations at the lines of the files."""

from __future__ import annotations

import os
from collections.abc import Sequence

from dualarm_cli.model.evaluation import Finding
from dualarm_cli.reporting.printable import printable
from dualarm_cli.scoring.verdict import Verdict, words
from dualarm_cli.scoring.words import advice

MOST = 10
"""Most annotations of a kind that GitHub shows of one step."""


def github_commands(verdicts: Sequence[Verdict], workspace: str | None) -> list[str]:
    """Returns the commands: an error for each reason of a case that fails, a notice on what improved.

    Where there are more than are shown, the last one says how many.

    Args:
        verdicts: by name.
        workspace: the folder that GitHub names files from; None for the working directory.
    """
    found = []
    for verdict in verdicts:
        if not verdict.failed:
            continue
        for reason in verdict.reasons or (Finding(words(verdict.state), verdict.case),):
            found.append(_command("error", verdict, reason, workspace))
    if len(found) > MOST:
        more = len(found) - MOST + 1
        text = _data(f"dualarm score: {more} more findings are in the step summary and the log")
        found = [*found[: MOST - 1], f"::error::{text}"]
    return found + [f"::notice::{_data(f'dualarm score: {line}')}" for line in advice(verdicts)]


def _command(kind: str, verdict: Verdict, reason: Finding, workspace: str | None) -> str:
    file = reason.file or verdict.case
    if workspace:
        file = os.path.relpath(file, workspace)
    # Without a line GitHub shows nothing at the file itself.
    properties = {"file": file, "line": str(reason.line or 1)}
    if reason.column:
        properties["col"] = str(reason.column)
    properties["title"] = f"{verdict.case}: {words(verdict.state)}"
    listed = ",".join(f"{name}={_property(printable(text))}" for name, text in properties.items())
    return f"::{kind} {listed}::{_data(printable(reason.message))}"


def _data(text: str) -> str:
    """Returns the message of a command, escaped."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    """Returns a property of a command, escaped."""
    return _data(text).replace(":", "%3A").replace(",", "%2C")
