"""robot.urdf beside a plan: the cell for RViz and other viewers, read back by pinocchio."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.exporting.cell_urdf import cell_urdf
from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Cell, Obstacle, Tool
from dualarm_cli.model.shape import Hull, Shape

CORNERS = np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
TRIANGLES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.mark.parametrize("name", list(bundled_tasks()))
def test_joints_tools_and_obstacles_are_where_the_cell_has_them(name: str) -> None:
    """The moving joints are the robot's, in their order; link frames against the data model at random positions."""
    cell = load_job(bundled_tasks()[name]).cell
    model = pin.buildModelFromXML(cell_urdf(cell).text)
    plain = pin.buildModelFromXML(cell.robot.urdf)
    assert list(model.names) == list(plain.names)
    q = np.random.default_rng(0).uniform(model.lowerPositionLimit, model.upperPositionLimit)
    data, other = model.createData(), plain.createData()
    pin.framesForwardKinematics(model, data, q)
    pin.framesForwardKinematics(plain, other, q)
    for arm in cell.robot.arms:
        flange = other.oMf[plain.getFrameId(arm.flange, pin.FrameType.BODY)]
        found = data.oMf[model.getFrameId(f"{arm.name}_tcp", pin.FrameType.BODY)]
        assert found.isApprox(flange * cell.tools[arm.name].tcp, 1e-9)
    solids = pin.buildGeomFromUrdfString(model, cell_urdf(cell).text, pin.GeometryType.COLLISION)
    seen = {model.frames[s.parentFrame].name: s for s in solids.geometryObjects}
    for obstacle in cell.obstacles:
        if obstacle.shape.kind in ("box", "sphere", "cylinder"):
            placed = cell.base * seen[obstacle.name].placement
            assert placed.isApprox(obstacle.shape.pose, 1e-9)


def with_everything(cell: Cell) -> Cell:
    """Returns a cell with a tool of a mesh and a capsule, a floor, and obstacles that share names with links."""
    mesh = Shape("mesh", (), pin.SE3.Identity(), Hull(CORNERS, TRIANGLES))
    capsule = Shape("capsule", (0.02, 0.1), pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.05])))
    arm = cell.robot.arms[0]
    floor = Shape("half_space", (), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.1])))
    return dataclasses.replace(
        cell,
        tools={**cell.tools, arm.name: Tool(pin.SE3.Identity(), shapes=(mesh, capsule))},
        obstacles=(Obstacle(arm.flange, mesh), Obstacle('a "<b>"', mesh), Obstacle("floor", floor)),
    )


def test_every_kind_of_shape_is_written_and_names_stay_unique() -> None:
    """One file for the same hull; a capsule as a rod with two balls; a floor as a plate whose top is the floor."""
    cell = with_everything(load_job(bundled_tasks()["01_first_pick"]).cell)
    found = cell_urdf(cell)
    root = ET.fromstring(found.text)
    names = [element.get("name") for element in root]
    assert len(names) == len(set(names))
    assert 'a "<b>"' in names
    arm = cell.robot.arms[0].name
    (tool,) = [link for link in root.iter("link") if link.get("name") == f"{arm}_tool"]
    for tag in ("visual", "collision"):
        kinds = sorted(g[0].tag for s in tool.findall(tag) for g in s.findall("geometry"))
        assert kinds == ["cylinder", "mesh", "sphere", "sphere"]
    ((name, content),) = found.meshes.items()
    assert all(mesh.get("filename") == name for mesh in root.iter("mesh"))
    assert len(content) == 84 + 4 * 50
    (plate,) = [link for link in root.iter("link") if link.get("name") == "floor"]
    origin, box = plate.find("collision/origin"), plate.find("collision/geometry/box")
    top = float(origin.get("xyz").split()[2]) + 0.5 * float(box.get("size").split()[2])
    assert top + cell.base.translation[2] == pytest.approx(-0.1)


def test_a_plan_is_verified_with_the_cell_beside_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The verifier reads it as the robot; its hash is in schedule.json."""
    monkeypatch.chdir(tmp_path)
    assert run(["plan", "01_first_pick", "--effort", "quick", "--out", "p", "--quiet"]) == 0
    text = Path("p/robot.urdf").read_text()
    cell = load_job(bundled_tasks()["01_first_pick"]).cell
    assert all(f'<link name="{obstacle.name}"' in text for obstacle in cell.obstacles)
    assert run(["verify", "p", "--quiet"]) == 0
    Path("p/robot.urdf").write_text(text + " ")
    assert run(["verify", "p", "--quiet"]) == 1


def test_tools_have_their_masses() -> None:
    """Torques of the written robot are those of the plain one with the tool's inertia added by pinocchio."""
    cell = load_job(bundled_tasks()["01_first_pick"]).cell
    arm = cell.robot.arms[0]
    moments = np.array([[0.02, 0.001, 0.0], [0.001, 0.03, -0.002], [0.0, -0.002, 0.025]])
    inertia = pin.Inertia(1.7, np.array([0.01, -0.02, 0.05]), moments)
    tool = dataclasses.replace(cell.tools[arm.name], inertia=inertia)
    cell = dataclasses.replace(cell, tools={**cell.tools, arm.name: tool})
    model = pin.buildModelFromXML(cell_urdf(cell).text)
    plain = pin.buildModelFromXML(cell.robot.urdf)
    flange = plain.frames[plain.getFrameId(arm.flange, pin.FrameType.BODY)]
    plain.appendBodyToJoint(flange.parentJoint, inertia, flange.placement)
    random = np.random.default_rng(1)
    q = random.uniform(model.lowerPositionLimit, model.upperPositionLimit)
    v, a = random.normal(size=(2, model.nv))
    expected = pin.rnea(plain, plain.createData(), q, v, a)
    np.testing.assert_allclose(pin.rnea(model, model.createData(), q, v, a), expected, atol=1e-9)
