"""Report of the reach over a table: document, tables and sentences."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray
from dualarm_cli.geometry.rotations import rpy_angles
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Cell
from dualarm_cli.notes import of_arm
from dualarm_cli.reachability.facing_tools import HandoverPose
from dualarm_cli.reachability.reach_map import ReachMap, reach_map
from dualarm_cli.report.comparisons import HandoverRow, ReachedFrame, ReachReport
from dualarm_cli.report.printable import numbers

if TYPE_CHECKING:
    from rich.table import Table

NOTE = "reached: a posture within all joint limits was found, without collision with the robot itself or obstacles"
"""Meaning of the figures; of two arms the other one is not checked."""


def reach_document(name: str, cell: Cell, reach: ReachMap) -> ReachReport:
    """Build the document of a reach map, JSON-ready, in SI units.

    It has areas by platform position, and positions by frame.

    Args:
        name: name of the robot or cell.
        cell: with its tools.
        reach: of a grid at one height.
    """
    grid = reach.grid
    platform = CellModel.from_cell(cell).platform
    places: list[float | None] = grid.platform[:, 0].tolist() if platform.is_chosen else [None]
    reached = _by_whom(reach)
    cell_area = np.square(grid.step)
    frames: dict[str, ReachedFrame] = {}
    for frame, pose in cell.frames.items():
        x, y, z = pose.translation.tolist()
        point = replace(grid, heights=np.array([z]), y=np.array([y]), x=np.array([x]))
        by_arm = {who: cells[:, 0, 0, 0] for who, cells in _by_whom(reach_map(cell, point)).items()}
        frames[frame] = {
            "xyz": [x, y, z],
            "reached": {who: cells.tolist() for who, cells in by_arm.items()},
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
            who: (cells[:, 0].sum(axis=(1, 2)) * cell_area).tolist()
            for who, cells in reached.items()
        },
        "area_at_any": {
            who: float(cells[:, 0].any(axis=0).sum() * cell_area) for who, cells in reached.items()
        },
        "positions": {who: cells[:, 0].sum(axis=0).tolist() for who, cells in reached.items()},
        "frames": frames,
    }


def _by_whom(reach: ReachMap) -> dict[str, BoolArray]:
    """Collect the reach of each arm and of both together.

    Both count from the same platform position.
    """
    reached = {arm: reach.reached(arm) for arm in reach.postures}
    return reached | {"both": reach.both} if len(reached) > 1 else reached


def area_table(document: Mapping[str, Any]) -> Table:
    """Build the table of areas by platform position."""
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
    """Build the table of frames with the platform positions that reach them."""
    from rich.table import Table

    first = next(iter(document["frames"].values()))
    rail = document["platform_unit"] == "m"
    of = "" if document["platform"][0] is None else f", platform {'mm' if rail else '°'}"
    arms = (f"{who}{of}" for who in first["reached"])
    table = Table("frame", *numbers("x, y, z m"), *arms)
    for name, frame in document["frames"].items():
        ranges = [
            ranges_of(document["platform"], flags, rail) for flags in frame["reached"].values()
        ]
        table.add_row(name, ", ".join(f"{v:.3g}" for v in frame["xyz"]), *ranges)
    return table


def ranges_of(places: Sequence[float | None], reached: Sequence[bool], rail: bool = False) -> str:
    """Format platform positions with reach as ranges of neighbours.

    Args:
        places: ascending [rad or m]; None alone for a fixed platform.
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
    """Compose sentences on the reach of each arm and its bounds, and lines of hand-overs."""
    lines, arms = [], min(2, len(document["positions"]))
    for who, count in document["positions"].items():
        arm = of_arm(who, "arm", arms)
        reached = np.array(count) > 0
        if not reached.any():
            what = (
                "the arms reach no point together"
                if who == "both"
                else f"the {arm} reaches nothing"
            )
            lines.append(f"{what} of a table {document['height']:.3g} m high")
            continue
        iy, ix = np.nonzero(reached)
        x, y = (
            f"{side[k.min()]:.3g} to {side[k.max()]:.3g} m"
            for side, k in ((document["x"], ix), (document["y"], iy))
        )
        subject = "both arms reach" if who == "both" else f"the {arm} reaches"
        lines.append(f"{subject} points between x {x} and y {y}")
    note = NOTE if arms == 1 else f"{NOTE}; the other arm is not checked"
    return [*lines, note, *(_handover_lines(document) if "handovers" in document else ())]


def handover_rows(cell: Cell, poses: Sequence[HandoverPose], distance: float) -> list[HandoverRow]:
    """Build the rows of hand-over poses, JSON-ready, in SI units, best first.

    Either arm can give: the tools of both are in the row, and `grip` is the pose of each in the other's frame.

    Args:
        cell: with its tools.
        poses: found at that distance.
        distance: distance of the tool centre points [m].
    """
    joints = {arm.name: arm.joints for arm in cell.robot.arms}
    return [
        {
            "score": pose.score,
            "grip": {"xyz": [0.0, 0.0, distance], "rpy": [math.pi, 0.0, pose.turn]},
            "tools": {
                arm: {"xyz": p.tolist(), "rpy": rpy_angles(R).tolist()}
                for arm, (R, p) in pose.tools.items()
            },
            "joints": {
                arm: dict(zip(joints[arm], q.tolist(), strict=True)) for arm, q in pose.q.items()
            },
        }
        for pose in poses
    ]


def _handover_lines(document: Mapping[str, Any]) -> list[str]:
    """Compose hand-over poses as lines for a task file, for either arm that gives."""
    apart = f"with the tools {document['handover_distance'] * 1000.0:g} mm apart"
    if not document["handovers"]:
        return [f"no hand-over {apart} was found; try another distance"]
    lines = [f"hand-overs {apart}, best first; the part is not checked:"]
    for number, row in enumerate(document["handovers"], 1):
        lines.append(f"  # {number}: either arm may give")
        for arm, tool in row["tools"].items():
            pose, grip = (
                f"xyz: {_row(entry['xyz'])}, rpy: {_row(np.degrees(entry['rpy']), ' deg')}"
                for entry in (tool, row["grip"])
            )
            lines.append(f"  handover: {{{pose}, grip: {{{grip}}}}}  # arm: {arm}")
    return lines


def _row(values: Iterable[float], unit: str = "") -> str:
    """Format three lengths [m] or angles [deg] as YAML."""
    words = (f"{round(float(value), 6) + 0.0:.9g}" for value in values)
    return f"[{', '.join(word if word == '0' else word + unit for word in words)}]"


def _shown(place: float, rail: bool) -> str:
    """Format a platform position in mm or degrees."""
    return f"{round(place * 1000.0 if rail else math.degrees(place), 1) + 0.0:g}"
