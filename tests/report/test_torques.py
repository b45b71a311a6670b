"""Torques of a report: the verifier's numbers, energy as an invariant, and lower efforts by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.evaluation.evaluate import evaluation_of
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.interface import Plan
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.page.page_data import torque_curves
from dualarm_cli.planning.planner import plan
from dualarm_cli.report.console import summary_lines
from dualarm_cli.report.report import build_report
from dualarm_cli.report.torques import torque_members
from dualarm_cli.verification import verify
from dualarm_cli.verification.as_done import job_as_done
from tests.pendulum import LENGTH, MASS, pendulum

CELL = """\
dualarm: cell/1
robot: openarm
tools: {left: {tcp: {xyz: [0, 0, 0.09]}, mass: 0.5}, right: {tcp: {xyz: [0, 0, 0.09]}}}
parts: {casting: {mass: 3 kg, shapes: [{box: [0.08, 0.08, 0.08], xyz: [0, 0, 0.04]}]}}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: free
defaults: {approach: 25 mm, retract: 25 mm}
return: true
tasks:
  - {id: first, arm: left, part: casting, pick: {xyz: [0.2, 0.1, 0.42], rpy: [180 deg, 0, 0], free: yaw},
     place: {xyz: [0.32, 0.25, 0.42], rpy: [180 deg, 0, 0], free: yaw}}
"""


@pytest.fixture(scope="module")
def heavy(tmp_path_factory: pytest.TempPathFactory) -> tuple[Schedule, Job]:
    """A verified plan of an OpenArm that carries 3 kg, and its job."""
    folder: Path = tmp_path_factory.mktemp("heavy")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(TASKS)
    job = load_job(folder / "tasks.yaml")
    schedule = plan(job, PlanSettings(effort="quick"))
    return replace(schedule, verification=verify(schedule, job)), job


def with_efforts(job: Job, factor: float) -> Job:
    """The job with other efforts."""
    robot = job.cell.robot
    torques = replace(robot.torques, effort=factor * robot.torques.effort)
    return replace(job, cell=replace(job.cell, robot=replace(robot, stated_torques=torques)))


def test_report_and_verifier_name_the_same_torque(heavy) -> None:
    """The largest share of all joints and of all stages is what the check has measured, with joint, time and part."""
    schedule, job = heavy
    members, stages = torque_members(schedule, job)
    [check] = (c for c in schedule.verification.checks if c.name == "torque")
    joint, worst = max(members["joints"].items(), key=lambda item: item[1]["share"])
    assert worst["share"] == pytest.approx(check.measured, abs=1e-12)
    assert check.detail.startswith(f"{joint} at {worst['time']:.3f} s: {worst['torque']:.4g} of ")
    assert check.detail.endswith("carrying left casting")
    assert worst["carrying"] == "left casting"
    evaluation = evaluation_of("", Plan(job, schedule))
    assert (evaluation.torque, evaluation.torque_joint) == (worst["share"], joint)
    assert max(row["share"] for row in stages) == worst["share"]
    assert stages[-1]["carrying"] == ""


def test_work_is_the_change_of_energy(heavy) -> None:
    """Kinetic and potential energy with the tool, and with the part from pick to place, by pinocchio.

    The motion returns, so that without the part the net work of the cycle is what lifting and laying it takes.
    """
    schedule, job = heavy
    members, _ = torque_members(schedule, job)
    energy = members["energy"]["left"]
    assert energy["net"] == pytest.approx(energy["work"] - energy["braking"], abs=1e-12)
    assert energy["work"] > 1.0
    pick, place = (event.time for event in schedule.events)
    heights = []
    model = pin.buildModelFromXML(job.cell.robot.urdf)
    data = model.createData()
    tool = job.cell.tools["left"].tcp * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.04]))
    for time in (pick, place):
        pin.framesForwardKinematics(model, data, schedule.trajectory.at(time)[0])
        flange = data.oMf[model.getFrameId(job.cell.robot.arm("left").flange)]
        heights.append((flange * tool).translation[2])
    lifted = 3.0 * 9.81 * (heights[1] - heights[0])
    assert energy["net"] == pytest.approx(lifted, abs=2e-3 * energy["work"])
    assert members["energy"]["right"]["work"] == pytest.approx(0.0, abs=1e-9)


def test_motion_within_nine_tenths_costs_nothing_with_lower_efforts(heavy) -> None:
    """The cycle stays where no joint needs more than 90 % of its effort."""
    schedule, job = heavy
    members, _ = torque_members(schedule, job)
    assert max(joint["share"] for joint in members["joints"].values()) < 0.9
    assert members["lower_effort"]["cycle_time"] == schedule.duration


@pytest.mark.parametrize(
    ("needed", "factor"), [(1.0, 0.9**-0.5), (0.95, (0.9 / 0.95) ** -0.5), (0.9, 1.0)]
)
def test_lower_efforts_slow_a_level_pendulum_by_the_root_of_what_lacks(
    needed: float, factor: float
) -> None:
    """About a vertical axis it needs m L² a alone, one second up and one down, and works m L² v² / 2."""
    a, inertia = 3.0, MASS * LENGTH**2
    base = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))
    rows = np.array([[0.0, 0.0, a], [a / 2, a, a], [a / 2, a, -a], [a, 0.0, -a]])[:, :, None]
    motion = Trajectory(("swing",), np.array([0.0, 1.0, 1.0, 2.0]), *rows.transpose(1, 0, 2))
    job = SimpleNamespace(
        cell=pendulum(inertia * a / needed, base), tasks=(), is_decided=True, returns=False
    )
    check = SimpleNamespace(name="torque", verdict="passed")
    schedule = SimpleNamespace(
        trajectory=motion, duration=2.0, events=(), stages=(), segments=(),
        verification=SimpleNamespace(checks=(check,)),
    )  # fmt: skip
    members, stages = torque_members(schedule, job)
    assert stages == []
    assert members["lower_effort"]["cycle_time"] == pytest.approx(2.0 * factor, rel=1e-12)
    joint = members["joints"]["swing"]
    assert joint["acceleration_factor"] == pytest.approx(1.0 / needed, rel=1e-9)
    assert joint["effective"] == pytest.approx(inertia * a, rel=1e-9)
    kinetic = inertia * a**2 / 2
    assert members["energy"]["left"] == {
        "work": pytest.approx(kinetic, rel=1e-9),
        "braking": pytest.approx(kinetic, rel=1e-9),
        "net": pytest.approx(0.0, abs=1e-9),
    }


def test_no_lower_effort_where_a_joint_could_not_hold_still(heavy) -> None:
    """Efforts of just what standing takes: 10 % less do not hold the arm."""
    schedule, job = heavy
    members, _ = torque_members(schedule, with_efforts(job, 0.05))
    assert members["lower_effort"]["cycle_time"] is None


def test_terminal_and_page_show_torques(heavy) -> None:
    """Energy, efforts and the bound's validity in the text; curves that reach the peaks on the page."""
    schedule, job = heavy
    bounded = replace(schedule, lower_bound=0.5 * schedule.duration)
    lines = summary_lines(build_report(bounded, job))
    assert any("torque limits keep it valid" in line for line in lines)
    assert any(line.startswith("energy at the joints") and " J net" in line for line in lines)
    assert any(line.startswith("efforts 10% lower: ") for line in lines)
    assert any(line.startswith("efforts permit ") for line in lines)
    curves = torque_curves(schedule, job_as_done(schedule, job))
    members, _ = torque_members(schedule, job)
    assert curves["efforts"] == [joint["effort"] for joint in members["joints"].values()]


def test_a_robot_without_data_has_no_torques(heavy) -> None:
    """None in the report and on the page, and no line."""
    schedule, job = heavy
    ignored = replace(job, cell=replace(job.cell, torque="ignored"))
    report = build_report(schedule, ignored)
    assert report["torques"] is None
    assert {stage["torque"] for stage in report["stages"]} == {None}
    assert torque_curves(schedule, ignored) is None
    assert not any(line.startswith(("energy", "efforts")) for line in summary_lines(report))
