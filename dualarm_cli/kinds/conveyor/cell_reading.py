"""Conveyors of cell files."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from dualarm_cli.files.cells.cell_frames import frame_pose
from dualarm_cli.files.cells.cells import AddedToCell, CellReader, KindCell
from dualarm_cli.files.cells.schema_cell import CellFile
from dualarm_cli.files.source.fields import Name, Section, Velocity3, refuse
from dualarm_cli.geometry.products import product
from dualarm_cli.model.cell import Tool
from dualarm_cli.model.part_flow import Conveyor

SLOWEST_BELT = 1e-4
"""Least speed of a conveyor [m/s]."""


class ConveyorSection(Section):
    """Belt of constant velocity that carries targets past the robot."""

    velocity: Velocity3 = Field(description="Velocity of the belt [m/s].")
    in_: Name | None = Field(
        default=None,
        alias="in",
        description="Named frame in whose axes the velocity is given; default world.",
    )

    @model_validator(mode="after")
    def _moves(self) -> ConveyorSection:
        if math.hypot(*self.velocity) < SLOWEST_BELT:
            raise refuse(
                f"a conveyor must move by {SLOWEST_BELT * 1e3:g} mm/s or more; targets on one that stands need none",
                "velocity",
            )
        return self


class ConveyorsFile(CellFile):
    """Cell file with conveyors."""

    conveyors: dict[Name, ConveyorSection] = Field(
        default_factory=dict, description="Belts that carry targets of tasks, by name."
    )


def read_conveyors(
    reader: CellReader, model: CellFile, tools: dict[str, Tool], frames: dict[str, pin.SE3]
) -> AddedToCell:
    """Create the conveyors, with velocities in the world."""
    assert isinstance(model, ConveyorsFile)  # the registry of kinds guarantees it
    conveyors = {}
    for name, section in model.conveyors.items():
        loc = ("conveyors", name, "in")
        frame = frame_pose(reader.document, loc, section.in_, frames, reader.findings)
        if frame is not None:
            conveyors[name] = Conveyor(name, product(frame.rotation, np.array(section.velocity)))
    return AddedToCell({"conveyors": conveyors})


CELL_READING = KindCell(ConveyorsFile, read_conveyors)
