"""Score as Markdown and GitHub annotations, for step summaries and pull requests."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence

from dualarm_cli.model.studies.evaluation import Finding
from dualarm_cli.report.printable import printable
from dualarm_cli.scoring.messages import (
    advice,
    caveat_lines,
    counted,
    figure_words,
    reason_lines,
    rule_words,
    verdict_words,
)
from dualarm_cli.scoring.verdict import Verdict, words

MOST = 10
"""Maximum number of annotations per kind that GitHub shows for one step."""


def github_commands(verdicts: Sequence[Verdict], workspace: str | None) -> list[str]:
    """List GitHub's workflow commands: an error per reason, a notice per improvement.

    Beyond GitHub's limit the last error counts the others.

    Args:
        verdicts: by name.
        workspace: folder of GitHub's file names; None for the working directory.
    """
    commands = []
    for verdict in verdicts:
        if not verdict.failed:
            continue
        for reason in verdict.reasons or (Finding(words(verdict.state), verdict.case),):
            commands.append(_command("error", verdict, reason, workspace))
    if len(commands) > MOST:
        more = len(commands) - MOST + 1
        text = _data(f"dualarm score: {more} more findings are in the step summary and the log")
        commands = [*commands[: MOST - 1], f"::error::{text}"]
    commands += [
        f"::warning::{_data(f'dualarm score: {line}')}" for line in caveat_lines(verdicts)[:MOST]
    ]
    return commands + [f"::notice::{_data(f'dualarm score: {line}')}" for line in advice(verdicts)]


def _command(kind: str, verdict: Verdict, reason: Finding, workspace: str | None) -> str:
    file = reason.file or verdict.case
    if workspace:
        file = os.path.relpath(file, workspace)
    # GitHub shows an annotation at a file only with a line.
    properties = {"file": file, "line": str(reason.line or 1)}
    if reason.column:
        properties["col"] = str(reason.column)
    properties["title"] = f"{verdict.case}: {words(verdict.state)}"
    listed = ",".join(f"{name}={_property(printable(text))}" for name, text in properties.items())
    return f"::{kind} {listed}::{_data(printable(reason.message))}"


def _data(text: str) -> str:
    """Escape the message of a command."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    """Escape a property of a command."""
    return _data(text).replace(":", "%3A").replace(",", "%2C")


MARK = "<!-- dualarm score -->\n"
"""First bytes of a file that this package wrote."""
MOST_ROWS = 1000
"""Maximum number of cases in the table; failed cases come first beyond it.

Step summaries are limited to a megabyte.
"""
_SPECIAL = re.compile(r"([\\`*_\[\]{}()#|~!])")


def markdown_text(verdicts: Sequence[Verdict], max_regression: float, compared: bool) -> str:
    """Render a score as Markdown: a heading, failures with reasons, and a table.

    Args:
        verdicts: by name.
        max_regression: allowed relative increase of a cycle time.
        compared: whether there is a baseline.
    """
    failed = [verdict for verdict in verdicts if verdict.failed]
    shown = list(verdicts)
    if len(shown) > MOST_ROWS:
        shown = sorted(shown, key=lambda verdict: (not verdict.failed, verdict.case))[:MOST_ROWS]
    title = f"{len(failed)} of {len(verdicts)} cells fail" if failed else "all cells are good"
    caveats = caveat_lines(shown)
    if caveats and not failed:
        title = f"no cell fails, {sum(bool(v.caveats) for v in shown)} not fully checked"
    lines = [f"## dualarm score: {title}", "", counted(verdicts) + "."]
    if compared:
        lines += ["", rule_words(max_regression) + "."]
    reasons = [line for verdict in failed[:MOST_ROWS] for line in reason_lines(verdict)] + caveats
    if reasons:
        lines += ["", *(f"- {_plain(line)}" for line in reasons)]
    lines += ["", "| cell | cycle time s | change | above bound | clearance mm | verdict |"]
    lines += ["| --- | ---: | ---: | ---: | ---: | --- |"]
    for verdict in shown:
        state = verdict_words(verdict)
        cells = (
            _plain(printable(verdict.case)),
            *figure_words(verdict),
            f"**{state}**" if verdict.failed else state,
        )
        lines.append(f"| {' | '.join(cells)} |")
    if len(verdicts) > len(shown):
        lines += ["", f"... and {len(verdicts) - len(shown)} more."]
    if notes := advice(verdicts):
        lines += ["", *(f"- {_plain(line)}" for line in notes)]
    return MARK + "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Escape a text so that Markdown shows it without markup, HTML or mentions."""
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = _SPECIAL.sub(r"\\\1", text).replace("@", "&#64;")
    return " ".join(text.split())
