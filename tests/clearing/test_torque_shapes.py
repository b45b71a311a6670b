"""Stages whose overloaded transfer has another shape, on two pendulums about vertical axes on a turntable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.clearing.torque_shapes import reshaped_within_torques
from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.motion.joint_motion import merge
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import Event, Segment, Stage
from dualarm_cli.motion.builder import Motion
from dualarm_cli.timing.composition import concatenate, hold

MASS, LENGTH, SHOULDER = 2.0, 0.5, 0.3
PEAK = 30.0
"""Acceleration of the fastest swing [rad/s²]."""
EFFORT = 0.8 * MASS * LENGTH**2 * PEAK
JOINTS = ("turn", "left", "right")
LINK = (
    '<link name="{}"><inertial><mass value="1e-9"/><inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/>'
    "</inertial></link>"
)
JOINT = (
    '<joint name="{}" type="revolute"><origin xyz="0 {} 0"/><parent link="{}"/><child link="{}"/><axis xyz="0 0 1"/>'
    '<limit lower="-3" upper="3" velocity="9" effort="{}"/></joint>'
)


def cell() -> Cell:
    """A turntable of 1 kg m² with arms at both sides; tools of 2 kg, gravity along all axes."""
    turntable = LINK.replace('izz="0"', 'izz="1"').replace("1e-9", "1").format("table")
    links = [LINK.format(name) for name in ("base", "left_arm", "right_arm")]
    joints = [
        JOINT.format("turn", 0, "base", "table", 1000),
        JOINT.format("left", SHOULDER, "table", "left_arm", EFFORT),
        JOINT.format("right", -SHOULDER, "table", "right_arm", EFFORT),
    ]
    urdf = f'<robot name="arms">{"".join([turntable, *links, *joints])}</robot>'
    ones = np.ones(3)
    limits = JointLimits(
        JOINTS, -3 * ones, 3 * ones, 9 * ones, 90 * ones, 900 * ones, ("assumed",) * 3
    )
    arms = tuple(Arm(name, (name,), f"{name}_arm", "general") for name in JOINTS[1:])
    tcp = pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0]))
    tool = Tool(tcp, pin.Inertia(MASS, tcp.translation, np.zeros((3, 3))))
    tools = {arm.name: tool for arm in arms}
    return Cell(Robot("arms", urdf, ("turn",), arms, limits), pin.SE3.Identity(), tools)


def swing(joint: str, start: float, duration: float, peak: float) -> Trajectory:
    """A motion from rest to rest with two triangles of acceleration."""
    a = np.array([0, 1, 0, -1, 0]) * peak
    h, q, v = duration / 4, np.full(5, start), np.zeros(5)
    for k in range(4):
        v[k + 1] = v[k] + h * (a[k] + a[k + 1]) / 2
        q[k + 1] = q[k] + h * v[k] + h * h * (2 * a[k] + a[k + 1]) / 6
    v[-1] = 0.0
    return Trajectory((joint,), np.arange(5) * h, q[:, None], v[:, None], a[:, None])


def track(joint: str, *parts: tuple[float, float]) -> Trajectory:
    """Swings and rests, each a duration and a peak, from 0."""
    pieces: list[Trajectory] = []
    for duration, peak in parts:
        here = float(pieces[-1].position[-1, 0]) if pieces else 0.0
        still = hold((joint,), np.array([here]), duration)
        pieces.append(swing(joint, here, duration, peak) if peak else still)
    return concatenate(pieces)


def motion_of(
    tracks: Sequence[Trajectory],
    segments: Sequence[Segment],
    stages: Sequence[tuple[float, str]],
    *events: Event,
) -> Motion:
    """A motion with stages, each its end and a task."""
    edges = [0.0, *(end for end, _ in stages)]
    made = [
        Stage(start, end, (task,) if task else (), "", None, 0.0, {}, {}, "")
        for start, (end, task) in zip(edges, stages, strict=False)
    ]
    return Motion(merge(tracks, JOINTS), tuple(made), tuple(segments), events)


class PlainJob(SimpleNamespace):
    """A job as far as shapes look at it; equal to itself only, as jobs are."""

    __hash__ = object.__hash__


def problem(**keys: object) -> SimpleNamespace:
    """A job of tasks a and b that limits torques, as far as shapes look at it."""
    plain = {"handover": None, "tool": "", "is_change": False, "part": ""}
    tasks = [
        SimpleNamespace(id=name, arm=arm, **{**plain, "handover": keys.get("handover")})
        for name, arm in (("a", "left"), ("a" if keys.get("handover") else "b", "right"))
    ]
    whole = cell()
    limits, cap = whole.robot.limits, keys.get("cap")
    job = PlainJob(cell=whole, tasks=tasks, limits=limits, tool_speed=cap, slows=False)

    def tips(arms: Sequence[str], q: np.ndarray) -> np.ndarray:
        angles = [q[:, 0] + q[:, JOINTS.index(arm)] for arm in arms]
        return np.array([LENGTH * np.stack([np.cos(x), np.sin(x), 0 * x], axis=1) for x in angles])

    model = SimpleNamespace(arms=JOINTS[1:], tool_positions=tips)
    return SimpleNamespace(job=job, limits_torques=True, model=model)


def assert_within_all(motion: Motion) -> None:
    """Efforts by Newton and Euler in the plane, limits by sampling, positions by integration."""
    time = np.linspace(0.0, motion.trajectory.duration, 4001)
    q, v, a = motion.trajectory.clamped(time)
    turn_v, turn_a = v[:, 0], a[:, 0]
    for arm, side in (("left", SHOULDER), ("right", -SHOULDER)):
        k = JOINTS.index(arm)
        # The shoulder's acceleration in the table's frame, then that of the tool across its arm.
        sx, sy = -turn_a * side, -(turn_v**2) * side
        across = -np.sin(q[:, k]) * sx + np.cos(q[:, k]) * sy + LENGTH * (turn_a + a[:, k])
        assert np.abs(MASS * LENGTH * across).max() <= EFFORT
    limits = cell().robot.limits
    for values, most in ((q, limits.upper), (v, limits.velocity), (a, limits.acceleration)):
        assert (np.abs(values) <= most * (1 + 1e-9)).all()
    assert (np.abs(motion.trajectory.jerk) <= limits.jerk * (1 + 1e-6)).all()
    moved = q[0] + np.cumsum(
        np.vstack([np.zeros(3), (v[1:] + v[:-1]) / 2 * np.diff(time)[:, None]]), axis=0
    )
    np.testing.assert_allclose(moved, q, atol=1e-4)


SEGMENTS = (
    Segment("left", "transfer", "a", "place", 0.0, 0.4),
    Segment("left", "dwell", "a", "place", 0.4, 0.5),
    Segment("right", "transfer", "b", "place", 0.0, 0.3),
    Segment("right", "wait", "b", "place", 0.3, 0.4, reason="partner"),
    Segment("right", "dwell", "b", "place", 0.4, 0.5),
)


def placed(arm: str, task: str, time: float, **keys: object) -> Event:
    """A placing event with a dwell of 0.1 s."""
    return replace(Event(time, arm, task, "place", "", pin.SE3.Identity(), 0.1), **keys)


@pytest.mark.parametrize("turns", [False, True])
def test_both_arms_end_a_stage_together(turns: bool) -> None:
    """The left arm's swing is beyond its effort; the right one waits longer, the table turns as before."""
    table = track("turn", (0.5, 4.0 if turns else 0.0))
    left, right = track("left", (0.4, PEAK), (0.1, 0.0)), track("right", (0.3, 5.0), (0.2, 0.0))
    events = placed("left", "a", 0.4), placed("right", "b", 0.4)
    motion = motion_of((table, left, right), SEGMENTS, [(0.5, "a")], events[0])
    motion = replace(motion, stages=(replace(motion.stages[0], tasks=("a", "b")),), events=events)
    with pytest.raises(AssertionError):
        assert_within_all(motion)
    shaped, [note] = reshaped_within_torques(problem(), motion, None)
    assert "1 transfer has another shape" in note
    assert_within_all(shaped)
    longer = shaped.trajectory.duration - 0.5
    assert 0.0 < longer < 0.1
    for old, new in ((motion.trajectory, shaped.trajectory),):
        np.testing.assert_allclose(new.position[-1], old.position[-1], atol=1e-9)
        early = np.linspace(0.0, 0.3, 50)
        np.testing.assert_allclose(
            new.clamped(early)[0][:, [0, 2]], old.clamped(early)[0][:, [0, 2]], atol=1e-9
        )
    assert {e.arm: e.time for e in shaped.events}["left"] == pytest.approx(0.4 + longer)
    assert shaped.stages[0].end == pytest.approx(0.5 + longer)


def test_an_arm_alone_comes_later_from_stage_to_stage() -> None:
    """Asynchronous arms are shaped one by one: the second stage begins as much later as the first takes longer."""
    left = track("left", (0.4, PEAK), (0.1, 0.0), (0.4, -4.0))
    still = track("turn", (0.9, 0.0)), track("right", (0.9, 0.0))
    segments = *SEGMENTS[:2], Segment("left", "return", "", "", 0.5, 0.9)
    motion = motion_of((*still, left), segments, [(0.5, "a"), (0.9, "")], placed("left", "a", 0.4))
    shaped, _ = reshaped_within_torques(problem(), motion, None)
    assert_within_all(shaped)
    longer = shaped.trajectory.duration - 0.9
    assert 0.0 < longer < 0.1
    assert (shaped.stages[1].start, shaped.stages[1].end) == pytest.approx(
        (0.5 + longer, 0.9 + longer)
    )
    [back] = [s for s in shaped.segments if s.kind == "return"]
    assert back.end - back.start == pytest.approx(0.4)


def test_arms_that_hand_over_meet_later() -> None:
    """The right arm waits before the meeting, not after it: both events are at one time."""
    tracks = (
        track("turn", (0.7, 0.0)),
        track("left", (0.4, PEAK), (0.3, 0.0)),
        track("right", (0.3, 5.0), (0.4, 0.0)),
    )
    segments = (
        *(replace(s, task="a") for s in SEGMENTS[:4]),
        replace(SEGMENTS[4], task="a"),
        Segment("left", "wait", "a", "", 0.5, 0.7, reason="partner"),
        Segment("right", "wait", "a", "", 0.5, 0.7, reason="partner"),
    )
    events = placed("left", "a", 0.4, action="give"), placed("right", "a", 0.4, action="take")
    motion = replace(motion_of(tracks, segments, [(0.7, "a")]), events=events)
    shaped, _ = reshaped_within_torques(problem(handover=object()), motion, None)
    assert_within_all(shaped)
    first, second = (event.time for event in shaped.events)
    assert first == pytest.approx(second)
    assert 0.4 < first < 0.5


@pytest.mark.parametrize("wait", [0.2, 0.0])
def test_a_belt_is_met_when_it_was(wait: float) -> None:
    """The common wait becomes shorter; without one the swing keeps its shape, unless belts may be met late."""
    left = track("left", (0.4, PEAK), (0.1 + wait, 0.0), (0.3, 2.0))
    still = track("turn", (0.8 + wait, 0.0)), track("right", (0.8 + wait, 0.0))
    begin, end = 0.5 + wait, 0.8 + wait
    waits = [Segment(arm, "wait", "b", "pick", 0.5, begin, reason="conveyor") for arm in JOINTS[1:]]
    segments = (
        *SEGMENTS[:2],
        *(waits if wait else ()),
        Segment("left", "transfer", "b", "pick", begin, end),
        Segment("right", "wait", "b", "pick", begin, end, reason="partner"),
    )
    met = placed("left", "b", end, velocity=(0.1, 0.0, 0.0), dwell=0.0)
    first = placed("left", "a", 0.4)
    motion = motion_of((*still, left), segments, [(0.5, "a"), (end, "b")], first, met)
    shaped, notes = reshaped_within_torques(problem(), motion, None)
    if not wait:
        assert (shaped, notes) == (motion, [])
        shaped, _ = reshaped_within_torques(problem(), motion, None, late=True)
        assert shaped.events[-1].time > end
    else:
        assert shaped.events[-1].time == pytest.approx(end)
        assert shaped.stages[1].start > 0.5
    assert_within_all(shaped)


@pytest.mark.parametrize(("cap", "shaped"), [(1.6, True), (1.0, False)])
def test_a_shape_that_is_too_fast_for_the_tool_is_not_taken(cap: float, shaped: bool) -> None:
    """The swing of 0.6 rad in 0.4 s moves the tool at up to 1.5 m/s, its shapes at nearly as much."""
    left = track("left", (0.4, PEAK), (0.1, 0.0))
    still = track("turn", (0.5, 0.0)), track("right", (0.5, 0.0))
    motion = motion_of((*still, left), SEGMENTS[:2], [(0.5, "a")], placed("left", "a", 0.4))
    changed, notes = reshaped_within_torques(problem(cap=cap), motion, None)
    assert (changed is not motion) == shaped == bool(notes)
    if shaped:
        assert_within_all(changed)
        time = np.linspace(0.0, changed.trajectory.duration, 2001)
        assert np.abs(LENGTH * changed.trajectory.clamped(time)[1][:, 1]).max() <= cap
