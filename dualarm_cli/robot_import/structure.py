"""Structure of a URDF: its arms, and the joints that carry both arms.

Start here if an import takes the wrong joints. The arms are found in the tree of joints, with the help of words in the
names of joints, links and groups: sides, and body parts other than arms.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

from dualarm_cli.errors import UsageError, did_you_mean
from dualarm_cli.files.robots.frozen_joints import leader_of
from dualarm_cli.files.robots.urdf import Urdf
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.carriers import HeldJoint, common, find_platform, moving

LEAST_AXES = 6
"""Minimum number of joints of an arm."""
_TIPS = (
    r"tool0$",
    r"flange",
    r"ee_?link|end_?effector|_ee$",
    r"tcp|tip$",
    r"palm|hand|gripper",
    r"wrist",
)
"""Patterns of links to which tools are bolted, best first."""
NO_TIP = "none"
"""Value of `--left-tip` or `--right-tip` for a missing arm."""
SIDES = ("left", "right")
"""Sides of an arm."""


_note = NoteTable(
    "structure",
    arm="{arm}: {joints:*, }; flange {tip}{by}",
    ambiguous="no {side} arm: the tree does not tell which row of joints it is, of those that end in {ends:*, }; "
    "name its end with --{side}-tip",
    grippers="joints of grippers by their names: {joints:*, }",
    no_arm="no arm: {first} to {last} ('{word}' in {joint})",
    following="no arm: {first} to {last}, as {pairs}; arms with joints that follow others cannot be planned",
)


class OpenChoiceError(UsageError):
    """Error of a tree with an ambiguous choice of arms."""

    def __init__(self, tips: tuple[str, ...]) -> None:
        """Store the tip links of the candidate chains."""
        self.tips = tips
        super().__init__(
            f"the tree has {len(tips)} rows of joints that may be arms, ending in {', '.join(tips)}; "
            "say which with --left-tip and --right-tip"
        )


@dataclass(frozen=True)
class NamedTip:
    """Tool link named by an option or an SRDF group."""

    link: str
    """Name of the link."""
    by: str
    """Option or SRDF group that names the link."""


@dataclass(frozen=True)
class ArmChain:
    """Chain of joints that may be an arm."""

    joints: tuple[str, ...]
    """Joint names from base to flange."""
    tip: str
    """Link to which the tool is bolted."""
    by: str = ""
    """Option or SRDF group that names the tip; empty if derived from the tree."""
    hand: str = ""
    """Link of the hand that an SRDF names, or empty."""

    @property
    def side(self) -> str:
        """Side that most of its names contain: left, right or empty."""
        return side_of_most((*self.joints, self.tip))


@dataclass(frozen=True)
class Structure:
    """Arms and platform of a robot."""

    arms: Mapping[str, ArmChain]
    """Arms by side: left, right or both."""
    platform: tuple[str, ...]
    """Joints that carry both arms, world side first."""
    reasons: tuple[Note, ...]
    """Decisions with their reasons."""
    held: tuple[HeldJoint, ...] = ()
    """Fixed joints of waists, lifts and rails that carry arms."""

    @property
    def joints(self) -> list[str]:
        """Joints of the platform and the arms."""
        return [*self.platform, *(joint for arm in self.arms.values() for joint in arm.joints)]


def find_structure(
    urdf: Urdf, tips: Mapping[str, NamedTip], platform: Sequence[str] | None
) -> Structure:
    """Find the arms and the platform of a robot.

    Args:
        urdf: a checked URDF.
        tips: named tool links by side; the others are derived from the tree. The link `none` means no arm on that
            side.
        platform: joints that carry both arms, as named by the user, or None.

    Raises:
        UsageError: an unknown name, or an ambiguous tree; the message names the options.
    """
    absent_tip = NO_TIP if NO_TIP not in urdf.links else ""
    absent = {side for side, tip in tips.items() if tip.link == absent_tip}
    named = {side: tip for side, tip in tips.items() if side not in absent}
    rows, notes = _rows(urdf)
    if named:
        _check_links(urdf, named)
        other_side = next((side for side in SIDES if side not in tips), "")
        ends = {side: ArmChain((), tip.link, tip.by) for side, tip in named.items()}
        if other_side:
            other_arm, why = _other_arm(urdf, rows, other_side, next(iter(ends.values())).tip)
            notes += why
            ends |= {other_side: other_arm} if other_arm else {}
        arms = _between(urdf, {side: ends[side] for side in SIDES if side in ends})
    else:
        sides = [side for side in SIDES if side not in absent]
        arms = _arms_by_side(urdf, rows, sides, notes)
    reasons = []
    for side, arm in arms.items():
        data = {"joints": arm.joints, "tip": arm.tip, "by": f" ({arm.by})" if arm.by else ""}
        name = f"{side} arm" if len(arms) == 2 else "one arm"
        reasons.append(_note("arm", side=side, arm=name, **data))
    carriers = common([urdf.chain(arm.tip) for arm in arms.values()]) if len(arms) == 2 else []
    firsts = {side: arm.joints[0] for side, arm in arms.items()}
    chosen, held, more = find_platform(urdf, carriers, firsts, platform)
    structure = Structure(arms, chosen, (*reasons, *more, *notes), held)
    _check_followers(urdf, structure)
    return structure


def _check_links(urdf: Urdf, tips: Mapping[str, NamedTip]) -> None:
    """Refuse unknown links, and the same link for both arms."""
    for tip in tips.values():
        if tip.link not in urdf.links:
            hint = did_you_mean(tip.link, list(urdf.links))
            raise UsageError(f"{tip.by}: the URDF has no link '{tip.link}'{hint}")
    if len(tips) == 2 and len({tip.link for tip in tips.values()}) == 1:
        left, right = tips.values()
        raise UsageError(
            f"{left.by} and {right.by} both name '{left.link}'; --left-tip and --right-tip name a link of each arm"
        )


def _other_arm(
    urdf: Urdf, rows: Sequence[ArmChain], side: str, tip: str
) -> tuple[ArmChain | None, list[Note]]:
    """Find the other arm if one tip is named, or None and the reason."""
    arm_joints = set(urdf.chain(tip))
    candidates = [row for row in rows if not arm_joints & set(row.joints)]
    fitting = [row for row in candidates if row.side == side]
    if not fitting and len(candidates) == 1 and not candidates[0].side:
        fitting = candidates
    if len(fitting) == 1:
        return fitting[0], []
    if not candidates:
        return None, []
    ends = [row.tip for row in candidates]
    return None, [_note("ambiguous", side=side, ends=ends)]


def _between(urdf: Urdf, ends: Mapping[str, ArmChain]) -> dict[str, ArmChain]:
    """Determine the joints that move only one arm's tip."""
    movable = set(moving(urdf))
    chains = {side: [n for n in urdf.chain(end.tip) if n in movable] for side, end in ends.items()}
    carried = len(common(list(chains.values()))) if len(chains) == 2 else 0
    arms = {}
    for side, end in ends.items():
        joints = _arm_part(urdf, chains[side][carried:])
        if len(joints) < LEAST_AXES:
            count = count_of(len(chains[side]), "joint")
            both = f"; {carried} of these move the other arm as well" if carried else ""
            raise UsageError(
                f"{end.by or f'--{side}-tip'}: link '{end.tip}' is moved by {count} "
                f"({', '.join(chains[side]) or 'none'}){both}; an arm has at least {LEAST_AXES} that turn"
            )
        arms[side] = replace(end, joints=joints)
    return arms


def _check_followers(urdf: Urdf, structure: Structure) -> None:
    """Refuse arms with a joint that mimics a planned one."""
    planned = set(structure.joints)
    for side, arm in structure.arms.items():
        for name in urdf.chain(arm.tip):
            leader = leader_of(urdf, name)
            if leader in planned:
                raise UsageError(
                    f"{arm.by or f'{side} arm'}: link '{arm.tip}' is moved by joint '{name}', which mimics '{leader}'; "
                    f"arms with joints that follow others cannot be planned. Name a link before it with --{side}-tip"
                )


def _arms_by_side(
    urdf: Urdf, rows: Sequence[ArmChain], sides: Sequence[str], left_out: Sequence[Note]
) -> dict[str, ArmChain]:
    """Assign candidate chains to the given sides, by the tree and its names."""
    candidates = [row for row in rows if not row.side or row.side in sides]
    if not candidates or not sides:
        grips = [name for name in moving(urdf) if word_among(name, GRIPPER)]
        if len(grips) >= LEAST_AXES:
            left_out = [*left_out, _note("grippers", joints=grips)]
        why = "".join(f"; {reason}" for reason in left_out)
        raise UsageError(
            f"no arm was found: no row of {LEAST_AXES} joints or more that turn; name its end with --left-tip{why}"
        )
    if len(candidates) == 1:
        return {candidates[0].side or sides[0]: candidates[0]}
    if len(candidates) > 2:
        named = [c for c in candidates if any("arm" in words(n) for n in (*c.joints, c.tip))]
        candidates = named if len(named) == 2 else candidates
    by_side = {c.side: c for c in candidates}
    if len(candidates) == 2 and set(by_side) == set(SIDES):
        return {side: by_side[side] for side in SIDES}
    raise OpenChoiceError(tuple(chain.tip for chain in candidates))


def _rows(urdf: Urdf) -> tuple[list[ArmChain], list[Note]]:
    """Find possible arm chains in document order, and reasons against the others."""
    movable = moving(urdf)
    before: dict[str, str] = {}  # moving joint to the moving joint that carries it
    for name in movable:
        chain = urdf.chain(urdf.joints[name].child_name("child", "link"))
        carriers = [n for n in chain if n in set(movable)]
        before[name] = carriers[-2] if len(carriers) > 1 else ""
    after: dict[str, list[str]] = {}
    for name, carrier in before.items():
        if not word_among(name, GRIPPER):
            after.setdefault(carrier, []).append(name)
    candidates, left_out = [], []
    for name in before:
        if word_among(name, GRIPPER) or (before[name] and len(after[before[name]]) == 1):
            continue
        row = [name]
        while len(after.get(row[-1], [])) == 1:
            row.append(after[row[-1]][0])
        joints = _arm_part(urdf, row)
        followers = _followers(urdf, joints) if joints else {}
        if len(joints) + len(followers) < LEAST_AXES:
            continue
        span = {"first": joints[0], "last": joints[-1]}
        part = next(((n, word) for n in joints if (word := word_among(n, NO_ARM))), None)
        if part is not None:
            left_out.append(_note("no_arm", **span, word=part[1], joint=part[0]))
        elif followers:
            both = ", ".join(f"{name} mimics {leader}" for name, leader in followers.items())
            left_out.append(_note("following", **span, pairs=both))
        else:
            candidates.append(ArmChain(joints, _tip(urdf, joints[-1])))
    return candidates, left_out


def _followers(urdf: Urdf, joints: Sequence[str]) -> dict[str, str]:
    """Find joints within or just after a chain that mimic one of its joints."""
    end = urdf.joints[joints[-1]].child_name("child", "link")
    inside = urdf.chain(end)
    inside = inside[inside.index(joints[0]) :]
    while len(joints) < LEAST_AXES:
        behind = [
            name
            for name, joint in urdf.joints.items()
            if joint.child_name("parent", "link") == end and joint.get("type") != "fixed"
        ]
        if len(behind) != 1 or word_among(behind[0], GRIPPER):
            break
        inside.append(behind[0])
        end = urdf.joints[behind[0]].child_name("child", "link")
    leaders = {name: leader_of(urdf, name) for name in inside}
    return {name: leader for name, leader in leaders.items() if leader in joints}


def _arm_part(urdf: Urdf, row: Sequence[str]) -> tuple[str, ...]:
    """Cut gripper joints off a chain's end, and sliding joints off both ends."""
    joints = [name for name in row if not word_among(name, GRIPPER)] or list(row)
    slides = [urdf.joints[name].get("type") == "prismatic" for name in joints]
    first = max((k + 1 for k, s in enumerate(slides[: len(joints) // 2]) if s), default=0)
    last = min(
        (k for k, s in enumerate(slides) if s and k >= len(joints) // 2), default=len(joints)
    )
    return tuple(joints[first:last])


def _tip(urdf: Urdf, joint: str) -> str:
    """Choose the tool link by name among those fixed to the last joint's body."""
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
    # Some readers confuse a link and a joint of the same name.
    usable = [link for link in links if link not in urdf.joints] or links
    return next(_matching(usable), usable[0])


def _matching(names: Sequence[str]) -> Iterator[str]:
    """Iterate over the links that may carry a tool, best first."""
    for pattern in _TIPS:
        yield from (name for name in names if re.search(pattern, name, re.IGNORECASE))


NO_ARM = frozenset(
    (
        *("leg", "foot", "feet", "ankle", "hip", "knee"),
        *("wheel", "caster", "head", "neck", "eye", "laser"),
    )
)
"""Words of body parts other than arms."""
GRIPPER = frozenset(
    ("grip", "gripper", "finger", "fingertip", "hand", "knuckle", "claw", "thumb", "suction")
)
"""Words of gripper joints."""
_PARTS = NO_ARM | GRIPPER | {"arm", "shoulder", "elbow", "forearm", "wrist"}
_SIDES = {"left": "left", "right": "right", "l": "left", "r": "right"}
_RUN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def words(name: str) -> list[str]:
    """Split a name into lower-case words at signs, digits and capitals, and after sides.

    `RHipYaw` becomes r, hip, yaw; `leftarm` becomes left, arm; `l1` has no words, because its letter is a number;
    plurals of parts become singular.
    """
    parts = []
    for match in _RUN.finditer(name):
        word = match[0].lower()
        if word in ("l", "r") and name[match.end() : match.end() + 1].isdigit():
            continue
        for side in _SIDES:
            rest = word.removeprefix(side)
            if rest != word and (_part(rest) in _PARTS or (rest and len(side) > 1)):
                parts.append(side)
                word = rest
                break
        parts.append(_part(word))
    return parts


def _part(word: str) -> str:
    """Make the name of a part singular; return other words unchanged."""
    return word[:-1] if word.endswith("s") and word[:-1] in _PARTS else word


def side_of(name: str) -> str:
    """Find the side in a name: `left`, `right` or an empty string.

    Whole words take precedence over single letters. A name with both sides has none.
    """
    name_words = words(name)
    for marks in (("left", "right"), ("l", "r")):
        sides = {_SIDES[word] for word in name_words if word in marks}
        if sides:
            return sides.pop() if len(sides) == 1 else ""
    return ""


def side_of_most(names: Iterable[str]) -> str:
    """Find the side in more than half of the names, or an empty string."""
    sides = [side_of(name) for name in names]
    return next((s for s in ("left", "right") if sides.count(s) > len(sides) / 2), "")


def word_among(name: str, parts: Iterable[str]) -> str:
    """Find the first word of a name among given parts, or an empty string."""
    return next((word for word in words(name) if word in parts), "")


def count_of(number: int, singular: str, plural: str = "") -> str:
    """Format a count in singular or plural, as `1 pair` or `3 pairs`."""
    return f"{number} {singular if number == 1 else plural or f'{singular}s'}"
