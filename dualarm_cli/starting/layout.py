"""Placement of table, trays and boxes for a robot's first six picks.

Targets are within reach, and the arms do not collide. The table is clear of the robot and covers most of the reach.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry import products
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Cell
from dualarm_cli.notes import of_arm
from dualarm_cli.reachability.filling import Postures
from dualarm_cli.reachability.reach_map import ReachMap, reach_map
from dualarm_cli.reachability.region import (
    REGION,
    Region,
    heights_reached,
    region,
)
from dualarm_cli.reachability.table_grid import TableGrid
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.robot_import.proposed_tool import ProposedTool, with_tools
from dualarm_cli.starting.table import Table, most_reached, room_for_table


@dataclass(frozen=True)
class LayoutSettings:
    """Distances of a proposed cell, and limits of its search."""

    rows_kept: int = 80
    """Maximum number of target rows of an arm that are paired."""
    pairs_kept: int = 150
    """Maximum number of tray and box pairs of an arm."""
    layouts_tried: int = 400
    """Maximum number of candidate layouts, combinations of the arms' pairs."""
    clearance: float = 0.005
    """Clearance of all bodies [m], at most a tenth of a step.

    It is less than the distance between neighbouring links of imported robots.
    """
    tables_tried: int = 6
    """Maximum number of candidate tables."""
    depth: int = 3
    """Preferred distance of targets from the border of an arm's reach [nodes].

    Smaller distances are tried if too few rows are available.
    """
    least_apart: float = 2.0
    """Minimum distance of an arm's tray from its box [steps]."""
    apart: float = 4.0
    """Preferred distance of an arm's tray from its box [steps]."""
    arms_apart: float = 4.0
    """Minimum distance between the rows of different arms, middle to middle [steps]."""
    alike: float = 0.2
    """Penalty of a step of asymmetry between the arms' targets.

    A step farther apart counts 1.
    """
    room: float = 0.03
    """Room between a table and the robot at home [m]."""
    front: float = 0.5
    """Weight of a node in front of the robot, relative to sides."""
    picks: int = 6
    """Number of picks of all arms together."""


LAYOUT = LayoutSettings()


@dataclass(frozen=True)
class Row:
    """Row of targets: the places of a tray or a box."""

    centre: tuple[float, float]
    """Centre [m]."""
    along: str
    """Axis along which the row runs: x or y."""


@dataclass(frozen=True)
class Layout:
    """Layout of trays, boxes and table for a robot's first six picks."""

    tools: Mapping[str, ProposedTool]
    """Tool of each arm."""
    trays: Mapping[str, Row]
    """Tray of each arm."""
    boxes: Mapping[str, Row]
    """Box of each arm."""
    height: float
    """Height of all targets [m]."""
    step: float
    """Distance between a row's targets, and approach and retract length [m]."""
    table: Table
    """Table under all targets."""
    clearance: float
    """Clearance of all bodies [m]."""
    home_fault: str
    """Reason why motions cannot start in the posture home, or empty."""


@dataclass(frozen=True)
class _Reach:
    """Reach of one arm on the table."""

    depth: FloatArray
    """Distance of each node from the border of the reach [nodes], shape (ny, nx)."""
    number: FloatArray
    """Index of each node's posture, shape (ny, nx)."""
    postures: Postures
    """Postures at the targets."""
    back: FloatArray
    """Joint positions with the tool retracted [rad], shape (m, n)."""


def find_layout(bare: Cell, name: str, accepted: Callable[[Layout], bool]) -> Layout:
    """Place table, trays and boxes for a robot.

    Args:
        bare: the placed robot; tools are proposed.
        name: of the robot, for messages.
        accepted: test of a layout; the first one that passes is returned.

    Raises:
        InfeasibleError: the arms do not reach a table with tools down, or find no room on it.
    """
    cell, tools = with_tools(bare)
    here = region(cell)
    cell = replace(cell, clearance=min(LAYOUT.clearance, 0.1 * here.step))
    # Hands that stand beyond their tool centre point must not touch the table.
    hands = (round(tool.beyond + 2.0 * cell.clearance, 3) for tool in tools.values())
    lift = max(0.5 * here.step, *hands)
    heights, reach = heights_reached(cell, here, 0.5 * here.step, lift)
    if not all(reach.reached(arm).any() for arm in reach.postures):
        raise InfeasibleError(Refusal("no_table", data={"robot": name}))
    key = "no_room_for_table"
    for arms_at_home in (True, False):
        for table in _tables(cell, here, heights - lift, reach, arms_at_home):
            layout = _on_table(cell, tools, here, table, lift)
            if layout is not None and accepted(layout):
                return layout
            key = "no_room_on_table" if layout is None and key != "no_plan" else "no_plan"
    count, mm = LAYOUT.picks // len(tools), 1e3 * here.step
    raise InfeasibleError(Refusal(key, data={"robot": name, "count": count, "mm": mm}))


def _tables(
    cell: Cell, here: Region, tops: FloatArray, reach: ReachMap, arms_at_home: bool
) -> list[Table]:
    """List the tables with the largest reach, best first.

    Those below the tools at home come first, and of these easily reached heights.

    Args:
        cell: the cell with its tools.
        here: its region.
        tops: table heights [m], shape (h,).
        reach: reach map of targets above these tables, by height.
        arms_at_home: whether tables must clear the arms at home.
    """
    step, grid = here.step, reach.grid
    model, home = CellModel.from_cell(cell), cell.robot.postures["home"]
    tips = np.array([model.tool_position(arm, home) for arm in model.arms])
    front, easy = _front(tips, here, grid), here.is_easy(tops + 0.5 * step)
    ranked = []
    for k, top in enumerate(np.round(tops, 4).tolist()):
        thickness = min(0.04, step)
        free = room_for_table(
            cell, grid.x, grid.y, (top - thickness, top), LAYOUT.room, arms=arms_at_home
        )
        reached = [reach.reached(arm)[0, k] for arm in reach.postures]
        score, rows, columns = most_reached(reached, free, front)
        if np.isfinite(score):
            table = Table.under(
                grid.x[columns], grid.y[rows], REGION.coarser * step, (top, thickness)
            )
            above = top >= tips[:, 2].min()
            ranked.append((above, not easy[k], -score, k, table))
    return [table for *_, table in sorted(ranked, key=lambda row: row[:4])[: LAYOUT.tables_tried]]


def _on_table(
    cell: Cell, tools: Mapping[str, ProposedTool], here: Region, table: Table, lift: float
) -> Layout | None:
    """Place trays and boxes on a table, cut to needed size.

    None without room. Targets are `lift` above the table [m].
    """
    step, height = here.step, round(table.top + lift, 4)
    grid = here.grid(here.home[None], np.array([height]), step)
    x, y = (
        side[(side > low) & (side < high)]
        for side, low, high in zip((grid.x, grid.y), table.low, table.high, strict=True)
    )
    grid = replace(grid, x=x, y=y)
    cell = replace(cell, obstacles=(table.obstacle,))
    rows = _rows(cell, reach_map(cell, grid, 0.5 * step), here)
    if rows is None:
        return None
    trays, boxes = rows
    every = np.array([row.centre for row in (*trays.values(), *boxes.values())])
    x, y = (
        side[(side > c.min() - 2.6 * step) & (side < c.max() + 2.6 * step)]
        for side, c in zip((grid.x, grid.y), every.T, strict=True)
    )
    table = Table.under(x, y, step, (table.top, table.thickness))
    fault = _home_fault(replace(cell, obstacles=(table.obstacle,)), table.top)
    return Layout(tools, trays, boxes, height, step, table, cell.clearance, fault)


def _front(tips: FloatArray, here: Region, grid: TableGrid) -> FloatArray:
    """Compute weights of nodes, shape (ny, nx): larger in front, zero behind.

    The front is the side of the tools at home.

    Args:
        tips: positions of the tools at home [m], shape (arms, 3).
        here: region of the cell.
        grid: the nodes.
    """
    ahead = tips[:, :2].mean(axis=0) - np.array(here.centre)
    if products.norm(ahead) < grid.step:
        ahead = np.array([1.0, 0.0])
    away = np.stack(np.meshgrid(grid.x, grid.y), axis=-1) - np.array(here.centre)
    cosine = products.product(away, ahead) / (
        products.norm(ahead) * np.maximum(products.norm(away, axis=-1), 1e-9)
    )
    return np.where(cosine >= -1e-9, 1.0 + LAYOUT.front * cosine, 0.0)


def _home_fault(cell: Cell, top: float) -> str:
    """Explain why motions cannot start at home, or return an empty text."""
    model, home = CellModel.from_cell(cell), cell.robot.postures["home"]
    test = CellClearance.of(cell, ()).test
    groups = [*(test.arm_pairs(arm) for arm in model.arms), test.cross()]
    for group in groups:
        if (test.margins(group, home[None]) < SLACK).any():
            body_a, body_b, margin = test.nearest(home, group.pairs)
            return (
                f"at home {body_a} and {body_b} lack {max(0.1, -1e3 * margin):.1f} mm of clearance"
            )
    for arm in model.arms:
        if (low := top - model.tool_position(arm, home)[2]) >= 0.0:
            tool = of_arm(arm, "tool", len(model.arms))
            return f"at home the {tool} is {1e3 * low:.0f} mm below the table's top"
    return ""


def _rows(
    cell: Cell, reach: ReachMap, here: Region
) -> tuple[dict[str, Row], dict[str, Row]] | None:
    """Place trays and boxes of all arms without collisions, or return None."""
    reaches = {arm: _arm_reach(reach, arm) for arm in reach.postures}
    grid = reach.grid
    middle = [
        (c - side[0]) / here.step
        for c, side in zip(here.centre[::-1], (grid.y, grid.x), strict=True)
    ]
    count = LAYOUT.picks // len(reaches)
    model, clearance = CellModel.from_cell(cell), CellClearance.of(cell, ())
    # Start as far from the border as possible, and move nearer if rows are lacking.
    for depth in range(LAYOUT.depth, 0, -1):
        pairs = {arm: _pairs(reach, arm_reach, count, depth) for arm, arm_reach in reaches.items()}
        for chosen in _layouts(pairs, middle, here.across[::-1]) if all(pairs.values()) else ():
            work = dict(zip(reaches, chosen, strict=True))
            if len(work) == 1 or _clear_of_each_other(model, clearance, reaches, work):
                rows_by_arm = [
                    {arm: _row(reach.grid, nodes[k]) for arm, nodes in work.items()} for k in (0, 1)
                ]
                return rows_by_arm[0], rows_by_arm[1]
    return None


Nodes = tuple[tuple[int, int], ...]
"""Rows and columns of the nodes of a row of targets."""


def _arm_reach(reach: ReachMap, arm: str) -> _Reach:
    reached = reach.reached(arm)[0, 0]
    depth, inner = np.zeros(reached.shape), reached
    while inner.any():
        depth += inner
        wide = np.pad(inner, 1)
        inner = np.logical_and.reduce(
            [
                wide[1 + dy : wide.shape[0] - 1 + dy, 1 + dx : wide.shape[1] - 1 + dx]
                for dy, dx in product((-1, 0, 1), repeat=2)
            ]
        )
    number = np.full(reached.size, -1)
    number[reach.postures[arm].node] = np.arange(len(reach.postures[arm].node))
    return _Reach(depth, number.reshape(reached.shape), reach.postures[arm], reach.drawn_back[arm])


def _pairs(reach: ReachMap, area: _Reach, count: int, depth: int) -> list[tuple[Nodes, Nodes]]:
    """List an arm's tray and box pairs, best first.

    They are at least `depth` nodes inside its reach.
    """
    deep: BoolArray = area.depth >= depth
    rows: list[Nodes] = []
    ny, nx = deep.shape
    for iy, ix in zip(*np.nonzero(deep), strict=True):
        for dy, dx in ((1, 0), (0, 1)):
            nodes = tuple((int(iy) + k * dy, int(ix) + k * dx) for k in range(count))
            if nodes[-1][0] < ny and nodes[-1][1] < nx and all(deep[node] for node in nodes):
                rows.append(nodes)
    if len(rows) > LAYOUT.rows_kept:
        rows = [rows[k] for k in np.linspace(0, len(rows) - 1, LAYOUT.rows_kept).astype(int)]
    pairs = [(_distance(tray, box), tray, box) for tray in rows for box in rows]
    # About the preferred distance; of too many such pairs, a subset spread over the table.
    pairs = sorted(
        (pair for pair in pairs if pair[0] >= LAYOUT.least_apart),
        key=lambda pair: abs(pair[0] - LAYOUT.apart),
    )
    near = [pair for pair in pairs if abs(pair[0] - LAYOUT.apart) <= 1.0]
    if len(near) > LAYOUT.pairs_kept:
        pairs = [near[k] for k in np.linspace(0, len(near) - 1, LAYOUT.pairs_kept).astype(int)]
    return [(tray, box) for _, tray, box in pairs[: LAYOUT.pairs_kept]]


def _distance(row_a: Nodes, row_b: Nodes) -> float:
    """Compute the least distance between the nodes of two rows [steps]."""
    a, b = np.array(row_a), np.array(row_b)
    return float(products.norm(a[:, None] - b[None], axis=-1).min())


def _layouts(
    pairs: Mapping[str, list[tuple[Nodes, Nodes]]],
    centre: Sequence[float],
    apart: Sequence[float],
) -> Sequence[tuple[tuple[Nodes, Nodes], ...]]:
    """List combinations of the arms' tray and box pairs, best first.

    Arms far apart come first, and arrangements that are symmetric.

    Args:
        pairs: tray and box pairs by arm.
        centre: middle of the robot, row and column.
        apart: from the right shoulder to the left one, along rows and columns.
    """
    if len(pairs) == 1:
        return [(pair,) for pair in next(iter(pairs.values()))][: LAYOUT.layouts_tried]
    left, right = pairs.values()
    a, b = (
        np.array([[np.mean(row, axis=0) for row in pair] for pair in arm]) for arm in (left, right)
    )
    gap = products.norm(a[:, None, :, None] - b[None, :, None, :], axis=-1).min(axis=(2, 3))
    # Vectors from the right arm's row to the left arm's, of trays and of boxes, and their midpoints.
    across, between = a[:, None] - b[None], 0.5 * (a[:, None] + b[None]) - np.array(centre)
    unlike = products.norm(across[:, :, 0] - across[:, :, 1], axis=-1)
    along = across.sum(axis=2, keepdims=True)
    along /= np.maximum(products.norm(along, axis=-1, keepdims=True), 1e-9)
    aside = np.abs((between * along).sum(axis=-1)).sum(axis=-1)
    score = np.minimum(gap, 2.0 * LAYOUT.arms_apart) - LAYOUT.alike * (unlike + aside)
    # Arms that work on each other's side would have to pass each other.
    own_side = (products.product(across, np.array(apart)) >= 0.0).all(axis=-1)
    score = np.where((gap >= LAYOUT.arms_apart) & own_side, score, -np.inf)
    order = np.argsort(-score, axis=None, kind="stable")[: LAYOUT.layouts_tried]
    order = order[np.isfinite(score.ravel()[order])]
    first, second = np.unravel_index(order, score.shape)
    return [(left[i], right[j]) for i, j in zip(first.tolist(), second.tolist(), strict=True)]


def _clear_of_each_other(
    model: CellModel,
    clearance: CellClearance,
    reaches: Mapping[str, _Reach],
    work: Mapping[str, tuple[Nodes, Nodes]],
) -> bool:
    """Test whether the arms are clear of each other, at targets and retracted."""
    test, rows = clearance.test, []
    for k in (0, 1):
        stages = list(zip(*(work[arm][k] for arm in reaches), strict=True))
        for nodes in stages:
            numbers = [
                int(reach.number[node]) for reach, node in zip(reaches.values(), nodes, strict=True)
            ]
            for backs in product((False, True), repeat=2):
                whole = np.array(model.cell.robot.postures["home"])
                for (arm, reach), number, back in zip(reaches.items(), numbers, backs, strict=True):
                    q = reach.back if back else reach.postures.q
                    whole[model.arms[arm].columns] = q[number]
                rows.append(whole)
    return bool((test.margins(test.cross(), np.array(rows)) >= SLACK).all())


def _row(grid: TableGrid, nodes: Nodes) -> Row:
    """Convert a row of nodes to rounded file values."""
    y, x = (
        float(np.mean([side[node[k]] for node in nodes])) for k, side in enumerate((grid.y, grid.x))
    )
    along = "y" if nodes[0][1] == nodes[-1][1] else "x"
    return Row((round(x, 4), round(y, 4)), along)
