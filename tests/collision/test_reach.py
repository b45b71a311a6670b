"""Pairs that are said never to meet never do."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.reach import Reach
from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    cell_solids,
    geometry_model,
    pairs_that_must_keep_apart,
)
from dualarm_cli.files.tasks.tasks import load_job


@pytest.mark.parametrize("name", ["04_packing", "05_two_robots", "07_two_shelves"])
def test_pairs_that_cannot_meet_keep_apart_at_three_thousand_random_postures(tasks_folder, name):
    """Their least distance by coal is never less than what is required; and there are such pairs."""
    cell = load_job(tasks_folder / name / "tasks.yaml").cell
    model = pin.buildModelFromXML(cell.robot.urdf)
    solids = cell_solids(cell, model, [])
    pairs = [
        pair
        for pair in pairs_that_must_keep_apart(model, solids, cell)
        if not Reach(model).can_meet(solids[pair.first], solids[pair.second], pair)
    ]
    assert pairs
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    data, distances = model.createData(), pin.GeometryData(geometry)
    required = np.array([pair.required for pair in pairs])
    limits = cell.robot.limits
    random = np.random.default_rng(0)
    order = [cell.robot.joints.index(joint) for joint in model.names[1:]]
    for q in random.uniform(limits.lower, limits.upper, (3000, len(order)))[:, order]:
        pin.computeDistances(model, data, geometry, distances, q)
        found = np.array([result.min_distance for result in distances.distanceResults])
        assert (found >= required).all()


def placed(x: float, y: float = 0.0, z: float = 0.0) -> pin.SE3:
    return pin.SE3(np.eye(3), np.array([x, y, z]))


def ball(joint: int, x: float, radius: float) -> Solid:
    """A ball at a place on the x axis of a joint's frame."""
    return Solid(f"ball {joint}", joint, placed(x), coal.Sphere(radius), abs(x) + radius)


def meets_at(model: pin.Model, one: Solid, other: Solid, required: float, within: float) -> bool:
    """Whether they can meet; the same whichever is first."""
    both = [
        Reach(model).can_meet(a, b, Pair(0, 1, required), within)
        for a, b in ((one, other), (other, one))
    ]
    assert both[0] == both[1]
    return both[0]


@pytest.mark.parametrize("links", [1, 2, 3])
def test_an_arm_reaches_as_far_as_its_links_add_up(links):
    """Joints about z, 0.3, 0.2 and 0.1 m apart, a ball of 20 mm 0.1 m from the last: against one of 50 mm that stands.

    Half a metre up the first joint's axis there is a link of 0.4 m along z, which the turning does not move.
    """
    model = pin.Model()
    last = model.addJoint(0, pin.JointModelRZ(), placed(0.0, 0.0, 0.5), "first")
    lengths = [0.3, 0.2, 0.1][:links]
    for k, length in enumerate(lengths):
        height = 0.4 if k == 0 else 0.0
        last = model.addJoint(last, pin.JointModelRZ(), placed(length, 0.0, height), f"joint {k}")
    reach = sum(lengths) + 0.12
    for away, meets in ((-1e-4, True), (1e-4, False)):
        distance = reach + 0.05 + 0.015 + away
        stands = Solid("ball", WORLD, placed(0.0, distance, 0.9), coal.Sphere(0.05), 2.0)
        assert meets_at(model, ball(last, 0.1, 0.02), stands, 0.01, 0.005) == meets


def test_two_arms_on_one_torso_meet_by_what_is_beyond_it():
    """Shoulders 0.8 m apart on a torso that turns; one arm of 0.3 m and a ball of 0.1 m, the other a ball alone."""
    model = pin.Model()
    torso = model.addJoint(0, pin.JointModelRZ(), placed(0.0, 0.0, 0.7), "torso")
    left = model.addJoint(torso, pin.JointModelRZ(), placed(0.0, 0.4), "left")
    right = model.addJoint(torso, pin.JointModelRZ(), placed(0.0, -0.4), "right")
    elbow = model.addJoint(left, pin.JointModelRZ(), placed(0.3), "elbow")
    for away, meets in ((-1e-4, True), (1e-4, False)):
        # 0.8 = 0.3 + (0.1 + 0.05) + (x + 0.05) + 0.02
        other = ball(right, 0.28 - away, 0.05)
        assert meets_at(model, ball(elbow, 0.1, 0.05), other, 0.02, 0.0) == meets
        # What the torso carries itself, 0.5 m beside the left shoulder: 0.3 + 0.12 + 0.05 + 0.03 m.
        beside = Solid("torso", torso, placed(0.0, 0.9 + away), coal.Sphere(0.03), 1.0)
        assert meets_at(model, ball(elbow, 0.1, 0.02), beside, 0.05, 0.0) == meets


def test_nothing_is_said_of_joints_that_slide():
    """However far away."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), placed(0.0), "slide")
    arm = model.addJoint(slide, pin.JointModelRZ(), placed(0.1), "arm")
    far = Solid("ball", WORLD, placed(9.0), coal.Sphere(0.05), 9.1)
    assert meets_at(model, ball(arm, 0.1, 0.05), far, 0.0, 0.0)
    assert meets_at(model, ball(slide, 0.1, 0.05), far, 0.0, 0.0)


def test_what_the_second_joint_carries_goes_round_on_a_circle_about_the_first_one_s_axis():
    """Joints about z, y and x: 0.2 m up the first axis, hypot(0.3, 0.4) beside it, 0.1 m on, and the solid's extent."""
    model = pin.Model()
    first = model.addJoint(0, pin.JointModelRZ(), placed(0.0, 1.0), "first")
    at = pin.SE3(np.eye(3), np.array([0.3, 0.4, 0.2]))
    second = model.addJoint(first, pin.JointModelRY(), at, "second")
    at = pin.SE3(np.eye(3), np.array([0.0, 0.1, 0.0]))
    third = model.addJoint(second, pin.JointModelRX(), at, "third")
    solid = ball(third, 0.0, 0.05)
    found = Reach(model)._ball(solid, [first, second, third])
    np.testing.assert_allclose(found.center, placed(0.0, 1.0, 0.2).translation, atol=1e-12)
    assert found.radius == pytest.approx(0.5 + 0.1 + solid.extent)
    alone = Reach(model)._ball(ball(first, 0.0, 0.05), [first])
    np.testing.assert_allclose(alone.center, placed(0.0, 1.0).translation)
    assert alone.radius == pytest.approx(ball(first, 0.0, 0.05).extent)
