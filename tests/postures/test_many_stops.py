"""Many stops at once: the same answers as one by one, and times that are times."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.postures import NoPosture, solve_stops
from dualarm_cli.postures import arm_angle as member
from dualarm_cli.postures.arm_angle import (
    choose_near,
    choose_posture,
    choose_postures,
    coarse_candidates,
    refine,
)
from dualarm_cli.postures.problem import POSTURES
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.postures.stop_batch import StopBatch, batches
from dualarm_cli.postures.stop_candidates import StopCandidates
from dualarm_cli.postures.stop_lines import line_path
from dualarm_cli.postures.target_grid import target_postures


@pytest.fixture(scope="module")
def problems(tasks_folder):
    """Stops of both arms as they come: poses, free yaw, no lines, unequal lines, configurations, out of reach."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    home = job.cell.robot.postures["home"]
    plain = [
        problem
        for work in job.stages()[:5]
        for problem in stop_problems(model, job, home, work).values()
    ]
    one, other, third, fourth = plain[:4]
    q = choose_posture(other).q_target
    return [
        *plain,
        dataclasses.replace(one, yaw=np.arange(24) * np.pi / 12, free_yaw=True),
        dataclasses.replace(one, approach=0.0, retract=0.0),
        dataclasses.replace(third, retract=0.03, waiting=0.9),
        dataclasses.replace(other, configurations=np.array([q, q + 0.05]), yaw=np.zeros(1)),
        dataclasses.replace(fourth, p_base_tool=np.array([[10.0, 0.0, 0.0]])),
        dataclasses.replace(third, refine=False),
    ]


def with_targets(problem):
    """A problem of configurations with the poses that belong to them."""
    if problem.configurations is None:
        return problem
    R, p = problem.arm.forward(problem.configurations)
    R_tool = R @ problem.R_tool_flange.T
    return dataclasses.replace(
        problem, R_base_tool=R_tool, p_base_tool=p - R_tool @ problem.p_tool_flange
    )


def test_together_and_one_by_one_are_the_same_answers(problems):
    """In the order asked, whatever is asked with them, to the last digits."""
    problems = [with_targets(problem) for problem in problems]
    together = choose_postures(problems[::-1])[::-1]
    assert len(together) == len(problems)
    for problem, answer in zip(problems, together, strict=True):
        alone = choose_posture(problem)
        assert type(answer) is type(alone)
        if isinstance(alone, NoPosture):
            assert answer == alone
            continue
        for field in dataclasses.fields(alone):
            assert getattr(answer, field.name) == pytest.approx(
                getattr(alone, field.name), abs=1e-9
            )


def test_what_has_no_batch_form_is_asked_one_by_one(problems, monkeypatch):
    """The same answers through the registry's single form."""
    together = solve_stops("arm_angle", problems[:2])
    monkeypatch.setattr("dualarm_cli.postures.BATCH_FORMS", {})
    one_by_one = solve_stops("arm_angle", problems[:2])
    for one, other in zip(together, one_by_one, strict=True):
        assert one.q_approach == pytest.approx(other.q_approach, abs=1e-9)


def test_only_problems_of_one_kind_share_a_batch(problems):
    """Every problem is in one batch; arms, given configurations and free yaws are not mixed."""
    found = batches(problems)
    assert sorted(np.concatenate([numbers for numbers, _ in found])) == list(range(len(problems)))
    for numbers, batch in found:
        kinds = {
            (id(problems[k].arm), problems[k].free_yaw, problems[k].configurations is None)
            for k in numbers
        }
        assert len(kinds) == 1
        assert batch.problems == tuple(problems[k] for k in numbers)


def test_the_cost_is_the_time_and_nothing_else(problems):
    """Closed form of the transfer, or the wait for the platform, and both lines as they are estimated."""
    for problem in problems:
        problem = with_targets(problem)
        posture = choose_posture(problem)
        if isinstance(posture, NoPosture):
            continue
        transfer = float(problem.transfer_time(posture.q_approach - problem.start))
        total = max(transfer, problem.waiting)
        for line, length in (("approach", problem.approach), ("retract", problem.retract)):
            if length > 0:
                q, way = line_path(problem, posture, line, 7)
                total += float(problem.line_time(q[None], way)[0])
        assert posture.cost == pytest.approx(total, rel=1e-9)


def test_lines_that_are_not_timed_could_not_have_been_the_best(problems):
    """The quick look and the complete one agree on the best way of every stop."""
    for _, batch in batches([with_targets(problem) for problem in problems]):
        grid = target_postures(batch)
        rows = [row for row, one in enumerate(grid) if isinstance(one, StopCandidates)]
        if not rows:
            continue
        quick, complete = (coarse_candidates(batch, grid, rows, full) for full in (False, True))
        assert len(quick.row) <= len(complete.row)
        for row in rows:
            one, other = (ways.cost[ways.row == row] for ways in (quick, complete))
            # The second place is for a way that is far from the first.
            assert (np.diff(np.delete(one, 1)) >= 0).all()
            assert one[0] == other[0] == other.min()


def test_near_a_posture_there_is_itself_and_what_is_quicker(problems):
    """Varied by next to nothing the posture comes back with its lines; varied by more, none that takes longer."""
    told = 0
    for problem in map(with_targets, problems):
        like = choose_posture(problem)
        if isinstance(like, NoPosture):
            continue
        [same] = choose_near([problem], [like], [like.cost + 1.0], 1e-9)
        for name in ("q_approach", "q_target", "q_retract"):
            assert getattr(same, name) == pytest.approx(getattr(like, name), abs=1e-7)
        assert same.cost == pytest.approx(like.cost, abs=1e-7)
        told += abs(like.psi_approach - like.psi_target) > 0.01
        [near] = choose_near([problem], [like], [like.cost + 1.0], 0.1)
        assert near.cost <= like.cost + 0.01
        # Half the time is more than any variation gains.
        assert choose_near([problem], [like], [0.5 * like.cost], 0.1) == [None]
    assert told > 2


def test_every_round_of_refinement_is_at_least_as_good(problems):
    """Costs never rise, and fall for most stops."""
    gained = []
    for _, batch in batches([with_targets(problem) for problem in problems]):
        grid = target_postures(batch)
        rows = [row for row, one in enumerate(grid) if isinstance(one, StopCandidates)]
        if not rows:
            continue
        ways = coarse_candidates(batch, grid, rows, False)
        best = ways.take(np.array([int(np.argmax(ways.row == row)) for row in rows]))
        rounds = refine(batch, best)
        assert (rounds[0].cost == best.cost).all()
        costs = np.array([stage.cost for stage in rounds])
        assert (np.diff(costs, axis=0) <= 0).all()
        gained += (costs[0] - costs[-1]).tolist()
        if batch.given:
            assert all((stage.psi == best.psi).all() for stage in rounds)
        if not batch.free_yaw:
            assert all((stage.yaw == best.yaw).all() for stage in rounds)
    assert np.mean(np.array(gained) > 0) > 0.5


def test_the_next_best_way_is_taken_where_the_best_does_not_hold_between_samples(
    problems, monkeypatch
):
    """A posture that fails the dense check at every refinement gives way to the next one."""
    problem = problems[0]
    settled, refused = member._refine_to_postures, []

    def refuse_first(batch: StopBatch, ways):
        if not refused:
            refused.append(ways)
            return {}
        return settled(batch, ways)

    monkeypatch.setattr(member, "_refine_to_postures", refuse_first)
    second = choose_posture(problem)
    assert len(refused[0].row) == POSTURES.starts
    monkeypatch.undo()
    # The ways that come next, by a look at all of them.
    (batch,) = [batch for _, batch in batches([problem])]
    ways = coarse_candidates(batch, target_postures(batch), [0], False)
    following = ways.take(np.arange(POSTURES.starts, 2 * POSTURES.starts))
    expected = refine(batch, following)[-1]
    assert second.cost == pytest.approx(float(expected.time[0]), rel=1e-9)
    assert second.psi_target == pytest.approx(float(expected.psi[0]), abs=1e-9)


def test_of_several_ways_the_one_that_refines_best_is_taken(problems):
    """Ways refined together end no worse than each of them alone, as far as all are refined."""
    for problem in problems[:6]:
        (batch,) = [batch for _, batch in batches([problem])]
        ways = coarse_candidates(batch, target_postures(batch), [0], False)
        two = ways.take(np.arange(2))
        together = refine(batch, two)
        assert {len(stage.row) for stage in together} == {1}
        alone = [refine(batch, two.take(np.array([k]))) for k in (0, 1)]
        leader = min(alone, key=lambda rounds: rounds[POSTURES.joint_rounds].cost[0])
        assert together[-1].cost[0] == pytest.approx(leader[-1].cost[0], rel=1e-9)


def test_the_second_way_is_far_from_the_first(problems):
    """Another branch, or arm angle or yaw at least POSTURES.far_angle away, and the best of all such."""
    for problem in problems[:6]:
        (batch,) = [batch for _, batch in batches([problem])]
        ways = coarse_candidates(batch, target_postures(batch), [0], True)
        psi, yaw = (
            np.abs(np.angle(np.exp(1j * (v - v[0])))) > POSTURES.far_angle
            for v in (ways.psi, ways.yaw)
        )
        far = psi | yaw | (ways.branch != ways.branch[0])
        assert ways.cost[0] == ways.cost.min()
        if far.any():
            assert far[1]
            assert ways.cost[1] == ways.cost[far].min()
