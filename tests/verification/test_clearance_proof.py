"""Certified clearances: never above the truth, near it, and nothing however short slips through."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.solids import (
    WORLD,
    Pair,
    Solid,
    cell_solids,
    geometry_model,
    pairs_that_must_keep_apart,
)
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.verification.clearance_proof import ClearanceProof, UnprovenError, levers

BALL = 0.1
"""Radius of the ball at the end of the arm [m]."""


def rest_to_rest(joints, start, end, duration):
    """A move of four equal phases of jerk +j, -j, -j, +j: d = j T³ / 32."""
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    j, h = 32.0 * (end - start) / duration**3, duration / 4.0
    q, v, a = [start], [np.zeros_like(start)], [np.zeros_like(start)]
    for sign in (1.0, -1.0, -1.0, 1.0):
        jerk = sign * j
        q.append(q[-1] + h * v[-1] + h**2 / 2 * a[-1] + h**3 / 6 * jerk)
        v.append(v[-1] + h * a[-1] + h**2 / 2 * jerk)
        a.append(a[-1] + h * jerk)
    return Trajectory(tuple(joints), h * np.arange(5.0), np.array(q), np.array(v), np.array(a))


def at(x, y, z=0.0):
    """A place without a turn."""
    return pin.SE3(np.eye(3), np.array([x, y, z]))


@pytest.fixture(scope="module")
def pointer():
    """One joint about z at the origin that carries a ball a metre out."""
    model = pin.Model()
    model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    return model, Solid("tip", 1, at(1.0, 0.0), coal.Sphere(BALL), 1.0 + BALL)


def certified(pointer, obstacle, trajectory, windows=None):
    """The margin and the least one met of the tip and an obstacle."""
    model, tip = pointer
    proof = ClearanceProof(model, [tip, obstacle], [Pair(0, 1, 0.0)], [windows], trajectory)
    [found] = proof.certify(np.array([0.0, trajectory.time[-1]]))
    return found


@pytest.mark.parametrize("angle", [0.3, 0.7, 1.2])
def test_a_ball_on_a_circle_comes_as_near_as_geometry_says(pointer, angle):
    """Past a ball of 50 mm on the same ray, 1.4 m out: 1.4 - 1.0 - 0.1 - 0.05 m."""
    obstacle = Solid(
        "ball", WORLD, at(1.4 * np.cos(angle), 1.4 * np.sin(angle)), coal.Sphere(0.05), 1.5
    )
    found = certified(pointer, obstacle, rest_to_rest(["turn"], [0.0], [1.5], 0.8))
    assert 0.249 <= found.margin <= 0.25
    assert found.margin <= found.met


@pytest.mark.parametrize("seed", range(20))
def test_a_contact_of_a_millisecond_is_found_and_a_miss_by_little_is_not_one(pointer, seed):
    """The tip passes at some 3 m/s; the ball is so far off that they overlap for a millisecond, or not at all."""
    random = np.random.default_rng(seed)
    trajectory = rest_to_rest(["turn"], [0.0], [2.0], 1.2)
    time = random.uniform(0.4, 0.8)
    [[q]], [[v]], _ = trajectory.at(np.array([time]))
    small = random.uniform(0.002, 0.02)
    # Chord of the overlap: v * 1 ms; the path is straight enough over 3 mm.
    off = np.sqrt((BALL + small) ** 2 - (0.5e-3 * v) ** 2)
    for distance, touches in ((off, True), (BALL + small + 1.5e-3, False)):
        place = at((1.0 + distance) * np.cos(q), (1.0 + distance) * np.sin(q))
        obstacle = Solid("ball", WORLD, place, coal.Sphere(small), 9.0)
        assert (certified(pointer, obstacle, trajectory).margin < 0.0) == touches


def test_a_pair_counts_within_its_windows_only(pointer):
    """The same contact outside the window does not matter; a window with nothing in it says nothing."""
    obstacle = Solid("ball", WORLD, at(np.cos(0.75), np.sin(0.75)), coal.Sphere(0.05), 9.0)
    trajectory = rest_to_rest(["turn"], [0.0], [1.5], 1.0)
    assert certified(pointer, obstacle, trajectory).margin < -0.14
    # At 0.5 s the tip is at 0.75 rad; at 0.25 s at j t³ / 6 = 32 * 1.5 / 64 / 6 = 0.125 rad.
    early = certified(pointer, obstacle, trajectory, [(0.0, 0.25)])
    chord = 2.0 * np.sin(0.5 * (0.75 - 0.125))
    assert early.margin == pytest.approx(chord - BALL - 0.05, abs=1e-3)
    assert certified(pointer, obstacle, trajectory, []).pair == -1


def test_what_stands_still_is_certified_exactly(pointer):
    """No speed, no doubt: the distance itself, less what coal may be off."""
    obstacle = Solid("ball", WORLD, at(2.0, 0.0), coal.Sphere(0.05), 9.0)
    found = certified(pointer, obstacle, rest_to_rest(["turn"], [0.0], [0.0], 1.0))
    assert found.margin == pytest.approx(0.85, abs=2e-6)


def scanned(model, solids, pairs, trajectory, samples):
    """The least distance of any pair at many instants.

    A first scan of 400 instants with all pairs says which can be the nearest at all: no pair comes nearer than half a
    step's way, at 12 m/s or less, below what it has there.
    """
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    data, distances = model.createData(), pin.GeometryData(geometry)
    order = [trajectory.joints.index(name) for name in model.names[1:]]
    end = trajectory.time[-1]

    def positions(count):
        return trajectory.at(np.linspace(0.0, end, count))[0][:, order]

    rows = []
    for q in positions(400):
        pin.computeDistances(model, data, geometry, distances, q)
        rows.append([result.min_distance for result in distances.distanceResults])
    coarse = np.min(rows, axis=0)
    near = np.flatnonzero(coarse <= coarse.min() + 12.0 * end / 399 / 2).tolist()
    least = coarse.min()
    for q in positions(samples):
        pin.updateGeometryPlacements(model, data, geometry, distances, q)
        least = min(
            least, *(pin.computeDistance(geometry, distances, k).min_distance for k in near)
        )
    return least


def check_random_moves(tasks_folder, seeds, samples):
    """Random moves of the SDA10F over its table, each of 1 to 3 s."""
    cell = load_job(tasks_folder / "04_packing" / "tasks.yaml").cell
    robot = cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    solids = cell_solids(cell, model, [])
    pairs = [Pair(p.first, p.second, 0.0) for p in pairs_that_must_keep_apart(model, solids, cell)]
    for seed in seeds:
        random = np.random.default_rng(seed)
        start, end = random.uniform(robot.limits.lower, robot.limits.upper, (2, len(robot.joints)))
        end = start + 0.5 * (end - start)
        trajectory = rest_to_rest(robot.joints, start, end, random.uniform(1.0, 3.0))
        proof = ClearanceProof(model, solids, pairs, [None] * len(pairs), trajectory)
        [found] = proof.certify(trajectory.time[[0, -1]])
        truth = scanned(model, solids, pairs, trajectory, samples)
        assert truth - 1e-3 <= found.margin <= truth
        assert found.met >= found.margin


def test_certified_clearances_of_random_moves_are_true_and_tight(tasks_folder):
    """Never above the least of a dense scan, and within a millimetre of it."""
    check_random_moves(tasks_folder, range(25), 2000)


@pytest.mark.slow
def test_certified_clearances_of_a_thousand_random_moves_are_true_and_tight(tasks_folder):
    """The same against scans of 10,000 instants."""
    check_random_moves(tasks_folder, range(1000, 2000), 10_000)


def test_no_joint_moves_a_solid_farther_than_its_lever():
    """Chains of a turn, a slide and two turns, with random placements: distances of balls, 4000 random steps.

    A slide has a lever of exactly one, and it makes those of the turns before it longer by as far as it goes.
    """
    rng = np.random.default_rng(4)
    for _ in range(8):
        model, solids = pin.Model(), []
        parent = 0
        for k, joint in enumerate("RPRR"):
            made = pin.JointModelPX() if joint == "P" else pin.JointModelRZ()
            placement = pin.SE3.Random()
            placement.translation = rng.uniform(-0.4, 0.4, 3)
            far = np.array([0.6 if joint == "P" else 3.0])
            parent = model.addJoint(parent, made, placement, f"j{k}", far, far, -far, far)
            offset = rng.uniform(-0.3, 0.3, 3)
            extent = float(np.linalg.norm(offset)) + 0.05
            solids.append(Solid(f"b{k}", parent, at(*offset), coal.Sphere(0.05), extent))
        solids.append(Solid("world", WORLD, at(*rng.uniform(-1, 1, 3)), coal.Sphere(0.05), 0.0))
        pairs = [Pair(i, j, 0.0) for i in range(5) for j in range(i + 1, 5)]
        table = levers(model, solids, pairs)
        data = model.createData()

        def distances(q, model=model, data=data, solids=solids, pairs=pairs):
            pin.forwardKinematics(model, data, q)
            centres = [data.oMi[s.joint].act(s.pose.translation) for s in solids]
            return np.array([np.linalg.norm(centres[p.first] - centres[p.second]) for p in pairs])

        assert set(table[:, 1]) <= {0.0, 1.0}
        for _ in range(500):
            q = rng.uniform(model.lowerPositionLimit, model.upperPositionLimit)
            step, joint = np.zeros(4), rng.integers(4)
            step[joint] = rng.uniform(-0.3, 0.3)
            step[1] = np.clip(q[1] + step[1], -0.6, 0.6) - q[1]
            change = np.abs(distances(q + step) - distances(q))
            assert (change <= table @ np.abs(step) + 1e-12).all()


def test_a_lever_is_no_longer_than_it_must_be(pointer):
    """The tip's farthest point is 1.1 m from the one joint; of two tips of one joint neither moves."""
    model, tip = pointer
    still = Solid("still", WORLD, at(2.0, 0.0), coal.Sphere(BALL), 2.0 + BALL)
    assert levers(model, [tip, still, tip], [Pair(0, 1, 0.0), Pair(0, 2, 0.0)]).tolist() == [
        [1.0 + BALL],
        [0.0],
    ]


def test_the_greatest_speed_of_an_interval_is_that_of_all_knots_it_touches(pointer):
    """Random accelerations at knots, random intervals: no less than at 400 instants, no more than of their knots."""
    model, tip = pointer
    rng = np.random.default_rng(6)
    time = np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 0.5, 30))])
    a, dt = rng.normal(size=31), np.diff(time)
    v = np.concatenate([[0.0], np.cumsum(dt * (a[:-1] + a[1:]) / 2.0)])
    q = np.concatenate([[0.0], np.cumsum(dt * (v[:-1] + dt * (2.0 * a[:-1] + a[1:]) / 6.0))])
    motion = Trajectory(("turn",), time, q[:, None], v[:, None], a[:, None])
    still = Solid("still", WORLD, at(2.0, 0.0), coal.Sphere(BALL), 2.0 + BALL)
    proof = ClearanceProof(model, [tip, still], [Pair(0, 1, 0.0)], [None], motion)
    begin, end = np.sort(rng.uniform(0.0, time[-1], (2, 300)), axis=0)
    for b, e, fastest in zip(begin, end, proof._fastest(begin, end)[:, 0], strict=True):
        inside = np.abs(motion.at(np.linspace(b, e, 400))[1]).max()
        first, last = np.searchsorted(time, [b, e])
        knots = np.linspace(time[max(first - 1, 0)], time[min(last, len(time) - 1)], 2000)
        assert inside - 1e-12 <= fastest <= np.abs(motion.at(knots)[1]).max() * 1.001 + 1e-12


def test_two_knots_have_the_speed_of_the_parabola_between_them(pointer):
    """From rest to rest with 8 rad/s² at first and -8 at last is 2 rad/s in the middle of a second."""
    model, tip = pointer
    rates = [np.array([[0.0], [4.0 / 3.0]]), np.zeros((2, 1)), np.array([[8.0], [-8.0]])]
    motion = Trajectory(("turn",), np.array([0.0, 1.0]), *rates)
    still = Solid("still", WORLD, at(2.0, 0.0), coal.Sphere(BALL), 2.0 + BALL)
    proof = ClearanceProof(model, [tip, still], [Pair(0, 1, 0.0)], [None], motion)
    found = proof._fastest(np.array([0.0, 0.4]), np.array([1.0, 0.6]))
    assert found == pytest.approx(np.full((2, 1), 2.0), abs=1e-12)


def balls_on_a_chain(rng):
    """Two turns and a slide with a ball on each, and two balls in the world; the trajectory has them backwards."""
    model, solids, parent = pin.Model(), [], 0
    for k, joint in enumerate("RPR"):
        made = pin.JointModelPX() if joint == "P" else pin.JointModelRZ()
        far = np.array([0.5 if joint == "P" else 3.0])
        parent = model.addJoint(
            parent, made, at(*rng.uniform(-0.4, 0.4, 3)), f"j{k}", far, far, -far, far
        )
        offset = rng.uniform(-0.2, 0.2, 3)
        extent = float(np.linalg.norm(offset)) + 0.05
        solids.append(Solid(f"b{k}", parent, at(*offset), coal.Sphere(0.05), extent))
    solids += [
        Solid("w", WORLD, at(*rng.uniform(-1, 1, 3)), coal.Sphere(0.05), 0.0) for _ in range(2)
    ]
    low, high = model.lowerPositionLimit, model.upperPositionLimit
    start, end = rng.uniform(low, high), rng.uniform(low, high)
    trajectory = rest_to_rest(["j2", "j1", "j0"], start[::-1], end[::-1], rng.uniform(0.5, 2.0))
    return model, solids, trajectory


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("precision", [5e-4, 1e-5])
def test_every_stretch_has_the_least_margin_of_the_pairs_that_count_then(seed, precision):
    """Balls, so that margins are by hand: pairs with windows, some twice with other requirements, several stretches.

    What is proven is no more than the least of a dense scan and no less than what was met less the precision; what was
    met is the named pair's margin at the named instant, in the stretch and in a window of the pair.
    """
    rng = np.random.default_rng(seed)
    model, solids, trajectory = balls_on_a_chain(rng)
    whole = trajectory.time[-1]
    pairs = [Pair(i, j, float(rng.uniform(0.0, 0.1))) for i in range(3) for j in range(i + 1, 5)]
    pairs += [Pair(p.first, p.second, p.required + 0.05) for p in pairs[:3]]
    windows = [
        None if rng.random() < 0.4 else [tuple(np.sort(rng.uniform(-0.1, 1.1, 2)) * whole)]
        for _ in pairs
    ]
    windows[1] = [(0.1 * whole, 0.2 * whole), (0.6 * whole, 0.9 * whole)]
    edges = np.array([0.0, *np.sort(rng.uniform(0.0, whole, 3)), whole])
    data = model.createData()

    def margins(times):
        rows = []
        for q in trajectory.at(times)[0][:, ::-1]:
            pin.forwardKinematics(model, data, q)
            c = [data.oMi[s.joint].act(s.pose.translation) for s in solids]
            rows.append(
                [np.linalg.norm(c[p.first] - c[p.second]) - 0.1 - p.required for p in pairs]
            )
        return np.array(rows)

    def counts(k, time):
        return windows[k] is None or any(a - 1e-9 <= time <= b + 1e-9 for a, b in windows[k])

    found = ClearanceProof(model, solids, pairs, windows, trajectory).certify(edges, precision)
    assert len(found) == len(edges) - 1
    for one, begin, end in zip(found, edges[:-1], edges[1:], strict=True):
        times = np.linspace(begin, end, 400)
        table = margins(times)
        for k in range(len(pairs)):
            table[[not counts(k, time) for time in times.tolist()], k] = np.inf
        truth = table.min()
        if one.pair < 0:
            assert one.margin == one.met == truth == np.inf
            continue
        assert one.met - precision - 2e-6 <= one.margin <= min(truth, one.met)
        assert begin <= one.time <= end
        assert counts(one.pair, one.time)
        [there] = margins(np.array([one.time]))
        assert one.met == pytest.approx(there[one.pair], abs=1e-6)
        assert one.met <= truth + precision + 1e-6


def test_the_earliest_instant_and_the_first_pair_of_equal_margins_are_named(pointer):
    """Stands still, and two equal balls: the beginning, the first pair; of a later stretch its own beginning."""
    model, tip = pointer
    balls = [Solid(n, WORLD, at(1.4, 0.0), coal.Sphere(0.05), 9.0) for n in ("a", "b")]
    proof = ClearanceProof(
        model,
        [tip, *balls],
        [Pair(0, 1, 0.0), Pair(0, 2, 0.0)],
        [None, None],
        rest_to_rest(["turn"], [0.0], [0.0], 1.0),
    )
    found = proof.certify(np.array([0.0, 0.3, 1.0]))
    assert [(one.pair, one.time) for one in found] == [(0, 0.0), (0, 0.3)]


def test_without_pairs_nothing_limits(pointer):
    """Every stretch is free."""
    model, tip = pointer
    motion = rest_to_rest(["turn"], [0.0], [1.0], 1.0)
    found = ClearanceProof(model, [tip], [], [], motion).certify(np.array([0.0, 0.5, 1.0]))
    assert [one.margin for one in found] == [np.inf, np.inf]


def test_a_motion_of_days_is_certified_all_the_same(pointer):
    """A tenth of a rad per hour past a ball: the first intervals are no shorter than fits the memory."""
    obstacle = Solid("ball", WORLD, at(1.4 * np.cos(0.7), 1.4 * np.sin(0.7)), coal.Sphere(0.05), 9)
    found = certified(pointer, obstacle, rest_to_rest(["turn"], [0.0], [1.5], 200_000.0))
    assert 0.249 <= found.margin <= 0.25


def test_a_motion_that_no_joint_can_make_is_not_followed_to_its_end(pointer):
    """A thousand turns a second for half a day, beside a ball that the tip passes by 0.4 mm: 270 million times."""
    spun = Trajectory(
        ("turn",),
        np.array([0.0, 43200.0]),
        np.array([[0.0], [2.7e8]]),
        np.full((2, 1), 6250.0),
        np.zeros((2, 1)),
    )
    near = Solid("near", WORLD, at(0.0, 2.0 * BALL + 1.0004), coal.Sphere(BALL), 9)
    with pytest.raises(UnprovenError):
        certified(pointer, near, spun)


def test_a_slide_s_lever_is_that_of_its_farther_end():
    """From -0.7 to 0.2 m: the turn before it may have the ball 0.7 m farther out than the slide's origin."""
    model = pin.Model()
    one = np.ones(1)
    turn = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn", one, one, -one, one)
    for lower, upper in ((-0.7, 0.2), (-0.2, 0.7)):
        both = model.copy()
        slide = both.addJoint(
            turn, pin.JointModelPX(), at(0.3, 0.4), "s", one, one, lower * one, upper * one
        )
        ball = Solid("b", slide, at(0.0, 0.0), coal.Sphere(0.05), 0.05)
        world = Solid("w", WORLD, at(9.0, 0.0), coal.Sphere(0.05), 9.0)
        [row] = levers(both, [ball, world], [Pair(0, 1, 0.0)])
        assert row == pytest.approx([0.05 + 0.7 + 0.5, 1.0])
