"""Motion while tools stand: they do by pinocchio, within limits, for arms with closed forms and without."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.continuation import moved_along
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.dwell_motion import dwell_motions, dwell_path
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import PLATFORM, Drive
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.timing import TIMING_SOLVERS
from dualarm_cli.verification.motion_checks import check_agreement, check_limits


@pytest.fixture(scope="module", params=[False, True], ids=["closed forms", "numeric"])
def stage(request, tasks_folder):
    """The first stage of the packing job, its arms with closed forms or without: drive, plan, job."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    # What any yaw will do for is planned fast enough with one.
    stops = [
        replace(stop, target=replace(stop.target, free_yaw=False))
        for stop in (job.tasks[0].stops[0], job.tasks[1].stops[0])
    ]
    tasks = zip(job.tasks[:2], stops, strict=True)
    job = replace(job, tasks=tuple(replace(t, stops=(s,)) for t, s in tasks), returns=False)
    model = CellModel.from_cell(job.cell, numeric=request.param)
    redundancy = "numeric" if request.param else "arm_angle"
    plan = choose_stages(model, job, "fixed", redundancy)[0]
    return Drive.of(model, job, TIMING_SOLVERS["ruckig"]), plan, job


def left(drive, plan, turn, along):
    """The stage left with the platform turned [rad] and the arms moved along their self-motions [rad]."""
    model = drive.model
    end, leaving = np.array(plan.end), {}
    end[model.platform_columns] = plan.arrival[model.platform_columns] + turn
    R_come, p_come = model.platform.pose(plan.arrival[model.platform_columns])
    R_gone, p_gone = model.platform.pose(end[model.platform_columns])
    for name, one in plan.stops.items():
        arm, made = model.arms[name].kinematics, one.posture
        R, p = arm.forward(made.q_target)
        R, p = R_gone.T @ R_come @ R, R_gone.T @ (p_come + R_come @ p - p_gone)
        psi = made.psi_target
        if hasattr(arm, "solve_branch"):
            psi += along
            q, _ = arm.solve_branch(R, p, psi, np.array(made.branch))
            q = arm.nearest_turns(q, made.q_target)
        else:
            [q], met = moved_along(arm, made.q_target[None], R[None], p[None], np.array([along]))
            assert met.all()
        leaving[name] = replace(one, posture=replace(made, q_target=q, psi_target=psi))
    return replace(plan, end=end, leaving=leaving)


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


def whole(drive, plan, move):
    """All joints along a motion in a dwell, at 40 instants."""
    times = np.linspace(0.0, move.duration, 40)
    position = np.tile(plan.arrival, (len(times), 1))
    for name, one in plan.stops.items():
        position[:, drive.columns[name]] = one.posture.q_target
    for group, motion in move.motion.items():
        position[:, drive.columns[group]] = motion.at(times)[0]
    return position


@pytest.mark.parametrize(("turn", "along"), [(-0.12, 0.0), (-0.2, 0.1), (0.05, -0.15)])
def test_tools_stand_while_the_platform_turns(stage, turn, along):
    """To 0.02 mm, with all joints within their limits; it begins and ends where it should, at rest."""
    drive, plan, job = stage
    plan = left(drive, plan, turn, along)
    [move] = dwell_motions(drive, plan)
    assert move.groups == (PLATFORM, "left", "right")
    position = whole(drive, plan, move)
    assert position[-1, drive.columns[PLATFORM]] - position[0, drive.columns[PLATFORM]] == (
        pytest.approx([turn], abs=1e-12)
    )
    for name, stop in plan.leaving.items():
        last = position[-1, drive.columns[name]]
        assert last == pytest.approx(stop.posture.q_target, abs=1e-12)
        first = tool(job, name, position[0])
        for row in position:
            moved = first.actInv(tool(job, name, row))
            assert np.linalg.norm(moved.translation) < 2e-5
            assert np.linalg.norm(pin.log3(moved.rotation)) < 1e-4
    for group, motion in move.motion.items():
        limits = drive.limits.select(drive.joints(group))
        checks = [*check_agreement(motion), *check_limits(motion, limits)]
        assert [check.name for check in checks if check.verdict == "failed"] == []
        assert not np.any(motion.velocity[[0, -1]])
        assert not np.any(motion.acceleration[[0, -1]])


def test_without_the_platform_each_arm_moves_by_itself(stage):
    drive, plan, job = stage
    plan = left(drive, plan, 0.0, 0.2)
    moves = dwell_motions(drive, plan)
    assert [move.groups for move in moves] == [("left",), ("right",)]
    for move in moves:
        position = whole(drive, plan, move)
        [name] = move.groups
        assert np.abs(position[-1] - position[0]).max() > 0.05
        for row in position:
            moved = tool(job, name, position[0]).actInv(tool(job, name, row))
            assert np.linalg.norm(moved.translation) < 2e-5


def test_a_way_out_of_reach_is_refused(stage):
    """Half a turn of the platform: the arms cannot keep their tools at their targets."""
    drive, plan, _ = stage
    near = left(drive, plan, 0.1, 0.0)
    end = np.array(near.end)
    end[drive.model.platform_columns] += 3.0
    with pytest.raises(InfeasibleError):
        dwell_path(drive.model, replace(near, end=end), (PLATFORM, "left"), 33)


def test_stages_with_such_motion_have_all_pieces_in_place(stage):
    """No arm leaves its target before all is over; each dwell is as long as asked, what is left of it a wait."""
    drive, plan, job = stage
    plan = left(drive, plan, -0.15, 0.0)
    lines = {name: replace(one.stop, retract=0.0) for name, one in plan.stops.items()}
    stops = {name: replace(plan.stops[name], stop=lines[name]) for name in lines}
    leaving = {name: replace(plan.leaving[name], stop=lines[name]) for name in lines}
    end = np.array(plan.end)
    for name, one in leaving.items():
        end[drive.columns[name]] = one.posture.q_target
    plan = replace(plan, stops=stops, leaving=leaving, end=end)
    [move] = dwell_motions(drive, plan)
    motion = realise(drive.model, job, [plan], drive.timing)
    assert isinstance(motion.trajectory, Trajectory)
    begin = max(event.time for event in motion.events)
    assert np.abs(motion.trajectory.position[-1] - end).max() < 1e-9
    for event in motion.events:
        own = [s for s in motion.segments if s.arm == event.arm]
        [dwell] = [s for s in own if s.kind == "dwell"]
        assert (dwell.start, dwell.end - dwell.start) == (event.time, pytest.approx(event.dwell))
        [wait] = [s for s in own if s.kind == "wait" and s.start >= dwell.end - 1e-9]
        assert wait.end == pytest.approx(begin + move.duration)
    column = drive.columns[PLATFORM]
    before = motion.trajectory.at(np.array([begin]))[0][0, column]
    assert before == pytest.approx(plan.arrival[column], abs=1e-12)
