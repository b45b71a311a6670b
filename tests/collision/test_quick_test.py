"""The planner's quick test: what it calls free is free by coal, and it calls free nearly all that is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.collision.solids import cell_solids, geometry_model, pairs_that_must_keep_apart
from dualarm_cli.collision.tree import JointTree
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Obstacle
from dualarm_cli.model.shape import Shape


def margins_by_coal(cell, positions, carried=()):
    """The least distance less required clearance of all pairs at every configuration."""
    robot = cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    solids = cell_solids(cell, model, carried)
    pairs = pairs_that_must_keep_apart(model, solids, cell)
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    data, distances = model.createData(), pin.GeometryData(geometry)
    order = [robot.joints.index(name) for name in model.names[1:]]
    required = np.array([pair.required for pair in pairs])
    found = []
    for q in positions[:, order]:
        pin.computeDistances(model, data, geometry, distances, q)
        found.append(
            (np.array([r.min_distance for r in distances.distanceResults]) - required).min()
        )
    return np.array(found)


def shapes():
    """One of each kind, in front of the robot, and the floor."""
    at = [
        pin.SE3(pin.rpy.rpyToMatrix(0.3 * k, 0.2, 0.1), np.array([0.5, 0.4 * k - 0.8, 0.7]))
        for k in range(5)
    ]
    return (
        Obstacle("box", Shape("box", (0.2, 0.3, 0.1), at[0])),
        Obstacle("ball", Shape("sphere", (0.1,), at[1])),
        Obstacle("rod", Shape("capsule", (0.05, 0.4), at[2])),
        Obstacle("can", Shape("cylinder", (0.06, 0.3), at[3])),
        Obstacle("floor", Shape("half_space", (), pin.SE3.Identity())),
    )


@pytest.mark.parametrize("name", ["04_packing", "05_two_robots"])
def test_what_is_called_free_is_free(tasks_folder, name):
    """Two thousand random postures among every kind of obstacle; cylinders alone are taken as longer than they are."""
    cell = load_job(tasks_folder / name / "tasks.yaml").cell
    cell = dataclasses.replace(cell, obstacles=shapes(), clearance=0.005)
    test = QuickTest(cell)
    limits = cell.robot.limits
    random = np.random.default_rng(3)
    q = random.uniform(limits.lower, limits.upper, (2000, len(limits.joints)))
    groups = [test.cross(), *map(test.arm_pairs, test.arms)]
    quick = np.minimum.reduce([test.margins(group, q) for group in groups])
    truth = margins_by_coal(cell, q)
    assert not ((quick > 1e-6) & (truth < 0.0)).any()
    assert (quick > 0.0).mean() > 0.9 * (truth > 0.0).mean() > 0.0
    one, other, margin = test.nearest(q[0], [p for g in groups for p in g.pairs])
    assert margin == pytest.approx(truth[0], abs=1e-6)
    assert one != other


def test_tools_of_boxes_and_carried_parts_are_where_coal_has_them(tasks_folder):
    """Turned boxes on both flanges, a long part in the left hand: nothing touching is called free, most is exact."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    turned = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.5, 0.2), np.array([0.02, 0.0, 0.06]))
    jaws = Shape("box", (0.12, 0.05, 0.08), turned)
    tools = {name: dataclasses.replace(tool, shapes=(jaws,)) for name, tool in cell.tools.items()}
    long = Shape("box", (0.06, 0.3, 0.05), pin.SE3(turned.rotation, np.array([0.0, 0.0, 0.05])))
    cell = dataclasses.replace(
        cell, tools=tools, parts={"long": (long,)}, obstacles=shapes(), clearance=0.005
    )
    carried = [("left", "long")]
    test = QuickTest(cell, carried)
    limits = cell.robot.limits
    q = np.random.default_rng(5).uniform(limits.lower, limits.upper, (2000, len(limits.joints)))
    groups = [test.cross({"left": "long"}), test.arm_pairs("left", "long"), test.arm_pairs("right")]
    quick = np.minimum.reduce([test.margins(group, q) for group in groups])
    truth = margins_by_coal(cell, q, carried)
    assert not ((quick > 1e-6) & (truth < 0.0)).any()
    assert (quick > 0.0).mean() > 0.97 * (truth > 0.0).mean() > 0.0
    # Where it is tight the quick test has asked coal, or is as exact.
    tight = (truth > 0.0) & (truth < 0.004)
    assert tight.sum() > 10
    np.testing.assert_allclose(quick[tight], truth[tight], atol=1e-4)
    # On its lines the part may touch what stands: those pairs alone are left out, and looked at as such.
    line = np.minimum.reduce(
        [test.margins(g, q) for g in (groups[0], test.arm_pairs("left", "long", True), groups[2])]
    )
    free = quick > 0.0
    lying = test.margins(test.ground("left", "long"), q)
    assert (line[free] > 0.0).all()
    assert (lying[free] > 0.0).all()
    assert ((line > 0.0) & ~free & (lying < 0.0)).any()


def test_frames_of_all_joints_are_pinocchios(tasks_folder):
    """Twenty random configurations, all at once; and a part of the tree only where it is asked for."""
    robot = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    tree = JointTree.of(model, robot.joints)
    q = np.random.default_rng(0).uniform(
        robot.limits.lower, robot.limits.upper, (20, len(robot.joints))
    )
    found = tree.frames(q, range(model.njoints))
    data = model.createData()
    for k, row in enumerate(q[:, [robot.joints.index(n) for n in model.names[1:]]]):
        pin.forwardKinematics(model, data, row)
        for joint in range(model.njoints):
            R, p = found[joint][0][..., k], found[joint][1][:, k]
            expected = data.oMi[joint]
            np.testing.assert_allclose(R @ tree.R_joint_own[joint].T, expected.rotation, atol=1e-12)
            np.testing.assert_allclose(p, expected.translation, atol=1e-12)
    assert set(tree.frames(q, [8])) == set(range(9))


def test_frames_of_a_slide_among_turns_are_pinocchios():
    """A turn, a slide along another axis and a turn, placed at random; twenty configurations."""
    random, model = np.random.default_rng(1), pin.Model()
    at, kinds = 0, (pin.JointModelRZ(), pin.JointModelPY(), pin.JointModelRX())
    for number, kind in enumerate(kinds):
        place = pin.SE3(pin.exp3(random.normal(size=3)), random.normal(size=3))
        at = model.addJoint(at, kind, place, f"j{number}")
    tree, q = JointTree.of(model, ("j0", "j1", "j2")), random.uniform(-1.5, 1.5, (20, 3))
    found, data = tree.frames(q, range(4)), model.createData()
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for joint in range(4):
            R, p = found[joint][0][..., k], found[joint][1][:, k]
            expected = data.oMi[joint]
            np.testing.assert_allclose(R @ tree.R_joint_own[joint].T, expected.rotation, atol=1e-12)
            np.testing.assert_allclose(p, expected.translation, atol=1e-12)
