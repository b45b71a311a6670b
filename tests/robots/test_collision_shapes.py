"""Collision geometry of the bundled robots: the naming of robots/README.md, and coverage."""

from __future__ import annotations

import dataclasses
import itertools
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import (
    cell_solids,
    geometry_model,
    pairs_that_must_keep_apart,
)
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.source.bundled import bundled_robots
from dualarm_cli.model.cell import Cell, Tool

Segment = tuple[np.ndarray, np.ndarray, float]
"""Both ends of a capsule's axis in the link's frame [m] and its radius [m]."""

# World extents [m] of the SDA10F's links at q = 0, measured on the collision meshes of
# ros-industrial/motoman and printed to the millimetre; the arm is the left one.
EXTENTS = {
    "torso_link_b1": [(-0.122, -0.129, 0.880), (0.222, 0.129, 1.339)],
    "left_link_s": [(0.013, 0.090, 1.095), (0.186, 0.351, 1.285)],
    "left_link_l": [(0.009, 0.174, 1.134), (0.192, 0.481, 1.300)],
    "left_link_e": [(0.032, 0.444, 1.132), (0.168, 0.691, 1.285)],
    "left_link_u": [(0.029, 0.555, 1.120), (0.170, 0.864, 1.255)],
    "left_link_r": [(0.041, 0.830, 1.127), (0.158, 1.040, 1.257)],
    "left_link_b": [(0.043, 0.928, 1.146), (0.157, 1.140, 1.273)],
}
# Extents [m] of links in their own frames, measured on the meshes of kth-ros-pkg/yumi (coarse; its
# link_3 is moved by joint 7) and tork-a/rtmros_nextage, printed to the millimetre.
OWN_EXTENTS = {
    ("yumi", "left_link_1"): [(-0.061, -0.078, 0.000), (0.079, 0.062, 0.149)],
    ("yumi", "left_link_2"): [(-0.085, -0.048, -0.078), (0.048, 0.173, 0.054)],
    ("yumi", "left_link_7"): [(-0.090, -0.079, 0.000), (0.047, 0.047, 0.127)],
    ("yumi", "left_link_3"): [(-0.048, -0.048, -0.078), (0.085, 0.165, 0.048)],
    ("yumi", "left_link_4"): [(-0.059, -0.070, 0.000), (0.041, 0.041, 0.132)],
    ("yumi", "left_link_5"): [(-0.034, -0.066, -0.067), (0.068, 0.033, 0.027)],
    ("yumi", "left_link_6"): [(-0.032, -0.032, -0.011), (0.032, 0.032, 0.013)],
    ("nextage", "left_link_0"): [(-0.045, -0.039, -0.061), (0.042, 0.054, 0.095)],
    ("nextage", "left_link_1"): [(-0.081, 0.040, -0.285), (0.036, 0.190, 0.036)],
    ("nextage", "left_link_2"): [(-0.069, -0.041, -0.153), (0.035, 0.084, 0.035)],
    ("nextage", "left_link_3"): [(-0.036, -0.036, -0.258), (0.036, 0.063, -0.140)],
    ("nextage", "left_link_4"): [(-0.041, -0.026, -0.116), (0.033, 0.071, 0.024)],
    ("nextage", "left_link_5"): [(0.000, -0.022, -0.022), (0.038, 0.022, 0.022)],
}


def _numbers(element: ET.Element | None, key: str) -> np.ndarray:
    assert element is not None
    return np.array([float(word) for word in element.attrib[key].split()])


def _shape(solid: ET.Element) -> ET.Element:
    geometry = solid.find("geometry")
    assert geometry is not None
    assert len(geometry) == 1
    return geometry[0]


def _capsule(link: ET.Element) -> Segment | None:
    """Returns the capsule that a link's collision elements spell, None where it has none."""
    solids = {solid.attrib["name"]: solid for solid in link.iter("collision")}
    middle = solids.get(f"{link.get('name')}_capsule")
    if middle is None:
        return None
    centre, shape = _numbers(middle.find("origin"), "xyz"), _shape(middle)
    radius = float(shape.attrib["radius"])
    if shape.tag == "sphere":
        return centre, centre, radius
    axis = pin.rpy.rpyToMatrix(*_numbers(middle.find("origin"), "rpy"))[:, 2]
    half = 0.5 * float(shape.attrib["length"]) * axis
    return centre - half, centre + half, radius


def _distance(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Returns each point's distance from a segment, shape (n,)."""
    along = end - start
    share = np.clip((points - start) @ along / max(along @ along, 1e-300), 0.0, 1.0)
    distance: np.ndarray = np.linalg.norm(points - start - share[:, None] * along, axis=1)
    return distance


@pytest.mark.parametrize("name", bundled_robots())
def test_each_link_is_one_capsule_or_one_box_and_spelled_as_the_readme_says(
    name: str, urdf_tree: Callable[[str], ET.Element]
) -> None:
    """`L_box`; or a sphere `L_capsule`; or a cylinder `L_capsule` with `_a`, `_b` on its ends."""
    for link in urdf_tree(name).iter("link"):
        label = link.attrib["name"]
        solids = {solid.attrib["name"]: solid for solid in link.iter("collision")}
        tags = {key.removeprefix(label): _shape(solid).tag for key, solid in solids.items()}
        assert tags in (
            {},
            {"_box": "box"},
            {"_capsule": "sphere"},
            {"_capsule": "cylinder", "_capsule_a": "sphere", "_capsule_b": "sphere"},
        ), label
        if len(tags) == 3:
            capsule = _capsule(link)
            assert capsule is not None
            ends = [_numbers(solids[f"{label}_capsule_{x}"].find("origin"), "xyz") for x in "ab"]
            gaps = [
                np.linalg.norm(np.subtract(ends, order)) for order in (capsule[:2], capsule[1::-1])
            ]
            assert min(gaps) < 1e-8, label
            radii = {float(_shape(solid).attrib["radius"]) for solid in solids.values()}
            assert radii == {capsule[2]}


@pytest.mark.parametrize("name", bundled_robots())
def test_what_is_seen_is_what_collides(name: str, urdf_tree: Callable[[str], ET.Element]) -> None:
    """Visual and collision elements are the same."""
    for link in urdf_tree(name).iter("link"):
        seen, hit = (
            [b"".join(ET.tostring(part) for part in solid) for solid in link.iter(tag)]
            for tag in ("visual", "collision")
        )
        assert seen == hit


@pytest.mark.parametrize("name", bundled_robots())
def test_capsules_leave_no_gap_along_an_arm(
    name: str, urdf_tree: Callable[[str], ET.Element]
) -> None:
    """The line shoulder, elbow, wrist, flange lies inside the arm's capsules at home.

    Of an arm without such centres: the line through its joints' origins to the flange.
    """
    robot = load_robot(name).robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(robot.postures["home"]))
    capsules = {link.attrib["name"]: _capsule(link) for link in urdf_tree(name).iter("link")}
    for arm in robot.arms:
        placed = []
        for joint in arm.joints:
            T = data.oMi[model.getJointId(joint)]
            child = next(
                j.find("child") for j in urdf_tree(name).iter("joint") if j.get("name") == joint
            )
            assert child is not None
            capsule = capsules[child.attrib["link"]]
            if capsule is not None:
                placed.append((T.act(capsule[0]), T.act(capsule[1]), capsule[2]))
        if arm.kind == "srs":
            points = _backbone(model, data, arm.joints, arm.flange)
        else:
            corners = [data.oMi[model.getJointId(joint)].translation for joint in arm.joints]
            points = _line([*corners, data.oMf[model.getFrameId(arm.flange)].translation])
        outside = np.min([_distance(points, a, b) - radius for a, b, radius in placed], axis=0)
        assert outside.max() <= 1e-9, (arm.name, points[outside.argmax()])


def _backbone(model: pin.Model, data: pin.Data, joints: tuple[str, ...], flange: str) -> np.ndarray:
    """Returns points 2 mm or less apart along shoulder, elbow, wrist, flange, shape (n, 3)."""

    def meet(first: str, second: str) -> np.ndarray:
        """Returns where the axes of two joints cross."""
        lines = []
        for name in (first, second):
            i = model.getJointId(name)
            column = model.joints[i].createData()
            model.joints[i].calc(column, np.zeros(model.nq), np.zeros(model.nv))
            lines.append(
                (data.oMi[i].translation, data.oMi[i].rotation @ np.array(column.S)[3:].ravel())
            )
        (p, u), (r, v) = lines
        share = np.linalg.lstsq(np.column_stack([u, -v]), r - p, rcond=None)[0]
        crossing: np.ndarray = p + share[0] * u
        return crossing

    corners = [meet(joints[i], joints[i + 1]) for i in (0, 3, 5)]
    corners.append(data.oMf[model.getFrameId(flange)].translation)
    return _line(corners)


def _line(corners: list[np.ndarray]) -> np.ndarray:
    """Returns points 2 mm or less apart along lines from corner to corner, shape (n, 3)."""
    steps = np.linspace(0.0, 1.0, 401)[:, None]
    return np.concatenate([a + steps * (b - a) for a, b in itertools.pairwise(corners)])


@pytest.mark.parametrize("link", EXTENTS)
def test_sda10f_capsules_contain_what_was_measured(
    link: str, pin_model: Callable[[str], pin.Model], urdf_tree: Callable[[str], ET.Element]
) -> None:
    """A capsule that contains a link reaches at least as far in all six directions, to 1 mm."""
    model = pin_model("sda10f")
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(model.nq))
    element = next(x for x in urdf_tree("sda10f").iter("link") if x.get("name") == link)
    capsule = _capsule(element)
    assert capsule is not None
    T = data.oMf[model.getFrameId(link)]
    ends = np.array([T.act(capsule[0]), T.act(capsule[1])])
    low, high = np.array(EXTENTS[link])
    assert (ends.min(axis=0) - capsule[2] <= low + 1e-3).all()
    assert (ends.max(axis=0) + capsule[2] >= high - 1e-3).all()


@pytest.mark.parametrize(("name", "link"), OWN_EXTENTS)
def test_measured_capsules_contain_what_was_measured(
    name: str, link: str, urdf_tree: Callable[[str], ET.Element]
) -> None:
    """As above, in the link's own frame; the right arm's links mirror or repeat the left one's."""
    elements = {x.attrib["name"]: x for x in urdf_tree(name).iter("link")}
    capsules = [_capsule(elements[label]) for label in (link, link.replace("left", "right"))]
    left, right = capsules
    assert left is not None
    assert right is not None
    low, high = np.array(OWN_EXTENTS[name, link])
    assert (np.min(left[:2], axis=0) - left[2] <= low + 1e-3).all()
    assert (np.max(left[:2], axis=0) + left[2] >= high - 1e-3).all()
    sides = np.array([1.0, -1.0 if name == "nextage" else 1.0, 1.0])
    np.testing.assert_allclose(np.array(right[:2]), sides * np.array(left[:2]), atol=1e-8)
    assert right[2] == left[2]


def test_sda10f_base_box_is_the_measured_pedestal(urdf_tree: Callable[[str], ET.Element]) -> None:
    """0.50 x 0.50 x 0.894 m standing on the floor, reaching 0.343 m behind the platform's axis."""
    solid = next(urdf_tree("sda10f").iter("collision"))
    centre, size = _numbers(solid.find("origin"), "xyz"), _numbers(_shape(solid), "size")
    np.testing.assert_allclose(centre - size / 2, [-0.343, -0.25, 0.0], atol=1e-12)
    np.testing.assert_allclose(centre + size / 2, [0.157, 0.25, 0.894], atol=1e-12)


# qin_150 has one arm and no body that could be near.
@pytest.mark.parametrize("name", [name for name in bundled_robots() if name != "qin_150"])
def test_no_arm_is_near_the_other_or_the_body_at_home(
    name: str, urdf_path: Callable[[str], Path]
) -> None:
    """50 mm or more between the arms, and from each arm beyond its elbow to what carries it.

    Left out are both first links together: they turn about fixed axes, as near as they are mounted.
    """
    robot = load_robot(name).robot
    model = pin.buildModelFromUrdf(str(urdf_path(name)))
    shapes = pin.buildGeomFromUrdf(model, str(urdf_path(name)), pin.GeometryType.COLLISION)
    body = [0, *(model.getJointId(joint) for joint in robot.platform)]
    arms = [[model.getJointId(joint) for joint in arm.joints] for arm in robot.arms]
    for arm in arms:
        _add_pairs(shapes, arm[3:], body)
    for left, right in itertools.combinations(arms, 2):
        _add_pairs(shapes, left, right[1:])
        _add_pairs(shapes, left[1:], right[:1])
    data, found = model.createData(), pin.GeometryData(shapes)
    pin.computeDistances(model, data, shapes, found, np.array(robot.postures["home"]))
    assert min(result.min_distance for result in found.distanceResults) >= 0.05


def _add_pairs(shapes: pin.GeometryModel, first: list[int], second: list[int]) -> None:
    """Adds every pair of a shape on one of the first joints and a shape on one of the second."""
    for i, a in enumerate(shapes.geometryObjects):
        for j, b in enumerate(shapes.geometryObjects):
            if a.parentJoint in first and b.parentJoint in second:
                shapes.addCollisionPair(pin.CollisionPair(i, j))


@pytest.mark.parametrize("name", bundled_robots())
def test_allowed_contacts_are_the_pairs_that_never_come_apart(name: str) -> None:
    """Of 300 random postures: they are never 35 mm apart; every other pair somewhere is 15 mm."""
    robot = load_robot(name).robot
    model = pin.buildModelFromXML(robot.urdf)
    cell = Cell(
        dataclasses.replace(robot, allowed_contacts=()),
        pin.SE3.Identity(),
        {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms},
    )
    solids = cell_solids(cell, model, ())
    pairs = pairs_that_must_keep_apart(model, solids, cell)
    shapes = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    data, found = model.createData(), pin.GeometryData(shapes)
    random = np.random.default_rng(0)
    farthest = np.full(len(pairs), -np.inf)
    for q in random.uniform(robot.limits.lower, robot.limits.upper, (300, model.nq)):
        pin.computeDistances(model, data, shapes, found, q)
        distances = [result.min_distance for result in found.distanceResults]
        farthest = np.maximum(farthest, distances)
    allowed = {frozenset(pair) for pair in robot.allowed_contacts}
    for pair, distance in zip(pairs, farthest, strict=True):
        bodies = frozenset((solids[pair.first].body, solids[pair.second].body))
        if bodies in allowed:
            assert distance < 0.035, bodies
        else:
            assert distance > 0.015, bodies
