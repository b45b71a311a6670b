"""Hand-over: a part goes from one arm's tool into the other's while the giving one stands still."""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from dualarm_cli.model.cell import Cell
from dualarm_cli.model.place import NOWHERE, Place
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class Handover:
    """How a part goes from the giving arm to the taking one."""

    giver: str
    """The arm that picks and gives."""
    taker: str
    """The arm that takes and places."""
    grip: pin.SE3
    """The taking tool's centre point in the frame of the giving tool's centre point."""
    place: Place = NOWHERE
    """Where it is written."""


def taken_part(part: str, task: str) -> str:
    """Returns what the part is called once the taking tool holds it, in which it hangs otherwise; empty for none."""
    return f"{part}@{task}" if part else ""


def with_taken_part(cell: Cell, part: str, task: str, grip: pin.SE3) -> Cell:
    """Returns a cell that knows a part also as it hangs in the taking tool, with the same clearances and contacts.

    Args:
        cell: with the part as it hangs in the giving tool.
        part: its name.
        task: the hand-over's.
        grip: the taking tool's centre point in the giving tool's.
    """
    name, back = taken_part(part, task), grip.inverse()
    shapes = tuple(replace(shape, pose=back * shape.pose) for shape in cell.parts[part])

    def other(body: str) -> str:
        return name if body == part else body

    return replace(
        cell,
        clearances=(
            *cell.clearances,
            *((other(a), other(b), least) for a, b, least in cell.clearances if part in (a, b)),
        ),
        allowed_contacts=(
            *cell.allowed_contacts,
            *((other(a), other(b)) for a, b in cell.allowed_contacts if part in (a, b)),
        ),
        parts={**cell.parts, name: shapes},
    )
