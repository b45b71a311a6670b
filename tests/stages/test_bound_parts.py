"""The parts of the lower bound one by one: rates by differences, enclosures by samples, lines by their own formula."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from scipy.optimize import brentq

from dualarm_cli.bound.bound import platform_edges
from dualarm_cli.bound.cells import Cells, pose_cells
from dualarm_cli.bound.layers import _variation, line_bounds
from dualarm_cli.effort import Resolution
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.platform_chain import rotation_z
from dualarm_cli.kinematics.srs.arm_angle_curves import flips
from dualarm_cli.kinematics.srs.srs_arm import SrsArm
from dualarm_cli.postures.platform_reach import (
    AngleCells,
    _bend_rates,
    reachable_cells,
    shape_rates,
    turned,
)
from dualarm_cli.stages.search.problem import ArmWork, SequenceProblem
from tests import posture_cells_numpy as in_numpy

Problems = Callable[..., SequenceProblem]


@pytest.fixture(scope="module", params=["sda10f", "iiwa7", "bottin_planar"])
def arm(request, tmp_path_factory) -> SrsArm:
    """The first arm of a bundled robot, its shoulder 0.2 m and more beside the platform's axis."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {request.param}\n")
    cell = load_cell(folder / "cell.yaml").cell
    return next(iter(CellModel.from_cell(cell).arms.values())).kinematics


def one_cell(low: float, high: float) -> AngleCells:
    return AngleCells(np.zeros(1, dtype=np.int64), np.array([low]), np.array([high]))


def smallest_rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The rotation about a × b that takes the unit vector a to b."""
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-15:
        return np.eye(3)
    return pin.exp3(axis / sine * np.arctan2(sine, float(a @ b)))


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


@pytest.mark.parametrize(("width", "parts"), [(0.4, 9), (0.1, 18), (0.02, 72)])
def test_every_joint_lies_in_its_enclosure(arm, width, parts):
    """Cell by cell, with arm angles counted from the plane that is carried along by the smallest rotation."""
    random = np.random.default_rng(22)
    narrow, told = [], 0
    for _ in range(2):
        q = random.uniform(np.maximum(arm.lower, -2.8), np.minimum(arm.upper, 2.8))
        R, p = arm.forward(q)
        wrist = arm.wrist_center(R, p)
        every = reachable_cells(arm, wrist, np.linspace(-0.5, 0.5, int(1.0 / width) + 1))
        found = in_numpy.enclosures(arm, R, p, every, shape_rates(arm, wrist, every), parts)
        cell = random.integers(0, len(every.index), 150)
        share = random.choice([0.0, 0.5, 1.0], 150) + random.uniform(-1e-3, 1e-3, 150)
        share = np.where(random.random(150) < 0.5, np.clip(share, 0.0, 1.0), random.random(150))
        phi = every.low[cell] + share * (every.high - every.low)[cell]
        psi = random.uniform(-np.pi, np.pi, 150)
        turn = rotation_z(-phi)
        solved = arm.solve(turn @ R, turn @ p, psi)
        for k in np.flatnonzero(solved.reachable):
            c = int(cell[k])
            middle = float(every.middle[c])
            then, now = (_plane(arm, R, p, angle) for angle in (middle, float(phi[k])))
            carried = smallest_rotation(then[0], now[0]) @ then[1]
            shift = np.arctan2(carried @ now[2], carried @ now[1])
            part = int(np.floor((psi[k] - shift + np.pi) / (2.0 * np.pi) * parts)) % parts
            for joint in range(7):
                flip = flips(joint, np.arange(8)).astype(int)
                last = 0 if joint == 3 else part
                low = found.low[joint, flip, c, last]
                high = found.high[joint, flip, c, last]
                known = high - low < 2.0 * np.pi
                beyond = np.mod((solved.q[k, :, joint] - low + 1e-6)[known], 2.0 * np.pi)
                assert (beyond <= (high - low + 2e-6)[known]).all(), (joint, c, part)
                told += int(known.sum())
        narrow.append(
            np.isfinite(found.low) & (found.high - found.low < 2.5 * (width + 6.3 / parts))
        )
    assert told > 2000
    if width < 0.05:
        # Away from poles a joint turns about as far as platform and arm angle do together.
        assert np.concatenate([x.ravel() for x in narrow]).mean() > 0.8


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


def test_azimuths_and_sines_within_a_cap_are_those_of_its_rim():
    """Rims of caps about the corner nearest to a pole, point by point; over a pole nothing is known."""
    random = np.random.default_rng(27)
    theta, away = random.uniform(0.05, np.pi - 0.05, (4, 60, 1)), random.uniform(0.01, 1.2, (60, 1))
    cap = in_numpy._cap(theta, away)
    sine = in_numpy._least_sine(theta, away)
    round_it = np.linspace(0.0, 2.0 * np.pi, 3601)
    for k in range(60):
        pole = np.minimum(theta[:, k, 0], np.pi - theta[:, k, 0]).min()
        radius = away[k, 0]
        if radius >= pole:
            assert (cap[k, 0], sine[k, 0]) == (np.inf, 0.0)
            continue
        c, s = np.cos(pole), np.sin(pole)
        x = np.sin(radius) * np.cos(round_it) * c + np.cos(radius) * s
        y = np.sin(radius) * np.sin(round_it)
        assert cap[k, 0] == pytest.approx(np.arctan2(y, x).max(), abs=1e-5)
        polar = [theta[:, k, 0].min() - radius, theta[:, k, 0].max() + radius]
        assert sine[k, 0] == pytest.approx(np.sin(np.linspace(*polar, 500)).min())


@pytest.mark.parametrize("pole", [0.0, np.pi])
@pytest.mark.parametrize(("near", "told"), [(0.9e-3, False), (1.1e-3, True), (-0.2, False)])
def test_near_a_pole_nothing_is_divided_by_a_sine(pole, near, told):
    """A vector that may come within a thousandth of the pole, or over it: no sine; nor a cap about a corner there."""
    towards = 1.0 if pole == 0.0 else -1.0
    theta, away = np.full((4, 1, 1), np.pi / 2), np.full((1, 1), 0.3)
    theta[1] = pole + towards * (near + 0.3)
    sine = in_numpy._least_sine(theta, away)[0, 0]
    assert sine == (pytest.approx(np.sin(near)) if told else 0.0)
    theta[1], away = pole + towards * abs(near), np.full((1, 1), 1e-5)
    cap = in_numpy._cap(theta, away)[0, 0]
    known = np.arcsin(np.sin(1e-5) / np.sin(abs(near)))
    assert cap == (np.inf if near == 0.9e-3 else pytest.approx(known))


@pytest.mark.parametrize("parts", [24, 90])
def test_at_one_platform_angle_the_elbow_s_circle_alone_widens_enclosures(arm, parts):
    """A vector on a circle of radius b has a first rate of b and a second one of b, its frame one of 1 and 1.

    With the half-width h, the least sine s and the nearest corner's polar angle theta, a polar angle is within
    min(b h, (b + b²) h² / 2s) of its corners', an azimuth within that of r h / s, asin(sin r h / sin theta)
    and (r / s + 2 r² / s²) h² / 2, where r is b or 1.
    """
    random = np.random.default_rng(28)
    h, told = np.pi / parts, 0
    for _ in range(6):
        R, p = arm.forward(random.uniform(np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0)))
        cell = one_cell(0.0, 0.0)
        rates = shape_rates(arm, arm.wrist_center(R, p), cell)
        found = in_numpy.enclosures(arm, R, p, cell, rates, parts)
        curves = arm.curves(R, p)
        edges = np.linspace(-np.pi, np.pi, parts + 1)
        corners = np.abs(np.array(curves.angles(np.sin(edges), np.cos(edges)))[[1, 5]])
        for (outer, middle, along), theta, b in (
            ((0, 1, 2), corners[0], float(rates.sin_upper[0])),
            ((6, 5, 4), corners[1], float(rates.sin_fore[0])),
        ):
            for k in range(parts):
                ends = theta[k : k + 2]
                pole = min(ends.min(), np.pi - ends.max())
                s = np.sin([max(ends.min() - b * h, 0.0), min(ends.max() + b * h, np.pi)]).min()
                for joint, rate in ((outer, b), (along, 1.0)):
                    if rate * h >= pole or s < 0.1:
                        continue
                    width = float((found.high - found.low)[joint, 0, 0, k])
                    q = [curves.angles(np.sin(x), np.cos(x))[joint] for x in edges[k : k + 2]]
                    own = abs(np.mod(float(q[1] - q[0]) + np.pi, 2.0 * np.pi) - np.pi)
                    slack = [
                        rate * h / s,
                        np.arcsin(min(np.sin(rate * h) / np.sin(pole), 1.0)),
                        (rate / s + 2.0 * rate**2 / s**2) * h**2 / 2.0,
                    ]
                    if min(slack[:2]) < 0.5 * np.pi:
                        assert width == pytest.approx(own + 2.0 * min(slack), abs=1e-7)
                        told += 1
                if b * h < pole and s > 0.1:
                    slack = [b * h, (b + b**2) * h**2 / (2.0 * s)]
                    low, high = (
                        max(ends.min() - min(slack), 0.0),
                        min(ends.max() + min(slack), np.pi),
                    )
                    for flip, expected in enumerate(([low, high], [-high, -low])):
                        own = [found.low[middle, flip, 0, k], found.high[middle, flip, 0, k]]
                        offset = arm.canonical.offset[middle]
                        assert own == pytest.approx(np.array(expected) - offset, abs=1e-7)
    assert told > 100


@pytest.mark.parametrize(("half", "parts"), [(0.002, 90), (0.1, 90), (0.03, 800), (0.002, 2000)])
def test_a_turn_of_the_platform_widens_enclosures_by_the_rates_of_the_shape(arm, half, parts):
    """Over (phi, psi) a vector with rates a_1, a_2 by phi and b, b by psi (1, 1 for the link's frame) by the docstring.

    d = a_1 h_phi + b h_psi; the least sine s is d beyond the corners; a polar angle is within
    min(d, ((a_2 + a_1²) h_phi² + (b + b²) h_psi²) / 2s) of its corners', an azimuth within the least of d / s,
    asin(sin d / sin theta) and ((a_2/s + 2 a_1²/s²) h_phi² + (r/s + 2 r²/s²) h_psi²) / 2, with r for b.
    """
    random = np.random.default_rng(29)
    told = np.zeros(5, dtype=int)
    for _ in range(10):
        R, p = arm.forward(random.uniform(np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0)))
        cell = one_cell(-half, half)
        rates = shape_rates(arm, arm.wrist_center(R, p), cell)
        found = in_numpy.enclosures(arm, R, p, cell, rates, parts)
        corners = in_numpy._corners(arm, R, p, cell, parts)[:, :, 0]
        h = np.pi / parts
        for (outer, middle, along), a_1, a_2, b in (
            ((0, 1, 2), rates.shoulder_first, rates.shoulder_second, rates.sin_upper),
            ((6, 5, 4), rates.wrist_first, rates.wrist_second, rates.sin_fore),
        ):
            one, two, sine = float(a_1[0]), float(a_2[0]), float(b[0])
            for k in random.integers(0, parts, 20):
                theta = corners[:, middle, k]
                d = one * half + sine * h
                if theta.min() - d < 0.05 or theta.max() + d > np.pi - 0.05:
                    continue
                s = np.sin([theta.min() - d, theta.max() + d]).min()
                bent = ((two + one**2) * half**2 + (sine + sine**2) * h**2) / (2.0 * s)
                slack = min(d, bent)
                told[0 if bent < d else 1] += 1
                low = max(theta.min() - slack, 0.0) - arm.canonical.offset[middle]
                assert found.low[middle, 0, 0, k] == pytest.approx(low, abs=1e-9)
                for joint, rate in ((outer, sine), (along, 1.0)):
                    d = one * half + rate * h
                    pole = np.minimum(theta, np.pi - theta).min()
                    bent = ((two / s + 2.0 * one**2 / s**2) * half**2) / 2.0
                    bent += ((rate / s + 2.0 * rate**2 / s**2) * h**2) / 2.0
                    cap = np.arcsin(min(np.sin(d) / np.sin(pole), 1.0)) if d < pole else np.inf
                    straight = min(d / s, cap)
                    if straight > 1.5:
                        continue
                    told[2 if bent < straight else 3] += 1
                    told[4] += cap < min(bent, d / s)
                    step = np.diff(corners[:, joint, k])
                    step -= 2.0 * np.pi * np.round(step / (2.0 * np.pi))
                    own = np.ptp(np.concatenate([[0.0], np.cumsum(step)]))
                    width = (found.high - found.low)[joint, :, 0, k]
                    assert width == pytest.approx(own + 2.0 * min(bent, straight), abs=1e-8)
    assert told[[0, 2]].min() > 50 or told[[1, 3]].min() > 20


def test_enclosures_shrink_to_the_corners_with_the_square_of_their_cells(arm):
    """What is beyond the corners' own range is a quarter in cells of half the size; at least nearly."""
    random = np.random.default_rng(23)
    beyond = []
    for _ in range(8):
        q = random.uniform(np.maximum(arm.lower, -2.0), np.minimum(arm.upper, 2.0))
        R, p = arm.forward(q)
        wrist = arm.wrist_center(R, p)
        row = []
        for half, parts in ((0.01, 160), (0.005, 320)):
            cell = one_cell(-half, half)
            rates = shape_rates(arm, wrist, cell)
            found = in_numpy.enclosures(arm, R, p, cell, rates, parts)
            corners = in_numpy._corners(arm, R, p, cell, parts)[:, [0, 2, 4, 6], 0]
            step = np.abs(np.mod(np.diff(corners, axis=0) + np.pi, 2.0 * np.pi) - np.pi)
            own = np.maximum(step[0] + step[1], step.max(axis=0))
            widths = (found.high - found.low)[[0, 2, 4, 6], 0, 0]
            row.append(np.median(np.maximum(widths - own, 0.0)))
        beyond.append(row)
    coarse, fine = np.median(np.array(beyond), axis=0)
    assert fine < 0.35 * coarse
    assert coarse < 0.02


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
        np.array([2.0, 1.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]),
    )
    found = in_numpy._merged(cells, np.zeros(9, dtype=np.int64))
    rows = sorted(zip(found.kind, found.low[:, 0], found.high[:, 0], found.line, strict=True))
    expected = [
        [0, 0.05, 0.25, 1.0],
        [1, -3.05, -2.95, 4.0],
        [1, 2.95, 3.05, 3.0],
        [2, 0.05, 0.15, 5.0],
        [3, -0.05, 0.05, 7.0],
        [3, 2.95, 3.05, 6.0],
        [4, 0.55, 1.25, 8.0],
    ]
    assert np.array(rows) == pytest.approx(np.array(expected))


@pytest.mark.parametrize("free_last", [False, True])
@pytest.mark.parametrize("finer", [1, 3])
def test_compiled_cells_are_those_of_numpy(arm, finer, free_last):
    """Random poses, also at the ends of the reach and with a stretched arm: the same cells in the same order."""
    random = np.random.default_rng(41)
    edges = np.linspace(-np.pi, np.pi, 25)
    resolution = Resolution(np.radians(15.0), 9, finer)
    for trial in range(6):
        q = random.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi))
        if trial % 3 == 1:
            q[3] = (1e-3, 1e-6, 0.0)[trial % 4 % 3]
        R, p = arm.forward(q)
        lines = lambda intervals: 0.1 + 0.01 * np.arange(len(intervals.index))  # noqa: E731
        both = [
            make(arm, R, p, edges, resolution, free_last, lines)
            for make in (pose_cells, in_numpy.pose_cells)
        ]
        found, expected = both
        assert np.array_equal(found.index, expected.index)
        assert np.array_equal(found.kind, expected.kind)
        assert np.array_equal(found.line, expected.line)
        for name in ("low", "high"):
            assert np.allclose(getattr(found, name), getattr(expected, name), atol=1e-7)
