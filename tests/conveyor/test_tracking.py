"""One arm at a part on a conveyor: with the belt to a fraction of a micrometre, within every limit, at any speed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.conveyor.tracking import Tracking
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.verification.motion_checks import check_agreement, check_limits, check_rest

DWELL = 0.2


def _tracking(model, job, redundancy):
    """Returns what one arm's first stop asks for, on a belt that stands so far."""
    [plan, *_] = choose_stages(
        MethodProblem(model, job, redundancy), "fixed", count=1, refine=False
    )
    name, stop = next(iter(plan.stops.items()))
    limits = job.cell.robot.limits.select(model.arms[name].arm.joints)
    # With a spare degree of freedom: the arm angle changes on both lines, by a little.
    posture = dataclasses.replace(
        stop.posture,
        psi_approach=stop.posture.psi_target + 0.05,
        psi_retract=stop.posture.psi_target - 0.05,
    )
    return Tracking(stop.problem, posture, np.zeros(3), DWELL, limits, None)


@pytest.fixture(scope="module")
def srs(tasks_folder):
    """An SDA10F's arm at its first pick."""
    job = load_job(tasks_folder / "02_two_trays" / "tasks.yaml")
    return _tracking(CellModel.from_cell(job.cell), job, "arm_angle")


@pytest.fixture(scope="module")
def general(tasks_folder):
    """The same arm as if it had no closed forms."""
    job = load_job(tasks_folder / "02_two_trays" / "tasks.yaml")
    return _tracking(CellModel.from_cell(job.cell, numeric=True), job, "numeric")


def _tool(asked, q):
    """Returns the tool's rotations and positions by the arm's forward kinematics."""
    R, p = asked.problem.arm.forward(q)
    R_tool = R @ asked.problem.R_tool_flange.T
    return R_tool, p - R_tool @ asked.problem.p_tool_flange


def _check(asked, found):
    """Checks a tracked motion by what it is for: instants of its own, the target's own numbers."""
    motion, problem, v = found.motion, asked.problem, asked.velocity
    checks = [*check_limits(motion, asked.limits), *check_agreement(motion), check_rest(motion)]
    assert all(check.verdict == "passed" for check in checks), checks
    time = np.linspace(0.0, motion.duration, 3001)
    R, p = _tool(asked, motion.at(time)[0])
    local = (
        p - problem.p_base_tool[0] - (time - found.reached)[:, None] * v
    ) @ problem.R_base_tool[0]
    axis = np.linalg.norm(R[:, :, 2] - problem.R_base_tool[0][:, 2], axis=1)
    assert axis.max() < 1e-4
    dwell = (time >= found.reached) & (time <= found.left)
    assert found.left - found.reached == pytest.approx(DWELL)
    assert np.linalg.norm(local[dwell], axis=1).max() < 1e-6
    rise, fall = found.phases.rise, motion.duration - found.phases.fall
    steady = (time >= rise) & (time <= fall)
    assert np.hypot(local[steady, 0], local[steady, 1]).max() < 1e-4
    assert -local[steady, 2].min() == pytest.approx(
        max(problem.approach, problem.retract), abs=1e-4
    )
    # In a ramp to the belt's speed, symmetric in time, the tool goes half as far as the belt.
    back = (p[0] - problem.p_base_tool[0]) + problem.approach * problem.R_base_tool[0][:, 2]
    assert back == pytest.approx(-v * (found.phases.approach + 0.5 * rise), abs=1e-9)
    on = (p[-1] - problem.p_base_tool[0]) + problem.retract * problem.R_base_tool[0][:, 2]
    after = DWELL + found.phases.retract + 0.5 * found.phases.fall
    assert on == pytest.approx(v * after, abs=1e-9)


velocities = st.tuples(st.floats(0.01, 0.25), st.floats(-np.pi, np.pi), st.floats(-0.3, 0.3)).map(
    lambda s: (
        s[0] * np.array([np.cos(s[1]) * np.cos(s[2]), np.sin(s[1]) * np.cos(s[2]), np.sin(s[2])])
    )
)
"""Of any direction that slopes by 0.3 rad at most."""


@settings(max_examples=25, deadline=None)
@given(velocity=velocities)
def test_at_any_speed_it_stays_with_the_part_within_limits(srs, velocity):
    """Or it is said that it cannot: at 0.1 m/s it always can."""
    asked = dataclasses.replace(srs, velocity=velocity)
    try:
        found = asked.solve()
    except InfeasibleError:
        assert np.linalg.norm(velocity) > 0.1
        return
    _check(asked, found)


@settings(max_examples=4, deadline=None)
@given(velocity=velocities)
def test_arms_without_closed_forms_do_the_same(general, velocity):
    """Their postures are followed from the target, the way along the self-motion as the arm angle is."""
    asked = dataclasses.replace(general, velocity=velocity)
    try:
        found = asked.solve()
    except InfeasibleError:
        assert np.linalg.norm(velocity) > 0.1
        return
    _check(asked, found)


def test_no_phase_could_be_much_shorter(srs):
    """With every moving phase 5 % shorter some limit is exceeded in each of them."""
    asked = dataclasses.replace(srs, velocity=np.array([0.0, -0.15, 0.0]))
    found = asked.solve()
    shorter = found.phases.longer(np.full(5, 0.95))
    motion, index = asked._motion(shorter, 32)
    excess = asked._excess(motion, shorter, index)
    assert (excess[[0, 1, 3, 4]] > 1.0).all()


def test_a_cap_on_the_tools_speed_is_kept(srs):
    """The tool goes along and down at once: beside 0.15 m/s of the belt a cap of 0.2 leaves sqrt(0.2² - 0.15²)."""
    velocity = np.array([0.0, -0.15, 0.0])
    asked = dataclasses.replace(srs, velocity=velocity, cap=0.2)
    found = asked.solve()
    _check(asked, found)
    time = np.linspace(0.0, found.motion.duration, 20001)
    _, p = _tool(asked, found.motion.at(time)[0])
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / np.diff(time)
    assert speed.max() <= 0.2 * (1.0 + 1e-6)
    # The line's way over its largest speed is a lower bound of its time.
    assert found.phases.approach >= asked.problem.approach / np.sqrt(0.2**2 - 0.15**2)
    with pytest.raises(InfeasibleError, match=r"capped at 0\.1 m/s"):
        dataclasses.replace(asked, cap=0.1).solve()


def test_a_belt_that_leaves_the_arms_reach_is_refused(srs):
    """At 5 m/s the dwell alone takes it 1 m."""
    with pytest.raises(InfeasibleError, match=r"reach|keep up"):
        dataclasses.replace(srs, velocity=np.array([5.0, 0.0, 0.0])).solve()
