"""Postures of a robot file: those that the SRDF names, as far as they can be taken, and a start posture."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import Robot
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import MARGIN, touching_links
from dualarm_cli.robot_import.home import propose_home
from dualarm_cli.robot_import.srdf import Srdf

HOME = "home"
"""The posture in which plans begin."""
PROPOSED = "proposed; collision-free, away from joint limits and singular postures"
"""Comment on a home that nobody states."""


@dataclass(frozen=True)
class NamedPostures:
    """Named postures, and messages on them."""

    values: Mapping[str, Mapping[str, float]]
    """Joint positions [rad or m] by posture, home first."""
    comments: Mapping[str, str]
    """What the robot file says of them."""
    reasons: tuple[str, ...]
    """What was taken and what was not, and why."""


def find_postures(robot: Robot, srdf: Srdf, seed: int) -> NamedPostures:
    """Returns the group states of an SRDF that a robot can be in, and a home.

    Joints that a state does not name are where home has them.

    Args:
        robot: with its allowed contacts; its home is where nothing better is found.
        srdf: what an SRDF says.
        seed: of the postures among which home is sought.
    """
    proposed = propose_home(robot, seed)
    rest = robot.postures[HOME] if proposed is None else _rounded(robot, proposed)
    taken: dict[str, FloatArray] = {}
    comments: dict[str, str] = {}
    reasons: list[str] = []
    # Home first: the other states are filled up from it.
    for name in sorted(srdf.states, key=lambda name: name != HOME):
        state = srdf.states[name]
        posture = rest.copy()
        for k, joint in enumerate(robot.joints):
            posture[k] = state.get(joint, posture[k])
        problem = srdf.conflicts.get(name) or _problem(robot, name, state, posture)
        if problem:
            reasons.append(f"posture {name} of the SRDF is not taken: {problem}")
            continue
        missing = [arm.name for arm in robot.arms if not state.keys() & set(arm.joints)]
        comments[name] = "group state of the SRDF"
        if missing:
            comments[name] += f"; {' and '.join(missing)} arm as in home"
        reasons.append(f"posture {name}: {comments[name]}")
        taken[name] = posture
        if name == HOME:
            rest = posture
    if HOME not in taken:
        taken = {HOME: rest, **taken}
        if proposed is None:
            reasons.append(
                "posture home: none of the postures tried is collision-free; all joints are at 0, write one"
            )
        else:
            comments[HOME] = PROPOSED
            reasons.append(f"posture home: {PROPOSED}")
    values = {
        name: dict(zip(robot.joints, posture.tolist(), strict=True))
        for name, posture in taken.items()
    }
    return NamedPostures(values, comments, tuple(reasons))


def _rounded(robot: Robot, posture: FloatArray) -> FloatArray:
    """Returns a posture in tenths of a milliradian or millimetre, within the limits."""
    return np.clip(np.round(posture, 4), robot.limits.lower, robot.limits.upper)


def _problem(robot: Robot, name: str, state: Mapping[str, float], posture: FloatArray) -> str:
    """Returns why a state cannot be a posture of a robot file, or nothing."""
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
        return f"{' and '.join(links[0])}{more} collide or are nearer than {1e3 * MARGIN:g} mm"
    return ""
