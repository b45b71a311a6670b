"""Which links overlap by construction, found by sampling postures, as MoveIt's assistant does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    Solid,
    geometry_model,
    link_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Robot

MARGIN = 0.01
"""Distance below which links count as touching: that much clearance a cell may ask for [m]."""
POSTURES = 10_000
"""Postures that are sampled."""
FEW = 200
"""Postures after which pairs that have not yet touched in most of them are looked at no longer."""
ALWAYS = 0.95
"""Share of postures from which on two links overlap by construction."""
MOSTLY, NEAR = 0.55, 3
"""Share of postures from which on the shapes of links at most NEAR moving joints apart are assumed to be too wide."""
OFTEN = 0.5
"""Share of postures from which on links that are farther apart are named."""


@dataclass(frozen=True)
class Contact:
    """Two links whose shapes overlap where the links do not."""

    links: tuple[str, str]
    """Their names."""
    why: str
    """Why they may touch, in words."""
    assumed: bool = False
    """Whether it is only assumed that the shapes touch and the links do not."""


def bare_cell(robot: Robot) -> Cell:
    """Returns a cell with nothing but a robot."""
    tools = {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms}
    return Cell(robot, pin.SE3.Identity(), tools, {}, ())


def sampled_range(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Returns the lowest and highest positions that are sampled [rad or m]: a turn either way of joints that turn."""
    most = np.array([np.inf if name in robot.sliding else 2 * np.pi for name in robot.joints])
    return np.maximum(robot.limits.lower, -most), np.minimum(robot.limits.upper, most)


def random_postures(robot: Robot, count: int, seed: int) -> FloatArray:
    """Returns postures within the limits, shape (count, joints) [rad or m]; joints that turn without end within a turn.

    Args:
        robot: of the data model.
        count: how many.
        seed: of the random numbers.
    """
    lower, upper = sampled_range(robot)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(robot.joints)))


def find_contacts(
    robot: Robot, known: Mapping[frozenset[str], str], seed: int
) -> tuple[list[Contact], list[Contact]]:
    """Returns the pairs of links that touch wherever the joints are, and the known ones; and those that often do.

    What touches in some postures only may be a collision: where it is assumed to be none, the robot file says so.

    Args:
        robot: without allowed contacts.
        known: pairs that may touch whatever the samples say, with the reason.
        seed: of the postures.
    """
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    pairs = pairs_that_must_keep_apart(model, solids, bare_cell(robot))
    found = [
        Contact((one, other), f"SRDF: {why}")
        for (one, other), why in sorted((sorted(names), why) for names, why in known.items())
    ]
    candidates = [
        pair
        for pair in pairs
        if frozenset((solids[pair.first].body, solids[pair.second].body)) not in known
    ]
    if not candidates:
        return found, []
    postures = in_model_order(model, robot, random_postures(robot, POSTURES, seed))
    indices = [(pair.first, pair.second) for pair in candidates]
    share = _touching(model, solids, indices, postures[:FEW]).mean(axis=0)
    likely = np.flatnonzero(share >= 0.5 * OFTEN)
    if not len(likely):
        return found, []
    share = _touching(model, solids, [indices[k] for k in likely], postures).mean(axis=0)
    by_bodies: dict[tuple[str, str], tuple[float, int]] = {}
    for k, of in zip(likely.tolist(), share.tolist(), strict=True):
        one, other = solids[candidates[k].first], solids[candidates[k].second]
        names = (one.body, other.body)
        between = joints_between(model, one.joint, other.joint)
        by_bodies[names] = max((of, between), by_bodies.get(names, (0.0, between)))
    often = []
    for names, (of, between) in by_bodies.items():
        what = f"touch in {of:.0%} of {POSTURES} postures"
        if of >= ALWAYS:
            found.append(Contact(names, what))
        elif of >= (MOSTLY if between <= NEAR else OFTEN):
            often.append(Contact(names, what, assumed=between <= NEAR))
    return found, often


def _touching(
    model: pin.Model,
    solids: Sequence[Solid],
    pairs: Sequence[tuple[int, int]],
    postures: FloatArray,
) -> BoolArray:
    """Returns which pairs are nearer than MARGIN in which postures, shape (postures, pairs)."""
    geometry, results = _prepared(solids, pairs)
    data = model.createData()
    found = np.zeros((len(postures), len(pairs)), dtype=np.bool_)
    for k, q in enumerate(postures):
        pin.computeCollisions(model, data, geometry, results, q, False)
        found[k] = [result.isCollision() for result in results.collisionResults]
    return found


def _prepared(
    solids: Sequence[Solid], pairs: Sequence[tuple[int, int]]
) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """Returns pinocchio's geometry of some pairs, which counts them as touching when nearer than MARGIN."""
    geometry = geometry_model(solids, pairs)
    results = pin.GeometryData(geometry)
    for request in results.collisionRequests:
        request.security_margin = MARGIN
    return geometry, results


def touches(robot: Robot, postures: FloatArray, arms: Sequence[str]) -> BoolArray:
    """Returns the postures in which links are nearer than MARGIN that must keep apart, shape (n,).

    Args:
        robot: with its allowed contacts.
        postures: shape (n, joints) [rad or m].
        arms: arms that are looked at; what only other arms move does not count.
    """
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    others = [joint for arm in robot.arms if arm.name not in arms for joint in arm.joints]
    moved = {model.getJointId(joint) for joint in others}
    pairs = [
        (pair.first, pair.second)
        for pair in pairs_that_must_keep_apart(model, solids, bare_cell(robot))
        if not {solids[pair.first].joint, solids[pair.second].joint} & moved
    ]
    if not pairs:
        return np.zeros(len(postures), dtype=np.bool_)
    geometry, results = _prepared(solids, pairs)
    data = model.createData()
    return np.array(
        [
            pin.computeCollisions(model, data, geometry, results, q, True)
            for q in in_model_order(model, robot, postures)
        ]
    )


def joints_between(model: pin.Model, one: int, other: int) -> int:
    """Returns how many moving joints are between what two joints move."""
    ways = []
    for joint in (one, other):
        way = [joint]
        while way[-1] != 0:
            way.append(model.parents[way[-1]])
        ways.append(way)
    common = next(joint for joint in ways[0] if joint in ways[1])
    return ways[0].index(common) + ways[1].index(common)


def in_model_order(model: pin.Model, robot: Robot, postures: FloatArray) -> FloatArray:
    """Returns postures (n, joints) of the robot with their columns in the order of pinocchio's model."""
    ordered = np.empty_like(postures)
    ordered[:, [model.idx_qs[model.getJointId(name)] for name in robot.joints]] = postures
    return ordered
