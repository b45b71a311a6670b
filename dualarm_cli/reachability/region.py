"""Region of a cell's arms: extent, spacing and height of reach-map grids."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.kinematics.cell_model import CellModel, general_arms
from dualarm_cli.model.cell import Cell
from dualarm_cli.reachability.reach_map import ReachMap, reach_map
from dualarm_cli.reachability.table_grid import TableGrid
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class RegionSettings:
    """Settings of reach-map grids."""

    angle_step: float = np.radians(15.0)
    """Spacing of platform angles [rad]."""
    rail_positions: int = 9
    """Number of positions of a sliding platform."""
    steps: tuple[float, ...] = (0.01, 0.02, 0.025, 0.04, 0.05, 0.08, 0.1)
    """Allowed spacings of a grid [m]."""
    step_share: float = 0.08
    """Maximum spacing as a fraction of an arm's length."""
    below: float = 0.2
    """Least depth of easy heights below the shoulder, as a fraction of the reach."""
    easy_score: float = 0.3
    """Fraction of the best score above which easy heights are preferred."""
    equivalent_score: float = 0.9
    """Fraction of the best score from which a height is equivalent."""
    coarser: int = 2
    """Spacing factor of the grid on which heights are compared."""


REGION = RegionSettings()


@dataclass(frozen=True)
class Region:
    """Region of a cell within the arms' maximum reach."""

    centre: tuple[float, float]
    """Horizontal midpoint of the shoulders, or position of the platform's axis [m]."""
    across: tuple[float, float]
    """Horizontal vector from the last to the first arm's shoulder [m]; zero for a single arm."""
    radius: float
    """Radius of the reach about the centre without sliding joints [m]."""
    travel: float
    """Additional reach by sliding joints [m]."""
    low: float
    """Lowest height within reach: a shoulder's height less its arm's length [m]."""
    high: float
    """Height of the highest shoulder [m]."""
    easy: tuple[float, float]
    """Range of heights for easy work: the base's, and from there to below the shoulders [m]."""
    step: float
    """Grid spacing for the shortest arm [m]."""
    home: FloatArray
    """Platform positions at home [rad or m], shape (k,)."""
    shoulders: FloatArray
    """Shoulders of the a arms with the platform at home [m], shape (a, 3)."""
    reaches: FloatArray
    """Distances of tool centre points from the shoulders within reach [m], shape (a,)."""

    def is_easy(self, heights: FloatArray) -> BoolArray:
        """Select easy heights: mask of heights [m], shape (h,)."""
        return (heights >= self.easy[0] - 1e-9) & (heights <= self.easy[1] + 1e-9)

    def grid(
        self,
        platform: FloatArray,
        heights: FloatArray,
        step: float,
        tilt: float = 0.0,
        *,
        whole: bool = False,
    ) -> TableGrid:
        """Make a grid over the region, on multiples of its spacing.

        Args:
            platform: positions of the platform's joints, shape (a, k) [rad or m].
            heights: heights of the tool centre point [m], shape (h,).
            step: spacing [m].
            tilt: tilt of the tool [rad].
            whole: whether the reach of sliding joints is included.
        """
        radius = self.radius + (self.travel if whole else 0.0)
        sides = [
            np.arange(np.ceil((c - radius) / step), np.floor((c + radius) / step) + 1) * step
            for c in self.centre
        ]
        return TableGrid(platform, heights, sides[1], sides[0], tilt, self.centre)


def region(cell: Cell) -> Region:
    """Compute the region within the arms' maximum reach.

    Args:
        cell: the cell with its tools.
    """
    model = CellModel.from_cell(cell)
    home = cell.robot.postures["home"][model.platform_columns]
    R, p = model.platform.pose(home)
    shoulders, reaches, slides = [], [], [0.0]
    for name, arm in general_arms(cell).items():
        first, second = arm.p_parent_joint[:2]
        shoulders.append(p + product(R, first + product(arm.R_parent_joint[0], second)))
        reaches.append(arm.reach + float(norm(cell.tools[name].tcp.translation)))
        slides.append(arm.farthest - arm.reach)
    at, reach = np.array(shoulders), np.array(reaches)
    centre = at[:, :2].mean(axis=0)
    if model.platform.is_turntable:
        centre = p[:2]
    radius = float((norm(at[:, :2] - centre, axis=1) + reach).max())
    along = platform_positions(cell) - home if model.platform.is_rail else np.zeros(1)
    travel = float(np.abs(along).max()) + max(slides)
    max_step = REGION.step_share * float(reach.min())
    step = max((s for s in REGION.steps if s <= max_step + 1e-9), default=REGION.steps[0])
    base = float(cell.base.translation[2])
    return Region(
        (float(centre[0]), float(centre[1])),
        (float(at[0, 0] - at[-1, 0]), float(at[0, 1] - at[-1, 1])),
        radius,
        travel if np.isfinite(travel) else 0.0,
        float((at[:, 2] - reach).min()),
        float(at[:, 2].max()),
        (base, max(base + step, float((at[:, 2] - REGION.below * reach).max()))),
        step,
        home,
        at,
        reach,
    )


def platform_positions(cell: Cell) -> FloatArray:
    """Choose the platform positions of reach maps, shape (a, k) [rad or m].

    A full turn, the whole rail, or else the home position.

    Args:
        cell: the cell.
    """
    model = CellModel.from_cell(cell)
    home = cell.robot.postures["home"][model.platform_columns]
    if not model.platform.is_chosen:
        return home[None]
    limits = cell.robot.limits.select(model.platform.joints)
    low, high = float(limits.lower[0]), float(limits.upper[0])
    if model.platform.is_rail:
        count = REGION.rail_positions if np.isfinite(high - low) and high > low else 0
        return np.linspace(low, high, count)[:, None] if count else home[None]
    low, high = max(low, -np.pi), min(high, np.pi)
    first, last = np.ceil(low / REGION.angle_step - 1e-9), np.floor(high / REGION.angle_step + 1e-9)
    angles = np.arange(first, last + 1) * REGION.angle_step
    if high - low > TURN - 1e-9:
        angles = angles[1:]  # the same as the last one
    return angles[:, None] if len(angles) else home[None]


def heights_reached(
    cell: Cell, here: Region, line: float = 0.0, lift: float = 0.0
) -> tuple[FloatArray, ReachMap]:
    """Compute a coarse reach map over heights, with the platform at home.

    Args:
        cell: the cell with its tools.
        here: region of the cell.
        line: length by which the tool must be drawn back [m].
        lift: height of the tool centre point above the multiples of the spacing [m].

    Returns:
        Heights of the tool centre point [m], shape (h,), and the map.
    """
    step = REGION.coarser * here.step
    # Tables are on multiples of the spacing: that of the root's height is among them.
    heights = np.arange(np.ceil(here.low / step), np.floor(here.high / step) + 1) * step + lift
    return heights, reach_map(cell, here.grid(here.home[None], heights, step), line)


def best_height(cell: Cell, here: Region) -> float | None:
    """Choose the height with the largest reachable area [m], or None.

    The score counts the nodes of the arm that reaches fewer, and half of those that both arms reach. Heights below the
    robot's base or near the shoulders count only if other heights score low.

    Args:
        cell: the cell with its tools.
        here: region of the cell.
    """
    heights, reach = heights_reached(cell, here)
    by_arm = [reach.reached(arm).sum(axis=(0, 2, 3)) for arm in reach.postures]
    score = np.min(by_arm, axis=0) + 0.5 * reach.both.sum(axis=(0, 2, 3))
    easy = here.is_easy(heights)
    if score[easy].max(initial=0.0) > REGION.easy_score * score.max():
        score = np.where(easy, score, 0.0)
    # The middle one of nearly equal heights.
    best = heights[score >= REGION.equivalent_score * score.max()]
    return round(float(best[len(best) // 2]), 6) if score.max() > 0.0 else None
