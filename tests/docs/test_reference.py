"""The reference is what the code says, and tells every member of the files that plans write."""

from __future__ import annotations

import importlib.util
import json
import re
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
from pydantic import ValidationError

from dualarm_cli.cli.parts.completion import families
from dualarm_cli.cli.run import command_line, run
from dualarm_cli.explanations import explanations
from dualarm_cli.files.cells.schema_cell import ObstacleSection
from dualarm_cli.files.tasks.schema_tasks import DefaultsSection, TargetSection, TasksFile
from dualarm_cli.model.budget import Kept
from dualarm_cli.schemas import result_fields
from dualarm_cli.verification.measuring.criteria import judge, not_checked

TABLES: dict[str, Any] = {"SCHEDULE": result_fields.SCHEDULE, "REPORT": result_fields.REPORT}
DOCS = Path(__file__).parents[2] / "docs"
JOBS = ("01_first_pick", "14_two_grippers", "15_conveyor")
MORE = (
    "02_two_trays",
    "10_seam",
    "11_any_order",
    "12_chute",
    "13_hand_over",
    "papers/choi_circles",
)
GRIPPING_CELL = """\
dualarm: cell/1
robot: sda10f
tools: {left: {tcp: {xyz: [0, 0, 120 mm]}}, right: {tcp: {xyz: [0, 0, 120 mm]}}}
parts: {cup: {shapes: [{sphere: {radius: 10 mm}}], grasps: {top: {width: 20 mm}}}}
"""
GRIPPING = """\
dualarm: tasks/1
cell: cell.yaml
defaults: {dwell: {gripper: [80 ms, 120 ms, 200 ms]}, signals: {grip: vacuum on, release: vacuum off}}
tasks:
  - id: cup
    arm: left
    part: cup
    pick: {xyz: [0.45, 0.20, 0.80], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.25, 0.55, 0.80], rpy: [180 deg, 0, 0]}
"""


def module(name: str) -> ModuleType:
    """Returns a script of the docs as a module."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    found = importlib.util.module_from_spec(spec)
    sys.modules[name] = found
    spec.loader.exec_module(found)
    return found


@pytest.fixture(scope="module")
def pages() -> dict[str, str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(DOCS))
        found: dict[str, str] = module("generate_reference").pages()
    return found


def test_the_committed_pages_are_what_the_code_says(pages: dict[str, str]) -> None:
    """`python docs/generate_reference.py` writes them."""
    folder = DOCS / "reference"
    assert sorted(path.name for path in folder.glob("*")) == sorted(pages)
    for name, text in pages.items():
        assert (folder / name).read_text(encoding="utf-8") == text, name


def test_every_command_option_method_and_code_is_in_a_page(pages: dict[str, str]) -> None:
    """Read from typer, the registries and the table of codes, and not by way of the script."""
    commands = pages["commands.md"]
    root = typer.main.get_command(command_line())
    todo = [("dualarm", root)]
    while todo:
        path, command = todo.pop()
        inner: dict[str, Any] = getattr(command, "commands", {})
        todo += [(f"{path} {name}", one) for name, one in inner.items()]
        if not inner:
            _, section = commands.split(f"## `{path}`\n", 1)
            section = section.split("\n## ", 1)[0]
            for option in (o for p in command.params for o in p.opts if o.startswith("--")):
                assert f"`{option}`" in section or option == "--help", (path, option)
    for family in families():
        for solver in family:
            assert f"| `{solver.name}` |" in pages["solvers.md"]
    for code in explanations():
        assert f"## {code}\n" in pages["errors.md"]


def test_defaults_and_choices_that_help_prints_are_in_the_page(
    pages: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Compared with the printed help of each command."""
    found = 0
    for section in pages["commands.md"].split("\n## `dualarm ")[1:]:
        name = section.partition("`")[0]
        rows = {row.split("`")[1]: row for row in section.splitlines() if row.startswith("| `--")}
        assert run([*name.split(), "--help"]) == 0
        printed = capsys.readouterr().out.split("\nOptions:\n")[1]
        for entry in re.split(r"^  (?:-\w, )?(?=--\w)", printed, flags=re.MULTILINE)[1:]:
            text = " ".join(entry.split())
            option = re.split(r"[ /]", text)[0]
            if option == "--help":
                continue
            names = [] if "(solvers.md)" in rows[option] else [r"^\S+ ([a-z0-9]+(?:\|[a-z0-9]+)+) "]
            for choices in (match for name in names for match in re.findall(name, text)):
                assert all(f"`{one}`" in rows[option] for one in choices.split("|")), text
                found += 1
            for default in re.findall(r"\[default: ([^\]]+)\]", text):
                assert default in rows[option], text
                found += 1
    assert found > 35


@pytest.mark.parametrize(
    ("page", "section", "key", "takes", "good", "bad"),
    [
        (
            "tasks.md",
            "defaults",
            "dwell",
            "time, at least 0, or list of 3, or mapping",
            "0.2 s",
            "0.2 mm",
        ),
        (
            "tasks.md",
            "defaults",
            "approach",
            "length, at least 0; at most 5 without a unit, or mapping",
            5,
            5.1,
        ),
        ("tasks.md", "The file", "speed", "fraction, at least 0.001, at most 1", "100%", "101%"),
        ("tasks.md", "tasks[].pick", "symmetry", "whole number, at least 1, at most 360", 360, 361),
        ("cell.md", "obstacles.<name>", "sphere", "length, above 0, or mapping", "1 mm", "0 mm"),
        ("cell.md", "obstacles.<name>", "box", "list of 3 × length, above 0", [1, 1, 1], [1, 1]),
        ("cell.md", "obstacles.<name>", "half_space", "true", True, False),
    ],
)
def test_what_a_page_says_of_a_value_is_what_is_read(
    pages: dict[str, str], page: str, section: str, key: str, takes: str, good: Any, bad: Any
) -> None:
    """A value at the border of the range is read, one beyond it is not."""
    schemas = {
        "defaults": DefaultsSection,
        "The file": TasksFile,
        "tasks[].pick": TargetSection,
        "obstacles.<name>": ObstacleSection,
    }
    rest = {
        "The file": {"dualarm": "tasks/1", "cell": "c", "tasks": [{"id": "a"}]},
        "tasks[].pick": {"xyz": [0, 0, 0]},
    }
    text = re.split(rf"\n## `?{re.escape(section)}`?\n", pages[page])[1]
    row = next(line for line in text.splitlines() if line.startswith(f"| `{key}` |"))
    assert re.sub(r"\[([^\]]+)\]\([^)]*\)|`", r"\1", row.split(" | ")[1]) == takes
    schemas[section].model_validate({**rest.get(section, {}), key: good})
    with pytest.raises(ValidationError):
        schemas[section].model_validate({**rest.get(section, {}), key: bad})


def test_no_key_is_without_a_meaning(pages: dict[str, str]) -> None:
    for name in ("tasks.md", "cell.md", "robot.md", "study.md", "points.md", "base.md"):
        rows = re.findall(r"^\| `[^`]+` \|.*\|$", pages[name], re.MULTILINE)
        assert len(rows) > 2
        assert not [row for row in rows if row.endswith("|  |")], name


def test_links_between_pages_and_headings_resolve(pages: dict[str, str]) -> None:
    for name, text in pages.items():
        for target in re.findall(r"\]\(([^)#]*)(?:#[^)]*)?\)", text):
            assert not target or (DOCS / "reference" / target).exists(), (name, target)
        headings = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        anchors = {
            "".join(c for c in h.lower() if c.isalnum() or c in " -_").replace(" ", "-")
            for h in headings
        }
        for anchor in re.findall(r"\]\(#([^)]*)\)", text):
            assert anchor in anchors, (name, anchor)


def leaves(value: Any, path: str, joints: set[str], found: set[str]) -> None:
    """Collects the members of a document; names that are keys become <…>, entries of lists []."""
    if isinstance(value, dict):
        for key, inner in value.items():
            name = key
            if path in ("provenance.inputs", "files", "buffers"):
                name = "<name>"
            elif path in ("motion", "robot.groups"):
                name = "<group>"
            elif key in joints or path == "bottlenecks":
                name = "<joint>"
            elif key in ("left", "right"):
                name = "<arm>"
            leaves(inner, f"{path}.{name}" if path else name, joints, found)
    elif isinstance(value, list) and any(isinstance(entry, dict) for entry in value):
        for entry in value:
            leaves(entry, f"{path}[]", joints, found)
    else:
        found.add(path)


def members(out: Path) -> dict[str, set[str]]:
    """Returns the members of a plan's files; empty containers and nothing count as themselves."""
    schedule = json.loads((out / "schedule.json").read_text())
    joints = set(schedule["robot"]["joints"])
    report = json.loads((out / "report.json").read_text())
    found: dict[str, set[str]] = {"SCHEDULE": set(), "REPORT": set()}
    leaves(schedule, "", joints, found["SCHEDULE"])
    leaves(report, "", joints, found["REPORT"])
    return found


def unknown(found: set[str], table: dict[str, Any]) -> list[str]:
    """Returns members that the table does not tell, neither themselves nor as what holds others."""
    return [
        name
        for name in sorted(found)
        if name not in table and not any(key.startswith((f"{name}.", f"{name}[]")) for key in table)
    ]


@pytest.mark.parametrize("job", JOBS)
def test_every_member_of_a_plans_files_is_told(
    job: str, planned_files: Callable[[str], Path]
) -> None:
    for table, found in members(planned_files(job)).items():
        assert unknown(found, TABLES[table]) == []


@pytest.mark.parametrize("job", JOBS)
def test_every_check_of_a_plan_is_told(
    job: str, planned_files: Callable[[str], Path], pages: dict[str, str]
) -> None:
    """With a measure and a unit."""
    report = json.loads((planned_files(job) / "report.json").read_text())
    for check in report["verification"]["checks"]:
        [row] = re.findall(
            rf"^\| `{check['name']}` \| (.+) \| .+ \| (.*) \|$", pages["checks.md"], re.M
        )
        assert check["verdict"] != "not checked" or row[1], check


def test_a_check_without_a_criterion_is_refused() -> None:
    """Neither judged nor left out without a row in the page."""
    with pytest.raises(KeyError):
        judge("spin", 1.0, 2.0, "here")
    with pytest.raises(KeyError):
        not_checked("spin", "nothing spins")


@pytest.mark.slow
def test_every_member_that_is_told_is_in_some_file(
    planned_files: Callable[[str], Path], tmp_path: Path
) -> None:
    """Over jobs of all kinds of work, and one with grasps, signals and dwells that vary."""
    seen: dict[str, set[str]] = {"SCHEDULE": set(), "REPORT": set()}
    (tmp_path / "cell.yaml").write_text(GRIPPING_CELL)
    (tmp_path / "tasks.yaml").write_text(GRIPPING)
    gripped = tmp_path / "plan"
    plan = ["plan", str(tmp_path / "tasks.yaml"), "--effort", "quick", "--no-page", "-q"]
    assert run([*plan, "--out", str(gripped)]) == 0
    for out in (gripped, *map(planned_files, (*JOBS, *MORE))):
        for table, found in members(out).items():
            assert unknown(found, TABLES[table]) == []
            seen[table] |= found
    seen["REPORT"] |= {f"budget[].{name}" for name in (*(f.name for f in fields(Kept)), "text")}
    for table, found in seen.items():
        # A list of numbers is a leaf.
        assert sorted({name.removesuffix("[]") for name in TABLES[table]} - found) == []
