"""Lines: profiles that keep every limit of every joint and pass through the path."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.line_profile import (
    ESTIMATE_SHAPES,
    distinct_operators,
    estimate_line_durations,
    estimate_operators,
    joint_line_durations,
)
from dualarm_cli.timing.problem import LineProblem
from dualarm_cli.timing.spline import largest_rates

JOINTS = ("s", "l", "e", "u", "r", "b", "t")


def distance_to_path(path, q):
    """Largest distance of joint vectors from the polyline of the path's samples [rad]."""
    a, b = path[:-1], path[1:]
    along = b - a
    t = ((q[:, None] - a) * along).sum(-1) / (along**2).sum(-1)
    nearest = a + np.clip(t, 0, 1)[..., None] * along
    return np.linalg.norm(q[:, None] - nearest, axis=-1).min(axis=1).max()


def test_lines_keep_all_limits_and_touch_one(limits, lines, assert_motion_is_consistent):
    """The time is scaled until the tightest limit is met exactly, and no other is broken."""
    for path in lines[0]:
        problem = LineProblem(JOINTS, path, lines[1], limits)
        trajectory = TIMING_SOLVERS["ruckig"].line(problem)
        assert_motion_is_consistent(trajectory, path[0], path[-1], limits)
        v, a, j = largest_rates(trajectory.time, trajectory.velocity, trajectory.acceleration)
        used = max(
            (v / limits.velocity).max(), (a / limits.acceleration).max(), (j / limits.jerk).max()
        )
        assert used == pytest.approx(1.0, abs=1e-9)


def test_lines_stay_on_the_path_and_more_knots_stay_closer(limits, lines):
    """The spline's distance from the path falls with the number of knots."""
    for path in lines[0]:
        fine = path[0] + (path - path[0])
        gaps = []
        for knots in (16, 64):
            problem = LineProblem(JOINTS, path, lines[1], limits, knots=knots)
            trajectory = TIMING_SOLVERS["ruckig"].line(problem)
            times = np.linspace(0, trajectory.duration, 500)
            gaps.append(distance_to_path(fine, trajectory.at(times)[0]))
        # The polyline itself leaves the smooth path by about h²/8 |q''| = (1/64)²/8 * 0.6 = 2e-5.
        assert gaps[1] < 5e-5
        assert gaps[1] <= gaps[0] + 5e-6


def test_a_straight_joint_path_takes_nearly_the_closed_form_time(limits):
    """One joint alone on a line: the profile is a double S; knots cost at most one per cent."""
    length = np.linspace(0.0, 0.08, 65)
    for distance in (0.05, 0.2, 0.5):
        path = np.zeros((65, 7))
        path[:, 2] = distance * length / 0.08
        trajectory = TIMING_SOLVERS["ruckig"].line(LineProblem(JOINTS, path, length, limits))
        law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
        least = float(law.duration(path[-1] - path[0]))
        assert least <= trajectory.duration <= 1.02 * least


def test_slower_limits_play_the_same_line_slower(limits, lines):
    """Limits scaled by k, k², k³ give 1/k of the speed."""
    path = lines[0][0]
    fast = TIMING_SOLVERS["ruckig"].line(LineProblem(JOINTS, path, lines[1], limits))
    slow = TIMING_SOLVERS["ruckig"].line(LineProblem(JOINTS, path, lines[1], limits.scaled(0.5)))
    assert slow.duration == pytest.approx(2 * fast.duration, rel=1e-9)


def test_toppra_is_at_most_a_hair_slower_than_the_profile_without_jerk(
    without_jerk, lines, assert_motion_is_consistent
):
    """Time-optimal along the path under the same limits; both keep them."""
    for path in lines[0][:3]:
        problem = LineProblem(JOINTS, path, lines[1], without_jerk)
        ours = TIMING_SOLVERS["ruckig"].line(problem)
        optimal = TIMING_SOLVERS["toppra"].line(problem)
        assert optimal.duration <= ours.duration * 1.01
        # Ours has jerk phases as short as it likes, but one double S along the whole path.
        assert ours.duration <= optimal.duration * 1.1
        assert_motion_is_consistent(optimal, path[0], path[-1], without_jerk)


@pytest.mark.parametrize("name", ["ruckig", "toppra"])
def test_a_cap_on_the_path_speed_holds(without_jerk, name):
    """On a joint path proportional to length, the path speed is the joint speed times 0.08/0.5."""
    length = np.linspace(0.0, 0.08, 65)
    path = np.zeros((65, 7))
    path[:, 1] = 0.5 * length / 0.08
    free = TIMING_SOLVERS[name].line(LineProblem(JOINTS, path, length, without_jerk))
    cap = 0.6 * np.abs(free.velocity[:, 1]).max() * 0.08 / 0.5
    capped = TIMING_SOLVERS[name].line(LineProblem(JOINTS, path, length, without_jerk, cap))
    assert np.abs(capped.velocity[:, 1]).max() * 0.08 / 0.5 <= cap * (1 + 1e-6)
    assert capped.duration > free.duration


def test_the_estimate_is_near_the_solved_line(limits, lines):
    """Within a fifth, for many lines at once, and independent of their company."""
    seven = np.stack([path[np.linspace(0, 64, 7).astype(int)] for path in lines[0]])
    share = np.linspace(0, 0.08, 7)
    # 64 / 6 is no whole number: take the samples by interpolation instead.
    grid = np.linspace(0, 64, 7)
    seven = np.stack(
        [
            np.column_stack([np.interp(grid, np.arange(65), p[:, k]) for k in range(7)])
            for p in lines[0]
        ]
    )
    together = estimate_line_durations(seven, share, limits)
    alone = [float(estimate_line_durations(one[None], share, limits)[0]) for one in seven]
    assert np.allclose(together, alone, rtol=1e-12)
    for path, estimate in zip(lines[0], together, strict=True):
        solved = TIMING_SOLVERS["ruckig"].line(LineProblem(JOINTS, path, lines[1], limits)).duration
        assert 0.8 < solved / estimate < 1.2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"position": np.zeros((5, 7)), "length": np.linspace(0, 1, 5)}, "8 gridpoints or more"),
        ({"length": np.linspace(0, 1, 65) ** 2}, "equal steps"),
        ({"position": np.full((65, 7), np.nan)}, "not finite"),
    ],
)
def test_lines_that_cannot_be_timed_are_refused(limits, change, words):
    """The noun's constructor says why."""
    fields = {"joints": JOINTS, "position": np.zeros((65, 7)), "length": np.linspace(0, 1, 65)}
    with pytest.raises(ValueError, match=words):
        LineProblem(**(fields | {"limits": limits} | change))


@pytest.mark.parametrize("name", ["ruckig", "toppra"])
def test_a_cap_on_the_path_speed_holds_on_a_curved_path(without_jerk, name, lines):
    """The joint path is parametrised by length: |dq/dt| / |dq/ds| is the path's speed."""
    path, length = lines[0][1], lines[1]
    cap = (
        0.5
        * 0.08
        / TIMING_SOLVERS[name].line(LineProblem(JOINTS, path, length, without_jerk)).duration
    )
    trajectory = TIMING_SOLVERS[name].line(LineProblem(JOINTS, path, length, without_jerk, cap))
    times = np.linspace(0, trajectory.duration, 400)[20:-20]
    q, v, _ = trajectory.at(times)
    slope = np.gradient(path, length, axis=0, edge_order=2)
    nearest = np.argmin(((q[:, None] - path) ** 2).sum(-1), axis=1)
    speed = np.linalg.norm(v, axis=1) / np.linalg.norm(slope[nearest], axis=1)
    # The nearest gridpoint is up to 1/128 of the way off, where the slope differs by about 1 %.
    assert speed.max() == pytest.approx(cap, rel=0.015)
    # Half the average speed as cap: mostly cruising, so little more than length/cap.
    assert 0.08 / cap < trajectory.duration < 1.15 * 0.08 / cap


@pytest.mark.parametrize("name", ["ruckig", "toppra"])
def test_a_line_on_which_no_joint_moves_takes_no_time(without_jerk, name):
    """Nothing limits it, unless the tool's speed is capped: then length/cap at least."""
    path, length = np.full((65, 7), 0.1), np.linspace(0, 0.08, 65)
    still = TIMING_SOLVERS[name].line(LineProblem(JOINTS, path, length, without_jerk))
    assert still.duration == 0.0
    assert np.array_equal(still.position[-1], path[0])
    capped = TIMING_SOLVERS[name].line(LineProblem(JOINTS, path, length, without_jerk, 0.1))
    assert 0.8 <= capped.duration < 0.85


def test_a_lone_joint_on_a_curved_path_takes_the_closed_form_time(limits):
    """Only its own angle matters, not how it depends on the length: within 2 % of the double S."""
    share = np.linspace(0, 1, 65)
    path = np.zeros((65, 7))
    path[:, 2] = 0.2 * (share + 0.5 * share**2)
    length = 0.08 * share
    found = TIMING_SOLVERS["ruckig"].line(LineProblem(JOINTS, path, length, limits)).duration
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    least = float(law.duration(path[-1] - path[0]))
    assert least * (1 - 1e-9) <= found <= 1.02 * least


def test_the_same_line_gives_the_same_bytes(limits, lines):
    """No randomness, no state."""
    problem = LineProblem(JOINTS, lines[0][2], lines[1], limits)
    one, two = (TIMING_SOLVERS["ruckig"].line(problem) for _ in range(2))
    assert one.position.tobytes() == two.position.tobytes()
    assert one.time.tobytes() == two.time.tobytes()


def test_the_estimate_is_the_largest_of_what_each_joint_asks_for(limits, lines):
    """Distinct instants alone give the same as all of them, for more lines than one block holds."""
    grid = np.linspace(0, 64, 7)
    seven = np.stack(
        [
            np.column_stack([np.interp(grid, np.arange(65), p[:, k]) for k in range(7)])
            for p in lines[0]
        ]
    )
    many = np.concatenate([seven * scale for scale in np.linspace(0.2, 1.0, 40)])
    share = np.linspace(0.0, 1.0, 7)
    every = joint_line_durations(many, limits).max(axis=1)
    assert np.allclose(estimate_line_durations(many, share, limits), every, rtol=1e-12)
    operators = estimate_operators(7)
    for operator, (distinct, first) in zip(operators, distinct_operators(7), strict=True):
        assert len(distinct) < len(operator)
        assert len(first) == len(ESTIMATE_SHAPES.start)
