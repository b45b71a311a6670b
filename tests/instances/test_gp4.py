"""Two GP4: their tables against the poses that APEX-MR's files give, and the steps' times."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

Script = Callable[[str], ModuleType]
NAMES = {"cliff": 204, "fish_high": 531}
# Bases in the world as the source prints them, table (0.9246 m) and shoulder (0.33 m) added.
PRINTED = {
    "left": np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.2546]]),
    "right": np.array(
        [
            [-0.99998353, -0.00573983, 0, 0.88101137],
            [0.00573983, -0.99998353, 0, -0.01304334],
            [0, 0, 1, 1.2546],
        ]
    ),
}


@pytest.fixture
def gp4(script: Script) -> ModuleType:
    """The script."""
    return script("gp4")


def quaternions(values: np.ndarray) -> np.ndarray:
    """Returns the rotations (n, 3, 3) of quaternions x y z w (n, 4)."""
    return np.array([pin.Quaternion(q).normalized().matrix() for q in values])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("side", PRINTED)
def test_the_table_gives_the_flange_of_every_step(gp4, tmp_path: Path, name, side) -> None:
    """Nine decimals of m and deg are worth 0.6 nm; the quaternions' eight nanoradians."""
    steps = gp4.read_steps(name)
    assert len(steps.q[side]) == NAMES[name]
    robot = load_robot(gp4.write_instance(name, tmp_path / "job").parent / "robot.yaml").robot
    model = pin.buildModelFromXML(robot.urdf)
    data, flange = model.createData(), model.getFrameId("flange")
    base = PRINTED[side]
    rotations = quaternions(steps.poses[side][:, 3:])
    for q, pose, R in zip(steps.q[side], steps.poses[side], rotations, strict=True):
        pin.framesForwardKinematics(model, data, q)
        found = data.oMf[flange]
        np.testing.assert_allclose(
            base[:, :3] @ found.translation + base[:, 3], pose[:3], rtol=0, atol=1e-9
        )
        np.testing.assert_allclose(base[:, :3] @ found.rotation, R, rtol=0, atol=8e-9)


def test_the_cell_has_both_arms_where_the_source_has_them(gp4, tmp_path: Path) -> None:
    """Within 3e-9 of an arm's half metre: by so much the printed turn of base 2 is longer than a turn."""
    steps = gp4.read_steps("cliff")
    path = gp4.write_instance("cliff", tmp_path / "job").parent / "cell.yaml"
    model = CellModel.from_cell(load_cell(path).cell)
    q = np.hstack([steps.q["left"], steps.q["right"]])
    for side, found in zip(
        ("left", "right"), model.tool_positions(["left", "right"], q), strict=True
    ):
        np.testing.assert_allclose(found, steps.poses[side][:, :3], rtol=0, atol=3e-9)


@pytest.mark.parametrize("name", NAMES)
def test_the_sums_at_full_speed_are_those_of_the_original_rows(gp4, name) -> None:
    """3.950 / 5.826 / 9.773 s and 12.981 / 14.457 / 27.427 s, of the original files."""
    found = gp4.step_sums(gp4.read_steps(name), np.inf)
    assert found == pytest.approx(gp4.SPEED_SUMS[name], abs=5e-4)


def test_paired_steps_take_the_sum_of_their_slower_arms(gp4, tmp_path: Path) -> None:
    """Every stage is a step from rest to rest: the plan can be neither faster nor slower."""
    job = load_job(gp4.write_instance("cliff", tmp_path / "job"))
    schedule = plan_without_bound(job, PlanSettings(timing="trapezoid"))
    limits = np.radians(gp4.ACCELERATION)
    expected = gp4.step_sums(gp4.read_steps("cliff"), limits)[2]
    assert schedule.duration == pytest.approx(expected, abs=1e-6)
    assert not verify(schedule, job).failures


def test_an_original_file_gives_our_data(gp4, tmp_path: Path, monkeypatch) -> None:
    """A line per change of joints, flag or not; what follows stays; the last step is kept for both arms."""
    home, there = [1.0] * 6, [2.0, *[1.0] * 5]
    pose = [0.5, 0, 0, 0, 0, 0, 1]
    rows = [(home, home), (there, home), (there, there), (there, there)]
    lines = [",".join(map(str, [0, *pose, *one, 1, *pose, *other])) for one, other in rows]
    (tmp_path / "two_steps.csv").write_text("\n".join(lines) + "\n")
    monkeypatch.setattr(gp4, "FOLDER", tmp_path)
    made = gp4.import_steps(tmp_path / "two_steps.csv")
    kept = [line.split(",")[:3] for line in made.read_text().splitlines()[1:]]
    assert kept == [
        ["0", "left", "1"],
        ["0", "right", "1"],
        ["1", "left", "2"],
        ["2", "right", "2"],
        ["3", "left", "2"],
        ["3", "right", "2"],
    ]
    steps = gp4.read_steps("two")
    np.testing.assert_allclose(np.degrees(steps.q["left"][:, 0]), [1, 2, 2, 2])
    np.testing.assert_allclose(np.degrees(steps.q["right"][:, 0]), [1, 1, 2, 2])


def test_free_arms_have_their_own_moves_only(gp4, tmp_path: Path) -> None:
    """82 and 89 steps of `cliff` move an arm; paired has all 203 for both."""
    paired = gp4.write_instance("cliff", tmp_path / "paired").read_text()
    free = gp4.write_instance("cliff", tmp_path / "free", "free").read_text()
    assert (paired.count("arm: left"), paired.count("arm: right")) == (203, 203)
    assert (free.count("arm: left"), free.count("arm: right")) == (82, 89)
