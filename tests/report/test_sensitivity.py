"""Sensitivity: what is said of other limits is what the same postures take when they are timed with them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.schedule import Provenance, Schedule, ScheduleRobot
from dualarm_cli.motion.motion import realise
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.report.measures import bottlenecks
from dualarm_cli.report.sensitivity import SENSITIVITY, sensitivity
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS
from tests.packing_tasks import packing_job


def with_limits(job, **changes):
    """The job with other limits on its robot."""
    robot = job.cell.robot
    limits = dataclasses.replace(robot.limits, **changes)
    cell = dataclasses.replace(job.cell, robot=dataclasses.replace(robot, limits=limits))
    return dataclasses.replace(job, cell=cell)


def bare(job):
    """The job without lines and dwells: transfers only."""
    tasks = tuple(
        dataclasses.replace(
            task,
            stops=tuple(dataclasses.replace(s, approach=0.0, retract=0.0) for s in task.stops),
        )
        for task in job.tasks
    )
    return dataclasses.replace(job, tasks=tasks)


class Planned:
    """A job's decided stages, and how long they take with any limits."""

    def __init__(self, job, platform="fixed"):
        """Decides the stages."""
        self.job, self.model = job, CellModel.from_cell(job.cell)
        self.stages = choose_stages(MethodProblem(self.model, job, "arm_angle"), platform)

    def motion(self, job):
        """The motion of the stages under a job's limits."""
        return realise(self.model, job, self.stages, TIMING_SOLVERS["ruckig"])

    @property
    def schedule(self):
        """The stages' schedule."""
        motion = self.motion(self.job)
        return Schedule(
            ScheduleRobot.of_job(self.job),
            JointMotion.of(motion.trajectory),
            motion.stages,
            motion.segments,
            motion.events,
            Provenance("test", {}, {}, 0),
        )

    def duration_with(self, entry, factor):
        """The cycle time with the entry's limits times a factor, the same postures timed anew."""
        limits = self.job.cell.robot.limits
        which = [entry.joint in (None, joint) for joint in limits.joints]
        changes = {
            name: np.where(which, factor, 1.0) * getattr(limits, name)
            for name in ("acceleration", "jerk")
            if name in entry.limit
        }
        return self.motion(with_limits(self.job, **changes)).trajectory.duration


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """The packing job, its first four tasks."""
    return packing_job(tasks_folder, 4)


def test_without_lines_every_figure_is_what_the_same_postures_take(packing):
    """Transfers are closed forms: all entries, lower and higher, equal a new timing to 1e-9 s."""
    planned = Planned(bare(packing), "exact")
    entries = sensitivity(planned.schedule)
    assert len(entries) == 2 * 15 + 3
    for entry in entries:
        assert entry.lower == pytest.approx(
            planned.duration_with(entry, 1 - SENSITIVITY.share), abs=1e-8
        )
        assert entry.higher == pytest.approx(
            planned.duration_with(entry, 1 + SENSITIVITY.share), abs=1e-8
        )


def test_with_lines_the_figures_are_within_half_a_percent_of_a_new_timing(packing):
    """The lines' part is an estimate: all limits together, and the most telling ones alone."""
    planned = Planned(packing)
    schedule = planned.schedule
    entries = sensitivity(schedule)
    for entry in entries[:2] + entries[-3:]:
        for said, factor in (
            (entry.lower, 1 - SENSITIVITY.share),
            (entry.higher, 1 + SENSITIVITY.share),
        ):
            true = planned.duration_with(entry, factor)
            assert abs(said - true) < 0.005 * schedule.duration, entry
    everything = entries[-1]
    assert everything.limit == "acceleration and jerk"
    # All limits together scale the profiles nearly as a whole, which the estimate gets nearly right.
    true = planned.duration_with(everything, 1 - SENSITIVITY.share)
    assert everything.lower - schedule.duration == pytest.approx(true - schedule.duration, rel=0.05)


def test_under_a_tool_speed_cap_the_figures_stay_near(packing):
    """0.6 m/s slows most transfers: their factor is found again from how long they take."""
    planned = Planned(dataclasses.replace(packing, tool_speed=0.6))
    schedule = planned.schedule
    assert schedule.duration > Planned(packing).schedule.duration * 1.1
    entry = sensitivity(schedule)[-1]
    for said, factor in (
        (entry.lower, 1 - SENSITIVITY.share),
        (entry.higher, 1 + SENSITIVITY.share),
    ):
        true = planned.duration_with(entry, factor)
        assert abs(said - true) < 0.002 * schedule.duration
        assert (said > schedule.duration) == (factor < 1)


@pytest.mark.parametrize("name", ["01_first_pick", "03_bottin_planar", "05_two_robots"])
def test_lower_limits_never_help_and_higher_ones_never_hurt(tasks_folder, name):
    """Every entry, on robots with and without a platform; single joints come most telling first."""
    schedule = Planned(load_job(tasks_folder / name / "tasks.yaml")).schedule
    entries = sensitivity(schedule)
    assert all(e.higher <= schedule.duration + 1e-9 <= e.lower + 2e-9 for e in entries)
    single = [e.lower - e.higher for e in entries if e.joint is not None]
    assert np.diff(single).max() < 1e-9
    together = [e for e in entries if e.joint is None]
    assert [e.limit for e in together] == ["acceleration", "jerk", "acceleration and jerk"]
    # What all limits do together, no single one exceeds.
    assert max(e.lower for e in entries) == pytest.approx(together[-1].lower)


def test_limits_that_are_not_assumed_are_left_alone(packing):
    """Only the joint whose source is assumed is listed, and the entries for all assumed ones are its own."""
    source = tuple(
        "assumed" if joint == "left_l" else "datasheet" for joint in packing.cell.robot.joints
    )
    entries = sensitivity(Planned(with_limits(packing, source=source)).schedule)
    assert [(e.joint, e.limit) for e in entries if e.joint] in (
        [("left_l", "acceleration"), ("left_l", "jerk")],
        [("left_l", "jerk"), ("left_l", "acceleration")],
    )
    alone = {e.limit: e for e in entries if e.joint}
    for entry in entries:
        if entry.joint is None and entry.limit in alone:
            assert (entry.lower, entry.higher) == (
                alone[entry.limit].lower,
                alone[entry.limit].higher,
            )
    measured = ("measured",) * len(source)
    assert sensitivity(Planned(with_limits(packing, source=measured)).schedule) == []


def test_a_return_of_the_platform_alone_counts(packing):
    """No arm moves, so no arm has a part; the stage is the platform's turn all the same."""
    planned = Planned(bare(packing))
    turned = np.array(planned.stages[0].start)
    turned[planned.model.platform_columns] += 0.5
    planned.stages = [
        StagePlan(turned, planned.stages[0].start, planned.stages[0].start, {}, "", 0.0)
    ]
    entries = sensitivity(planned.schedule)
    for entry in (entries[0], entries[-1]):
        assert entry.lower == pytest.approx(
            planned.duration_with(entry, 1 - SENSITIVITY.share), abs=1e-8
        )
    assert entries[0].joint == "torso_b1"
    found = bottlenecks(planned.schedule)
    assert found.stages == {"platform": 1}
    assert found.time["platform"] == planned.schedule.duration


def test_a_plan_in_which_nothing_moves_does_not_depend_on_limits(tmp_path):
    """A target where the joints are already: zero stays zero."""
    (tmp_path / ".git").mkdir()
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: iiwa7\n")
    (tmp_path / "tasks.yaml").write_text(
        "dualarm: tasks/1\ncell: cell.yaml\ntasks:\n  - id: a\n    arm: left\n"
        "    move: {joints: [[0, 30 deg, 0, -90 deg, 0, 60 deg, 0]]}\n"
    )
    entries = sensitivity(Planned(load_job(tmp_path / "tasks.yaml")).schedule)
    assert len(entries) == 2 * 7 + 3
    assert {(entry.lower, entry.higher) for entry in entries} == {(0.0, 0.0)}


def test_a_jerk_that_is_not_limited_has_no_sensitivity(packing):
    """Accelerations only."""
    job = with_limits(bare(packing), jerk=np.full(15, np.inf))
    planned = Planned(job)
    entries = sensitivity(planned.schedule)
    assert {entry.limit for entry in entries} == {"acceleration"}
    for entry in (entries[0], entries[-1]):
        assert entry.lower == pytest.approx(
            planned.duration_with(entry, 1 - SENSITIVITY.share), abs=1e-8
        )
