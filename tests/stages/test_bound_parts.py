"""Parts of the lower bound one by one: derivatives by differences, enclosures by samples, compiled cells by numpy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.bound.bound import platform_edges
from dualarm_cli.bound.cells import Cells, LineToTarget, pose_cells
from dualarm_cli.effort import Resolution
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.postures.platform_reach import AngleCells, reachable_cells
from dualarm_cli.stages.plans.problem import SequenceProblem
from tests import posture_cells_numpy as in_numpy
from tests.posture_cells_numpy import one_cell, smallest_rotation
from tests.ranges_numpy import Range, half, turning

Problems = Callable[..., SequenceProblem]


def _plane(arm: SrsArm, R: np.ndarray, p: np.ndarray, angle: float) -> list[np.ndarray]:
    """u, r and t of the arm plane in the world, (3,) each."""
    back = rotation_z(np.array([-angle]))[0]
    plane = arm.curves(back @ R, back @ p).plane
    return [back.T @ arm.canonical.B @ v for v in (plane.u, plane.r, plane.t)]


def test_the_arm_plane_is_carried_along_by_the_smallest_rotation(arm):
    """Against that rotation itself, over platform angles up to 0.8 rad to either side."""
    random = np.random.default_rng(26)
    for _ in range(40):
        R, p = arm.forward(random.uniform(np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0)))
        middle, turn = random.uniform(-0.2, 0.2), random.uniform(-0.8, 0.8, 1)
        then, now = (_plane(arm, R, p, x) for x in (middle, middle + float(turn[0])))
        if then[0] @ now[0] < -0.9:
            continue
        carried = smallest_rotation(then[0], now[0]) @ then[1]
        found = in_numpy._carried_along(
            *(in_numpy._directions(arm, R, p, x + np.zeros(1)) for x in (middle, middle + turn)),
            turn,
        )
        expected = np.arctan2(carried @ now[2], carried @ now[1])
        assert np.mod(found[0] - expected + 1.0, 2.0 * np.pi) == pytest.approx(1.0, abs=1e-9)


def holds(known: Range, values: np.ndarray, slack: float) -> np.ndarray:
    """Whether ranges hold numbers, give or take; ranges that tell nothing hold any."""
    away = np.abs(values - known.middle)
    return ~(away > known.radius + slack)


def test_ranges_hold_what_their_numbers_give():
    """Random ranges and numbers in them, at the ends as well: sums, products, squares, reciprocals, roots, hulls."""
    random = np.random.default_rng(31)
    a, b = (Range(random.normal(size=400), random.uniform(0.0, 1.0, 400)) for _ in range(2))
    for _ in range(20):
        x, y = (r.middle + r.radius * random.choice([-1.0, 1.0, 0.3], 400) for r in (a, b))
        assert holds(a + b, x + y, 1e-12).all()
        assert holds(a * b, x * y, 1e-12).all()
        assert holds(a.square(), x * x, 1e-12).all()
        assert holds(a.complement(), 1.0 - x, 1e-12).all()
        assert holds(a.scaled(-3.0), -3.0 * x, 1e-12).all()
        assert holds(a.inverse(), 1.0 / x, 1e-9 / np.abs(x).min() ** 2).all()
        assert holds(a.root(), np.sqrt(np.maximum(x, 0.0)), 1e-12).all()
        assert (holds(a.hull(b), x, 1e-12) & holds(a.hull(b), y, 1e-12)).all()


def test_jets_have_the_derivatives_of_differences():
    """Products, reciprocals and roots of a + p cos + q sin, by central differences, over and about narrow intervals."""
    random = np.random.default_rng(32)
    h, n = 1e-3, 200
    low = random.uniform(-3.0, 3.0, n)
    cells = AngleCells(np.arange(n), low, low + random.choice([0.0, 0.1], n))
    rows = [(random.uniform(2.5, 4.0, n), *random.uniform(-0.9, 0.9, (2, n))) for _ in range(2)]
    one, other = (turning(cells, *row) for row in rows)
    made = {
        "product": (one * other, lambda x, y: x * y),
        "reciprocal": (one.inverse(), lambda x, y: 1.0 / x),
        "root": (one.root(), lambda x, y: np.sqrt(x)),
        "all": (
            (one * other).root() * other.inverse() + one.scaled(-2.0),
            lambda x, y: np.sqrt(x * y) / y - 2.0 * x,
        ),
    }
    for share in (0.0, 0.4, 1.0):
        phi = cells.low + share * (cells.high - cells.low)
        at = [
            [row[0] + row[1] * np.cos(phi + d) + row[2] * np.sin(phi + d) for row in rows]
            for d in (-h, 0.0, h)
        ]
        for jet, function in made.values():
            before, here, after = (function(*x) for x in at)
            assert holds(jet.value, here, 1e-12).all()
            assert holds(jet.first, (after - before) / (2.0 * h), 1e-5).all()
            assert holds(jet.second, (after - 2.0 * here + before) / h**2, 1e-4).all()
    still = cells.high == cells.low
    for jet, _ in made.values():
        assert max(x.radius[still].max() for x in (jet.value, jet.first, jet.second)) < 1e-12


@pytest.mark.parametrize(("width", "parts"), [(0.2, 20), (0.05, 60), (0.01, 200)])
def test_second_derivatives_are_those_of_differences(arm, width, parts):
    """Joints in the plane that is carried along, by differences at random places of each box, away from poles."""
    random = np.random.default_rng(33)
    step, told, tight = 2e-3, 0, []
    for _ in range(6):
        R, p = arm.forward(random.uniform(np.maximum(arm.lower, -2.4), np.minimum(arm.upper, 2.4)))
        cell = one_cell(-0.5 * width, 0.5 * width)
        bends = in_numpy.bends_of(arm, in_numpy.shape_of(arm, R, p, cell), half(cell), parts)
        for k in random.integers(0, parts, 12):
            phi = random.uniform(cell.low[0], cell.high[0])
            psi = -np.pi + 2.0 * np.pi * (k + random.random()) / parts

            def joints(phi: float, psi: float) -> np.ndarray:
                return carried_joints(arm, R, p, phi, psi)  # noqa: B023

            here = joints(phi, psi)
            if np.sin(here[[1, 3, 5]]).min() < 0.2:
                continue
            for d, (by_phi, by_psi) in enumerate([(step, 0.0), (0.0, step)]):
                ends = [joints(phi + s * by_phi, psi + s * by_psi) - here for s in (-1.0, 1.0)]
                ends = [x - 2.0 * np.pi * np.round(x / (2.0 * np.pi)) for x in ends]
                second = (ends[0] + ends[1]) / step**2
                known = Range(bends.second[d].middle[:, 0, k], bends.second[d].radius[:, 0, k])
                assert holds(known, second, 2e-3 * (1.0 + np.abs(second))).all(), (d, k)
                told += int(bends.smooth[:, 0, k].sum())
                tight.append(known.radius)
    assert told > 100
    # What is not known of them shrinks with the boxes.
    assert np.median(np.nan_to_num(tight, nan=np.inf)) < 40.0 * (width + 2.0 * np.pi / parts)


def carried_joints(arm: SrsArm, R: np.ndarray, p: np.ndarray, phi: float, psi: float) -> np.ndarray:
    """Joints, of 2, 4 and 6 the positive angles, with psi counted from the plane carried along from phi = 0."""
    then, now = (_plane(arm, R, p, x) for x in (0.0, phi))
    carried = smallest_rotation(then[0], now[0]) @ then[1]
    angle = psi + np.arctan2(carried @ now[2], carried @ now[1])
    back = rotation_z(np.array([-phi]))[0]
    curves = arm.curves(back @ R, back @ p)
    return np.array(curves.angles(np.sin(angle), np.cos(angle)))


@pytest.mark.parametrize(("width", "parts"), [(0.4, 9), (0.1, 18), (0.02, 72)])
def test_every_joint_lies_in_its_span(arm, width, parts):
    """Cell by cell, at random places and at the edges, and the span of neighbours along the circle alike."""
    random = np.random.default_rng(22)
    narrow, told = [], 0
    for _ in range(4):
        R, p = arm.forward(random.uniform(np.maximum(arm.lower, -2.8), np.minimum(arm.upper, 2.8)))
        cell = one_cell(-0.5 * width, 0.5 * width)
        if not len(reachable_cells(arm, arm.wrist_center(R, p), np.array([-3.0, 3.0])).index):
            continue
        corners = in_numpy._corners(arm, R, p, cell, parts)
        bends = in_numpy.bends_of(arm, in_numpy.shape_of(arm, R, p, cell), half(cell), parts)
        low, high = in_numpy.spans_of(corners, bends, (half(cell), np.pi / parts))[:, :, 0]
        for _ in range(150):
            k = int(random.integers(0, parts))
            share = random.choice([0.0, 1.0, random.random()], 2)
            phi = float(cell.low[0] + share[0] * width)
            turn = rotation_z(np.array([-phi]))[0]
            if arm.reach_miss(turn @ R, turn @ p) > 0.0:
                continue
            q = carried_joints(arm, R, p, phi, -np.pi + 2.0 * np.pi * (k + share[1]) / parts)
            known = high[:, k] - low[:, k] < 2.0 * np.pi
            beyond = np.mod((q - low[:, k] + 1e-6)[known], 2.0 * np.pi)
            assert (beyond <= (high[:, k] - low[:, k] + 2e-6)[known]).all(), (k, phi)
            told += int(known.sum())
        narrow.append((high - low).ravel() < 2.5 * (width + 6.3 / parts))
    assert told > 1000
    if width < 0.05:
        # Away from poles a joint turns about as far as platform and arm angle do together.
        assert np.concatenate(narrow).mean() > 0.8


def test_spans_shrink_to_the_corners_with_the_square_of_their_cells(arm):
    """What is beyond the corners' own range is a quarter in cells of half the size; at least nearly."""
    random = np.random.default_rng(23)
    beyond = []
    for _ in range(8):
        R, p = arm.forward(random.uniform(np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0)))
        row = []
        for width, parts in ((0.04, 80), (0.02, 160)):
            cell = one_cell(-0.5 * width, 0.5 * width)
            corners = in_numpy._corners(arm, R, p, cell, parts)
            bends = in_numpy.bends_of(arm, in_numpy.shape_of(arm, R, p, cell), half(cell), parts)
            low, high = in_numpy.spans_of(corners, bends, (half(cell), np.pi / parts))[:, :, 0]
            step = np.diff(corners[:, :, 0], axis=0)
            step -= 2.0 * np.pi * np.round(step / (2.0 * np.pi))
            own = np.ptp(np.concatenate([0.0 * step[:1], np.cumsum(step, axis=0)]), axis=0)
            row.append(np.median(high - low - own))
        beyond.append(row)
    coarse, fine = np.median(np.array(beyond), axis=0)
    assert fine < 0.35 * coarse
    assert coarse < 0.01


def test_cells_of_the_platform_are_as_many_as_their_width_asks_for(
    random_problem: Problems,
) -> None:
    """No wider than asked, none more than needed: 5.934 rad by 1 rad are six."""
    problem = random_problem(0, (1, 1))
    low, high = problem.platform_range
    for step in (0.1, 0.3, 1.0, (high - low) / 4.0, 2.0 * (high - low)):
        edges = platform_edges(problem, step)
        assert (edges[0], edges[-1]) == pytest.approx((low, high))
        assert np.diff(edges).max() <= step * (1.0 + 1e-9)
        assert (len(edges) - 2) * step < high - low


def test_out_of_reach_there_is_no_cell(arm):
    """Above the platform's axis, far out, and where nothing turns."""
    edges = np.linspace(-1.0, 1.0, 5)
    for wrist, grid in (
        (np.array([0.0, 0.0, 9.0]), edges),
        (np.array([9.0, 0.0, 0.5]), edges),
        (np.array([9.0, 0.0, 0.5]), np.zeros(2)),
    ):
        cells = reachable_cells(arm, wrist, grid)
        assert [len(x) for x in (cells.index, cells.low, cells.high)] == [0, 0, 0]


def test_cells_are_merged_where_turns_and_branch_are_the_same():
    """Of one part of the circle: what is within 2 rad is one cell, what is farther off another turn."""
    joint = np.array([0.1, 0.2, 3.0, -3.0, 0.1, 3.0, 0.0, 1.2, 0.6])
    kind = np.array([0, 0, 1, 1, 2, 3, 3, 4, 4])
    rest = np.zeros((9, 7))
    cells = Cells(
        np.zeros(9, dtype=np.int64),
        kind,
        np.column_stack([joint - 0.05, rest]),
        np.column_stack([joint + 0.05, rest]),
        np.zeros(9),
    )
    found = in_numpy._merged(cells, np.zeros(9, dtype=np.int64)).cells
    rows = sorted(zip(found.kind, found.low[:, 0], found.high[:, 0], strict=True))
    expected = [
        [0, 0.05, 0.25],
        [1, -3.05, -2.95],
        [1, 2.95, 3.05],
        [2, 0.05, 0.15],
        [3, -0.05, 0.05],
        [3, 2.95, 3.05],
        [4, 0.55, 1.25],
    ]
    assert np.array(rows) == pytest.approx(np.array(expected))


def floor(intervals: AngleCells) -> np.ndarray:
    return 0.02 * (np.arange(len(intervals.index)) % 20)


@pytest.mark.parametrize("free_last", [False, True])
@pytest.mark.parametrize("finer", [1, 3])
@pytest.mark.parametrize("line", [False, True])
def test_compiled_cells_are_those_of_numpy(arm, finer, free_last, line):
    """Random poses, also at the ends of the reach and with a stretched arm: the same cells and lines, in order."""
    random = np.random.default_rng(41)
    edges = np.linspace(-1.5, 1.5, 7)
    resolution = Resolution(0.5, 9 if finer == 1 else 4, finer)
    law = RestToRest(random.uniform(1.0, 4.0, 7), random.uniform(3.0, 12.0, 7), np.full(7, 90.0))
    told = 0.0
    for trial in range(3):
        q = random.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi))
        if trial % 3 == 1:
            q[3] = (1e-3, 1e-6, 0.0)[trial % 4 % 3]
        R, p = arm.forward(q)
        to = LineToTarget(p + 0.1 * R[:, trial % 3], law, floor) if line else None
        within = in_numpy.within_reach(arm, R, p, edges, resolution)
        found, expected = (
            make(arm, (R, p), within, resolution, free_last, to)
            for make in (pose_cells, in_numpy.pose_cells)
        )
        assert np.array_equal(found.index, expected.index)
        assert np.array_equal(found.kind, expected.kind)
        assert np.allclose(found.line, expected.line, rtol=0.0, atol=1e-4)
        told += found.line.sum()
        for name in ("low", "high"):
            assert np.allclose(getattr(found, name), getattr(expected, name), atol=1e-7)
    assert (told > 0.0) == line
