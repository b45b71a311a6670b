"""Motions within torques: a pendulum by hand, and what slowing leaves as it is."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.kinematics.dynamics import Dynamics, limits_torques
from dualarm_cli.model.cell import Cell, Held
from dualarm_cli.model.job import ANY
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.place import NOWHERE
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import Event, Segment, Stage
from dualarm_cli.motion import torque_limits
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.payloads import PayloadSpan
from dualarm_cli.motion.torque_limits import SETTINGS, within_torques
from tests.pendulum import GRAVITY, LENGTH, MASS, ONE, PART, pendulum

ACCELERATION = 40.0
LYING = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.zeros(3))
"""Base with which the joint's axis is vertical, so that gravity needs no torque."""
H = 0.1


def job_of(
    effort: float, base: pin.SE3 = LYING, rule: str = "limited", **torques: float
) -> SimpleNamespace:
    """A bar without mass about y, with a tool of 2 kg at its end."""
    stated = {name: value * ONE for name, value in torques.items()}
    cell = replace(pendulum(effort, base, **stated), torque=rule)
    return SimpleNamespace(cell=cell, tasks=())


def task_of(name: str, **keys: object) -> SimpleNamespace:
    """A task as far as torques look at it."""
    plain = {"arm": "left", "tool": "", "is_change": False, "part": "", "path": None, "seam": None}
    stop = SimpleNamespace(action="place", place=NOWHERE)
    return SimpleNamespace(**{"id": name, "stops": (stop,), "place": NOWHERE, **plain, **keys})


def swing() -> Motion:
    """Forth with triangles of acceleration up to 40 rad/s², a rest of 0.1 s, and a fifth of it back."""
    a = np.array([0, 1, 0, -1, 0, 0, -0.2, 0, 0.2, 0]) * ACCELERATION
    time = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8, 9]) * H
    jerk = np.diff(a) / H
    q, v = np.zeros(10), np.zeros(10)
    for k in range(9):
        v[k + 1] = v[k] + H * (a[k] + a[k + 1]) / 2
        q[k + 1] = q[k] + H * v[k] + H * H * (a[k] / 2 + jerk[k] * H / 6)
    v[[4, 5, 9]] = 0.0
    trajectory = Trajectory(("swing",), time, q[:, None], v[:, None], a[:, None])
    segments = (
        Segment("left", "transfer", "a", "place", 0.0, 0.4),
        Segment("left", "dwell", "a", "place", 0.4, 0.5),
        Segment("left", "return", "", "", 0.5, 0.9),
    )
    event = Event(0.4, "left", "a", "place", "left_tcp", pin.SE3.Identity(), 0.1)
    return Motion(trajectory, (), segments, (event,))


def test_a_span_is_slowed_as_far_as_its_torque_requires() -> None:
    """Of m L² a at the peak to a quarter: twice the time of the first swing, the other one as it was."""
    peak = MASS * LENGTH**2 * ACCELERATION
    motion, notes = within_torques(job_of(peak / 4.0 / (1.0 - SETTINGS.reserve)), swing())
    np.testing.assert_allclose(
        motion.trajectory.time, np.array([0, 2, 4, 6, 8, 9, 10, 11, 12, 13]) * H
    )
    np.testing.assert_array_equal(motion.trajectory.position, swing().trajectory.position)
    assert np.abs(motion.trajectory.acceleration).max() == pytest.approx(ACCELERATION / 4.0)
    assert [(s.start, s.end) for s in motion.segments] == [
        (0.0, pytest.approx(0.8)), (pytest.approx(0.8), pytest.approx(0.9)), (pytest.approx(0.9), pytest.approx(1.3)),
    ]  # fmt: skip
    assert motion.events[0].time == pytest.approx(0.8)
    [note] = notes
    assert note.startswith(
        "torque: 1 motion between rests is slowed, by up to 100% for swing, together by 0.400 s"
    )


@pytest.mark.parametrize("arm", ["left", ANY])
def test_a_part_counts_whichever_arm_its_task_names(arm: str) -> None:
    """(M + 3 kg) L² a to a quarter: twice the time of the first swing, also where any arm may pick."""
    peak = (MASS + PART) * LENGTH**2 * ACCELERATION
    job = job_of(peak / 4.0 / (1.0 - SETTINGS.reserve))
    job.tasks = (task_of("a", arm=arm, part="box"),)
    pick = Event(0.0, "left", "a", "pick", "left_tcp", pin.SE3.Identity(), 0.0)
    motion, _ = within_torques(job, replace(swing(), events=(pick,)))
    assert motion.trajectory.time[4] == pytest.approx(8 * H)


def test_gravity_is_not_slowed_away() -> None:
    """Upright about y, from horizontal: m g L stays, m L² a falls by the square of the factor."""
    effort = 1.5 * MASS * GRAVITY * LENGTH / (1.0 - SETTINGS.reserve)
    motion, _ = within_torques(job_of(effort, pin.SE3.Identity()), swing())
    trajectory = motion.trajectory
    q, a = trajectory.position[:, 0], trajectory.acceleration[:, 0]
    torque = MASS * LENGTH**2 * a - MASS * GRAVITY * LENGTH * np.cos(q)
    assert np.abs(torque).max() <= effort
    assert np.abs(torque).max() == pytest.approx((1.0 - SETTINGS.reserve) * effort, rel=1e-3)


def test_the_reserve_is_kept_at_rest() -> None:
    """M g L = 9.81 N m is 99.8 % of 9.83 N m."""
    with pytest.raises(InfeasibleError, match=r"swing needs 9\.81 N m to hold still"):
        within_torques(job_of(9.83, pin.SE3.Identity()), swing())


def test_a_joint_that_cannot_hold_still_is_refused() -> None:
    """At 0 it needs m g L = 9.81 N m; the refusal has the torque and the share."""
    with pytest.raises(
        InfeasibleError, match=r"swing needs 9\.81 N m to hold still .*, 123% of its"
    ):
        within_torques(job_of(8.0, pin.SE3.Identity()), swing())


def test_the_tasks_whose_load_cannot_be_held_are_named() -> None:
    """The tool alone takes 9.81 N m, with a part of 3 kg 24.5 N m: the first of two parts is put down in time."""
    job, motion = job_of(15.0, pin.SE3.Identity()), swing()
    assert MASS * GRAVITY * LENGTH < 15.0 < (MASS + PART) * GRAVITY * LENGTH
    tasks = [task_of(name, part="box") for name in ("a", "b")]
    times = {("a", "pick"): 0.0, ("a", "place"): 0.05, ("b", "pick"): 0.45}
    events = [
        replace(motion.events[0], time=t, task=task, action=action, dwell=0.0)
        for (task, action), t in times.items()
    ]
    with pytest.raises(BlockedError) as refused:
        within_torques(
            SimpleNamespace(cell=job.cell, tasks=tasks), replace(motion, events=tuple(events))
        )
    assert refused.value.unheld == (("left", "a"), ("left", "b"))
    assert refused.value.refusals[0].data["loads"] == ["left box"]
    alone = replace(motion, events=tuple(events[2:]))
    with pytest.raises(BlockedError) as refused:
        within_torques(SimpleNamespace(cell=job.cell, tasks=tasks), alone)
    assert refused.value.unheld == (("left", "b"),)


def test_a_changed_tool_is_no_reason_against_the_task_that_took_it() -> None:
    """Another arm would take the same tool; the part in it may go to another arm."""
    held = [
        PayloadSpan("left", 0.0, 1.0, Held("drill"), "fetch"),
        PayloadSpan("left", 0.0, 1.0, Held("drill", "box"), "a"),
    ]
    error = torque_limits._cannot_hold(job_of(8.0), 0.0, 0, 9.81, held)
    assert error.unheld == (("left", "a"),)
    assert torque_limits._cannot_hold(job_of(8.0), 0.0, 0, 9.81, held[:1]).unheld == ()


def test_a_motion_within_its_torques_is_the_same_object() -> None:
    """Nothing is rebuilt."""
    motion = swing()
    assert within_torques(job_of(100.0), motion) == (motion, [])


@pytest.mark.parametrize(
    ("job", "limited"),
    [(job_of(100.0), True), (job_of(100.0, rule="checked"), False), (job_of(0.0), False)],
)
def test_torques_are_limited_by_rule_and_data(job: SimpleNamespace, limited: bool) -> None:
    """With an effort, unless the cell file says otherwise."""
    assert limits_torques(job.cell) == limited


def test_a_belt_that_would_be_met_too_late_is_a_refusal() -> None:
    """It is met at 0.4 s, and the first swing takes twice its time; in estimates of delays it is met then."""
    motion = swing()
    met = replace(motion.events[0], velocity=(0.1, 0.0, 0.0), dwell=0.0)
    weak = job_of(MASS * LENGTH**2 * ACCELERATION / 4.0 / (1.0 - SETTINGS.reserve))
    weak.tasks, motion = (task_of("a"),), replace(motion, events=(met,))
    with pytest.raises(InfeasibleError, match=r"would be met 0\.400 s late"):
        within_torques(weak, motion)
    slowed, _ = within_torques(weak, motion, late=True)
    assert slowed.events[0].time == pytest.approx(0.8, abs=1e-12)


PEAK = MASS * LENGTH**2 * ACCELERATION


def test_a_part_on_a_belt_that_is_followed_beyond_an_effort_is_a_refusal() -> None:
    """From 0.1 to 0.3 s the tool follows it: m L² 40 rad/s² at 0.1 s of an effort of a half."""
    met = replace(swing().events[0], time=0.1, velocity=(0.1, 0.0, 0.0), dwell=0.2)
    weak = job_of(PEAK / 2.0)
    weak.tasks = (task_of("a"),)
    with pytest.raises(InfeasibleError) as caught:
        within_torques(weak, replace(swing(), events=(met,)))
    [refusal] = caught.value.refusals
    assert (refusal.measured, refusal.allowed) == pytest.approx((PEAK, PEAK / 2.0))
    assert "swing needs 20 N m at 0.10 s, 200% of its effort, while the tool follows" in str(
        refusal
    )


@pytest.mark.parametrize(
    ("kind", "slower"), [("path", True), ("path", False), ("seam", True), ("seam", False)]
)
def test_paths_and_seams_are_slowed_only_as_the_file_allows(kind: str, slower: bool) -> None:
    """The first swing follows it: a quarter of the torque takes twice the time; the way back is as fast as before."""
    motion = replace(
        swing(), segments=(Segment("left", kind, "a", kind, 0.0, 0.4), *swing().segments[1:])
    )
    weak = job_of(PEAK / 4.0 / (1.0 - SETTINGS.reserve))
    work = SimpleNamespace(slower=slower, place=NOWHERE, entry_duration=None)
    weak.tasks = (task_of("a", **{kind: work}),)
    if not slower:
        with pytest.raises(
            InfeasibleError, match=r"399% of its effort.*or give at most 50% of the speed"
        ):
            within_torques(weak, motion)
        return
    slowed, _ = within_torques(weak, motion)
    expected = np.array([0, 2, 4, 6, 8, 9, 10, 11, 12, 13]) * H
    np.testing.assert_allclose(slowed.trajectory.time, expected)
    assert slowed.segments[0].end == pytest.approx(0.8)


def test_transfers_beside_a_path_are_slowed() -> None:
    """The way back follows a path at its speed, which is within the effort; the first swing is not."""
    way = Segment("left", "path", "a", "path", 0.5, 0.9)
    motion = replace(swing(), segments=(*swing().segments[:2], way))
    weak = job_of(PEAK / 4.0 / (1.0 - SETTINGS.reserve))
    weak.tasks = (task_of("a", path=SimpleNamespace(slower=False, place=NOWHERE)),)
    slowed, _ = within_torques(weak, motion)
    assert slowed.trajectory.time[4] == pytest.approx(0.8)
    assert slowed.segments[-1].end - slowed.segments[-1].start == pytest.approx(0.4)


def test_an_entry_of_given_duration_is_not_slowed() -> None:
    """The swing leads to a seam within 0.5 s, with its dwell: beyond the effort there is no plan."""
    seam = Segment("left", "seam", "a", "seam_end", 0.5, 0.9)
    stage = Stage(0.0, 0.5, ("a",), "", None, 0.0, {}, {}, "")
    motion = replace(swing(), segments=(*swing().segments[:2], seam), stages=(stage,))
    weak = job_of(PEAK / 4.0 / (1.0 - SETTINGS.reserve))
    work = SimpleNamespace(slower=True, place=NOWHERE, entry_duration=0.5)
    weak.tasks = (task_of("a", seam=work),)
    with pytest.raises(InfeasibleError, match="before the seam; give its entry a longer"):
        within_torques(weak, motion)


def test_a_wait_for_a_belt_is_shorter_by_what_is_slowed_before_it() -> None:
    """Forth in 0.8 s instead of 0.4 s, and 0.5 s of wait instead of 0.9 s: the belt is met at 1.3 s as before."""
    motion, wait = swing(), 0.9
    old = motion.trajectory
    time = np.where(np.arange(10) >= 5, old.time + wait - H, old.time)
    trajectory = replace(old, time=time)
    segments = (
        Segment("left", "transfer", "a", "place", 0.0, 0.4),
        Segment("left", "wait", "b", "pick", 0.4, 1.3, reason="conveyor"),
        Segment("left", "transfer", "b", "pick", 1.3, 1.7),
    )
    met = replace(motion.events[0], time=1.7, velocity=(0.1, 0.0, 0.0), dwell=0.0)
    weak = job_of(MASS * LENGTH**2 * ACCELERATION / 4.0 / (1.0 - SETTINGS.reserve))
    weak.tasks = (task_of("a"),)
    slowed, _ = within_torques(
        weak, replace(motion, trajectory=trajectory, segments=segments, events=(met,))
    )
    assert [(round(s.start, 9), round(s.end, 9)) for s in slowed.segments] == [
        (0, 0.8),
        (0.8, 1.3),
        (1.3, 1.7),
    ]
    assert slowed.events[0].time == pytest.approx(1.7, abs=1e-12)
    assert slowed.trajectory.time[4] == pytest.approx(0.8)


@pytest.mark.parametrize("share", [0.9, 0.5])
def test_motion_is_slowed_until_the_rated_effort_is_kept(share: float) -> None:
    """Of horizontal motion torques fall by s² and rests keep their length: RMS by dense sampling."""
    peak = MASS * LENGTH**2 * ACCELERATION

    def effective(motion: Motion) -> float:
        t = np.linspace(0.0, motion.trajectory.duration, 200_001)
        torque = MASS * LENGTH**2 * motion.trajectory.at(t)[2]
        return float(np.sqrt(np.mean(np.square(torque))))

    rated = share * effective(swing())
    motion, notes = within_torques(job_of(2 * peak, rated=rated), swing())
    assert effective(motion) <= rated
    assert effective(motion) == pytest.approx(rated, rel=0.01)
    assert motion.trajectory.time[5] - motion.trajectory.time[4] == pytest.approx(H)
    assert "for the rated effort of swing" in notes[1]


def test_a_rated_effort_that_holding_still_exceeds_is_refused() -> None:
    """M g L cos q at rest is beyond 5 N m however slow the motion is."""
    with pytest.raises(InfeasibleError, match=r"swing needs .* on average \(RMS\) over the cycle"):
        within_torques(job_of(100.0, pin.SE3.Identity(), rated=5.0), swing())


def test_a_dwell_keeps_its_length_and_a_wait_follows() -> None:
    """A dwell of an arm in a span in which another joint moves."""
    motion = swing()
    within = replace(
        motion,
        segments=(
            Segment("left", "dwell", "a", "place", 0.0, 0.2),
            Segment("left", "wait", "b", "pick", 0.2, 0.3, reason="partner"),
            Segment("left", "transfer", "b", "pick", 0.3, 0.9),
        ),
    )
    peak = MASS * LENGTH**2 * ACCELERATION
    slowed, _ = within_torques(job_of(peak / 4.0 / (1.0 - SETTINGS.reserve)), within)
    spans = [(s.kind, round(s.start, 9), round(s.end, 9)) for s in slowed.segments]
    assert spans == [("dwell", 0.0, 0.2), ("wait", 0.2, 0.6), ("transfer", 0.6, 1.3)]


def test_viscous_friction_is_slowed_away() -> None:
    """At 4 rad/s it needs 40 N m of 30; slower it needs less, and no joint has to hold anything."""
    effort = 30.0
    motion, _ = within_torques(job_of(effort, viscous=10.0), swing())
    v, a = motion.trajectory.at(np.linspace(0.0, motion.trajectory.duration, 2001))[1:]
    torque = np.abs(MASS * LENGTH**2 * a + 10.0 * v)
    assert torque.max() <= effort
    assert torque.max() == pytest.approx(effort, rel=0.02)


def test_viscous_friction_that_brakes_alone_is_slowed_away() -> None:
    """Where the joint brakes by 20 N m at 2 rad/s, 30 N m/(rad/s) of friction need 60 - 20 of 35 N m."""
    effort = 35.0
    motion, _ = within_torques(job_of(effort, viscous=30.0), swing())
    v, a = motion.trajectory.at(np.linspace(0.0, motion.trajectory.duration, 2001))[1:]
    torque = np.abs(MASS * LENGTH**2 * a + 30.0 * v)
    assert effort * 0.9 <= torque.max() <= effort


def test_coulomb_friction_counts_where_a_joint_holds_still() -> None:
    """M g L = 9.81 N m and 1 N m of friction are 108 % of 10 N m."""
    job = job_of(10.0, pin.SE3.Identity(), coulomb=1.0)
    with pytest.raises(InfeasibleError, match=r"swing needs 10\.81 N m .*, 108% of its"):
        within_torques(job, swing())


def with_jumps() -> Motion:
    """Forth by a step of acceleration up and one down, a rest of 0.1 s, and back, with double knots."""
    time = np.array([0, 1, 1, 2, 2, 3, 3, 4, 4, 5]) * H
    a = np.array([1, 1, -1, -1, 0, 0, -0.2, -0.2, 0.2, 0.2]) * ACCELERATION
    q, v = np.zeros(10), np.zeros(10)
    for k, h in enumerate(np.diff(time)):
        v[k + 1], q[k + 1] = v[k] + h * a[k], q[k] + h * v[k] + h * h * a[k] / 2
    v[[3, 4, 5, 9]] = 0.0
    trajectory = Trajectory(("swing",), time, q[:, None], v[:, None], a[:, None])
    dwell = Segment("left", "dwell", "a", "place", 0.2, 0.3)
    return replace(swing(), trajectory=trajectory, segments=(dwell,), events=())


@pytest.mark.parametrize(
    ("base", "effort"), [(LYING, 5.0), (pin.SE3.Identity(), 11.0), (pin.SE3.Identity(), 16.0)]
)
def test_a_jump_of_acceleration_belongs_to_the_motion_before_a_rest(
    base: pin.SE3, effort: float
) -> None:
    """The rest keeps its length, and between all knots the motion is that of its accelerations."""
    motion, _ = within_torques(job_of(effort, base), with_jumps())
    new = motion.trajectory
    h = np.diff(new.time)[:, None]
    assert h[4] == pytest.approx(H)
    q, v, a = (x[:-1] for x in (new.position, new.velocity, new.acceleration))
    np.testing.assert_allclose(v + h * (a + h * new.jerk / 2), new.velocity[1:], atol=1e-12)
    moved = q + h * (v + h * (a / 2 + h * new.jerk / 6))
    np.testing.assert_allclose(moved, new.position[1:], atol=1e-12)
    assert [s.kind for s in motion.segments] == ["dwell"]


def test_mass_matrix_and_bias_have_rotors_springs_and_friction() -> None:
    """M L² + J, and viscous friction less the spring; Coulomb friction lowers the limit."""
    job = job_of(30.0, rotor=0.1, spring=0.7, stiffness=0.3, viscous=0.2, coulomb=2.0)
    dynamics = Dynamics(job.cell, {})
    M, bias = dynamics.at(0.4 * ONE, -1.5 * ONE)
    assert M.item() == pytest.approx(MASS * LENGTH**2 + 0.1, rel=1e-9)
    assert bias.item() == pytest.approx(-0.2 * 1.5 - 0.7 - 0.3 * 0.4, rel=1e-9)
    assert dynamics.limit.item() == pytest.approx(28.0)


def chain(masses: list[float]) -> Cell:
    """Vertical axes in a row, with the masses given."""
    links = [f'<link name="l{k}"><inertial><mass value="{m}"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
             f'iyz="0"/></inertial></link>' for k, m in enumerate([1.0, *masses])]  # fmt: skip
    joints = [f'<joint name="j{k}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><axis xyz="0 0 1"/>'
              '<limit lower="-3" upper="3" velocity="9" effort="5"/></joint>' for k in range(len(masses))]  # fmt: skip
    names, ones = tuple(f"j{k}" for k in range(len(masses))), np.ones(len(masses))
    limits = JointLimits(names, -3 * ones, 3 * ones, ones, ones, ones, ("assumed",) * len(masses))
    arm = Arm("left", names, f"l{len(masses)}", "general")
    urdf = f'<robot name="chain">{"".join([*links, *joints])}</robot>'
    return Cell(Robot("chain", urdf, (), (arm,), limits), pin.SE3.Identity(), {})


def test_placeholders_of_masses_limit_nothing() -> None:
    """As the verifier does not check them either: four links of 1 kg."""
    assert not limits_torques(chain([1.0] * 4))
    assert limits_torques(chain([1.0, 2.0, 1.0, 1.0]))
    assert limits_torques(chain([1.0] * 3))
