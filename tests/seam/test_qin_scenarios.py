"""Both scenarios of [Qin2024] from their task files: phases, closed chain, speeds, limits, and the closed forms."""

from __future__ import annotations

import functools
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.wrist_arm import WristArm
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

SETTINGS = PlanSettings(timing="trapezoid", effort="quick", named=frozenset({"timing"}))


@dataclass(frozen=True)
class Scenario:
    """One scenario, planned."""

    job: Job
    schedule: Schedule
    seams: list[tuple[float, float]]
    """From when to when each seam is worked [s]."""


@functools.cache
def planned(folder: Path) -> Scenario:
    """Returns the scenario of a folder."""
    job = load_job(folder / "tasks.yaml")
    schedule = plan_without_bound(job, SETTINGS)
    seams = sorted({(s.start, s.end) for s in schedule.segments if s.kind == "seam"})
    return Scenario(job, schedule, seams)


@pytest.fixture(params=["qin_rotation", "qin_translation"])
def scenario(request: pytest.FixtureRequest, tasks_folder: Path) -> Scenario:
    """Each of them."""
    return planned(tasks_folder / "papers" / request.param)


def _poses(scenario: Scenario, arm: str, position: FloatArray) -> list[pin.SE3]:
    """Returns the tool of one arm by pinocchio on the schedule's URDF."""
    robot = scenario.schedule.robot
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    order = [scenario.schedule.trajectory.joints.index(name) for name in model.names[1:]]
    frame = model.getFrameId(robot.arms[arm].flange)
    found = []
    for q in position:
        pin.framesForwardKinematics(model, data, q[order])
        found.append(robot.base * data.oMf[frame] * robot.arms[arm].tcp)
    return found


def test_the_plan_is_verified(scenario):
    """By the verifier, clearance included."""
    verification = verify(scenario.schedule, scenario.job, clearance=True)
    assert verification.passed, [
        check for check in verification.checks if check.verdict == "failed"
    ]


def test_seams_begin_at_5_s_and_13_s(scenario):
    """Tables 3 and 4: 0 to 5 s, 5 to 13 s, 13 to 16 s; with these limits the way back of the first one takes longer."""
    (first, second), (third, fourth) = scenario.seams
    assert (first, second, third) == pytest.approx((5.0, 13.0, 13.0), abs=1e-9)
    if scenario.job.tasks[-1].seam.slower:
        assert 16.0 <= fourth < 18.0
    else:
        assert fourth == pytest.approx(16.0, abs=1e-9)


def test_the_rotation_is_that_of_figure_24(tasks_folder):
    """Axis 6 of M turns most, then axis 6 of S, the others hardly; the tool moves up and down, as the paper says.

    Axis 6 of S turns by what the track's slope is, atan(-r² s c / x / r), to both sides and back; the tool rises by
    R - sqrt(R² - r²). On the way to the first point, 0 to 5 s, every joint's speed is a trapezoid without a pause.
    """
    found = planned(tasks_folder / "papers" / "qin_rotation")
    job, trajectory = found.job, found.schedule.trajectory
    joints = trajectory.joints
    q = trajectory.at(np.linspace(5.0, 13.0, 2001))[0]
    travel = dict(zip(joints, np.abs(np.diff(q, axis=0)).sum(axis=0), strict=True))
    beta = np.linspace(0.0, np.pi, 2001)
    x = np.sqrt(0.05**2 - (0.045 * np.sin(beta)) ** 2)
    slope = np.arctan(-0.045 * np.sin(beta) * np.cos(beta) / x)
    assert travel.pop("left_joint_6") == pytest.approx(np.pi, abs=1e-6)
    spun = np.abs(np.diff(slope)).sum()
    assert travel.pop("right_joint_6") == pytest.approx(spun, rel=0.05)
    assert spun < np.pi
    assert max(travel.values()) < np.deg2rad(20.0)
    tool = CellModel.from_cell(job.cell).tool_position("right", q)
    moved = np.ptp(tool, axis=0)
    assert moved[2] == pytest.approx(0.05 - np.sqrt(0.05**2 - 0.045**2), abs=1e-4)
    assert np.hypot(*moved[:2]) < 0.003
    on_the_way = trajectory.at(np.linspace(0.05, 4.95, 99))[1]
    assert (np.abs(on_the_way).max(axis=1) > 1e-3).all()


def test_the_translation_has_a_quarter_in_8_s_and_the_rest_in_3_s(tasks_folder):
    """Table 4: the part is at the quarter of its circle of 100 mm at 13 s and back at 16 s, never turned."""
    found = planned(tasks_folder / "papers" / "qin_translation")
    rows = found.schedule.trajectory.at(np.array([5.0, 13.0, 16.0, *np.linspace(13.0, 16.0, 301)]))
    poses = _poses(found, "left", rows[0])
    places = np.array([pose.translation for pose in poses])
    docking, quarter = (-1.5, 0.5, 1.081), (-1.5, 0.4, 0.981)
    np.testing.assert_allclose(places[:3], [docking, quarter, docking], atol=1e-6)
    way = np.linalg.norm(np.diff(places[3:], axis=0), axis=1).sum()
    assert way == pytest.approx(0.75 * 2.0 * np.pi * 0.1, rel=1e-3)
    assert max(np.abs(pose.rotation - poses[0].rotation).max() for pose in poses) < 1e-6


BASE = {
    "x": ("-2.787771237015342", "-2.786771237015342"),
    "y": ("0.2736306197661341", "0.2746306197661341"),
    "z": ("-0.04619662918795875", "-0.04519662918795875"),
    "yaw": ("-0.14311725158125643", "-0.14211725158125643"),
}
"""Numbers of the right robot's base, and what they are with an error of 1 mm or 1 mrad."""


def _seam_distance(found: Scenario, folder: Path, tasks_folder: Path, **changed: str) -> float:
    """Returns how far the plan's tool is from its seams in a copy of the job with files of other content [m]."""
    copy = folder / "copy"
    shutil.copytree(tasks_folder / "papers" / "qin_translation", copy, dirs_exist_ok=True)
    (folder / "dualarm.toml").touch()
    for name, text in changed.items():
        (copy / f"{name}.yaml").write_text(text)
    checks = verify(found.schedule, load_job(copy / "tasks.yaml")).checks
    [measured] = [check.measured for check in checks if check.name == "seam_distance"]
    assert measured is not None
    return measured


def test_what_a_wrong_base_or_tool_does_to_the_distance_at_the_seam(tasks_folder, tmp_path):
    """A millimetre of either is a millimetre there; a turned base moves the tool by its angle times the distance."""
    folder = tasks_folder / "papers" / "qin_translation"
    found = planned(folder)
    base, cell = ((folder / name).read_text() for name in ("base.yaml", "cell.yaml"))
    assert _seam_distance(found, tmp_path, tasks_folder) < 1e-6
    off = {
        name: _seam_distance(found, tmp_path, tasks_folder, base=base.replace(*numbers))
        for name, numbers in BASE.items()
    }
    for name in "xyz":
        assert off[name] == pytest.approx(1e-3, abs=2e-6)
    q = found.schedule.trajectory.at(np.linspace(5.0, 16.0, 200))[0]
    tool = np.array([pose.translation for pose in _poses(found, "right", q)])
    far = np.hypot(*(tool[:, :2] - [float(BASE["x"][0]), float(BASE["y"][0])]).T).max()
    # The seam is 5 mm before the tool.
    assert 1e-3 * (far - 0.1) < off["yaw"] < 1e-3 * (far + 0.005)
    assert off["yaw"] == pytest.approx(1.3e-3, abs=0.05e-3)
    longer = cell.replace("[0, 0, 347 mm]", "[0, 0, 348 mm]")
    tool_off = _seam_distance(found, tmp_path, tasks_folder, base=base, cell=longer)
    assert tool_off == pytest.approx(1e-3, abs=2e-6)
    fitted = tmp_path / "fitted.yaml"
    points = tasks_folder / "papers" / "qin_calibration" / "points.yaml"
    assert run(["calibrate", str(points), "--out", str(fitted), "--quiet"]) == 0
    refitted = _seam_distance(found, tmp_path, tasks_folder, base=fitted.read_text(), cell=cell)
    assert refitted == pytest.approx(12.1e-3, abs=0.1e-3)


def test_the_half_track_s_frames_are_those_of_the_saddle(tasks_folder):
    """Eq. 12 at every 2 deg: points, x along the track, z out of the branch pipe; backwards with x turned round."""
    folder = tasks_folder / "papers" / "qin_rotation"
    there, back = (
        np.loadtxt(folder / name, delimiter=",", skiprows=1)
        for name in ("half_track.csv", "half_track_back.csv")
    )
    beta = np.deg2rad(np.arange(0.0, 181.0, 2.0))
    c, s, R, r = np.cos(beta), np.sin(beta), 0.05, 0.045
    x = np.sqrt(R**2 - (r * s) ** 2)
    np.testing.assert_allclose(there[:, :3], np.stack([x, r * s, -r * c], axis=1), atol=1e-9)
    along = np.stack([-(r**2) * s * c / x, r * c, r * s], axis=1)
    along /= np.linalg.norm(along, axis=1)[:, None]
    for rows, way in ((there, 1.0), (back[::-1], -1.0)):
        np.testing.assert_allclose(rows[:, :3], there[:, :3], atol=1e-12)
        frames = np.array([pin.Quaternion(q).toRotationMatrix() for q in rows[:, 3:]])
        np.testing.assert_allclose(frames[:, :, 0], way * along, atol=1e-8)
        np.testing.assert_allclose(frames[:, :, 2], np.stack([0 * s, s, -c], axis=1), atol=1e-8)


def test_both_robots_stand_still_at_both_ends_of_seams(scenario):
    """Joint speeds are zero there, as in Figs. 24 and 27."""
    for time in np.ravel(scenario.seams):
        assert np.abs(scenario.schedule.trajectory.at(np.array([time]))[1]).max() < 1e-9


def test_the_chain_is_closed_to_a_micrometre(scenario):
    """The tool's point in the part's frame against the curve, by pinocchio: 1e-6 m (the experiment: 1.4 to 2.6 mm)."""
    job = scenario.job
    for (start, end), task in zip(scenario.seams, ("0", "-1"), strict=True):
        work = job.tasks[int(task)].seam
        time = np.linspace(start, end, 301)
        q = scenario.schedule.trajectory.at(time)[0]
        tool, holder = _poses(scenario, "right", q), _poses(scenario, "left", q)
        T_tool_part = job.cell.tools["left"].tcp.inverse() * work.part
        in_part = [(one * T_tool_part).actInv(two) for one, two in zip(holder, tool, strict=True)]
        tip = np.array([T.act(np.array([0.0, 0.0, work.tool.standoff])) for T in in_part])
        axis = np.array([T.rotation[:, 2] for T in in_part])
        # A curve of 4,000 places, then the nearest place of the line between neighbours: good to 1e-9 m.
        R, p = work.curve.at(np.linspace(0.0, work.length, 4001))
        k = np.linalg.norm(p[None] - tip[:, None], axis=2).argmin(axis=1)
        tangent = R[k][:, :, 0]
        off = tip - p[k]
        along = (off * tangent).sum(axis=1)
        bend = (p[np.minimum(k + 1, 4000)] - 2.0 * p[k] + p[np.maximum(k - 1, 0)]) / (
            work.length / 4000
        ) ** 2
        inside = (k > 0) & (k < 4000)
        off = off - along[:, None] * tangent - 0.5 * along[:, None] ** 2 * bend * inside[:, None]
        assert np.linalg.norm(off, axis=1)[inside].max() < 1e-6
        # The tool points into the surface; the normal at the nearest place turns by bend times the rest of the way.
        assert (axis * R[k][:, :, 2]).sum(axis=1).max() < -1.0 + 1e-6


def test_the_speed_along_seams_is_a_trapezoid(scenario):
    """The master's turn about the centre is in proportion to the way: its rate has two values, or rises and falls."""
    start, end = scenario.seams[0]
    time = np.linspace(start, end, 1001)
    q = scenario.schedule.trajectory.at(time)[0]
    tool, holder = _poses(scenario, "right", q), _poses(scenario, "left", q)
    tip = np.array(
        [
            one.actInv(two).act(np.array([0.0, 0.0, 0.005]))
            for one, two in zip(holder, tool, strict=True)
        ]
    )
    way = np.linalg.norm(np.diff(tip, axis=0), axis=1)
    speed = way / np.diff(time)
    steady = speed > 0.999 * np.median(speed)
    first, last = np.flatnonzero(steady)[[0, -1]]
    assert speed[first:last] == pytest.approx(np.median(speed), rel=1e-3)
    # Before and after, equal steps up and down: the second differences vanish.
    for ramp in (speed[2 : first - 2], speed[last + 3 : -2]):
        assert np.abs(np.diff(ramp, 2)).max() < 2e-3 * np.median(speed)


def test_joints_are_those_of_one_branch_of_the_closed_forms(scenario):
    """Along each seam the closed-form inverse kinematics of both robots has the same joints, on one branch."""
    job = scenario.job
    model = CellModel.from_cell(job.cell)
    trajectory = scenario.schedule.trajectory
    for start, end in scenario.seams:
        q = trajectory.at(np.linspace(start, end, 101))[0]
        for name, arm in model.arms.items():
            kinematics = arm.kinematics
            assert isinstance(kinematics, WristArm)
            own = q[:, arm.columns]
            branch = np.unique(kinematics.branch(own))
            assert len(branch) == 1, name
            solved = kinematics.solve(*kinematics.forward(own), reference=own)
            found = solved.q[np.arange(len(own)), branch[0]]
            turns = (found - own) / (2.0 * np.pi)
            assert np.abs(turns - np.round(turns)).max() < 1e-8
