"""Steps of the quadratic program against its own promises and the nonlinear chain; what improvement keeps."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from dualarm_cli.kinds.seam.closed_chain.closing import all_equations
from dualarm_cli.kinds.seam.closed_chain.posture_paths import steady_time
from dualarm_cli.kinds.seam.closed_chain.program import SeamProgram
from dualarm_cli.kinds.seam.closed_chain.solvers import PROGRAM, improved
from dualarm_cli.kinds.seam.closed_chain.starts import (
    beyond_limits,
    part_poses,
    seam_starts,
    standing_joints,
)
from dualarm_cli.model.curves.tool_path import ToolPath, Turn
from dualarm_cli.model.process_work import Hold, SeamTool


@pytest.fixture(scope="module")
def tilting(cells, make):
    """A rim whose surface has to face up within 40 degrees, the tool with 10 degrees of tilt: the part must turn."""
    tool = SeamTool(0.002, free_spin=True, tilt=np.radians(10.0))
    work = make.work_on(make.rim(0.03, 100.0), tool=tool, downhand=np.radians(40.0))
    return make.problem_on(cells["sda10f"], work)


@pytest.fixture(scope="module")
def start(tilting):
    """Its quickest start within limits, the part moving."""
    ways = seam_starts(tilting, moving=True).position
    return next(way for way in ways if beyond_limits(tilting, way).max() == 0.0)


def test_a_step_keeps_the_time_that_it_promises(tilting, start):
    """Rates are linear in the joints and their bounds lie below: promises are kept before the chain is closed."""
    program = SeamProgram(tilting, standing_joints(tilting, moving=True))
    time = steady_time(start, tilting.limits)
    for radius in (0.02, 0.2):
        moved, promised = program.step(start, time, radius, pace=1.0)
        assert promised < time
        assert np.abs(moved - start).max() <= radius * (1.0 + 1e-6)
        assert steady_time(moved, tilting.limits) <= promised * (1.0 + 1e-4)
        assert beyond_limits(tilting, moved).max() == 0.0


def test_what_a_step_leaves_of_the_chain_is_of_second_order(tilting, start):
    """Half of the step leaves a quarter of the residual: the slopes in the program are those of the chain."""
    program = SeamProgram(tilting, standing_joints(tilting, moving=True))
    moved, _ = program.step(start, steady_time(start, tilting.limits), 0.02, pace=1.0)
    left = [
        all_equations(
            tilting.chain, start + part * (moved - start), tilting.shares
        ).exact.size.max()
        for part in (1.0, 0.5, 0.25)
    ]
    assert 1e-5 < left[0] < 1e-2
    for whole, half in pairwise(left):
        assert half == pytest.approx(whole / 4.0, rel=0.1)


def test_joints_that_stand_are_one_variable(tilting, start, cells):
    """With the master standing, a step moves its joints by the same at all nodes, and the platform not at all."""
    stands = standing_joints(tilting, moving=False)
    moved, _ = SeamProgram(tilting, stands).step(start, 9.0, 0.05, pace=1.0)
    steps = moved - start
    names = tilting.limits.joints
    master = [names.index(name) for name in cells["sda10f"].robot.arm("left").joints]
    assert np.ptp(steps[:, master], axis=0).max() < 1e-12
    assert np.abs(steps[:, master]).max() > 0.0
    assert (steps[:, names.index("torso_b1")] == 0.0).all()


def test_improvement_is_closed_within_limits_tilt_and_downhand_and_faster(
    tilting, start, make, cells
):
    """Judged by pinocchio at the nodes: where the tool is, how it leans, how the surface leans."""
    stands = standing_joints(tilting, moving=True)
    found = improved(tilting, start, stands)
    before = steady_time(start, tilting.limits)
    assert steady_time(found, tilting.limits) < 0.8 * before
    limits, work = tilting.limits, tilting.chain.work
    assert ((found >= limits.lower) & (found <= limits.upper)).all()
    for q, share in zip(found, tilting.shares, strict=True):
        part, tool = make.by_pinocchio(cells["sda10f"], work, q)
        angle = share * np.radians(100.0)
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        tip = part.actInv(tool * np.array([0.0, 0.0, work.tool.standoff]))
        np.testing.assert_allclose(tip, 0.03 * out, atol=1e-7)
        lean = np.arccos(np.clip(-out @ (part.rotation.T @ tool.rotation[:, 2]), -1.0, 1.0))
        assert lean <= work.tool.tilt + 1e-6
        assert np.arccos((part.rotation @ out)[2]) <= work.downhand + 1e-6


def test_time_never_rises(cells, make):
    """From each of some starts, with few steps or more, to within what making it easy may cost."""
    problem = make.problem_on(cells["sda10f"], make.work_on(make.line()), samples=40)
    stands = standing_joints(problem, moving=False)
    ways = [w for w in seam_starts(problem).position if beyond_limits(problem, w).max() == 0.0][:2]
    for way in ways:
        before = steady_time(way, problem.limits)
        for steps in (1, 6):
            after = steady_time(improved(problem, way, stands, steps), problem.limits)
            assert after <= before * PROGRAM.spare_time


def test_a_slow_seam_is_not_wandered_along(cells, make):
    """Asked for a thousand seconds a way is made easy by its own time: joints travel no more than before."""
    work = make.work_on(make.line())
    problem = make.problem_on(cells["sda10f"], work, samples=60, time=1000.0)
    stands = standing_joints(problem, moving=False)
    ways = [w for w in seam_starts(problem).position if beyond_limits(problem, w).max() == 0.0][:2]
    for way in ways:
        before = np.abs(np.diff(way, axis=0)).sum()
        assert np.abs(np.diff(improved(problem, way, stands), axis=0)).sum() < 1.2 * before


def test_still_parts_stand_and_given_ways_are_followed(cells, make):
    """Master's joints the same at all nodes; a part that turns by 30 degrees is where its way says."""
    cell, work = cells["sda10f"], make.work_on(make.line())
    problem = make.problem_on(cell, work, samples=60)
    still = improved(
        problem, seam_starts(problem).position[0], standing_joints(problem, moving=False), 6
    )
    master = problem.chain.master_joints
    assert np.ptp(still[:, master], axis=0).max() == 0.0
    part, _ = make.by_pinocchio(cell, work, still[20])
    angle, up = np.radians(30.0), np.array([0.0, 0.0, 1.0])
    way = ToolPath((Turn(part, part.translation, up, angle, angle * up),))
    given = make.problem_on(cell, replace(work, hold=Hold(part_path=way)), samples=200)
    starts = seam_starts(given)
    assert starts.failure is None
    found = improved(given, starts.position[0], standing_joints(given, moving=True), 6)
    R, p = part_poses(given, given.shares)
    for k in (0, 13, 40):
        there, _ = make.by_pinocchio(cell, work, found[k])
        c, s = np.cos(np.radians(30.0) * k / 40), np.sin(np.radians(30.0) * k / 40)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        np.testing.assert_allclose(there.rotation, turn @ part.rotation, atol=1e-7)
        np.testing.assert_allclose(there.translation, part.translation, atol=1e-7)
        np.testing.assert_allclose(R[k], there.rotation, atol=1e-7)
        np.testing.assert_allclose(p[k], there.translation, atol=1e-7)


def test_what_improves_into_something_stops_short_of_it(cells, make):
    """A wall in joint space that the free descent crosses: all nodes keep off it, and it is still faster."""
    problem = make.problem_on(cells["sda10f"], make.work_on(make.line()), samples=40)
    stands = standing_joints(problem, moving=False)
    ways = seam_starts(problem).position
    way = next(w for w in ways if beyond_limits(problem, w).max() == 0.0)
    free = improved(problem, way, stands, 12)
    joint = int(np.argmax(np.abs(free - way).max(axis=0)))
    node = int(np.argmax(np.abs(free - way)[:, joint]))
    up = free[node, joint] > way[node, joint]
    wall = way[:, joint].max() + 0.05 if up else way[:, joint].min() - 0.05
    walled = replace(problem, is_free=lambda q: (q[:, joint] < wall) == up)
    assert not walled.is_free(free).all()
    found = improved(walled, way, stands, 12)
    assert walled.is_free(found).all()
    assert steady_time(found, problem.limits) < steady_time(way, problem.limits)
