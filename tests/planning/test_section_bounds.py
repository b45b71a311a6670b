"""The lower bound of jobs with paths and seams: what transfers to and from them add, and that no motion is faster."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.bound.bound import bound_note
from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.planning import kind_of
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.curves.contours import LineContour
from dualarm_cli.model.curves.feature_curve import FeatureCurve
from dualarm_cli.model.curves.tool_path import Line, ToolPath
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.model.process_work import Hold, PathWork, SeamTool, SeamWork
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.console import bound_line
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify

ARMS = ("left", "right")
PATHS = """\
  - id: one
    path:
      speed: 200 mm/s
      left:  {{through: [{{xyz: [{x}, 0.30, {z}], rpy: [180 deg, 0, 0]}}, {{xyz: [{x}, 0.36, {z}]}}]}}
      right: {{through: [{{xyz: [{x}, -0.30, {z}], rpy: [180 deg, 0, 0]}}, {{xyz: [{x}, -0.36, {z}]}}]}}
  - id: other
    path:
      arm: right
      speed: 200 mm/s
      through: [{{xyz: [{x}, -0.25, {z}], rpy: [180 deg, 0, 20 deg]}}, {{xyz: [{x}, -0.20, {z}]}}]
"""
PART = """\
  - id: part
    arm: left
    pick: {xyz: [0.5, 0.3, 0.9], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.45, 0.4, 0.9], rpy: [180 deg, 0, 0]}
    approach: 40 mm
"""
PART_IN_HAND = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
SEAM = FeatureCurve(
    LineContour(np.zeros(3), np.array([0.06, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    pin.SE3.Identity(),
)


def job_of(folder: Path, *tasks: str, head: str = "") -> Job:
    """A job of some tasks on a turning platform."""
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    file = folder / "tasks.yaml"
    file.write_text(f"dualarm: tasks/1\ncell: cell.yaml\n{head}tasks:\n" + "".join(tasks))
    return load_job(file)


def at_full_speed(job: Job) -> float:
    """What a job's paths and seams take at the speed of the file [s]."""
    works = {id(work): work for task in job.tasks if (work := task.path or task.seam) is not None}
    return sum(work.length / (work.speed * job.speed) for work in works.values())


@pytest.mark.parametrize("start", ["home", "free"])
def test_transfers_of_six_axis_arms_are_the_fastest_of_all_postures(
    general_robots, tmp_path: Path, start: str
) -> None:
    """Home, a path of both arms, one of the right arm, home: every posture at the ends of paths, with all turns."""
    file = general_robots.write_cell(tmp_path, "ur5")
    head = (
        file.read_text()
        .split("tasks:\n")[0]
        .replace("return: true", f"return: true\nstart: {start}")
    )
    file.write_text(f"{head}tasks:\n{PATHS.format(x=0.45, z=0.2)}")
    job = load_job(file)
    model = CellModel.from_cell(job.cell)
    home = np.array(job.cell.robot.postures["home"])
    one, other = (next(t.path for t in job.tasks if t.id == name) for name in ("one", "other"))
    begin, end, right_begin, right_end = (
        {
            arm: _postures(model, arm, path.pose(share * path.length))
            for arm, path in work.paths.items()
        }
        for work, share in product((one, other), (0.0, 1.0))
    )
    there = max(
        _least(model, job, arm, home[None][:, model.arms[arm].columns], begin[arm]) for arm in ARMS
    )
    between = _least(model, job, "right", end["right"], right_begin["right"])
    # The left arm stands where its path ended until both return.
    back = max(
        _least(model, job, arm, ends, home[None][:, model.arms[arm].columns])
        for arm, ends in (("left", end["left"]), ("right", right_end["right"]))
    )
    expected = between if start == "free" else there + between + back
    for blended in (False, True):
        bound = job_bound(job, "quick", "lines" if blended else "none")
        # Tables of times have steps of distance, and round down.
        assert 0.99 * expected <= bound.value - at_full_speed(job) <= expected
        assert bound_note("paths") in bound.assumptions


def _postures(model: CellModel, arm: str, pose: pin.SE3) -> FloatArray:
    """All joints within limits of an arm whose tool is at a pose, shape (k, 6)."""
    own = model.arms[arm]
    R, p = model.platform.pose(np.zeros(0))
    flange = pin.SE3(R, p).inverse() * pose * own.T_flange_tcp.inverse()
    found = own.kinematics.solve(flange.rotation, flange.translation)
    limits = model.cell.robot.limits.select(own.arm.joints)
    turned = (
        found.q[found.reachable][:, None]
        + 2.0 * np.pi * np.array(list(product((-1, 0, 1), repeat=6)))
    ).reshape(-1, 6)
    return turned[((turned >= limits.lower) & (turned <= limits.upper)).all(axis=1)]


def _least(model: CellModel, job: Job, arm: str, some: FloatArray, others: FloatArray) -> float:
    """The shortest motion from rest to rest from one of some joints (k, 6) to one of others (m, 6) [s]."""
    limits = job.cell.robot.limits.select(model.arms[arm].arm.joints)
    law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
    return float(law.duration(others[None] - some[:, None]).min())


@pytest.mark.parametrize("seed", range(40))
def test_no_motion_through_random_configurations_is_faster(tmp_path: Path, seed: int) -> None:
    """Paths and moves where random configurations have the tools: the motion through these configurations."""
    rng = np.random.default_rng(seed)
    whole = job_of(tmp_path, PATHS.format(x=0.5, z=0.9), head="start: home\nreturn: true\n")
    model = CellModel.from_cell(whole.cell)
    walk = _RandomJob(whole, model, rng)
    job, least = walk.job, walk.duration
    for blended in (False, True):
        assert job_bound(
            job, "quick", "lines" if blended else "none"
        ).value <= least + at_full_speed(job)


class _RandomJob:
    """Sections of random tasks, and the motion from rest to rest through the configurations that they were made of."""

    def __init__(self, whole: Job, model: CellModel, rng: np.random.Generator) -> None:
        self._whole, self._model, self._rng = whole, model, rng
        limits = whole.cell.robot.limits
        self._law = RestToRest(limits.velocity, limits.acceleration, limits.jerk)
        self._lower, self._upper = limits.lower, limits.upper
        self._home = np.array(whole.cell.robot.postures["home"])
        # Where the platform was last, and each arm, which stands still while it has nothing to do.
        self._platform = self._home
        self._last = dict.fromkeys(ARMS, self._home)
        self._tasks: list[Task] = []
        self.duration = 0.0
        # Alone with the ways there and back its bound is nearly as long as the motion.
        paths = int(rng.choice([1, 2, 4]))
        stops = rng.random() < 0.5
        for number in range(paths):
            if stops:
                self._add_stops(number)
            if rng.random() < 0.3:
                self._add_seam(number)
            else:
                self._add_path(number)
        if stops and rng.random() < 0.5:
            self._add_stops(paths)
        self._stage(dict.fromkeys(ARMS, self._home), self._home)
        self.job = replace(whole, tasks=tuple(self._tasks))

    def _drawn(self, near: FloatArray | None = None) -> FloatArray:
        spread = self._rng.choice([0.02, 0.3, 1.0, 3.0])
        q = (self._platform if near is None else near) + spread * self._rng.normal(
            size=len(self._home)
        )
        return np.clip(q, self._lower, self._upper)

    def _stage(self, there: dict[str, FloatArray], platform: FloatArray) -> None:
        """Adds a stage in which some arms, and the platform, go to configurations, the slowest one last."""
        moved = np.zeros_like(platform)
        columns = self._model.platform_columns
        moved[columns] = (platform - self._platform)[columns]
        for arm, q in there.items():
            own = self._model.arms[arm].columns
            moved[own] = (q - self._last[arm])[own]
        self.duration += float(self._law.duration(moved))
        self._platform = platform
        self._last |= there

    def _add_stops(self, number: int) -> None:
        counts = {arm: int(self._rng.integers(0, 3)) for arm in ARMS}
        # The right arm may have to wait for the left one's first task.
        waits = counts["left"] > 0 and self._rng.random() < 0.3
        first = {"left": 0, "right": int(waits)}
        for k in range(4):
            q = self._drawn()
            now = [arm for arm in ARMS if first[arm] <= k < first[arm] + counts[arm]]
            for arm in now:
                stop = Stop(
                    "move", PoseTarget(self._model.tool_pose(arm, q)), 0.0, 0.0, Dwell(), NOWHERE
                )
                after = (f"left {number} 0",) if arm == "right" and waits and k == 1 else ()
                self._tasks.append(Task(f"{arm} {number} {k}", arm, (stop,), after))
            if now:
                self._stage(dict.fromkeys(now, q), q)

    def _add_path(self, number: int) -> None:
        arms = (ARMS, ("left",), ("right",))[self._rng.integers(3)]
        first, last = self._drawn(), self._drawn()
        self._stage(dict.fromkeys(arms, first), first)
        poses = {arm: [self._model.tool_pose(arm, q) for q in (first, last)] for arm in arms}
        paths = {arm: ToolPath((Line(*ends),)) for arm, ends in poses.items()}
        work = PathWork(paths, speed=0.2)
        for arm in arms:
            end = Stop("path", PoseTarget(poses[arm][1]), 0.0, 0.0, Dwell(), NOWHERE)
            self._tasks.append(Task(f"path {number}", arm, (end,), path=work))
        self._platform = last
        self._last |= dict.fromkeys(arms, last)

    def _add_seam(self, number: int) -> None:
        """Adds a seam on a part that the planner holds where it likes: it begins at once, and ends anywhere."""
        work = SeamWork("left", "right", PART_IN_HAND, SEAM, SeamTool(), Hold(), speed=0.1)
        self._tasks += [Task(f"seam {number}", arm, (), seam=work) for arm in ARMS]
        last = self._drawn(self._home if self._rng.random() < 0.5 else None)
        self._platform = last
        self._last |= dict.fromkeys(ARMS, last)


@pytest.mark.parametrize("parts_first", [True, False])
def test_transfers_to_and_from_paths_raise_the_bound_and_no_plan_is_faster(
    tmp_path: Path, parts_first: bool
) -> None:
    """A part before two paths, and after them; without the return the bound is less, and so it is with blending."""
    rows = (PART, PATHS.format(x=0.5, z=0.9))
    job = job_of(tmp_path, *(rows if parts_first else rows[::-1]), head="return: true\n")
    bounds = []
    for blend in ("none", "lines"):
        schedule = plan_without_bound(job, PlanSettings(effort="quick", blend=blend))
        assert verify(schedule, job).passed
        bounds.append(job_bound(job, "quick", blend).value)
        ends = replace(job, returns=False)
        least = job_bound(ends, "quick", blend).value
        assert at_full_speed(job) < least < bounds[-1] < schedule.duration
    assert bounds[1] < bounds[0]


def test_an_arm_comes_from_where_it_stood_before_the_other_one_s_work(tmp_path: Path) -> None:
    """A path of the left arm, a part for the right one, both again: each transfer counts, and where the arm started."""
    path = "  - id: other" + PATHS.format(x=0.5, z=0.9).split("  - id: other")[1]
    path = path.replace("arm: right", "arm: left").replace(", -0.2", ", 0.2")
    right = PART.replace("arm: left", "arm: right").replace(" 0.3,", " -0.3,")
    right = right.replace(" 0.4,", " -0.4,")
    again = path.replace("id: other", "id: again"), right.replace("id: part", "id: more")
    head = "start: free\n"
    for blended in (False, True):
        bounds = []
        for tasks in ((path,), (path, right), (path, right, again[0]), (path, right, *again)):
            job = job_of(tmp_path, *tasks, head=head)
            found = job_bound(job, "quick", "lines" if blended else "none").value
            bounds.append(found - at_full_speed(job))
        # The right arm's way from its last place to the next pick is longer than the left one's to its path.
        assert (np.diff(bounds) > (0.1, -1e-3, 0.1)).all()
        robot = job.cell.robot
        far = np.array(robot.postures["home"])
        far[robot.columns(robot.arm("right").joints)] += 1.0
        moved = replace(robot, postures={**robot.postures, "home": far})
        elsewhere = replace(job, cell=replace(job.cell, robot=moved))
        assert job_bound(elsewhere, "quick", "lines" if blended else "none").value > found


def test_handovers_between_paths_last_for_all_of_their_dwells(
    tasks_folder: Path, tmp_path: Path
) -> None:
    """Dwells of 5 s: pick, give after take, place beside pick, give after take, place."""
    handed = load_job(tasks_folder / "13_hand_over" / "tasks.yaml")
    path = job_of(tmp_path, PATHS.format(x=0.5, z=0.9)).tasks
    stops = [
        replace(t, stops=tuple(replace(s, dwell=Dwell(gripper=5.0)) for s in t.stops))
        for t in handed.tasks
    ]
    job = replace(handed, tasks=(*path, *stops))
    bound = job_bound(job, "quick").value
    assert bound - at_full_speed(job) > 7 * 5.0
    assert (
        bound
        <= plan_without_bound(job, PlanSettings(effort="quick"), check_collisions=False).duration
    )


def test_an_open_order_leaves_transfers_to_paths_out(tmp_path: Path) -> None:
    """The bound holds for every order, and says what it leaves out."""
    job = job_of(tmp_path, PATHS.format(x=0.5, z=0.9), head="order: optimise\nreturn: true\n")
    bound = job_bound(job, "quick")
    assert bound.value == pytest.approx(at_full_speed(job), rel=2e-5)
    assert bound_note("open_paths") in bound.assumptions


def test_an_open_order_of_seams_may_use_the_time_before_they_open(tmp_path: Path) -> None:
    """A: 10 s there, not before 11 s, 0.6 s; B: not before 10 s, 0.6 s and 6 s more. A, then B: 11.6 + 6.6 s."""
    seam = (
        "  - id: {name}\n    coordinate:\n      master: left\n      slave: right\n"
        "      curve: {{kind: line, start: [-30 mm, 0, 0], end: [30 mm, 0, 0]}}\n"
        "      part: {{xyz: [0, 0, 200 mm]}}\n      speed: 100 mm/s\n"
        "      not_before: {opens}\n      {more}\n"
    )
    rows = [
        seam.format(name="a", opens="11 s", more="entry: {duration: 10 s}"),
        seam.format(name="b", opens="10 s", more="exit: {dwell: 6 s}"),
    ]
    for tasks in (rows, rows[::-1]):
        job = job_of(tmp_path, *tasks, head="order: optimise\n")
        assert job_bound(job, "quick").value == pytest.approx(11.0 + 0.6 + 6.6, rel=2e-5)


def test_tasks_of_any_arm_between_paths_count_alone(tmp_path: Path) -> None:
    """Two paths with such tasks before, between and after them: dwells of 2 s at four stops, on two arms."""
    anyone = PART.replace("arm: left", "arm: any").replace("approach", "dwell: 2 s\n    approach")
    one, other = PATHS.format(x=0.5, z=0.9).split("  - id: other")
    more = anyone.replace("id: part", "id: more").replace(" 0.3,", " 0.35,")
    job = job_of(tmp_path, anyone, one, more, "  - id: other" + other, head="return: true\n")
    for blend in ("none", "lines"):
        bound = job_bound(job, "quick", blend).value
        schedule = plan_without_bound(
            job, PlanSettings(effort="quick", blend=blend), check_collisions=False
        )
        # The right arm goes home from the second path besides.
        assert at_full_speed(job) + 2 * 2 * 2.0 / 2 + 0.1 < bound <= schedule.duration
        # Paths come in the file's order.
        line = bound_line(build_report(replace(schedule, lower_bound=bound), job))
        assert "plan of these tasks is faster" in line


def test_after_tasks_of_any_arm_both_arms_go_on_from_anywhere(
    general_robots, tmp_path: Path
) -> None:
    """Which arm did them is not told: the right arm's second path counts the same wherever it is."""
    file = general_robots.write_cell(tmp_path, "ur5")
    head = "dualarm: tasks/1\ncell: cell.yaml\nstart: free\ntasks:\n"
    path = "  - id: other" + PATHS.format(x=0.45, z=0.2).split("  - id: other")[1]
    anyone = PART.replace("arm: left", "arm: any").replace("0.9]", "0.2]")
    far = path.replace("id: other", "id: far").replace("0.45, -0.2", "0.35, -0.6")
    near = path.replace("id: other", "id: near")
    bounds = []
    for between, last in ((anyone, near), (anyone, far), ("", near), ("", far)):
        file.write_text(head + path + between + last)
        job = load_job(file)
        bounds.append(job_bound(job, "quick").value - at_full_speed(job))
    assert bounds[0] == pytest.approx(bounds[1], rel=1e-4)
    assert bounds[2] + 0.1 < bounds[3]


def test_a_path_that_ends_out_of_reach_within_its_tolerance_has_a_bound(tmp_path: Path) -> None:
    """The end is some 0.5 mm beyond the stretched arm, which springs as printed come near enough: 40 mm at 50 mm/s."""
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot:\n  left:  {robot: iiwa14, base: {xyz: [0, 0.35, 0]}}\n"
        "  right: {robot: iiwa14, base: {xyz: [0, -0.35, 0]}}\n"
        "tools: {left: {tcp: {xyz: [0, 0, 150 mm]}}, right: {tcp: {xyz: [0, 0, 150 mm]}}}\n"
    )
    file = tmp_path / "tasks.yaml"
    file.write_text(
        "dualarm: tasks/1\ncell: cell.yaml\nreturn: true\ntasks:\n"
        "  - id: p\n    path: {arm: left, speed: 50 mm/s, slower: allowed, tolerance: 5 mm, "
        "redundancy: virtual_spring_damped, through: [{xyz: [1.0955, 0.35, 0.36], "
        "rpy: [0, 90 deg, 0]}, {xyz: [1.0955, 0.39, 0.36]}]}\n"
    )
    job = load_job(file)
    assert job_bound(job, "quick").value == pytest.approx(0.04 / 0.05, rel=2e-5)


def test_a_path_tells_the_poses_of_the_arms_that_follow_it(tmp_path: Path) -> None:
    """Of both arms, or of one: its first pose and its last one, as the file has them."""
    job = job_of(tmp_path, PATHS.format(x=0.5, z=0.9))
    both, alone = job.sections()
    first, last = kind_of(both).ends(job, both)
    assert sorted(first) == sorted(last) == ["left", "right"]
    np.testing.assert_allclose(first["left"].pose.translation, [0.5, 0.30, 0.9], atol=1e-12)
    np.testing.assert_allclose(last["right"].pose.translation, [0.5, -0.36, 0.9], atol=1e-12)
    first, last = kind_of(alone).ends(job, alone)
    assert list(first) == list(last) == ["right"]
    R = pin.rpy.rpyToMatrix(np.pi, 0.0, np.radians(20.0))
    np.testing.assert_allclose(first["right"].pose.rotation, R, atol=1e-12)
