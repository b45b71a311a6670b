"""Two schedules of the same work: what got slower, by how much, and what is to blame."""

from __future__ import annotations

import csv
import dataclasses
import io
from functools import partial

import numpy as np
import pytest

from dualarm_cli.errors import UsageError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.comparison.schedule_comparison import compare_schedules
from dualarm_cli.report.comparison.schedule_comparison_table import (
    schedules_csv,
    schedules_sentence,
)
from tests.packing_tasks import packing_job

plan = partial(plan_without_bound, check_collisions=False)
"""Plans that differ by their method alone, not by what they make way for."""
FIXED = PlanSettings(platform="fixed", blend="none")


@pytest.fixture(scope="module")
def job(tasks_folder):
    """The packing job, its first six tasks."""
    return packing_job(tasks_folder, 6)


@pytest.fixture(scope="module")
def before(job):
    """Its plan with the platform held."""
    return plan(job, FIXED)


def compared(a, b):
    """The comparison's document."""
    return compare_schedules(a, b, ("A", "B"))


def with_dwell(job, task_id, gripper):
    """The job with another gripper time at one task."""
    tasks = [
        dataclasses.replace(
            task,
            stops=tuple(
                dataclasses.replace(s, dwell=dataclasses.replace(s.dwell, gripper=gripper))
                for s in task.stops
            ),
        )
        if task.id == task_id
        else task
        for task in job.tasks
    ]
    return dataclasses.replace(job, tasks=tuple(tasks))


def test_a_schedule_is_identical_to_itself(before):
    """No stage differs and the sentence says so."""
    document = compared(before, before)
    assert document["identical"]
    assert document["difference"] == 0.0
    assert all(row["blame"] is None for row in document["stages"])
    assert schedules_sentence(document) == f"A and B are identical: {before.duration:.3f} s"


def test_differences_of_the_stages_add_up(job, before):
    """To that of the whole, and so do those of what is to blame."""
    document = compared(before, plan(job, PlanSettings(platform="exact", blend="none")))
    whole = document["difference"]
    assert abs(whole) > 0.01
    assert sum(r["difference"] for r in document["stages"]) == pytest.approx(whole, abs=1e-9)
    assert sum(e["difference"] for e in document["blamed"]) == pytest.approx(whole, abs=1e-5)
    for row in document["stages"]:
        found = row["blame"]
        if found is not None:
            # The blamed part's share of a difference of at most five parts is a fifth or more.
            grown = found["b_time"] - found["a_time"]
            assert grown * np.sign(row["difference"]) >= abs(row["difference"]) / 5 - 1e-9
    assert document["notes"] == ["settings differ: platform fixed → exact"]


def test_a_longer_dwell_is_to_blame_for_exactly_what_it_costs(job, before):
    """Half a second more at each of one task's two stops; it is the left arm that was not waiting."""
    document = compared(before, plan(with_dwell(job, "left[1,2]", 0.62), FIXED))
    slower = [row for row in document["stages"] if row["difference"] > 1e-6]
    assert [row["work"] for row in slower] == [
        ["left[1,2] pick", "right[1,2] pick"],
        ["left[1,2] place", "right[1,2] place"],
    ]
    for row in slower:
        found = row["blame"]
        assert (found["part"], found["arm"], found["joint"]) == ("dwell", "left", "")
        assert found["b_time"] - found["a_time"] == pytest.approx(0.5, abs=1e-9)
    assert document["blamed"][0]["name"] == "dwell"


def test_a_weaker_joint_is_named_and_its_limits_are_the_cause(job, before):
    """left_l at half its speed and a quarter of its acceleration: the same way, more time."""
    robot = job.cell.robot
    k = robot.joints.index("left_l")
    limits = robot.limits
    changed = {
        name: np.where(np.arange(15) == k, share, 1.0) * getattr(limits, name)
        for name, share in (("velocity", 0.5), ("acceleration", 0.25), ("jerk", 0.125))
    }
    slow = dataclasses.replace(robot, limits=dataclasses.replace(limits, **changed))
    from dualarm_cli.kinematics.cell_model import CellModel
    from dualarm_cli.motion.motion import realise
    from dualarm_cli.stages.method import MethodProblem
    from dualarm_cli.stages.stage_by_stage import choose_stages
    from dualarm_cli.timing import TIMING_SOLVERS

    stages = choose_stages(MethodProblem(CellModel.from_cell(job.cell), job, "arm_angle"), "fixed")
    weak = dataclasses.replace(job, cell=dataclasses.replace(job.cell, robot=slow))
    motion = realise(CellModel.from_cell(weak.cell), weak, stages, TIMING_SOLVERS["ruckig"])
    after = dataclasses.replace(
        before,
        robot=dataclasses.replace(before.robot, limits=slow.limits),
        motion=JointMotion.of(motion.trajectory),
        stages=motion.stages,
        segments=motion.segments,
        events=motion.events,
    )
    document = compared(before, after)
    blamed = [row["blame"] for row in document["stages"] if row["blame"]]
    transfers = [found for found in blamed if found["part"] == "transfer"]
    assert transfers
    assert {found["joint"] for found in transfers} == {"left_l"}
    assert {found["cause"] for found in transfers} == {"limits"}
    for found in transfers:
        assert found["a_displacement"] == pytest.approx(found["b_displacement"], abs=1e-6)
    assert "limits differ for 1 joints: left_l" in document["notes"]


def test_the_way_is_the_cause_where_it_is_longer(job, before):
    """Named with its displacement before and after, which the trajectories confirm."""
    after = plan(job, PlanSettings(platform="exact", blend="none"))
    document = compared(before, after)
    found = [
        row
        for row in document["stages"]
        if row["blame"] and row["blame"]["cause"] == "displacement"
    ]
    assert found
    for row in found:
        for side, schedule in (("a", before), ("b", after)):
            stage = schedule.stages[row[side] - 1]
            joint, way = row["blame"]["joint"], row["blame"][f"{side}_displacement"]
            q = schedule.trajectory.at(np.array([stage.start]))[0][0]
            column = schedule.trajectory.joints.index(joint)
            inside = (schedule.trajectory.time >= stage.start) & (
                schedule.trajectory.time <= stage.end
            )
            # Where the transfer ends is one of the knots of the stage.
            ways = np.abs(schedule.trajectory.position[inside, column] - q[column])
            assert np.abs(ways - way).min() < 1e-6


def test_stages_that_differ_by_less_than_is_shown_are_not_counted(before):
    """0.1 ms are 0.000 s in the table."""
    document = compared(before, before)
    for row in document["stages"]:
        row["difference"] = 1e-4
    document |= {"identical": False, "difference": 1e-3}
    count = len(document["stages"])
    assert f": 0 of {count} stages slower, 0 faster" in schedules_sentence(document)


def test_stages_are_matched_by_what_is_done_in_them(job, before):
    """One task less: its stages stand alone, the others keep their partners; the sum still holds."""
    fewer = dataclasses.replace(job, tasks=(*job.tasks[:2], *job.tasks[4:]))
    document = compared(before, plan(fewer, FIXED))
    kinds = [row["match"] for row in document["stages"]]
    assert kinds.count("only in A") == 2
    assert kinds.count("same work") == 5
    lone = [row for row in document["stages"] if row["match"] == "only in A"]
    assert [row["work"][0] for row in lone] == ["left[1,2] pick", "left[1,2] place"]
    assert all(row["b"] is None and row["b_duration"] is None for row in lone)
    whole = sum(row["difference"] for row in document["stages"])
    assert whole == pytest.approx(document["difference"], abs=1e-9)
    swapped = compared(plan(fewer, FIXED), before)
    assert [row["match"] for row in swapped["stages"]].count("only in B") == 2


def test_another_order_is_matched_and_noted(job, before):
    """The last two tasks first."""
    other = dataclasses.replace(job, tasks=(*job.tasks[4:], *job.tasks[:4]))
    document = compared(before, plan(other, FIXED))
    assert {row["match"] for row in document["stages"]} == {"same work"}
    assert [row["b"] for row in document["stages"]] == [3, 4, 5, 6, 1, 2, 7]
    assert "the order of the stages differs" in document["notes"]


def test_stages_with_another_partner_are_compared_and_said_to_be(job, before):
    """The right arm's tasks shifted by one: the left arm's work is what both versions share."""
    left, right = job.tasks[0::2], job.tasks[1::2]
    other = dataclasses.replace(job, tasks=(*left, *right[1:], right[0]))
    document = compared(before, plan(other, FIXED))
    matches = [row["match"] for row in document["stages"]]
    assert matches.count("different simultaneous work") == 6
    assert matches.count("same work") == 1


def test_schedules_of_other_work_are_refused(before, tasks_folder):
    """Times alone say nothing; both sides' tasks are named."""
    other = plan(load_job(tasks_folder / "01_first_pick" / "tasks.yaml"), FIXED)
    with pytest.raises(
        UsageError, match=r"A does left\[1,1\] pick.*; B does left part pick, right"
    ):
        compared(before, other)


def test_a_schedule_without_stages_and_segments_is_cut_at_its_events(before):
    """As somebody else's program may write it: the same work is found, and the note says how."""
    foreign = dataclasses.replace(before, stages=(), segments=())
    document = compared(before, foreign)
    assert "B states no stages and no segments: cut at its events" in document["notes"]
    assert {row["match"] for row in document["stages"]} == {"same work"}
    assert document["difference"] == 0.0


def test_work_that_takes_no_time_is_matched_by_its_event(tmp_path):
    """A target where the joints are already, against one that is 30 degrees away."""
    plans = []
    for angle in (0, 30):
        folder = tmp_path / str(angle)
        (folder / ".git").mkdir(parents=True)
        (folder / "cell.yaml").write_text("dualarm: cell/1\nrobot: iiwa7\n")
        (folder / "tasks.yaml").write_text(
            "dualarm: tasks/1\ncell: cell.yaml\ntasks:\n  - id: a\n    arm: left\n"
            f"    move: {{joints: [[{angle} deg, 30 deg, 0, -90 deg, 0, 60 deg, 0]]}}\n"
        )
        plans.append(plan(load_job(folder / "tasks.yaml"), FIXED))
    document = compared(*plans)
    (row,) = document["stages"]
    assert row["match"] == "same work"
    assert row["blame"]["joint"] == "joint_1"
    assert row["blame"]["a_displacement"] == 0.0
    assert row["blame"]["b_displacement"] == pytest.approx(np.radians(30))
    assert document["relative"] is None


def test_broken_times_are_refused_with_a_hint_to_the_verifier(before):
    """NaN, times that fall, stages that end before they start."""
    time = np.array(before.trajectory.time)
    for broken in (np.where(np.arange(len(time)) == 3, np.nan, time), time[::-1]):
        trajectory = dataclasses.replace(before.trajectory, time=broken)
        with pytest.raises(UsageError, match="`dualarm verify B` says more"):
            compared(before, dataclasses.replace(before, motion=JointMotion.of(trajectory)))
    stage = dataclasses.replace(before.stages[0], end=-1.0)
    with pytest.raises(UsageError, match="stage 1 ends before it starts"):
        compared(before, dataclasses.replace(before, stages=(stage, *before.stages[1:])))


def test_the_csv_has_one_row_per_stage(job, before):
    """Displacements read back as the same doubles."""
    document = compared(before, plan(job, PlanSettings(platform="exact", blend="none")))
    rows = list(csv.DictReader(io.StringIO(schedules_csv(document).decode())))
    assert len(rows) == len(document["stages"])
    for read, row in zip(rows, document["stages"], strict=True):
        assert float(read["difference"]) == row["difference"]
        if row["blame"] and row["blame"]["joint"]:
            assert float(read["a_displacement"]) == row["blame"]["a_displacement"]


def test_the_sentence_names_only_what_goes_the_way_of_the_whole(job, before):
    """A joint that got faster is not what makes B slower."""
    document = compared(plan(job, PlanSettings(platform="exact", blend="none")), before)
    sign = np.sign(document["difference"])
    text = schedules_sentence(document)
    named = [e for e in document["blamed"] if f"{e['name']} (" in text.split("most of it")[1]]
    assert named
    assert all(entry["difference"] * sign > 0 for entry in named)
