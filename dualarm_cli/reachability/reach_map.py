"""Reach map of a table: collision-free postures by point, arm and platform angle."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel, general_arms
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import INVERSE, descend
from dualarm_cli.model.cell import Cell
from dualarm_cli.reachability.filling import FILLING, Postures, fill
from dualarm_cli.reachability.table_grid import TableGrid, flange_poses
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ReachMap:
    """Nodes of a table within reach of each arm, with postures."""

    grid: TableGrid
    """Grid of nodes."""
    postures: Mapping[str, Postures]
    """Postures by arm, one on every node within reach."""
    drawn_back: Mapping[str, FloatArray]
    """Joints by arm at the line's other end [rad], shape (m, n)."""

    def reached(self, arm: str) -> BoolArray:
        """Return the mask of nodes within an arm's reach, shaped like the grid."""
        mask = np.zeros(self.grid.size, dtype=np.bool_)
        mask[self.postures[arm].node] = True
        return mask.reshape(self.grid.shape)

    @property
    def both(self) -> BoolArray:
        """Mask of nodes that every arm reaches from the same platform angle."""
        return np.logical_and.reduce([self.reached(arm) for arm in self.postures])


def reach_map(cell: Cell, grid: TableGrid, line: float = 0.0) -> ReachMap:
    """Compute the reach map of a table grid.

    A posture counts if all joints are within their limits and the arm is collision-free with itself, the platform and
    obstacles. The other arm is ignored.

    Args:
        cell: robot, tools and obstacles.
        grid: the nodes.
        line: length by which the tool is drawn back along its axis on the same branch [m].
    """
    model, general = CellModel.from_cell(cell), general_arms(cell)
    clearance = CellClearance.of(cell, ())
    by_arm, ends = {}, {}
    for name in model.arms:

        def accepted(postures: Postures, arm: str = name) -> BoolArray:
            mask = is_clear(model, clearance, arm, grid, postures.node, postures.q)
            if line:
                rows = np.flatnonzero(mask)
                back, reached = _drawn_back(
                    model, general[arm], arm, grid, postures.take(rows), line
                )
                reached &= is_clear(model, clearance, arm, grid, postures.node[rows], back)
                mask[rows] = reached
            return mask

        by_arm[name] = fill(model, general[name], name, grid, accepted)
        ends[name] = by_arm[name].q
        if line:
            ends[name] = _drawn_back(model, general[name], name, grid, by_arm[name], line)[0]
    return ReachMap(grid, by_arm, ends)


def positions(
    model: CellModel, arm: str, grid: TableGrid, node: IntArray, q: FloatArray
) -> FloatArray:
    """Assemble robot configurations from an arm's joints on nodes, all others at home."""
    rows = np.tile(model.cell.robot.postures["home"], (len(q), 1))
    rows[:, model.platform_columns] = grid.platform_at(node)
    rows[:, model.arms[arm].columns] = q
    return rows


def is_clear(
    model: CellModel,
    clearance: CellClearance,
    arm: str,
    grid: TableGrid,
    node: IntArray,
    q: FloatArray,
) -> BoolArray:
    """Check that an arm's joints on nodes are collision-free, the other arm aside."""
    if not len(q):
        return np.zeros(0, dtype=np.bool_)
    margins = clearance.test.margins(
        clearance.test.arm_pairs(arm), positions(model, arm, grid, node, q)
    )
    return np.asarray(margins >= SLACK)


def _drawn_back(
    model: CellModel,
    numeric: GeneralArm,
    arm: str,
    grid: TableGrid,
    postures: Postures,
    line: float,
) -> tuple[FloatArray, BoolArray]:
    """Compute joints with the tool drawn back [rad], and the mask on the branch."""
    R, p = flange_poses(model, arm, grid, postures.node, postures.yaw, line)
    back, error = descend(numeric, R, p, postures.q)
    on_branch = np.abs(back - postures.q).max(axis=1, initial=0.0) <= FILLING.largest_change
    return back, np.asarray((error <= INVERSE.residual).all(axis=1) & on_branch)
