"""Tool targets: the path to the letter, but for short mean values where its curvature jumps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.path.context import PATH, PathClock, tool_targets
from dualarm_cli.model.curves.tool_path import Line, ToolPath, Turn
from dualarm_cli.model.process_work import PathWork

TOLERANCE = 1e-4
RADIUS, SPEED = 0.05, 0.2


def pose(x, y):
    """A pose in the plane."""
    return pin.SE3(np.eye(3), np.array([x, y, 0.0]))


def line(*points):
    """Lines through points."""
    poses = [pose(*point) for point in points]
    return tuple(Line(a, b) for a, b in pairwise(poses))


def hook(angle=np.pi / 2):
    """0.2 m along x, then on a circle of radius 50 mm without a corner, the tool keeping its rotation."""
    circle = Turn(
        pose(0.2, 0), np.array([0.2, RADIUS, 0.0]), np.array([0.0, 0.0, 1.0]), angle, np.zeros(3)
    )
    return ToolPath((*line((0, 0), (0.2, 0)), circle))


def targets(path, tolerance=TOLERANCE):
    """Targets, the path itself at the same instants, the instants' step, and the shares."""
    clock = PathClock.of(PathWork({"left": path}, SPEED, tolerance=tolerance))
    count = int(np.ceil(clock.duration / 1e-3))
    step = clock.duration / count
    share = clock.at(np.arange(count + 1) * step)[0]
    R, p = tool_targets(path, share, step, tolerance)
    return R, p, path.at(share * path.length), step, share


def jumps(p, step):
    """Changes of the acceleration from one instant to the next."""
    return np.linalg.norm(np.diff(np.diff(p, 2, axis=0) / step**2, axis=0), axis=1)


@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5])
def test_rounding_stays_within_its_share_of_the_tolerance(tolerance):
    """By hand: beside the line |y| where x < 0.2, off the circle | |p - centre| - r | behind it."""
    _, p, (_, exact), _, _ = targets(hook(), tolerance)
    centre = np.array([0.2, RADIUS, 0.0])
    off_circle = np.abs(np.linalg.norm(p - centre, axis=1) - RADIUS)
    off = np.where(p[:, 0] < 0.2, np.minimum(np.abs(p[:, 1]), off_circle), off_circle)
    assert off.max() <= PATH.rounded * tolerance * 1.01
    assert np.linalg.norm(p - exact, axis=1).max() <= PATH.rounded * tolerance * 1.01
    # It does round: on the circle the mean is a W² / 24 inside, which is what chooses W (up to 0.15 s).
    assert off.max() > 0.3 * PATH.rounded * tolerance


def test_start_and_end_are_exact():
    """Both poses to the last bit, and all of the path far from the junction."""
    R, p, (R_exact, exact), _, share = targets(hook())
    for k in (0, -1):
        assert p[k].tolist() == exact[k].tolist()
        assert R[k].tolist() == R_exact[k].tolist()
    far = np.abs(share * hook().length - 0.2) > 0.04
    assert p[far].tolist() == exact[far].tolist()


def test_the_acceleration_no_longer_jumps():
    """It would by v²/r = 0.8 m/s² within an instant.

    The mean spreads it over W = (24 tolerance/4 r / v²)^(1/2) = 27 ms, some 27 instants: 0.03 m/s² each.
    """
    _, p, (_, exact), step, _ = targets(hook())
    assert jumps(exact, step).max() > 0.39  # half of it between two instants at least
    window = np.sqrt(24.0 * PATH.rounded * TOLERANCE / (SPEED**2 / RADIUS))
    assert jumps(p, step).max() < 2.0 * (SPEED**2 / RADIUS) * step / window


def test_a_path_without_junctions_is_untouched():
    """One line, one circle: bit by bit."""
    circle = ToolPath((hook().pieces[1],))
    for path in (ToolPath(line((0, 0), (0.3, 0))), circle):
        R, p, (R_exact, exact), _, _ = targets(path)
        assert p.tolist() == exact.tolist()
        assert R.tolist() == R_exact.tolist()


def test_junctions_without_a_jump_and_corners_are_untouched():
    """A line that goes on as a line; a right angle, where the tool stands still."""
    for points in (((0, 0), (0.1, 0), (0.3, 0)), ((0, 0), (0.2, 0), (0.2, 0.2))):
        _, p, (_, exact), _, _ = targets(ToolPath(line(*points)))
        assert p.tolist() == exact.tolist()


def test_both_junctions_of_an_arc_between_lines_are_rounded():
    """Line, quarter circle, line; also where a circle of the other hand follows (twice the jump)."""
    end = hook().pose(hook().length).translation
    there = ToolPath((*hook().pieces, *line(end[:2], end[:2] + np.array([0.0, 0.2]))))
    _, p, (_, exact), step, _ = targets(there)
    assert there.corners == ()
    limit = 2.0 * (SPEED**2 / RADIUS) * step / 0.0273
    assert jumps(p, step).max() < limit
    assert np.linalg.norm(p - exact, axis=1).max() <= PATH.rounded * TOLERANCE * 1.01
    back = Turn(
        pin.SE3(np.eye(3), end), np.array([end[0] + RADIUS, end[1], 0.0]),
        np.array([0.0, 0.0, -1.0]), 1.0, np.zeros(3),
    )  # fmt: skip
    wave = ToolPath((*hook().pieces, back))
    _, p, (_, exact), step, _ = targets(wave)
    assert wave.corners == ()
    assert jumps(exact, step).max() > 0.79
    assert jumps(p, step).max() < 2.0 * limit
    assert np.linalg.norm(p - exact, axis=1).max() <= PATH.rounded * TOLERANCE * 1.01


def turning_hook(length, rate):
    """A line of that length and a quarter circle on which the tool turns about z, evenly along its way."""
    R = pin.utils.rotate("z", length * rate)
    first = Line(pose(0, 0), pin.SE3(R, np.array([length, 0, 0])))
    axis, angle = np.array([0.0, 0.0, 1.0]), np.pi / 2
    second = Turn(
        first.end, np.array([length, RADIUS, 0.0]), axis, angle, rate * RADIUS * angle * axis
    )
    return ToolPath((first, second))


def test_rotations_stay_with_their_places():
    """2 rad/m at constant speed: the mean of an angle that grows evenly is the angle in the middle."""
    path = turning_hook(0.2, 2.0)
    assert path.corners == ()
    R, _, _, _, share = targets(path)
    heading = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    assert heading == pytest.approx(2.0 * share * path.length, abs=1e-4)
    assert np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max() < 1e-14


def test_rotations_are_rounded_like_positions():
    """Where the tool speeds up the mean is ahead of it: by the same share of its turn as of its way."""
    # Full speed is reached after 0.2 m/s x 0.3 s / 2 = 30 mm only; the junction is at 20 mm.
    path = turning_hook(0.02, 2.0)
    R, p, (_, exact), _, _ = targets(path)
    on_line = p[:, 0] < 0.015
    assert np.linalg.norm(p - exact, axis=1)[on_line].max() > 1e-6
    heading = np.arctan2(R[:, 1, 0], R[:, 0, 0])
    assert heading[on_line] == pytest.approx(2.0 * p[on_line, 0], abs=1e-12)
