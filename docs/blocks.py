"""Code blocks of README and docs: they are run, and what they print is compared with the blocks below them.

A comment above a block says how it is checked; several are separated by semicolons:

- `<!-- file: NAME -->`: the block is written to NAME. Later blocks of the page may use it.
- `<!-- in: NAME -->`: the block is a fragment. Its keys replace those of the file NAME; a list replaces `tasks`.
- `<!-- exit: N -->`: the commands, or `dualarm check` of a file, end with exit code N.
- `<!-- slow -->`: the commands take more than some seconds, and are run on request only.

Blocks of a page run in order in one folder that holds `tasks/`. In an output (`text`) `…` stands for anything, and
numbers are those that are printed. A block without a language is a drawing.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Sequence
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from unittest.mock import patch

import typer
import yaml
from jsonschema import Draft202012Validator

from dualarm_cli.cli.run import command_line, run
from dualarm_cli.files.source.text_source import read_text
from dualarm_cli.files.source.yaml_source import parse_yaml
from dualarm_cli.records import dataclass
from dualarm_cli.schemas import schema_of

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    [
        ROOT / "README.md",
        *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
    ]
)
"""README and every page."""
BLOCK = re.compile(
    r"(?:^ *<!-- (?P<note>[^\n]*) -->\n)?^(?P<indent> *)```(?P<language>[^\n]*)\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
SET_UP = ("python3", ".venv/", "PYTHONPATH=. .venv/", "pip ", "dask ", "sphinx-build ", "export ")
SHELL = re.compile(r"[|<>;&$*`]")
"""What only a shell understands; a glob in quotes as well, which the shell hands over as it is."""
PLACEHOLDER = re.compile(r"(?<![\w-])[A-Z]{2,}(?:\.\w+)?\b")
NUMBER = re.compile(r"\d+(?:\.\d+)?")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: language, text, and what the comment above it says."""

    language: str
    text: str
    notes: dict[str, str]


def blocks(page: Path) -> list[Block]:
    """Returns the fenced blocks of a page, without Sphinx's directives."""
    found = []
    for match in BLOCK.finditer(page.read_text(encoding="utf-8")):
        indent = match["indent"]
        text = re.sub(rf"^{indent}", "", match["text"], flags=re.MULTILINE)
        notes = [
            note.partition(":")[::2] for note in (match["note"] or "").split(";") if note.strip()
        ]
        kept = {key.strip(): value.strip() for key, value in notes}
        if not match["language"].startswith("{"):
            found.append(Block(match["language"], text, kept))
    return found


def named(page: Path) -> str:
    """Returns the path of a page below the root folder."""
    return page.relative_to(ROOT).as_posix()


def check_set_up(line: str) -> None:
    """Extras and folders that a set-up command names exist."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    for group in re.findall(r"(?:\.|dualarm)\[([\w,]+)\]", line):
        assert set(group.split(",")) <= set(extras), line
    for path in re.findall(r"\btests/\S+|\btasks/\S+", line):
        assert (ROOT / path).exists(), line


def check_usage(line: str) -> None:
    """A command with placeholders is one that the command line can parse."""
    words = shlex.split(line.replace("…", ""), comments=True)[1:]
    command = typer.main.get_command(command_line())
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    command.make_context("dualarm", words)


def run_commands(lines: list[str], folder: Path) -> tuple[int, str]:
    """Runs `dualarm` commands in this process up to one that fails; returns exit code and output."""
    code, printed = 0, io.StringIO()
    with (
        chdir(folder),
        patch.dict(os.environ, {"COLUMNS": "200"}),
        redirect_stdout(printed),
        redirect_stderr(printed),
    ):
        for line in lines:
            code = code or run(shlex.split(line, comments=True)[1:])
    return code, printed.getvalue()


def run_bash(lines: list[str], folder: Path) -> tuple[int, str]:
    """Runs lines with bash up to one that fails; returns exit code and output."""
    tools = folder / ".bin"
    tools.mkdir(exist_ok=True)
    (tools / "dualarm").write_text(f'#!/bin/sh\nexec {sys.executable} -m dualarm_cli "$@"\n')
    (tools / "dualarm").chmod(0o755)
    environment = os.environ | {
        "PATH": f"{tools}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "COLUMNS": "200",
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_NUM_THREADS": "1",
    }
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join(lines)],
        cwd=folder,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    return done.returncode, done.stdout


def run_shell(block: Block, folder: Path) -> str:
    """Runs the commands of a block in a folder; returns what they print."""
    lines = []
    for line in block.text.replace("\\\n", " ").splitlines():
        if line.startswith(SET_UP):
            check_set_up(line)
        elif line.startswith("dualarm") and PLACEHOLDER.search(line.split(" #")[0]):
            check_usage(line)
        else:
            lines.append(line)
    plain = all(line.startswith("dualarm ") and not SHELL.search(line) for line in lines)
    code, printed = (run_commands if plain else run_bash)(lines, folder)
    assert code == int(block.notes.get("exit", 0)), f"{block.text}\n{printed}"
    for figure in re.findall(r"--plot (\S+)", "\n".join(lines)):
        assert (folder / figure).stat().st_size > 0
    return printed


def check_yaml(block: Block, folder: Path) -> None:
    """A whole file, or a fragment in the file that it belongs to, is accepted by `dualarm check`."""
    document = yaml.safe_load(block.text)
    if "repos" in document:
        hooks = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
        used = {hook["id"] for repo in document["repos"] for hook in repo["hooks"]}
        assert used <= {hook["id"] for hook in hooks}
        return
    if "jobs" in document:
        assert block.text == (ROOT / "docs" / "score-workflow.yaml").read_text()
        return
    if "in" in block.notes:
        path = folder / block.notes["in"]
        change = document if isinstance(document, dict) else {"tasks": document}
        text = yaml.safe_dump(yaml.safe_load(path.read_text()) | change, sort_keys=False)
        path = path.with_name("fragment.yaml")
    else:
        assert "file" in block.notes, f"no comment says which file this is:\n{block.text}"
        path, text = folder / block.notes["file"], block.text
        path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    content = parse_yaml(read_text(path, path.name)).data
    kind = content["dualarm"].partition("/")[0]
    assert [e.message for e in Draft202012Validator(schema_of(kind)).iter_errors(content)] == []
    ends = {name: value for name, value in block.notes.items() if name == "exit"}
    run_shell(Block("sh", f"dualarm check {path.relative_to(folder)}", ends), folder)


def corrected(block: Block, printed: str) -> str:
    """Returns an output block with the numbers that the commands have printed.

    Raises:
        AssertionError: a line is not printed, whatever its numbers.
    """
    real = [" ".join(line.split()) for line in printed.splitlines()]
    return "".join(f"{_corrected_line(line, real)}\n" for line in block.text.splitlines())


def _corrected_line(line: str, real: list[str]) -> str:
    """Returns a line of an output block with the numbers of the printed line that is most like it."""
    shown = " ".join(line.split())
    if any(re.search(_pattern(shown, re.escape), text) for text in real):
        return line
    matches = (re.search(_pattern(shown, _any_number), text) for text in real)
    found = [match.groups() for match in matches if match is not None]
    assert found, f"not printed: {line}\n" + "\n".join(real)
    before = NUMBER.findall(line)
    numbers = iter(min(found, key=lambda new: _difference(before, new)))
    return NUMBER.sub(lambda _: next(numbers), line)


def _difference(before: Sequence[str], after: Sequence[str]) -> tuple[int, float]:
    """Returns how many numbers differ, and by how much in total."""
    pairs = [(float(a), float(b)) for a, b in zip(before, after, strict=True)]
    return sum(a != b for a, b in pairs), sum(abs(a - b) for a, b in pairs)


def _pattern(shown: str, literal: Callable[[str], str]) -> str:
    """Returns what a line of an output block matches: `…` anything, all else as `literal` has it."""
    text = ".*".join(map(literal, shown.split("…")))
    return rf"(?<![\d.]){text}(?!\d|\.\d)" if shown[-1:].isdigit() else rf"(?<![\d.]){text}"


def _any_number(text: str) -> str:
    return f"({NUMBER.pattern})".join(map(re.escape, NUMBER.split(text)))


def correct_page(page: Path, folder: Path, *, slow: bool) -> str:
    """Runs the blocks of a page one after the other; returns its text with the numbers that they print.

    Raises:
        AssertionError: a block does not end as its comment says, or prints something else.
    """
    shutil.copytree(ROOT / "tasks", folder / "tasks")
    text, printed = page.read_text(encoding="utf-8"), ""
    left_out = False
    for block in blocks(page):
        if block.language == "sh":
            left_out = "slow" in block.notes and not slow
            printed = "" if left_out else printed + run_shell(block, folder)
        elif block.language == "yaml":
            check_yaml(block, folder)
        elif block.language == "python":
            (folder / "block.py").write_text(block.text)
            script = Block("sh", f"{shlex.quote(sys.executable)} block.py", block.notes)
            printed += run_shell(script, folder)
        elif block.language == "text" and not left_out:
            text = text.replace(block.text, corrected(block, printed))
        else:
            # Excerpts of modules (py) are pieces that do not stand alone.
            assert block.language in ("text", "", "py"), f"{block.language!r} is not checked"
    return text
