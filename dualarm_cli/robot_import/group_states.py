"""Postures of a robot file: valid SRDF group states, and home."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.robot import Robot
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import CONTACT, touching_links
from dualarm_cli.robot_import.home import propose_home
from dualarm_cli.robot_import.srdf import Srdf

HOME = "home"
"""Name of the posture in which plans start."""
PROPOSED = "proposed; tools down, collision-free, away from joint limits and singular postures"
"""Comment on a proposed home posture."""
NOT_PROPOSED = "not proposed: {why}; its joints are at 0 or nearest to it; write it under `postures` of robot.yaml"
"""Comment on a home posture that was not found, with its reason."""


_note = NoteTable(
    "posture",
    not_taken="posture {name} of the SRDF is not taken: {problem}",
    posture="posture {name}: {source}",
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


def find_postures(
    robot: Robot, tcps: Mapping[str, pin.SE3], srdf: Srdf, seed: int
) -> NamedPostures:
    """Select the valid group states of an SRDF, and find a home posture.

    Joints that a state does not name stay as in home.

    Args:
        robot: with its allowed contacts; its home is the fallback.
        tcps: tool frame of each arm in its flange's, z along the tool.
        srdf: content of the SRDF.
        seed: of the sampled postures.
    """
    proposed = propose_home(robot, tcps, seed)
    comments = {HOME: PROPOSED}
    home = robot.postures[HOME]
    if isinstance(proposed, Note):
        comments[HOME] = NOT_PROPOSED.format(why=proposed)
    else:
        home = _rounded(robot, proposed)
    accepted: dict[str, FloatArray] = {}
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
        reasons.append(_note("posture", name=HOME, source=comments[HOME]))
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
