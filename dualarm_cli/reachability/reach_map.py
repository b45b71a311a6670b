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
    """What each arm reaches on the nodes of a table."""

    grid: TableGrid
    """The nodes."""
    postures: Mapping[str, Postures]
    """By arm, a posture on every node that it reaches."""
    drawn_back: Mapping[str, FloatArray]
    """By arm, the joints at the other end of the line, shape (m, n) [rad]; where no line was asked for, the same."""

    def reached(self, arm: str) -> BoolArray:
        """Returns the nodes that an arm reaches, in the shape of the grid."""
        found = np.zeros(self.grid.size, dtype=np.bool_)
        found[self.postures[arm].node] = True
        return found.reshape(self.grid.shape)

    @property
    def both(self) -> BoolArray:
        """The nodes that every arm reaches, each from the same platform angle, in the shape of the grid."""
        return np.logical_and.reduce([self.reached(arm) for arm in self.postures])


def reach_map(cell: Cell, grid: TableGrid, line: float = 0.0) -> ReachMap:
    """Returns which nodes each arm reaches.

    A posture counts if all joints are within their limits and if the arm is clear of itself, of the platform and of
    obstacles. The other arm is not looked at.

    Args:
        cell: robot, tools and obstacles.
        grid: the nodes.
        line: how far the tool is drawn back from there along its axis, without leaving its branch [m].
    """
    model, general = CellModel.from_cell(cell), general_arms(cell)
    clearance = CellClearance.of(cell, ())
    found, ends = {}, {}
    for name in model.arms:

        def accepted(postures: Postures, arm: str = name) -> BoolArray:
            good = is_clear(model, clearance, arm, grid, postures.node, postures.q)
            if line:
                rows = np.flatnonzero(good)
                back, reached = _drawn_back(
                    model, general[arm], arm, grid, postures.take(rows), line
                )
                reached &= is_clear(model, clearance, arm, grid, postures.node[rows], back)
                good[rows] = reached
            return good

        found[name] = fill(model, general[name], name, grid, accepted)
        ends[name] = found[name].q
        if line:
            ends[name] = _drawn_back(model, general[name], name, grid, found[name], line)[0]
    return ReachMap(grid, found, ends)


def positions(
    model: CellModel, arm: str, grid: TableGrid, node: IntArray, q: FloatArray
) -> FloatArray:
    """Returns all joints of the robot [rad] with one arm at q (m, n) on nodes (m,), the other one at home."""
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
    """Returns which joints (m, n) of one arm on nodes (m,) are clear of all but the other arm, shape (m,)."""
    if not len(q):
        return np.zeros(0, dtype=np.bool_)
    margins = clearance.test.margins(clearance.test.own(arm), positions(model, arm, grid, node, q))
    return np.asarray(margins >= SLACK)


def _drawn_back(
    model: CellModel,
    numeric: GeneralArm,
    arm: str,
    grid: TableGrid,
    postures: Postures,
    line: float,
) -> tuple[FloatArray, BoolArray]:
    """Returns joints with the tool drawn back (m, n) [rad], and whether they are reached from the nodes' postures."""
    R, p = flange_poses(model, arm, grid, postures.node, postures.yaw, line)
    back, error = descend(numeric, R, p, postures.q)
    near = np.abs(back - postures.q).max(axis=1, initial=0.0) <= FILLING.largest_change
    return back, np.asarray((error <= INVERSE.residual).all(axis=1) & near)
