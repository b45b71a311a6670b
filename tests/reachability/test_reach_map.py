"""Reach of a table, compared with exact intervals of arm angles, with pinocchio and coal, and with itself turned."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import cell_solids, geometry_model, pairs_that_must_keep_apart
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.reachability.reach_map import reach_map
from dualarm_cli.reachability.region import best_height, platform_positions, region
from dualarm_cli.reachability.table_grid import YAWS, TableGrid, flange_poses
from dualarm_cli.robot_import.contacts import bare_cell
from dualarm_cli.robot_import.proposed_tool import with_tools

HEIGHTS = {"sda10f": 0.8, "iiwa7": 0.1, "qin_150": 0.2, "yumi": 0.1, "nextage": 0.95}


def cell_of(name, *, shapes=True):
    """Returns a bundled robot with proposed tools, with or without its shapes."""
    cell, _ = with_tools(bare_cell(load_robot(name).robot))
    if shapes:
        return cell
    urdf = re.sub(r"<collision.*?</collision>", "", cell.robot.urdf, flags=re.DOTALL)
    tools = {arm: replace(tool, shapes=()) for arm, tool in cell.tools.items()}
    return replace(cell, robot=replace(cell.robot, urdf=urdf, meshes={}), tools=tools)


def grid_of(name, cell, turns=1):
    """Returns a grid at one height, at so many platform angles, coarse enough to be looked at node by node."""
    here = region(cell)
    platform = np.tile(here.home, (turns, 1))
    if platform.shape[1]:
        platform[:, 0] += np.radians(30.0) * np.arange(turns)
    return here.grid(platform, np.array([HEIGHTS[name]]), 2.0 * here.step)


@pytest.mark.parametrize("name", sorted(HEIGHTS))
def test_without_shapes_reach_is_that_of_inverse_kinematics(name):
    """Every node that some turn of the tool reaches by closed forms, or from many starts, is found; and no other."""
    cell = cell_of(name, shapes=False)
    grid = grid_of(name, cell, 2 if name in ("sda10f", "nextage") else 1)
    model, reach = CellModel.from_cell(cell), reach_map(cell, grid)
    for arm, kinematics in ((name, one.kinematics) for name, one in model.arms.items()):
        node = np.random.default_rng(1).permutation(grid.size)[:120]
        every, yaw = np.repeat(node, YAWS), np.tile(np.arange(YAWS), len(node))
        R, p = flange_poses(model, arm, grid, every, yaw)
        if isinstance(kinematics, GeneralArm):
            found = (kinematics.postures(R, p, first_only=True).miss == 0.0).all(axis=1)
        else:
            found = kinematics.feasible_arm_angles(R, p).count.any(axis=1)
        exact = found.reshape(-1, YAWS).any(axis=1)
        mapped = reach.reached(arm).ravel()[node]
        assert exact.any()
        assert not exact.all()
        # Numeric inverse kinematics may miss what is reached on the border, and so may the way from node to node.
        assert (mapped != exact).mean() <= 0.01, (arm, node[mapped != exact])


@pytest.mark.parametrize("name", ["nextage", "sda10f", "yumi"])
def test_postures_hold_the_tool_and_are_clear(name):
    """By pinocchio's forward kinematics the tool stands on the node, pointing down; by coal nothing touches."""
    cell = cell_of(name)
    grid = grid_of(name, cell, 2)
    reach = reach_map(cell, grid, line=0.04)
    model = pin.buildModelFromXML(cell.robot.urdf)
    solids, data = cell_solids(cell, model, ()), model.createData()
    members = {arm.name: {model.getJointId(j) for j in arm.joints} for arm in cell.robot.arms}
    for arm in cell.robot.arms:
        others = set().union(*(own for name, own in members.items() if name != arm.name))
        pairs = [
            (pair.first, pair.second)
            for pair in pairs_that_must_keep_apart(model, solids, cell)
            if not {solids[pair.first].joint, solids[pair.second].joint} & others
        ]
        geometry = geometry_model(solids, pairs)
        results = pin.GeometryData(geometry)
        found = reach.postures[arm.name]
        assert len(found.node) > 30
        for k in range(0, len(found.node), 5):
            for q_arm, up in ((found.q[k], 0.0), (reach.drawn_back[arm.name][k], 0.04)):
                whole = dict(zip(cell.robot.joints, cell.robot.postures["home"], strict=True))
                whole |= dict(zip(arm.joints, q_arm, strict=True))
                turned = grid.platform_at(found.node[[k]])[0]
                whole |= dict(zip(cell.robot.platform, turned, strict=True))
                q = np.empty(model.nq)
                for joint, value in whole.items():
                    q[model.idx_qs[model.getJointId(joint)]] = value
                assert (q >= model.lowerPositionLimit - 1e-9).all()
                assert (q <= model.upperPositionLimit + 1e-9).all()
                pin.framesForwardKinematics(model, data, q)
                tip = cell.base * data.oMf[model.getFrameId(arm.flange)] * cell.tools[arm.name].tcp
                np.testing.assert_allclose(
                    tip.translation, grid.points(found.node[[k]])[0] + [0, 0, up], atol=1e-7
                )
                np.testing.assert_allclose(tip.rotation[:, 2], [0.0, 0.0, -1.0], atol=1e-7)
                assert not pin.computeCollisions(model, data, geometry, results, q, True)


def test_a_turned_platform_turns_what_is_reached():
    """A quarter turn of the platform takes the grid onto itself; but for a few nodes so does it what is reached."""
    cell = cell_of("sda10f", shapes=False)
    here = region(cell)
    grid = here.grid(np.array([[0.0], [0.5 * np.pi]]), np.array([0.8]), 0.1)
    for arm, reached in ((arm, reach_map(cell, grid).reached(arm)) for arm in ("left", "right")):
        before, after = reached[:, 0]
        # Counterclockwise: (x, y) goes to (-y, x); rows are y, columns x.
        turned = np.rot90(before, -1)
        assert before.sum() > 80, arm
        assert (turned != after).sum() <= 0.01 * before.sum()


def test_a_tilted_tool_leans_outwards():
    """The tip points away from the centre, by as much as is asked for."""
    grid = TableGrid(
        np.zeros((1, 0)), np.array([0.5]), np.array([-0.3, 0.3]), np.array([0.4]), np.radians(30.0)
    )
    R, tip = grid.tools(np.arange(2), np.array([0, 3]))
    for k in range(2):
        out = tip[k, :2] / np.linalg.norm(tip[k, :2])
        np.testing.assert_allclose(R[k, :2, 2], 0.5 * out, atol=1e-12)
        np.testing.assert_allclose(R[k, 2, 2], -np.cos(np.radians(30.0)), atol=1e-12)
        np.testing.assert_allclose(R[k] @ R[k].T, np.eye(3), atol=1e-12)


def test_what_is_reached_with_a_line_is_reached_without():
    """A longer line is never easier."""
    cell = cell_of("yumi")
    grid = grid_of("yumi", cell)
    counts = [
        {arm: reach_map(cell, grid, line).reached(arm).sum() for arm in ("left", "right")}
        for line in (0.0, 0.1, 0.3)
    ]
    for arm in ("left", "right"):
        assert counts[0][arm] >= counts[1][arm] >= counts[2][arm]


def test_heights_are_between_root_and_shoulder():
    """The SDA10F stands on the floor and has its shoulders at 1.2 m: a table is between the two."""
    cell = cell_of("sda10f")
    height = best_height(cell, region(cell))
    assert 0.4 <= height <= 1.1
    assert len(platform_positions(cell)) == 23  # +-170 deg in steps of 15
