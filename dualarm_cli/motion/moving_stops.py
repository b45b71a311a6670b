"""Stops of a stage in which joints move in dwells, or the platform on lines: all pieces in their places.

No arm leaves its target before the motion in its dwell is over. Where the platform turns on a line, all arms of the
stage begin that line together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.motion.dwell_motion import dwell_motions
from dualarm_cli.motion.line_motion import groups_on_line, turned_line
from dualarm_cli.motion.stop_motion import add_segment, event_of, timed_line
from dualarm_cli.motion.transfers import PLATFORM, Drive
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing.composition import hold

Moves = Sequence[tuple[float, Trajectory]]
"""What a group does, and when each begins [s] from the stage's start."""


@dataclass(frozen=True)
class _Times:
    """When one arm does what at its stop, from the stage's start [s]."""

    arrives: float
    """Its transfer is over."""
    begins: float
    """Its approach begins."""
    there: float
    """It is at its target."""
    leaves: float
    """Its retract begins."""
    move: tuple[float, Trajectory] | None
    """What moves in its dwell, and when that begins."""


def add_moving_stops(
    record: MotionBuilder, drive: Drive, plan: StagePlan, ends: Mapping[str, float]
) -> dict[str, float]:
    """Appends the stops of a stage in whose dwells joints move, or on whose lines the platform does.

    Args:
        record: what is planned so far.
        drive: of the job.
        plan: the stage.
        ends: when each group's transfer is over, from the stage's start [s].

    Returns:
        When each group is done with the stage [s].
    """
    lines = {
        (name, line): timed_line(drive, plan, one, line)
        for name, one in plan.stops.items()
        for line, way in (("approach", one.stop.approach), ("retract", one.stop.retract))
        if way > 0.0
    }
    length = {key: line.duration for key, line in lines.items()}
    begins = {name: ends[name] for name in plan.stops}
    if "approach" in plan.turned:
        begins = dict.fromkeys(plan.stops, max(ends[group] for group in groups_on_line(plan)))
    there = {name: begins[name] + length.get((name, "approach"), 0.0) for name in plan.stops}
    leaves = {name: there[name] + one.stop.dwell.total for name, one in plan.stops.items()}
    moves: dict[str, tuple[float, Trajectory]] = {}
    for move in dwell_motions(drive, plan):
        arms = [name for name in move.groups if name != PLATFORM]
        start = max(there[name] for name in arms)
        moves |= {name: (start, move.motion[name]) for name in move.groups}
        leaves |= {name: max(leaves[name], start + move.duration) for name in arms}
    if "retract" in plan.turned:
        leaves = dict.fromkeys(plan.stops, max(leaves.values()))
    latest = {name: leaves[name] + length.get((name, "retract"), 0.0) for name in plan.stops}
    over = max({**ends, **latest}.values())
    # What leaves in motion leaves as the stage ends.
    leaves |= {
        name: leaves[name] + (over - latest[name])
        for name in plan.stops
        if (name, "retract") in plan.passes
    }
    found = dict(ends)
    if PLATFORM in ends:
        own = [moves[PLATFORM]] if PLATFORM in moves else []
        if "approach" in plan.turned:
            own.insert(0, (max(begins.values()), turned_line(drive, plan, "approach")[PLATFORM]))
        if "retract" in plan.turned:
            own.append((max(leaves.values()), turned_line(drive, plan, "retract")[PLATFORM]))
        found[PLATFORM] = _add_moves(record, drive, PLATFORM, ends[PLATFORM], own)
    for name, one in plan.stops.items():
        times = _Times(ends[name], begins[name], there[name], leaves[name], moves.get(name))
        found[name] = _add_stop(record, drive, plan, one, lines, times)
    return found


def _add_moves(
    record: MotionBuilder, drive: Drive, group: str, clock: float, moves: Moves
) -> float:
    """Appends what a group does, and that it stands between; returns when it is over [s].

    Args:
        record: what is planned so far.
        drive: of the job.
        group: which one.
        clock: since when it stands, from the stage's start [s].
        moves: what it does.
    """
    for start, motion in moves:
        if start > clock:
            record.add(group, hold(drive.joints(group), motion.position[0], start - clock))
        record.add(group, motion)
        clock = start + motion.duration
    return clock


def _add_stop(
    record: MotionBuilder,
    drive: Drive,
    plan: StagePlan,
    arm_stop: ArmStop,
    lines: Mapping[tuple[str, str], Trajectory],
    times: _Times,
) -> float:
    """Appends one arm's stop; returns when it is over, from the stage's start [s].

    Args:
        record: what is planned so far.
        drive: of the job.
        plan: the stage.
        arm_stop: what the arm does in it.
        lines: the stage's lines, by arm and line.
        times: when it does what.
    """
    name, begin, there, leaves = arm_stop.arm, record.clock, times.there, times.leaves
    approach, retract = lines.get((name, "approach")), lines.get((name, "retract"))
    moves = [] if approach is None else [(times.begins, approach)]
    moves += [] if times.move is None else [times.move]
    clock = _add_moves(record, drive, name, times.arrives, moves)
    if times.begins > times.arrives:
        span = begin + times.arrives, begin + times.begins
        add_segment(record, name, "wait", arm_stop, *span, "partner")
    if approach is not None:
        add_segment(record, name, "approach", arm_stop, begin + times.begins, begin + there)
    record.events.append(event_of(drive.model, plan, arm_stop, begin + there))
    if leaves > clock:
        stands = arm_stop if times.move is None else plan.stop_at("retract", arm_stop)
        record.add(name, hold(drive.joints(name), stands.posture.q_target, leaves - clock))
    over = there + arm_stop.stop.dwell.total
    add_segment(record, name, "dwell", arm_stop, begin + there, begin + over)
    if leaves > over:
        add_segment(record, name, "wait", arm_stop, begin + over, begin + leaves, "partner")
    if retract is None:
        return leaves
    record.add(name, retract)
    end = leaves + retract.duration
    add_segment(record, name, "retract", arm_stop, begin + leaves, begin + end)
    return end
