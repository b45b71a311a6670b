"""Named frames of a cell, composed into the world."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import FramedPose, LineSection, to_se3
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.model.lines import Line, LineDirection

WORLD = "world"
"""Name of the root frame."""


def world_frames(
    document: Document, sections: dict[str, FramedPose], findings: Findings
) -> dict[str, pin.SE3]:
    """Compute the frames in the world: T_world_frame = T_world_parent T_parent_frame.

    Args:
        document: the cell file.
        sections: frames as the file has them.
        findings: where errors are noted.
    """
    world: dict[str, pin.SE3] = {}
    names = [*sections, WORLD]
    for name, section in sections.items():
        if name == WORLD:
            message = f"'{WORLD}' is the name of the root frame; choose another name"
            findings.add(document, ("frames", name), message, key=True)
        parent = section.in_
        if parent is not None and parent not in names:
            message = f"there is no frame {quote(parent)}{suggest(parent, names, 'frames')}"
            findings.add(document, ("frames", name, "in"), message)
    waiting = {name: section for name, section in sections.items() if name != WORLD}
    while waiting:
        ready = [n for n, s in waiting.items() if (s.in_ or WORLD) == WORLD or s.in_ in world]
        if not ready:
            _note_cycles(document, waiting, findings)
            break
        for name in ready:
            section = waiting.pop(name)
            T_world_parent = world.get(section.in_ or WORLD, pin.SE3.Identity())
            world[name] = T_world_parent * to_se3(section)
    # A frame that could not be placed has been noted; frames inside it are not reported again.
    return {name: world.get(name, pin.SE3.Identity()) for name in sections}


def _note_cycles(document: Document, waiting: dict[str, FramedPose], findings: Findings) -> None:
    """Note each cycle of frames once, at its first member in the file."""
    seen: set[str] = set()
    for start in waiting:
        path = [start]
        while (
            (parent := waiting[path[-1]].in_) in waiting
            and parent not in path
            and parent not in seen
        ):
            path.append(str(parent))
        if parent in path:
            ring = path[path.index(str(parent)) :]
            seen.update(ring)
            text = " in ".join(quote(name) for name in [*ring, ring[0]])
            findings.add(document, ("frames", ring[0], "in"), f"frames form a cycle: {text}")


def read_line(
    document: Document,
    loc: tuple[str | int, ...],
    section: LineSection,
    outward: int,
    frames: Mapping[str, pin.SE3],
    findings: Findings,
) -> Line:
    """Read length and direction of a line, along the tool after noting an unknown frame.

    Args:
        document: the file that has it.
        loc: where it stands.
        section: the line as the file has it.
        outward: 1 for a retract, -1 for an approach, whose tool moves to the target.
        frames: frames in the world.
        findings: where errors are noted.
    """
    if section.direction is None:
        return section.distance, LineDirection()
    vector = np.array(section.direction)
    vector *= outward / norm(vector)
    if section.in_ != "tool":
        named = {"tool": pin.SE3.Identity(), **frames}
        T_world_frame = frame_pose(document, (*loc, "in"), section.in_, named, findings)
        vector = vector if T_world_frame is None else product(T_world_frame.rotation, vector)
    x, y, z = vector.tolist()
    return section.distance, LineDirection((x, y, z), section.in_ != "tool")


def frame_pose(
    document: Document,
    loc: tuple[str | int, ...],
    name: str | None,
    frames: Mapping[str, pin.SE3],
    findings: Findings,
) -> pin.SE3 | None:
    """Look up a frame in the world, or None after noting an unknown name.

    Args:
        document: the file that names it.
        loc: where it names it.
        name: the frame; None for the world.
        frames: frames in the world.
        findings: where errors are noted.
    """
    if name is None or name == WORLD:
        return pin.SE3.Identity()
    if name not in frames:
        names = [*frames, WORLD]
        message = f"the cell has no frame {quote(name)}{suggest(name, names, 'it has')}"
        if (grid := name.partition("[")[0]) in frames and name.endswith("]"):
            message = (
                f"{quote(name)} is no frame; for one place of a grid write `at: {grid}` and, such as for the second "
                "along y, `each: {x: [1, 1], y: [2, 2]}`"
            )
        findings.add(document, loc, message)
        return None
    return frames[name]
