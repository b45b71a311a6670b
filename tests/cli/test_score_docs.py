"""What users copy: the workflow, the hooks, the page that shows them."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer
import yaml

from dualarm_cli.cli.run import command_line
from dualarm_cli.scoring.verdict import STATES

ROOT = Path(__file__).parents[2]
WORKFLOW = ROOT / "docs" / "score-workflow.yaml"
PAGE = ROOT / "docs" / "how-to" / "ci.md"
HOOKS = ROOT / ".pre-commit-hooks.yaml"


def options(words):
    """Parses the words after `dualarm score` as the command line would, and runs nothing."""
    command = typer.main.get_command(command_line()).commands["score"]
    return command.make_context("score", list(words)).params


def test_the_workflow_is_valid_by_githubs_schema(tmp_path):
    """The schema comes with the tool; a workflow with a misspelt key is not valid by it."""
    tool = [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.github-workflows"]
    subprocess.run([*tool, str(WORKFLOW)], check=True, capture_output=True)
    broken = tmp_path / "broken.yaml"
    broken.write_text(WORKFLOW.read_text().replace("runs-on:", "run-on:"))
    assert subprocess.run([*tool, str(broken)], check=False, capture_output=True).returncode == 1


def test_the_workflow_has_what_matters():
    """No right to write, an end to its time, the cache kept also where the gate is closed, a command that is one."""
    document = yaml.safe_load(WORKFLOW.read_text())
    assert document["permissions"] == {"contents": "read"}
    job = document["jobs"]["score"]
    assert job["timeout-minutes"] <= 60
    steps = job["steps"]
    commands = [
        shlex.split(step["run"]) for step in steps if "dualarm score" in step.get("run", "")
    ]
    assert len(commands) == 1
    given = options(commands[0][2:])
    assert given["github"]
    assert given["baseline"] == Path("scores.json")
    assert given["timeout"] == "10 min"
    saved = [step for step in steps if step.get("uses", "").startswith("actions/cache/save@")]
    assert saved[0]["if"] == "always()"
    # Out of the checkout: a commit must not bring answers.
    assert str(given["cache"]) == saved[0]["with"]["path"] == "~/.cache/dualarm"
    for step in steps:
        assert re.fullmatch(r"actions/[a-z/-]+@v[0-9]+", step.get("uses", "actions/x@v1"))


def test_the_page_shows_the_workflow_as_it_is_and_every_verdict():
    """What is shown is what there is."""
    page = PAGE.read_text()
    assert f"```yaml\n{WORKFLOW.read_text()}```" in page
    for state in STATES:
        assert f"`{state.replace('_', ' ')}`" in page


def test_hooks_name_commands_that_there_are_and_files_that_matter():
    """Keys that pre-commit asks for; the score takes no file names, the check takes those of our files."""
    hooks = {hook["id"]: hook for hook in yaml.safe_load(HOOKS.read_text())}
    assert set(hooks) == {"dualarm-check", "dualarm-score"}
    for hook in hooks.values():
        assert {"id", "name", "entry", "language", "files"} <= set(hook)
        assert hook["language"] == "python"
        assert hook["entry"].split()[1] in typer.main.get_command(command_line()).commands
    check, score = hooks["dualarm-check"], hooks["dualarm-score"]
    for name in ("cells/a/tasks.yaml", "cell.yml", "robots/x/robot.yaml", "cells/a/study.yaml"):
        assert re.search(check["files"], name)
    for name in (".github/workflows/score.yaml", "mytasks.yaml"):
        assert not re.search(check["files"], name)
    assert score["pass_filenames"] is False
    assert options(score["args"])["baseline"] == Path("scores.json")
    assert re.search(score["files"], "robots/x/robot.urdf")


@pytest.mark.parametrize("path", [WORKFLOW, HOOKS, PAGE])
def test_nothing_names_this_machine_or_a_registry(path):
    """Files that other people copy."""
    text = path.read_text()
    for word in ("/work/", "/home/", "/tmp/", "pypi.org", "ghcr.io", "docker.io"):
        assert word not in text
