"""Grid of a reach map: width, spacing, and height above the ground."""

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
    """Resolution of the region that arms reach."""

    angle_step: float = np.radians(15.0)
    """Spacing of platform angles [rad]."""
    rail_positions: int = 9
    """Positions of a platform that slides."""
    steps: tuple[float, ...] = (0.01, 0.02, 0.025, 0.04, 0.05, 0.08, 0.1)
    """Spacings that a grid may have [m]."""
    step_share: float = 0.08
    """Spacing as a share of an arm's length."""
    below: float = 0.2
    """Least depth of easy heights below the shoulder, as a share of the reach."""
    some: float = 0.3
    """Share of the best score above which only easy heights count. If no easy height exceeds it, all heights count."""
    nearly: float = 0.9
    """Share of the best score from which a height counts as equivalent."""
    coarser: int = 2
    """By how many spacings the grid is coarser on which heights are compared."""


REGION = RegionSettings()


@dataclass(frozen=True)
class Region:
    """What a cell's arms can reach at all."""

    centre: tuple[float, float]
    """Middle of the arms' shoulders, or the axis of the platform [m]."""
    across: tuple[float, float]
    """From the last arm's shoulder to the first one's [m]; zero for one arm."""
    radius: float
    """Nothing farther from there is reached while nothing slides [m]."""
    travel: float
    """How much farther sliding joints get [m]."""
    low: float
    """Height of the lowest shoulder less its arm's length [m]."""
    high: float
    """Height of the highest shoulder [m]."""
    easy: tuple[float, float]
    """Heights between the robot's root and where arms still bend well over a table [m]."""
    step: float
    """Spacing that suits the shortest arm [m]."""
    home: FloatArray
    """The platform's positions at home, shape (k,) [rad or m]."""

    def is_easy(self, heights: FloatArray) -> BoolArray:
        """Returns which heights (h,) [m] are between the robot's root and well below the shoulders."""
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
        """Returns a grid over what may be reached, on multiples of its spacing.

        Args:
            platform: positions of the platform's joints, shape (a, k) [rad or m].
            heights: shape (h,) [m].
            step: spacing [m].
            tilt: how far the tool leans [rad].
            whole: whether it is as wide as sliding joints get.
        """
        radius = self.radius + (self.travel if whole else 0.0)
        sides = [
            np.arange(np.ceil((c - radius) / step), np.floor((c + radius) / step) + 1) * step
            for c in self.centre
        ]
        return TableGrid(platform, heights, sides[1], sides[0], tilt, self.centre)


def region(cell: Cell) -> Region:
    """Returns what a cell's arms can reach at all.

    Args:
        cell: with its tools.
    """
    model = CellModel.from_cell(cell)
    home = cell.robot.postures["home"][model.platform_columns]
    R, p = model.platform.pose(home)
    shoulders, reaches, slides = [], [], [0.0]
    for name, arm in general_arms(cell).items():
        first, second = arm.p_parent_joint[:2]
        shoulders.append(p + product(R, first + product(arm.R_parent_joint[0], second)))
        reaches.append(arm.length + float(norm(cell.tools[name].tcp.translation)))
        slides.append(arm.farthest - arm.length)
    at, reach = np.array(shoulders), np.array(reaches)
    centre = at[:, :2].mean(axis=0)
    if model.platform.is_turntable:
        centre = p[:2]
    radius = float((norm(at[:, :2] - centre, axis=1) + reach).max())
    along = platform_positions(cell) - home if model.platform.is_rail else np.zeros(1)
    travel = float(np.abs(along).max()) + max(slides)
    wanted = REGION.step_share * float(reach.min())
    step = max((s for s in REGION.steps if s <= wanted + 1e-9), default=REGION.steps[0])
    return Region(
        (float(centre[0]), float(centre[1])),
        (float(at[0, 0] - at[-1, 0]), float(at[0, 1] - at[-1, 1])),
        radius,
        travel if np.isfinite(travel) else 0.0,
        float((at[:, 2] - reach).min()),
        float(at[:, 2].max()),
        (float(cell.base.translation[2]), float((at[:, 2] - REGION.below * reach).max())),
        step,
        home,
    )


def platform_positions(cell: Cell) -> FloatArray:
    """Returns platform positions at which reach is compared, shape (a, k): all round, all along a rail, else home.

    Args:
        cell: whose platform it is.
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


def heights_reached(cell: Cell, here: Region, line: float = 0.0) -> tuple[FloatArray, ReachMap]:
    """Returns heights of the tool centre point, shape (h,) [m], and what is reached there from home on a coarse grid.

    Args:
        cell: with its tools.
        here: its region.
        line: how far the tool must be able to be drawn back [m].
    """
    step = REGION.coarser * here.step
    heights = np.arange(np.ceil(here.low / step), np.floor(here.high / step) + 1) * step
    return heights, reach_map(cell, here.grid(here.home[None], heights, step), line)


def best_height(cell: Cell, here: Region) -> float | None:
    """Returns the height of the tool centre point at which most of a table is reached [m]; None where nothing is.

    Most by the arm that reaches less, then by both at one place. Heights below the robot's root or near the shoulders
    count only where little is reached at others.

    Args:
        cell: with its tools.
        here: its region.
    """
    heights, reach = heights_reached(cell, here)
    by_arm = [reach.reached(arm).sum(axis=(0, 2, 3)) for arm in reach.postures]
    score = np.min(by_arm, axis=0) + 0.5 * reach.both.sum(axis=(0, 2, 3))
    easy = here.is_easy(heights)
    if score[easy].max(initial=0.0) > REGION.some * score.max():
        score = np.where(easy, score, 0.0)
    # Among heights that are about as good as the best one, the middle one.
    good = heights[score >= REGION.nearly * score.max()]
    return round(float(good[len(good) // 2]), 6) if score.max() > 0.0 else None
