"""`dualarm verify LOG --plan PLAN`: what comes back from elsewhere, from a file to an exit code."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.exporting.schedule_reader import read_schedule


@pytest.fixture(scope="module")
def planned(tmp_path_factory, tasks_folder):
    """A plan."""
    out = tmp_path_factory.mktemp("recorded") / "plan"
    job = tasks_folder / "01_first_pick" / "tasks.yaml"
    assert run(["plan", str(job), "--effort", "quick", "--out", str(out), "--quiet"]) == 0
    return out


def log(planned, file, delay=0.0, error=0.0):
    """Writes a CSV of a motion that is late [s], with one joint off [rad]."""
    trajectory = read_schedule(planned).trajectory
    time = np.arange(0.0, trajectory.duration + 0.02, 0.004)
    q, v, _ = (row.copy() for row in trajectory.clamped(time - delay))
    q[:, trajectory.joints.index("right_b")] += error
    with file.open("w", newline="") as opened:
        writer = csv.writer(opened)
        names = [[f"{joint}_position", f"{joint}_velocity"] for joint in trajectory.joints]
        writer.writerow(["time", *(name for pair in names for name in pair)])
        for k, instant in enumerate(time):
            writer.writerow([instant, *np.column_stack([q[k], v[k]]).ravel().tolist()])
    return file


def test_a_late_joint_that_is_off_fails_and_is_named(planned, tmp_path, capsys):
    """Half a degree and eight milliseconds, in the document and in the table."""
    file = log(planned, tmp_path / "log.csv", 0.008, np.deg2rad(0.5))
    command = ["verify", str(file), "--plan", str(planned)]
    assert run([*command, "--json"]) == 1
    document = json.loads(capsys.readouterr().out)
    assert not document["passed"]
    joints = document["tracking"]["joints"]
    assert np.rad2deg(joints["right_b"]["error"]) == pytest.approx(0.5, abs=0.01)
    # The platform hardly moves in this plan: it tells no delay.
    delays = {name: row["delay"] for name, row in joints.items()}
    assert [name for name, delay in delays.items() if delay is None] in ([], ["torso_b1"])
    assert {round(delay * 1e3, 1) for delay in delays.values() if delay is not None} == {8.0}
    assert len(document["tracking"]["events"]) == 4
    stages = {row["stage"] for row in document["clearances"]}
    assert stages == set(range(len(read_schedule(planned).stages)))
    assert run(command) == 1
    printed = capsys.readouterr().out
    assert "right_b 0.5 deg" in printed
    assert "recorded motion: FAILED" in printed
    wide = ["--delay", "10 ms", "--tracking-error", "0.6 deg", "--tool-error", "5 mm"]
    assert run([*command, *wide, "-q"]) == 0


def test_an_input_file_is_no_motion(tasks_folder, capsys):
    """A task file in place of its plan."""
    assert run(["verify", str(tasks_folder / "01_first_pick" / "tasks.yaml")]) == 2
    assert "is an input file, not a schedule; plan it" in capsys.readouterr().err


@pytest.mark.parametrize("interpolation", ["linear", "cubic", "quintic"])
def test_an_exported_trajectory_that_comes_back_passes(planned, tmp_path, interpolation):
    """Of both arms; of one where the joints that are not in it are to count as planned, and not otherwise."""
    out = tmp_path / "out"
    export = ["export", str(planned), "--to", "ros2", "--interpolation", interpolation]
    assert run([*export, "--platform-with", "both", "--out", str(out), "-q"]) == 0
    for name, alone in (("both_arms.yaml", 0), ("left.json", 1)):
        command = ["verify", str(out / name), "--plan", str(planned), "-q"]
        command += ["--interpolation", interpolation]
        assert run([*command, "--unlogged-as-planned"]) == 0
        assert run(command) == alone


def test_a_motion_without_its_plan_says_what_is_missing(planned, tmp_path, capsys):
    """A CSV or a JointTrajectory is no schedule."""
    file = log(planned, tmp_path / "log.csv")
    assert run(["verify", str(file)]) == 2
    assert "--plan PLAN" in capsys.readouterr().err
    message = tmp_path / "log.json"
    message.write_text('{"joint_names": [], "points": []}')
    assert run(["verify", str(message)]) == 2
    assert "--plan PLAN" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--interpolation", "quintic"], "needs accelerations"),
        (["--tracking-error", "0"], "must be above 0"),
        (["--tool-error", "1 deg"], "unit 'deg'"),
        (["--delay", "soon"], "is not a number"),
    ],
)
def test_bad_options_are_refused(planned, tmp_path, capsys, options, message):
    """With what is allowed."""
    file = log(planned, tmp_path / "log.csv")
    assert run(["verify", str(file), "--plan", str(planned), *options]) == 2
    assert message in capsys.readouterr().err
