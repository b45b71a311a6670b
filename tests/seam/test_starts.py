"""Starts: closed all along, determined by the seed, and a first failure that is where geometry has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.kinds.seam.closed_chain.closing import all_equations
from dualarm_cli.kinds.seam.closed_chain.posture_paths import path_cost, steady_times
from dualarm_cli.kinds.seam.closed_chain.starts import (
    STARTS,
    seam_starts,
    standing_joints,
    why_impossible,
)
from dualarm_cli.model.curves.contours import LineContour
from dualarm_cli.model.curves.feature_curve import FeatureCurve
from dualarm_cli.model.curves.point_spline import PointSpline
from dualarm_cli.model.process_work import Hold, SeamTool


@pytest.mark.parametrize("moving", [False, True])
def test_every_way_is_closed_at_every_node_and_stands_where_it_has_to(cells, make, moving):
    """Quickest first; without moving, the master's joints and the platform are the same at all nodes."""
    problem = make.problem_on(cells["sda10f"], make.work_on(make.line()))
    found = seam_starts(problem, moving=moving)
    assert found.failure is None
    assert len(found.position) >= 5
    for way in found.position:
        assert all_equations(problem.chain, way, problem.shares).size.max() < 1e-8
    stands = standing_joints(problem, moving=moving)
    names = np.array(problem.limits.joints)
    slave = set(cells["sda10f"].robot.arm("right").joints)
    both = slave | set(cells["sda10f"].robot.arm("left").joints)
    assert set(names[~stands]) == (both if moving else slave)
    assert np.ptp(found.position[:, :, stands], axis=1).max() == 0.0
    inside = [
        k
        for k, way in enumerate(found.position)
        if ((way >= problem.bounds[0]) & (way <= problem.bounds[1]))[:, problem.chain.closes].all()
    ]
    costs = [path_cost(problem, found.position[k]) for k in inside]
    assert (np.diff(costs) >= 0.0).all()
    # The cost is the time, and up to 65 % more for limits and singular postures that are near.
    times = steady_times(found.position[inside], problem.limits).max(axis=-1)
    assert (costs >= times).all() and (costs <= 1.65 * times + 1e-9).all()


def test_a_way_of_the_part_is_kept_at_every_node(cells, make):
    """A pose that one start of a free seam has: all starts with it have the part there, by pinocchio."""
    cell, work = cells["sda10f"], make.work_on(make.line())
    free = seam_starts(make.problem_on(cell, work))
    part, _ = make.by_pinocchio(cell, work, free.position[0, 0])
    given = make.problem_on(cell, replace(work, hold=Hold(pose=part)), samples=200)
    found = seam_starts(given)
    assert found.failure is None
    for way in found.position[:3]:
        for q in way[::10]:
            there, _ = make.by_pinocchio(cell, work, q)
            np.testing.assert_allclose(there.homogeneous, part.homogeneous, atol=1e-7)


def radial(start, end, height):
    """A line on a table, away from a robot's axis."""
    ends = np.array([[start, 0.0, height], [end, 0.0, height]])
    return FeatureCurve(
        LineContour(ends[0], ends[1], np.array([0.0, 0.0, 1.0])), pin.SE3.Identity()
    )


def test_the_first_failure_is_where_the_arm_is_stretched(cells, make):
    """An iiwa14's shoulder is 0.36 m high, its wrist 0.126 + 0.1 m over the tool that points down, its links 0.82 m.

    Over a table 0.134 m high the wrist moves at the shoulder's height: the line from 0.5 to 1 m ends after 0.32 m.
    """
    work = make.work_on(
        radial(0.5, 1.0, 0.36 - 0.226),
        master=None,
        slave="left",
        part=pin.SE3.Identity(),
        tool=SeamTool(),
    )
    found = seam_starts(make.problem_on(cells["iiwa14"], work, samples=30))
    assert len(found.position) == 0
    reached = 0.5 + 0.5 * found.failure.share
    assert 0.81 < reached < 0.823
    reason = found.failure.reason
    assert (reason.key, reason.arm) == ("seam_not_reached", "left")
    whole = replace(work, curve=radial(0.5, 0.8, 0.134))
    assert seam_starts(make.problem_on(cells["iiwa14"], whole, samples=30)).failure is None


def test_a_seam_out_of_reach_fails_at_its_begin(cells, make):
    """From 1 m on."""
    work = make.work_on(
        radial(1.0, 1.1, 0.134), master=None, slave="left", part=pin.SE3.Identity(), tool=SeamTool()
    )
    found = seam_starts(make.problem_on(cells["iiwa14"], work))
    assert found.failure.share == 0.0


def test_a_joint_s_limit_that_ends_it_is_named(cells, make):
    """Joints 1 and 3 held to 0.1 rad, a line across in front of the robot: it ends at a limit, by name and degrees."""
    ends = np.array([[0.5, 0.0, 0.134], [0.5, 0.6, 0.134]])
    curve = FeatureCurve(
        LineContour(ends[0], ends[1], np.array([0.0, 0.0, 1.0])), pin.SE3.Identity()
    )
    work = make.work_on(
        curve, master=None, slave="left", part=pin.SE3.Identity(), tool=SeamTool(free_spin=True)
    )
    problem = make.problem_on(cells["iiwa14"], work)
    limits = problem.limits
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    lower[[0, 2]], upper[[0, 2]] = -0.1, 0.1
    problem = replace(problem, limits=replace(limits, lower=lower, upper=upper))
    found = seam_starts(problem)
    assert found.failure is not None
    assert 0.0 < found.failure.share < 1.0
    reason = found.failure.reason
    assert reason.key == "seam_joint_limit"
    assert reason.data["joint"] in limits.joints


def test_of_ways_that_cannot_be_worked_the_joint_the_collision_or_the_end_is_told(cells, make):
    """A joint's limit put between its least and its greatest position on a way; bodies; what comes next."""
    problem = make.problem_on(cells["sda10f"], make.work_on(make.line()), samples=60)
    way = seam_starts(problem).position[0]
    assert why_impossible(problem, [way]).reason.key == "seam_goes_on"
    touching = replace(problem, is_free=lambda q: np.zeros(len(q), dtype=bool))
    assert why_impossible(touching, [way]).reason.key == "seam_all_touch"
    joint = int(np.argmax(np.ptp(way, axis=0)))
    upper = np.array(problem.limits.upper)
    # Beyond what bounds for decisions leave free, and what they are passed by in rounding.
    upper[joint] = 0.5 * (way[:, joint].min() + way[:, joint].max())
    narrow = replace(problem, limits=replace(problem.limits, upper=upper))
    found = why_impossible(narrow, [way])
    beyond = way[:, joint] > narrow.bounds[1][joint] + STARTS.rounded
    assert found.share == problem.shares[int(np.argmax(beyond))]
    name, degrees = problem.limits.joints[joint], np.degrees(upper[joint])
    assert str(found.reason) == f"joint {name} reaches its limit of {degrees:.1f} deg"


def test_what_touches_is_left_out(cells, make):
    """A test that lets nothing pass, and one that lets the left elbow bend one way only."""
    work = make.work_on(make.line())
    nothing = make.problem_on(
        cells["sda10f"], work, samples=60, is_free=lambda q: np.zeros(len(q), dtype=bool)
    )
    assert seam_starts(nothing).failure.reason.key == "seam_all_touch"
    elbow = nothing.limits.joints.index("left_e")
    some = replace(nothing, is_free=lambda q: q[:, elbow] > 0.0)
    found = seam_starts(some)
    assert len(found.position)
    assert (found.position[:, :, elbow] > 0.0).all()


def test_joints_that_the_file_names_are_where_starts_are_drawn(cells, make):
    """Joints that close the chain in the middle: one start is exactly there, and most of the others are near."""
    problem = make.problem_on(cells["sda10f"], make.work_on(make.line()), samples=60)
    whole = seam_starts(problem).position
    middle = whole.shape[1] // 2
    near = whole[0, middle]
    found = seam_starts(replace(problem, reference=near)).position
    away = np.abs(found[:, middle] - near).max(axis=1)
    assert away.min() < 1e-7
    # 0.3 rad of deviation at most, of 15 joints: the farthest of them is seldom beyond three times that.
    assert np.median(away) < 0.9
    assert np.median(np.abs(whole[:, middle] - near).max(axis=1)) > 2.0


def test_the_seed_decides_what_is_drawn(cells, make):
    """Same seed, same bytes; another one, other ways."""
    work = make.work_on(make.line())
    one, same, other = (
        seam_starts(make.problem_on(cells["sda10f"], work, samples=30, seed=seed)).position
        for seed in (3, 3, 4)
    )
    assert one.tobytes() == same.tobytes()
    assert one.tobytes() != other.tobytes()


@pytest.mark.parametrize(("waves", "fewest", "most"), [(0, 41, 41), (4, 41, 81), (20, 161, 321)])
def test_nodes_are_as_many_as_the_curve_asks_for(cells, make, waves, fewest, most):
    """41 on a line; at least eight to each wave of 5 mm on half a metre, at most 321."""
    x = np.linspace(0.0, 1.0, 60 * max(waves, 1) + 1)
    points = np.stack([0.5 * x, 0.005 * np.sin(2.0 * np.pi * waves * x), 0.0 * x], axis=1)
    curve = FeatureCurve(PointSpline(points, np.array([0.0, 0.0, 1.0])), pin.SE3.Identity())
    problem = make.problem_on(cells["sda10f"], make.work_on(curve))
    assert fewest <= problem.nodes <= most
    assert problem.nodes - 1 >= 8 * waves
    assert len(problem.shares) == problem.nodes
