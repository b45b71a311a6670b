"""`dualarm robot import --left … --right …`: two robots of one arm each become a cell."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from dualarm_cli.cli.run import run
from dualarm_cli.collision.solids import geometry_model, link_solids, pairs_that_must_keep_apart
from dualarm_cli.errors import UsageError
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.model.cell import Cell
from dualarm_cli.robot_import.importing import ImportRequest
from dualarm_cli.robot_import.importing_pair import import_pair
from dualarm_cli.starting.robot_source import robot_source


@pytest.fixture
def urdfs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns an empty project with the URDFs of two single arms and of a robot with both."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dualarm.toml").write_text("")
    for name in ("iiwa7", "iiwa14", "nextage"):
        (tmp_path / f"{name}.urdf").write_text(load_robot(name).robot.urdf)
    return tmp_path


def _least_distance(cell: Cell) -> float:
    """Returns the least distance of bodies that must keep apart, in the posture home [m]."""
    robot = cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    pairs = pairs_that_must_keep_apart(model, solids, cell)
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    q = pin.neutral(model)
    for joint, value in zip(robot.joints, robot.postures["home"], strict=True):
        q[model.idx_qs[model.getJointId(joint)]] = value
    results = pin.GeometryData(geometry)
    pin.computeDistances(model, model.createData(), geometry, results, q)
    return min(result.min_distance for result in results.distanceResults)


def test_two_urdfs_become_a_cell_whose_home_is_collision_free(urdfs: Path) -> None:
    """Each robot in a folder of its own; the left one stands on the left of the right one."""
    names = ["--left", "iiwa7.urdf", "--right", "iiwa14.urdf"]
    assert run(["robot", "import", *names, "--out", "mine"]) == 0
    cell = load_cell(urdfs / "mine/cell.yaml").cell
    assert [arm.name for arm in cell.robot.arms] == ["left", "right"]
    left, right = (load_robot(name).robot.limits.velocity for name in ("iiwa7", "iiwa14"))
    assert cell.robot.limits.velocity.tolist() == [*left, *right]
    model = pin.buildModelFromXML(cell.robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    first = (model.getJointId(arm.joints[0]) for arm in cell.robot.arms)
    left_base, right_base = (data.oMi[joint].translation for joint in first)
    assert left_base[1] > right_base[1]
    assert _least_distance(cell) > 0.0
    # A new project takes the two robots over: a line of YAML each, without quotes and trailing blanks.
    entry = robot_source("mine").entry
    assert entry.splitlines()[0] == "robot:"
    assert '"' not in entry
    written = yaml.safe_load((urdfs / "mine/cell.yaml").read_text())
    assert yaml.safe_load(entry) == {"robot": written["robot"]}


def test_the_same_robot_twice_is_written_once(urdfs: Path) -> None:
    request = ImportRequest(urdfs / "iiwa7.urdf")
    files = import_pair(request, request).files
    assert sum(name.endswith("robot.yaml") for name in files) == 1
    assert files == import_pair(request, request).files


def test_robots_whose_urdfs_have_one_name_keep_their_folders(urdfs: Path) -> None:
    """A slower copy under the same name."""
    text = (urdfs / "iiwa7.urdf").read_text()
    slower = re.sub('velocity="[^"]*"', 'velocity="0.5"', text, count=1)
    (urdfs / "other.urdf").write_text(slower)
    pair = import_pair(ImportRequest(urdfs / "iiwa7.urdf"), ImportRequest(urdfs / "other.urdf"))
    folders = {name.split("/")[0] for name in pair.files if name.endswith("robot.yaml")}
    assert len(folders) == 2
    assert {folder.split("_")[0] for folder in folders} == {"left", "right"}


def test_a_robot_of_two_arms_is_refused(urdfs: Path) -> None:
    arm, both = ImportRequest(urdfs / "iiwa7.urdf"), ImportRequest(urdfs / "nextage.urdf")
    with pytest.raises(UsageError, match=r"--right .*nextage.urdf: .* has 2 arms"):
        import_pair(arm, both)


def test_a_tip_takes_one_arm_of_a_robot_of_two(urdfs: Path) -> None:
    """The other arm stands still, without `--right-tip none`: a member of a pair has one arm."""
    flange = load_robot("nextage").robot.arm("right").flange
    both = ImportRequest(urdfs / "nextage.urdf", tips={"right": flange})
    files = import_pair(ImportRequest(urdfs / "iiwa7.urdf"), both).files
    (text,) = (
        t.decode() for n, t in files.items() if n.startswith("nextage") and n.endswith("yaml")
    )
    assert f"flange: {flange}" in text
    assert "left:" not in text


@pytest.mark.parametrize(
    "arguments",
    [
        ["--left", "iiwa7.urdf"],
        ["iiwa7.urdf", "--left", "iiwa7.urdf", "--right", "iiwa7.urdf"],
        [],
        ["--left", "iiwa7.urdf", "--right", "iiwa7.urdf", "--platform", "a1"],
        ["--left", "iiwa7.urdf", "--right", "iiwa7.urdf", "--right-tip", "no_link"],
    ],
)
def test_what_does_not_fit_together_is_refused(
    arguments: list[str], urdfs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["robot", "import", *arguments, "--out", "mine"]) == 2
    assert not (urdfs / "mine").exists()
    assert capsys.readouterr().err.count("\n") == 1


def test_the_imported_cell_plans(urdfs: Path) -> None:
    """Both arms make a short move from home, verified with the shapes of the URDFs."""
    names = ["--left", "iiwa7.urdf", "--right", "iiwa14.urdf"]
    assert run(["robot", "import", *names, "--out", "mine"]) == 0
    robot = load_cell(urdfs / "mine/cell.yaml").cell.robot
    moves = []
    for arm in robot.arms:
        near = np.round(robot.postures["home"][robot.columns(arm.joints)] + 0.05, 4).tolist()
        moves.append(f"  - {{id: {arm.name}, arm: {arm.name}, move: {{joints: {near}}}}}\n")
    tasks = "dualarm: tasks/1\ncell: cell.yaml\ntasks:\n" + "".join(moves)
    (urdfs / "mine/tasks.yaml").write_text(tasks)
    assert run(["plan", "mine/tasks.yaml", "--effort", "quick", "--out", "plan", "--quiet"]) == 0
    assert json.loads((urdfs / "plan/report.json").read_text())["verification"]["passed"]
