"""Help of commands: groups, examples that the commands take, every value, nothing cut at 80 columns."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from dualarm_cli.cli.parts.completion import families
from dualarm_cli.cli.parts.help import EXAMPLES, GROUPS
from dualarm_cli.cli.parts.options import SOLVERS
from dualarm_cli.cli.run import COMMANDS, command_line, run


def commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Every command with its words, groups left out."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield path, command
    for name, one in (inner or {}).items():
        yield from commands(one, (*path, name))


ALL = dict(commands(typer.main.get_command(command_line())))


@pytest.mark.parametrize("path", ALL, ids=" ".join)
def test_a_help_of_80_columns_is_whole(
    path: tuple[str, ...], capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No line is longer or ends in "…"; each option is there, without Python's types; examples stand at the end."""
    monkeypatch.setenv("COLUMNS", "80")
    assert run([*path, "--help"]) == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80
    for mark in ("…", "<str>", "<path>", "(default", "[default: ("):
        assert mark not in text
    for param in ALL[path].params:
        assert (param.opts[0] if param.opts[0].startswith("-") else "Arguments:") in text
        shown = [getattr(param, "help", None) or ""]
        if isinstance(param.default, str | int | float) and param.default not in ("", True, False):
            shown.append(f"[default: {param.default}]")
        assert all("".join(words.split()) in "".join(text.split()) for words in shown)
    words = EXAMPLES[" ".join(path)].split("; ")[-1]
    assert text.splitlines()[-1] == f"  dualarm {' '.join(path)} {words}"


def test_examples_are_what_the_commands_take() -> None:
    """Each is parsed, without being run."""
    assert {" ".join(path) for path in ALL} == set(EXAMPLES) - {""}
    each = [(path, words) for path, examples in EXAMPLES.items() for words in examples.split("; ")]
    lines = [f"{path} {words}" for path, words in each]
    for line in lines:
        words = shlex.split(line)
        path = next(p for p in ALL if tuple(words[: len(p)]) == p)
        ALL[path].make_context("dualarm", words[len(path) :])


def test_every_command_is_in_one_group(capsys: pytest.CaptureFixture[str]) -> None:
    """The help without a command shows them, also where nothing is given; it is no error to read."""
    assert [name for names in GROUPS.values() for name in names] == list(COMMANDS)
    assert run(["--help"]) == 0
    helped = capsys.readouterr().out
    assert all(f"\n{group}:\n" in helped for group in GROUPS)
    assert run([]) == 2
    bare = capsys.readouterr().err
    assert bare.strip() == helped.strip()


def test_values_of_methods_are_those_of_their_registries() -> None:
    """They are written down, so that a help loads no library of theirs."""
    names = {family.family: list(family.names) for family in families()}
    for family, text in SOLVERS.items():
        assert re.split(r", |\|", text) == names[family]
