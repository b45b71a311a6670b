"""`dualarm platform`: the paper's table as a user sees it, and the figure."""

from __future__ import annotations

import hashlib
import json
import re

import pytest

from dualarm_cli.cli.run import run

# [Bottin2021] Table 2 with our own sign of the second displacement (the paper mirrors it).
TABLE_2 = [
    ["-113.63", "59.14", "58.17", "-0.97"],
    ["-40.43", "4.62", "-5.24", "0.62"],
    ["-26.57", "-6.87", "-7.61", "0.74"],
    ["39.49", "-45.01", "33.88", "-11.13"],
    ["-70.10", "28.95", "12.75", "-16.20"],
    ["109.90", "0.65", "–", "–"],
    ["179.53", "54.40", "–", "–"],
    ["-0.47", "-27.55", "0.40", "-27.15"],
]


def linearised_rows(text):
    """The printed cells: turn, both displacements, difference."""
    rows = [re.split(r"\s*[│┃]\s*", line) for line in text.splitlines() if "linearised" in line]
    return [[row[4], row[6], row[7], row[8]] for row in rows]


@pytest.mark.parametrize("source", ["options", "task file"])
def test_the_papers_input_prints_the_papers_table(source, capsys, tasks_folder):
    """All eight rows to the printed digit, from the defaults and from the shipped task file."""
    arguments = (
        [str(tasks_folder / "03_bottin_planar" / "tasks.yaml")] if source != "options" else []
    )
    assert run(["platform", *arguments]) == 0
    assert linearised_rows(capsys.readouterr().out) == TABLE_2


def test_a_stage_of_a_real_robot(capsys, tasks_folder):
    """The packing job's third stage on the SDA10F: exact elbows move equally."""
    task = str(tasks_folder / "04_packing" / "tasks.yaml")
    assert run(["platform", task, "--stage", "3", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    roots = [c for c in document["candidates"] if c["method"] == "exact" and "root" in c["kind"]]
    assert roots
    for root in roots:
        assert abs(root["difference"]) < 1e-9


@pytest.mark.parametrize("stage", ["0", "25", "99"])
def test_a_stage_that_is_not_there(stage, capsys, tasks_folder):
    """The error says which there are."""
    task = str(tasks_folder / "04_packing" / "tasks.yaml")
    assert run(["platform", task, "--stage", stage]) == 2
    assert "the tasks have stages 1 to 24" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_the_figure_is_the_same_every_time(kind, tmp_path, capsys):
    """Two runs, the same bytes; and something is on it."""
    digests = []
    for k in range(2):
        file = tmp_path / f"figure{k}.{kind}"
        assert run(["platform", "--plot", str(file)]) == 0
        digests.append(hashlib.sha256(file.read_bytes()).hexdigest())
        assert file.stat().st_size > 10_000
    assert digests[0] == digests[1]


def test_robots_without_a_platform_are_refused(capsys, tasks_folder):
    """Two robots with bases of their own have no angle to choose."""
    task = str(tasks_folder / "05_two_robots" / "tasks.yaml")
    assert run(["platform", task]) == 2
    assert "no angle to choose" in capsys.readouterr().err


def test_options_that_would_be_void_are_refused(capsys, tasks_folder):
    """A planar robot's length beside a task file, a stage without one."""
    task = str(tasks_folder / "03_bottin_planar" / "tasks.yaml")
    assert run(["platform", task, "--radius", "60 mm"]) == 2
    assert "--radius describes a planar robot" in capsys.readouterr().err
    assert run(["platform", "--stage", "2"]) == 2
    assert "only a task file has stages" in capsys.readouterr().err
