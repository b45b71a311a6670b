"""Names of the bodies of a cell, and pairs of them."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import pinocchio as pin

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.model.robot import Robot


def link_names(robot: Robot) -> list[str]:
    """List the names of a robot's links."""
    frames = pin.buildModelFromXML(robot.urdf).frames
    return [frame.name for frame in frames if frame.type == pin.FrameType.BODY]


def checked_pairs(
    document: Document,
    pairs: Mapping[Loc, Sequence[str]],
    bodies: list[str],
    findings: Findings,
    kinds: Collection[str] = (),
) -> tuple[tuple[str, str], ...]:
    """Check pairs of bodies; note unknown names, pairs with itself and duplicates.

    Args:
        document: the file.
        pairs: two names each, by their places.
        bodies: all bodies.
        findings: where errors are noted.
        kinds: bodies that may exist several times: parts.
    """
    checked: list[tuple[str, str]] = []
    for place, names in pairs.items():
        body_a, body_b = (_once_prefixed(name, bodies) for name in names)
        for n, name in enumerate((body_a, body_b)):
            if name not in bodies:
                message = f"there is no body {quote(name)}{suggest(name, bodies, 'bodies')}"
                findings.add(document, (*place, n), message)
        if body_a == body_b and body_a not in kinds:
            findings.add(document, place, f"{quote(body_a)} is paired with itself; name two bodies")
        if any({body_a, body_b} == set(pair) for pair in checked):
            findings.add(document, place, f"{quote(body_a)} and {quote(body_b)} are paired twice")
        checked.append((body_a, body_b))
    return tuple(checked)


def _once_prefixed(name: str, bodies: list[str]) -> str:
    """Drop a doubled `left_` or `right_`, which earlier versions gave links of pairs."""
    side, _, rest = name.partition("_")
    doubled = name not in bodies and rest in bodies and rest.startswith(f"{side}_")
    return rest if doubled and side in ("left", "right") else name
