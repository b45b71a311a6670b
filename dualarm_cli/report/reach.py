"""Report of the reach over a table: as a document, a table and sentences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Cell
from dualarm_cli.reachability.reach_map import ReachMap, reach_map
from dualarm_cli.report.printable import numbers

if TYPE_CHECKING:
    from rich.table import Table

NOTE = (
    "reached: a posture was found that keeps all joint limits and is clear of the robot itself and of obstacles; the "
    "other arm is not looked at"
)
"""What the figures mean."""


def reach_document(name: str, cell: Cell, reach: ReachMap) -> dict[str, Any]:
    """Return what is reached, JSON-ready: by platform position the areas, and by frame the positions; SI units.

    Args:
        name: of the robot or cell.
        cell: with its tools.
        reach: of a grid at one height.
    """
    grid = reach.grid
    platform = CellModel.from_cell(cell).platform
    places = grid.platform[:, 0].tolist() if platform.is_chosen else [None]
    reached = _by_whom(reach)
    cell_area = np.square(grid.step)
    frames = {}
    for frame, pose in cell.frames.items():
        x, y, z = pose.translation.tolist()
        here = replace(grid, heights=np.array([z]), y=np.array([y]), x=np.array([x]))
        found = {who: one[:, 0, 0, 0] for who, one in _by_whom(reach_map(cell, here)).items()}
        frames[frame] = {
            "xyz": [x, y, z],
            "reached": {who: one.tolist() for who, one in found.items()},
        }
    return {
        "format": "dualarm.reach/1",
        "name": name,
        "height": float(grid.heights[0]),
        "tilt": grid.tilt,
        "step": grid.step,
        "platform": places,
        "platform_unit": "m" if platform.is_rail else "rad",
        "x": grid.x.tolist(),
        "y": grid.y.tolist(),
        "area": {
            who: (one[:, 0].sum(axis=(1, 2)) * cell_area).tolist() for who, one in reached.items()
        },
        "area_at_any": {
            who: float(one[:, 0].any(axis=0).sum() * cell_area) for who, one in reached.items()
        },
        "positions": {who: one[:, 0].sum(axis=0).tolist() for who, one in reached.items()},
        "frames": frames,
    }


def _by_whom(reach: ReachMap) -> dict[str, BoolArray]:
    """Return what each arm reaches, and what all of several reach from one platform position."""
    found = {arm: reach.reached(arm) for arm in reach.postures}
    return found | {"both": reach.both} if len(found) > 1 else found


def area_table(document: Mapping[str, Any]) -> Table:
    """Return the table of areas by platform position."""
    from rich.table import Table

    rail = document["platform_unit"] == "m"
    areas = (f"{who} m²" for who in document["area"])
    table = Table(*numbers("platform mm" if rail else "platform °", *areas))
    for k, place in enumerate(document["platform"]):
        cells = (f"{area[k]:.3f}" for area in document["area"].values())
        table.add_row("–" if place is None else _shown(place, rail), *cells)
    if len(document["platform"]) > 1:
        table.add_section()
        table.add_row("any", *(f"{area:.3f}" for area in document["area_at_any"].values()))
    return table


def frame_table(document: Mapping[str, Any]) -> Table:
    """Return the table of frames: from which platform positions each arm reaches them."""
    from rich.table import Table

    first = next(iter(document["frames"].values()))
    rail = document["platform_unit"] == "m"
    of = "" if document["platform"][0] is None else f", platform {'mm' if rail else '°'}"
    arms = (f"{who}{of}" for who in first["reached"])
    table = Table("frame", *numbers("x, y, z m"), *arms)
    for name, frame in document["frames"].items():
        ranges = [ranges_of(document["platform"], one, rail) for one in frame["reached"].values()]
        table.add_row(name, ", ".join(f"{v:.3g}" for v in frame["xyz"]), *ranges)
    return table


def ranges_of(places: Sequence[float | None], reached: Sequence[bool], rail: bool = False) -> str:
    """Return the platform positions at which something is reached, in words: ranges of neighbours.

    Args:
        places: ascending [rad or m]; None alone where the platform stands.
        reached: at each of them.
        rail: whether they are in metres.
    """
    if not any(reached):
        return "no"
    if places[0] is None:
        return "yes"
    if all(reached):
        return "all"
    ranges: list[list[float]] = []
    before = False
    for place, good in zip(places, reached, strict=True):
        if good and place is not None:
            if before:
                ranges[-1][1] = place
            else:
                ranges.append([place, place])
        before = good
    return ", ".join(
        _shown(low, rail) if low == high else f"{_shown(low, rail)} to {_shown(high, rail)}"
        for low, high in ranges
    )


def reach_lines(document: Mapping[str, Any]) -> list[str]:
    """Return sentences on what is reached: by whom, and within which sides."""
    lines = []
    for who, count in document["positions"].items():
        reached = np.array(count) > 0
        if not reached.any():
            what = (
                "the arms reach no point together"
                if who == "both"
                else f"the {who} arm reaches nothing"
            )
            lines.append(f"{what} of a table {document['height']:.3g} m high")
            continue
        iy, ix = np.nonzero(reached)
        x, y = (
            f"{side[k.min()]:.3g} to {side[k.max()]:.3g} m"
            for side, k in ((document["x"], ix), (document["y"], iy))
        )
        subject = "both arms reach" if who == "both" else f"the {who} arm reaches"
        lines.append(f"{subject} points between x {x} and y {y}")
    return [*lines, NOTE]


def _shown(place: float, rail: bool) -> str:
    """Return a platform position in mm or degrees."""
    return f"{round(place * 1000.0 if rail else math.degrees(place), 1) + 0.0:g}"
