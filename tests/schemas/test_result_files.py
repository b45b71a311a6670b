"""The schemas of schedule.json and report.json: files of real plans are valid, changed ones are not."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from dualarm_cli.cli.run import run
from dualarm_cli.schemas import schema_of

JOBS = ("01_first_pick", "15_conveyor", "12_chute")
MORE = (
    "02_two_trays",
    "10_seam",
    "11_any_order",
    "13_hand_over",
    "14_two_grippers",
    "papers/choi_circles",
)


def results(folder: Path) -> dict[str, Any]:
    """Reads the files of a plan."""
    kinds = ("schedule", "report")
    return {kind: json.loads((folder / f"{kind}.json").read_text()) for kind in kinds}


def wrong(kind: str, data: Any) -> list[str]:
    """Returns what a schema finds wrong."""
    found = Draft202012Validator(schema_of(kind)).iter_errors(data)
    return [f"{error.json_path}: {error.message}" for error in found]


@pytest.mark.parametrize("job", [*JOBS, *(pytest.param(j, marks=pytest.mark.slow) for j in MORE)])
def test_files_of_a_plan_are_valid(job: str, planned_files: Callable[[str], Path]) -> None:
    for kind, data in results(planned_files(job)).items():
        assert wrong(kind, data) == []


def test_a_budget_is_valid_and_changed_files_are_not(tasks_folder: Path, tmp_path: Path) -> None:
    """One change each: a member that there is not, one of another type, one that is missing."""
    job = tasks_folder / "01_first_pick"
    (tmp_path / "cell.yaml").write_text((job / "cell.yaml").read_text())
    text = (job / "tasks.yaml").read_text()
    budget = "budget: {cycle_time: 1 min, clearance: 1 mm}\n"
    (tmp_path / "tasks.yaml").write_text(text.replace("\ntasks:", f"\n{budget}tasks:"))
    out = tmp_path / "out"
    plan = ["plan", str(tmp_path / "tasks.yaml"), "--effort", "quick", "--out", str(out)]
    assert run([*plan, "--quiet"]) in (0, 1)
    files = results(out)
    assert len(files["report"]["budget"]) == 2
    for kind, data in files.items():
        assert wrong(kind, data) == []
    changes: list[tuple[str, Any]] = [
        ("schedule", lambda d: d.pop("motion")),
        ("schedule", lambda d: d["motion"]["left"].pop("velocity")),
        ("schedule", lambda d: d["robot"].pop("joints")),
        ("schedule", lambda d: d["events"][0].pop("xyz")),
        ("schedule", lambda d: d["events"][0].update(xyz=[0, 0])),
        ("schedule", lambda d: d.update(format="dualarm.schedule/1")),
        ("schedule", lambda d: d["stages"][0].update(start="0")),
        ("schedule", lambda d: d.update(colour="red")),
        ("report", lambda d: d.update(cycle_time="fast")),
        ("report", lambda d: d["stages"][0].update(tasks="a")),
        ("report", lambda d: d["arms"]["left"].update(zzz=1)),
    ]
    for kind, change in changes:
        changed = copy.deepcopy(files[kind])
        change(changed)
        assert len(wrong(kind, changed)) == 1
