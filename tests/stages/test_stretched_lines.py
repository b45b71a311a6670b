"""The geometric bound of lines of stretched arms, and the distances and angles that it rests on: by samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

from dualarm_cli.bound import stretched_lines
from dualarm_cli.bound.stretched_lines import _variation, line_bounds
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.postures.platform_reach import (
    AngleCells,
    turned,
    wrist_distances,
)
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem
from tests.posture_cells_numpy import one_cell

Problems = Callable[..., SequenceProblem]


@pytest.fixture(autouse=True)
def everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound of all arms, not only of those that are nearly stretched."""
    monkeypatch.setattr(stretched_lines, "STRETCHED", 0.0)


@pytest.mark.parametrize("own", [0.2, 0.3, 0.45])
def test_a_link_s_angle_to_the_line_is_bounded_by_the_law_of_cosines(own):
    """Links of different lengths, so that the angle may pass a right one, and turn: by samples."""
    other, random = 0.3, np.random.default_rng(25)
    for _ in range(60):
        near, far = np.sort(random.uniform(abs(own - other) + 0.01, own + other - 0.01, 2))
        r = np.linspace(near, far, 4001)
        angle = np.arccos((r * r + own**2 - other**2) / (2.0 * own * r))
        for passes in (False, True):
            varies, most = _variation(
                own, other, np.array([near]), np.array([far]), np.array([passes])
            )
            swept = np.abs(np.diff(angle)).sum() * (1 + passes)
            turns = 0 < angle.argmax() < 4000
            assert most[0] == pytest.approx(np.sin(angle).max(), abs=1e-5)
            assert swept <= varies[0] + 1e-6
            assert varies[0] <= np.ptp(angle) * (1 + passes) * (1 + turns) + 1e-6


def test_distances_stay_within_their_bounds(arm) -> None:
    """Shoulder-wrist distance at many angles of wide intervals, the nearest and the farthest of all in their middle."""
    random, told = np.random.default_rng(5), 0
    radius = np.hypot(*arm.geometry.shoulder[:2])
    for trial in range(40):
        edges = np.linspace(-3.0, 3.0, (8, 20, 60)[trial % 3])
        cells = AngleCells(np.arange(len(edges) - 1), edges[:-1], edges[1:])
        wrist = arm.geometry.shoulder + random.normal(scale=0.35 * arm.reach[1], size=3)
        least, most = wrist_distances(arm, wrist, cells)
        phi = cells.low + np.linspace(0.0, 1.0, 101)[:, None] * (cells.high - cells.low)
        gaps = np.array(
            [np.linalg.norm(turned(wrist, row) - arm.geometry.shoulder, axis=1) for row in phi]
        )
        inside = (gaps >= arm.reach[0]) & (gaps <= arm.reach[1])
        assert ((gaps >= least - 1e-9) | ~inside).all()
        assert ((gaps <= most + 1e-9) | ~inside).all()
        samples, every = gaps[[0, 50, 100]], inside.all(axis=0)
        assert (gaps.min(axis=0) - least <= 0.5 * radius * cells.half + 1e-6)[every].all()
        told += int((gaps.min(axis=0) < samples.min(axis=0) - 1e-4)[every].sum())
        told += int((gaps.max(axis=0) > samples.max(axis=0) + 1e-4)[every].sum())
    assert told > 10 or radius == 0.0


def test_a_line_over_an_interval_takes_no_longer_than_at_any_angle_in_it(
    random_problem: Problems,
) -> None:
    """Wide intervals against single angles, for random lines in all directions, also close by the shoulder."""
    work = random_problem(0, (1, 1)).arms[0]
    arm = work.kinematics
    random = np.random.default_rng(12)
    told = 0
    for _ in range(60):
        R = pin.SE3.Random().rotation
        wrist = arm.geometry.shoulder + random.normal(scale=0.35, size=3)
        end = wrist + 0.08 * (lambda v: v / np.linalg.norm(v))(random.normal(size=3))
        middle, half = random.uniform(-2.0, 2.0), random.choice([0.003, 0.02, 0.1])
        whole = AngleCells(
            np.zeros(1, dtype=np.int64), np.array([middle - half]), np.array([middle + half])
        )
        phi = np.linspace(middle - half, middle + half, 41)
        points = AngleCells(np.zeros(41, dtype=np.int64), phi, phi)
        away = [
            np.linalg.norm(rotation_z(-phi) @ x - arm.geometry.shoulder, axis=1)
            for x in (wrist, end)
        ]
        inside = np.all([(x > arm.reach[0]) & (x < arm.reach[1]) for x in away], axis=0)
        if inside.any():
            bound = line_bounds(work, R, wrist, end, whole)[0]
            assert bound <= line_bounds(work, R, wrist, end, points)[inside].min() + 1e-3
            told += bound > 0.1
    assert told > 10


def exact_line(work: ArmWork, R: np.ndarray, a: np.ndarray, b: np.ndarray, phi: float) -> float:
    """The bound of a line at one platform angle, term by term from its description, everything by samples."""
    geometry = work.kinematics.geometry
    back = rotation_z(np.array([-phi]))[0]
    v, w = back @ a - geometry.shoulder, back @ b - geometry.shoulder
    way = v + np.linspace(0.0, 1.0, 4001)[:, None] * (w - v)
    r = np.linalg.norm(way, axis=1)
    beta = np.arccos(np.clip(v @ w / np.linalg.norm(v) / np.linalg.norm(w), -1.0, 1.0))
    axis = np.cross(v, w) / np.linalg.norm(np.cross(v, w))
    passes = 2.0 if 0 < r.argmin() < 4000 else 1.0
    r = np.linspace(r.min(), r.max(), 4001)

    def duration(asked: Callable[[np.ndarray], float]) -> float:
        def lacks(time: float) -> float:
            return asked(work.law.reachable_distance(np.array([time])))

        return 0.0 if lacks(1e-6) >= 0.0 else brentq(lacks, 1e-6, 60.0, xtol=1e-6)

    times = []
    for one, other, outer, joints in (
        (geometry.upper, geometry.fore, geometry.axes[0], [0, 1, 2]),
        (
            geometry.fore,
            geometry.upper,
            back @ R @ geometry.R_flange.T @ geometry.axes[6],
            [6, 5, 4],
        ),
    ):
        angle = np.arccos(np.clip((r * r + one**2 - other**2) / (2.0 * one * r), -1.0, 1.0))
        turns = 2.0 if 0 < angle.argmax() < 4000 else 1.0
        varies = passes * turns * (angle.max() - angle.min())
        first = abs(axis @ outer)
        shares = np.array([first, np.sqrt(1.0 - first**2), np.sin(angle).max()])
        times.append(duration(lambda d, s=shares, j=joints, x=beta - varies: s @ d.ravel()[j] - x))
    bends = [
        np.arccos(
            (x @ x - geometry.upper**2 - geometry.fore**2) / (2 * geometry.upper * geometry.fore)
        )
        for x in (v, w)
    ]
    times.append(duration(lambda d: d.ravel()[3] - abs(bends[0] - bends[1])))
    return max(times)


def test_a_line_at_one_angle_takes_what_its_description_says(random_problem: Problems) -> None:
    """Radial and tangential lines, some past the foot of the shoulder's height: by samples and a root finder."""
    work = random_problem(0, (1, 1)).arms[0]
    arm, random = work.kinematics, np.random.default_rng(24)
    upper, fore = arm.geometry.upper, arm.geometry.fore
    limits, passed = np.array(arm.reach), 0
    for trial in range(80):
        R, phi = pin.SE3.Random().rotation, random.uniform(-2.0, 2.0)
        turn = rotation_z(np.array([phi]))[0]
        out, side = random.normal(size=(2, 3))
        out /= np.linalg.norm(out)
        side = np.cross(out, side)
        side /= np.linalg.norm(side)
        distance = random.uniform(max(limits[0], 0.3 * (upper + fore)), 0.93 * limits[1])
        length = random.uniform(0.02, 0.3) * distance
        start = distance * out
        end = start + length * (
            side if trial % 3 else random.choice([-1.0, 1.0]) * (out + 0.05 * side)
        )
        if trial % 3:
            # Before the foot of the shoulder's height, or behind it.
            shift = (0.05, -random.uniform(0.2, 0.6))[trial % 3 - 1]
            start = start + shift * length * side
        reach = [np.linalg.norm(x) for x in (start, end)]
        if max(reach) > 0.97 * limits[1] or min(reach) < limits[0] + 0.02:
            continue
        ends = [turn @ (arm.geometry.shoulder + x) for x in (start, end)]
        bound = float(line_bounds(work, R, *ends, one_cell(phi, phi))[0])
        assert bound == pytest.approx(exact_line(work, R, *ends, phi), rel=3e-3, abs=2e-3)
        near = line_bounds(work, R, *ends, one_cell(phi - 1e-4, phi + 1e-4))[0]
        assert 0.9 * bound - 0.005 <= near <= bound + 1e-3
        passed += 1
    assert passed > 40


def test_only_nearly_stretched_arms_have_a_bound(monkeypatch, random_problem: Problems) -> None:
    """The same lines with the limit at its value: the same bound beyond it, 0 s within."""
    work = random_problem(0, (1, 1)).arms[0]
    arm, random = work.kinematics, np.random.default_rng(34)
    R, phi = pin.SE3.Random().rotation, np.linspace(-0.4, 0.4, 9)
    cells = AngleCells(np.arange(8), phi[:-1], phi[1:])
    for share in (0.5, 0.99):
        away = random.normal(size=3)
        wrist = arm.geometry.shoulder + share * arm.reach[1] * away / np.linalg.norm(away)
        end = wrist + 0.05 * np.cross(away, [1.0, 0.0, 0.0]) / np.linalg.norm(away)
        monkeypatch.setattr(stretched_lines, "STRETCHED", 0.0)
        every = line_bounds(work, R, wrist, end, cells)
        monkeypatch.setattr(stretched_lines, "STRETCHED", 0.95)
        some = line_bounds(work, R, wrist, end, cells)
        assert ((some == every) | (some == 0.0)).all()
        assert some[3:5].any() == (share == 0.99)
