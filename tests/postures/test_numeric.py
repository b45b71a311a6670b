"""The numeric redundancy solver: against closed forms, and what a stop may ask for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.serial_chain import pose_error
from dualarm_cli.postures import REDUNDANCY_SOLVERS, NoPosture, StopPosture, solve_stops
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.postures.stop_lines import flange_poses, line_path

AHEAD = np.array([1.0, 0.0, 0.0])


def problems_of(job, numeric):
    """All stops of a job, as seen from its start."""
    model = CellModel.from_cell(job.cell, numeric=numeric)
    home = np.array(job.start_joints)
    return [one for work in job.stages() for one in stop_problems(model, job, home, work).values()]


@pytest.fixture(scope="module")
def yumi(general_robots, tmp_path_factory):
    """Stops of the YuMi with approach and retract."""
    folder = tmp_path_factory.mktemp("yumi")
    return problems_of(load_job(general_robots.write_cell(folder, "yumi")), numeric=True)


def test_it_is_about_as_quick_as_the_closed_forms_where_an_arm_has_them(tasks_folder):
    """Stops of the SDA10F: on average within 3 % of `arm_angle`, which searches the same postures otherwise."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    exact = solve_stops("arm_angle", problems_of(job, numeric=False))
    numeric = solve_stops("numeric", problems_of(job, numeric=True))
    both = [
        (one.cost, other.cost)
        for one, other in zip(exact, numeric, strict=True)
        if isinstance(one, StopPosture) and isinstance(other, StopPosture)
    ]
    assert len(both) == sum(isinstance(one, StopPosture) for one in exact) >= 2
    closed, sampled = np.array(both).T
    assert sampled.mean() <= 1.03 * closed.mean()


@pytest.mark.parametrize("line", ["approach", "retract"])
def test_the_lines_of_a_posture_are_exact_and_end_where_it_says(yumi, line):
    """65 samples: flange poses along the tool's z axis to 1e-9, ends bit for bit those of the posture or nearly."""
    for problem in yumi:
        posture = REDUNDANCY_SOLVERS["numeric"].solve(problem)
        assert isinstance(posture, StopPosture)
        q, length = line_path(problem, posture, line, 65)
        outward = q if line == "retract" else q[::-1]
        end = posture.q_retract if line == "retract" else posture.q_approach
        assert np.array_equal(outward[0], posture.q_target)
        assert np.abs(outward[-1] - end).max() < 1e-9
        R, p, away = flange_poses(problem, np.array([posture.target]), np.array([posture.yaw]))
        R_found, p_found = problem.arm.forward(outward)
        assert (
            np.abs(pose_error(R_found, p_found, R, p + away[:, 0] * length[:, None])).max() < 1e-9
        )
        few = [line_path(problem, posture, name, 7) for name in ("approach", "retract")]
        lines = sum(float(problem.line_time(q[None], length)[0]) for q, length in few)
        move = float(problem.transfer_time(posture.q_approach - problem.start))
        assert posture.cost == pytest.approx(move + lines, abs=1e-9)


def test_refinement_never_makes_a_stop_longer(yumi):
    """And on the YuMi's stops it shortens most."""
    shorter = 0
    for problem in yumi:
        plain = REDUNDANCY_SOLVERS["numeric"].solve(replace(problem, refine=False))
        refined = REDUNDANCY_SOLVERS["numeric"].solve(problem)
        assert refined.cost <= plain.cost + 0.02
        shorter += refined.cost < plain.cost - 1e-3
    assert shorter > len(yumi) / 2


def test_freedom_of_yaw_is_used(yumi):
    """Quarter turns, and any turn: nowhere much slower than the nominal one, and quicker on average."""
    solve = REDUNDANCY_SOLVERS["numeric"].solve
    nominal = [solve(problem).cost for problem in yumi[:3]]
    quarters = [solve(replace(p, yaw=np.arange(4) * np.pi / 2)) for p in yumi[:3]]
    every = [solve(replace(p, yaw=np.arange(12) * np.pi / 6, free_yaw=True)).cost for p in yumi[:3]]
    for one in quarters:
        assert min(abs(one.yaw - k * np.pi / 2) for k in range(4)) == 0.0
    assert np.mean([one.cost for one in quarters]) <= np.mean(nominal) + 0.02
    assert np.mean(every) < np.mean(nominal)


def test_given_configurations_are_taken_as_they_are(yumi):
    """The nearer one of two, bit for bit, if its lines can be followed."""
    problem = yumi[0]
    first = REDUNDANCY_SOLVERS["numeric"].solve(problem)
    q = np.stack([problem.start + 0.3, first.q_target])
    R, p = problem.arm.forward(q)
    tool = R @ problem.R_tool_flange.T
    given = replace(
        problem,
        configurations=q,
        R_base_tool=tool,
        p_base_tool=p - (tool @ problem.p_tool_flange),
        yaw=np.zeros(1),
        approach=0.0,
        retract=0.0,
    )
    found = REDUNDANCY_SOLVERS["numeric"].solve(given)
    assert np.array_equal(found.q_target, q[found.target])
    assert np.array_equal(found.q_approach, found.q_target)
    least = [float(problem.transfer_time(one - problem.start)) for one in q]
    assert found.target == int(np.argmin(least))
    # Also one that self-motion would bring nearer to the start, with lines and without.
    for line in (0.0, 0.02):
        alone = replace(
            given,
            configurations=q[:1],
            R_base_tool=given.R_base_tool[:1],
            p_base_tool=given.p_base_tool[:1],
            approach=line,
        )
        assert np.array_equal(REDUNDANCY_SOLVERS["numeric"].solve(alone).q_target, q[0])


def test_what_has_to_keep_clear_does(yumi):
    """A test that forbids joint 1 beyond where the best posture has it, at every place."""
    problem = yumi[0]
    best = REDUNDANCY_SOLVERS["numeric"].solve(problem)
    edge = best.q_target[0] - 0.2
    asked = []

    def clear(q, place):
        asked.append(place)
        return q[:, 0] < edge

    found = REDUNDANCY_SOLVERS["numeric"].solve(replace(problem, is_free=clear))
    assert max(found.q_approach[0], found.q_target[0], found.q_retract[0]) < edge
    assert {"approach", "target", "retract"} == set(asked)
    never = replace(problem, is_free=lambda q, _: np.zeros(len(q), dtype=np.bool_))
    reason = REDUNDANCY_SOLVERS["numeric"].solve(never)
    assert isinstance(reason, NoPosture)
    assert "collides or lacks clearance" in str(reason.reason)


def test_targets_out_of_reach_have_their_reason(yumi):
    """Far beyond all links together, and just beyond what the arm can do."""
    problem = yumi[0]
    far = replace(problem, p_base_tool=problem.p_base_tool + 3.0 * AHEAD)
    assert "out of the arm's reach" in str(REDUNDANCY_SOLVERS["numeric"].solve(far).reason)
    near = replace(problem, p_base_tool=problem.p_base_tool + 0.35 * AHEAD)
    assert "nearest one found misses it by" in str(REDUNDANCY_SOLVERS["numeric"].solve(near).reason)


def test_solvers_say_which_arms_they_serve(yumi, tasks_folder):
    """No arm angle without closed forms; `numeric` wants an arm that was measured as a general one."""
    assert "no arm angle" in REDUNDANCY_SOLVERS["arm_angle"].why_unsupported(yumi[0])
    assert REDUNDANCY_SOLVERS["numeric"].why_unsupported(yumi[0]) is None
    with pytest.raises(UnsupportedError, match="redundancy numeric"):
        REDUNDANCY_SOLVERS["arm_angle"].solve(yumi[0])
    closed = problems_of(load_job(tasks_folder / "01_first_pick" / "tasks.yaml"), numeric=False)
    assert REDUNDANCY_SOLVERS["arm_angle"].why_unsupported(closed[0]) is None
    assert "general" in REDUNDANCY_SOLVERS["numeric"].why_unsupported(closed[0])
