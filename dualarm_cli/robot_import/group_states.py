"""Postures of a robot file: valid SRDF group states, and home."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import tanh
from dualarm_cli.geometry.linear_systems import singular_values
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import (
    CONTACT,
    in_model_order,
    random_postures,
    sampled_range,
    touches,
    touching_links,
)
from dualarm_cli.robot_import.srdf import Srdf

HOME = "home"
"""Name of the posture in which plans start."""
PROPOSED = "proposed; collision-free, away from joint limits and singular postures"
"""Comment on a proposed home posture."""
LOOKED_AT = 4000
"""Number of sampled postures that are compared."""
TRIED = 400
"""Maximum number of postures tested for collisions, best first."""
FEW = 40
"""Number of postures of each arm that are combined with the other arm's."""


_note = NoteTable(
    "posture",
    not_taken="posture {name} of the SRDF is not taken: {problem}",
    posture="posture {name}: {source}",
    no_home="posture home: none of the postures tried is collision-free; all joints are at 0, write one",
)


@dataclass(frozen=True)
class NamedPostures:
    """Named postures with messages."""

    values: Mapping[str, Mapping[str, float]]
    """Joint positions [rad or m] by posture, home first."""
    comments: Mapping[str, str]
    """Comments in the robot file by posture."""
    reasons: tuple[Note, ...]
    """Messages on accepted and rejected states."""


def find_postures(robot: Robot, srdf: Srdf, seed: int) -> NamedPostures:
    """Select the valid group states of an SRDF, and find a home posture.

    Joints that a state does not name stay as in home.

    Args:
        robot: with its allowed contacts; its home is the fallback.
        srdf: content of the SRDF.
        seed: of the sampled postures.
    """
    proposed = propose_home(robot, seed)
    home = robot.postures[HOME] if proposed is None else _rounded(robot, proposed)
    accepted: dict[str, FloatArray] = {}
    comments: dict[str, str] = {}
    reasons: list[Note] = []
    # Home first, because it completes the other states.
    for name in sorted(srdf.states, key=lambda name: name != HOME):
        state = srdf.states[name]
        posture = home.copy()
        for k, joint in enumerate(robot.joints):
            posture[k] = state.get(joint, posture[k])
        problem = srdf.conflicts.get(name) or _problem(robot, name, state, posture)
        if problem:
            reasons.append(_note("not_taken", name=name, problem=problem))
            continue
        missing = [arm.name for arm in robot.arms if not state.keys() & set(arm.joints)]
        comments[name] = "group state of the SRDF"
        if missing:
            comments[name] += f"; {' and '.join(missing)} arm as in home"
        reasons.append(_note("posture", name=name, source=comments[name]))
        accepted[name] = posture
        if name == HOME:
            home = posture
    if HOME not in accepted:
        accepted = {HOME: home, **accepted}
        if proposed is None:
            reasons.append(_note("no_home"))
        else:
            comments[HOME] = PROPOSED
            reasons.append(_note("posture", name=HOME, source=PROPOSED))
    values = {
        name: dict(zip(robot.joints, posture.tolist(), strict=True))
        for name, posture in accepted.items()
    }
    return NamedPostures(values, comments, tuple(reasons))


def _rounded(robot: Robot, posture: FloatArray) -> FloatArray:
    """Round a posture to 0.1 mrad or 0.1 mm, within the limits."""
    return np.clip(np.round(posture, 4), robot.limits.lower, robot.limits.upper)


def _problem(robot: Robot, name: str, state: Mapping[str, float], posture: FloatArray) -> str:
    """Explain why a state is no valid posture of a robot file.

    Empty if it is.
    """
    if name == "free":
        return "`free` cannot name a posture"
    if not any(state.keys() >= set(arm.joints) for arm in robot.arms):
        return "it does not name all joints of an arm"
    limits = robot.limits
    for k, joint in enumerate(robot.joints):
        if not limits.lower[k] <= posture[k] <= limits.upper[k]:
            return f"{joint} at {posture[k]:g} is outside its limits, {limits.lower[k]:g} to {limits.upper[k]:g}"
    links = touching_links(robot, posture)
    if links:
        more = f" and {len(links) - 1} more" if len(links) > 1 else ""
        return (
            f"{' and '.join(links[0])}{more} collide or are nearer than {1e3 * CONTACT.margin:g} mm"
        )
    return ""


def propose_home(robot: Robot, seed: int) -> FloatArray | None:
    """Find a collision-free posture (joints,) [rad or m], or None.

    The platform is at 0 or nearest to it; if that collides, a sliding platform is tried in the middle and at the ends.

    Args:
        robot: with its allowed contacts.
        seed: of the random postures.
    """
    columns = robot.columns(robot.platform)
    lower, upper = robot.limits.lower[columns], robot.limits.upper[columns]
    places = [np.clip(0.0, lower, upper)]
    if robot.platform and robot.sliding.issuperset(robot.platform):
        places += [0.5 * (lower + upper), upper, lower]
    homes = (_home_at(robot, seed, place) for place in places)
    return next((home for home in homes if home is not None), None)


def _home_at(robot: Robot, seed: int, place: FloatArray) -> FloatArray | None:
    """Find a collision-free posture for a platform position (k,), or None."""
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    limits = robot.limits
    middle = np.clip(0.0, limits.lower, limits.upper)
    middle[robot.columns(robot.platform)] = place
    lower, upper = sampled_range(robot)
    width, centre = upper - lower, 0.5 * (lower + upper)
    postures = random_postures(robot, LOOKED_AT, seed)
    # Around the middle of the ranges: postures in the outer half are seldom a useful start.
    postures = centre + 0.7 * (postures - centre)
    postures[:, robot.columns(robot.platform)] = middle[robot.columns(robot.platform)]
    ordered = in_model_order(model, robot, postures)
    best: dict[str, list[int]] = {}
    for arm in robot.arms:
        columns = robot.columns(arm.joints)
        moved = [model.idx_vs[model.getJointId(name)] for name in arm.joints]
        frame = model.getFrameId(arm.flange)
        side = {"left": 1.0, "right": -1.0}[arm.name] if len(robot.arms) > 1 else 0.0
        score = np.empty(len(postures))
        for k, (q, in_order) in enumerate(zip(postures, ordered, strict=True)):
            jacobian = pin.computeFrameJacobian(model, data, in_order, frame, pin.LOCAL)[:, moved]
            values = singular_values(jacobian)
            pin.framesForwardKinematics(model, data, in_order)
            pose = data.oMf[frame]
            room = np.min(
                0.5 - np.abs(q[columns] - centre[columns]) / np.maximum(width[columns], 1e-9)
            )
            down = -pose.rotation[2, 2]
            front = tanh(4.0 * pose.translation[0])
            own_side = tanh(4.0 * side * pose.translation[1])
            score[k] = 2.0 * room + down + 0.5 * front + 0.5 * own_side + 2.0 * min(values[-1], 0.2)
        best[arm.name] = np.argsort(-score, kind="stable")[:TRIED].tolist()

    def combined(numbers: dict[str, list[int]]) -> FloatArray:
        """Combine sampled postures of each arm, given by index, shape (n, joints)."""
        rows = np.tile(middle, (len(next(iter(numbers.values()))), 1))
        for name, chosen in numbers.items():
            columns = robot.columns(robot.arm(name).joints)
            rows[:, columns] = postures[np.ix_(chosen, columns)]
        return rows

    free: dict[str, list[int]] = {}
    for name, numbers in best.items():
        clear = ~touches(robot, combined({name: numbers}), [name])
        free[name] = [number for number, ok in zip(numbers, clear, strict=True) if ok][:FEW]
    if not all(free.values()):
        return None
    # Combinations of both arms' best postures come first.
    pairs = sorted(product(*(range(len(indices)) for indices in free.values())), key=sum)[:TRIED]
    candidates = combined(
        {name: [rows[pair[a]] for pair in pairs] for a, (name, rows) in enumerate(free.items())}
    )
    usable = np.flatnonzero(~touches(robot, candidates, list(free)))
    return candidates[usable[0]] if len(usable) else None
