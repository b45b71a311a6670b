"""Hand-over of a part between the tools of two arms."""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from dualarm_cli.model.cell import Cell
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Handover:
    """Arms and grip of a hand-over."""

    giver: str
    """Arm that picks and gives."""
    taker: str
    """Arm that takes and places."""
    grip: pin.SE3
    """Taking tool centre point in the frame of the giving one."""
    place: Place = NOWHERE
    """Place of the hand-over in its file."""


def taken_part(part: str, task: str) -> str:
    """Name a part as held by the taking tool; empty for none."""
    return f"{part}@{task}" if part else ""


def with_taken_part(cell: Cell, part: str, task: str, grip: pin.SE3) -> Cell:
    """Add a part, as held by the taking tool, to a cell.

    It has the same solids, clearances and allowed contacts as in the giving tool.

    Args:
        cell: with the part as it hangs in the giving tool.
        part: its name.
        task: the hand-over's.
        grip: the taking tool's centre point in the giving tool's.
    """
    name, back = taken_part(part, task), grip.inverse()
    shapes = tuple(replace(shape, pose=back * shape.pose) for shape in cell.parts[part])

    def in_taker(body: str) -> str:
        return name if body == part else body

    return replace(
        cell,
        clearances=(
            *cell.clearances,
            *(
                (in_taker(a), in_taker(b), least)
                for a, b, least in cell.clearances
                if part in (a, b)
            ),
        ),
        allowed_contacts=(
            *cell.allowed_contacts,
            *((in_taker(a), in_taker(b)) for a, b in cell.allowed_contacts if part in (a, b)),
        ),
        parts={**cell.parts, name: shapes},
    )
