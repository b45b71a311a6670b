"""Exact platform angles where they are hard to find: limits of reach, double roots, equal arms."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

from dualarm_cli.geometry.roots import first_order_zeros
from dualarm_cli.platform_angle import PLATFORM_SOLVERS, Kind, PlatformProblem
from dualarm_cli.platform_angle.problem import cosine_coefficients, elbow_cosine

SCAN = 1440
SOLVE = PLATFORM_SOLVERS["exact"].solve
FAMILIES = (
    "reach",
    "always_balanced",
    "opposed",
    "square",
    "double",
    "small",
    "extreme",
    "consistent",
    "stretched",
)
NOISE = 1e-11
"""A scan sees a change of sign where both samples are larger than this [rad]."""


def tiny(rng, low, high, shape):
    """Numbers of either sign between 10^low and 10^high, evenly over the decades."""
    return 10.0 ** rng.uniform(low, high, shape) * rng.choice([-1.0, 1.0], shape)


def hard_moves(count, seed, family):
    """Moves with one difficulty each."""
    rng = np.random.default_rng([seed, FAMILIES.index(family)])
    a = {
        "radius": rng.uniform(0.02, 0.4, (count, 2)),
        "offset": rng.uniform(-np.pi, np.pi, (count, 2)),
        "height": rng.uniform(-0.3, 0.3, (count, 2)),
        "upper": rng.uniform(0.1, 0.5, (count, 2)),
        "fore": rng.uniform(0.1, 0.5, (count, 2)),
        "elbow_0": rng.uniform(0.3, 2.9, (count, 2)),
        "rho": rng.uniform(0, 0.8, (count, 2)),
        "theta": rng.uniform(-np.pi, np.pi, (count, 2)),
        "rise": rng.uniform(-0.2, 0.2, (count, 2)),
    }
    angle_0 = rng.uniform(-2, 2, count)
    change = {
        "reach": touch_the_reach,
        "always_balanced": make_always_balanced,
        "opposed": oppose,
        "square": square,
        "small": shrink,
        "extreme": straighten,
    }.get(family)
    if change is not None:
        change(rng, a)
    rho, theta = a.pop("rho"), a.pop("theta")
    z = a["height"] + a.pop("rise")
    wrist = np.stack([rho * np.cos(theta), rho * np.sin(theta), z], axis=-1)
    problem = PlatformProblem(wrist=wrist, angle_0=angle_0, **a)
    start = {"double": tangent, "consistent": through, "stretched": through_a_limit}.get(family)
    return problem if start is None else dataclasses.replace(problem, elbow_0=start(rng, problem))


def touch_the_reach(rng, a):
    """The farthest or nearest wrist distance is a limit of the arm, up to 1e-12 to 1e-1."""
    far, near = (
        np.hypot(a["radius"] + a["rho"], a["rise"]),
        np.hypot(a["radius"] - a["rho"], a["rise"]),
    )
    pick = rng.integers(0, 4, far.shape)
    limit = np.where(pick % 2, far, near) * (1 + tiny(rng, -12, -1, far.shape))
    upper = np.where(pick < 2, limit * rng.uniform(0.3, 0.7, far.shape), limit + a["fore"])
    a["upper"] = np.maximum(upper, 1e-3)
    a["fore"] = np.maximum(np.where(pick < 2, limit - upper, a["fore"]), 1e-3)


def make_always_balanced(rng, a):
    """Arm 2 is arm 1 or its mirror image, up to 1e-14 to 1e-2 in some of its numbers."""
    count = len(a["radius"])
    error = tiny(rng, -14, -2, count)
    for name in ("height", "rho", "radius", "upper", "fore", "rise", "elbow_0"):
        some = error * rng.uniform(-1, 1, count) * (rng.random(count) < 0.4)
        a[name][:, 1] = (
            np.abs(a[name][:, 0] + some) if name in ("rho", "radius") else a[name][:, 0] + some
        )
    side = np.where(rng.random(count) < 0.5, -1.0, 1.0)
    a["offset"][:, 1] = side * a["offset"][:, 0] + error * (rng.random(count) < 0.5)
    a["theta"][:, 1] = side * a["theta"][:, 0]


def oppose(rng, a):
    """One elbow opens just as the other closes, q4_1 + q4_2 = pi, up to 1e-14 to 1e-2.

    Equal links L give x = 1 - r² / 2L²; a shoulder turned by pi mirrors the swing, and heights with
    r_1² + r_2² = 4 L² in the mean mirror the rest.
    """
    count = len(a["radius"])
    error, link = tiny(rng, -14, -2, count), a["upper"][:, [0]]
    a["upper"][:], a["fore"][:] = link, link
    for name in ("radius", "rho"):
        a[name][:] = np.minimum(a[name][:, [0]], 0.6 * link)
    a["offset"][:, 1], a["theta"][:, 1] = a["offset"][:, 0] + np.pi, a["theta"][:, 0]
    flat = a["radius"][:, 0] ** 2 + a["rho"][:, 0] ** 2
    rest = 4 * link[:, 0] ** 2 - 2 * flat - a["rise"][:, 0] ** 2
    a["rise"][:, 1] = np.sqrt(np.maximum(rest, 0.0))
    a["elbow_0"][:, 1] = np.pi - a["elbow_0"][:, 0] + error * (rng.random(count) < 0.7)
    a["theta"][:, 1] += error * (rng.random(count) < 0.5)
    a["rho"][:, 1] *= 1 + error * (rng.random(count) < 0.5)


def square(rng, a):
    """Mirrored arms with equal elbows: the squared equation is a square with zeros 0 and pi.

    Both arms are stretched or folded at one of the zeros, up to 1e-12 to 1e-1; one target is off by
    1e-15 to 1e-10, so that rounding shows, and most starts by 1e-15 to 1e-1.
    """
    for name in ("radius", "rho", "rise", "height", "elbow_0"):
        a[name][:, 1] = a[name][:, 0]
    for name in ("offset", "theta"):
        a[name][:, 1] = -a[name][:, 0]
    count = len(a["radius"])
    zero = np.where(rng.random(count) < 0.5, 0.0, np.pi)
    radius, rho = a["radius"][:, 0], a["rho"][:, 0]
    turn = zero + a["offset"][:, 0] - a["theta"][:, 0]
    distance = np.sqrt(radius**2 + rho**2 - 2 * radius * rho * np.cos(turn) + a["rise"][:, 0] ** 2)
    inside = np.abs(tiny(rng, -12, -1, count))
    fold = rng.random(count) < 0.3
    share = np.where(fold, 0.0, rng.uniform(0.3, 0.7, count))
    fore = np.where(fold, a["fore"][:, 0], share * distance * (1 + inside))
    upper = np.where(fold, fore + distance * (1 - inside), (1 - share) * distance * (1 + inside))
    a["upper"][:], a["fore"][:] = upper[:, None], fore[:, None]
    a["theta"][:, 1] += tiny(rng, -15, -10, count)
    a["rho"][:, 1] *= 1 + tiny(rng, -15, -10, count)
    a["elbow_0"][:, 1] += tiny(rng, -15, -1, count) * (rng.random(count) < 0.6)


def shrink(rng, a):
    """Radii down to 1e-14 m, some wrists next to the axis."""
    a["radius"] *= np.abs(tiny(rng, -14, 0, a["radius"].shape))
    a["rho"][rng.random(len(a["rho"])) < 0.3] *= 1e-9


def straighten(rng, a):
    """Elbows that start stretched, folded or at a right angle, exactly or nearly."""
    size = np.abs(tiny(rng, -14, -1, a["elbow_0"].shape))
    near = np.where(rng.random(size.shape) < 0.5, size, np.pi - size)
    sharp = rng.choice([0.0, np.pi, np.pi / 2], size.shape)
    a["elbow_0"] = np.where(rng.random(size.shape) < 0.3, sharp, near)


def interior(problem, angle):
    """Elbow angles at platform angles (n, k), and where both arms reach."""
    x = elbow_cosine(problem, angle)
    return np.arccos(np.clip(x, -1, 1)), (np.abs(x) <= 1.0).all(axis=-1)


def through(rng, problem, angle=None):
    """Starting elbows that make a given (or random) angle a root."""
    count = len(problem.angle_0)
    angle = rng.uniform(-np.pi, np.pi, count) if angle is None else angle
    q, _ = interior(problem, angle[:, None])
    turn = rng.uniform(-0.5, 0.5, count)
    return q[:, 0] - np.column_stack([turn, rng.choice([-1.0, 1.0], count) * turn])


def through_a_limit(rng, problem):
    """A root 1e-10 to 1e-1 rad beside an angle at which an arm is stretched or folded."""
    count, rows = len(problem.angle_0), np.arange(len(problem.angle_0))
    arm = rng.integers(0, 2, count)
    u, v, w = cosine_coefficients(problem)[rows, arm].T
    limit, _ = first_order_zeros(u - rng.choice([1.0, -1.0], count), v, w)
    return through(rng, problem, limit[rows, rng.integers(0, 2, count)] + tiny(rng, -10, -1, count))


def tangent(rng, problem):
    """K is an extremum of q4_1 - s q4_2, up to 1e-14 to 1e-2: a double root, a close pair or none."""
    count, rows = len(problem.angle_0), np.arange(len(problem.angle_0))
    sign = rng.choice([1.0, -1.0], count)
    q, reach = interior(problem, np.broadcast_to(np.linspace(-np.pi, np.pi, 721), (count, 721)))
    f = q[..., 0] - sign[:, None] * q[..., 1]
    turn = np.diff(f, axis=1)
    bend = (turn[:, :-1] * turn[:, 1:] < 0) & reach[:, :-2] & reach[:, 1:-1] & reach[:, 2:]
    k = np.argmax(bend * rng.random(bend.shape), axis=1) + 1
    before, here, after = f[rows, k - 1], f[rows, k], f[rows, k + 1]
    curve = before - 2 * here + after
    top = here - (after - before) ** 2 / 8 / np.where(curve == 0, 1, curve)
    other = rng.uniform(0.2, 2.9, count)
    return np.column_stack([top + tiny(rng, -14, -2, count) + sign * other, other])


def samples(problem):
    """A scan that is dense everywhere and denser where an arm reaches its limits, (n, m)."""
    count, c = len(problem.angle_0), cosine_coefficients(problem)
    columns = [np.broadcast_to(np.linspace(-np.pi, np.pi, SCAN, endpoint=False), (count, SCAN))]
    for arm in (0, 1):
        for limit in (1.0, -1.0):
            angle, exists = first_order_zeros(c[:, arm, 0] - limit, c[:, arm, 1], c[:, arm, 2])
            for step in (1e-1, 1e-2, 1e-3, 1e-5, 1e-7, 1e-9):
                columns += [np.where(exists, angle + step, 0), np.where(exists, angle - step, 0)]
    wrapped = np.mod(np.hstack(columns) + np.pi, 2 * np.pi) - np.pi
    return extrema(problem, np.sort(wrapped, axis=1))


def extrema(problem, grid):
    """The samples and the extrema between them, by golden section, so that close pairs are seen."""
    q, reach = interior(problem, grid)
    more = [np.zeros(0, dtype=int)], [np.zeros(0)]
    for sign in (1.0, -1.0):
        turn = np.diff(q[..., 0] - sign * q[..., 1], axis=1)
        bend = (turn[:, :-1] * turn[:, 1:] < 0) & reach[:, :-2] & reach[:, 1:-1] & reach[:, 2:]
        row, column = np.nonzero(bend)
        low, high, up = grid[row, column], grid[row, column + 2], np.sign(turn[row, column])
        some = problem.rows(row)
        for _ in range(45):
            first, second = low + 0.382 * (high - low), low + 0.618 * (high - low)
            one, two = (interior(some, phi[:, None])[0][:, 0] for phi in (first, second))
            lower = up * (one[:, 0] - sign * one[:, 1]) < up * (two[:, 0] - sign * two[:, 1])
            low, high = np.where(lower, first, low), np.where(lower, high, second)
        more[0].append(row)
        more[1].append((low + high) / 2)
    row, angle = np.concatenate(more[0]), np.concatenate(more[1])
    order = np.argsort(row, kind="stable")
    row, angle = row[order], angle[order]
    place = np.arange(len(row)) - np.searchsorted(row, row)
    extra = np.zeros((len(grid), int(place.max(initial=-1)) + 1))
    extra[row, place] = angle
    return np.sort(np.hstack([grid, extra]), axis=1)


def seen_and_missed(problem, solution):
    """How many roots a scan encloses, and how many of them have no candidate in their interval."""
    grid = samples(problem)
    q, reach = interior(problem, grid)
    seen = missed = 0
    for sign, kind in ((1.0, Kind.ROOT_SAME), (-1.0, Kind.ROOT_OPPOSITE)):
        target = problem.elbow_0[:, 0] - sign * problem.elbow_0[:, 1]
        f = q[..., 0] - sign * q[..., 1] - target[:, None]
        both = reach[:, :-1] & reach[:, 1:] & (f[:, :-1] * f[:, 1:] < 0)
        row, column = np.nonzero(both & (np.minimum(np.abs(f[:, :-1]), np.abs(f[:, 1:])) > NOISE))
        low, high = grid[row, column], grid[row, column + 1]
        # A gap of the reach narrower than the scan is no root: bisection does not end at zero.
        row, low, high = enclosed(problem, sign, row, low, high, np.sign(f[row, column]))
        ahead = np.mod(solution.angle[row] - low[:, None] + 1e-9, 2 * np.pi)
        hit = (ahead <= (high - low)[:, None] + 2e-9) & solution.valid[row]
        seen += len(row)
        missed += int((~(hit & (solution.kind[row] == kind)).any(axis=1)).sum())
    return seen, missed


def enclosed(problem, sign, row, low, high, before):
    """The intervals in which the difference of displacements really vanishes."""
    some, a, b = problem.rows(row), low.copy(), high.copy()
    inside = np.ones(len(row), dtype=bool)
    for _ in range(60):
        middle = (a + b) / 2
        q, reach = interior(some, middle[:, None])
        f = q[:, 0, 0] - sign * q[:, 0, 1] - (some.elbow_0[:, 0] - sign * some.elbow_0[:, 1])
        inside &= reach[:, 0]
        a, b = np.where(f * before > 0, middle, a), np.where(f * before > 0, b, middle)
    keep = inside & (np.abs(f) < 1e-6)
    return row[keep], low[keep], high[keep]


def assert_all_roots(count, seed, family, least):
    """Every enclosed root is found, every root is true, and nothing warns or is not a number."""
    problem = hard_moves(count, seed, family)
    with warnings.catch_warnings(), np.errstate(divide="raise", invalid="raise", over="raise"):
        warnings.simplefilter("error")
        solution = SOLVE(problem)
    assert np.isfinite(solution.angle).all()
    assert np.isfinite(solution.delta).all()
    q, _ = interior(problem, solution.angle)
    moved = np.abs(q - problem.elbow_0[:, None])
    assert np.abs(moved[..., 0] - moved[..., 1])[solution.is_root].max() < 1e-9
    seen, missed = seen_and_missed(problem, solution)
    assert seen > least * count
    assert missed == 0


@pytest.mark.parametrize(
    ("family", "least"),
    list(zip(FAMILIES, (0.4, 0.8, 0.5, 0.25, 0.8, 0.02, 0.5, 1.2, 1.0), strict=True)),
)
def test_no_root_is_missed_where_roots_are_hard_to_find(family, least):
    """500 moves of each difficulty against a scan that is refined at limits and extrema."""
    assert_all_roots(500, 0, family, least)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(1, 9))
@pytest.mark.parametrize("family", FAMILIES)
def test_no_root_is_missed_in_a_hundred_thousand_hard_moves(family, seed):
    """The same on 72 times 1,500 moves: nine difficulties, eight seeds."""
    assert_all_roots(1_500, seed, family, 0.02)


def mirrored_arms(angle_0=0.4):
    """Two equal arms whose targets and starts are equal too: at every angle both elbows agree."""
    return PlatformProblem.broadcast(
        shoulder=(0.2, 0.7, 0.1),
        links=(0.3, 0.25),
        wrist=[[0.4, 0.2, 0.0], [0.4, 0.2, 0.0]],
        angle_0=angle_0,
        elbow_0=1.3,
    )


@pytest.mark.parametrize("name", ["exact", "linearised"])
def test_arms_that_always_agree_keep_the_platform_where_it_is(name):
    """Every angle is a root: the start is the nearest, and the reason is named."""
    solution = PLATFORM_SOLVERS[name].solve(mirrored_arms())
    assert solution.preferred(0)[0] == 0.4
    assert solution.kind[0, solution.best[0]] == Kind.ROOT_SAME
    assert "alike at every angle" in solution.reason(0)


def test_arms_that_always_agree_turn_to_the_nearest_reach_if_the_start_is_out_of_it():
    """Turned away by pi the targets are too far: the nearer edge of the reach is taken."""
    problem = mirrored_arms(angle_0=-2.2)
    solution = SOLVE(problem)
    best = solution.best[0]
    assert solution.kind[0, best] == Kind.ROOT_SAME
    grid = np.linspace(-np.pi, np.pi, 100_001)
    reach = interior(problem, grid[None])[1][0]
    turn = np.abs(np.mod(grid[reach] + 2.2 + np.pi, 2 * np.pi) - np.pi)
    assert abs(abs(solution.angle[0, best] + 2.2) - turn.min()) < 1e-4


@pytest.mark.parametrize("name", ["exact", "linearised", "fixed"])
@pytest.mark.parametrize("spoil", ["radius", "wrist"])
def test_a_platform_that_moves_no_elbow_stays(name, spoil):
    """Shoulders or wrists on the axis: the start is the answer, with a reason."""
    base = mirrored_arms()
    fields = {"radius": np.zeros((1, 2)), "wrist": np.array([[[0, 0, 0.3], [0, 0, -0.1]]])}
    problem = dataclasses.replace(base, **{spoil: fields[spoil]}, elbow_0=np.array([[1.0, 2.0]]))
    solution = PLATFORM_SOLVERS[name].solve(problem)
    assert solution.preferred(0) == [0.4]
    assert "every angle is equal" in solution.reason(0)


def test_one_arm_that_the_platform_does_not_move_still_has_its_roots():
    """Arm 2 on the axis keeps its elbow: the roots bring arm 1 to the one displacement, by hand."""
    base = mirrored_arms()
    problem = dataclasses.replace(base, radius=np.array([[0.2, 0.0]]))
    q2 = interior(problem, np.zeros((1, 1)))[0][0, 0, 1]
    solution = SOLVE(problem)
    q1 = interior(problem, solution.angle)[0][0, solution.is_root[0], 0]
    turn = q2 - 1.3
    assert solution.is_root[0].sum() >= 2
    assert np.allclose(np.minimum(np.abs(q1 - 1.3 - turn), np.abs(q1 - 1.3 + turn)), 0, atol=1e-9)


def test_the_same_moves_give_the_same_bytes_alone_and_among_others():
    """Chunks and neighbours change nothing."""
    problem = hard_moves(9_000, 3, "consistent")
    whole, part = SOLVE(problem), SOLVE(problem.rows(slice(4_000, 5_000)))
    for name in ("angle", "kind", "valid", "reachable", "delta"):
        assert getattr(whole, name)[4_000:5_000].tobytes() == getattr(part, name).tobytes()
        assert getattr(whole, name).tobytes() == getattr(SOLVE(problem), name).tobytes()


def test_reachable_roots_come_nearest_first_and_before_everything_else():
    """The order that a planner takes the candidates in."""
    problem = hard_moves(2_000, 4, "consistent")
    solution = SOLVE(problem)
    way = np.abs(solution.angle - problem.angle_0[:, None])
    for move in range(500):
        columns = solution.order[move]
        roots = [k for k in columns if solution.is_root[move, k]]
        assert list(columns[: len(roots)]) == roots
        assert (np.diff(way[move, roots]) >= 0).all()
        assert solution.preferred(move)[: len(roots)] == solution.angle[move, roots].tolist()


@pytest.mark.parametrize("family", ["consistent", "always_balanced", "double"])
def test_no_root_is_listed_twice(family):
    """Roots of one kind keep a distance."""
    solution = SOLVE(hard_moves(2_000, 5, family))
    pairs = 0
    for kind in (Kind.ROOT_SAME, Kind.ROOT_OPPOSITE):
        mine = solution.is_root & (solution.kind == kind)
        for i in range(8):
            for k in range(i):
                both = mine[:, i] & mine[:, k]
                turn = solution.angle[both, i] - solution.angle[both, k]
                apart = np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi)
                pairs += both.sum()
                assert (apart > 1e-9).all()
    assert pairs > 100


@pytest.mark.parametrize("family", ["reach", "extreme", "stretched"])
def test_whoever_can_reach_at_all_gets_an_angle_within_reach(family):
    """If any sample of the refined scan is in reach of both arms, so is the preferred angle."""
    problem = hard_moves(1_500, 6, family)
    solution = SOLVE(problem)
    reach = interior(problem, samples(problem))[1].any(axis=1)
    assert 0.1 < reach.mean() < 0.95
    assert (solution.best[reach] >= 0).all()


def test_moves_without_a_root_get_several_angles_the_best_balanced_first():
    """Up to four, by growing imbalance."""
    problem = hard_moves(3_000, 7, "extreme")
    solution = SOLVE(problem)
    rows = np.flatnonzero(~solution.is_root.any(axis=1) & (solution.best >= 0))
    assert len(rows) > 100
    counts = [len(solution.preferred(move)) for move in rows]
    assert max(counts) == 4
    assert np.mean(counts) > 2
    for move in rows[:200]:
        columns = solution.order[move][: len(solution.preferred(move))]
        assert (np.diff(solution.imbalance[move, columns]) > -2e-8).all()


def test_of_two_mirrored_angles_the_nearer_is_preferred():
    """With everything at azimuth 0 or pi both elbows are even functions: fallbacks come in pairs."""
    rng = np.random.default_rng(8)
    count = 3_000
    wrist = np.zeros((count, 2, 3))
    wrist[:, :, 0] = rng.uniform(0.1, 0.6, (count, 2))
    problem = PlatformProblem.broadcast(
        shoulder=(
            rng.uniform(0.1, 0.3, (count, 2)),
            [0.0, np.pi],
            rng.uniform(-0.2, 0.2, (count, 2)),
        ),
        links=(0.3, rng.uniform(0.2, 0.4, (count, 2))),
        wrist=wrist,
        angle_0=rng.uniform(-1.5, 1.5, count),
        elbow_0=rng.uniform(0.3, 2.9, (count, 2)),
    )
    solution = SOLVE(problem)
    rows = np.flatnonzero(~solution.is_root.any(axis=1) & (solution.best >= 0))
    angle = solution.angle[rows, solution.best[rows]]
    paired = np.abs(np.sin(angle)) > 1e-3
    assert paired.sum() > 100
    assert (np.sin(angle[paired]) * problem.angle_0[rows][paired] > 0).all()
