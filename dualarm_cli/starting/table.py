"""Table of a proposed cell: where it clears the robot, and where most is reached."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import cell_solids
from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.model.cell import Cell, Obstacle
from dualarm_cli.model.shape import Shape
from dualarm_cli.reachability.region import platform_positions
from dualarm_cli.records import dataclass
from dualarm_cli.robot_import.contacts import in_model_order


@dataclass(frozen=True)
class Table:
    """Table top with sides along x and y."""

    low: tuple[float, float]
    """Minimum x and y [m]."""
    high: tuple[float, float]
    """Maximum x and y [m]."""
    top: float
    """Height of the top [m]."""
    thickness: float
    """Thickness [m]."""

    @staticmethod
    def under(x: FloatArray, y: FloatArray, step: float, levels: tuple[float, float]) -> Table:
        """Build the table under a block of nodes."""
        low = (round(float(x[0] - 0.5 * step), 4), round(float(y[0] - 0.5 * step), 4))
        high = (round(float(x[-1] + 0.5 * step), 4), round(float(y[-1] + 0.5 * step), 4))
        return Table(low, high, *levels)

    @property
    def size(self) -> tuple[float, float, float]:
        """Side lengths [m]."""
        return self.high[0] - self.low[0], self.high[1] - self.low[1], self.thickness

    @property
    def middle(self) -> tuple[float, float, float]:
        """Centre [m]."""
        x, y = (0.5 * (a + b) for a, b in zip(self.low, self.high, strict=True))
        return x, y, self.top - 0.5 * self.thickness

    @property
    def obstacle(self) -> Obstacle:
        """Obstacle of the data model."""
        return Obstacle("table", Shape("box", self.size, pin.SE3(np.eye(3), np.array(self.middle))))


def room_for_table(
    cell: Cell,
    x: FloatArray,
    y: FloatArray,
    levels: tuple[float, float],
    room: float,
    *,
    arms: bool,
) -> BoolArray:
    """Mark the nodes where a table clears the robot at home, shape (ny, nx).

    A platform that moves between stages is checked at positions over its range.

    Args:
        cell: robot and tools.
        x: nodes [m], evenly spaced.
        y: nodes [m].
        levels: minimum and maximum height of the table [m].
        room: least distance of the table from the robot [m].
        arms: whether the table must also clear the arms in the posture home.
    """
    model, home = pin.buildModelFromXML(cell.robot.urdf), cell.robot.postures["home"]
    solids, data = cell_solids(cell, model, ()), model.createData()
    moved = {model.getJointId(joint) for arm in cell.robot.arms for joint in arm.joints}
    half = 0.5 * (x[1] - x[0] if len(x) > 1 else 0.0) + room
    free = np.ones((len(y), len(x)), dtype=np.bool_)
    turned = np.tile(home, (1 + len(places := platform_positions(cell)), 1))
    turned[1:, cell.robot.columns(cell.robot.platform)] = places
    for k, q in enumerate(in_model_order(model, cell.robot, turned)):
        pin.forwardKinematics(model, data, q)
        for solid in solids:
            if isinstance(solid.geometry, coal.Halfspace) or (
                solid.joint in moved and (k or not arms)
            ):
                continue
            pose = cell.base * data.oMi[solid.joint] * solid.pose
            body = coal.CollisionObject(solid.geometry, pose.rotation, pose.translation).getAABB()
            low, high = np.array(body.min_), np.array(body.max_)
            if low[2] - room < levels[1] and high[2] + room > levels[0]:
                across = (x > low[0] - half) & (x < high[0] + half)
                along = (y > low[1] - half) & (y < high[1] + half)
                free &= ~(along[:, None] & across[None])
    return free


def most_reached(
    reached: list[BoolArray], free: BoolArray, front: FloatArray
) -> tuple[float, slice, slice]:
    """Find the free rectangle of nodes with the largest reach.

    Its score is the reached weight of the arm that reaches less, plus half the weight that all arms reach, minus a
    tenth of the number of nodes.

    Args:
        reached: by arm, the nodes that it reaches, shape (ny, nx).
        free: nodes that a table may be on, shape (ny, nx).
        front: weights of the nodes, shape (ny, nx).

    Returns:
        The score, rows (y) and columns (x); minus infinity where there is no such rectangle.
    """
    both: BoolArray = np.logical_and.reduce(reached)
    y, x = (np.array(np.triu_indices(n + 1, 1)) for n in free.shape)

    def inside(values: FloatArray) -> FloatArray:
        """Sum values over all rectangles, shape (rows, columns)."""
        total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
        total[1:, 1:] = values.cumsum(axis=0).cumsum(axis=1)
        sums: FloatArray = (
            total[y[1]][:, x[1]]
            - total[y[0]][:, x[1]]
            - total[y[1]][:, x[0]]
            + total[y[0]][:, x[0]]
        )
        return sums

    worst = np.minimum.reduce([inside(front * nodes.astype(np.float64)) for nodes in reached])
    score = (
        worst + 0.5 * inside(front * both.astype(np.float64)) - 0.1 * inside(np.ones(free.shape))
    )
    score = np.where((inside((~free).astype(np.float64)) < 0.5) & (worst > 0.0), score, -np.inf)
    row, column = np.unravel_index(int(np.argmax(score)), score.shape)
    rows, columns = (slice(*ends[:, k].tolist()) for ends, k in ((y, row), (x, column)))
    return float(score[row, column]), rows, columns
