"""Exact platform angles on masses of random moves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.platform_angle import PLATFORM_SOLVERS, Kind, PlatformProblem
from dualarm_cli.platform_angle.problem import elbow_cosine

SCAN = 2048
SOLVE = PLATFORM_SOLVERS["exact"].solve


def random_moves(count, seed):
    """Moves of arms of any shape; a fifth starts with equal elbows, some are degenerate."""
    rng = np.random.default_rng(seed)
    height = rng.uniform(-0.3, 0.3, (count, 2))
    distance, azimuth = rng.uniform(0, 0.8, (count, 2)), rng.uniform(-np.pi, np.pi, (count, 2))
    wrist = np.stack(
        [
            distance * np.cos(azimuth),
            distance * np.sin(azimuth),
            height + rng.uniform(-0.2, 0.2, (count, 2)),
        ],
        axis=-1,
    )
    elbow_0 = rng.uniform(0.3, 2.9, (count, 2))
    equal = rng.random(count) < 0.2
    elbow_0[equal, 1] = elbow_0[equal, 0]
    radius = rng.uniform(0, 0.4, (count, 2))
    radius[rng.random(count) < 0.02] = 0.0
    wrist[rng.random(count) < 0.02, 0, :2] = 0.0
    return PlatformProblem(
        radius,
        rng.uniform(-np.pi, np.pi, (count, 2)),
        height,
        rng.uniform(0.1, 0.5, (count, 2)),
        rng.uniform(0.1, 0.5, (count, 2)),
        wrist,
        rng.uniform(-2, 2, count),
        elbow_0,
    )


def elbow_differences(problem, angle, sign):
    """q4_1 - s q4_2 - K at platform angles (n, k), and where both arms reach."""
    x = elbow_cosine(problem, angle)
    q = np.arccos(np.clip(x, -1, 1)) - problem.elbow_0[:, None]
    return q[..., 0] - sign * q[..., 1], (np.abs(x) <= 1.0).all(axis=-1)


def missed_and_found(problem):
    """How many sign changes of a dense scan have no root in their interval, and how many there are."""
    solution = SOLVE(problem)
    grid = np.linspace(-np.pi, np.pi, SCAN, endpoint=False)
    step = grid[1] - grid[0]
    missed = found = 0
    for sign, kind in ((1.0, Kind.ROOT_SAME), (-1.0, Kind.ROOT_OPPOSITE)):
        g, reach = elbow_differences(
            problem, np.broadcast_to(grid, (len(problem.angle_0), SCAN)), sign
        )
        change = reach & np.roll(reach, -1, axis=1) & (g * np.roll(g, -1, axis=1) < 0)
        row, column = np.nonzero(change)
        ahead = np.mod(solution.angle[row] - grid[column, None] + 1e-9, 2 * np.pi)
        hit = (ahead <= step + 2e-9) & solution.valid[row] & (solution.kind[row] == kind)
        missed += int((~hit.any(axis=1)).sum())
        found += len(row)
    return missed, found, solution


def assert_every_root_is_true(problem, solution):
    """No candidate that calls itself a root leaves a difference of a nanoradian."""
    for sign, kind in ((1.0, Kind.ROOT_SAME), (-1.0, Kind.ROOT_OPPOSITE)):
        g, _ = elbow_differences(problem, solution.angle, sign)
        root = solution.valid & solution.reachable & (solution.kind == kind)
        assert np.abs(g[root]).max() < 1e-9


@pytest.mark.parametrize("seed", range(3))
def test_every_root_that_a_dense_scan_sees_is_found_and_no_false_one(seed):
    """1,000 moves against 2,048 samples of the unsquared equation."""
    problem = random_moves(1_000, seed)
    missed, found, solution = missed_and_found(problem)
    assert found > 800
    assert missed == 0
    assert_every_root_is_true(problem, solution)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 200))
def test_every_root_of_a_hundred_thousand_moves_is_found(seed):
    """The same on 100 times 1,000 moves."""
    problem = random_moves(1_000, seed)
    missed, _, solution = missed_and_found(problem)
    assert missed == 0
    assert_every_root_is_true(problem, solution)


def test_turning_everything_turns_the_roots():
    """Rotating wrists and start by an angle rotates every candidate by it.

    Two roots that all but meet may be told as one: rounding moves them by its square root.
    """
    problem = random_moves(500, 11)
    turn = 0.7
    c, s = np.cos(turn), np.sin(turn)
    wrist = problem.wrist @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])
    turned = dataclasses.replace(problem, wrist=wrist, angle_0=problem.angle_0 + turn)
    first, second = SOLVE(problem), SOLVE(turned)
    for move in range(500):
        a, b = np.array(first.preferred(move)) + turn, np.array(second.preferred(move))
        assert bool(len(a)) == bool(len(b))
        apart = np.abs(a[:, None] - b)
        assert all((apart.min(axis=axis) < 1e-6).all() for axis in (0, 1) if apart.size)
        if len(a) == len(b):
            assert np.allclose(a, b, atol=1e-6)


def test_swapping_the_arms_keeps_the_roots():
    """Arm 1 and arm 2 are names."""
    problem = random_moves(500, 12)
    swapped = PlatformProblem(
        **{
            name: getattr(problem, name)[:, ::-1] if name != "angle_0" else problem.angle_0
            for name in problem.__dataclass_fields__
        }
    )
    for solution, other in zip([SOLVE(problem)], [SOLVE(swapped)], strict=True):
        for move in range(500):
            a = sorted(solution.angle[move][solution.reachable[move] & (solution.kind[move] < 3)])
            b = sorted(other.angle[move][other.reachable[move] & (other.kind[move] < 3)])
            assert len(a) == len(b)
            assert np.allclose(a, b, atol=1e-6)


def test_lengths_have_no_unit():
    """Scaling every length by 1,000 changes no angle."""
    problem = random_moves(300, 13)
    lengths = ("radius", "height", "upper", "fore", "wrist")
    scaled = dataclasses.replace(problem, **{n: getattr(problem, n) * 1000.0 for n in lengths})
    first, second = SOLVE(problem), SOLVE(scaled)
    for move in range(300):
        a, b = sorted(first.preferred(move)), sorted(second.preferred(move))
        assert np.allclose(a, b, atol=1e-6)


def test_without_a_root_the_best_balanced_angle_comes_first():
    """No angle of a dense scan balances the elbows better than the preferred fallback."""
    problem = random_moves(2_000, 14)
    solution = SOLVE(problem)
    roots = (solution.kind == Kind.ROOT_SAME) | (solution.kind == Kind.ROOT_OPPOSITE)
    without = np.flatnonzero(
        ~(solution.reachable & roots & solution.valid).any(axis=1) & (solution.best >= 0)
    )
    assert len(without) > 50
    grid = np.broadcast_to(np.linspace(-np.pi, np.pi, SCAN), (len(without), SCAN))
    some = problem.rows(without)
    x = elbow_cosine(some, grid)
    size = np.abs(np.arccos(np.clip(x, -1, 1)) - some.elbow_0[:, None])
    imbalance = np.where((np.abs(x) <= 1).all(axis=-1), np.abs(size[..., 0] - size[..., 1]), np.inf)
    chosen = solution.imbalance[without, solution.best[without]]
    assert (chosen <= imbalance.min(axis=1) + 1e-6).all()


def test_degenerate_moves_get_an_answer_or_a_reason():
    """Zero radius, wrists on the axis, equal equations: no NaN, no warning, a named reason."""
    base = random_moves(4, 15)
    radius, wrist = base.radius.copy(), base.wrist.copy()
    radius[0] = 0.0
    wrist[1, :, :2] = 0.0
    radius[2] = radius[2, 0]
    problem = dataclasses.replace(base, radius=radius, wrist=wrist)
    with np.errstate(all="raise"):
        solution = SOLVE(problem)
    assert np.isfinite(solution.angle).all()
    assert np.isfinite(solution.delta).all()
    for move in (0, 1):
        assert "every angle is equal" in solution.reason(move)


def test_a_move_out_of_reach_has_no_angle_and_says_so():
    """A wrist ten metres away."""
    base = random_moves(1, 16)
    problem = dataclasses.replace(base, wrist=np.full((1, 2, 3), 10.0))
    solution = SOLVE(problem)
    assert solution.best[0] == -1
    assert solution.preferred(0) == []
    assert "within reach" in solution.reason(0)


@pytest.mark.parametrize("name", ["exact", "linearised", "fixed"])
def test_every_solver_stays_within_half_a_turn_and_says_what_is_reachable(name):
    """The contract of the family: wrapped angles, reach by the cosine law, no moves at all."""
    problem = random_moves(400, 17)
    solution = PLATFORM_SOLVERS[name].solve(problem)
    way = np.abs(solution.angle - problem.angle_0[:, None])[solution.valid]
    assert way.max() <= np.pi + 1e-12
    x = elbow_cosine(problem, solution.angle)
    assert (np.abs(x[solution.reachable]) <= 1.0 + 2e-9).all()
    empty = PLATFORM_SOLVERS[name].solve(problem.rows(slice(0, 0)))
    assert empty.angle.shape[0] == 0


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("upper", 0.0, "links must be longer than 0"),
        ("radius", -0.1, "radii not negative"),
        ("wrist", np.nan, "wrist must be finite"),
    ],
)
def test_impossible_moves_are_refused(name, value, words):
    """The noun's constructor names what is wrong."""
    base = random_moves(2, 18)
    with pytest.raises(ValueError, match=words):
        dataclasses.replace(base, **{name: np.full_like(getattr(base, name), value)})
