"""A schedule made by hand: a turntable with two planar three-joint arms, no planner involved.

Every arm is a chain of two equal links L and a wrist, all joints about z. With shoulder φ + θ, elbow -2θ and wrist θ
the tool looks along φ at the distance 2 L cos θ + TCP of the shoulder: a straight line is θ alone, exactly.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, Place, PoseTarget, Stop, Task
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import (
    Event,
    Provenance,
    Schedule,
    ScheduleArm,
    ScheduleRobot,
    Segment,
    Stage,
)
from dualarm_cli.verification import verify
from dualarm_cli.verification.as_done import job_as_done
from dualarm_cli.verification.measuring.line_spans import LineSpan, line_spans
from dualarm_cli.verification.measuring.tool_model import ToolModel

LINK, TCP, SIDE, LINE = 0.4, 0.1, 0.5, 0.05
JOINTS = ("turn", "l1", "l2", "l3", "r1", "r2", "r3")
ARM_JOINTS = {"left": JOINTS[1:4], "right": JOINTS[4:]}
DWELL = Dwell(gripper=0.3, settle=0.06, handshake=0.04)
MOVE, STRAIGHT = 0.8, 0.4
"""Durations of transfers and lines [s]; dwells last DWELL.total."""
BASE = pin.SE3(pin.utils.rotate("z", 0.3), np.array([0.2, -0.1, 0.9]))
# Platform angle, then (φ, distance) of the left and of the right tool at the two stages' targets.
TARGETS = [
    (0.4, {"left": (0.3, 0.75), "right": (-0.2, 0.7)}),
    (-0.3, {"left": (-0.4, 0.65), "right": (0.5, 0.8)}),
]


def _urdf() -> str:
    joint = (
        '<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/>'
        '<origin xyz="{3}"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" velocity="4" effort="0"/></joint><link name="{2}"/>'
    )
    parts = [
        '<robot name="planar"><link name="base"/>',
        joint.format("turn", "base", "top", "0 0 0"),
    ]
    for side, y in (("l", SIDE), ("r", -SIDE)):
        parts.append(joint.format(f"{side}1", "top", f"{side}_upper", f"0 {y} 0"))
        parts.append(joint.format(f"{side}2", f"{side}_upper", f"{side}_fore", f"{LINK} 0 0"))
        parts.append(joint.format(f"{side}3", f"{side}_fore", f"{side}_hand", f"{LINK} 0 0"))
        # The flange's z axis looks along the hand's x axis.
        parts.append(
            f'<link name="{side}_flange"/><joint name="{side}_f" type="fixed">'
            f'<parent link="{side}_hand"/><child link="{side}_flange"/>'
            f'<origin rpy="0 {np.pi / 2!r} 0"/></joint>'
        )
    return "".join(parts) + "</robot>"


def _arm_posture(phi: float, reach: float) -> np.ndarray:
    theta = np.arccos((reach - TCP) / (2 * LINK))
    return np.array([phi + theta, -2 * theta, theta])


def _tool(side: str, turn: float, phi: float, reach: float) -> pin.SE3:
    """Returns the tool in the world by plane trigonometry."""
    y = SIDE if side == "left" else -SIDE
    shoulder = y * np.array([-np.sin(turn), np.cos(turn), 0.0])
    along = np.array([np.cos(turn + phi), np.sin(turn + phi), 0.0])
    across = np.array([-along[1], along[0], 0.0])
    # z of the tool is along the hand, y stays across it, x = y × z points down.
    R = np.column_stack([np.cross(across, along), across, along])
    return BASE * pin.SE3(R, shoulder + reach * along)


def _posture(turn: float, tools: dict[str, tuple[float, float]]) -> np.ndarray:
    return np.concatenate([[turn], _arm_posture(*tools["left"]), _arm_posture(*tools["right"])])


class Film:
    """Strings rest-to-rest moves together, each of four jerks +, -, -, + of equal length."""

    def __init__(self, start: np.ndarray) -> None:
        """Begins at rest."""
        zero = np.zeros_like(start)
        self.knots = [(0.0, start, zero, zero)]

    @property
    def now(self) -> float:
        """The time reached [s]."""
        return self.knots[-1][0]

    def move(self, goal: np.ndarray, duration: float) -> None:
        """Moves all joints in the same shape; a stand-still where the goal is where it is."""
        begin, start = self.now, self.knots[-1][1]
        h = duration / 4
        d = goal - start
        # q = d/12, d/2, 11 d/12 with jerk d / (2 h³): v = d/(4h), d/(2h), d/(4h); a = ±d/(2h²), 0.
        for share, v, a in ((1 / 12, 0.25, 0.5), (0.5, 0.5, 0.0), (11 / 12, 0.25, -0.5)):
            time = begin + (len(self.knots) - 1) % 4 * h + h
            self.knots.append((time, start + share * d, v * d / h, a * d / h**2))
        zero = np.zeros_like(d)
        self.knots.append((begin + duration, goal.copy(), zero, zero))

    def trajectory(self, joints: tuple[str, ...] = JOINTS) -> Trajectory:
        """Returns what was strung together."""
        t, q, v, a = (np.array(column) for column in zip(*self.knots, strict=True))
        return Trajectory(joints, t, q, v, a)


def _limits() -> JointLimits:
    n = len(JOINTS)
    return JointLimits(
        JOINTS,
        np.full(n, -3.0),
        np.full(n, 3.0),
        np.full(n, 20.0),
        np.full(n, 200.0),
        np.full(n, 2000.0),
        ("assumed",) * n,
    )


def _job(start: np.ndarray) -> Job:
    robot = Robot(
        "planar",
        _urdf(),
        ("turn",),
        tuple(
            Arm(arm, joints, f"{arm[0]}_flange", "general") for arm, joints in ARM_JOINTS.items()
        ),
        _limits(),
        {"ready": start},
    )
    tcp = pin.SE3(np.eye(3), np.array([0.0, 0.0, TCP]))
    cell = Cell(robot, BASE, {arm: Tool(tcp) for arm in ARM_JOINTS})
    tasks = []
    for line, arm in enumerate(ARM_JOINTS, start=7):
        stops = tuple(
            Stop(action, PoseTarget(_tool(arm, turn, *tools[arm])), LINE, LINE, DWELL,
                 Place("tasks.yaml", line, 3))
            for action, (turn, tools) in zip(("pick", "place"), TARGETS, strict=True)
        )  # fmt: skip
        tasks.append(Task(f"{arm}-part", arm, stops))
    return Job(cell, tuple(tasks), "ready", True)


def _stage(start: float, end: float, tasks: tuple[str, ...], turn: float) -> Stage:
    return Stage(
        start=start,
        end=end,
        tasks=tasks,
        platform_solver="exact",
        platform_angle=turn,
        platform_time=0.5,
        arm_times={"left": 0.4},
        joint_times={"turn": 0.5},
        bottleneck="turn",
    )


def _schedule(job: Job, start: np.ndarray) -> Schedule:
    film, stages, segments, events = Film(start), [], [], []

    def play(kind: str, goal: np.ndarray, duration: float, action: str) -> None:
        begin = film.now
        film.move(goal, duration)
        for arm in ARM_JOINTS:
            task = f"{arm}-part" if action else ""
            shares = DWELL if kind == "dwell" else None
            segments.append(Segment(arm, kind, task, action, begin, film.now, shares))  # type: ignore[arg-type]

    for action, (turn, tools) in zip(("pick", "place"), TARGETS, strict=True):
        begin = film.now
        above = _posture(turn, {arm: (phi, r - LINE) for arm, (phi, r) in tools.items()})
        there = _posture(turn, tools)
        play("transfer", above, MOVE, action)
        play("approach", there, STRAIGHT, action)
        for arm in ARM_JOINTS:
            pose = _tool(arm, turn, *tools[arm])
            events.append(
                Event(film.now, arm, f"{arm}-part", action, f"{arm}_tcp", pose, DWELL.total)
            )
        play("dwell", there, DWELL.total, action)
        play("retract", above, STRAIGHT, action)
        stages.append(_stage(begin, film.now, ("left-part", "right-part"), turn))
    begin = film.now
    play("return", start, MOVE, "")
    stages.append(_stage(begin, film.now, (), 0.0))
    robot, tcp = job.cell.robot, job.cell.tools["left"].tcp
    return Schedule(
        ScheduleRobot(
            "planar",
            robot.urdf,
            BASE,
            {arm.name: ScheduleArm(arm.flange, tcp, arm.joints) for arm in robot.arms},
            robot.limits,
            robot.platform,
        ),
        JointMotion.of(film.trajectory()),
        tuple(stages),
        tuple(sorted(segments, key=lambda s: (s.arm, s.start))),
        tuple(events),
        Provenance("0", {}, {}, 0),
    )


@pytest.fixture(scope="session")
def clean() -> SimpleNamespace:
    """The job and a schedule for it without any fault."""
    start = _posture(0.0, {"left": (0.0, 0.6), "right": (0.1, 0.6)})
    job = _job(start)
    return SimpleNamespace(job=job, schedule=_schedule(job, start))


CLOCK_TASKS = {
    "fill": ("left", {"pick": (0.3, 0.75), "place": (-0.4, 0.65)}),
    "look": ("left", {"move": (0.1, 0.7)}),
    "fit": ("right", {"pick": (-0.2, 0.7), "place": (0.5, 0.8)}),
    "turn": ("right", {"move": (0.2, 0.6)}),
}
"""Arm and targets, (φ, distance) from its shoulder, of tasks of asynchronous arms; the platform stands."""


def _clock_job(job: Job) -> Job:
    tasks = {}
    for line, (name, (arm, targets)) in enumerate(CLOCK_TASKS.items(), start=7):
        bare = "move" in targets
        stops = tuple(
            Stop(action, PoseTarget(_tool(arm, 0.0, *target)), *((0.0, 0.0, Dwell()) if bare else
                 (LINE, LINE, DWELL)), Place("tasks.yaml", line, 3))
            for action, target in targets.items()
        )  # fmt: skip
        tasks[name] = Task(name, arm, stops)
    return dataclasses.replace(
        job,
        tasks=(
            dataclasses.replace(tasks["turn"], arm="any", not_before=0.5, not_after=1.0),
            dataclasses.replace(tasks["look"]),
            dataclasses.replace(tasks["fit"], after=("fill",)),
            dataclasses.replace(tasks["fill"], arm="any"),
        ),
        mode="free",
        order="optimise",
        sequences=(("fill", "look"),),
    )


class Clock:
    """One arm's work: tasks and waits one after the other."""

    def __init__(self, arm: str, start: np.ndarray) -> None:
        """Begins where the motion starts."""
        self.arm, self.film = arm, Film(start)
        self.stages: list[Stage] = []
        self.segments: list[Segment] = []
        self.events: list[Event] = []

    def _play(self, kind: str, goal: np.ndarray, duration: float, *what: str) -> None:
        begin = self.film.now
        self.film.move(goal, duration)
        shares = DWELL if kind == "dwell" else None
        reason = what[0] if kind == "wait" else ""
        task, action = ("", "") if kind in ("wait", "return") else what
        segment = Segment(self.arm, kind, task, action, begin, self.film.now, shares, reason)  # type: ignore[arg-type]
        self.segments.append(segment)

    def wait(self, duration: float, reason: str) -> None:
        """Stands where it is."""
        self._play("wait", self.film.knots[-1][1], duration, reason)

    def task(self, name: str) -> None:
        """Does a task, each stop in a stage of its own."""
        for action, (phi, reach) in CLOCK_TASKS[name][1].items():
            begin, line = self.film.now, 0.0 if action == "move" else LINE
            above, there = _arm_posture(phi, reach - line), _arm_posture(phi, reach)
            self._play("transfer", above, MOVE, name, action)
            if line:
                self._play("approach", there, STRAIGHT, name, action)
            pose = _tool(self.arm, 0.0, phi, reach)
            dwell = DWELL.total if line else 0.0
            tcp = f"{self.arm}_tcp"
            self.events.append(Event(self.film.now, self.arm, name, action, tcp, pose, dwell))
            if line:
                self._play("dwell", there, DWELL.total, name, action)
                self._play("retract", above, STRAIGHT, name, action)
            self._stage(begin, name)

    def back(self) -> None:
        """Returns to the start."""
        begin = self.film.now
        self._play("return", self.film.knots[0][1], MOVE)
        self._stage(begin)

    def _stage(self, begin: float, *tasks: str) -> None:
        stage = _stage(begin, self.film.now, tasks, 0.0)
        self.stages.append(dataclasses.replace(stage, arm=self.arm))


def _together(job: Job, clocks: list[Clock]) -> Schedule:
    """Returns the schedule of arms by their clocks, the platform still; who is done first waits for the end."""
    end = max(clock.film.now for clock in clocks)
    for clock in clocks:
        if clock.film.now < end:
            clock.wait(end - clock.film.now, "end")
    parts = [clock.film.trajectory(ARM_JOINTS[clock.arm]) for clock in clocks]
    time = np.unique(np.concatenate([part.time for part in parts]))
    # What differs by rounding alone is one knot.
    time = time[np.append(True, np.diff(time) > 1e-12)]
    columns = [
        np.hstack(rates) for rates in zip(*(part.clamped(time) for part in parts), strict=True)
    ]
    platform = np.zeros((len(time), 1))
    trajectory = Trajectory(JOINTS, time, *(np.hstack([platform, rates]) for rates in columns))
    return Schedule(
        ScheduleRobot.of_job(job),
        JointMotion.of(trajectory),
        tuple(sorted((s for c in clocks for s in c.stages), key=lambda stage: stage.start)),
        tuple(segment for clock in clocks for segment in clock.segments),
        tuple(sorted((e for c in clocks for e in c.events), key=lambda event: event.time)),
        Provenance("0", {}, {}, 0),
    )


@pytest.fixture(scope="session")
def by_clocks(clean: SimpleNamespace) -> SimpleNamespace:
    """A job for asynchronous arms, `play` for schedules of it, and one without any fault.

    Left: fill picks until 2.0 s and places until 4.0 s, look until 4.8 s, back at 5.6 s. Right: turn until 0.8 s,
    waits, is on its way to fit from 3.2 s, so that its approach begins at 4.0 s; picks until 5.2 s, places until 7.2 s,
    is back at 8 s.
    """
    job = _clock_job(clean.job)
    start = job.cell.robot.postures["ready"]

    def play(**rows: list[str | tuple[float, str]]) -> Schedule:
        clocks = []
        for arm, steps in rows.items():
            at = 1 if arm == "left" else 4
            clock = Clock(arm, start[at : at + 3])
            for step in steps:
                if isinstance(step, tuple):
                    clock.wait(*step)
                else:
                    clock.task(step)
            clock.back()
            clocks.append(clock)
        return _together(job, clocks)

    schedule = play(left=["fill", "look"], right=["turn", (2.4, "after"), "fit"])
    return SimpleNamespace(job=job, schedule=schedule, play=play)


@pytest.fixture(scope="session")
def failing() -> Callable[..., dict[str, str]]:
    """What fails in a schedule: the details of the failed checks, by name."""

    def run(schedule: Schedule, job: Job | None = None) -> dict[str, str]:
        return {check.name: check.detail for check in verify(schedule, job).failures}

    return run


@pytest.fixture(scope="session")
def measured_lines() -> Callable[..., tuple[LineSpan, ...]]:
    """The spans of the lines of a schedule for a job as it was done."""

    def run(schedule: Schedule, job: Job) -> tuple[LineSpan, ...]:
        return line_spans(schedule, job_as_done(schedule, job), ToolModel(schedule))

    return run


@pytest.fixture(scope="session")
def moved() -> Callable[..., Schedule]:
    """A schedule with other knots: keyword arguments replace arrays of its trajectory."""

    def run(schedule: Schedule, **arrays: np.ndarray) -> Schedule:
        trajectory = dataclasses.replace(schedule.trajectory, **arrays)
        return dataclasses.replace(schedule, motion=JointMotion.of(trajectory))

    return run


@pytest.fixture(scope="session")
def bumped(moved: Callable[..., Schedule]) -> Callable[..., Schedule]:
    """A schedule in which joints swing out and back over four equal intervals from a knot.

    The swing is a uniform cubic B-spline, so that position, velocity and acceleration go on agreeing.
    """

    def run(schedule: Schedule, knot: int, swing: dict[str, float]) -> Schedule:
        trajectory = schedule.trajectory
        h = trajectory.time[knot + 1] - trajectory.time[knot]
        assert np.allclose(np.diff(trajectory.time[knot : knot + 5]), h)
        q, v, a = (
            np.array(rates)
            for rates in (trajectory.position, trajectory.velocity, trajectory.acceleration)
        )
        rows = slice(knot + 1, knot + 4)
        for joint, top in swing.items():
            column = trajectory.joints.index(joint)
            # The spline of height 2/3 has 1/6, 2/3, 1/6; slopes 1/2, 0, -1/2; curvatures 1, -2, 1.
            q[rows, column] += 1.5 * top * np.array([1, 4, 1]) / 6
            v[rows, column] += 1.5 * top * np.array([1, 0, -1]) / (2 * h)
            a[rows, column] += 1.5 * top * np.array([1, -2, 1]) / h**2
        return moved(schedule, position=q, velocity=v, acceleration=a)

    return run


@pytest.fixture(scope="session")
def refined(moved: Callable[..., Schedule]) -> Callable[..., Schedule]:
    """The same motion with further knots."""

    def run(schedule: Schedule, times: list[float]) -> Schedule:
        trajectory = schedule.trajectory
        fresh = np.setdiff1d(times, trajectory.time)
        order = np.argsort(np.concatenate([trajectory.time, fresh]), kind="stable")
        merged = [
            np.concatenate([old, new])[order]
            for old, new in zip(
                (
                    trajectory.time,
                    trajectory.position,
                    trajectory.velocity,
                    trajectory.acceleration,
                ),
                (fresh, *trajectory.at(fresh)),
                strict=True,
            )
        ]
        names = ("time", "position", "velocity", "acceleration")
        return moved(schedule, **dict(zip(names, merged, strict=True)))

    return run


@pytest.fixture(scope="session")
def limited() -> Callable[..., Job]:
    """A job with one limit of one joint set to a value."""

    def run(job: Job, rate: str, joint: str, value: float) -> Job:
        robot = job.cell.robot
        values = np.array(getattr(robot.limits, rate))
        values[robot.joints.index(joint)] = value
        limits = dataclasses.replace(robot.limits, **{rate: values})
        cell = dataclasses.replace(job.cell, robot=dataclasses.replace(robot, limits=limits))
        return dataclasses.replace(job, cell=cell)

    return run
