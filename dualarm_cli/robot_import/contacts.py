"""Links that overlap by construction, found by sampling postures, as in MoveIt's assistant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    Solid,
    geometry_model,
    link_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.structure import count_of

_note = NoteTable(
    "contacts",
    allowed="links that may touch, see allowed_contacts: {pairs}",
    assumed="links that touch in many postures, see assumed_contacts: {pairs}; their shapes are assumed to be wider "
    "than the links. Judge them, or give them finer shapes (--convex-parts)",
    stated="links whose collisions the SRDF leaves out though they touch in some postures, see assumed_contacts: "
    "{pairs}; each plan lists them. Judge them",
    kept_apart="{links:* and } {why}, and are kept apart",
)


@dataclass(frozen=True)
class ContactSettings:
    """Thresholds on sampled postures that classify touching links."""

    postures: int = 10_000
    """Number of sampled postures."""
    few: int = 200
    """Number of postures after which rarely touching pairs are dropped.

    Pairs that touch in less than half of the fraction `often` are dropped unless the SRDF names them.
    """
    always: float = 0.95
    """Fraction of postures from which two links overlap by construction."""
    mostly: float = 0.55
    """Fraction of postures from which near links' shapes count as too wide."""
    near: int = 3
    """Maximum number of moving joints between links that count as near."""
    often: float = 0.5
    """Fraction of postures from which touching links that are not near are reported."""
    margin: float = 0.01
    """Distance below which links count as touching: the clearance a cell may require [m]."""


CONTACT = ContactSettings()


@dataclass(frozen=True)
class Contact:
    """Pair of links whose shapes overlap although the links do not."""

    links: tuple[str, str]
    """Names of the links."""
    why: str
    """Reason why they may touch."""
    assumed: bool = False
    """Flag of a contact that is only assumed to be caused by wide shapes."""
    stated: bool = False
    """Flag of a pair that the SRDF excludes from collision checking."""


def bare_cell(robot: Robot) -> Cell:
    """Build a cell that contains only a robot."""
    tools = {arm.name: Tool(pin.SE3.Identity()) for arm in robot.arms}
    return Cell(robot, pin.SE3.Identity(), tools, {}, ())


def sampled_range(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Compute the sampled position ranges [rad or m]; turning joints get at most ±2π."""
    bound = np.array([np.inf if name in robot.sliding else TURN for name in robot.joints])
    return np.maximum(robot.limits.lower, -bound), np.minimum(robot.limits.upper, bound)


def random_postures(robot: Robot, count: int, seed: int) -> FloatArray:
    """Sample postures within the limits, shape (count, joints) [rad or m].

    Joints without limits are sampled within ±2π.

    Args:
        robot: of the data model.
        count: number of postures.
        seed: of the random numbers.
    """
    lower, upper = sampled_range(robot)
    return np.random.default_rng(seed).uniform(lower, upper, (count, len(robot.joints)))


def find_contacts(
    robot: Robot, excluded: Mapping[frozenset[str], str], seed: int
) -> tuple[list[Contact], list[Contact]]:
    """Find the pairs of links that touch always, and those that often touch.

    Links that touch only in some postures may really collide: the robot file lists those that are assumed not to. Pairs
    excluded by the SRDF are sampled too: if they touch always or never, they are allowed, else assumed.

    Args:
        robot: without allowed contacts.
        excluded: pairs that the SRDF excludes from collision checking, with its reason.
        seed: of the postures.
    """
    model, solids, pairs = _kept_apart(robot)
    if not pairs:
        return [], []
    named = [frozenset(solids[k].body for k in pair) in excluded for pair in pairs]
    postures = in_model_order(model, robot, random_postures(robot, CONTACT.postures, seed))
    rough = _touching(model, solids, pairs, postures[: CONTACT.few]).mean(axis=0)
    chosen = np.flatnonzero(np.array(named) | (rough >= 0.5 * CONTACT.often))
    fractions = dict(enumerate(rough.tolist()))
    if len(chosen):
        finer = _touching(model, solids, [pairs[k] for k in chosen], postures).mean(axis=0)
        fractions |= dict(zip(chosen.tolist(), finer.tolist(), strict=True))
    by_bodies: dict[tuple[str, str], tuple[float, int]] = {}
    for k, (i, j) in enumerate(pairs):
        names = (solids[i].body, solids[j].body)
        between = joints_between(model, solids[i].joint, solids[j].joint)
        by_bodies[names] = max((fractions[k], between), by_bodies.get(names, (0.0, between)))
    always, often = [], []
    for names, (fraction, between) in by_bodies.items():
        why = f"touch in {100 * fraction:.3g}% of {CONTACT.postures} postures"
        stated = excluded.get(frozenset(names))
        if stated is not None:
            why = f"SRDF: {stated}; {why}"
        if fraction >= CONTACT.always or (stated is not None and fraction == 0.0):
            always.append(Contact(names, why, stated=stated is not None))
        elif stated is not None or fraction >= (
            CONTACT.mostly if between <= CONTACT.near else CONTACT.often
        ):
            assumed = stated is not None or between <= CONTACT.near
            often.append(Contact(names, why, assumed, stated is not None))
    return always, often


def contact_reasons(contacts: Sequence[Contact], often: Sequence[Contact]) -> list[Note]:
    """Compose the messages on contacts: allowed, assumed, and frequent ones that are checked.

    Args:
        contacts: pairs that may touch.
        often: pairs that touch in some postures only.
    """
    reasons = []
    if contacts:
        reasons.append(_note("allowed", pairs=count_of(len(contacts), "pair")))
    shapes = sum(pair.assumed and not pair.stated for pair in often)
    if shapes:
        reasons.append(_note("assumed", pairs=count_of(shapes, "pair")))
    stated = sum(pair.stated for pair in often)
    if stated:
        reasons.append(_note("stated", pairs=count_of(stated, "pair")))
    reasons += [
        _note("kept_apart", links=pair.links, why=pair.why) for pair in often if not pair.assumed
    ]
    return reasons


def _kept_apart(robot: Robot) -> tuple[pin.Model, list[Solid], list[tuple[int, int]]]:
    """Build a robot's model, its solids, and the pairs of solids that are checked."""
    model = pin.buildModelFromXML(robot.urdf)
    solids = link_solids(model, robot)
    pairs = pairs_that_must_keep_apart(model, solids, bare_cell(robot))
    return model, solids, [(pair.first, pair.second) for pair in pairs]


def _touching(
    model: pin.Model,
    solids: Sequence[Solid],
    pairs: Sequence[tuple[int, int]],
    postures: FloatArray,
) -> BoolArray:
    """Mark the pairs nearer than the margin in each posture, shape (postures, pairs)."""
    geometry, results = _prepared(solids, pairs)
    data = model.createData()
    touching = np.zeros((len(postures), len(pairs)), dtype=np.bool_)
    for k, q in enumerate(postures):
        pin.computeCollisions(model, data, geometry, results, q, False)
        touching[k] = [result.isCollision() for result in results.collisionResults]
    return touching


def _prepared(
    solids: Sequence[Solid], pairs: Sequence[tuple[int, int]]
) -> tuple[pin.GeometryModel, pin.GeometryData]:
    """Build pinocchio's geometry of given pairs, with the margin as contact distance."""
    geometry = geometry_model(solids, pairs)
    results = pin.GeometryData(geometry)
    for request in results.collisionRequests:
        request.security_margin = CONTACT.margin
    return geometry, results


def touches(robot: Robot, postures: FloatArray, arms: Sequence[str]) -> BoolArray:
    """Mark the postures in which checked links are nearer than the margin, shape (n,).

    Args:
        robot: with its allowed contacts.
        postures: shape (n, joints) [rad or m].
        arms: checked arms; links moved only by other arms are ignored.
    """
    model, solids, pairs = _kept_apart(robot)
    others = [joint for arm in robot.arms if arm.name not in arms for joint in arm.joints]
    moved = {model.getJointId(joint) for joint in others}
    pairs = [(i, j) for i, j in pairs if not {solids[i].joint, solids[j].joint} & moved]
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


def touching_links(robot: Robot, posture: FloatArray) -> list[tuple[str, str]]:
    """List the checked links nearer than the margin in a posture.

    Args:
        robot: with its allowed contacts.
        posture: shape (joints,) [rad or m].
    """
    model, solids, pairs = _kept_apart(robot)
    if not pairs:
        return []
    touching = _touching(model, solids, pairs, in_model_order(model, robot, posture[None]))[0]
    names = [
        (solids[i].body, solids[j].body) for (i, j), on in zip(pairs, touching, strict=True) if on
    ]
    return list(dict.fromkeys(names))


def joints_between(model: pin.Model, joint_a: int, joint_b: int) -> int:
    """Count the moving joints between the bodies of two joints."""
    ancestries = []
    for joint in (joint_a, joint_b):
        ancestry = [joint]
        while ancestry[-1] != 0:
            ancestry.append(model.parents[ancestry[-1]])
        ancestries.append(ancestry)
    common = next(joint for joint in ancestries[0] if joint in ancestries[1])
    return ancestries[0].index(common) + ancestries[1].index(common)


def in_model_order(model: pin.Model, robot: Robot, postures: FloatArray) -> FloatArray:
    """Reorder postures (n, joints) of the robot into the joint order of pinocchio's model."""
    ordered = np.empty_like(postures)
    ordered[:, [model.idx_qs[model.getJointId(name)] for name in robot.joints]] = postures
    return ordered
