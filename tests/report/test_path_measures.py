"""Measures of paths, taken once more with pinocchio on the URDF; the figure, the same bytes every time."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds.path import figures
from dualarm_cli.kinds.path.figures import draw_paths
from dualarm_cli.kinds.path.measures import path_curves, path_lines, path_measures, path_samples
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

CELL = """\
dualarm: cell/1
robot: sda10f
base: {xyz: [0.1, -0.2, 0.05], rpy: [0, 0, 20 deg]}
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [10 mm, 0, 100 mm]}}
frames:
  robot: {xyz: [0.1, -0.2, 0.05], rpy: [0, 0, 20 deg]}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: home
tasks:
  - id: seam
    path:
      redundancy: virtual_spring_damped
      in: robot
      speed: 100 mm/s
      tolerance: 0.2 mm
      stiffness: 10
      critical_points: {left: {xyz: [0.1, 0.5, 0.2]}, right: {xyz: [0.0, -0.4, 0.1]}}
      left:
        through:
          - {xyz: [0.45, 0.25, 0.90], rpy: [180 deg, 0, 0]}
          - {xyz: [0.48, 0.25, 0.90]}
      right:
        through:
          - {xyz: [0.45, -0.25, 0.90], rpy: [180 deg, 0, 0]}
          - {xyz: [0.47, -0.25, 0.90]}
"""
CRITICAL = {"left": np.array([0.1, 0.5, 0.2]), "right": np.array([0.0, -0.4, 0.1])}
STARTS = {"left": np.array([0.45, 0.25, 0.9]), "right": np.array([0.45, -0.25, 0.9])}
LENGTHS = {"left": 0.03, "right": 0.02}
ARMS = ("left", "right")


class Measured:
    """The path of a schedule by pinocchio, at evenly spaced instants between its first and last."""

    def __init__(self, schedule, cell, count):
        """Prepares model and instants."""
        self.model = pin.buildModelFromXML(schedule.robot.urdf)
        self.data = self.model.createData()
        self.cell = cell
        names = list(self.model.names)[1:]
        self.joints = schedule.trajectory.joints
        (span,) = {(s.start, s.end) for s in schedule.segments if s.kind == "path"}
        self.time = np.linspace(*span, count)
        q, v, _ = schedule.trajectory.at(self.time)
        order = [self.joints.index(name) for name in names]
        self.q, self.v, self.names = q[:, order], v[:, order], names

    def at(self, k):
        """Puts the robot where it is at the k-th instant."""
        pin.computeJointJacobians(self.model, self.data, self.q[k])
        pin.updateFramePlacements(self.model, self.data)

    def tool(self, arm):
        """The tool in the robot's own frame."""
        flange = self.model.getFrameId(self.cell.robot.arm(arm).flange)
        return self.data.oMf[flange] * self.cell.tools[arm].tcp

    def jacobian(self, arm):
        """Jacobian of the tool by pinocchio's frame, moved to the tool centre point, along the root's axes."""
        flange = self.model.getFrameId(self.cell.robot.arm(arm).flange)
        frame = pin.LOCAL_WORLD_ALIGNED
        J = pin.getFrameJacobian(self.model, self.data, flange, frame)
        r = self.tool(arm).translation - self.data.oMf[flange].translation
        moved = J.copy()
        moved[:3] -= pin.skew(r) @ J[3:]
        return moved

    def elbow(self, arm):
        """Where the fourth joint of the arm is."""
        joint = self.model.getJointId(self.cell.robot.arm(arm).joints[3])
        return self.data.oMi[joint].translation.copy()

    def critical(self, arm):
        """The critical point, which the waist carries."""
        waist = self.model.getJointId(self.cell.robot.platform[-1])
        return self.data.oMi[waist].act(CRITICAL[arm])

    def columns(self, joints):
        """Columns of joints."""
        return [self.names.index(name) for name in joints]


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Two lines by the damped springs, which follow them only nearly and turn the waist; verified."""
    folder = tmp_path_factory.mktemp("seam")
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(TASKS)
    job = load_job(folder / "tasks.yaml")
    schedule = plan_without_bound(job, PlanSettings())
    schedule = dataclasses.replace(schedule, verification=verify(schedule, job, clearance=True))
    (measures,) = path_measures(schedule, job)
    return SimpleNamespace(
        job=job, schedule=schedule, measures=measures, mine=Measured(schedule, job.cell, 401)
    )


def test_what_is_said_of_the_path_itself(planned):
    """Name, method, arms, length of the longer line, duration of its segment without the transfer before it."""
    found = planned.measures
    assert (found["task"], found["method"]) == ("seam", "virtual_spring_damped")
    assert found["arms"] == ["left", "right"]
    assert found["length"] == pytest.approx(0.03, abs=1e-12)
    segment = next(s for s in planned.schedule.segments if s.kind == "path")
    assert segment.start > 0.0
    assert found["duration"] == pytest.approx(segment.end - segment.start, abs=1e-12)


def test_the_tool_error_is_the_distance_from_the_lines(planned):
    """Both run along the robot's x: beside them it is the distance in y and z, at their ends also that in x."""
    mine, worst, worst_angle = planned.mine, 0.0, 0.0
    down = pin.utils.rotate("x", np.pi)
    for k in range(len(mine.time)):
        mine.at(k)
        for arm in ARMS:
            T = mine.tool(arm)
            off = T.translation - STARTS[arm]
            off[0] -= np.clip(off[0], 0.0, LENGTHS[arm])
            worst = max(worst, float(np.linalg.norm(off)))
            worst_angle = max(worst_angle, float(np.linalg.norm(pin.log3(down.T @ T.rotation))))
    # The damped method leaves its path visibly, or nothing would be measured here.
    assert worst > 1e-5
    assert planned.measures["tool_error"] == pytest.approx(worst, rel=1e-3)
    assert planned.measures["tool_angle_error"] == pytest.approx(worst_angle, rel=1e-3)


def test_elbows_are_as_far_from_their_critical_points_as_pinocchio_says(planned):
    """Mean over the time; the samples' forces are ten times that."""
    mine = planned.mine
    distances = {arm: [] for arm in ARMS}
    for k in range(len(mine.time)):
        mine.at(k)
        for arm in ARMS:
            distances[arm].append(np.linalg.norm(mine.elbow(arm) - mine.critical(arm)))
    (samples,) = path_samples(planned.schedule, planned.job)
    for m, arm in enumerate(ARMS):
        mean = float(np.mean(distances[arm]))
        assert planned.measures["elbow_distance"][arm] == pytest.approx(mean, rel=1e-3)
        assert samples.distance[[0, -1], m] == pytest.approx(
            [distances[arm][0], distances[arm][-1]], abs=1e-9
        )
        assert samples.force[0, m] == pytest.approx(10.0 * distances[arm][0], abs=1e-8)


def test_the_least_distance_is_that_of_the_arm_s_self_motion(planned):
    """Self-motion traced with pinocchio, the waist standing: no elbow within limits is nearer, one is as near."""
    mine, model = planned.mine, planned.mine.model
    (samples,) = path_samples(planned.schedule, planned.job)
    assert (samples.least <= samples.distance + 1e-9).all()
    for m, arm in enumerate(ARMS):
        columns = mine.columns(planned.job.cell.robot.arm(arm).joints)
        mine.at(0)
        flange = model.getFrameId(planned.job.cell.robot.arm(arm).flange)
        goal, nearest = mine.data.oMf[flange].copy(), np.inf
        for way in (1.0, -1.0):
            q, ahead = mine.q[0].copy(), None
            for _ in range(3000):
                J = pin.computeFrameJacobian(model, mine.data, q, flange)[:, columns]
                null = np.linalg.svd(J)[2][-1]
                ahead = null * way if ahead is None else null * np.sign(null @ ahead)
                q[columns] += 2e-3 * ahead
                for _ in range(2):
                    pin.framesForwardKinematics(model, mine.data, q)
                    left = pin.log6(mine.data.oMf[flange].actInv(goal)).vector
                    J = pin.computeFrameJacobian(model, mine.data, q, flange)[:, columns]
                    q[columns] += np.linalg.pinv(J) @ left
                if ((q < model.lowerPositionLimit) | (q > model.upperPositionLimit)).any():
                    break
                pin.framesForwardKinematics(model, mine.data, q)
                nearest = min(nearest, float(np.linalg.norm(mine.elbow(arm) - mine.critical(arm))))
        # Other branches may come nearer still; of this arm none does.
        assert samples.least[0, m] == pytest.approx(nearest, abs=2e-3)
        assert samples.least[0, m] <= nearest + 1e-9
    means = planned.measures["least_elbow_distance"]
    assert [means[arm] for arm in ARMS] == pytest.approx(samples.least.mean(axis=0).tolist())


def test_manipulabilities_are_those_of_pinocchio_s_jacobians(planned):
    """The product of the singular values: of each arm by its own seven joints, of both tools by all fifteen."""
    mine, robot = planned.mine, planned.job.cell.robot
    alone, together = {arm: [] for arm in ARMS}, []
    for k in range(0, len(mine.time)):
        mine.at(k)
        J = {arm: mine.jacobian(arm) for arm in ARMS}
        for arm in ARMS:
            own = J[arm][:, mine.columns(robot.arm(arm).joints)]
            alone[arm].append(np.prod(np.linalg.svd(own, compute_uv=False)))
        both = np.vstack([J["left"], J["right"]])
        together.append(np.prod(np.linalg.svd(both, compute_uv=False)))
    found = planned.measures
    for arm in ARMS:
        assert found["manipulability"][arm] == pytest.approx(np.mean(alone[arm]), rel=2e-3)
    assert found["manipulability_together"] == pytest.approx(np.mean(together), rel=2e-3)
    assert found["least_manipulability_together"] == pytest.approx(np.min(together), rel=2e-3)


def test_joint_travel_is_the_integral_of_all_speeds(planned):
    """During the path alone, by the trapezoidal rule; the platform's share is its own."""
    mine = planned.mine
    travel = np.trapezoid(np.abs(mine.v), mine.time, axis=0)
    assert planned.measures["joint_travel"] == pytest.approx(travel.sum(), rel=2e-3)
    (waist,) = mine.columns(planned.job.cell.robot.platform)
    assert travel[waist] > 0.01
    assert planned.measures["platform_travel"] == pytest.approx(travel[waist], rel=2e-3)


def test_room_and_speed_are_measured_against_the_limits(planned):
    """The smallest room of any joint to the URDF's limits, and the largest share of a speed limit."""
    mine = planned.mine
    low, high = mine.model.lowerPositionLimit, mine.model.upperPositionLimit
    room = np.minimum(mine.q - low, high - mine.q).min(axis=0)
    found = planned.measures
    assert found["limit_joint"] == mine.names[int(np.argmin(room))]
    assert found["limit_room"] == pytest.approx(room.min(), abs=1e-4)
    share = (np.abs(mine.v) / mine.model.velocityLimit).max(axis=0)
    assert found["speed_joint"] == mine.names[int(np.argmax(share))]
    assert found["speed_share"] == pytest.approx(share.max(), rel=5e-3)


def test_a_slower_job_uses_more_of_its_slower_limits(planned):
    """At 50 % the same motion uses twice the share."""
    job = dataclasses.replace(planned.job, speed=0.5)
    (found,) = path_measures(planned.schedule, job)
    assert found["speed_share"] == pytest.approx(2.0 * planned.measures["speed_share"], rel=1e-12)


def test_the_clearance_is_that_of_the_path_s_stage(planned):
    """As the verifier proved it; nothing where it did not."""
    (stage,) = [k for k, s in enumerate(planned.schedule.stages) if "seam" in s.tasks]
    proven = [
        c.clearance
        for c in planned.schedule.verification.clearances
        if c.stage == stage and not c.near
    ]
    assert proven
    assert planned.measures["clearance"] == min(proven)
    bare = dataclasses.replace(planned.schedule, verification=None)
    assert path_measures(bare, planned.job)[0]["clearance"] is None


def test_joints_of_an_idle_arm_do_not_count_as_near_their_limits(planned):
    """Where only the left arm follows, the room is that of the left arm and the platform."""
    task = planned.job.tasks[0]
    work = dataclasses.replace(task.path, paths={"left": task.path.paths["left"]})
    job = dataclasses.replace(planned.job, tasks=(dataclasses.replace(task, path=work),))
    segments = tuple(s for s in planned.schedule.segments if s.arm == "left" or s.kind != "path")
    # The right arm stands at the limit of its elbow all the time.
    trajectory = planned.schedule.trajectory
    position = np.array(trajectory.position)
    column = trajectory.joints.index("right_e")
    position[:, column] = job.cell.robot.limits.upper[job.cell.robot.columns(["right_e"])[0]]
    schedule = dataclasses.replace(
        planned.schedule,
        segments=segments,
        motion=JointMotion.of(dataclasses.replace(trajectory, position=position)),
    )
    (found,) = path_measures(schedule, job)
    assert found["arms"] == ["left"]
    assert not found["limit_joint"].startswith("right")
    mine = planned.mine
    columns = [k for k, name in enumerate(mine.names) if not name.startswith("right")]
    low, high = mine.model.lowerPositionLimit, mine.model.upperPositionLimit
    room = np.minimum(mine.q - low, high - mine.q)[:, columns].min()
    assert found["limit_room"] == pytest.approx(room, abs=1e-4)


def test_jobs_without_paths_have_no_measures(tasks_folder, planned):
    """Neither measures nor samples; nor a path whose segment is missing."""
    job = load_job(tasks_folder / "03_bottin_planar" / "tasks.yaml")
    assert path_measures(planned.schedule, job) == []
    assert path_samples(planned.schedule, job) == []
    bare = dataclasses.replace(planned.schedule, segments=())
    assert path_measures(bare, planned.job) == []


def test_curves_of_the_comparison_are_those_of_the_samples(planned):
    """101 instants from the path's first to its last: force, manipulability of each arm and together."""
    (samples,) = path_samples(planned.schedule, planned.job)
    (curves,) = path_curves(planned.schedule, planned.job)
    assert len(curves["time"]) == 101
    assert curves["time"][-1] == pytest.approx(planned.measures["duration"], abs=1e-12)
    k = [int(np.argmin(np.abs(samples.time - time))) for time in curves["time"]]
    for m, arm in enumerate(ARMS):
        np.testing.assert_array_equal(curves["force"][arm], samples.force[k, m])
        np.testing.assert_array_equal(
            curves["manipulability"][arm], samples.arm_manipulability[k, m]
        )
    np.testing.assert_array_equal(
        curves["manipulability_together"], samples.joint_manipulability[k]
    )


def test_the_figure_names_every_curve_beside_the_panels(planned, monkeypatch):
    """All joints, tools, elbows, critical points and least forces are in legends, and no panel has one in it."""
    seen = []
    monkeypatch.setattr(figures, "rendered", lambda figure, kind: seen.append(figure) or b"")
    draw_paths(planned.schedule, planned.job, "png")
    (whole,) = seen
    parts = [sub for part in whole.subfigs for sub in part.subfigs]
    named = {text.get_text() for part in parts for legend in part.legends for text in legend.texts}
    robot = planned.job.cell.robot
    assert named >= {*robot.platform, *(joint for arm in robot.arms for joint in arm.joints)}
    things = ("tool", "elbow", "critical point")
    assert named >= {f"{arm} {what}" for arm in ARMS for what in things}
    assert named >= {f"{arm}, least force with tools there" for arm in ARMS}
    panels = [axes for part in parts for axes in part.axes]
    assert len(panels) == 4 + 3 + 3
    for axes in panels:
        assert axes.get_legend() is None
        assert all(getattr(axes, f"get_{name}label")() for name in "xy")


def test_the_sentence_has_the_measures_in_people_s_units(planned):
    """Millimetres, degrees, percent, by hand from the measures."""
    (line,) = path_lines({"paths": [planned.measures]})
    found = planned.measures
    assert line.startswith("path seam by virtual_spring_damped: 30.0 mm in ")
    assert f"{found['elbow_distance']['left'] * 1000:.0f} mm" in line
    assert f"joints travel {np.degrees(found['joint_travel']):.0f} deg" in line
    assert f"{found['speed_joint']} uses {100 * found['speed_share']:.0f}% of its speed" in line


@pytest.mark.parametrize(
    ("kind", "begin"), [("png", b"\x89PNG"), ("svg", b"<?xml"), ("pdf", b"%PDF")]
)
def test_the_figure_is_the_same_bytes_twice_and_needs_no_screen(planned, kind, begin, monkeypatch):
    """Also where matplotlib is told to open windows and there is no display; another motion is another picture."""
    first = draw_paths(planned.schedule, planned.job, kind)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("MPLBACKEND", "TkAgg")
    assert draw_paths(planned.schedule, planned.job, kind) == first
    assert first.startswith(begin)
    assert len(first) > 10_000
    trajectory = planned.schedule.trajectory
    other = dataclasses.replace(trajectory, position=np.array(trajectory.position) + 0.1)
    schedule = dataclasses.replace(planned.schedule, motion=JointMotion.of(other))
    if kind == "png":
        assert draw_paths(schedule, planned.job, kind) != first
