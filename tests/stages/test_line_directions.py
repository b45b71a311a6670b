"""Lines in any direction: nodes, plans and their verification, by forward kinematics."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.lines import LineDirection, LineDirections
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan
from dualarm_cli.stages.plans.candidates import Grid
from dualarm_cli.stages.plans.source import grid_nodes
from dualarm_cli.stages.sequence_problem import sequence_problem
from dualarm_cli.verification import verify

LENGTH = 0.05
UP, ASIDE = LineDirection((0.0, 0.6, 0.8), fixed=True), LineDirection((0.6, 0.0, -0.8))
AHEAD = LineDirection((1.0, 0.0, 0.0), fixed=True)
Jobs = Callable[..., Job]


def directed(job: Job, approach: LineDirection, retract: LineDirection) -> Job:
    """A job whose lines all have these directions."""

    def turned(task):
        stops = [replace(s, directions=LineDirections(approach, retract)) for s in task.stops]
        return replace(task, stops=tuple(stops))

    return replace(job, tasks=tuple(map(turned, job.tasks)))


@pytest.mark.parametrize("numeric", [False, True])
@pytest.mark.parametrize("pair", [(UP, ASIDE), (UP, AHEAD)])
def test_nodes_end_their_lines_where_the_directions_say(random_job: Jobs, numeric, pair) -> None:
    """In the world: along a vector that stays, and along one that turns with the free yaw."""
    job = directed(random_job(3, (1, 1), line=LENGTH, free_yaw=True), *pair)
    problem = sequence_problem(CellModel.from_cell(job.cell, numeric=numeric), job)
    angles = np.radians([-20.0, 15.0])
    for a, work in enumerate(problem.arms):
        nodes, stop = grid_nodes(problem, a, 0, Grid(angles, 12, 400)), work.stops[0]
        assert len(nodes.work) > 20
        # A last joint that turns a line is not free.
        assert nodes.free_last == (not numeric and pair[1].fixed)
        R_world, p_world = problem.platform.pose(angles[nodes.angle_index][:, None])

        def tips(q, work=work, R_world=R_world, p_world=p_world):
            R, p = work.kinematics.forward(q)
            R_tool = R @ work.R_tool_flange.T
            tip = p - R_tool @ work.p_tool_flange
            return R_world @ R_tool, np.einsum("nij,nj->ni", R_world, tip) + p_world

        R_tool, target = tips(nodes.q_target)
        assert np.abs(target - stop.p_world_tool).max() < 1e-8
        for q, line in zip((nodes.q_approach, nodes.q_retract), pair, strict=True):
            R_end, end = tips(q)
            away = np.array(line.vector) if line.fixed else R_tool @ line.vector
            assert np.abs(R_end - R_tool).max() < 1e-8
            assert np.abs(end - target - LENGTH * away).max() < 1e-8


@pytest.mark.parametrize(("platform", "retract"), [("exact", ASIDE), ("sequence", AHEAD)])
def test_plans_keep_their_lines_and_the_bound(random_job: Jobs, platform, retract) -> None:
    """The verifier measures the directions, and no other ones."""
    job = directed(random_job(5, (1, 1), line=LENGTH, free_yaw=True, returns=True), UP, retract)
    schedule = plan(job, PlanSettings(platform=platform, effort="quick"))
    assert verify(schedule, job).passed
    assert schedule.lower_bound <= schedule.duration
    # Nothing is known of the joints where a free yaw turns a line.
    assert (schedule.lower_bound > 0.0) == retract.fixed
    plain = directed(job, LineDirection(), LineDirection())
    failed = {c.name for c in verify(schedule, plain).checks if c.verdict == "failed"}
    assert {"lines_straight", "line_lengths"} <= failed
