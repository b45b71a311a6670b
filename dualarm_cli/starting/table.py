"""Where a table has room beside a robot, and holds most of what its arms reach."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import WORLD, cell_solids
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.cell import Cell, Obstacle
from dualarm_cli.model.shape import Shape
from dualarm_cli.records import dataclass

ROOM = 0.03
"""Room between a table and the robot as it stands [m]."""
FRONT = 0.5
"""What a node in front of the robot is worth more than one beside it."""


@dataclass(frozen=True)
class Table:
    """A table top, its sides along x and y."""

    low: tuple[float, float]
    """Least x and y [m]."""
    high: tuple[float, float]
    """Greatest x and y [m]."""
    top: float
    """Height of its top [m]."""
    thickness: float
    """[m]"""

    @property
    def size(self) -> tuple[float, float, float]:
        """Sides [m]."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1], self.thickness

    @property
    def middle(self) -> tuple[float, float, float]:
        """Its centre [m]."""
        x, y = (0.5 * (a + b) for a, b in zip(self.low, self.high, strict=True))
        return x, y, self.top - 0.5 * self.thickness

    @property
    def obstacle(self) -> Obstacle:
        """In the data model."""
        return Obstacle("table", Shape("box", self.size, pin.SE3(np.eye(3), np.array(self.middle))))


def room_for_table(
    cell: Cell, x: FloatArray, y: FloatArray, levels: tuple[float, float], *, arms: bool
) -> BoolArray:
    """Returns where a table does not touch the robot as it stands at home, shape (ny, nx).

    A platform that turns is looked at all round.

    Args:
        cell: robot and tools.
        x: nodes [m], evenly spaced.
        y: nodes [m].
        levels: least and greatest height of the table [m].
        arms: whether it must not touch the arms in the posture home either.
    """
    model, home = pin.buildModelFromXML(cell.robot.urdf), cell.robot.postures["home"]
    solids, data = cell_solids(cell, model, ()), model.createData()
    moved = {model.getJointId(joint) for arm in cell.robot.arms for joint in arm.joints}
    half = 0.5 * (x[1] - x[0] if len(x) > 1 else 0.0) + ROOM
    free = np.ones((len(y), len(x)), dtype=np.bool_)
    for k, turn in enumerate(np.append(0.0, np.radians(np.arange(10.0, 360.0, 10.0)))):
        q = np.array(home)
        if k:
            if not cell.robot.platform:
                break
            q[cell.robot.columns(cell.robot.platform)[0]] += turn
        ordered = np.empty_like(q)
        ordered[[model.idx_qs[model.getJointId(name)] for name in cell.robot.joints]] = q
        pin.forwardKinematics(model, data, ordered)
        for solid in solids:
            if solid.joint in moved and (k or not arms):
                continue
            if isinstance(solid.geometry, coal.Halfspace):
                continue
            pose = (
                cell.base
                * (pin.SE3.Identity() if solid.joint == WORLD else data.oMi[solid.joint])
                * solid.pose
            )
            body = coal.CollisionObject(solid.geometry, pose.rotation, pose.translation).getAABB()
            low, high = np.array(body.min_), np.array(body.max_)
            if low[2] - ROOM < levels[1] and high[2] + ROOM > levels[0]:
                across = (x > low[0] - half) & (x < high[0] + half)
                along = (y > low[1] - half) & (y < high[1] + half)
                free &= ~(along[:, None] & across[None])
    return free


def most_reached(
    reached: list[BoolArray], free: BoolArray, front: FloatArray
) -> tuple[float, slice, slice]:
    """Returns the free rectangle of nodes in which the arms reach most: what it is worth, rows (y) and columns (x).

    What the arm reaches that reaches less counts, then what both do, then how little else there is. Where there is no
    such rectangle it is worth minus infinity.

    Args:
        reached: by arm, the nodes that it reaches, shape (ny, nx).
        free: nodes that a table may be on, shape (ny, nx).
        front: what nodes are worth by where they are, shape (ny, nx).
    """
    both: BoolArray = np.logical_and.reduce(reached)
    y, x = (np.array(np.triu_indices(n + 1, 1)) for n in free.shape)

    def inside(values: FloatArray) -> FloatArray:
        """Returns the sums over all rectangles, shape (rows, columns)."""
        total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
        total[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
        found: FloatArray = (
            total[y[1]][:, x[1]]
            - total[y[0]][:, x[1]]
            - total[y[1]][:, x[0]]
            + total[y[0]][:, x[0]]
        )
        return found

    worst = np.minimum.reduce([inside(front * one.astype(np.float64)) for one in reached])
    score = (
        worst + 0.5 * inside(front * both.astype(np.float64)) - 0.1 * inside(np.ones(free.shape))
    )
    score = np.where((inside((~free).astype(np.float64)) < 0.5) & (worst > 0.0), score, -np.inf)
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    rows, columns = (slice(*ends[:, k].tolist()) for ends, k in ((y, row), (x, column)))
    return float(score[row, column]), rows, columns
