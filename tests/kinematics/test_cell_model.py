"""The platform chain and the arms on it, against pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.kinematics.cell_model import CellModel, find_false_kinds
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.parallel_arm import ParallelArm
from dualarm_cli.kinematics.platform_chain import PlatformChain
from dualarm_cli.kinematics.wrist_arm import WristArm
from dualarm_cli.model.cell import Cell, Tool

ROOT = Path(__file__).parents[2]

TILTED_WAIST = """<robot name="waist"><link name="root"/><link name="one"/><link name="two"/>
<joint name="yaw" type="revolute"><parent link="root"/><child link="one"/><origin xyz="0.1 0.2 0.3" rpy="0.3 0.1 -0.4"/>
<axis xyz="0 0.6 0.8"/><limit lower="-3" upper="3" velocity="1" effort="0"/></joint>
<joint name="lift" type="prismatic"><parent link="one"/><child link="two"/><origin xyz="0 0.1 0.5" rpy="-0.2 0 0.7"/>
<axis xyz="1 0 0"/><limit lower="-3" upper="3" velocity="1" effort="0"/></joint></robot>"""


def a_cell(name):
    """A bundled robot at a crooked place with a crooked tool."""
    robot = load_robot(name).robot
    base = pin.SE3(pin.rpy.rpyToMatrix(0.1, -0.2, 0.3), np.array([0.4, 0.5, 0.6]))
    tcp = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.2, 0.1), np.array([0.03, -0.02, 0.15]))
    return Cell(robot, base, {arm.name: Tool(tcp) for arm in robot.arms})


@pytest.mark.parametrize("name", ["sda10f", "bottin_planar", "openarm", "iiwa14", "amiro_like"])
def test_tools_are_where_pinocchio_has_them(name):
    """200 random configurations, position to 1e-12 m and pose likewise."""
    cell = a_cell(name)
    model = CellModel.from_cell(cell)
    urdf = pin.buildModelFromXML(cell.robot.urdf)
    data = urdf.createData()
    rng = np.random.default_rng(1)
    positions = rng.uniform(-2, 2, (200, len(cell.robot.joints)))
    columns = [cell.robot.joints.index(joint) for joint in urdf.names[1:]]
    for arm in cell.robot.arms:
        many = model.tool_position(arm.name, positions)
        for k, position in enumerate(positions):
            pin.framesForwardKinematics(urdf, data, position[columns])
            expected = cell.base * data.oMf[urdf.getFrameId(arm.flange)] * cell.tools[arm.name].tcp
            assert np.abs(many[k] - expected.translation).max() < 1e-12
        assert model.tool_pose(arm.name, position).isApprox(expected, 1e-12)


def test_a_chain_of_any_axes_is_where_pinocchio_has_it():
    """A tilted turning joint, then a sliding one along x."""
    model = pin.buildModelFromXML(TILTED_WAIST)
    base = pin.SE3(pin.rpy.rpyToMatrix(0.5, 0.1, 0.2), np.array([1.0, 2.0, 3.0]))
    chain = PlatformChain.from_model(model, ("yaw", "lift"), base)
    assert chain.revolute == (True, False)
    assert not chain.is_turntable
    data = model.createData()
    aligned = None
    for q in np.random.default_rng(2).uniform(-2, 2, (50, 2)):
        R, p = chain.pose(q)
        pin.forwardKinematics(model, data, q)
        # The chain's own frame is the joint's, turned by a constant so that its axis is z.
        constant = (base * data.oMi[2]).actInv(pin.SE3(R, p))
        aligned = aligned or constant
        assert np.abs(constant.homogeneous - aligned.homogeneous).max() < 1e-12
        assert np.allclose(constant.rotation[:, 2], [1, 0, 0], atol=1e-12)


def test_an_arm_called_srs_that_is_not_is_found_out():
    """The SDA10F with its left elbow 5 mm off: the sentence names the arm and the measured offset."""
    robot = load_robot("sda10f").robot
    assert find_false_kinds(robot) == []
    import dataclasses
    import re

    joint = re.compile(r'(<joint name="left_u".*?<origin xyz=")0 0 0(")', re.DOTALL)
    urdf, count = joint.subn(r"\g<1>0.005 0 0\2", robot.urdf)
    assert count == 1
    false = dataclasses.replace(robot, urdf=urdf)
    (found,) = find_false_kinds(false)
    assert "arm left of Yaskawa" in found.message
    assert "kind: general" in found.message
    line = (ROOT / found.file).read_text().splitlines()[found.line - 1]
    assert "left:" in line
    assert line[found.column - 1 :].startswith("srs")
    # Planning says the same of it, with the same place.
    tools = {side: Tool(pin.SE3.Identity()) for side in ("left", "right")}
    with pytest.raises(InputError) as refused:
        CellModel.from_cell(Cell(false, pin.SE3.Identity(), tools))
    assert refused.value.diagnostics == [found]


@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize(
    ("name", "kind", "family"),
    [("spherical", "spherical_wrist", WristArm), ("ur5", "parallel_axes", ParallelArm)],
)
def test_six_axes_have_closed_forms_if_they_are_called_by_their_kind(
    general_robots, tmp_path, numeric, name, kind, family
):
    """Also where numeric inverse kinematics is asked for: it has the postures at once. Called general it has none."""
    general_robots.ROBOTS[name].write(tmp_path)
    file = tmp_path / "robot.yaml"
    tools = {side: Tool(pin.SE3.Identity()) for side in ("left", "right")}
    cell = Cell(load_robot(str(file)).robot, pin.SE3.Identity(), tools)
    model = CellModel.from_cell(cell, numeric=numeric)
    assert all(isinstance(arm.kinematics, family) for arm in model.arms.values())
    file.write_text(file.read_text().replace(f"kind: {kind}", "kind: general"))
    cell = Cell(load_robot(str(file)).robot, pin.SE3.Identity(), tools)
    model = CellModel.from_cell(cell, numeric=numeric)
    assert all(type(arm.kinematics) is GeneralArm for arm in model.arms.values())
