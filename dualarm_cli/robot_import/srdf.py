"""SRDF: what MoveIt knows of a robot besides its URDF."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from dualarm_cli.files.robots.urdf import Urdf
from dualarm_cli.files.robots.urdf_tree import Element, UrdfFindings, parse_xml
from dualarm_cli.files.source.text_source import quote, read_text

_NEVER = ("never", "default")


@dataclass(frozen=True)
class Srdf:
    """What an SRDF says of arms, postures and contacts."""

    tips: Mapping[str, str] = field(default_factory=dict)
    """Links at the ends of the groups of arms, by side."""
    states: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named postures: joint positions [rad or m]; states of one name of several groups are one posture."""
    contacts: Mapping[frozenset[str], str] = field(default_factory=dict)
    """Pairs of links that may touch, with the reason that it gives."""


def read_srdf(path: Path, urdf: Urdf) -> Srdf:
    """Returns what an SRDF says.

    Args:
        path: the file.
        urdf: the robot that it is for.

    Raises:
        InputError: not XML, not an SRDF, or a link or joint that the URDF does not have.
    """
    source = read_text(path, str(path))
    root = parse_xml(source)
    findings = UrdfFindings(source)
    if root.tag != "robot":
        findings.add(root, f"root element must be <robot>, not <{root.tag}>")
        findings.raise_if_any()
    tips, states = _tips(root, urdf, findings), _states(root, urdf, findings)
    contacts: dict[frozenset[str], str] = {}
    for element in root.all("disable_collisions"):
        names = [element.get("link1"), element.get("link2")]
        for name in names:
            if name not in urdf.links:
                findings.add(element, f"the URDF has no link {quote(name)}")
        reason = element.get("reason", "no reason given")
        if reason.lower() not in _NEVER and len(set(names)) == 2:
            contacts[frozenset(names)] = reason
    findings.raise_if_any()
    return Srdf(tips, states, contacts)


def _tips(root: Element, urdf: Urdf, findings: UrdfFindings) -> dict[str, str]:
    """Returns the ends of the groups whose names tell an arm and its side."""
    tips: dict[str, str] = {}
    for group in root.all("group"):
        chain = group.find("chain")
        side = next((s for s in ("left", "right") if re.search(s, group.name, re.IGNORECASE)), "")
        if chain is None or not side or re.search("hand|gripper|finger", group.name, re.IGNORECASE):
            continue
        tip = chain.get("tip_link")
        if tip not in urdf.links:
            findings.add(chain, f"the URDF has no link {quote(tip)}")
        tips.setdefault(side, tip)
    return tips


def _states(root: Element, urdf: Urdf, findings: UrdfFindings) -> dict[str, dict[str, float]]:
    """Returns the named postures."""
    states: dict[str, dict[str, float]] = {}
    for state in root.all("group_state"):
        for joint in state.all("joint"):
            if joint.name not in urdf.joints:
                findings.add(joint, f"the URDF has no joint {quote(joint.name)}")
                continue
            if len(joint.get("value").split()) != 1:
                continue  # of a joint with several positions, which stays where it is
            value = findings.numbers(joint, "value", 1, f"joint {quote(joint.name)}")
            if value is not None and math.isfinite(value[0]):
                states.setdefault(state.name, {})[joint.name] = value[0]
    return states
