"""`dualarm robot list|show|export` and `dualarm solvers`."""

from __future__ import annotations

import json
import math

import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run


def test_list_names_every_bundled_robot(capsys):
    """The SDA10F and the paper's robot among them, with their arms."""
    assert run(["robot", "list", "--json"]) == 0
    rows = {row["robot"]: row for row in json.loads(capsys.readouterr().out)["robots"]}
    assert {"sda10f", "bottin_planar", "iiwa14", "openarm", "yumi", "nextage"} <= set(rows)
    assert rows["sda10f"]["platform_joints"] == 1
    assert rows["iiwa14"]["arms"] == {"left": "7 axes, srs"}
    assert rows["nextage"]["arms"] == {"left": "6 axes, general", "right": "6 axes, general"}
    assert rows["amiro_like"]["platform_joints"] == 2


def test_show_gives_limits_their_source_and_the_measured_geometry(capsys):
    """R0 = 283.24 mm, alpha = 138.651 deg, links 360 mm: published figures of the SDA10F."""
    assert run(["robot", "show", "sda10f", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    left, right = document["arms"]["left"], document["arms"]["right"]
    assert left["shoulder_radius"] == pytest.approx(0.283240, abs=1e-6)
    assert left["shoulder_azimuth"] - right["shoulder_azimuth"] == pytest.approx(2.419916, abs=1e-5)
    assert left["upper"] == pytest.approx(0.360, abs=1e-12)
    assert left["is_srs"]
    assert document["joints"]["left_s"]["source"] == "assumed"
    assert run(["robot", "show", "sda10f"]) == 0
    short = capsys.readouterr().out
    assert "measured deviation" not in short
    assert "postures: home, rest, zero: -v has values" in short
    assert run(["robot", "show", "sda10f", "-v"]) == 0
    text = capsys.readouterr().out
    assert "measured deviation" in text
    assert "assumed" in text
    assert "left flange: link left_tool0" in text
    # Accelerations are in degrees, as the speeds beside them.
    row = next(line for line in text.splitlines() if " left_s " in line)
    acceleration = document["joints"]["left_s"]["acceleration"]
    assert f"{acceleration * 180 / math.pi:.1f}" in row
    assert document["posture_values"]["zero"] == dict.fromkeys(document["joints"], 0.0)
    assert "posture zero: all joints 0" in text
    rest = document["posture_values"]["rest"]["left_s"]
    assert f"posture rest: left_s {rest * 180 / math.pi:.4g}°" in text


JOINTS = {
    "sda10f": 15,
    "bottin_planar": 15,
    "iiwa14": 7,
    "openarm": 14,
    "yumi": 14,
    "nextage": 13,
    "amiro_like": 16,
    "qin_150": 6,
}


@pytest.mark.parametrize("name", ["yumi", "nextage"])
def test_show_says_that_an_arm_is_of_general_kind(name, capsys):
    """No shoulder, elbow and wrist are measured where there are none."""
    assert run(["robot", "show", name, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    axes = {"yumi": 7, "nextage": 6}[name]
    for arm in document["arms"].values():
        assert arm["summary"].startswith(f"kind general, {axes} axes")
        assert "upper" not in arm
    assert document["notes"] == []


@pytest.mark.parametrize("name", JOINTS)
def test_export_writes_a_urdf_that_other_tools_load(name, tmp_path, capsys):
    """Pinocchio loads it with as many joints as the robot has; an existing file is not replaced."""
    file = tmp_path / "robot.urdf"
    assert run(["robot", "export", name, "--out", str(file)]) == 0
    model = pin.buildModelFromXML(file.read_text())
    assert model.nq == JOINTS[name]
    assert run(["robot", "export", name, "--out", str(file)]) == 2
    assert "add --force" in capsys.readouterr().err


def test_solvers_lists_every_family_with_references(capsys):
    """The words of the command line, each with where it comes from."""
    assert run(["solvers", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["solvers"]
    names = {(row["family"], row["name"]) for row in rows}
    assert {
        ("platform", "fixed"),
        ("platform", "linearised"),
        ("platform", "exact"),
        ("redundancy", "arm_angle"),
        ("redundancy", "numeric"),
        ("method", "sequence"),
        ("timing", "ruckig"),
        ("timing", "toppra"),
        ("timing", "trapezoid"),
    } <= names
    assert all(row["reference"] and row["summary"] for row in rows)


def test_show_says_what_serves_arms_that_are_not_srs(general_robots, tmp_path, capsys):
    """The YuMi's offsets of its data sheet: 30, 30, 41.88, 40.5, 27, 27 mm; six axes without a wrist centre."""
    general_robots.YUMI.write(tmp_path)
    assert run(["robot", "show", str(tmp_path / "robot.yaml"), "--json"]) == 0
    left = json.loads(capsys.readouterr().out)["arms"]["left"]
    assert left["inverse_kinematics"] == "numeric"
    assert not left["is_srs"]
    assert "each other by 30, 30, 41.9, 40.5, 27, 27 mm" in left["summary"]
    general_robots.NEXTAGE.write(tmp_path)
    assert run(["robot", "show", str(tmp_path / "robot.yaml")]) == 0
    text = capsys.readouterr().out
    assert (
        "left arm: kind general, 6 axes; its last three axes miss a common point by 45 mm" in text
    )
    assert "inverse kinematics: numeric" in text
    assert run(["robot", "show", "sda10f", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["arms"]["left"]["inverse_kinematics"] == "arm_angle"


def test_show_tells_of_the_closed_forms_of_a_spherical_wrist(general_robots, tmp_path, capsys):
    """Eight branches where it is called by its kind; called general it is told what it might be."""
    general_robots.SPHERICAL.write(tmp_path)
    file = tmp_path / "robot.yaml"
    assert run(["robot", "show", str(file), "--json"]) == 0
    left = json.loads(capsys.readouterr().out)["arms"]["left"]
    assert (left["inverse_kinematics"], left["branches"]) == ("closed_form", 8)
    assert left["shoulder"] == "elbow"
    assert "axes 2 and 3 are parallel" in left["summary"]
    assert left["summary"].endswith("inverse kinematics: closed form (eight branches)")
    file.write_text(file.read_text().replace("kind: spherical_wrist", "kind: general"))
    assert run(["robot", "show", str(file), "--json"]) == 0
    left = json.loads(capsys.readouterr().out)["arms"]["left"]
    assert left["inverse_kinematics"] == "numeric"
    assert "kind spherical_wrist has closed forms for it" in left["summary"]


def test_show_tells_of_parallel_axes_that_are_measured(general_robots, tmp_path, capsys):
    """A UR5 whose file says nothing of its kind; called general it is told; calibrated (1e-3 rad) it is general."""
    general_robots.UR5.write(tmp_path)
    file, urdf = tmp_path / "robot.yaml", tmp_path / "robot.urdf"
    text = file.read_text()
    for kind, words, served in (
        (
            "",
            "kind parallel_axes, 6 axes; its axes 2, 3 and 4 are parallel; inverse",
            "closed_form",
        ),
        (", kind: general", "kind parallel_axes has closed forms for it", "numeric"),
    ):
        file.write_text(text.replace(", kind: parallel_axes", kind))
        assert run(["robot", "show", str(file), "--json"]) == 0
        left = json.loads(capsys.readouterr().out)["arms"]["left"]
        assert left["inverse_kinematics"] == served
        assert words in left["summary"]
    bent = urdf.read_text().replace(
        'xyz="0 -0.1197 0.425" rpy="0 0 0"', 'xyz="0 -0.1197 0.425" rpy="0.001 0 0"'
    )
    urdf.write_text(bent)
    file.write_text(text.replace(", kind: parallel_axes", ""))
    assert run(["robot", "show", str(file), "--json"]) == 0
    left = json.loads(capsys.readouterr().out)["arms"]["left"]
    assert (left["kind"], left["inverse_kinematics"]) == ("general", "numeric")
    assert "not parallel by 0.001 rad" in left["summary"]
    file.write_text(text)
    assert run(["check", str(file)]) == 2
    words = capsys.readouterr()
    assert (
        "has kind: parallel_axes, but its axes 2, 3 and 4 are not parallel by 0.001 rad"
        in words.out + words.err
    )


def test_check_measures_a_spherical_wrist(general_robots, tmp_path, capsys):
    """Good where there is one; the Nextage's 45 mm are told where it is called one."""
    general_robots.SPHERICAL.write(tmp_path)
    assert run(["check", str(tmp_path / "robot.yaml")]) == 0
    general_robots.NEXTAGE.write(tmp_path)
    file = tmp_path / "robot.yaml"
    file.write_text(file.read_text().replace("kind: general", "kind: spherical_wrist"))
    assert run(["check", str(file)]) == 2
    words = capsys.readouterr()
    assert "has kind: spherical_wrist" in words.out + words.err
    assert "45 mm" in words.out + words.err


def test_a_general_robot_is_planned_by_the_plain_command(general_robots, tmp_path, capsys):
    """Exit 0 with a note; exit 3 with task, arm and miss; exit 2 with the reason for a method that was named."""
    file = general_robots.write_cell(tmp_path, "spherical", tasks=1)
    out = ["--out", str(tmp_path / "plan"), "--force", "--effort", "quick"]
    assert run(["plan", str(file), *out, "-v"]) == 0
    text = capsys.readouterr().out
    assert "planned with redundancy numeric" in text.replace("\n", " ")
    settings = json.loads((tmp_path / "plan" / "schedule.json").read_text())["provenance"][
        "settings"
    ]
    assert (settings["platform"], settings["redundancy"]) == ("sequence", "numeric")
    assert "named" not in settings
    assert run(["plan", str(file), *out, "--platform", "exact"]) == 2
    assert "platform exact cannot plan Two six-axis arms" in capsys.readouterr().err
    file.write_text(file.read_text().replace("[0.45, 0.2, 0.1]", "[1.2, 0.3, 0.4]"))
    assert run(["plan", str(file), *out]) == 3
    error = capsys.readouterr().err.replace("\n", " ")
    assert "task 'left 0': left arm cannot pick" in error
    assert "mm with the required orientation" in error
    assert "; move the target or free its yaw" in error
    file.write_text(file.read_text().replace("deg, 0, 0]}", "deg, 0, 0], free: yaw}"))
    assert run(["plan", str(file), *out]) == 3
    # Nobody is told to free what is free already.
    error = capsys.readouterr().err.replace("\n", " ")
    assert "; move the target" in error
    assert "free its yaw" not in error


def test_an_arm_of_five_axes_is_described_and_refused(general_robots, tmp_path, capsys):
    """It cannot hold a tool in any pose."""
    robot = general_robots.SPHERICAL
    rows = general_robots.spherical_wrist_arm
    tool = general_robots.FORWARD
    chains = [
        general_robots.chain(side, rows(sign)[:5], "base", tool)
        for side, sign in (("left", 1), ("right", -1))
    ]
    home = {side: values[:5] for side, values in robot.home.items()}
    urdf = f'<robot name="r"><link name="base"/>{chains[0]}{chains[1]}</robot>'
    five = general_robots.GeneralRobot("Five", urdf, "general", False, home)
    file = general_robots.write_cell(tmp_path, "spherical", tasks=1)
    five.write(tmp_path)
    assert run(["robot", "show", str(tmp_path / "robot.yaml")]) == 0
    assert "not planned: arm left of Five: the arm has 5 joints" in capsys.readouterr().out
    assert run(["plan", str(file), "--out", str(tmp_path / "plan")]) == 2
    assert "6 are needed to hold a tool in any pose" in capsys.readouterr().err


def test_a_robot_of_a_single_joint_is_refused_too(tmp_path, capsys):
    """Jacobians with one column are no special case."""
    (tmp_path / "dualarm.toml").touch()
    (tmp_path / "one.urdf").write_text(
        '<robot name="one"><link name="base"/><link name="tip"/><joint name="j" type="revolute">'
        '<parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="2" effort="1"/></joint></robot>'
    )
    (tmp_path / "robot.yaml").write_text(
        "dualarm: robot/1\nname: One\nurdf: one.urdf\n"
        "arms: {left: {joints: [j], flange: tip, kind: general}}\n"
        "limits: {j: {acceleration: 1 rad/s^2, jerk: 9 rad/s^3, source: assumed}}\n"
    )
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: robot.yaml\n")
    file = tmp_path / "tasks.yaml"
    file.write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nstart: free\n"
        "tasks: [{id: a, arm: left, move: {joints: [0.5]}}]\n"
    )
    assert run(["plan", str(file), "--out", str(tmp_path / "plan")]) == 2
    assert "the arm has 1 joints; 6 are needed" in capsys.readouterr().err
