"""SRDF: MoveIt's arms, postures and contacts of a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path

from dualarm_cli.errors import UsageError
from dualarm_cli.files.robots.urdf import Urdf
from dualarm_cli.files.robots.urdf_tree import Element, UrdfFindings, parse_xml
from dualarm_cli.files.source.text_source import TextSource, quote
from dualarm_cli.notes import Note
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.expanded_text import program_notes
from dualarm_cli.robot_import.structure import (
    GRIPPER,
    NO_ARM,
    SIDES,
    ArmChain,
    NamedTip,
    Structure,
    side_of,
    word_among,
    words,
)


@dataclass(frozen=True)
class Srdf:
    """Arms, postures and contacts of an SRDF."""

    tips: Mapping[str, tuple[NamedTip, ...]] = field(default_factory=dict)
    """Tip links of groups that may be the arm, by side."""
    states: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Named postures: joint positions [rad or m].

    Equal names of several groups form one posture.
    """
    conflicts: Mapping[str, str] = field(default_factory=dict)
    """Contradictions within named postures, by posture."""
    contacts: Mapping[frozenset[str], str] = field(default_factory=dict)
    """Pairs of links excluded from collision checking, with the SRDF's reason."""
    end_effectors: tuple[tuple[str, ...], ...] = ()
    """Links of each end effector: the one that carries it, then those of its group."""
    notes: tuple[Note, ...] = ()
    """Notes on the reading."""


def read_srdf(source: TextSource, urdf: Urdf) -> Srdf:
    """Read an SRDF.

    Args:
        source: its text.
        urdf: of the same robot.

    Raises:
        InputError: not XML, not an SRDF, or a link or joint that the URDF does not have.
    """
    root = parse_xml(source)
    findings = UrdfFindings(source)
    if root.tag != "robot":
        findings.add(root, f"root element must be <robot>, not <{root.tag}>")
        findings.raise_if_any()
    tips = _tips(root, urdf, findings)
    states, conflicts = _states(root, urdf, findings)
    contacts = _contacts(root, urdf, findings)
    effectors = _end_effectors(root, urdf, findings)
    findings.raise_if_any()
    return Srdf(tips, states, conflicts, contacts, effectors, program_notes(source))


def named_tips(srdf: Srdf, requested: Mapping[str, str]) -> dict[str, NamedTip]:
    """Select the tip link of each side: from options, or else from the SRDF.

    Args:
        srdf: content of the SRDF.
        requested: links named by options, by side.

    Raises:
        UsageError: groups of one side end in different links, and no option chooses.
    """
    tips = {}
    for side in SIDES:
        groups = srdf.tips.get(side, ())
        if side in requested:
            tips[side] = NamedTip(requested[side], f"--{side}-tip")
        elif len({tip.link for tip in groups}) > 1:
            several = ", ".join(f"{tip.link} ({tip.by})" for tip in groups)
            raise UsageError(f"the {side} arm may end in {several}; say which with --{side}-tip")
        elif groups:
            tips[side] = groups[0]
    return tips


def with_hands(structure: Structure, srdf: Srdf, urdf: Urdf) -> Structure:
    """Name the hand of each arm with an end effector.

    It is the outermost link that is fixed to the arm. An end effector with links that the arm's last joint does not
    move is the arm itself, and no hand.

    Args:
        structure: arms of the robot.
        srdf: content of the SRDF.
        urdf: of the robot.
    """
    arms: dict[str, ArmChain] = {}
    for side, arm in structure.arms.items():
        hand, last = "", arm.joints[-1]
        for links in srdf.end_effectors:
            chains = {link: urdf.chain(link) for link in links}
            fixed = [
                k for k, chain in chains.items() if chain[-1:] == [last] and k not in urdf.joints
            ]
            if all(last in chain for chain in chains.values()):
                hand = max(fixed, key=lambda link: len(urdf.path(link)), default=hand)
        arms[side] = replace(arm, hand=hand)
    return replace(structure, arms=arms)


def _tips(root: Element, urdf: Urdf, findings: UrdfFindings) -> dict[str, tuple[NamedTip, ...]]:
    """Find the tips of the groups whose names mean an arm of one side.

    Groups with the word `arm` take precedence.
    """
    tips: dict[str, dict[str, NamedTip]] = {side: {} for side in SIDES}
    for group in root.all("group"):
        chain, side = group.find("chain"), side_of(group.name)
        if chain is None or not side or word_among(group.name, NO_ARM | GRIPPER):
            continue
        tip = chain.get("tip_link")
        if tip not in urdf.links:
            findings.add(chain, f"the URDF has no link {quote(tip)}")
        place = f"group {quote(group.name)} of {Path(findings.source.name).name}"
        tips[side][group.name] = NamedTip(tip, place)
    tips_by_side = {}
    for side, groups in tips.items():
        arms = [tip for name, tip in groups.items() if "arm" in words(name)]
        tips_by_side[side] = tuple(arms or groups.values())
    return tips_by_side


def _end_effectors(
    root: Element, urdf: Urdf, findings: UrdfFindings
) -> tuple[tuple[str, ...], ...]:
    """Collect the links of each end effector."""
    groups = {group.name: group for group in root.all("group")}
    effectors = []
    for element in root.all("end_effector"):
        named = [(element, element.get("parent_link"))]
        group = groups.get(element.get("group"))
        for part in group.children if group else ():
            if part.tag == "link":
                named.append((part, part.name))
            elif part.tag == "joint" and part.name in urdf.joints:
                named.append((part, urdf.joints[part.name].child_name("child", "link")))
            elif part.tag == "chain":
                named += [(part, part.get(key)) for key in ("base_link", "tip_link")]
        for place, link in named:
            if link not in urdf.links:
                findings.add(place, f"the URDF has no link {quote(link)}")
        effectors.append(tuple(dict.fromkeys(link for _, link in named)))
    return tuple(effectors)


def _contacts(root: Element, urdf: Urdf, findings: UrdfFindings) -> dict[frozenset[str], str]:
    """Collect the pairs excluded from collision checking, except those that never touch."""
    contacts: dict[frozenset[str], str] = {}
    for element in root.all("disable_collisions"):
        names = [element.get("link1"), element.get("link2")]
        for key, name in zip(("link1", "link2"), names, strict=True):
            if not name:
                findings.add(element, f"<disable_collisions> has no {key}; it needs two links")
            elif name not in urdf.links:
                findings.add(element, f"the URDF has no link {quote(name)}")
        reason = element.get("reason") or "no reason given"
        if reason.lower() not in ("never", "default") and len(set(names)) == 2:
            contacts[frozenset(names)] = reason
    return contacts


def _states(
    root: Element, urdf: Urdf, findings: UrdfFindings
) -> tuple[dict[str, dict[str, float]], dict[str, str]]:
    """Read the named postures, and the contradictions between their groups."""
    states: dict[str, dict[str, float]] = {}
    conflicts: dict[str, str] = {}
    for state in root.all("group_state"):
        if not state.name:
            findings.add(state, "<group_state> has no name")
        for joint in state.all("joint"):
            if len(joint.get("value").split()) > 1:
                continue  # a joint with several positions, such as the fixed base
            if joint.name not in urdf.joints:
                findings.add(joint, f"the URDF has no joint {quote(joint.name)}")
                continue
            value = findings.numbers(joint, "value", 1, f"joint {quote(joint.name)}")
            if value is None:
                continue
            previous = states.setdefault(state.name, {}).setdefault(joint.name, value[0])
            if previous != value[0]:
                conflicts[state.name] = f"{joint.name} is at {previous:g} and at {value[0]:g}"
    return states, conflicts
