"""`dualarm robot import --left … --right …`: two robots of one arm each become a cell."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml

from dualarm_cli.cli.run import run
from dualarm_cli.collision.solids import geometry_model, link_solids, pairs_that_must_keep_apart
from dualarm_cli.errors import UsageError
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robot_pair import compose_pair
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
    entry = robot_source(ImportRequest(Path("mine"))).entry
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


def _write_prefixed(folder: Path, prefixes: dict[str, str]) -> str:
    """Writes left.urdf and right.urdf with prefixed names; returns the URDF without."""
    text = (folder / "iiwa7.urdf").read_text()
    for side, prefix in prefixes.items():
        pattern = r'((?:<link|<joint) name|(?:<parent|<child) link)="'
        (folder / f"{side}.urdf").write_text(re.sub(pattern, rf'\1="{prefix}', text))
    return text


@pytest.mark.parametrize(
    ("left", "right", "kept", "flanges"),
    [
        ("left_", "right_", True, ["left_flange", "right_flange"]),
        ("a_", "b_", True, ["left_a_flange", "right_b_flange"]),
        ("a_", "a_", False, ["left_a_flange", "right_a_flange"]),
    ],
)
def test_controllers_names_of_joints_stay_where_the_robots_share_none(
    left: str, right: str, kept: bool, flanges: list[str], urdfs: Path
) -> None:
    """A robot whose URDF has prefixes of its own, `tf_prefix` of ur_description, gets no second one."""
    prefixes = {"left": left, "right": right}
    text = _write_prefixed(urdfs, prefixes)
    stems = prefixes.values() if kept else [f"{side}_{prefix}" for side, prefix in prefixes.items()]
    expected = [f"{stem}joint_{k}" for stem in stems for k in range(1, 8)]
    assert run(["robot", "import", "--left=left.urdf", "--right=right.urdf", "--out=mine"]) == 0
    robot = load_cell(urdfs / "mine/cell.yaml").cell.robot
    assert list(robot.joints) == expected
    assert [joint for arm in robot.arms for joint in arm.joints] == expected
    assert [arm.flange for arm in robot.arms] == flanges
    # The pair is the two robots: each flange is where its URDF has it, from its base.
    model, alone = pin.buildModelFromXML(robot.urdf), pin.buildModelFromXML(text)
    q = pin.randomConfiguration(alone, np.full(7, -1.0), np.full(7, 1.0))
    both = np.empty(14)
    for k, joint in enumerate(expected):
        both[model.idx_qs[model.getJointId(joint)]] = q[k % 7]
    data, data_alone = model.createData(), alone.createData()
    pin.framesForwardKinematics(model, data, both)
    pin.framesForwardKinematics(alone, data_alone, q)
    for side, flange in zip(("left", "right"), flanges, strict=True):
        base = data.oMf[model.getFrameId(f"world_to_{side}")]
        T_base_flange = base.inverse() * data.oMf[model.getFrameId(flange)]
        assert T_base_flange.isApprox(data_alone.oMf[alone.getFrameId("flange")], 1e-12)


def test_links_of_earlier_versions_with_two_prefixes_are_still_read(urdfs: Path) -> None:
    _write_prefixed(urdfs, {"left": "left_", "right": "right_"})
    assert run(["robot", "import", "--left=left.urdf", "--right=right.urdf", "--out=mine"]) == 0
    cell = urdfs / "mine/cell.yaml"
    cell.write_text(cell.read_text() + "allowed_contacts: [[left_left_link_7, right_link_7]]\n")
    assert load_cell(cell).cell.allowed_contacts == (("left_link_7", "right_link_7"),)


def test_names_that_one_prefix_leaves_ambiguous_get_two() -> None:
    """The left robot has both `tip` and `left_tip`: a link of each name is in the pair."""
    text = load_robot("iiwa7").robot.urdf
    more = "".join(
        f'<link name="{name}"/><joint name="to_{name}" type="fixed"><parent link="flange"/>'
        f'<child link="{name}"/></joint>'
        for name in ("tip", "left_tip")
    )
    robot = replace(load_robot("iiwa7").robot, urdf=text.replace("</robot>", f"{more}</robot>"))
    pair = compose_pair(robot, pin.SE3.Identity(), robot, pin.SE3.Identity())
    links = {frame.name for frame in pin.buildModelFromXML(pair.urdf).frames}
    assert {"left_tip", "left_left_tip", "right_tip", "right_left_tip"} <= links
