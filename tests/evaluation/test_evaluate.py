"""One evaluation: the figures are the plan's, every error is a status, every file that was read is named."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.evaluation import evaluate as module
from dualarm_cli.evaluation.evaluate import evaluate, settings_of
from dualarm_cli.evaluation.request import Request, case_name
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.budget import Kept
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.planning import planner
from dualarm_cli.planning.planner import plan


def test_the_figures_are_those_of_the_plan(cells, request_for):
    """Cycle time, bound, travel added up here from the knots; shares of the time add up to it."""
    case = cells(1)[0]
    request = request_for(case)
    found = evaluate(request)
    schedule = plan(load_job(case), settings_of(request))
    assert found.status == "planned"
    assert found.case == case
    assert found.closes
    assert found.cycle_time == schedule.trajectory.time[-1]
    assert found.lower_bound == schedule.lower_bound
    assert found.gap == pytest.approx(1.0 - found.lower_bound / found.cycle_time)
    knots = schedule.trajectory.position
    assert found.travel == pytest.approx(np.abs(np.diff(knots, axis=0)).sum())
    assert (found.torque, found.torque_joint) == (None, "")
    assert sum(found.limiting.values()) == pytest.approx(found.cycle_time)
    assert set(found.limiting) <= set(schedule.trajectory.joints)
    limit = found.limits["left_1"]
    assert limit["acceleration"] == pytest.approx(np.radians(600.0))
    assert limit["jerk"] == pytest.approx(np.radians(6000.0))


def test_it_goes_through_json_without_loss(cells, request_for):
    """The same noun and the same bytes."""
    found = evaluate(request_for(cells(1)[0]))
    text = json.dumps(found.as_document(), allow_nan=False)
    again = Evaluation.of_document(json.loads(text))
    assert again == found
    assert json.dumps(again.as_document(), allow_nan=False) == text


@pytest.mark.parametrize(
    "change",
    [
        {"status": "fine"},
        {"cycle_time": float("nan")},
        {"cycle_time": "1"},
        {"cycle_time": True},
        {"closes": 1},
        {"limiting": {"a": None}},
        {"limits": {"a": 1.0}},
        {"inputs": {"a": 1}},
        {"findings": [{"message": "x"}]},
        {"budgets": {}},
        {"caveats": [1]},
        {"caveats": "none"},
        {"more": 1},
    ],
)
def test_a_document_that_is_none_is_refused(change):
    """So that a damaged store or a foreign answer is never taken for one."""
    with pytest.raises(ValueError, match=r"\w"):
        Evaluation.of_document(Evaluation("a", "planned").as_document() | change)


def test_every_file_that_was_read_is_named_with_its_hash(cells, request_for):
    """The task file, the cell, the robot and its URDF; from the task file's folder."""
    found = evaluate(request_for(cells(1)[0]))
    assert list(found.inputs) == [
        "../../robots/planar/bottin_planar.urdf",
        "../../robots/planar/robot.yaml",
        "cell.yaml",
        "tasks.yaml",
    ]
    for name, digest in found.inputs.items():
        data = (Path("cells/000") / name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == digest


def test_meshes_tables_and_bundled_robots_are_among_the_files(tasks_folder):
    """What a job is read from besides YAML: a CSV of poses, and robots that come with the package."""
    seam = tasks_folder / "papers" / "qin_curves" / "tasks.yaml"
    read = evaluate(Request.of(seam, platform="nothing")).inputs
    assert "tasks.yaml" in read
    assert any(name.startswith("bundled:") and name.endswith(".urdf") for name in read)


def test_bad_files_are_told_with_their_places(cells, request_for):
    """Every one of them."""
    case = cells(1)[0]
    path = Path(case)
    path.write_text(path.read_text().replace("return: true", "retrun: true\nspeed: fast"))
    found = evaluate(request_for(case))
    assert found.status == "bad_input"
    assert [(f.file, f.line, f.column) for f in found.findings] == [(case, 3, 1), (case, 4, 8)]
    assert "did you mean 'return'" in found.findings[0].message


def test_what_cannot_be_reached_is_infeasible_at_its_place(cells, request_for):
    """A metre away from a robot of a foot."""
    case = cells(1)[0]
    path = Path(case)
    path.write_text(path.read_text().replace("80 mm", "1080 mm"))
    found = evaluate(request_for(case))
    assert found.status == "infeasible"
    assert (found.findings[0].file, found.findings[0].line) == (case, 5)
    assert found.cycle_time is None


def test_an_unknown_solver_a_missing_file_and_a_bug_have_their_status(
    cells, request_for, monkeypatch
):
    """Nothing is raised."""
    request = request_for(cells(1)[0])
    assert evaluate(replace(request, platform="nothing")).status == "bad_input"
    gone = evaluate(request_for("cells/nowhere/tasks.yaml"))
    assert gone.status == "bad_input"
    assert "cannot be read" in gone.findings[0].message

    def broken(*_, **__):
        raise ZeroDivisionError("seven")

    monkeypatch.setattr(planner, "plan", broken)
    found = evaluate(request)
    assert found.status == "internal_error"
    assert "ZeroDivisionError: seven" in found.findings[0].message


def test_a_plan_that_the_verifier_fails_says_which_check(cells, request_for, monkeypatch):
    """A mutated schedule: its last knot is moved, so that it does not come back."""

    def spoilt(job, settings, watch, **_):
        schedule = plan(job, settings, watch)
        position = schedule.trajectory.position.copy()
        position[-1] += 0.01
        return replace(
            schedule, motion=JointMotion.of(replace(schedule.trajectory, position=position))
        )

    monkeypatch.setattr(planner, "plan", spoilt)
    found = evaluate(request_for(cells(1)[0]))
    assert found.status == "fails_verification"
    assert any("position" in finding.message for finding in found.findings)


@pytest.mark.parametrize("figure", [float("nan"), float("inf")])
def test_a_figure_that_is_none_is_an_error_and_goes_through_json(
    cells, request_for, monkeypatch, figure
):
    """Also that of a budget: a process that could not write its answer down would seem to have crashed."""
    line = Kept("clearance", 0.01, figure, True, "a", 1, 1)
    monkeypatch.setattr(module, "judge_budget", lambda *_: (line,))
    found = evaluate(request_for(cells(1)[0]))
    assert found.status == "internal_error"
    assert "not finite" in found.findings[0].message
    assert Evaluation.of_document(json.loads(json.dumps(found.as_document(), allow_nan=False)))


@pytest.mark.parametrize("bound", [None, float("inf")])
def test_a_bound_that_is_not_known_or_infinite_is_none(cells, request_for, monkeypatch, bound):
    """An infinite one fails the verifier, and its evaluation still goes through JSON."""
    monkeypatch.setattr(
        planner, "plan", lambda *given, **_: replace(plan(*given), lower_bound=bound)
    )
    found = evaluate(request_for(cells(1)[0]))
    assert found.status == ("planned" if bound is None else "fails_verification")
    assert (found.lower_bound, found.gap) == (None, None)
    assert json.dumps(found.as_document(), allow_nan=False)


def test_values_are_replaced_by_kind_and_pointer(cells, request_for):
    """Half the speed takes longer; a limit of the robot and a value of a list as well; nonsense is refused."""
    request = request_for(cells(1)[0])
    plain = evaluate(request)
    slow = evaluate(replace(request, overrides={"tasks:/speed": "50%"}))
    assert slow.cycle_time == pytest.approx(2.0 * plain.cycle_time, rel=1e-9)
    robot = evaluate(
        replace(request, overrides={"robot:/limits/left_1/acceleration": "100 deg/s^2"})
    )
    assert robot.limits["left_1"]["acceleration"] == pytest.approx(np.radians(100.0))
    moved = evaluate(replace(request, overrides={"tasks:/tasks/0/move/xyz/1": 0.02}))
    assert moved.travel != plain.travel
    for name in ("tasks:/tasks/7/id", "cell:/frames/a/xyz/0", "cell:/robot/x", "robot:"):
        refused = evaluate(replace(request, overrides={name: 1}))
        assert refused.status == "bad_input"
        assert f"{name} leads nowhere" in refused.findings[0].message


def test_cases_are_named_from_the_working_directory(tmp_path, monkeypatch):
    """With forward slashes; what is elsewhere by its absolute name."""
    (tmp_path / "a").mkdir()
    monkeypatch.chdir(tmp_path / "a")
    assert case_name("./x/../b/tasks.yaml") == "b/tasks.yaml"
    assert case_name(tmp_path / "a" / "b.yaml") == "b.yaml"
    assert case_name(tmp_path / "b.yaml") == str(tmp_path / "b.yaml")
    assert case_name(tmp_path / "a" / "..b.yaml") == "..b.yaml"
