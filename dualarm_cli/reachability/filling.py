"""Postures on the nodes of a table: found from scratch on some nodes, and from one node to the next on all others."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import norm
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.kinematics.numeric_inverse import INVERSE, descend
from dualarm_cli.reachability.table_grid import YAWS, TableGrid, flange_poses
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class FillingSettings:
    """Numbers that steer the search for postures of reach maps."""

    seed_steps: tuple[int, ...] = (4, 3, 2, 1)
    """Postures are found from scratch on every so many nodes along each axis: the first of these with `many` nodes."""
    many: int = 200
    """Minimum number of seed nodes of an arm without closed forms."""
    many_closed: int = 1000
    """Minimum number of seed nodes of an arm with closed forms."""
    seeds_kept: int = 6
    """Maximum number of postures kept per seed pose."""
    turns: tuple[int, ...] = (0, 1, -1, 2, -2)
    """Yaw steps between neighbouring nodes, of YAWS per turn, in order of trial."""
    largest_change: float = 1.5
    """A joint that moves more on the way to a node next to it, or along a line, has left its branch [rad]."""


FILLING = FillingSettings()


@dataclass(frozen=True)
class Postures:
    """One posture on some nodes."""

    node: IntArray
    """Numbers of nodes, shape (m,)."""
    yaw: IntArray
    """Numbers of turns about the tool's axis, shape (m,)."""
    q: FloatArray
    """The arm's joints [rad], shape (m, n)."""

    def take(self, rows: IntArray | BoolArray) -> Postures:
        """Returns some of them."""
        return Postures(self.node[rows], self.yaw[rows], self.q[rows])


Accept = Callable[[Postures], BoolArray]
"""Says which postures will do."""


def fill(
    model: CellModel, numeric: GeneralArm, arm: str, grid: TableGrid, accept: Accept
) -> Postures:
    """Returns a posture on every node for which one was found, nodes ascending.

    From some nodes on, the posture of a node is the start of descents to the nodes next to it, with the
    same turn of the tool first and others after that. A node without a posture has none next to a posture of its
    neighbours; that is not proven to mean that there is none.

    Args:
        model: the cell, with closed forms where arms have them.
        numeric: the arm without closed forms.
        arm: its name.
        grid: the nodes.
        accept: which postures will do.
    """
    axes = numeric.axes
    q, yaw = np.full((grid.size, axes), np.nan), np.zeros(grid.size, dtype=np.int64)
    done = np.zeros(grid.size, dtype=np.bool_)
    tried = np.zeros((len(FILLING.turns), 2 * len(grid.shape), grid.size), dtype=np.bool_)

    def keep(found: Postures) -> bool:
        """Keeps the first accepted posture of each node; returns whether there is one."""
        some = False
        left = found.take(~done[found.node])
        while len(left.node):
            # One of each node at a time: most are accepted, and then the others need not be looked at.
            first = np.unique(left.node, return_index=True)[1]
            tested = left.take(first)
            good = tested.take(accept(tested))
            q[good.node], yaw[good.node], done[good.node] = good.q, good.yaw, True
            some |= len(good.node) > 0
            left = left.take(np.delete(np.arange(len(left.node)), first))
            left = left.take(~done[left.node])
        return some

    keep(seeds(model, arm, grid))
    turn = 0
    while turn < len(FILLING.turns):
        rows: list[Postures] = []
        sources = np.flatnonzero(done)
        for way, (there, exists) in enumerate(grid.neighbours(sources)):
            open_ = exists & ~done[there] & ~tried[turn, way, there]
            tried[turn, way, there[open_]] = True
            source, target = sources[open_], there[open_]
            rows.append(Postures(target, (yaw[source] + FILLING.turns[turn]) % YAWS, q[source]))
        starts = Postures(
            *(np.concatenate([getattr(r, f) for r in rows]) for f in ("node", "yaw", "q"))
        )
        if not len(starts.node):
            turn += 1
            continue
        R, p = flange_poses(model, arm, grid, starts.node, starts.yaw)
        # What is on nobody's way to anything is not descended to.
        near = norm(p - numeric.p_parent_joint[0], axis=1) <= numeric.farthest
        starts, R, p = starts.take(near), R[near], p[near]
        reached, error = descend(numeric, R, p, starts.q)
        good = (error <= INVERSE.residual).all(axis=1)
        good &= np.abs(reached - starts.q).max(axis=1, initial=0.0) <= _most(FILLING.turns[turn])
        if keep(Postures(starts.node, starts.yaw, reached).take(good)):
            turn = 0
    nodes = np.flatnonzero(done)
    return Postures(nodes, yaw[nodes], q[nodes])


def _most(turn: int) -> float:
    """Returns how far a joint may move [rad] when the tool is turned by so many of YAWS."""
    return FILLING.largest_change + abs(turn) * TURN / YAWS


def seeds(model: CellModel, arm: str, grid: TableGrid) -> Postures:
    """Find postures on nodes spread over the grid.

    At most `seeds_kept` are kept of each pose.

    Args:
        model: the cell.
        arm: its name.
        grid: the nodes.
    """
    kinematics = model.arms[arm].kinematics
    many, yaws = (FILLING.many, 1) if kinematics.solves_by_search else (FILLING.many_closed, YAWS)
    spread = (grid.every(step) for step in FILLING.seed_steps)
    coarse = next((node for node in spread if len(node) >= many), np.arange(grid.size))
    node, yaw = np.repeat(coarse, yaws), np.tile(np.arange(yaws), len(coarse))
    R, p = flange_poses(model, arm, grid, node, yaw)
    reached = kinematics.postures(R, p, first_only=True, thorough=False)
    pose = reached.pose
    kept = np.arange(len(pose)) - np.searchsorted(pose, pose) < FILLING.seeds_kept
    return Postures(node[pose[kept]], yaw[pose[kept]], reached.q[kept])
