"""Which joints of a URDF are arms and which carry both, found in its tree."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from dualarm_cli.errors import UsageError, did_you_mean
from dualarm_cli.files.robots.frozen_joints import nearest_to_zero, position_range
from dualarm_cli.files.robots.urdf import MOVING_TYPES, Urdf

LEAST_AXES = 6
"""Fewest joints of an arm."""
PLATFORM_JOINTS = 2
"""Most joints that may carry both arms."""
_OTHERS = re.compile(r"leg|foot|ankle|hip|knee|wheel|caster|head|neck|eye|laser", re.IGNORECASE)
_GRIPPER = re.compile(r"grip|finger|hand|knuckle|claw|thumb|suction", re.IGNORECASE)
_TIPS = (
    r"tool0$",
    r"flange",
    r"ee_?link|end_?effector|_ee$",
    r"tcp|tip$",
    r"palm|hand|gripper",
    r"wrist",
)
"""Names of links that tools are bolted to, best first."""
_SIDES = {
    "left": re.compile(r"(^|[_\-.])(left|l)([_\-.]|$)|^left|left$", re.IGNORECASE),
    "right": re.compile(r"(^|[_\-.])(right|r)([_\-.]|$)|^right|right$", re.IGNORECASE),
}


class OpenChoiceError(UsageError):
    """A tree that does not tell which of its rows of joints are the arms."""

    def __init__(self, tips: tuple[str, ...]) -> None:
        """Stores the links in which those rows end."""
        self.tips = tips
        super().__init__(
            f"the tree has {len(tips)} rows of joints that may be arms, ending in {', '.join(tips)}; "
            "say which with --left-tip and --right-tip"
        )


@dataclass(frozen=True)
class ArmChain:
    """A row of joints that may be an arm."""

    joints: tuple[str, ...]
    """From base to flange."""
    tip: str
    """Link to which the tool is bolted."""


@dataclass(frozen=True)
class FrozenSlide:
    """A lift or rail that carries arms and stands still, though it need not."""

    joint: str
    """Its name."""
    position: float
    """Where it stands [m]."""
    lower: float
    """Its lowest position [m]."""
    upper: float
    """Its highest position [m]."""
    arm: str = ""
    """Side of the arm that it carries as its first joint; empty where it carries both."""


@dataclass(frozen=True)
class Structure:
    """Arms and platform of a robot."""

    arms: Mapping[str, ArmChain]
    """By side: left, right or both."""
    platform: tuple[str, ...]
    """Joints that carry both arms, world side first."""
    reasons: tuple[str, ...]
    """What was decided, and why."""
    frozen: tuple[FrozenSlide, ...] = ()
    """Lifts and rails that carry arms and stand still."""

    @property
    def joints(self) -> list[str]:
        """Joints of the platform and the arms."""
        return [*self.platform, *(joint for arm in self.arms.values() for joint in arm.joints)]


def moving(urdf: Urdf) -> list[str]:
    """Returns the joints that turn or slide and follow no other one, in document order."""
    return [
        name
        for name, joint in urdf.joints.items()
        if joint.get("type") in MOVING_TYPES and joint.find("mimic") is None
    ]


def find_structure(
    urdf: Urdf, tips: Mapping[str, str], platform: Sequence[str] | None
) -> Structure:
    """Returns the arms and the platform of a robot.

    Args:
        urdf: a checked URDF.
        tips: links that tools are bolted to, by side, where the user names them.
        platform: joints that carry both arms, where the user names them.

    Raises:
        UsageError: a name that there is not, or a tree that leaves a choice; it says which options settle it.
    """
    reasons = []
    for side, tip in tips.items():
        if tip not in urdf.links:
            hint = did_you_mean(tip, list(urdf.links))
            raise UsageError(f"--{side}-tip: the URDF has no link '{tip}'{hint}")
    if tips:
        ends = {
            side: [n for n in urdf.chain(tip) if n in set(moving(urdf))]
            for side, tip in tips.items()
        }
        carried = _common(list(ends.values())) if len(ends) == 2 else []
        arms = {
            side: ArmChain(_arm_part(urdf, joints[len(carried) :]), tips[side])
            for side, joints in ends.items()
        }
        for side, chain in arms.items():
            if len(chain.joints) < LEAST_AXES:
                raise UsageError(
                    f"--{side}-tip: link '{tips[side]}' is moved by {len(chain.joints)} joints that turn "
                    f"({', '.join(chain.joints) or 'none'}); an arm has at least {LEAST_AXES}"
                )
    else:
        arms = _found_arms(urdf)
        reasons += [
            f"{side} arm: {', '.join(arm.joints)}; flange {arm.tip}" for side, arm in arms.items()
        ]
    carriers = _common([urdf.chain(arm.tip) for arm in arms.values()]) if len(arms) == 2 else []
    chosen, told = _platform(urdf, carriers, platform, reasons)
    return Structure(arms, chosen, told, _frozen_slides(urdf, arms, carriers, chosen))


def _slides(urdf: Urdf) -> list[str]:
    """Returns the joints that slide between limits and follow no other one."""
    return [
        name
        for name in moving(urdf)
        if urdf.joints[name].get("type") == "prismatic"
        and all(map(math.isfinite, position_range(urdf.joints[name])))
    ]


def _frozen_slides(
    urdf: Urdf, arms: Mapping[str, ArmChain], carriers: Sequence[str], platform: Sequence[str]
) -> tuple[FrozenSlide, ...]:
    """Returns the joints that slide below arms and stand still: those that carry both, and those right before one."""
    usable = set(_slides(urdf)).difference(platform)
    sides = dict.fromkeys((name for name in carriers if name in usable), "")
    for side, arm in arms.items():
        before = [n for n in urdf.chain(arm.tip) if n in moving(urdf)]
        place = before.index(arm.joints[0]) - 1
        if place >= 0 and before[place] in usable and before[place] not in sides:
            sides[before[place]] = side
    return tuple(
        FrozenSlide(name, nearest_to_zero(joint), *position_range(joint), side)
        for name, side in sides.items()
        for joint in (urdf.joints[name],)
    )


def _platform(
    urdf: Urdf, carriers: list[str], asked: Sequence[str] | None, reasons: list[str]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Returns the joints of the platform and all reasons."""
    turning = [
        n for n in carriers if n in moving(urdf) and urdf.joints[n].get("type") != "prismatic"
    ]
    if asked is not None:
        for name in asked:
            if name not in carriers:
                known = ", ".join(carriers) or "none"
                raise UsageError(
                    f"--platform: '{name}' does not carry both arms; these do: {known}"
                )
        return tuple(n for n in carriers if n in asked), tuple(reasons)
    chosen = turning[-PLATFORM_JOINTS:]
    if chosen:
        reasons.append(f"platform: {', '.join(chosen)}: carries both arms")
    lifts = [name for name in carriers if name in _slides(urdf)]
    for name in lifts:
        place = nearest_to_zero(urdf.joints[name])
        reasons.append(
            f"{name}: slides and carries both arms; stands at {1e3 * place:g} mm; --platform {name} lets it move "
            "between stages"
        )
    left = [name for name in carriers if name not in (*chosen, *lifts)]
    if left:
        reasons.append(f"joints below the arms that stay where they are: {', '.join(left)}")
    return tuple(chosen), tuple(reasons)


def _common(chains: list[list[str]]) -> list[str]:
    """Returns the joints with which all chains begin."""
    found = []
    for names in zip(*chains, strict=False):
        if len(set(names)) > 1:
            break
        found.append(names[0])
    return found


def _found_arms(urdf: Urdf) -> dict[str, ArmChain]:
    """Returns the arms by side, from the tree and the names in it."""
    candidates = [chain for chain in _chains(urdf) if not _OTHERS.search(" ".join(chain.joints))]
    if not candidates:
        raise UsageError(
            f"no arm was found: no row of {LEAST_AXES} joints or more that turn; name its end with --left-tip"
        )
    if len(candidates) == 1:
        return {"left": candidates[0]}
    if len(candidates) > 2:
        named = [
            c for c in candidates if re.search("arm", " ".join((*c.joints, c.tip)), re.IGNORECASE)
        ]
        candidates = named if len(named) == 2 else candidates
    sides = {side: [c for c in candidates if _is_of(side, c)] for side in ("left", "right")}
    if (
        len(candidates) == 2
        and all(len(found) == 1 for found in sides.values())
        and sides["left"] != sides["right"]
    ):
        return {side: found[0] for side, found in sides.items()}
    raise OpenChoiceError(tuple(chain.tip for chain in candidates))


def _is_of(side: str, chain: ArmChain) -> bool:
    """Returns whether most names of a chain say that it is of a side."""
    names = (*chain.joints, chain.tip)
    return sum(bool(_SIDES[side].search(name)) for name in names) > len(names) / 2


def _chains(urdf: Urdf) -> list[ArmChain]:
    """Returns all rows of joints that may be arms, in document order."""
    own = set(moving(urdf))
    before: dict[str, str] = {}  # moving joint to the moving joint that carries it
    for name in moving(urdf):
        carriers = [
            n for n in urdf.chain(urdf.joints[name].child_name("child", "link")) if n in own
        ]
        before[name] = carriers[-2] if len(carriers) > 1 else ""
    after: dict[str, list[str]] = {}
    for name, carrier in before.items():
        if not _GRIPPER.search(name):
            after.setdefault(carrier, []).append(name)
    found = []
    for name in before:
        if _GRIPPER.search(name) or (before[name] and len(after[before[name]]) == 1):
            continue
        row = [name]
        while len(after.get(row[-1], [])) == 1:
            row.append(after[row[-1]][0])
        joints = _arm_part(urdf, row)
        if len(joints) >= LEAST_AXES:
            found.append(ArmChain(joints, _tip(urdf, joints[-1])))
    return found


def _arm_part(urdf: Urdf, row: Sequence[str]) -> tuple[str, ...]:
    """Returns a row of joints without those of a gripper at its end and those that slide at its begin and end."""
    joints = [name for name in row if not _GRIPPER.search(name)] or list(row)
    slides = [urdf.joints[name].get("type") == "prismatic" for name in joints]
    first = max((k + 1 for k, s in enumerate(slides[: len(joints) // 2]) if s), default=0)
    last = min(
        (k for k, s in enumerate(slides) if s and k >= len(joints) // 2), default=len(joints)
    )
    return tuple(joints[first:last])


def _tip(urdf: Urdf, joint: str) -> str:
    """Returns the link that a tool is bolted to: one that is fixed to what the last joint moves, by its name."""
    first = urdf.joints[joint].child_name("child", "link")
    links, todo = [first], [first]
    while todo:
        link = todo.pop(0)
        fixed = [
            j.child_name("child", "link")
            for j in urdf.joints.values()
            if j.get("type") == "fixed" and j.child_name("parent", "link") == link
        ]
        links += fixed
        todo += fixed
    # A link and a joint of one name cannot be told apart by every reader.
    usable = [link for link in links if link not in urdf.joints] or links
    return next(_matching(usable), usable[0])


def _matching(names: Sequence[str]) -> Iterator[str]:
    """Iterates over the links that may be a tool's, best first."""
    for pattern in _TIPS:
        yield from (name for name in names if re.search(pattern, name, re.IGNORECASE))
