"""Postures on table nodes: inverse kinematics on seed nodes, continuation to their neighbours."""

from __future__ import annotations

from collections.abc import Callable, Iterator

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
    """Settings of the posture search of reach maps."""

    seed_steps: tuple[int, ...] = (4, 3, 2, 1)
    """Spacings of seed nodes along each axis; the first with `many` nodes is used."""
    many: int = 200
    """Minimum number of seed nodes of an arm without closed forms."""
    many_closed: int = 1000
    """Minimum number of seed nodes of an arm with closed forms."""
    seeds_kept: int = 6
    """Maximum number of postures per seed pose."""
    turns: tuple[int, ...] = (0, 1, -1, 2, -2)
    """Yaw steps between neighbouring nodes, of YAWS per turn, in order of preference."""
    largest_change: float = 1.5
    """Joint change between neighbouring nodes from which the branch is lost [rad]."""


FILLING = FillingSettings()


@dataclass(frozen=True)
class Postures:
    """Postures on m nodes, one on each."""

    node: IntArray
    """Node numbers, shape (m,)."""
    yaw: IntArray
    """Yaw numbers about the tool's axis, shape (m,)."""
    q: FloatArray
    """Joints of the arm [rad], shape (m, n)."""

    def take(self, rows: IntArray | BoolArray) -> Postures:
        """Select postures by their rows."""
        return Postures(self.node[rows], self.yaw[rows], self.q[rows])


Accept = Callable[[Postures], BoolArray]
"""Function from postures to the mask of accepted ones."""


def fill(
    model: CellModel, numeric: GeneralArm, arm: str, grid: TableGrid, accept: Accept
) -> Postures:
    """Compute a posture on every node within reach, nodes ascending.

    From seed nodes on, the posture of a node starts descents to its neighbours, with the same yaw first and other yaws
    after that. A node without a posture has none near a posture of its neighbours; this does not prove that it is out
    of reach.

    Args:
        model: the cell, with closed forms where arms have them.
        numeric: the arm without closed forms.
        arm: name of the arm.
        grid: the nodes.
        accept: function that selects acceptable postures.
    """
    axes = numeric.axes
    q, yaw = np.full((grid.size, axes), np.nan), np.zeros(grid.size, dtype=np.int64)
    done = np.zeros(grid.size, dtype=np.bool_)
    visited = np.zeros((len(FILLING.turns), 2 * len(grid.shape), grid.size), dtype=np.bool_)

    def keep(postures: Postures) -> bool:
        """Store the first accepted posture of each node; returns whether any was accepted."""
        any_accepted = False
        candidates = postures.take(~done[postures.node])
        while len(candidates.node):
            # A posture of each node at a time: most are accepted, and then the others need no test.
            first = np.unique(candidates.node, return_index=True)[1]
            tested = candidates.take(first)
            accepted = tested.take(accept(tested))
            q[accepted.node], yaw[accepted.node], done[accepted.node] = (
                accepted.q,
                accepted.yaw,
                True,
            )
            any_accepted |= len(accepted.node) > 0
            candidates = candidates.take(np.delete(np.arange(len(candidates.node)), first))
            candidates = candidates.take(~done[candidates.node])
        return any_accepted

    any(keep(batch) for batch in seeds(model, arm, grid))
    turn = 0
    while turn < len(FILLING.turns):
        rows: list[Postures] = []
        sources = np.flatnonzero(done)
        for direction, (target, exists) in enumerate(grid.neighbours(sources)):
            open_ = exists & ~done[target] & ~visited[turn, direction, target]
            visited[turn, direction, target[open_]] = True
            source, target = sources[open_], target[open_]
            rows.append(Postures(target, (yaw[source] + FILLING.turns[turn]) % YAWS, q[source]))
        starts = Postures(
            *(np.concatenate([getattr(r, f) for r in rows]) for f in ("node", "yaw", "q"))
        )
        if not len(starts.node):
            turn += 1
            continue
        R, p = flange_poses(model, arm, grid, starts.node, starts.yaw)
        # Poses out of reach are dropped before the descent.
        within_reach = norm(p - numeric.p_parent_joint[0], axis=1) <= numeric.farthest
        starts, R, p = starts.take(within_reach), R[within_reach], p[within_reach]
        reached, error = descend(numeric, R, p, starts.q)
        converged = (error <= INVERSE.residual).all(axis=1)
        converged &= np.abs(reached - starts.q).max(axis=1, initial=0.0) <= _max_change(
            FILLING.turns[turn]
        )
        if keep(Postures(starts.node, starts.yaw, reached).take(converged)):
            turn = 0
    nodes = np.flatnonzero(done)
    return Postures(nodes, yaw[nodes], q[nodes])


def _max_change(turn: int) -> float:
    """Compute the allowed joint change [rad] for a yaw change in steps of YAWS."""
    return FILLING.largest_change + abs(turn) * TURN / YAWS


def seeds(model: CellModel, arm: str, grid: TableGrid) -> Iterator[Postures]:
    """Compute postures on nodes spread over the grid, up to `seeds_kept` per pose.

    Closed forms solve all yaws at once. Searches take longer: a batch has one yaw, as most wrists hold the tool at any.

    Args:
        model: the cell.
        arm: its name.
        grid: the nodes.
    """
    kinematics = model.arms[arm].kinematics
    many, count = (FILLING.many, 1) if kinematics.solves_by_search else (FILLING.many_closed, YAWS)
    spread = (grid.every(step) for step in FILLING.seed_steps)
    coarse = next((node for node in spread if len(node) >= many), np.arange(grid.size))
    for yaws in np.arange(YAWS).reshape(-1, count):
        node, yaw = np.repeat(coarse, count), np.tile(yaws, len(coarse))
        R, p = flange_poses(model, arm, grid, node, yaw)
        reached = kinematics.postures(R, p, first_only=True, thorough=False)
        pose = reached.pose
        selected = np.arange(len(pose)) - np.searchsorted(pose, pose) < FILLING.seeds_kept
        yield Postures(node[pose[selected]], yaw[pose[selected]], reached.q[selected])
