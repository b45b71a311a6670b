"""Waits among segments: what belongs to a transfer, what comes after all work, and why arms of a motion wait."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.schedule import Segment
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.waiting import transfer_ends, whole_transfers, with_ends
from dualarm_cli.postures.stage_plan import Detour
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS


def _row(arm, *parts):
    """Segments one after the other from 0, each (kind, task, length) or (wait, task, length, reason)."""
    clock, row = 0.0, []
    for kind, task, length, *reason in parts:
        action = "move" if task else ""
        segment = Segment(arm, kind, task, action, clock, clock + length, None, *reason)
        row.append(segment)
        clock += length
    return row


def test_waits_for_the_partner_after_the_last_task_are_the_end():
    """Left works on a, b and then only returns; right never works: it has nothing to wait for but the end."""
    left = _row(
        "left",
        ("transfer", "a", 1.0),
        ("wait", "", 1.0, "partner"),
        ("transfer", "b", 1.0),
        ("wait", "", 1.0, "partner"),
        ("return", "", 1.0),
        ("wait", "", 1.0, "partner"),
    )
    right = _row("right", ("wait", "", 6.0, "partner"))
    reasons = [part.reason for part in with_ends([*left, *right], [])]
    assert reasons == ["", "partner", "", "end", "", "end", "end"]


def test_an_end_before_more_work_is_waiting_for_the_partner():
    """A section's end is not the job's: more work follows when sections are put together. Other reasons stay."""
    row = _row(
        "left",
        ("transfer", "a", 1.0),
        ("wait", "", 1.0, "end"),
        ("transfer", "b", 1.0),
        ("wait", "b", 1.0, "shared_zone"),
        ("wait", "", 1.0),
    )
    assert [part.reason for part in with_ends(row, [])] == ["", "partner", "", "shared_zone", ""]


def test_a_transfer_is_one_from_leaving_to_where_the_line_begins():
    """Waits 1 s, moves 2, pauses 3, moves 4, waits 5 for the platform: it is under way from 1 s to 15 s."""
    row = _row(
        "left",
        ("wait", "a", 1.0, "shared_zone"),
        ("transfer", "a", 2.0),
        ("wait", "a", 3.0, "shared_zone"),
        ("transfer", "a", 4.0),
        ("wait", "a", 5.0, "platform"),
        ("approach", "a", 6.0),
        ("wait", "", 7.0, "partner"),
    )
    whole = whole_transfers(row)
    spans = [(part.kind, part.reason, part.start, part.end) for part in whole]
    assert spans == [
        ("wait", "shared_zone", 0.0, 1.0),
        ("transfer", "", 1.0, 15.0),
        ("approach", "", 15.0, 21.0),
        ("wait", "partner", 21.0, 28.0),
    ]
    assert transfer_ends(row, 0.0, 15.0) == [15.0]
    assert transfer_ends(row, 0.0, 14.0) == transfer_ends(row, 15.0, 30.0) == []


def test_waiting_at_the_line_for_the_other_arm_is_no_transfer():
    """Only what leads on to another move, or is for the platform, belongs to it; nor does another task's move."""
    row = _row(
        "left",
        ("transfer", "a", 1.0),
        ("wait", "a", 1.0, "shared_zone"),
        ("approach", "a", 1.0),
        ("transfer", "b", 1.0),
        ("transfer", "c", 1.0),
    )
    assert whole_transfers(row) == row


def test_standing_until_the_platform_is_there_counts_as_the_transfer():
    """An arm without a way of its own has one that lasts as long as the platform's."""
    row = _row("left", ("wait", "a", 2.0, "platform"), ("approach", "a", 1.0))
    assert [(p.kind, p.end) for p in whole_transfers(row)] == [("transfer", 2.0), ("approach", 3.0)]


@pytest.fixture(scope="module")
def first_pick(tasks_folder):
    """The smallest job with lines, its cell and its stages with the platform held."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    return job, model, choose_stages(MethodProblem(model, job, "arm_angle"), "fixed")


def _left(job, model, plans):
    motion = realise(model, job, plans, TIMING_SOLVERS["ruckig"])
    return motion, [s for s in motion.segments if s.arm == "left" and s.end - s.start > 1e-6]


def test_an_arm_that_leaves_late_waits_for_the_other_one_to_be_away(first_pick):
    """Half a second before the first transfer; right, done half a second earlier, waits for its partner then."""
    job, model, plans = first_pick
    first = replace(plans[0], waits={"left": 0.5})
    motion, left = _left(job, model, [first, *plans[1:]])
    assert [(s.kind, s.reason) for s in left[:2]] == [("wait", "shared_zone"), ("transfer", "")]
    assert (left[0].start, left[0].end, left[0].task) == (0.0, 0.5, left[1].task)
    (right,) = [s for s in motion.segments if s.arm == "right" and s.reason == "partner"]
    assert right.end - right.start == pytest.approx(0.5, abs=1e-6)


def test_a_detour_that_is_over_before_the_platform_is_there_waits_for_it(tasks_folder):
    """Left barely moves, the platform turns by 60 degrees: from the transfer's end until it stands left waits."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    model = CellModel.from_cell(job.cell)
    plan = choose_stages(MethodProblem(model, job, "arm_angle"), "fixed")[0]
    columns, arrival = model.arms["left"].columns, plan.arrival.copy()
    arrival[model.platform_columns] += np.radians(60.0)
    start = arrival.copy()
    start[model.platform_columns] = plan.start[model.platform_columns]
    start[columns] += 0.01
    posture = arrival[columns] + 0.005
    end = plan.end.copy()
    end[model.platform_columns] = arrival[model.platform_columns]
    turned = replace(
        plan,
        start=start,
        arrival=arrival,
        end=end,
        detours={"left": Detour(posture[None], stops=True)},
    )
    motion, left = _left(job, model, [turned])
    assert [(s.kind, s.reason) for s in left[:3]] == [
        ("transfer", ""),
        ("wait", "platform"),
        ("approach", ""),
    ]
    turning = motion.trajectory.select(job.cell.robot.platform)
    still = turning.time[np.abs(turning.velocity[:, 0]) > 1e-9].max()
    there = turning.time[turning.time > still][0]
    assert left[1].end == pytest.approx(there, abs=1e-6)
    assert left[0].end < 0.7 * there
    # Right, straight and without a way of its own, stands until then as well.
    right = next(s for s in motion.segments if s.arm == "right")
    assert (right.kind, right.reason) == ("wait", "platform")
    assert right.end == pytest.approx(there, abs=1e-6)
