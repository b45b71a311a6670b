"""Tools at parts on conveyors: a gantry of three slides, made by hand, so that where everything is is plain sums."""

from __future__ import annotations

import dataclasses

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.cell import Cell, Tool
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.part_flow import Conveyor, OnBelt
from dualarm_cli.model.place import Place
from dualarm_cli.model.robot import Arm, JointLimits, Robot
from dualarm_cli.model.schedule import Event, Provenance, Schedule, ScheduleRobot, Segment, Stage
from dualarm_cli.verification import verify
from dualarm_cli.verification.measuring.line_spans import line_spans
from dualarm_cli.verification.measuring.tool_model import ToolModel
from dualarm_cli.verification.stage_checks import _time_at_rest

JOINTS = ("gx", "gy", "gz")
BELT, LINE, PASSES, MET = 0.2, 0.06, 1.0, 2.0
"""Speed along -y [m/s], length of lines [m], when the part passes [s] and is met [s]."""
RAMP, STRAIGHT, DWELL = 0.4, 0.4, 0.3
PART = np.array([0.3, 0.5, -0.2])
"""Where the part is when it passes; when it is met it is BELT (MET - PASSES) = 0.2 m further along -y."""
DOWN = pin.utils.rotate("x", np.pi)


def _urdf() -> str:
    parts, parent = ['<robot name="gantry"><link name="base"/>'], "base"
    for name, axis in zip(JOINTS, ("1 0 0", "0 1 0", "0 0 1"), strict=True):
        parts.append(
            f'<link name="{name}_link"/><joint name="{name}" type="prismatic"><parent link="{parent}"/>'
            f'<child link="{name}_link"/><axis xyz="{axis}"/>'
            '<limit lower="-2" upper="2" velocity="4" effort="0"/></joint>'
        )
        parent = f"{name}_link"
    parts.append(
        f'<link name="flange"/><joint name="f" type="fixed"><parent link="{parent}"/><child link="flange"/>'
        f'<origin rpy="{np.pi!r} 0 0"/></joint></robot>'
    )
    return "".join(parts)


def _job(velocity: float = -BELT, passes: float = PASSES, y: float = 0.5, **stop: object) -> Job:
    limits = JointLimits(
        JOINTS,
        np.full(3, -2.0),
        np.full(3, 2.0),
        np.full(3, 4.0),
        np.full(3, 50.0),
        np.full(3, 500.0),
        ("assumed",) * 3,
    )
    robot = Robot(
        "gantry",
        _urdf(),
        (),
        (Arm("left", JOINTS, "flange", "general"),),
        limits,
        {"home": np.zeros(3)},
    )
    identity = pin.SE3.Identity()
    belt = OnBelt(Conveyor("belt", np.array([0.0, velocity, 0.0])), passes, 0.4, passes)
    target = PoseTarget(pin.SE3(DOWN, np.array([PART[0], y, PART[2]])))
    place = Place("tasks.yaml", 3, 5)
    pick = Stop("pick", target, LINE, LINE, Dwell(gripper=DWELL), place, belt=belt)
    pick = dataclasses.replace(pick, **stop)
    task = Task("part", "left", (pick,), place=place)
    return Job(Cell(robot, identity, {"left": Tool(identity)}), (task,), "home", False)


def _integrated(pieces: list[tuple[float, float, float, float]]) -> Trajectory:
    """Returns the motion from rest at 0 of pieces of a duration and constant jerks along x, y, z."""
    t, q, v, a = [0.0], [np.zeros(3)], [np.zeros(3)], [np.zeros(3)]
    for dt, *jerk in pieces:
        j = np.array(jerk)
        t.append(t[-1] + dt)
        q.append(q[-1] + dt * (v[-1] + dt * (a[-1] / 2 + dt * j / 6)))
        v.append(v[-1] + dt * (a[-1] + dt * j / 2))
        a.append(a[-1] + dt * j)
    return Trajectory(JOINTS, *(np.array(column) for column in (t, q, v, a)))


def _move(way: np.ndarray, duration: float) -> list[tuple[float, ...]]:
    """Rest to rest in four jerks +, -, -, + of equal length h: the way is 2 j h³."""
    h = duration / 4
    j = np.asarray(way) / (2 * h**3)
    return [(h, *(sign * j)) for sign in (1, -1, -1, 1)]


def _ramp(change: float) -> list[tuple[float, ...]]:
    """Velocity along y by two jerks of RAMP/2: the change is j (RAMP/2)², the way half of what it makes in RAMP."""
    j = change / (RAMP / 2) ** 2
    return [(RAMP / 2, 0.0, j, 0.0), (RAMP / 2, 0.0, -j, 0.0)]


def _schedule(job: Job, *, stands: bool = False, overlap: bool = False) -> Schedule:
    """Returns the pick; in a wrong way: standing in the dwell, or getting up to speed while it goes down."""
    speed = 0.0 if stands else BELT
    # Where y has to be when the motion at the belt begins: back by what belt and ramp take it on.
    behind = speed * (RAMP / 2 + (0.0 if overlap else STRAIGHT))
    above = PART + np.array([0.0, -BELT * (MET - PASSES) + behind, LINE])
    lead = MET - STRAIGHT - (0.0 if overlap else RAMP)
    line = _move(np.array([0.0, 0.0, -LINE]), STRAIGHT)
    if overlap:
        # Both take 0.4 s: the ramp's two jerks are two of the line's four each.
        y = [r[2] for r in _ramp(-speed) for _ in range(2)]
        down = [(h, 0.0, j, z) for (h, _, _, z), j in zip(line, y, strict=True)]
    else:
        down = [*_ramp(-speed), *line]
    pieces = [
        *_move(above, lead),
        *down,
        (DWELL, 0.0, 0.0, 0.0),
        *_move(np.array([0.0, 0.0, LINE]), STRAIGHT),
        *_ramp(speed),
    ]
    motion = _integrated(pieces)
    over = motion.duration
    pose = pin.SE3(DOWN, PART - np.array([0.0, BELT * (MET - PASSES), 0.0]))
    who = ("left", "part", "pick")
    spans = [
        ("transfer", 0.0, lead),
        ("approach", lead, MET),
        ("dwell", MET, MET + DWELL),
        ("retract", MET + DWELL, over),
    ]
    shares = Dwell(gripper=DWELL)
    return Schedule(
        ScheduleRobot.of_job(job),
        JointMotion.of(motion),
        (Stage(0.0, over, ("part",), "fixed", None, 0.0, {}, {}, ""),),
        tuple(
            Segment("left", kind, "part", "pick", start, end, shares if kind == "dwell" else None)
            for kind, start, end in spans
        ),
        (Event(MET, *who, "left_tcp", pose, DWELL, (0.0, -BELT, 0.0)),),
        Provenance("0", {}, {}, 0),
    )


def _failed(schedule: Schedule, job: Job | None) -> set[str]:
    return {check.name for check in verify(schedule, job).failures}


@pytest.fixture(scope="module")
def clean() -> Schedule:
    """A schedule without fault."""
    return _schedule(_job())


def test_a_tool_that_goes_with_the_part_passes(clean):
    """Every check of conveyors is made and passes, with files and as far as possible without."""
    verification = verify(clean, _job())
    assert verification.passed, verification.failures
    made = {check.name for check in verification.checks if check.verdict == "passed"}
    assert {
        "conveyor_part",
        "conveyor_windows",
        "conveyor_velocity",
        "conveyor_dwells",
        "conveyor_dwells_steady",
        "conveyor_lines_straight",
        "conveyor_lines_steady",
        "conveyor_line_lengths",
    } <= made
    alone = {check.name: check.verdict for check in verify(clean).checks}
    assert alone["conveyor_dwells"] == alone["conveyor_velocity"] == "passed"
    assert alone["conveyor_part"] == alone["conveyor_line_lengths"] == "not checked"
    assert verify(clean).passed


def test_a_part_that_comes_at_another_time_is_missed(clean):
    """10 ms late at 0.2 m/s is 2 mm: at the event the tool is beside the part, though it goes as fast."""
    for passes in (PASSES + 0.01, PASSES - 0.01):
        job = _job(passes=passes)
        [check] = [c for c in verify(clean, job).checks if c.name == "conveyor_part"]
        assert check.measured == pytest.approx(0.002, abs=1e-9)
        assert _failed(clean, job) == {"conveyor_part"}


def test_windows_are_kept_at_both_ends(clean):
    """If it passes 0.5 s after MET it is met too early; 0.4 m take 2 s: too late by 0.1 s if it passed at -0.1 s."""
    late = _job(passes=MET + 0.5, y=0.5 - BELT * (MET + 0.5 - PASSES))
    [check] = [c for c in verify(clean, late).checks if c.name == "conveyor_windows"]
    assert _failed(clean, late) == {"conveyor_windows"}
    assert check.measured == pytest.approx(0.5)
    early = _job(passes=-0.1, y=0.5 + BELT * 1.1)
    [check] = [c for c in verify(clean, early).checks if c.name == "conveyor_windows"]
    assert _failed(clean, early) == {"conveyor_windows"}
    assert check.measured == pytest.approx(0.1)


def test_another_belt_is_not_followed(clean):
    """On a belt that is 2 mm/s faster the tool is 0.6 mm off after a dwell of 0.3 s; at MET it may be at the part."""
    job = _job(velocity=-BELT - 0.002, y=0.5 + 0.002 * (MET - PASSES))
    checks = {c.name: c for c in verify(clean, job).checks}
    assert checks["conveyor_part"].verdict == "passed"
    assert checks["conveyor_dwells"].measured == pytest.approx(0.0006, abs=1e-8)
    # What the event states is another velocity than the file's.
    assert checks["conveyor_velocity"].measured == pytest.approx(0.002, abs=1e-6)
    assert {"conveyor_dwells", "conveyor_velocity", "conveyor_lines_straight"} <= _failed(
        clean, job
    )


def test_a_tool_that_stands_in_the_dwell_fails():
    """It is at the part at the event and then 0.2 m/s times 0.3 s behind."""
    job = _job()
    checks = {c.name: c for c in verify(_schedule(job, stands=True), job).checks}
    assert checks["conveyor_part"].verdict == "passed"
    assert checks["conveyor_dwells"].measured == pytest.approx(0.06, abs=1e-9)
    assert checks["conveyor_velocity"].measured == pytest.approx(0.2, abs=1e-6)
    assert checks["conveyor_lines_straight"].verdict == "failed"


def test_getting_up_to_speed_on_the_line_is_not_straight():
    """On the ramp of 0.4 s it falls 0.04 m behind a belt of 0.2 m/s, all of it on the line; all else is right."""
    job = _job()
    found = _schedule(job, overlap=True)
    [check] = [c for c in verify(found, job).checks if c.name == "conveyor_lines_straight"]
    assert _failed(found, job) == {"conveyor_lines_straight"}
    # The line begins at the last instant looked at, 25 ms / 4 apart, at which 60 mm less 0.1 mm are still to go.
    assert 0.035 < check.measured <= 0.04 + 1e-9


@pytest.mark.parametrize("line", ["approach", "retract"])
def test_lines_are_as_long_as_asked(clean, line):
    """A line of 60 mm where 80 mm are asked lacks 20 mm; where 30 mm are asked the rest is its own matter."""
    job = _job(**{line: 0.08})
    [check] = [c for c in verify(clean, job).checks if c.name == "conveyor_line_lengths"]
    assert check.verdict == "failed"
    assert check.measured == pytest.approx(0.02, abs=1e-9)
    assert verify(clean, _job(**{line: 0.03})).passed


def test_a_line_that_is_not_listed_is_missing(clean):
    """Without its segment nobody could say where it is."""
    segments = tuple(s for s in clean.segments if s.kind != "retract")
    found = _failed(dataclasses.replace(clean, segments=segments), _job())
    assert "conveyor_line_lengths" in found


def test_what_an_event_states_excuses_nothing(clean):
    """A target that stands is left by a moving tool, whatever velocity the event claims; the claim is wrong too."""
    job = _job(y=0.5 - BELT * (MET - PASSES), belt=None)
    assert {
        "tool_still_in_dwells",
        "lines_straight",
        "conveyor_velocity",
    } <= _failed(clean, job)
    [event] = clean.events
    honest = dataclasses.replace(clean, events=(dataclasses.replace(event, velocity=(0.0,) * 3),))
    assert {"tool_still_in_dwells", "lines_straight"} <= _failed(honest, job)
    # And the other way round: the file's conveyor counts where the event states none.
    assert _failed(honest, _job()) == {"conveyor_velocity"}
    assert "tool_still_in_dwells" in _failed(honest, None)


def test_a_tool_that_turns_at_the_part_is_found(clean):
    """An event whose pose is turned by 1 mrad is neither the tool's nor the target's."""
    [event] = clean.events
    pose = event.pose * pin.SE3(pin.utils.rotate("z", 1e-3), np.zeros(3))
    turned = dataclasses.replace(clean, events=(dataclasses.replace(event, pose=pose),))
    found = _failed(turned, _job())
    assert {"tool_angle_at_events", "conveyor_dwells_steady", "conveyor_lines_steady"} <= found


@pytest.mark.parametrize(("share", "expected"), [(0.9, "passed"), (1.1, "failed")])
def test_tolerances_of_conveyors(clean, share, expected):
    """Faults of 0.9 and of 1.1 of what is allowed, each in its own check.

    Off the part by a micrometre, off its window by a nanosecond at both ends, off the belt's velocity by 1 mm/s, off
    the part in the dwell by a micrometre and a microradian, off the line by 0.1 mm, 0.1 mrad and 0.1 mm of length.
    """
    [event] = clean.events
    um, tenth = share * 1e-6, share * 1e-4

    def stated(**changes):
        return dataclasses.replace(clean, events=(dataclasses.replace(event, **changes),))

    def moved(x, angle=0.0):
        return event.pose * pin.SE3(pin.utils.rotate("z", angle), np.array([x, 0.0, 0.0]))

    # The part passes so much later than the tool is there, or so much earlier than the window is long, 0.4 m.
    early, late = MET + share * 1e-9, MET - 0.4 / BELT - share * 1e-9
    longer = {"approach": LINE + tenth, "retract": LINE}
    for name, schedule, job in (
        ("conveyor_part", clean, _job(y=0.5 + um)),
        ("conveyor_windows", clean, _job(passes=early, y=0.5 - BELT * (early - PASSES))),
        ("conveyor_windows", clean, _job(passes=late, y=0.5 - BELT * (late - PASSES))),
        ("conveyor_velocity", stated(velocity=(share * 1e-3, -BELT, 0.0)), _job()),
        ("conveyor_dwells", stated(pose=moved(um)), _job()),
        ("conveyor_dwells_steady", stated(pose=moved(0.0, um)), _job()),
        ("conveyor_lines_straight", stated(pose=moved(tenth)), _job()),
        ("conveyor_lines_steady", stated(pose=moved(0.0, tenth)), _job()),
        ("conveyor_line_lengths", clean, _job(**longer)),
    ):
        checks = {c.name: c.verdict for c in verify(schedule, job).checks}
        assert checks[name] == expected, name


def test_an_arm_is_at_rest_once_it_has_left_the_belt(clean):
    """The line ends with the retract, RAMP before the motion does; a stop that stands still is over with its line."""
    [span] = line_spans(clean, _job(), ToolModel(clean))
    end = clean.duration - RAMP
    assert span.end == pytest.approx(end, abs=1e-3)
    assert span.start == pytest.approx(MET - STRAIGHT, abs=1e-3)
    assert _time_at_rest(clean, span) == pytest.approx(clean.duration, abs=1e-9)
    stands = dataclasses.replace(span, stop=dataclasses.replace(span.stop, belt=None))
    assert _time_at_rest(clean, stands) == span.end
