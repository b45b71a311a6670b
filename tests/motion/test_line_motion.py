"""Lines on which the platform turns: tools stay on them by pinocchio, within limits, for arms of both kinds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.motion.line_motion import (
    groups_on_line,
    turned_line,
    turned_path,
    with_turned_line,
)
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.stop_motion import joints_along, timed_line
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers
from dualarm_cli.motion.turned_transfers import turned_transfer
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.timing.launch import Launch
from dualarm_cli.verification.motion_checks import check_agreement, check_limits

LAUNCH = Launch(0.3, 0.0, 1.0, 0.5, 0)
"""Some way to pass the outer end of a line in motion."""


@pytest.fixture(scope="module", params=[False, True], ids=["closed forms", "numeric"])
def stages(request, tasks_folder):
    """The first two stages of the packing job, its arms with closed forms or without: drive, plans, job."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    tasks = []
    for task in job.tasks[:2]:
        # What any yaw will do for is planned fast enough with one.
        stops = tuple(
            replace(stop, line_motion=True, target=replace(stop.target, free_yaw=False))
            for stop in task.stops
        )
        tasks.append(replace(task, stops=stops))
    job = replace(job, tasks=tuple(tasks), returns=False)
    model = CellModel.from_cell(job.cell, numeric=request.param)
    plans = choose_stages(model, job, "fixed", "numeric" if request.param else "arm_angle")
    return Drive.of(model, job, TIMING_SOLVERS["ruckig"]), plans, job


def turned(stages, line, turn):
    """The first stage with the platform turned so far at the outer end of a line [rad]."""
    drive, plans, _ = stages
    target = plans[0].platform_at(line, drive.model.platform_columns)
    return with_turned_line(drive, plans[0], line, target + turn, target)


def tool(job, name, position):
    """A tool's pose in the world by pinocchio alone."""
    robot = job.cell.robot
    model = pin.buildModelFromXML(robot.urdf)
    data, q = model.createData(), np.zeros(model.nq)
    for joint, value in zip(robot.joints, position, strict=True):
        q[model.joints[model.getJointId(joint)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    flange = data.oMf[model.getFrameId(robot.arm(name).flange)]
    return job.cell.base * flange * job.cell.tools[name].tcp


def whole(drive, plan, rows):
    """All joints (m, columns) of those of the groups on a line, one after the other (m, n)."""
    position, first = np.tile(plan.arrival, (len(rows), 1)), 0
    for group in groups_on_line(plan):
        columns = drive.columns[group]
        position[:, columns] = rows[:, first : first + len(columns)]
        first += len(columns)
    return position


@pytest.mark.parametrize("line", ["approach", "retract"])
@pytest.mark.parametrize("turn", [0.03, -0.2])
@pytest.mark.parametrize("launch", [None, LAUNCH], ids=["at rest", "in motion"])
def test_tools_stay_on_their_lines_while_the_platform_turns(stages, line, turn, launch):
    """To 0.1 mm and 0.1 mrad, never back, over the whole length; all joints within their limits."""
    drive, _, job = stages
    plan = turned(stages, line, turn)
    if launch is not None:
        plan = replace(plan, passes={(group, line): launch for group in groups_on_line(plan)})
    motion = turned_line(drive, plan, line)
    times = np.linspace(0.0, motion[PLATFORM].duration, 60)
    rows = np.hstack([motion[group].at(times)[0] for group in groups_on_line(plan)])
    position = whole(drive, plan, rows if line == "retract" else rows[::-1])
    column = drive.model.platform_columns[0]
    assert position[-1, column] - position[0, column] == pytest.approx(turn, abs=1e-12)
    outer = plan.end if line == "retract" else plan.arrival
    assert position[-1] == pytest.approx(outer, abs=1e-9)
    for name, one in plan.stops.items():
        target, depths = tool(job, name, position[0]), []
        for row in position:
            moved = target.actInv(tool(job, name, row))
            assert np.hypot(*moved.translation[:2]) < 1e-4
            assert np.linalg.norm(pin.log3(moved.rotation)) < 1e-4
            depths.append(-moved.translation[2])
        assert np.diff(depths).min() > -1e-6
        assert depths[-1] == pytest.approx(getattr(one.stop, line), abs=1e-6)
    speeds = [np.abs(motion[group].at(times[[0, -1]])[1]).max(axis=1) for group in motion]
    resting = slice(None) if launch is None else slice(1) if line == "retract" else slice(1, None)
    assert max(speed[resting].max() for speed in speeds) < 1e-9
    assert launch is None or max(speed.max() for speed in speeds) > 0.01
    for group, trajectory in motion.items():
        checks = [
            *check_agreement(trajectory),
            *check_limits(trajectory, drive.limits.select(drive.joints(group))),
        ]
        assert [check.name for check in checks if check.verdict == "failed"] == []


@pytest.mark.parametrize("line", ["approach", "retract"])
def test_where_the_platform_stands_lines_are_the_usual_ones(stages, line):
    drive, plans, _ = stages
    plan, first = turned(stages, line, 0.0), 1
    path = turned_path(drive, plan, line)
    assert np.ptp(path[:, 0]) == 0.0
    for name, one in plans[0].stops.items():
        q, _ = joints_along(drive, plans[0], one, line)
        count = len(drive.columns[name])
        assert path[:, first : first + count] == pytest.approx(
            q if line == "retract" else q[::-1], abs=1e-8
        )
        first += count


def test_a_line_out_of_reach_is_refused(stages):
    """Half a turn of the platform within 0.1 m."""
    with pytest.raises(InfeasibleError):
        turned(stages, "retract", 3.0)


def test_platform_and_arms_arrive_together(stages):
    """At rest and in motion."""
    drive, _, _ = stages
    plan = turned(stages, "approach", -0.1)
    resting = time_transfers(drive, plan).motion
    assert len({motion.duration for motion in resting.values()}) == 1
    passes = {(group, "approach"): LAUNCH for group in groups_on_line(plan)}
    plan = replace(plan, passes=passes)
    rates = {}
    for group, motion in turned_line(drive, plan, "approach").items():
        rates[group] = None, np.stack([motion.velocity[0], motion.acceleration[0]])
    moving = time_transfers(drive, plan, rates).motion
    assert len({motion.duration for motion in moving.values()}) == 1
    for group, (_, arriving) in rates.items():
        assert moving[group].velocity[-1] == pytest.approx(arriving[0], abs=1e-8)


@pytest.mark.parametrize("blend", [True, False])
def test_transfers_take_what_they_say(stages, blend):
    """Both stages as they are realised with it between them: from leaving the targets to being at the next ones."""
    drive, plans, job = stages
    found = turned_transfer(drive, plans[0], plans[1], (0.05, -0.05), blend=blend)
    assert found is not None
    assert blend or found.ways == (None, None)
    before, plan = found.put(drive, plans[0], plans[1])
    assert np.array_equal(before.end, plan.start)
    motion = realise(drive.model, job, [before, plan], drive.timing)
    left = [
        s.start for s in motion.segments if s.kind == "retract" and s.end <= motion.stages[0].end
    ]
    there = [motion.event_of[1, name].time for name in plan.stops]
    assert np.ptp(left) < 1e-9
    assert np.ptp(there) < 1e-9
    assert there[0] - left[0] == pytest.approx(found.time, abs=1e-9)


def test_an_arm_that_stands_next_keeps_the_platform_standing(stages):
    """Its retract would end elsewhere, and all that comes after it with it."""
    drive, plans, _ = stages
    one = {name: stop for name, stop in plans[1].stops.items() if name == "left"}
    assert turned_transfer(drive, plans[0], replace(plans[1], stops=one), blend=True) is None


def test_lines_beside_each_other_do_not_share_their_timing(stages):
    """What is known of a line with the platform turned says nothing of the one on which it stands."""
    drive, plans, _ = stages
    plan, name = turned(stages, "retract", -0.2), next(iter(plans[0].stops))
    still = timed_line(drive, plans[0], plans[0].stops[name], "retract")
    moving = timed_line(drive, plan, plan.stops[name], "retract")
    assert np.abs(still.position[-1] - moving.position[-1]).max() > 0.05
