"""`dualarm explain`: what an error code means, and what to do."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from dualarm_cli.cli.parts.completion import complete_code
from dualarm_cli.cli.parts.output import JsonOption, print_json


def explain_command(
    code: Annotated[
        str,
        typer.Argument(
            help="An error code, such as E610; all of them without it.",
            autocompletion=complete_code,
        ),
    ] = "",
    json_output: JsonOption = False,
) -> None:
    """Explain an error code: causes and remedies."""
    from dualarm_cli.errors import UsageError, did_you_mean
    from dualarm_cli.explanations import EXPLANATIONS

    wanted = code.strip().upper()
    if wanted and wanted not in EXPLANATIONS:
        guess = did_you_mean(wanted, list(EXPLANATIONS)) or ";"
        raise UsageError(
            f"there is no error code '{code}'{guess} `dualarm explain` lists all codes"
        )
    chosen = {wanted: EXPLANATIONS[wanted]} if wanted else EXPLANATIONS
    if json_output:
        codes = [{"code": name} | asdict(one) for name, one in chosen.items()]
        print_json({"format": "dualarm.explanations/1", "codes": codes})
        return
    if not wanted:
        for name, one in chosen.items():
            typer.echo(f"{name}  {one.title}")
        return
    one = chosen[wanted]
    lines = [f"{wanted}: {one.title}", "", "Why:", *(f"  - {text}" for text in one.causes)]
    lines += ["", "What to do:", *(f"  - {text}" for text in one.remedies)]
    if one.example:
        lines += ["", f"Example: {one.example}"]
    if one.page:
        lines += ["", f"More: {one.page} of the documentation"]
    typer.echo("\n".join(lines))
