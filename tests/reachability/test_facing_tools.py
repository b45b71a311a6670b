"""Hand-over poses, checked with pinocchio and coal: tools that face each other, clear bodies, lines to draw back."""

from __future__ import annotations

import json

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.collision.solids import cell_solids, geometry_model, pairs_that_must_keep_apart
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.reachability.facing_tools import FACING, handover_poses
from dualarm_cli.robot_import.contacts import bare_cell
from dualarm_cli.robot_import.proposed_tool import with_tools

DISTANCE = 0.08


@pytest.fixture(scope="module", params=["amiro_like", "yumi"])
def meeting(request):
    """Returns a cell with proposed tools, and its hand-over poses: closed forms, and inverse kinematics by search."""
    cell, _ = with_tools(bare_cell(load_robot(request.param).robot))
    return cell, handover_poses(cell, DISTANCE)


def tool_poses(cell, pose):
    """Computes the tools of both arms with pinocchio, and the model's configuration."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    q = pin.neutral(model)
    joints = dict(zip(cell.robot.joints, cell.robot.postures["home"], strict=True))
    for arm in cell.robot.arms:
        joints |= dict(zip(arm.joints, pose.q[arm.name], strict=True))
    for name, value in joints.items():
        q[model.joints[model.getJointId(name)].idx_q] = value
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    tools = {
        arm.name: cell.base * data.oMf[model.getFrameId(arm.flange)] * cell.tools[arm.name].tcp
        for arm in cell.robot.arms
    }
    return tools, model, q


def test_tools_face_each_other_at_every_pose(meeting):
    """The joints reach the poses; the z axes are opposite, and one tool is ahead of the other by the distance."""
    cell, poses = meeting
    assert 3 <= len(poses) <= FACING.poses
    lower, upper = cell.robot.limits.lower, cell.robot.limits.upper
    for pose in poses:
        tools, _, q = tool_poses(cell, pose)
        assert ((q >= lower) & (q <= upper)).all()
        for arm, (R, p) in pose.tools.items():
            assert tools[arm].isApprox(pin.SE3(R, p), 1e-8)
        grip = pin.SE3(pin.rpy.rpyToMatrix(np.pi, 0.0, pose.turn), np.array([0.0, 0.0, DISTANCE]))
        assert (tools["left"].actInv(tools["right"])).isApprox(grip, 1e-8)
        assert (tools["right"].actInv(tools["left"])).isApprox(grip, 1e-8)
        assert np.degrees(pose.turn) % 90.0 == pytest.approx(0.0)


def test_bodies_keep_their_clearance_at_every_pose(meeting):
    """Of the robot, its tools and both arms, by coal."""
    cell, poses = meeting
    for pose in poses:
        _, model, q = tool_poses(cell, pose)
        solids = cell_solids(cell, model, ())
        pairs = [
            (pair.first, pair.second) for pair in pairs_that_must_keep_apart(model, solids, cell)
        ]
        geometry = geometry_model(solids, pairs)
        results = pin.GeometryData(geometry)
        assert not pin.computeCollisions(model, model.createData(), geometry, results, q, False)


def test_poses_are_apart_and_the_best_is_level(meeting):
    """No two are alike; level tools are among them."""
    _, poses = meeting
    scores = [pose.score for pose in poses]
    assert scores == sorted(scores, reverse=True)
    places = np.array(
        [[*p, *(FACING.lever * R[:, 2])] for R, p in (pose.tools["left"] for pose in poses)]
    )
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert gaps[np.triu_indices(len(poses), 1)].min() >= FACING.apart - 1e-9
    assert min(abs(pose.tools["left"][0][2, 2]) for pose in poses) < 1e-9


JOB = """\
dualarm: tasks/1
cell: cell.yaml
order: given
start: free
defaults: {{approach: 60 mm, retract: 60 mm, dwell: 0.1 s, part: rod}}
tasks:
  - id: pass
    arm: {giver}
    pick: {{xyz: [0.45, {y}, 0.85], rpy: [180 deg, 0, 0], free: yaw}}
    {handover}
    place: {{xyz: [0.45, -{y}, 0.85], rpy: [180 deg, 0, 0], free: yaw}}
"""
CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left: {tcp: {xyz: [0, 0, 115 mm]}, shapes: [{capsule: {radius: 30 mm, length: 55 mm}, xyz: [0, 0, 57.5 mm]}]}
  right: {tcp: {xyz: [0, 0, 115 mm]}, shapes: [{capsule: {radius: 30 mm, length: 55 mm}, xyz: [0, 0, 57.5 mm]}]}
parts: {rod: {shapes: [{box: [20 mm, 20 mm, 70 mm], xyz: [0, 0, 40 mm]}]}}
"""


def test_the_first_pose_is_pasted_and_planned(tmp_path, monkeypatch, capsys):
    """The line as it is printed, with either arm that gives."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cell.yaml").write_text(CELL)
    words = [
        "robot",
        "reach",
        "cell.yaml",
        "--height",
        "0.8",
        "--step",
        "0.2",
        "--handover",
        "80 mm",
    ]
    assert run(words) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if "handover:" in line]
    for giver, y in (("left", "0.45"), ("right", "-0.45")):
        handover = next(line for line in lines if line.endswith(giver))
        text = JOB.format(giver=giver, y=y, handover=handover).replace("--", "")
        (tmp_path / "tasks.yaml").write_text(text)
        assert run(["plan", "tasks.yaml", "--effort", "quick", "--out", giver]) == 0
        assert "verification: passed" in capsys.readouterr().out


def test_bundled_openarms_pass_a_rod_at_the_first_pose(tmp_path, monkeypatch, capsys):
    """With grippers as init writes them: the rod reaches from one tool centre point to the other one's."""
    monkeypatch.chdir(tmp_path)
    tool = "{tcp: {xyz: [0, 0, 80 mm]}, shapes: [{capsule: {radius: 20 mm, length: 40 mm}, xyz: [0, 0, 40 mm]}]}"
    rod = "{shapes: [{box: [16 mm, 16 mm, 100 mm], xyz: [0, 0, 50 mm]}]}"
    cell = f"dualarm: cell/1\nrobot: openarm\ntools:\n  left: {tool}\n  right: {tool}\nparts: {{rod: {rod}}}\n"
    (tmp_path / "cell.yaml").write_text(cell)
    assert run(["robot", "reach", "cell.yaml", "--step", "0.2", "--handover", "100 mm"]) == 0
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if "handover:" in line]
    text = JOB.format(giver="left", y="0.15", handover=lines[0])
    text = text.replace("0.45, ", "0.2, ").replace("0.85", "0.525").replace("--", "")
    (tmp_path / "tasks.yaml").write_text(text)
    assert run(["plan", "tasks.yaml", "--effort", "quick", "--no-page"]) == 0
    assert "verification: passed" in capsys.readouterr().out


def test_the_document_has_both_tools_and_the_joints(capsys):
    """Joints by name, poses of both tools, and the grip; without the option no poses."""
    words = ["robot", "reach", "openarm", "--height", "0.5", "--step", "0.2", "--json"]
    assert run(words) == 0
    assert "handovers" not in json.loads(capsys.readouterr().out)
    assert run([*words, "--handover", "0.08"]) == 0
    document = json.loads(capsys.readouterr().out)
    row = document["handovers"][0]
    assert document["handover_distance"] == 0.08
    assert row["grip"]["xyz"] == [0.0, 0.0, 0.08]
    for arm in load_robot("openarm").robot.arms:
        assert tuple(row["joints"][arm.name]) == arm.joints
    left, right = row["tools"].values()
    z = pin.rpy.rpyToMatrix(*left["rpy"])[:, 2]
    assert np.array(left["xyz"]) + 0.08 * z == pytest.approx(np.array(right["xyz"]), abs=1e-9)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["iiwa7", "--handover", "80 mm"], "has one arm only; a hand-over needs two"),
        (["yumi", "--handover", "-1 mm"], "--handover -0.001 m: must be from 0 to"),
        (["yumi", "--handover", "far"], "--handover: 'far'"),
    ],
)
def test_other_distances_are_refused(words, said, capsys):
    """Exit code 2, a sentence."""
    assert run(["robot", "reach", *words]) == 2
    assert said in capsys.readouterr().err


def test_tools_that_cannot_meet_say_so(capsys):
    """No pose is within reach of both."""
    assert (
        run(["robot", "reach", "openarm", "--height", "0.5", "--step", "0.2", "--handover", "0.8"])
        == 0
    )
    assert "no hand-over with the tools 800 mm apart was found" in capsys.readouterr().out
