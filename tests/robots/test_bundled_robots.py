"""What holds for every bundled robot."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import bundled_robots, robots_folder
from dualarm_cli.model.robot import Arm, Robot

Axes = Callable[[pin.Model, tuple[str, ...], np.ndarray], tuple[np.ndarray, ...]]

ROBOTS = [
    "amiro_like",
    "bottin_planar",
    "iiwa14",
    "iiwa7",
    "nextage",
    "openarm",
    "qin_150",
    "sda10f",
    "yumi",
]
# Described by tables of parameters in their robot file, without a URDF.
TABLES = ["qin_150"]

SQRT3 = 3.0**0.5
# Shoulder, elbow, wrist centre at q = 0 [m]: for the planar robot 50, 120 and 190 mm from the
# platform's axis, the right arm turned by 120 deg; for the iiwas the sums of the links' lengths; for
# AMIRO 0.700 m in two halves below shoulders at 0.75 + 0.57 m.
CENTRES = {
    ("amiro_like", "left"): [(0, 0.22, 1.32), (0, 0.22, 0.97), (0, 0.22, 0.62)],
    ("amiro_like", "right"): [(0, -0.22, 1.32), (0, -0.22, 0.97), (0, -0.22, 0.62)],
    ("bottin_planar", "left"): [(0.05, 0, 0), (0.12, 0, 0), (0.19, 0, 0)],
    ("bottin_planar", "right"): [
        (-0.5 * reach, SQRT3 / 2 * reach, 0.0) for reach in (0.05, 0.12, 0.19)
    ],
    ("iiwa14", "left"): [(0, 0, 0.36), (0, 0, 0.78), (0, 0, 1.18)],
    ("iiwa7", "left"): [(0, 0, 0.34), (0, 0, 0.74), (0, 0, 1.14)],
    ("openarm", "left"): [(0, 0.1535, 0.698), (0, 0.1535, 0.478), (0, 0.1535, 0.262)],
    ("openarm", "right"): [(0, -0.1535, 0.698), (0, -0.1535, 0.478), (0, -0.1535, 0.262)],
    ("sda10f", "left"): [(0.1, 0.265, 1.2), (0.1, 0.625, 1.2), (0.1, 0.985, 1.2)],
    ("sda10f", "right"): [(0.1, -0.265, 1.2), (0.1, -0.625, 1.2), (0.1, -0.985, 1.2)],
}
# Upper arm and forearm together [m] of the arms without such centres.
REACH = {"nextage": 0.250 + 0.235, "qin_150": 1.200 + 1.050, "yumi": 0.2515 + 0.265}


def _arms(robot: Robot) -> dict[str, Arm]:
    return {arm.name: arm for arm in robot.arms}


def test_the_bundled_robots_are_these() -> None:
    """A robot added to the folder has to be added to these tests."""
    assert bundled_robots() == ROBOTS


@pytest.mark.parametrize("name", ROBOTS)
def test_pinocchio_reads_the_urdf_with_one_position_per_moving_joint(
    name: str, pin_model: Callable[[str], pin.Model], urdf_tree: Callable[[str], ET.Element]
) -> None:
    """No joint is continuous, floating or a mimic; none is lost."""
    joints = [j for j in urdf_tree(name).iter("joint") if j.get("type") != "fixed"]
    model = pin_model(name)
    assert {joint.get("type") for joint in joints} == {"revolute"}
    assert [joint.get("name") for joint in joints] == list(model.names)[1:]
    assert model.nq == model.nv == len(joints)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_loader_takes_every_joint_and_limit_of_the_urdf(
    name: str, pin_model: Callable[[str], pin.Model]
) -> None:
    """Nothing is fixed, widened or reordered on the way; every joint has assumed rates."""
    loaded = load_robot(name)
    limits, model = loaded.robot.limits, pin_model(name)
    assert loaded.notes == ()
    assert list(loaded.robot.joints) == list(model.names)[1:]
    np.testing.assert_array_equal(limits.lower, model.lowerPositionLimit)
    np.testing.assert_array_equal(limits.upper, model.upperPositionLimit)
    np.testing.assert_array_equal(limits.velocity, model.velocityLimit)
    assert np.isfinite(limits.acceleration).all()
    assert set(limits.source) == {"assumed"}
    if name == "qin_150":  # the paper's motion is trapezoidal
        assert np.isinf(limits.jerk).all()
        return
    # Every other robot file assumes a jerk of ten times the acceleration per second.
    np.testing.assert_allclose(limits.jerk, 10.0 * limits.acceleration, rtol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_every_posture_is_well_inside_the_limits(name: str) -> None:
    """A job that starts in a posture needs room: at least 9 deg in every joint."""
    robot = load_robot(name).robot
    assert "home" in robot.postures
    for posture, q in robot.postures.items():
        room = np.minimum(q - robot.limits.lower, robot.limits.upper - q)
        assert room.min() > np.radians(9.0), posture


@pytest.mark.parametrize("name", ROBOTS)
def test_home_is_not_named_by_accident(name: str) -> None:
    """The loader invents a home of zeros where the file has none; every bundled file has one."""
    assert np.abs(load_robot(name).robot.postures["home"]).max() > 0.1


@pytest.mark.parametrize("name", ROBOTS)
def test_no_arm_is_singular_at_home(name: str) -> None:
    """Smallest singular value of the Jacobian, lengths over the arm's reach, far from 0."""
    robot = load_robot(name).robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    q = np.array(robot.postures["home"])
    for arm in robot.arms:
        frame = model.getFrameId(arm.flange)
        reach = REACH.get(name)
        if reach is None:
            centres = np.array(CENTRES[name, arm.name], dtype=float)
            reach = np.linalg.norm(np.diff(centres, axis=0), axis=1).sum()
        jacobian = pin.computeFrameJacobian(model, data, q, frame)[:, robot.columns(arm.joints)]
        jacobian[:3] /= reach
        assert np.linalg.svd(jacobian, compute_uv=False).min() > 0.2, arm.name


@pytest.mark.parametrize(("name", "side"), CENTRES)
def test_axes_meet_in_shoulder_elbow_and_wrist(
    name: str, side: str, pin_model: Callable[[str], pin.Model], joint_axes: Axes
) -> None:
    """Axes 1-3, 3-5, 5-7 pass through the published centres, consecutive ones at right angles."""
    arm = _arms(load_robot(name).robot)[side]
    assert arm.kind == "srs"
    model = pin_model(name)
    axes, points = joint_axes(model, arm.joints, np.zeros(model.nq))
    for first, centre in zip((0, 2, 4), np.array(CENTRES[name, side], dtype=float), strict=True):
        across = np.cross(axes[first : first + 3], centre - points[first : first + 3])
        assert np.linalg.norm(across, axis=1).max() < 1e-12
    assert np.abs((axes[:-1] * axes[1:]).sum(axis=1)).max() < 1e-12


def test_every_arm_has_its_centres_listed_here() -> None:
    """The check of the centres leaves out the arms of the robots without centres, and no other."""
    arms = {(name, arm) for name in ROBOTS for arm in load_robot(name).robot.arms}
    assert {(name, arm.name) for name, arm in arms if arm.kind == "srs"} == set(CENTRES)
    assert {name for name, arm in arms if arm.kind != "srs"} == set(REACH)


@pytest.mark.parametrize("name", ROBOTS)
def test_no_mesh_is_needed(name: str, urdf_path: Callable[[str], Path]) -> None:
    """Primitive geometry only, so that one file is the whole robot."""
    text = urdf_path(name).read_text(encoding="utf-8")
    assert "mesh" not in text
    assert "package://" not in text
    files = ["robot.yaml"] if name in TABLES else [f"{name}.urdf", "robot.yaml"]
    folder = robots_folder() / name
    assert sorted(path.name for path in folder.iterdir()) == sorted(files)


@pytest.mark.parametrize("name", ROBOTS)
def test_inertias_are_those_of_possible_bodies(
    name: str, urdf_tree: Callable[[str], ET.Element]
) -> None:
    """Positive mass, and no principal moment above the sum of the other two."""
    for inertial in urdf_tree(name).iter("inertial"):
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None
        assert inertia is not None
        xx, xy, xz, yy, yz, zz = (
            float(inertia.attrib[f"i{key}"]) for key in ("xx", "xy", "xz", "yy", "yz", "zz")
        )
        moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        assert float(mass.attrib["value"]) > 0.0
        assert 0.0 < moments[2] <= moments[0] + moments[1]
