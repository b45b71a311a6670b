"""Frames of cell files, and grids of places in them: trays, pallets, cartons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from dualarm_cli.files.source.fields import (
    Angle,
    FramedPose,
    Length,
    Section,
    Size,
    VariesSection,
    refuse,
)
from dualarm_cli.files.source.short_forms import ShortForm
from dualarm_cli.geometry.products import product
from dualarm_cli.model.part_flow import Pattern, PlaceIndex, PlaceOrder, PoseRange

MOST_PLACES = 10_000
"""Maximum number of places of a grid, and of tasks that a file is expanded to."""
_Count = Annotated[int, Field(ge=1, le=MOST_PLACES)]


class GridSection(Section):
    """Places at equal distances along x and y of a frame, in layers along z."""

    count: Annotated[list[_Count], Field(min_length=2, max_length=2)] = Field(
        description="Number of places along x and along y; the first place is at the frame."
    )
    pitch: Annotated[list[Length], Field(min_length=2, max_length=2)] = Field(
        description="Distance of neighbouring places along x and along y [m]; negative against the axis."
    )
    layers: _Count = Field(default=1, description="Number of layers.")
    layer_height: Size | None = Field(default=None, description="Distance of layers along z [m].")
    order: PlaceOrder = Field(
        default="rows",
        description="rows: all places along x, then the next row along y; columns: along y first; snake: rows, every "
        "second one backwards. Layers follow each other: upwards to place, downwards to pick.",
    )
    stagger: Length = Field(
        default=0.0, description="Shift of every second row along x [m], as of round parts."
    )
    turn: Angle = Field(
        default=0.0, description="Turn of every second layer about the middle of the grid [rad]."
    )
    without: list[Annotated[list[_Count], Field(min_length=2, max_length=3)]] = Field(
        default_factory=list,
        description="Places without parts: [x, y] of all layers, or [x, y, layer]; the first is 1.",
    )

    @model_validator(mode="after")
    def _whole(self) -> GridSection:
        if self.layers > 1 and self.layer_height is None:
            raise refuse("'layer_height' is missing: the grid has layers", "layers", code="E202")
        total = self.count[0] * self.count[1] * self.layers
        if total > MOST_PLACES:
            raise refuse(f"{total} places; at most {MOST_PLACES} are allowed", "count")
        for axis, count, pitch in zip("xy", self.count, self.pitch, strict=True):
            if count > 1 and pitch == 0.0:
                raise refuse(
                    f"places along {axis} coincide: their pitch is 0; write their distance", "pitch"
                )
        most = (*self.count, self.layers)
        for place in self.without:
            for number, highest in zip(place, most, strict=False):
                if number > highest:
                    shown = "[" + ", ".join(map(str, place)) + "]"
                    size = " by ".join(map(str, most))
                    raise refuse(
                        f"there is no place {shown} to leave out; the grid has {size} places",
                        "without",
                    )
        if not pattern_of(self).places:
            raise refuse("no place is left; leave out fewer", "without")
        return self


class FrameSection(FramedPose):
    """A frame, with a grid of places where parts lie or go."""

    grid: GridSection | None = Field(
        default=None,
        description="Places in the frame; tasks with `each` are repeated for each of them.",
    )
    varies: Annotated[VariesSection, ShortForm("xy")] | None = Field(
        default=None,
        description="Deviations of the frame with all targets in it [m], as of a tray that is put down by hand; "
        "`dualarm sweep --perturb` draws them.",
    )


def patterns_of(sections: Mapping[str, FrameSection]) -> dict[str, Pattern]:
    """Lay out the places of all frames with a grid, by frame."""
    return {name: pattern_of(s.grid) for name, s in sections.items() if s.grid is not None}


def pose_ranges(
    sections: Mapping[str, FrameSection], frames: Mapping[str, pin.SE3]
) -> dict[str, tuple[PoseRange, ...]]:
    """List the ranges of varying frames, with those of their parents.

    Args:
        sections: frames as the file has them, without cycles.
        frames: their poses in the world.
    """

    def ranges(name: str) -> tuple[PoseRange, ...]:
        section = sections.get(name)
        if section is None:
            return ()
        inner = (section.varies.about(f"frame {name}", frames[name]),) if section.varies else ()
        return (*inner, *ranges(section.in_ or ""))

    return {name: listed for name in sections if (listed := ranges(name))}


def pattern_of(grid: GridSection) -> Pattern:
    """Lay out the places of a grid in its frame.

    Args:
        grid: as the file has it.
    """
    height = grid.layer_height or 0.0
    middle = np.array([(n - 1) * p / 2.0 for n, p in zip(grid.count, grid.pitch, strict=True)])
    left_out = {tuple(place) for place in grid.without}
    places: dict[PlaceIndex, pin.SE3] = {}
    for k in range(grid.layers):
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, grid.turn) if k % 2 and grid.turn else np.eye(3)
        for j in range(grid.count[1]):
            for i in range(grid.count[0]):
                index = (i + 1, j + 1, k + 1)
                if index in left_out or index[:2] in left_out:
                    continue
                flat = np.array([i * grid.pitch[0] + j % 2 * grid.stagger, j * grid.pitch[1], 0.0])
                if k % 2 and grid.turn:
                    flat[:2] = middle + product(turn[:2, :2], flat[:2] - middle)
                flat[2] = k * height
                places[index] = pin.SE3(turn, flat)
    pitch = [abs(p) if n > 1 else np.inf for n, p in zip(grid.count, grid.pitch, strict=True)]
    return Pattern(places, grid.order, (pitch[0], pitch[1]), grid.layers > 1)
