"""Points as requests: what is replaced by what, and plans the same as of files that somebody edited."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.evaluation.evaluate import settings_of
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.files.studies.studies import load_study
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.schedule import Provenance
from dualarm_cli.model.studies.study import Study
from dualarm_cli.planning.planner import plan
from dualarm_cli.studies.requests import (
    check_settings,
    input_problems,
    point_requests,
    reference_requests,
)
from dualarm_cli.studies.search import study_points

STUDY = """\
dualarm: study/1
tasks: tasks.yaml
settings: {effort: quick, platform: exact}
parameters:
  target:
    tasks: tasks.P1.move.xyz[0]
    values: [80 mm, 90 mm]
  limits:
    targets: [robot: limits.torso.acceleration, {tasks: 'tasks.P2.move.xyz[1]', apply: shift}]
    apply: scale
    values: [50%, 100%]
"""


@pytest.fixture
def folder(tmp_path: Path, tasks_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with the planar robot and its job of two moves."""
    (tmp_path / "dualarm.toml").write_text("")
    for file in (tasks_folder / "03_bottin_planar").glob("*.yaml"):
        shutil.copy(file, tmp_path)
    robots = tasks_folder.parent / "robots" / "bottin_planar"
    for file in robots.iterdir():
        shutil.copy(file, tmp_path)
    cell = tmp_path / "cell.yaml"
    cell.write_text(cell.read_text().replace("bottin_planar", "robot.yaml"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _study(folder: Path, text: str) -> Study:
    (folder / "study.yaml").write_text(text)
    return load_study("study.yaml")


def _joint(folder: Path) -> str:
    """Returns the platform's joint, which the robot file limits."""
    return load_job(folder / "tasks.yaml").cell.robot.platform[0]


def _plan_bytes(path: Path, overrides: dict, settings) -> bytes:
    """Returns the schedule of a job as it is written, without the hashes of its files."""
    schedule = plan(load_job(path, overrides=overrides), settings)
    return b"".join(
        to_json(replace(schedule, provenance=Provenance("", {}, {}, 0)), "robot.urdf", {})
    )


def test_the_plan_is_that_of_edited_files_to_the_byte(folder: Path) -> None:
    """A target, and half of the 600 deg/s^2 that the robot file allows: replaced, and edited by hand."""
    joint = _joint(folder)
    text = STUDY.replace("limits.torso.", f"limits.{joint}.").replace(
        ", {tasks: 'tasks.P2.move.xyz[1]', apply: shift}", ""
    )
    study = _study(folder, text)
    point = study_points(study)[2]
    (request,) = point_requests(study, point)
    assert dict(request.overrides) == {
        "tasks:/tasks/0/move/xyz/0": "90.0 mm",
        f"robot:/limits/{joint}/acceleration": "300.0 deg/s^2",
    }
    plain = _plan_bytes(folder / "tasks.yaml", {}, settings_of(request))
    replaced = _plan_bytes(folder / "tasks.yaml", dict(request.overrides), settings_of(request))
    tasks, robot = folder / "tasks.yaml", folder / "robot.yaml"
    assert tasks.read_text().count("[80 mm, 10 mm, 0]") == 1
    tasks.write_text(tasks.read_text().replace("[80 mm, 10 mm, 0]", "[90 mm, 10 mm, 0]"))
    lines = robot.read_text().splitlines()
    (row,) = [
        k
        for k, line in enumerate(lines)
        if line.strip().startswith(f"{joint}:") and "acceleration" in line
    ]
    old = lines[row].partition("acceleration:")[2].split(",")[0]
    lines[row] = lines[row].replace(f"acceleration:{old}", "acceleration: 300 deg/s^2")
    robot.write_text("\n".join(lines) + "\n")
    edited = _plan_bytes(tasks, {}, settings_of(request))
    assert replaced == edited
    assert replaced != plain


def test_what_is_the_file_s_own_value_is_not_replaced(folder: Path) -> None:
    """So that the files as they are, and points that are no others, are planned once."""
    text = STUDY.replace("limits.torso.", f"limits.{_joint(folder)}.").replace(
        "apply: shift}", "apply: scale}"
    )
    study = _study(folder, text)
    points = study_points(study)
    assert point_requests(study, points[1]) == reference_requests(study)
    asked = [[r.as_document() for r in point_requests(study, point)] for point in points]
    assert len({json.dumps(documents) for documents in asked}) == 4


def test_words_and_truths_that_are_the_file_s_own_are_not_replaced(folder: Path) -> None:
    """As with numbers: `order: given` and `return: true` are what the file has; text is no truth."""
    text = (
        "dualarm: study/1\ntasks: tasks.yaml\nparameters:\n"
        "  order: {tasks: order, values: [given, optimise]}\n"
        "  close: {tasks: return, values: [true, false, 'true']}\n"
    )
    study = _study(folder, text)
    found = [
        dict(request.overrides) for p in study_points(study) for request in point_requests(study, p)
    ]
    closes = [{}, {"tasks:/return": False}, {"tasks:/return": "true"}]
    assert found == closes + [{"tasks:/order": "optimise"} | close for close in closes]


def test_shift_and_scale_start_from_the_file(folder: Path) -> None:
    """100 mm in the file: 10 mm more, or half of it."""
    text = "dualarm: study/1\ntasks: tasks.yaml\nparameters:\n"
    text += "  p: {tasks: 'tasks.P2.move.xyz[1]', apply: %s, values: [%s]}\n"
    for apply, value, result in (
        ("shift", "1 cm", "110.0 mm"),
        ("scale", "50%", "50.0 mm"),
        ("set", "7 cm", "7.0 cm"),
    ):
        study = _study(folder, text % (apply, value))
        (request,) = point_requests(study, study_points(study)[0])
        assert dict(request.overrides) == {"tasks:/tasks/1/move/xyz/1": result}


def test_bad_values_are_told_of_the_study_file(folder: Path) -> None:
    """With the parameter, the path and what is allowed."""
    joint = _joint(folder)
    study = _study(
        folder,
        f"dualarm: study/1\ntasks: tasks.yaml\nparameters:\n  pull:\n    robot: limits.{joint}.acceleration\n"
        "    values: [1, 0]\n",
    )
    good, bad = study_points(study)
    assert input_problems(study, good) == []
    (found,) = input_problems(study, bad)
    assert str(found).startswith(
        f"study.yaml:4:3: E200 parameter 'pull' makes limits.{joint}.acceleration of robot.yaml 0: 0: "
    )
    assert "must be positive" in found.message


def test_settings_name_methods_that_there_are(folder: Path) -> None:
    """All wrong ones at once, at their places."""
    text = "dualarm: study/1\ntasks: tasks.yaml\nsettings: {platform: exakt, timing: rukig, redundancy: x}\n"
    text += "parameters:\n  p: {tasks: start, values: [home]}\n"
    with pytest.raises(InputError) as error:
        check_settings(_study(folder, text))
    places = [(d.line, d.column) for d in error.value.diagnostics]
    assert places == [(3, 22), (3, 37), (3, 56)]
    assert "there is no 'exakt', did you mean 'exact'? known: " in str(error.value.diagnostics[0])
