"""`dualarm robot list|show|export` and `dualarm solvers`."""

from __future__ import annotations

import json

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
    text = capsys.readouterr().out
    assert "measured deviation" in text
    assert "assumed" in text


JOINTS = {
    "sda10f": 15,
    "bottin_planar": 15,
    "iiwa14": 7,
    "openarm": 14,
    "yumi": 14,
    "nextage": 13,
    "amiro_like": 16,
}


@pytest.mark.parametrize("name", ["yumi", "nextage"])
def test_show_says_that_an_arm_is_of_general_kind(name, capsys):
    """No shoulder, elbow and wrist are measured where there are none."""
    assert run(["robot", "show", name, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    axes = {"yumi": 7, "nextage": 6}[name]
    for arm in document["arms"].values():
        assert arm["summary"] == f"kind general, {axes} axes"
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
        ("timing", "ruckig"),
        ("timing", "toppra"),
        ("timing", "trapezoid"),
    } <= names
    assert all(row["reference"] and row["summary"] for row in rows)
