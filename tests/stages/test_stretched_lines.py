"""The geometric bound of lines, and the rates of the arm's shape that it rests on: by differences and samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

from dualarm_cli.bound import stretched_lines
from dualarm_cli.bound.stretched_lines import _variation, line_bounds
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import (
    AngleCells,
    _bend_rates,
    reachable_cells,
    shape_rates,
    turned,
)
from dualarm_cli.stages.plans.problem import ArmWork, SequenceProblem
from tests.posture_cells_numpy import one_cell, smallest_rotation

Problems = Callable[..., SequenceProblem]


@pytest.fixture(autouse=True)
def everywhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bound of all arms, not only of those that are nearly stretched."""
    monkeypatch.setattr(stretched_lines, "STRETCHED", 0.0)


def link_frames(
    arm: SrsArm, wrist: np.ndarray, middle: float, phi: float, psi: float
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Upper arm's frame in the carried one, forearm's in the world, sines of both links' angles to the line.

    In the world: the shoulder goes round, the wrist stands, the elbow's direction at the middle is carried along by the
    smallest rotation of the line between them.
    """
    upper, fore = arm.geometry.upper, arm.geometry.fore

    def line(angle: float) -> np.ndarray:
        return wrist - rotation_z(np.array([angle]))[0] @ arm.geometry.shoulder

    start, now = line(middle), line(phi)
    r = float(np.linalg.norm(now))
    u0, u = start / np.linalg.norm(start), now / r
    beside = np.cross(u0, [0.3, 0.5, 0.8])
    beside /= np.linalg.norm(beside)
    e0 = np.cos(psi) * beside + np.sin(psi) * np.cross(u0, beside)
    e = smallest_rotation(u0, u) @ e0
    alpha = np.arccos((r * r + upper**2 - fore**2) / (2.0 * r * upper))
    gamma = np.arccos((r * r + fore**2 - upper**2) / (2.0 * r * fore))
    frames = []
    for angle in (alpha, -gamma):
        along = np.cos(angle) * u + np.sin(angle) * e
        frames.append(np.column_stack([along, np.cross(u, e), np.cross(along, np.cross(u, e))]))
    back = rotation_z(np.array([-phi]))[0]
    return back @ frames[0], frames[1], float(np.sin(alpha)), float(np.sin(gamma))


def test_rates_of_the_arm_s_shape_are_those_of_differences(arm):
    """Frames of both links by differences: never faster than said; on narrow intervals nearly as fast at worst."""
    random = np.random.default_rng(21)
    h, tight = 1e-4, []
    for trial in range(30):
        least, most = arm.reach
        away = random.normal(size=3)
        distance = least + (most - least) * random.uniform(0.1, 0.97)
        wrist = arm.geometry.shoulder + away * (distance / np.linalg.norm(away))
        half = (0.001, 0.02, 0.08)[trial % 3]
        cell = one_cell(-half, half)
        rates = shape_rates(arm, wrist, cell)
        if not np.isfinite(rates.shoulder_first[0]):
            continue
        largest = np.zeros(6)
        for phi in np.linspace(-half, half, 3):
            r = np.linalg.norm(turned(wrist, np.array([phi]))[0] - arm.geometry.shoulder)
            if not least + 1e-3 < r < most - 1e-3:
                continue
            for psi in np.linspace(-np.pi, np.pi, 6, endpoint=False):
                three = [link_frames(arm, wrist, 0.0, phi + d, psi) for d in (-h, 0.0, h)]
                row = []
                for k in (0, 1):
                    before, here, ahead = (one[k] for one in three)
                    row.append(np.linalg.norm(pin.log3(before.T @ ahead)) / (2.0 * h))
                    row.append(np.linalg.norm((ahead - 2.0 * here + before) / h**2, 2))
                largest = np.maximum(largest, [*row, *three[1][2:]])
        bound = np.array(
            [
                rates.shoulder_first[0],
                rates.shoulder_second[0],
                rates.wrist_first[0],
                rates.wrist_second[0],
                rates.sin_upper[0],
                rates.sin_fore[0],
            ]
        )
        assert (largest <= bound * (1.0 + 1e-5) + 1e-5).all()
        if half < 0.002 and largest[4] > 0.2 and largest[5] > 0.2:
            tight.append(largest / np.maximum(bound, 1e-12))
    share = np.median(np.array(tight), axis=0)
    # First rates are sums of sizes of vectors that may point elsewhere; sines are exact.
    assert share[0] > 0.6
    assert share[4:] == pytest.approx(1.0, abs=0.02)


def test_second_rates_hold_for_the_worst_course_of_the_shoulder_wrist_line(arm):
    """Direction u at the interval's end, u' and u'' as long as may be, turned so that all terms add up.

    The line's frame turns with (u_c + u) x u' / (1 + u_c.u); seen from the platform it also turns with that, by 1.
    """
    R0 = float(np.hypot(*arm.geometry.shoulder[:2]))
    upper, fore = arm.geometry.upper, arm.geometry.fore
    wrist = arm.geometry.shoulder + np.array([0.0, 0.0, -0.6 * (upper + fore)])
    for half in (0.01, 0.1, 0.3):
        rates = shape_rates(arm, wrist, one_cell(-half, half))
        low, high = rates.distance_low, rates.distance_high
        r_2 = R0 + R0**2 / low
        upper_1, upper_2, _ = _bend_rates(upper, fore, low, high, R0, r_2)
        fore_1, fore_2, _ = _bend_rates(fore, upper, low, high, R0, r_2)
        spin = rates.wrist_first - fore_1
        spin_2 = rates.wrist_second - fore_2 - fore_1 * spin - rates.wrist_first**2
        a = R0 / float(low[0])
        a_2, theta = 2.0 * a + 3.0 * a**2, a * half
        u_c, u = np.array([0.0, 0.0, 1.0]), np.array([np.sin(theta), 0.0, np.cos(theta)])
        across = np.array([np.cos(theta), 0.0, -np.sin(theta)])
        both, scale = u_c + u, 1.0 + u_c @ u
        worst = [
            np.cross(both, a * np.array([0.0, 1.0, 0.0])) / scale,
            np.cross(both, a_2 * np.cross([0.0, 1.0, 0.0], both) / np.linalg.norm(both)) / scale,
            (u_c @ (a * across)) * np.cross(both, a * across) / scale**2,
        ]
        first, second, third = (float(np.linalg.norm(x)) for x in worst)
        assert spin[0] == pytest.approx(first)
        assert second + third <= spin_2[0] * (1.0 + 1e-9)
        assert spin_2[0] <= second + third / np.cos(0.5 * theta) + 1e-9
        carried = rates.shoulder_first - upper_1
        assert carried[0] == pytest.approx(first + 1.0)
        carried_2 = rates.shoulder_second - upper_2 - upper_1 * carried - rates.shoulder_first**2
        assert carried_2[0] == pytest.approx(float(spin_2[0]) + first)


@pytest.mark.parametrize("own", [0.2, 0.3, 0.45])
def test_a_link_s_angle_to_the_line_is_bounded_by_the_law_of_cosines(own):
    """Links of different lengths, so that the angle may pass a right one, and turn: by samples and differences."""
    other, random = 0.3, np.random.default_rng(25)
    for _ in range(60):
        near, far = np.sort(random.uniform(abs(own - other) + 0.01, own + other - 0.01, 2))
        r = np.linspace(near, far, 4001)
        angle = np.arccos((r * r + own**2 - other**2) / (2.0 * own * r))
        slope = np.gradient(angle, r, edge_order=2)
        bend = np.gradient(slope, r, edge_order=2)
        one, two, sine = _bend_rates(own, other, *np.array([[near], [far]]), 0.2, np.array([0.7]))
        assert sine[0] == pytest.approx(np.sin(angle).max(), abs=1e-5)
        assert 0.2 * np.abs(slope).max() <= one[0] * (1.0 + 1e-3)
        assert (0.04 * np.abs(bend) + 0.7 * np.abs(slope)).max() <= two[0] * (1.0 + 1e-2)
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
    """Shoulder-wrist distance at many angles of each interval."""
    random = np.random.default_rng(5)
    edges = np.linspace(-3.0, 3.0, 20)
    wrist = arm.geometry.shoulder + random.normal(scale=0.3, size=3)
    cells = reachable_cells(arm, wrist, edges)
    rates = shape_rates(arm, wrist, cells)
    for share in np.linspace(0.0, 1.0, 21):
        phi = cells.low + share * (cells.high - cells.low)
        gap = np.linalg.norm(turned(wrist, phi) - arm.geometry.shoulder, axis=1)
        assert (gap >= rates.distance_low - 1e-9).all()
        assert (gap <= rates.distance_high + 1e-9).all()


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
