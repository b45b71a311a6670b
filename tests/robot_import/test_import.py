"""`dualarm robot import`: what it finds in the URDFs of robots whose files were written by hand."""

from __future__ import annotations

import contextlib
import json
import math
import os
import pty
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.collision.solids import (
    geometry_model,
    link_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.errors import InputError, MissingDependencyError, UsageError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import bundled_robots
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.robot_import.importing import Imported, ImportRequest, import_robot

TWO_ARMS = [name for name in bundled_robots() if len(load_robot(name).robot.arms) == 2]
BY_TREE = [name for name in TWO_ARMS if name != "bottin_planar"]
"""Robots whose URDF is there as a file; links of the planar one are not named as arms are."""
TETRAHEDRON = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\n"


def urdf_of(name: str, folder: Path) -> Path:
    """Writes the URDF of a bundled robot as a file of its own, and returns it."""
    path = folder / f"{name}.urdf"
    path.write_text(load_robot(name).robot.urdf)
    return path


def imported(path: Path, **more: object) -> Imported:
    return import_robot(ImportRequest(path, **more))  # type: ignore[arg-type]


@pytest.mark.parametrize("name", BY_TREE)
def test_arms_and_platform_are_those_that_people_wrote(name: str, tmp_path: Path) -> None:
    """Joints, flanges, sides, platform and kinds of the bundled robot files."""
    written = load_robot(name).robot
    both = written.platform if len(written.platform) > 1 else None
    found = imported(urdf_of(name, tmp_path), platform=both).loaded.robot
    assert found.platform == written.platform
    for arm in written.arms:
        mine = found.arm(arm.name)
        assert (mine.joints, mine.kind) == (arm.joints, arm.kind)
        assert mine.flange == arm.flange
    assert found.limits.velocity.tolist() == written.limits.velocity.tolist()


@pytest.mark.parametrize("name", BY_TREE)
def test_the_posture_proposed_is_collision_free_and_away_from_limits(
    name: str, tmp_path: Path
) -> None:
    """Judged by coal over the contacts that people allowed, not those that the import found."""
    found = imported(urdf_of(name, tmp_path)).loaded.robot
    home = found.postures["home"]
    assert (home > found.limits.lower).all()
    assert (home < found.limits.upper).all()
    written = load_robot(name).robot
    robot = replace(found, allowed_contacts=written.allowed_contacts)
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    tools = {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms}
    cell = Cell(robot, pin.SE3.Identity(), tools, {}, ())
    pairs = pairs_that_must_keep_apart(model, solids, cell)
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    q = pin.neutral(model)
    for joint, value in zip(robot.joints, home, strict=True):
        q[model.idx_qs[model.getJointId(joint)]] = value
    results = pin.GeometryData(geometry)
    pin.computeDistances(model, model.createData(), geometry, results, q)
    assert min(result.min_distance for result in results.distanceResults) > 0.009


def test_the_same_urdf_gives_the_same_bytes(tmp_path: Path) -> None:
    path = urdf_of("nextage", tmp_path)
    assert imported(path).files == imported(path).files


def test_every_assumed_number_says_so(tmp_path: Path) -> None:
    """The bundled URDFs have no accelerations: all are by the stated rule, top speed in 0.3 s, that in 0.1 s."""
    found = imported(urdf_of("yumi", tmp_path))
    limits = found.loaded.robot.limits
    assert limits.acceleration == pytest.approx(limits.velocity / 0.3)
    assert limits.jerk == pytest.approx(limits.acceleration / 0.1)
    assert set(limits.source) == {"assumed"}
    text = found.files["robot.yaml"].decode()
    rule = "{acceleration: top speed in 0.3 s, jerk: acceleration in 0.1 s, source: assumed}"
    assert f"default: {rule}" in text


@pytest.mark.parametrize("decimals", [4, 3])
def test_rounded_angles_are_made_exact(decimals: int, tmp_path: Path) -> None:
    """With 1.5708 or 1.571 for a quarter turn the arms of an SDA10F are not spherical-revolute-spherical."""

    def _rounded(rpy: re.Match[str]) -> str:
        return f'rpy="{" ".join(f"{float(word):.{decimals}f}" for word in rpy[1].split())}"'

    path = urdf_of("sda10f", tmp_path)
    text = path.read_text()
    angles = re.findall(r'rpy="([^"]*)"', text)
    assert any(abs(float(word)) > 1.5 for rpy in angles for word in rpy.split())
    path.write_text(re.sub(r'rpy="([^"]*)"', _rounded, text))
    found = imported(path)
    assert [arm.kind for arm in found.loaded.robot.arms] == ["srs", "srs"]
    assert any(
        "rounded angles of the URDF made exact multiples of a quarter turn: " in reason
        and f"{math.pi / 2:.{decimals}f}" in reason
        for reason in found.reasons
    )


def test_a_wrist_of_rounded_angles_is_spherical(tmp_path: Path) -> None:
    """Six axes along z with 1.571 for quarter turns, as a maker writes them; and no collision shapes, which is said."""
    poses = (
        ("0 0 0.2", "0 0 0"),
        ("0 0 0", "0 -1.571 -1.571"),
        ("0.5 0 0", "0 0 1.571"),
        ("0 -0.4 0", "1.571 0 0"),
        ("0 0 0", "-1.571 0 0"),
        ("0 -0.1 0", "1.571 0 0"),
    )
    rows = "".join(
        f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 0 1"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/><limit lower="-3" upper="3" velocity="2" effort="1"/></joint>'
        f'<link name="l{k + 1}"/>'
        for k, (xyz, rpy) in enumerate(poses)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm"><link name="l0"/>{rows}</robot>')
    found = imported(path)
    assert [arm.kind for arm in found.loaded.robot.arms] == ["spherical_wrist"]
    angles = "6 rounded angles of the URDF made exact multiples of a quarter turn: -1.571, 1.571"
    assert angles in found.reasons
    assert any("has no collision shapes" in reason for reason in found.reasons)


def test_links_that_overlap_in_every_posture_are_found(tmp_path: Path) -> None:
    """A ball of 0.4 m on the second link of YuMi's left arm reaches into the body whatever the first joint does."""
    path = urdf_of("yumi", tmp_path)
    plain = {frozenset(pair) for pair in imported(path).loaded.robot.allowed_contacts}
    text = path.read_text()
    joint = load_robot("yumi").robot.arm("left").joints[1]
    link = re.findall(rf'<joint name="{joint}".*?<child link="([^"]*)"', text, re.DOTALL)[0]
    root = pin.buildModelFromXML(text).frames[1].name
    ball = '<collision><geometry><sphere radius="0.4"/></geometry></collision>'
    path.write_text(text.replace(f'<link name="{link}">', f'<link name="{link}">{ball}', 1))
    wide = {frozenset(pair) for pair in imported(path).loaded.robot.allowed_contacts}
    assert frozenset((link, root)) in wide
    assert len(wide) > len(plain)


def test_links_that_touch_in_some_postures_only_are_no_contacts_or_told(tmp_path: Path) -> None:
    """A box on the upper arm that the forearm meets when it bends: judged by coal in 400 postures of its own."""
    path = urdf_of("nextage", tmp_path)
    text = path.read_text()
    joints = load_robot("nextage").robot.arm("left").joints
    (link,) = re.findall(rf'<joint name="{joints[1]}".*?<child link="([^"]*)"', text, re.DOTALL)
    box = '<origin xyz="0.08 0 -0.12"/><geometry><box size="0.12 0.06 0.2"/></geometry>'
    solid = f'<link name="{link}"><collision>{box}</collision>'
    path.write_text(text.replace(f'<link name="{link}">', solid, 1))
    found = imported(path)
    allowed = {frozenset(pair) for pair in found.loaded.robot.allowed_contacts}
    bare = replace(found.loaded.robot, allowed_contacts=())
    model = pin.buildModelFromXML(bare.urdf)
    solids = link_solids(model, bare)
    cell = Cell(
        bare, pin.SE3.Identity(), {a.name: Tool(pin.SE3.Identity()) for a in bare.arms}, {}, ()
    )
    pairs = [(p.first, p.second) for p in pairs_that_must_keep_apart(model, solids, cell)]
    geometry = geometry_model(solids, pairs)
    results = pin.GeometryData(geometry)
    rng = np.random.default_rng(7)
    share: dict[frozenset[str], float] = {}
    for q in rng.uniform(model.lowerPositionLimit, model.upperPositionLimit, (400, model.nq)):
        pin.computeDistances(model, model.createData(), geometry, results, q)
        now = {
            frozenset((solids[a].body, solids[b].body))
            for (a, b), result in zip(pairs, results.distanceResults, strict=True)
            if result.min_distance < 0.01
        }
        for pair in now:
            share[pair] = share.get(pair, 0.0) + 1 / 400
    assert any(0.02 < of < 0.5 for of in share.values())
    assert all(share[pair] > 0.45 for pair in allowed)
    told = " ".join(found.loaded.notes)
    for pair in allowed:
        if share[pair] < 0.9:
            assert all(name in told for name in pair)


SRDF = """<?xml version="1.0"?>
<robot name="yumi">
  <group name="left_arm"><chain base_link="{base}" tip_link="{left}"/></group>
  <group name="right_arm"><chain base_link="{base}" tip_link="{right}"/></group>
  <group name="left_gripper"><link name="{left}"/></group>
  <group_state name="ready" group="left_arm">{states}</group_state>
</robot>
"""


def test_an_srdf_gives_tips_and_postures(tmp_path: Path) -> None:
    """Flanges of the groups that are arms, and the middle of all ranges as a posture."""
    path = urdf_of("yumi", tmp_path)
    robot = load_robot("yumi").robot
    left, right = (robot.arm(side) for side in ("left", "right"))
    base = pin.buildModelFromXML(robot.urdf).frames[1].name
    middle = 0.5 * (robot.limits.lower + robot.limits.upper)
    values = dict(zip(robot.joints, middle.tolist(), strict=True))
    states = "".join(f'<joint name="{j}" value="{values[j]}"/>' for j in left.joints)
    srdf = tmp_path / "yumi.srdf"
    srdf.write_text(SRDF.format(base=base, left=left.flange, right=right.flange, states=states))
    found = imported(path, srdf=srdf).loaded.robot
    assert (found.arm("left").flange, found.arm("right").flange) == (left.flange, right.flange)
    columns = found.columns(left.joints)
    assert found.postures["ready"][columns] == pytest.approx([values[j] for j in left.joints])
    srdf.write_text(srdf.read_text().replace(left.flange, "no_link"))
    with pytest.raises(InputError, match="no link 'no_link'"):
        imported(path, srdf=srdf)


def test_joint_limits_of_moveit_are_taken(tmp_path: Path) -> None:
    """The lower of both speeds; limits that are switched off do not count."""
    path = urdf_of("iiwa7", tmp_path)
    robot = load_robot("iiwa7").robot
    one, two, three = robot.joints[:3]
    limits = tmp_path / "joint_limits.yaml"
    limits.write_text(
        "joint_limits:\n"
        f"  {one}: {{has_velocity_limits: true, max_velocity: 0.5, max_acceleration: 4.0}}\n"
        f"  {two}: {{max_velocity: 99.0, has_acceleration_limits: false, max_acceleration: 4.0}}\n"
        f"  {three}: {{has_acceleration_limits: true, max_acceleration: 3.0, has_jerk_limits: true, max_jerk: 30.0}}\n"
    )
    found = imported(path, joint_limits=limits).loaded.robot.limits
    assert found.velocity[:2].tolist() == [0.5, robot.limits.velocity[1]]
    assert found.acceleration[0] == 4.0
    assert found.acceleration[1] == pytest.approx(robot.limits.velocity[1] / 0.3)
    assert (found.acceleration[2], found.jerk[2]) == (3.0, 30.0)


def test_packages_beside_the_urdfs_own_are_found_by_their_package_xml(tmp_path: Path) -> None:
    """A ROS workspace: the description names meshes of its own package and of its neighbour."""
    (tmp_path / "src/arm_description/urdf/real").mkdir(parents=True)
    (tmp_path / "src/arm_meshes").mkdir()
    (tmp_path / "src/arm_description/part.obj").write_text(TETRAHEDRON)
    (tmp_path / "src/arm_meshes/part.obj").write_text(TETRAHEDRON)
    path = urdf_of("iiwa7", tmp_path / "src/arm_description/urdf/real")
    link = re.findall(r'<link name="([^"]*)"', path.read_text())[3]
    solids = "".join(
        f'<collision><geometry><mesh filename="package://{name}/part.obj"/></geometry></collision>'
        for name in ("arm_description", "arm_meshes")
    )
    text = path.read_text()
    path.write_text(text.replace(f'<link name="{link}">', f'<link name="{link}">{solids}', 1))
    with pytest.raises(InputError, match="package 'arm_meshes' is not in the folder"):
        imported(path)
    (tmp_path / "src/arm_meshes/package.xml").write_text("<package/>")
    assert len(imported(path).loaded.robot.meshes[link]) == 2
    path.write_text(path.read_text().replace("package://", "package:///"))
    assert len(imported(path).loaded.robot.meshes[link]) == 2


def test_meshes_come_along_as_their_hulls(tmp_path: Path) -> None:
    """The folder needs nothing from elsewhere: the package may be gone afterwards."""
    package = tmp_path / "elsewhere" / "arm_meshes"
    package.mkdir(parents=True)
    (package / "part.obj").write_text(TETRAHEDRON)
    path = urdf_of("iiwa7", tmp_path)
    text = path.read_text()
    link = re.findall(r'<link name="([^"]*)"', text)[3]
    mesh = '<mesh filename="package://arm_meshes/part.obj" scale="2 2 2"/>'
    solid = f'<link name="{link}"><collision><origin xyz="0 0 1"/><geometry>{mesh}</geometry></collision>'
    path.write_text(text.replace(f'<link name="{link}">', solid, 1))
    with pytest.raises(InputError, match="--package-dir"):
        imported(path)
    found = imported(path, packages=(tmp_path / "elsewhere",))
    (package / "part.obj").unlink()
    folder = tmp_path / "robot"
    for name, content in found.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
    (shape,) = load_robot(folder / "robot.yaml").robot.meshes[link]
    assert shape.hull is not None
    corners = sorted(shape.hull.corners.round(6).tolist())
    assert corners == sorted([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 0.2]])
    assert shape.pose.translation.tolist() == [0.0, 0.0, 1.0]


def test_a_tree_that_leaves_a_choice_says_which_options_settle_it(tmp_path: Path) -> None:
    """YuMi with arms whose names tell no side."""
    path = urdf_of("yumi", tmp_path)
    robot = load_robot("yumi").robot
    text = path.read_text()
    for arm, letter in zip(robot.arms, "ab", strict=True):
        for k, joint in enumerate(arm.joints):
            text = text.replace(f'name="{joint}"', f'name="axis_{letter}{k}"')
    text = re.sub(r"left|right", lambda m: {"left": "unit_a", "right": "unit_b"}[m[0]], text)
    path.write_text(text)
    with pytest.raises(UsageError, match="--left-tip and --right-tip") as refused:
        imported(path)
    tips = re.findall(r"ending in (.*);", str(refused.value))[0].split(", ")
    assert len(tips) == 2
    settled = imported(path, tips={"left": tips[1], "right": tips[0]}).loaded.robot
    assert settled.arm("left").flange == tips[1]
    assert len(settled.arm("left").joints) == len(robot.arms[0].joints)


@pytest.mark.parametrize(
    ("tips", "platform", "message"),
    [
        ({"left": "left_tool"}, None, "--left-tip: the URDF has no link 'left_tool', did you mean 'left_tool0'?"),
        ({}, ("left_s",), "--platform: 'left_s' does not carry both arms; these do: torso_b1"),
        ({"left": "torso_link_b1"}, None, "is moved by 1 joint (torso_b1)"),
    ],
)  # fmt: skip
def test_wrong_names_are_refused(
    tips: dict[str, str], platform: tuple[str, ...] | None, message: str, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=re.escape(message)):
        imported(urdf_of("sda10f", tmp_path), tips=tips, platform=platform)


def test_a_platform_may_be_left_out(tmp_path: Path) -> None:
    """Its joint is then fixed, which a note says."""
    found = imported(urdf_of("sda10f", tmp_path), platform=())
    assert found.loaded.robot.platform == ()
    assert any("fixed: torso_b1 at 0" in note for note in found.loaded.notes)


def test_xacro_without_the_library_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "xacro", None)
    path = tmp_path / "arm.urdf.xacro"
    path.write_text('<robot name="a"><xacro:macro name="m"/></robot>')
    with pytest.raises(MissingDependencyError, match=r"dualarm\[xacro\]"):
        imported(path)


def test_the_command_writes_a_folder_that_plans(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From a URDF to a verified plan, the robot file as it was written; a second import replaces nothing unasked."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dualarm.toml").write_text("")
    urdf = urdf_of("nextage", tmp_path)
    assert run(["robot", "import", str(urdf), "--out", "mine"]) == 0
    out = capsys.readouterr()
    assert "left arm: left_0, left_1" in out.out + out.err
    robot = load_robot("mine").robot
    (tmp_path / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot: mine/robot.yaml\nclearance: 2 mm\n"
    )
    moves = []
    for arm in robot.arms:
        home = robot.postures["home"][robot.columns(arm.joints)]
        near = np.round(home + 0.05, 4).tolist()
        moves.append(f"  - {{id: {arm.name}, arm: {arm.name}, move: {{joints: {near}}}}}\n")
    tasks = "dualarm: tasks/1\ncell: cell.yaml\nreturn: true\ntasks:\n" + "".join(moves)
    (tmp_path / "tasks.yaml").write_text(tasks)
    assert run(["plan", "tasks.yaml", "--effort", "quick", "--out", "plan", "--quiet"]) == 0
    report = json.loads((tmp_path / "plan/report.json").read_text())
    assert report["verification"]["passed"]
    assert report["smallest_clearance"] is not None
    assert run(["robot", "import", str(urdf), "--out", "mine"]) == 2
    assert "add --force" in capsys.readouterr().err
    assert run(["robot", "import", str(urdf), "--out", "mine", "--force", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["robot"] == "mine/robot.yaml"


def test_on_a_terminal_it_asks_which_arm_is_which(tmp_path: Path) -> None:
    """YuMi with names that tell no side, its right arm called left: the answers decide."""
    text = load_robot("yumi").robot.urdf
    plain = re.sub(r"left|right", lambda m: {"left": "unit_a", "right": "unit_b"}[m[0]], text)
    (tmp_path / "yumi.urdf").write_text(plain)
    arms = [arm.flange for arm in load_robot("yumi").robot.arms]
    a, b = (re.sub("left|right", f"unit_{x}", tip) for x, tip in zip("ab", arms, strict=True))
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "dualarm_cli", "robot", "import", "yumi.urdf", "--out", "mine"]
    with subprocess.Popen(command, cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=theirs) as run:
        os.close(theirs)
        os.write(ours, f"{b}\nnobody\n{a}\n".encode())
        told = b""
        with contextlib.suppress(OSError):  # what Linux raises when the other end is closed
            while part := os.read(ours, 4096):
                told += part
    os.close(ours)
    assert run.returncode == 0, told.decode()
    assert "'nobody' is not one of" in told.decode()
    robot = load_robot(tmp_path / "mine/robot.yaml").robot
    assert (robot.arm("left").flange, robot.arm("right").flange) == (b, a)
