"""`dualarm export`: files, what is said of losses, refusals."""

from __future__ import annotations

import json
import shutil
import sys
from typing import get_args

import pytest

from dualarm_cli.cli.export import PlatformGroup, _table
from dualarm_cli.cli.parts.options import ReceiverInterpolation
from dualarm_cli.cli.parts.output import stdout_console
from dualarm_cli.cli.run import run
from dualarm_cli.formats import FORMATS
from dualarm_cli.formats.request import PlatformController
from dualarm_cli.formats.sampling import JointLoss
from dualarm_cli.geometry.interpolation import INTERPOLATIONS


@pytest.fixture(scope="module")
def planned(tmp_path_factory, tasks_folder):
    """A plan."""
    out = tmp_path_factory.mktemp("export") / "plan"
    job = tasks_folder / "01_first_pick" / "tasks.yaml"
    assert run(["plan", str(job), "--effort", "quick", "--out", str(out), "--quiet"]) == 0
    return out


def test_the_choices_of_the_command_are_those_of_the_lists():
    """One literal list each."""
    assert tuple(one.value for one in ReceiverInterpolation) == INTERPOLATIONS
    assert tuple(one.value for one in PlatformGroup) == get_args(PlatformController)


@pytest.mark.parametrize("name", list(FORMATS))
def test_every_format_is_written_and_listed(planned, tmp_path, capsys, name):
    """The document names every file; what holds motion says what every joint loses."""
    out = tmp_path / "out"
    assert run(["export", str(planned), "--to", name, "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((out / "export.json").read_text())
    assert all((out / file).stat().st_size > 0 for file in document["files"])
    written = {p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file()}
    assert written == {*document["files"], "export.json"}
    if FORMATS[name].motion:
        for group in document["trajectories"].values():
            assert all(joint["deviation"] >= 0.0 for joint in group["joints"].values())
    # A second time only with leave.
    assert run(["export", str(planned), "--to", name, "--out", str(out)]) == 2
    assert run(["export", str(planned), "--to", name, "--out", str(out), "--force", "-q"]) == 0


def test_what_exceeds_limits_is_said(planned, tmp_path, capsys):
    """Cubic at 100 Hz without knots exceeds accelerations; with knots it does not."""
    command = ["export", str(planned), "--to", "ros2", "--rate", "100", "--out"]
    assert run([*command, str(tmp_path / "knots")]) == 0
    assert "warning" not in capsys.readouterr().err
    assert run([*command, str(tmp_path / "uniform"), "--uniform"]) == 0
    assert "beyond limits under cubic interpolation" in capsys.readouterr().err


@pytest.mark.parametrize(("name", "library"), [("mcap", "rosbags"), ("parquet", "pyarrow")])
def test_a_missing_library_names_its_extra(planned, tmp_path, capsys, monkeypatch, name, library):
    """And nothing is written."""
    for module in [m for m in sys.modules if m.split(".")[0] == library]:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, library, None)
    out = tmp_path / "out"
    assert run(["export", str(planned), "--to", name, "--out", str(out)]) == 2
    assert f"{library} is not installed: pip install 'dualarm[export]'" in capsys.readouterr().err
    assert not out.exists()


def test_a_format_that_cannot_hold_the_plan_says_why(planned, tmp_path, capsys):
    """Controllers need the names of the arms' joints."""
    plan = shutil.copytree(planned, tmp_path / "nameless")
    document = json.loads((plan / "schedule.json").read_text())
    document["robot"]["arms"]["right"]["joints"] = []
    (plan / "schedule.json").write_text(json.dumps(document))
    out = tmp_path / "out"
    assert run(["export", str(plan), "--to", "ros2", "--out", str(out)]) == 2
    assert "cannot be exported to ros2: robot.arms.right.joints" in capsys.readouterr().err
    assert not out.exists()


def test_a_format_without_files_for_a_plan_it_supports_is_a_fault(planned, tmp_path, monkeypatch):
    """It is not written as an empty folder."""
    monkeypatch.setattr("dualarm_cli.formats.perfetto_trace.files", lambda request: {})
    out = tmp_path / "out"
    assert run(["export", str(planned), "--to", "perfetto", "--out", str(out)]) == 4
    assert not out.exists()


@pytest.mark.parametrize("rate", ["0", "-5", "nan", "inf", "1e9", "5e-324"])
def test_a_rate_that_makes_no_sense_is_refused(planned, tmp_path, capsys, rate):
    """With what is allowed."""
    out = tmp_path / "out"
    command = ["export", str(planned), "--to", "npz", "--rate", rate, "--out", str(out)]
    assert run(command) == 2
    assert "must be at least 0.001 and at most 10000 Hz" in capsys.readouterr().err


def test_more_samples_than_memory_has_room_for_are_refused(planned, tmp_path, capsys):
    """A file of a few kilobytes may describe days."""
    plan = shutil.copytree(planned, tmp_path / "long")
    document = json.loads((plan / "schedule.json").read_text())
    for group in document["motion"].values():
        group["time"][-1] = 35_000.0
    (plan / "schedule.json").write_text(json.dumps(document))
    for name in (name for name, form in FORMATS.items() if form.motion and not form.needs_job):
        out = tmp_path / "out"
        assert run(["export", str(plan), "--to", name, "--out", str(out)]) == 2
        assert "3,500,000 samples; at most 250,000" in capsys.readouterr().err
        assert not out.exists()


def test_a_plan_that_fails_its_verification_is_said_to_fail(planned, tmp_path, capsys):
    """Exit code 1; numbers that mean nothing are not written at all."""
    copy = shutil.copytree(planned, tmp_path / "copy")
    document = json.loads((copy / "schedule.json").read_text())
    document["events"][0]["xyz"][0] += 0.01
    (copy / "schedule.json").write_text(json.dumps(document))
    assert run(["export", str(copy), "--to", "npz", "--out", str(tmp_path / "out")]) == 1
    assert "verification: FAILED: tool_position_at_events" in capsys.readouterr().err
    assert (tmp_path / "out" / "schedule.npz").exists()
    document["motion"]["left"]["acceleration"][0][0] = float("nan")
    (copy / "schedule.json").write_text(json.dumps(document))
    assert run(["export", str(copy), "--to", "npz", "--out", str(tmp_path / "none")]) == 2
    assert not (tmp_path / "none").exists()


@pytest.mark.parametrize("name", ["mcap", "gltf"])
def test_tasks_of_another_robot_are_refused(planned, tmp_path, capsys, tasks_folder, name):
    """With the joints that do not fit."""
    other = tasks_folder / "09_yumi" / "tasks.yaml"
    command = ["export", str(planned), "--to", name, "--tasks", str(other)]
    assert run([*command, "--out", str(tmp_path / "out")]) == 2
    assert "different robots" in capsys.readouterr().err


def test_a_folder_without_a_name_is_refused(planned, capsys):
    """It would be the working directory."""
    assert run(["export", str(planned), "--to", "npz", "--out", ""]) == 2
    assert "name a folder" in capsys.readouterr().err


def test_the_jerk_of_long_joint_names_is_shown_at_80_columns(monkeypatch, capsys):
    """A UR's longest joint with a prefix has 24 characters."""
    monkeypatch.setenv("COLUMNS", "80")
    names = ("left_shoulder_lift_joint", "right_wrist_1_joint")
    rows = [
        JointLoss(name, 1.5e-6, 12.345, 0.9, 1.01 + k, 1.2 + k, 0.0) for k, name in enumerate(names)
    ]
    stdout_console().print(_table(rows, "quintic", frozenset()))
    out = capsys.readouterr().out
    assert "1.2000" in out
    assert "2.2000" in out
    assert max(map(len, out.splitlines())) <= 80
