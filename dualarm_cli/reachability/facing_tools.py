"""Hand-over poses: where both arms reach, with their tools facing each other.

Directions and midpoints on a grid; the inverse kinematics of each arm at turns about its tool's axis; the best pairs
that keep their clearance and can draw back, spread over room and directions.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dualarm_cli.collision.clearance import SLACK, CellClearance
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import CellModel, general_arms
from dualarm_cli.kinematics.manipulability import manipulability
from dualarm_cli.kinematics.numeric_inverse import INVERSE, descend
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.posture_source import LARGEST_STEP
from dualarm_cli.model.cell import Cell
from dualarm_cli.reachability.region import Region, region
from dualarm_cli.reachability.table_grid import YAWS, carried_flanges
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class FacingSettings:
    """Settings of the search for hand-over poses."""

    slopes: tuple[float, ...] = (0.0, np.radians(45.0), np.radians(-45.0))
    """Slopes of the giving tool above the horizontal [rad]."""
    headings: int = 8
    """Number of headings of a full turn."""
    towards: float = 0.3
    """Minimum cosine between a heading and the horizontal direction to the other arm's shoulder."""
    spacings: tuple[int, ...] = (1, 2, 3, 4, 6, 8)
    """Candidate spacings of midpoints, in steps of the region.

    The first with few enough poses is used.
    """
    many: int = 4_000
    """Maximum number of poses of an arm with closed forms."""
    many_searched: int = 500
    """Maximum number of poses of an arm without them."""
    stretch: float = 0.85
    """Maximum distance of a tool from its shoulder as a fraction of the reach."""
    behind: float = 0.1
    """Distance behind the shoulders still in front, as a fraction of the reach."""
    line: float = 0.08
    """Length by which either tool draws back from the part [m]."""
    samples: int = 4
    """Number of checked positions along that line."""
    kept: int = 3
    """Maximum number of tested postures per pose and parity of the turn."""
    apart: float = 0.2
    """Minimum distance between selected poses [m]."""
    lever: float = 0.2
    """Distance equivalent to a change of the tool's direction [m/rad]."""
    poses: int = 5
    """Maximum number of selected poses."""


FACING = FacingSettings()


@dataclass(frozen=True)
class HandoverPose:
    """Tools of two arms that face each other along their z axes."""

    tools: Mapping[str, tuple[FloatArray, FloatArray]]
    """Rotation (3, 3) and tool centre point (3,) [m] in the world, by arm."""
    turn: float
    """Turn of either tool about its z axis, relative to the other [rad]."""
    q: Mapping[str, FloatArray]
    """Joints by arm [rad], the platform at home, each of shape (n,)."""
    score: float
    """Least of both arms' relative manipulability and distance from joint limits, from 0 to 1.

    It is less the farther the tools are from where they are at home.
    """


@dataclass(frozen=True)
class _Reached:
    """Best clear posture of an arm at each pose and parity of the tool's turn."""

    key: IntArray
    """Twice the pose's number, plus 1 for odd turns, ascending, shape (m,)."""
    yaw: IntArray
    """Turns about the tool's axis, of YAWS, shape (m,)."""
    q: FloatArray
    """Joints [rad], shape (m, n)."""
    score: FloatArray
    """Scores, shape (m,)."""


@dataclass(frozen=True)
class _Pairs:
    """Postures of both arms at m poses, best first."""

    pose: IntArray
    """Numbers of the poses, shape (m,)."""
    yaw: Mapping[str, IntArray]
    """Turns about the tools' axes by arm, of YAWS, shape (m,)."""
    q: Mapping[str, FloatArray]
    """Joints by arm [rad], shape (m, n)."""
    score: FloatArray
    """Scores, shape (m,)."""

    def take(self, rows: IntArray | BoolArray) -> _Pairs:
        """Select pairs by their rows."""
        yaw = {arm: values[rows] for arm, values in self.yaw.items()}
        q = {arm: values[rows] for arm, values in self.q.items()}
        return _Pairs(self.pose[rows], yaw, q, self.score[rows])


def handover_poses(cell: Cell, distance: float) -> list[HandoverPose]:
    """Search hand-over poses of both arms with the platform at home, best first.

    The bodies of the robot, its tools and obstacles keep their clearance, also as either tool draws back by
    `FACING.line`; the part is not checked. Turns of the tools to each other are multiples of a quarter turn.

    Args:
        cell: robot with two arms, tools and obstacles.
        distance: distance between the tool centre points [m].
    """
    return _Search(cell, distance).poses()


class _Search:
    """Search for poses at which the tools of two arms face each other."""

    def __init__(self, cell: Cell, distance: float) -> None:
        """Choose directions and midpoints, as few as the arms' inverse kinematics needs."""
        self._model, self._general = CellModel.from_cell(cell), general_arms(cell)
        self._clearance = CellClearance.of(cell, ())
        self._home = cell.robot.postures["home"]
        self._here = here = region(cell)
        self._middle = self._model.tool_positions(list(self._model.arms), self._home).mean(axis=0)
        searched = any(arm.kinematics.solves_by_search for arm in self._model.arms.values())
        many = FACING.many_searched if searched else FACING.many
        for spacing in FACING.spacings:
            R, p = _facing(here, self._middle, spacing * here.step, distance)
            if len(R) <= many:
                break
        first, second = self._model.arms
        # Half a turn about x turns a tool towards the one before it.
        facing = product(R, np.diag([1.0, -1.0, -1.0]))
        self._tools = {first: (R, p), second: (facing, p + distance * R[..., 2])}

    def poses(self) -> list[HandoverPose]:
        """Select the best poses that are apart, by room and direction."""
        pairs = self._pairs()
        pairs = pairs.take(self._draw_back(pairs))
        first, second = self._tools
        R, p = self._tools[first]
        place = np.concatenate([p, FACING.lever * R[..., 2]], axis=1)[pairs.pose]
        selected, rows = list[int](), np.arange(len(place))
        while len(rows) and len(selected) < FACING.poses:
            selected.append(int(rows[0]))
            rows = rows[norm(place[rows] - place[rows[0]], axis=1) >= FACING.apart]
        return [
            HandoverPose(
                {arm: self._tool(arm, pairs, k) for arm in self._tools},
                float(-(pairs.yaw[first][k] + pairs.yaw[second][k]) % YAWS) * TURN / YAWS,
                {arm: q[k] for arm, q in pairs.q.items()},
                float(pairs.score[k]),
            )
            for k in selected
        ]

    def _tool(self, arm: str, pairs: _Pairs, k: int) -> tuple[FloatArray, FloatArray]:
        """Compute the tool of a pair: rotation (3, 3) and tip (3,) [m]."""
        R, p = self._turned(arm, pairs.pose[k : k + 1], pairs.yaw[arm][k : k + 1])
        return R[0], p[0]

    def _turned(self, arm: str, pose: IntArray, yaw: IntArray) -> tuple[FloatArray, FloatArray]:
        """Compute tools turned about their axes: rotations (m, 3, 3) and tips (m, 3) [m]."""
        R, p = self._tools[arm]
        turn = rotation_z(np.asarray(yaw * (TURN / YAWS), dtype=np.float64))
        return product(R[pose], turn), p[pose]

    def _flange(
        self, arm: str, pose: IntArray, yaw: IntArray, back: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Compute flange poses of tools drawn back along their axes [m], in the carried frame."""
        R, p = self._turned(arm, pose, yaw)
        platform = self._home[self._model.platform_columns][None]
        return carried_flanges(self._model, arm, platform, R, p - back * R[..., 2])

    def _pairs(self) -> _Pairs:
        """Find clear pairs of postures whose tools are multiples of a quarter turn apart."""
        first, second = self._tools
        a = self._reached(first, np.arange(len(self._tools[first][0])))
        b = self._reached(second, np.unique(a.key // 2))
        _, i, j = np.intersect1d(a.key, b.key, assume_unique=True, return_indices=True)
        score = np.minimum(a.score[i], b.score[j]) / (1.0 + self._farness(a.key[i] // 2))
        order = np.lexsort((i, -score.round(9)))
        i, j = i[order], j[order]
        q = {first: a.q[i], second: b.q[j]}
        pairs = _Pairs(a.key[i] // 2, {first: a.yaw[i], second: b.yaw[j]}, q, score[order])
        return pairs.take(self._apart(q))

    def _farness(self, pose: IntArray) -> FloatArray:
        """Compute distances of both tools' middle from that at home, as fractions of the reach."""
        first, second = self._tools
        middle = 0.5 * (self._tools[first][1] + self._tools[second][1])[pose]
        return norm(middle - self._middle, axis=1) / float(self._here.reaches.max())

    def _reached(self, arm: str, poses: IntArray) -> _Reached:
        """Solve for an arm's best clear posture at each pose and parity of the turn."""
        pose, yaw = np.repeat(poses, YAWS), np.tile(np.arange(YAWS), len(poses))
        kinematics = self._model.arms[arm].kinematics
        reached = kinematics.postures(
            *self._flange(arm, pose, yaw), first_only=True, thorough=False
        )
        q, yaw = reached.q, yaw[reached.pose]
        key = 2 * pose[reached.pose] + yaw % 2
        score = self._scores(arm, q)
        best = np.lexsort((np.arange(len(q)), -score.round(9), key))
        ordered = key[best]
        best = best[np.arange(len(best)) - np.searchsorted(ordered, ordered) < FACING.kept]
        best = best[self._is_clear(arm, self._rows({arm: q[best]}))]
        best = best[np.unique(key[best], return_index=True)[1]]
        return _Reached(key[best], yaw[best], q[best], score[best])

    def _scores(self, arm: str, q: FloatArray) -> FloatArray:
        """Score postures from 0 to 1: manipulability and distance from limits, the smaller."""
        if not len(q):
            return np.zeros(0)
        values = manipulability(self._general[arm].jacobian(q))
        lower, upper = self._general[arm].lower, self._general[arm].upper
        bounded = np.isfinite(upper - lower)
        half = np.where(bounded, 0.5 * (upper - lower), 1.0)
        room = np.minimum(q - lower, upper - q) / half
        room = np.where(bounded, room, 1.0).min(axis=1)
        return np.asarray(np.minimum(values / max(float(values.max()), 1e-300), room))

    def _rows(self, q: Mapping[str, FloatArray]) -> FloatArray:
        """Assemble robot configurations from arms' joints, all others at home."""
        rows = np.tile(self._home, (len(next(iter(q.values()))), 1))
        for arm, values in q.items():
            rows[:, self._model.arms[arm].columns] = values
        return rows

    def _is_clear(self, arm: str, rows: FloatArray) -> BoolArray:
        """Check that an arm keeps its clearance from all but the other arm."""
        test = self._clearance.test
        return np.asarray(test.margins(test.arm_pairs(arm), rows) >= SLACK)

    def _apart(self, q: Mapping[str, FloatArray]) -> BoolArray:
        """Check that the arms keep their clearance from each other."""
        test = self._clearance.test
        return np.asarray(test.margins(test.cross(), self._rows(q)) >= SLACK)

    def _draw_back(self, pairs: _Pairs) -> BoolArray:
        """Check that either tool can draw back while the one that it faces stands still."""
        good = np.ones(len(pairs.pose), dtype=np.bool_)
        for arm, q in pairs.q.items():
            for length in np.linspace(0.0, FACING.line, FACING.samples + 1)[1:].tolist():
                R, p = self._flange(arm, pairs.pose, pairs.yaw[arm], length)
                moved, error = descend(self._general[arm], R, p, q)
                good &= (error <= INVERSE.residual).all(axis=1)
                good &= np.abs(moved - q).max(axis=1, initial=0.0) <= LARGEST_STEP
                q = moved
                good &= self._is_clear(arm, self._rows({arm: q}))
                good &= self._apart({**pairs.q, arm: q})
        return good


def _facing(
    here: Region, home: FloatArray, spacing: float, distance: float
) -> tuple[FloatArray, FloatArray]:
    """Choose poses of the first arm's tool: rotations (m, 3, 3) and tips (m, 3) [m].

    The tool points towards the other arm, level or sloped. Midpoints are on the side of the shoulders where the tools
    are at home. Tips are rounded to 1 mm.
    """
    R = _directions(here)
    low = np.floor((here.shoulders.min(axis=0) - here.reaches.max()) / spacing)
    high = np.ceil((here.shoulders.max(axis=0) + here.reaches.max()) / spacing)
    sides = [np.arange(a, b + 1) * spacing for a, b in zip(low, high, strict=True)]
    middle = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    centre = here.shoulders.mean(axis=0)
    side = product((middle - centre)[:, :2], (home - centre)[:2])
    middle = middle[side >= -np.square(FACING.behind * here.reaches.max())]
    R, middle = np.repeat(R, len(middle), axis=0), np.tile(middle, (len(R), 1))
    p = (middle - 0.5 * distance * R[..., 2]).round(3) + 0.0
    tips = np.stack([p, p + distance * R[..., 2]], axis=1)
    far = norm(tips - here.shoulders, axis=2) > FACING.stretch * here.reaches
    within = ~far.any(axis=1)
    return R[within], p[within]


def _directions(here: Region) -> FloatArray:
    """Choose directions of the first arm's tool: rotations (k, 3, 3), z along the tool."""
    heading = np.arange(FACING.headings) * (TURN / FACING.headings)
    towards = -np.array(here.across)
    cosine = cos(heading - arctan2(towards[1], towards[0]))
    if norm(towards) > 0.0:
        heading = heading[cosine >= FACING.towards]
    slope = np.repeat(np.array(FACING.slopes), len(heading))
    heading = np.tile(heading, len(FACING.slopes))
    c, s, zero = cos(slope), sin(slope), np.zeros(len(slope))
    # The x axis points to the side, so that a level tool has round angles.
    level = np.array([[zero, -s, c], [zero + 1.0, zero, zero], [zero, c, s]])
    return product(rotation_z(np.asarray(heading, dtype=np.float64)), np.moveaxis(level, -1, 0))
