"""Words in the names of joints, links and groups: sides, and parts of a robot that are no arm."""

from __future__ import annotations

import re
from collections.abc import Iterable

NO_ARM = frozenset(
    (
        *("leg", "foot", "feet", "ankle", "hip", "knee"),
        *("wheel", "caster", "head", "neck", "eye", "laser"),
    )
)
"""Words that tell a row of joints that is no arm."""
GRIPPER = frozenset(
    ("grip", "gripper", "finger", "fingertip", "hand", "knuckle", "claw", "thumb", "suction")
)
"""Words that tell a joint of a gripper."""
_PARTS = NO_ARM | GRIPPER | {"arm", "shoulder", "elbow", "forearm", "wrist"}
_SIDES = {"left": "left", "right": "right", "l": "left", "r": "right"}
_RUN = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+")


def words(name: str) -> list[str]:
    """Returns the words of a name in small letters: split at signs, digits and capitals, sides split off.

    `RHipYaw` is r, hip, yaw; `leftarm` is left, arm; `l1` is none, as its letter only numbers; plurals of parts are
    singular.
    """
    found = []
    for match in _RUN.finditer(name):
        word = match[0].lower()
        if word in ("l", "r") and name[match.end() : match.end() + 1].isdigit():
            continue
        for side in _SIDES:
            rest = word.removeprefix(side)
            if rest != word and (_part(rest) in _PARTS or (rest and len(side) > 1)):
                found.append(side)
                word = rest
                break
        found.append(_part(word))
    return found


def _part(word: str) -> str:
    """Returns a part's singular, and any other word as it is."""
    return word[:-1] if word.endswith("s") and word[:-1] in _PARTS else word


def side_of(name: str) -> str:
    """Returns left or right where a name tells one of them; whole words before single letters."""
    found = words(name)
    for marks in (("left", "right"), ("l", "r")):
        sides = {_SIDES[word] for word in found if word in marks}
        if sides:
            return sides.pop() if len(sides) == 1 else ""
    return ""


def side_of_most(names: Iterable[str]) -> str:
    """Returns the side that more than half of some names tell, or nothing."""
    sides = [side_of(name) for name in names]
    return next((s for s in ("left", "right") if sides.count(s) > len(sides) / 2), "")


def tells(name: str, parts: Iterable[str]) -> str:
    """Returns the first word of a name that is one of some parts, or nothing."""
    return next((word for word in words(name) if word in parts), "")


def count_of(number: int, one: str, several: str = "") -> str:
    """Returns a number of things, such as `1 pair` or `3 pairs`."""
    return f"{number} {one if number == 1 else several or f'{one}s'}"
