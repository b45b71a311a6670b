"""Stages decided by several platform solvers at once: what each would have decided for itself."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from dualarm_cli.errors import InfeasibleError, UnknownSolverError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.postures import reach
from dualarm_cli.postures.problem import POSTURES
from dualarm_cli.postures.stage_problems import Clock, stop_problems
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages, choose_stages_with
from dualarm_cli.stages.stage_choice import OpenStage, try_places
from tests.packing_tasks import packing_job

SOLVERS = ["fixed", "linearised", "exact"]


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """The packing job, its first six tasks."""
    return packing_job(tasks_folder, 6)


@pytest.fixture(scope="module")
def model(packing):
    """Its cell."""
    return CellModel.from_cell(packing.cell)


def moved(job, index, translation):
    """The job with one task's first target elsewhere."""
    task = job.tasks[index]
    target = task.stops[0].target
    pose = target.pose.copy()
    pose.translation[:] = translation
    stop = dataclasses.replace(task.stops[0], target=dataclasses.replace(target, pose=pose))
    tasks = list(job.tasks)
    tasks[index] = dataclasses.replace(task, stops=(stop, *task.stops[1:]))
    return dataclasses.replace(job, tasks=tuple(tasks))


@pytest.mark.parametrize("start", ["home", "free"])
def test_together_is_as_each_for_itself(packing, model, start):
    """Same stages in the same order, joint for joint, from a posture and from a free start."""
    job = dataclasses.replace(packing, start=start)
    together = choose_stages_with(MethodProblem(model, job, "arm_angle"), SOLVERS)
    assert list(together) == SOLVERS
    for name in SOLVERS:
        alone = choose_stages(MethodProblem(model, job, "arm_angle"), name)
        assert len(together[name]) == len(alone) == len(job.stages()) + job.returns
        for one, other in zip(together[name], alone, strict=True):
            assert one.solver == other.solver
            assert one.duration == pytest.approx(other.duration, rel=1e-9)
            for field in ("start", "arrival", "end"):
                assert getattr(one, field) == pytest.approx(getattr(other, field), abs=1e-9)


def test_one_that_fails_leaves_the_others_alone(packing, model, monkeypatch):
    """A solver whose angles none will do, and whose scan is empty, is a reason; the others plan on."""
    from dualarm_cli.stages import stage_choice as stages

    candidates, scan = stages.platform_candidates, stages.reachable_positions
    stuck = []

    def none_for_exact(model, position, stops, solver):
        if solver == "exact":
            stuck.append(position.tobytes())
            return
        yield from candidates(model, position, stops, solver)

    def no_scan_where_stuck(model, position, stops):
        if position.tobytes() not in stuck:
            yield from scan(model, position, stops)

    monkeypatch.setattr(stages, "platform_candidates", none_for_exact)
    monkeypatch.setattr(stages, "reachable_positions", no_scan_where_stuck)
    found = choose_stages_with(MethodProblem(model, packing, "arm_angle"), SOLVERS)
    assert isinstance(found["exact"], InfeasibleError)
    monkeypatch.undo()
    alone = choose_stages(MethodProblem(model, packing, "arm_angle"), "linearised")
    assert [plan.duration for plan in found["linearised"]] == pytest.approx(
        [plan.duration for plan in alone], rel=1e-9
    )


def test_what_nobody_reaches_is_every_solvers_reason(packing, model):
    """Ten metres away: one error each, all with the place."""
    job = moved(packing, 2, [10.0, 0.0, 1.0])
    found = choose_stages_with(MethodProblem(model, job, "arm_angle"), SOLVERS)
    for failure in found.values():
        assert isinstance(failure, InfeasibleError)
        assert job.tasks[2].id in str(failure)
    with pytest.raises(InfeasibleError, match=re.escape(job.tasks[2].id)):
        choose_stages(MethodProblem(model, job, "arm_angle"), "exact")


def test_unknown_names_are_refused(packing, model):
    """Platform and redundancy solvers alike."""
    with pytest.raises(UnknownSolverError):
        choose_stages_with(MethodProblem(model, packing, "arm_angle"), ["exat"])
    with pytest.raises(UnknownSolverError):
        choose_stages_with(MethodProblem(model, packing, "arm_engel"), ["fixed"])


def test_stages_without_lines_last_their_closed_forms_alone(packing, model):
    """No share of the travel is in them: slowest joint of platform and arm, and the dwell, of the slower arm."""
    tasks = tuple(
        dataclasses.replace(
            task,
            stops=tuple(dataclasses.replace(s, approach=0.0, retract=0.0) for s in task.stops),
        )
        for task in packing.tasks
    )
    job = dataclasses.replace(packing, tasks=tasks)
    robot = job.cell.robot
    law = RestToRest(robot.limits.velocity, robot.limits.acceleration, robot.limits.jerk)
    for plan in choose_stages(MethodProblem(model, job, "arm_angle"), "exact"):
        alone = law.per_joint(plan.arrival - plan.start)
        platform = alone[model.platform_columns].max()
        dwells = {name: stop.stop.dwell.total for name, stop in plan.stops.items()}
        expected = max(
            max(platform, alone[arm.columns].max()) + dwells.get(name, 0.0)
            for name, arm in model.arms.items()
            if name in plan.stops or not plan.stops
        )
        assert plan.duration == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("place", [[-0.3, -0.6, 1.0], [-0.5, 0.5, 0.9], [0.1, -0.75, 0.8]])
def test_the_scan_in_blocks_finds_what_the_whole_scan_finds(packing, model, place):
    """Nearest first, and none left out, against a look at every angle."""
    job = moved(packing, 0, place)
    home = np.array(job.cell.robot.postures["home"])
    stops = stop_problems(model, job, home, job.stages()[0])
    assert isinstance(job.stages()[0]["left"][1].target, PoseTarget)
    angles, here = reach.scanned_positions(model, home)
    usable = np.ones(len(angles), dtype=bool)
    for stop in stops.values():
        usable &= reach._common_angles(reach._points(stop, model.platform, angles - here))
    nearest = angles[np.argsort(np.abs(angles - here), kind="stable")]
    expected = [a for a in nearest if usable[angles == a][0]][: POSTURES.max_angles]
    found = [float(one[0]) for one in reach.reachable_positions(model, home, stops)]
    assert found == expected


def test_solvers_at_the_same_angle_from_different_positions_are_not_confused(packing, model):
    """Two starts, one platform angle: each has its own transfer, as if it had been alone."""
    home = np.array(packing.cell.robot.postures["home"])
    other = home.copy()
    other[model.arms["left"].columns] += 0.2
    stage = OpenStage(model, Clock.of(model, packing), packing.stages()[0], True, None, "arm_angle")
    places = {name: ("fixed", np.zeros(1)) for name in ("one", "two", "three")}
    positions = {"one": home, "two": other, "three": home}
    together = try_places(stage, positions, places)
    for name, position in positions.items():
        alone = try_places(stage, {name: position}, {name: places[name]})[name]
        assert together[name].start == pytest.approx(position)
        assert together[name].duration == pytest.approx(alone.duration, rel=1e-9)
        assert together[name].arrival == pytest.approx(alone.arrival, abs=1e-9)
    assert together["one"].stops["left"].problem.start == pytest.approx(
        home[model.arms["left"].columns]
    )
    assert together["two"].stops["left"].problem.start == pytest.approx(
        other[model.arms["left"].columns]
    )
