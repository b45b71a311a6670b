"""Whole motions looked at in one go, against every stage and every instant looked at one by one."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin

from dualarm_cli.clearing.repairs import Clearing
from dualarm_cli.clearing.stage_samples import (
    KEPT,
    StageSamples,
    _keep_margins,
    stage_samples,
    which_are_clear,
)
from dualarm_cli.collision.clearance import Loads
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import MotionCache
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS

LINES = SimpleNamespace(may_only_touch=lambda held: Loads(("",)).are_on_lines(held).any(axis=1))
"""A test in which what is held may touch on lines only."""


def test_stages_that_touch_are_those_of_which_an_instant_touches(tasks_folder):
    """Greedy plans without collision checking: at full density, no instant of a clear stage lacks anything."""
    timing = TIMING_SOLVERS["ruckig"]
    touched = 0
    for name in ("06_shared_bin", "08_narrow_bin"):
        job = load_job(tasks_folder / name / "tasks.yaml")
        model = CellModel.from_cell(job.cell)
        plans = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed", refine=False)
        motion = realise(model, job, plans, timing)
        holding = Holding.of(job)
        stages = [stage_samples(motion, k, k, holding) for k in range(len(motion.stages))]
        together = which_are_clear(holding.cell, stages)
        for stage, clear in zip(stages, together, strict=True):
            assert which_are_clear(holding.cell, [stage])[0] == clear
            lacks = holding.cell.margins(stage.position, stage.held).min() < KEPT
            # Between instants it is looked at more closely: there may be more, never less.
            assert not (lacks and clear)
        touched += int((~together).sum())
        clearing = Clearing(model, job, holding, timing, 0)
        colliding = clearing.colliding_stages(plans, motion)
        assert colliding == np.flatnonzero(~together).tolist()
        assert clearing.colliding_stages(plans, motion) == colliding
    assert 0 < touched < 40


def test_lines_that_are_timed_already_are_the_same_lines(tasks_folder):
    """A plan realised twice with one memory is the plan realised without; other postures get lines of their own."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    model, timing = CellModel.from_cell(job.cell), TIMING_SOLVERS["ruckig"]
    cache = MotionCache()
    one = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed", refine=False)
    other = choose_stages(MethodProblem(model, job, "arm_angle"), "exact")
    for plans in (one, other, one):
        again = realise(model, job, plans, timing, cache)
        anew = realise(model, job, plans, timing)
        np.testing.assert_array_equal(again.trajectory.position, anew.trajectory.position)
        np.testing.assert_array_equal(again.trajectory.time, anew.trajectory.time)
    stops = sum(len(plan.stops) for plan in one)
    assert 2 * stops < len(cache.lines) <= 4 * stops


def test_a_part_that_reaches_into_something_for_a_moment_on_its_line_is_seen():
    """Margins of what lies count only below zero: five instants of a thousand, between those looked at first."""
    lies = np.zeros((1000, 2), dtype=np.int64)
    position = np.arange(1000.0)[:, None]

    def margins(position, held):
        colliding = (position[:, 0] > 88.5) & (position[:, 0] < 94.5) & (held[:, 0] == 3)
        return np.where(colliding, -0.005, 0.2)

    assert _keep_margins(LINES, [StageSamples(position, lies)], margins)[0]
    on_line = lies.copy()
    on_line[:, 0] = 3
    assert not _keep_margins(LINES, [StageSamples(position, on_line)], margins)[0]


def test_an_arm_that_is_late_is_where_it_was_before():
    """By rows: in its stage, before that in the one before it, and after it until it is done as well."""
    before = StageSamples(np.array([[0.0, 10.0], [1.0, 11.0]]), np.array([[0, 5], [1, 6]]))
    this = StageSamples(np.array([[2.0, 12.0], [3.0, 13.0]]), np.array([[2, 7], [3, 8]]))
    found = this.delayed([1], 1, 1)
    np.testing.assert_array_equal(found.position, [[2.0, 12.0], [3.0, 12.0], [3.0, 13.0]])
    np.testing.assert_array_equal(found.held, [[2, 7], [3, 7], [3, 8]])
    found = replace(this, before=before).delayed([1], 1, 1)
    np.testing.assert_array_equal(found.position, [[2.0, 11.0], [3.0, 12.0], [3.0, 13.0]])
    np.testing.assert_array_equal(found.held, [[2, 6], [3, 7], [3, 8]])
    far = replace(this, before=before).delayed([0], 0, 4)
    np.testing.assert_array_equal(far.position[:, 0], [0.0, 0.0, 0.0, 1.0, 2.0, 3.0])
    np.testing.assert_array_equal(far.position[:, 1], [12.0, *[13.0] * 5])


def _along_the_shelf(task, way):
    """The same task with its place elsewhere along the tool's y axis [m]."""
    *others, place = task.stops
    pose = place.target.pose
    there = pin.SE3(pose.rotation, pose.translation + way * pose.rotation[:, 1])
    target = replace(place.target, pose=there)
    return replace(task, stops=(*others, replace(place, target=target)))


def test_with_a_skew_stages_touch_whose_arms_touch_when_one_is_late(tasks_folder):
    """A greedy plan, its hands to be 0.2 m apart, against many delays up to 0.3 s at instants of the whole motion."""
    timing, skew = TIMING_SOLVERS["ruckig"], 0.3
    job = load_job(tasks_folder / "08_narrow_bin" / "tasks.yaml")
    tasks = tuple(replace(task, part="") for task in job.tasks)
    tasks = (*tasks[:1], *(_along_the_shelf(task, -0.04) for task in tasks[1:5]), *tasks[5:])
    last = ("tool", "link_b", "link_r")
    apart = tuple((f"left_{one}", f"right_{other}", 0.2) for one in last for other in last)
    cell = replace(job.cell, clearances=apart)
    job = replace(job, cell=cell, tasks=tasks)
    model = CellModel.from_cell(job.cell)
    plans = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed", refine=False)
    motion = realise(model, job, plans, timing)
    holding = Holding.of(replace(job, skew=skew))
    plain = Clearing(model, job, Holding.of(job), timing, 0).colliding_stages(plans, motion)
    colliding = Clearing(model, job, holding, timing, 0).colliding_stages(plans, motion)
    late = set()
    for k, stage in enumerate(motion.stages):
        times = np.arange(stage.start, stage.end, 0.01)
        for columns in holding.cell.columns:
            for delay in np.linspace(0.0, skew, 7):
                q = motion.trajectory.clamped(times)[0]
                q[:, columns] = motion.trajectory.clamped(times - delay)[0][:, columns]
                held = np.zeros((len(q), 2), dtype=np.int64)
                if holding.cell.cross_margins(q, held).min() < KEPT:
                    late.add(k)
    assert late - set(plain)
    assert set(plain) | late <= set(colliding)
    # Between the instants and delays of this test there are others, but few.
    assert len(set(colliding) - set(plain) - late) <= 1
