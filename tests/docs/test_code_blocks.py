"""README and docs: every code block runs, every output is printed, every figure is drawn, every link leads somewhere.

A comment above a block says how it is checked; several are separated by semicolons:

- `<!-- file: NAME -->`: the block is written to NAME. Later blocks of the page may use it.
- `<!-- in: NAME -->`: the block is a fragment. Its keys replace those of the file NAME; a list replaces `tasks`.
- `<!-- exit: N -->`: the commands, or `dualarm check` of a file, end with exit code N.
- `<!-- slow -->`: the commands, and the output below them, are checked with `-m slow` only.

Blocks of a page run in order in one folder that holds `tasks/`. In an output (`text`) `…` stands for anything, and
numbers are about those that are printed; a block without a language is a drawing.
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
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import pytest
import typer
import yaml
from jsonschema import Draft202012Validator

from dualarm_cli.cli.run import command_line, run
from dualarm_cli.files.source.text_source import read_text
from dualarm_cli.files.source.yaml_source import parse_yaml
from dualarm_cli.schemas import schema_of

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    [
        ROOT / "README.md",
        *(page for page in (ROOT / "docs").rglob("*.md") if "_build" not in page.parts),
    ]
)
BLOCK = re.compile(
    r"(?:^ *<!-- (?P<note>[^\n]*) -->\n)?^(?P<indent> *)```(?P<language>[^\n]*)\n(?P<text>.*?)^ *```$",
    re.MULTILINE | re.DOTALL,
)
SET_UP = ("python3", ".venv/", "PYTHONPATH=. .venv/", "pip ", "dask ", "sphinx-build ", "export ")
SHELL = re.compile(r"[|<>;&$*`]")
"""What only a shell understands; a glob in quotes as well, which the shell hands over as it is."""
PLACEHOLDER = re.compile(r"(?<![\w-])[A-Z]{2,}(?:\.\w+)?\b")
NUMBER = re.compile(r"\d+(?:\.\d+)?")
NEAR, ROUNDED, COUNTS = 0.05, 0.02, 100
"""How far a number that is printed may be from the one in the docs: a share, and in decimals so much more. Machines
round differently, and a search may then end elsewhere. Whole numbers below the last one are counts, and exact."""
FIGURES = {
    "any_order.png": ("dualarm plan tasks/11_any_order/tasks.yaml", "order.png"),
    "circles.png": ("dualarm plan tasks/papers/choi_circles/tasks.yaml", "circles_paths.png"),
    "curves.png": ("dualarm curve tasks/papers/qin_curves/tasks.yaml", "curves.png"),
    "gantt.png": ("dualarm plan tasks/04_packing/tasks.yaml", "gantt.png"),
    "platform.png": ("dualarm platform", "platform.png"),
    "reach.png": ("dualarm robot reach tasks/04_packing/cell.yaml", "reach.png"),
    "seam.png": ("dualarm plan tasks/10_seam/tasks.yaml", "seam_seams.png"),
    "study_pareto.png": ("dualarm sweep tasks/04_packing/study.yaml", "packing-study/pareto.png"),
    "study_sensitivity.png": (
        "dualarm sweep tasks/04_packing/study.yaml",
        "packing-study/sensitivity.png",
    ),
    "tool_changes.png": ("dualarm plan tasks/14_two_grippers/tasks.yaml", "changes.png"),
}
"""Figures of the docs: the command that draws each one, and the file that it writes."""


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
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("COLUMNS", "200")
        with redirect_stdout(printed), redirect_stderr(printed):
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


def check_output(block: Block, printed: str) -> None:
    """Every line of an output block is in what the commands have printed, numbers as near as `NEAR` says."""
    real = [" ".join(line.split()) for line in printed.splitlines()]
    for line in block.text.splitlines():
        assert any(is_printed(" ".join(line.split()), one) for one in real), (
            f"not printed: {line}\n{printed}"
        )


def is_printed(shown: str, line: str) -> bool:
    """Whether a line of the docs is a printed one, or part of it."""
    parts = shown.split("…")
    if re.search(".*".join(map(re.escape, parts)), line):
        return True
    texts = [map(re.escape, NUMBER.split(part)) for part in parts]
    found = re.search(".*".join(f"({NUMBER.pattern})".join(text) for text in texts), line)
    return found is not None and all(map(is_near, found.groups(), NUMBER.findall(shown)))


def is_near(printed: str, shown: str) -> bool:
    """Whether a number is the one in the docs; small whole numbers are counts."""
    one, other = float(printed), float(shown)
    if "." not in shown and other < COUNTS:
        return one == other
    return abs(one - other) <= NEAR * other + ("." in shown) * ROUNDED


def check_figures(folder: Path) -> None:
    """A figure that a command has drawn is as large as the one in the docs."""
    for figure, (_, file) in FIGURES.items():
        if (folder / file).exists():
            drawn, kept = (
                path.read_bytes()[16:24] for path in (folder / file, ROOT / "docs" / figure)
            )
            assert drawn == kept, f"{figure} is not what its command draws"


def check_page(page: Path, folder: Path, *, slow: bool) -> None:
    """Checks the blocks of a page one after the other."""
    shutil.copytree(ROOT / "tasks", folder / "tasks")
    printed: str | None = ""
    for block in blocks(page):
        if block.language == "sh":
            left_out = "slow" in block.notes and not slow
            printed = None if left_out else (printed or "") + run_shell(block, folder)
        elif block.language == "yaml":
            check_yaml(block, folder)
        elif block.language == "python":
            (folder / "block.py").write_text(block.text)
            script = Block("sh", f"{shlex.quote(sys.executable)} block.py", block.notes)
            printed = (printed or "") + run_shell(script, folder)
        elif block.language == "text" and printed is not None:
            check_output(block, printed)
        else:
            # Excerpts of modules (py) are pieces that do not stand alone.
            assert block.language in ("text", "", "py"), (
                f"a block in {block.language!r} is not checked"
            )
    check_figures(folder)


@pytest.mark.full_effort
@pytest.mark.parametrize("page", PAGES, ids=named)
def test_blocks_of_a_page(page, tmp_path):
    """Commands run, files are valid, outputs are real."""
    check_page(page, tmp_path, slow=False)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if any("slow" in one.notes for one in blocks(page))],
    ids=named,
)
def test_blocks_of_a_page_that_take_long(page, tmp_path):
    """The same with the commands that take more than some seconds."""
    check_page(page, tmp_path, slow=True)


def test_every_figure_is_drawn_by_a_command_of_a_page():
    """Each PNG of the docs has its command in the table, and a page shows that command."""
    assert {figure.name for figure in (ROOT / "docs").glob("*.png")} == set(FIGURES)
    commands = "\n".join(
        block.text for page in PAGES for block in blocks(page) if block.language == "sh"
    )
    for command, file in FIGURES.values():
        asked = re.sub("_(paths|seams)", "", file.split("/")[0])
        option = rf"--(?:plot|out) {re.escape(asked)}"
        assert re.search(rf"^{re.escape(command)}\b.*{option}", commands, re.MULTILINE), file


def test_commands_do_not_get_into_each_others_way():
    """Somebody who runs all commands in one folder meets no result of an earlier page."""
    folders: list[str] = []
    for page in PAGES:
        for block in blocks(page):
            for line in block.text.splitlines() if block.language == "sh" else ():
                if line.startswith("dualarm plan tasks/"):
                    assert "--out " in line, f"{named(page)}: {line}"
                    folders += re.findall(r"--out (\S+)", line)
    assert len(folders) == len(set(folders)), folders


def anchors(page: Path) -> set[str]:
    """Returns the anchors of a page's headings as GitHub and MyST make them."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    titles = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=named)
def test_links_of_a_page_lead_somewhere(page):
    """Files exist, and so do the headings that anchors name."""
    text = BLOCK.sub("", page.read_text(encoding="utf-8"))
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", link):
            continue
        target, _, anchor = link.partition("#")
        path = (page.parent / target).resolve() if target else page
        assert path.exists(), link
        if anchor:
            assert anchor in anchors(path), link


def test_the_readme_is_one_page_and_names_every_page():
    """At most 150 lines; each how-to page is in its table."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(readme.splitlines()) <= 150
    for page in (ROOT / "docs" / "how-to").glob("*.md"):
        assert f"(docs/how-to/{page.name})" in readme, page.name


def test_the_set_up_commands_are_those_that_ci_runs():
    """One line installs and plans, the other one installs and tests."""
    commands = re.findall(r"^python3 -m venv .*$", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert len(commands) == 2
    plan, test = commands
    assert (
        ".venv/bin/pip install -q . && .venv/bin/dualarm plan tasks/04_packing/tasks.yaml" in plan
    )
    assert test.endswith(".venv/bin/python -m pytest -n 2")
