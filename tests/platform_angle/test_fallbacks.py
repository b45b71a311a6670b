"""Stationary points, limits of the reach, elbow angles and the paper's candidates."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.geometry.roots import first_order_zeros
from dualarm_cli.platform_angle import PLATFORM_SOLVERS, Kind, PlatformProblem, elbow_angles
from dualarm_cli.platform_angle.exact import stationary_polynomial, unbalanced_angles
from dualarm_cli.platform_angle.problem import cosine_coefficients, elbow_cosine

STEP = 1e-6


def arms(count, seed):
    """Moves of random arms within reach somewhere."""
    rng = np.random.default_rng(seed)
    rho, theta = rng.uniform(0.1, 0.5, (count, 2)), rng.uniform(-np.pi, np.pi, (count, 2))
    z = rng.uniform(-0.2, 0.2, (count, 2))
    return PlatformProblem.broadcast(
        shoulder=(
            rng.uniform(0.05, 0.3, (count, 2)),
            rng.uniform(-np.pi, np.pi, (count, 2)),
            rng.uniform(-0.1, 0.1, (count, 2)),
        ),
        links=(rng.uniform(0.2, 0.5, (count, 2)), rng.uniform(0.2, 0.5, (count, 2))),
        wrist=np.stack([rho * np.cos(theta), rho * np.sin(theta), z], axis=-1),
        angle_0=rng.uniform(-2, 2, count),
        elbow_0=rng.uniform(0.3, 2.9, (count, 2)),
    )


def combination(problem, angle, sign):
    """q4_1 - s q4_2 at platform angles (n, k), and where both arms are 0.01 inside their reach."""
    x = elbow_cosine(problem, angle)
    q = np.arccos(np.clip(x, -1, 1))
    return q[..., 0] - sign * q[..., 1], (np.abs(x) < 0.99).all(axis=-1)


def test_elbow_angles_follow_from_the_triangle_of_points_in_space():
    """Shoulder, elbow, wrist: the law of cosines on coordinates, no coefficient of ours."""
    problem = arms(300, 1)
    angle = np.random.default_rng(2).uniform(-4, 4, (300, 5))
    q, reached = elbow_angles(problem, angle)
    for arm in (0, 1):
        azimuth = angle + problem.offset[:, [arm]]
        radius = problem.radius[:, [arm]]
        shoulder = np.stack(
            [
                radius * np.cos(azimuth),
                radius * np.sin(azimuth),
                np.broadcast_to(problem.height[:, [arm]], azimuth.shape),
            ],
            axis=-1,
        )
        distance = np.linalg.norm(problem.wrist[:, None, arm] - shoulder, axis=-1)
        a1, a2 = problem.upper[:, [arm]], problem.fore[:, [arm]]
        inside = (distance < a1 + a2) & (distance > np.abs(a1 - a2))
        assert (inside == reached[..., arm]).all()
        # The third side of the triangle with the angle that was found.
        side = np.sqrt(a1**2 + a2**2 - 2 * a1 * a2 * np.cos(q[..., arm]))
        assert np.allclose(side[inside], distance[inside], atol=1e-12)
        assert (q[..., arm][~inside] == 0).all()


def test_the_stationary_polynomial_is_its_definition():
    """x_1'² (1 - x_2²) - x_2'² (1 - x_1²) at random angles, with x' by finite differences."""
    problem = arms(200, 3)
    phi = np.random.default_rng(4).uniform(-np.pi, np.pi, (200, 6))
    x = elbow_cosine(problem, phi)
    dx = (elbow_cosine(problem, phi + STEP) - elbow_cosine(problem, phi - STEP)) / (2 * STEP)
    one, two, d1, d2 = x[..., 0], x[..., 1], dx[..., 0], dx[..., 1]
    f = stationary_polynomial(cosine_coefficients(problem))
    value = f[:, :1] + sum(
        f[:, [2 * m - 1]] * np.cos(m * phi) + f[:, [2 * m]] * np.sin(m * phi) for m in (1, 2, 3)
    )
    size = np.abs(f).max(axis=1, keepdims=True)
    expected = d1**2 * (1 - two**2) - d2**2 * (1 - one**2)
    assert (np.abs(value - expected) <= 1e-7 * np.maximum(size, 1)).all()


@pytest.mark.parametrize(
    ("sign", "kind"), [(1.0, Kind.STATIONARY_SAME), (-1.0, Kind.STATIONARY_OPPOSITE)]
)
def test_stationary_points_are_flat_and_all_there(sign, kind):
    """Zero slope by finite differences; every turning point of a scan has one in its interval."""
    problem = arms(1_000, 5)
    angle, kinds, valid = unbalanced_angles(cosine_coefficients(problem), problem.angle_0)
    before, inside = combination(problem, angle - STEP, sign)
    after, _ = combination(problem, angle + STEP, sign)
    mine = valid & (kinds == kind) & inside
    assert mine.sum() > 1_000
    assert np.abs(after - before)[mine].max() / (2 * STEP) < 1e-7
    grid = np.linspace(-np.pi, np.pi, 1441)
    f, inside = combination(problem, np.broadcast_to(grid, (1_000, 1441)), sign)
    turn = np.diff(f, axis=1)
    bend = (turn[:, :-1] * turn[:, 1:] < 0) & inside[:, :-2] & inside[:, 1:-1] & inside[:, 2:]
    row, column = np.nonzero(bend)
    assert len(row) > 1_000
    ahead = np.mod(angle[row] - grid[column, None], 2 * np.pi)
    hit = (ahead <= 2 * (grid[1] - grid[0])) & valid[row] & (kinds == kind)
    assert hit.any(axis=1).all()


def test_boundaries_are_where_the_reach_ends():
    """At each, one arm is stretched or folded to a microradian, and just beyond it does not reach."""
    problem = arms(1_000, 6)
    angle, kinds, valid = unbalanced_angles(cosine_coefficients(problem), problem.angle_0)
    mine = valid & (kinds == Kind.BOUNDARY)
    assert mine.sum() > 500
    limit = (1.0 - np.abs(elbow_cosine(problem, angle)))[mine]
    nearest = np.abs(limit).argmin(axis=-1)
    # A hair inside, so that whoever computes the arm from the angle can.
    inside = limit[np.arange(len(limit)), nearest]
    assert (inside > 0).all()
    assert inside.max() < 1e-11
    out = [np.abs(elbow_cosine(problem, angle + s)).max(axis=-1) > 1.0 for s in (1e-3, -1e-3)]
    assert (out[0] | out[1])[mine].all()


def test_the_papers_roots_solve_its_equation_five_and_its_other_points_are_flat():
    """|x_1f - x_10| = |x_2f - x_20| with either sign, and no slope of its two sides' difference."""
    problem = arms(2_000, 7)
    solution = PLATFORM_SOLVERS["linearised"].solve(problem)
    x_0 = np.cos(problem.elbow_0)[:, None]
    for sign, root, flat in (
        (1.0, Kind.ROOT_SAME, Kind.STATIONARY_SAME),
        (-1.0, Kind.ROOT_OPPOSITE, Kind.STATIONARY_OPPOSITE),
    ):
        values = []
        for step in (0.0, STEP, -STEP):
            moved = elbow_cosine(problem, solution.angle + step) - x_0
            values.append(moved[..., 0] - sign * moved[..., 1])
        assert np.abs(values[0])[solution.valid & (solution.kind == root)].max() < 1e-13
        slope = np.abs(values[1] - values[2]) / (2 * STEP)
        assert slope[solution.valid & (solution.kind == flat)].max() < 1e-8


def test_the_divisions_by_zero_of_the_printed_equations_are_no_special_cases():
    """A = B (Eq. 14) has phi = pi and tan(phi/2) = -B/C; C = 0 (Eq. 15) has 0 and pi, by hand."""
    angle, exists = first_order_zeros(np.array([1.0]), np.array([1.0]), np.array([0.5]))
    assert exists.all()
    expected = [np.pi, 2 * np.arctan(-2.0)]
    assert np.allclose(np.sort(np.cos(angle[0])), np.sort(np.cos(expected)), atol=1e-15)
    assert np.allclose(np.sort(np.sin(angle[0])), np.sort(np.sin(expected)), atol=1e-15)
    # Arm 2 sits on the axis, arm 1 and its target at azimuth 0: B = v_1, C = 0 for both signs.
    problem = PlatformProblem.broadcast(
        shoulder=([0.2, 0.0], 0.0, 0.0),
        links=(0.3, 0.3),
        wrist=[[0.3, 0.0, 0.1], [0.1, 0.0, 0.3]],
        angle_0=0.5,
        elbow_0=[1.0, 1.0],
    )
    solution = PLATFORM_SOLVERS["linearised"].solve(problem)
    for kind in (Kind.STATIONARY_SAME, Kind.STATIONARY_OPPOSITE):
        flat = solution.angle[0, solution.valid[0] & (solution.kind[0] == kind)]
        assert np.allclose(np.sort(np.cos(flat)), [-1.0, 1.0], atol=1e-15)


def test_one_pair_of_wrists_is_one_move_and_messages_name_the_value():
    """The named constructor takes (2, 3); what it refuses it quotes with its place."""
    fields = {"shoulder": (0.2, 0.0, 0.0), "elbow_0": 1.0}
    wrist = np.full((2, 3), 0.2)
    problem = PlatformProblem.broadcast(**fields, links=(0.3, 0.3), wrist=wrist, angle_0=0.0)
    assert problem.wrist.shape == (1, 2, 3)
    with pytest.raises(ValueError, match=r"upper\[0, 1\] = -0.3: links must be longer than 0"):
        PlatformProblem.broadcast(**fields, links=([0.3, -0.3], 0.3), wrist=wrist, angle_0=0.0)
    with pytest.raises(ValueError, match=r"wrist\[0, 0, 2\] = nan: wrist must be finite"):
        wrist[0, 2] = np.nan
        PlatformProblem.broadcast(**fields, links=(0.3, 0.3), wrist=wrist, angle_0=0.0)
    with pytest.raises(ValueError, match=r"elbow_0 has shape \(3, 2\); needs \(2, 2\)"):
        dataclasses.replace(arms(2, 8), elbow_0=np.ones((3, 2)))


def test_a_planar_start_out_of_reach_is_refused_with_its_distance():
    """P_1,0 at 300 mm: 250 mm from a shoulder at 50 mm, beyond twice 70 mm."""
    with pytest.raises(ValueError, match=r"arm 1 .* 0\.25 m from its shoulder, reach 0 to 0\.14 m"):
        PlatformProblem.planar(
            radius=0.05,
            alpha=2.0,
            links=(0.07, 0.07),
            angle_0=0.0,
            start=[[0.3, 0.0], [0.0, 0.1]],
            goal=[[0.1, 0.0], [0.0, 0.1]],
        )


def test_solutions_cannot_be_changed():
    """Frozen through, as every noun is."""
    solution = PLATFORM_SOLVERS["exact"].solve(arms(3, 9))
    for name in ("angle", "kind", "valid", "reachable", "delta", "degenerate", "always_balanced"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(solution, name)[0] = 0
