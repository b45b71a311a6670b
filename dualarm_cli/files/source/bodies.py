"""Names of the bodies of a cell, and the pairs of them that a file names."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import pinocchio as pin

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.model.robot import Robot


def link_names(robot: Robot) -> list[str]:
    """Return the names of a robot's links."""
    frames = pin.buildModelFromXML(robot.urdf).frames
    return [frame.name for frame in frames if frame.type == pin.FrameType.BODY]


def checked_pairs(
    document: Document,
    pairs: Mapping[Loc, Sequence[str]],
    known: list[str],
    findings: Findings,
    kinds: Collection[str] = (),
) -> tuple[tuple[str, str], ...]:
    """Return pairs of bodies, after noting every name that is none, and bodies paired with themselves or twice.

    Args:
        document: the file.
        pairs: two names each, by their places.
        known: all bodies.
        findings: where errors are noted.
        kinds: those of the bodies that there may be several of: parts.
    """
    found: list[tuple[str, str]] = []
    for place, (one, other) in pairs.items():
        for n, name in enumerate((one, other)):
            if name not in known:
                message = f"there is no body {quote(name)}{suggest(name, known, 'bodies')}"
                findings.add(document, (*place, n), message)
        if one == other and one not in kinds:
            findings.add(document, place, f"{quote(one)} is paired with itself; name two bodies")
        if any({one, other} == set(pair) for pair in found):
            findings.add(document, place, f"{quote(one)} and {quote(other)} are paired twice")
        found.append((one, other))
    return tuple(found)
