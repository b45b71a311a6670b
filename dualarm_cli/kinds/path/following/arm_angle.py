"""Path following by the arm angle at a fixed platform.

The posture path is that of least joint motion.
"""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.geometry.elementary import TURN
from dualarm_cli.geometry.products import product
from dualarm_cli.kinds.path.following.position_limits import ended_by_limit
from dualarm_cli.kinds.path.following.problem import NoPath, PathMotion, PathProblem, within_limits
from dualarm_cli.kinematics.cell_model import ArmModel, CellModel
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal


@dataclass(frozen=True)
class TrackSettings:
    """Resolution of the search for arm angles along a path."""

    stations: int = 61
    """Places along the path at which arm angles are compared."""
    cells: int = 72
    """Number of arm angles that are compared."""
    reach: int = 5
    """Largest change of the arm angle between neighbouring stations, in grid cells."""
    branches: int = 8
    """Number of branches of the inverse kinematics."""
    rounds: int = 30
    """Maximum number of rounds that refine the angles."""
    enough: float = 1e-6
    """Relative gain of one round that ends the refinement."""
    delta: float = 1e-5
    """Step of the derivatives by the arm angle [rad]."""
    farthest: float = 1.0
    """Largest joint difference between two stations that is no jump [rad]."""
    kept_free: float = np.deg2rad(0.5)
    """Margin to the joints' limits where angles are compared [rad]."""


TRACK = TrackSettings()


@dataclass(frozen=True)
class Track:
    """Arm angles of one branch along a path."""

    branch: int
    """Branch of the inverse kinematics."""
    psi: FloatArray
    """Arm angles at the stations, continuous [rad], shape (m,)."""
    cost: float
    """Sum of squared joint motions over speed limits, per fraction [s²].

    The fraction is that of the path.
    """


def follow_arm_angle(problem: PathProblem) -> PathMotion | NoPath:
    """Follow by arm angles of least joint motion at a fixed platform.

    Dynamic programming over arm angles, then refinement.

    The cost is the sum of squared joint motions over the speed limits, over a grid of arm angles and all branches.
    Levenberg-Marquardt steps then refine the angles off the grid. The tools are exact: inverse kinematics in closed
    form at every instant. Our own; closed form [Shimizu2008].
    """
    model = problem.model
    if model is None:
        return NoPath(Refusal("no_closed_forms"), 0)
    from scipy.interpolate import CubicSpline

    position = np.tile(problem.start, (problem.instants, 1))
    stations = np.linspace(0.0, 1.0, TRACK.stations)
    at = np.interp(stations, problem.share, np.arange(problem.instants))
    for b, a in enumerate(np.flatnonzero(problem.follows)):
        name = problem.body.arms[a]
        arm = model.arms[name]
        kinematics = arm.closed_form
        R, p = flange_poses(model, arm, problem.start, problem.R[:, b], problem.p[:, b])
        nearest = np.round(at).astype(np.int64)
        share = problem.share[nearest]
        velocity = problem.limits.velocity[arm.columns]
        q0 = problem.start[arm.columns]
        track = best_track(kinematics, R[nearest], p[nearest], velocity, q0)
        if track is None:
            return _reason(problem, model, name, (R, p))
        rising = np.concatenate([[True], np.diff(share) > 0.0])
        psi = CubicSpline(share[rising], track.psi[rising])(problem.share)
        q, _ = kinematics.solve_branch(R, p, psi, np.array(track.branch))
        position[:, arm.columns] = kinematics.nearest_turns(q, q0)
    return within_limits(problem, position)


def flange_poses(
    model: CellModel, arm: ArmModel, position: FloatArray, R: FloatArray, p: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Convert tool poses in the world to flange poses in the carried frame.

    Rotations have shape (..., 3, 3), positions (..., 3) [m].

    Args:
        model: the cell.
        arm: arm of the tool.
        position: all joints; those of the platform count [rad], shape (n,).
        R: rotations of the tool, shape (..., 3, 3).
        p: tool centre points [m], shape (..., 3).
    """
    R_world, p_world = model.carried_frame(position)
    T = arm.T_flange_tcp.inverse()
    inside = product(p - p_world, R_world)
    turned = product(R_world.T, R)
    return product(turned, T.rotation), inside + product(turned, T.translation)


def best_track(
    arm: SrsArm,
    R: FloatArray,
    p: FloatArray,
    velocity: FloatArray,
    start: FloatArray | None = None,
) -> Track | None:
    """Compute the arm angles of least joint motion along a path.

    None without a branch.

    Args:
        arm: the arm.
        R: flange rotations at m stations, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3).
        velocity: speed limits of the joints [rad/s], shape (7,).
        start: joints at the first station [rad], shape (7,); None where they are free.
    """
    tracks = _grid_tracks(arm, R, p, velocity, start)
    if not tracks:
        return None
    return _refined(arm, R, p, velocity, tracks[0], fixed=start is not None)


def coarse_tracks(arm: SrsArm, R: FloatArray, p: FloatArray, velocity: FloatArray) -> list[Track]:
    """Compute the grid's arm angles of least joint motion, by branch.

    Branches that follow are sorted, best first.

    Args:
        arm: the arm.
        R: flange rotations at m stations, shape (m, 3, 3).
        p: flange positions [m], shape (m, 3).
        velocity: speed limits of the joints [rad/s], shape (7,).
    """
    return _grid_tracks(arm, R, p, velocity, None)


def _grid_tracks(
    arm: SrsArm, R: FloatArray, p: FloatArray, velocity: FloatArray, start: FloatArray | None
) -> list[Track]:
    """Compute each branch's best track on the grid of arm angles.

    The best track comes first.
    """
    grid: FloatArray = np.arange(TRACK.cells, dtype=np.float64) * (TURN / TRACK.cells)
    if start is not None:
        # The grid begins at the given arm angle.
        grid = grid + float(arm.arm_angle(start))
    solved = arm.solve(R[:, None], p[:, None], grid)
    q = solved.q
    inside = (q >= arm.lower + TRACK.kept_free) & (q <= arm.upper - TRACK.kept_free)
    allowed = inside.all(axis=-1) & solved.reachable[..., None]
    if start is not None:
        allowed[0] = False
        allowed[0, 0, int(arm.branch(start))] = True
        q[0, 0, int(arm.branch(start))] = start
    return [
        Track(branch, np.unwrap(grid[cells]), value * (len(R) - 1))
        for cells, branch, value in _cheapest_tracks(q / velocity, q, allowed)
    ]


def _cheapest_tracks(
    scaled: FloatArray, q: FloatArray, allowed: BoolArray
) -> list[tuple[IntArray, int, float]]:
    """Compute each branch's cheapest path through all stations.

    The best comes first; branches without one are left out.

    A result has the cells (m,), the branch and the sum of squares.

    Args:
        scaled: joints over speed limits [s], shape (m, cells, branches, 7).
        q: joints [rad], the same shape.
        allowed: allowed postures, shape (m, cells, branches).
    """
    # A branch without a posture at some station has no track. Joints come first: sums over a short last axis are slow.
    whole = np.flatnonzero(allowed.any(axis=1).all(axis=0))
    allowed = allowed[:, :, whole]
    scaled, q = (
        np.ascontiguousarray(np.moveaxis(joints[:, :, whole], -1, 1)) for joints in (scaled, q)
    )
    m, cells, branches = allowed.shape
    value = np.where(allowed[0], 0.0, np.inf)
    shifts = np.arange(-TRACK.reach, TRACK.reach + 1)
    back = np.zeros((m, cells, branches), dtype=np.int64)
    for k in range(1, m):
        # From cell c + shift at the station before to cell c here.
        source = (np.arange(cells)[:, None] + shifts) % cells
        moved = scaled[k][:, :, None] - scaled[k - 1][:, source]
        cost = (moved * moved).sum(axis=0) + value[source]
        cost[np.abs(q[k][:, :, None] - q[k - 1][:, source]).max(axis=0) > TRACK.farthest] = np.inf
        best = cost.argmin(axis=1)
        back[k] = np.take_along_axis(source[..., None], best[:, None], axis=1)[:, 0]
        value = np.where(allowed[k], np.take_along_axis(cost, best[:, None], axis=1)[:, 0], np.inf)
    tracks = []
    for branch in range(branches):
        cell = int(np.argmin(value[:, branch]))
        least = float(value[cell, branch])
        if not np.isfinite(least):
            continue
        track = np.empty(m, dtype=np.int64)
        for k in range(m - 1, -1, -1):
            track[k] = cell
            cell = int(back[k, cell, branch])
        tracks.append((track, int(whole[branch]), least))
    return sorted(tracks, key=lambda candidate: candidate[2])


def _refined(
    arm: SrsArm,
    R: FloatArray,
    p: FloatArray,
    velocity: FloatArray,
    track: Track,
    *,
    fixed: bool,
) -> Track:
    """Refine a track's angles off the grid by Levenberg-Marquardt steps.

    The cost between neighbours (i, i+1) is |(q_i+1 - q_i) / v|², so that the normal equations are tridiagonal.
    """
    from scipy.linalg import solveh_banded

    def joints(angles: FloatArray) -> FloatArray:
        return arm.solve_branch(R, p, angles, np.array(track.branch))[0]

    def cost_of(q: FloatArray) -> float:
        inside = (
            (q >= arm.lower + TRACK.kept_free / 2) & (q <= arm.upper - TRACK.kept_free / 2)
        ).all()
        jumps = np.abs(np.diff(q, axis=0)).max() > TRACK.farthest
        return (
            float(np.square(np.diff(q / velocity, axis=0)).sum())
            if inside and not jumps
            else np.inf
        )

    psi = track.psi
    q = joints(psi)
    cost, damping = cost_of(q), 1e-6
    for _ in range(TRACK.rounds):
        slope = (
            (joints(psi + TRACK.delta) - joints(psi - TRACK.delta)) / (2.0 * TRACK.delta) / velocity
        )
        residuals = np.diff(q / velocity, axis=0)
        squares = (slope * slope).sum(axis=1)
        bands = np.zeros((2, len(psi)))
        bands[1] = 2.0 * squares
        bands[1, [0, -1]] -= squares[[0, -1]]
        bands[1] += damping * squares.max()
        bands[0, 1:] = -(slope[:-1] * slope[1:]).sum(axis=1)
        pull = np.zeros(len(psi))
        pull[:-1] += (slope[:-1] * residuals).sum(axis=1)
        pull[1:] -= (slope[1:] * residuals).sum(axis=1)
        if fixed:
            bands[1, 0], bands[0, 1], pull[0] = 1.0, 0.0, 0.0
        candidate = psi + solveh_banded(bands, pull)
        moved = joints(candidate)
        lower = cost_of(moved)
        if lower < cost:
            gained = cost - lower
            psi, q, cost, damping = candidate, moved, lower, damping / 10.0
            if gained < TRACK.enough * cost:
                break
        else:
            damping *= 30.0
    # The sum of squared differences times the number of intervals does not depend on that number.
    return Track(track.branch, psi, cost * (len(psi) - 1))


def _reason(
    problem: PathProblem, model: CellModel, name: str, flanges: tuple[FloatArray, FloatArray]
) -> NoPath:
    """Explain why no branch of an arm follows a path."""
    miss = model.arms[name].closed_form.reach_miss(*flanges)
    if miss.max() > 0.0:
        k = int(np.argmax(miss > 0.0))
        data = {"mm": miss.max() * 1e3}
        return NoPath(Refusal("wrist_misses", arm=name, data=data), k)
    moves = problem.free.copy()
    moves[model.platform_columns] = False
    if ended := ended_by_limit(problem, moves):
        reason = Refusal("platform_stands", data={"cause": ended.reason})
        return NoPath(reason, ended.instant)
    return NoPath(Refusal("no_branch", arm=name), 0)
