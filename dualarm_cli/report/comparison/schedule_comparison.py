"""The document of `dualarm compare schedules`: differences stage by stage, with causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np

from dualarm_cli.errors import UsageError
from dualarm_cli.model.schedule import DURATION, TOOL_SPEED, Schedule
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.report.stage_parts import StageParts, overlap, stage_parts

_note = NoteTable(
    "comparison",
    robots="different robots ({names:*, }): durations are compared, joints only where both robots have one of "
    "that name",
    limits="limits differ for {count} joints: {examples}",
    settings="settings differ: {changed:*, }",
    order="the order of the stages differs",
    overlap="stages of {side} overlap: the arms run asynchronously, so the differences of the stages do not add "
    "up to the total",
    missing="{side} states no {missing:* and no }: cut at its events",
)
KINDS = (("transfer", "return"), ("approach",), ("dwell",), ("retract",), ("path",), ("seam",))
"""Groups of segment kinds in an arm's work."""
SAME_ANGLE = 1e-6
"""Tolerance of equal displacements [rad]."""


@dataclass(frozen=True)
class Version:
    """A stage in one of the schedules."""

    schedule: Schedule
    """The schedule."""
    parts: StageParts
    """The stage."""

    @property
    def duration(self) -> float:
        """Length of the stage [s]."""
        return self.parts.stage.end - self.parts.stage.start

    @property
    def work(self) -> frozenset[tuple[str, str]]:
        """Tasks and actions of the stage; empty for a return."""
        work = frozenset(
            (part.task, part.action)
            for parts in self.parts.arms.values()
            for part in parts
            if part.task
        )
        # Work without duration has no segments, but an event.
        stage = self.parts.stage
        return work or frozenset(
            (event.task, event.action)
            for event in self.schedule.events
            if event.task in stage.tasks and stage.start <= event.time <= stage.end
        )

    def arm_for(self, work: frozenset[tuple[str, str]], name: str) -> str:
        """Find the arm doing most of the given work, else the named arm."""
        shared = {
            arm: len({(part.task, part.action) for part in parts} & work)
            for arm, parts in self.parts.arms.items()
        }
        best = max(shared, key=lambda arm: (shared[arm], arm == name), default=name)
        return best if shared.get(best) else name

    def times(self, arm: str) -> dict[str, float]:
        """Sum an arm's times by kind of segment, and its waits between them [s]."""
        times = {kinds[0]: self.parts.length(arm, *kinds) for kinds in KINDS}
        parts = self.parts.arms.get(arm, ())
        end = parts[-1].end if parts else self.parts.stage.start
        times["wait"] = max(0.0, end - self.parts.stage.start - sum(times.values()))
        return times

    def arrival(self, arm: str) -> float:
        """Compute the end of an arm's transfer [s]."""
        return self.parts.arrival(arm)

    def displacement(self, joint: str, arm: str) -> float | None:
        """Compute the displacement of a joint in an arm's transfer [rad], or None."""
        trajectory = self.schedule.trajectory
        if joint not in trajectory.joints:
            return None
        times = np.array([self.parts.stage.start, self.arrival(arm)])
        q = trajectory.clamped(times)[0][:, trajectory.joints.index(joint)]
        return float(abs(q[1] - q[0]))


@dataclass(frozen=True)
class Blame:
    """Cause of the longer version of a stage."""

    part: str
    """transfer, approach, dwell, retract or wait."""
    arm: str
    """The arm that ends the longer version."""
    joint: str
    """The joint that decides the longer version's transfer; empty for other parts."""
    cause: str
    """displacement, limits or timing for a transfer; time for other parts."""
    a_time: float
    """Time of the part in A [s]."""
    b_time: float
    """Time of the part in B [s]."""
    a_displacement: float | None
    """Displacement of the joint in A [rad or m]; None without a cause."""
    b_displacement: float | None
    """Displacement of the joint in B [rad or m]."""
    slides: bool = False
    """Whether the joint slides."""

    @property
    def name(self) -> str:
        """Name of the joint, or of the part."""
        return self.joint or self.part


def blame(a: Version, b: Version) -> Blame:
    """Find the cause of the longer of two versions of a stage.

    The parts of the critical arm add up to the longer version, while the same arm's parts in the shorter version add up
    to no more than that one. So some part of that arm grew at least by its share of the difference; the one that
    grew most is the cause.

    Args:
        a: before.
        b: after, of a different duration.
    """
    longer, shorter = (b, a) if b.duration > a.duration else (a, b)
    arm = longer.parts.critical
    work = frozenset((part.task, part.action) for part in longer.parts.arms.get(arm, ()))
    other_arm = shorter.arm_for(work - {("", "")}, arm)
    long_times, short_times = longer.times(arm), shorter.times(other_arm)
    part = max(long_times, key=lambda name: long_times[name] - short_times[name])
    arms = (other_arm, arm) if longer is b else (arm, other_arm)
    times = [version.times(name)[part] for version, name in zip((a, b), arms, strict=True)]
    joint = _slowest_joint(longer, arm) if part == "transfer" else ""
    if not joint:
        return Blame(part, arm, "", "time", times[0], times[1], None, None)
    moved = [v.displacement(joint, name) for v, name in zip((a, b), arms, strict=True)]
    cause = _cause(a, b, joint, times[1] - times[0], moved)
    slides = joint in longer.schedule.robot.sliding
    return Blame(part, arm, joint, cause, times[0], times[1], moved[0], moved[1], slides)


def _slowest_joint(version: Version, arm: str) -> str:
    """Find the joint that decides an arm's transfer.

    The stated one has priority, then the largest minimum time, then the largest displacement.
    """
    robot, stated = version.schedule.robot, version.parts.stage.bottleneck
    stated_arm = robot.arms.get(arm)
    joints = [*(robot.platform or ()), *(stated_arm.joints if stated_arm is not None else ())]
    if stated in joints or (
        stated not in ("", DURATION, TOOL_SPEED) and not version.parts.stage.tasks
    ):
        return stated
    moved = {joint: version.displacement(joint, arm) or 0.0 for joint in joints}
    moved = {
        joint: displacement for joint, displacement in moved.items() if displacement > SAME_ANGLE
    }
    least = {
        joint: _least_time(version, joint, displacement) for joint, displacement in moved.items()
    }
    if any(time is None for time in least.values()):
        return max(moved, key=lambda joint: moved[joint], default="")
    return max(least, key=lambda joint: least[joint] or 0.0, default="")


def _least_time(version: Version, joint: str, displacement: float | None) -> float | None:
    """Compute the minimum time of a displacement under the schedule's limits [s], or None."""
    limits = version.schedule.robot.limits
    if displacement is None or joint not in limits.joints:
        return None
    joint_limits = limits.select([joint])
    if not (np.isfinite(joint_limits.velocity[0]) and np.isfinite(joint_limits.acceleration[0])):
        return None
    return float(joint_limits.law.duration(np.array([displacement])))


def _cause(a: Version, b: Version, joint: str, difference: float, moved: list[float | None]) -> str:
    """Classify a transfer's difference: longer displacement, other limits, or other timing."""
    before, between, after = (
        _least_time(a, joint, moved[0]),
        _least_time(a, joint, moved[1]),
        _least_time(b, joint, moved[1]),
    )
    if before is None or between is None or after is None:
        farther = abs((moved[1] or 0.0) - (moved[0] or 0.0)) > SAME_ANGLE
        return "displacement" if farther else "timing"
    shares = {"displacement": between - before, "limits": after - between}
    shares["timing"] = difference - sum(shares.values())
    return max(shares, key=lambda name: np.sign(difference) * shares[name])


SAME = 1e-6
"""Tolerance of equal durations [s]."""
SHOWN = 4
"""Maximum number of names in a message."""

Pair = tuple[int | None, int | None]


def compare_schedules(a: Schedule, b: Schedule, names: tuple[str, str]) -> dict[str, Any]:
    """Compare two schedules as a JSON-ready document [s, rad, m].

    Stages are matched by their tasks and actions, independent of their positions; the others by the most common work.
    A stage without partner is a row of its own, so that all differences add up to the total.

    Args:
        a: before.
        b: after.
        names: their names in messages.

    Raises:
        UsageError: invalid times or positions of a schedule, or no common work.
    """
    for schedule, name in zip((a, b), names, strict=True):
        _refuse_broken(schedule, name)
    versions = [[Version(s, part) for part in stage_parts(s)] for s in (a, b)]
    pairs = _matched(versions[0], versions[1])
    _refuse_strangers(versions, pairs, names)
    rows = [_row(versions[0], versions[1], pair) for pair in pairs]
    return {
        "format": "dualarm.schedule-comparison/1",
        "a": _side(a, names[0]),
        "b": _side(b, names[1]),
        "difference": b.duration - a.duration,
        "relative": b.duration / a.duration - 1.0 if a.duration > 0 else None,
        "identical": _same_motion(a, b) and all(abs(row["difference"]) <= SAME for row in rows),
        "stages": rows,
        "blamed": _blamed(rows),
        "notes": _notes(a, b, pairs),
    }


def _refuse_broken(schedule: Schedule, name: str) -> None:
    advice = f"; `dualarm verify {name}` says more"
    for group in schedule.motion.groups.values():
        for what in ("time", "position", "velocity", "acceleration"):
            if not np.isfinite(getattr(group, what)).all():
                raise UsageError(f"{name}: the {what} of a knot is not finite{advice}")
        if (np.diff(group.time) < 0).any():
            raise UsageError(f"{name}: the times of the knots do not increase{advice}")
    parts = [("stage", number, s.start, s.end) for number, s in enumerate(schedule.stages, 1)]
    parts += [("segment", number, s.start, s.end) for number, s in enumerate(schedule.segments, 1)]
    for what, number, start, end in parts:
        if end < start:
            raise UsageError(f"{name}: {what} {number} ends before it starts{advice}")


def _refuse_strangers(
    versions: Sequence[Sequence[Version]], pairs: Sequence[Pair], names: tuple[str, str]
) -> None:
    """Raise if no stages of the two schedules share any work."""
    work = [any(v.work for v in side) for side in versions]
    shared = any(i is not None and j is not None and versions[0][i].work for i, j in pairs)
    if any(work) and not shared:
        listed = []
        for side, name in zip(versions, names, strict=True):
            done = [" ".join(work).strip() for v in side for work in sorted(v.work)]
            examples = ", ".join(done[:SHOWN]) + (", …" if len(done) > SHOWN else "")
            listed.append(f"{name} does {examples or 'nothing'}")
        raise UsageError(
            f"no common stages: {'; '.join(listed)}; compare plans that share tasks and actions"
        )


def _matched(a: Sequence[Version], b: Sequence[Version]) -> list[Pair]:
    """Match the stages of A and B, in A's order.

    Those only in B come last.
    """
    free = list(range(len(b)))
    partner: dict[int, int] = {}
    for i, version in enumerate(a):
        same = next((j for j in free if b[j].work == version.work), None)
        if same is not None:
            partner[i] = same
            free.remove(same)
    for i, version in enumerate(a):
        if i in partner:
            continue
        shared = {j: len(b[j].work & version.work) for j in free}
        best = max(shared, key=lambda j: (shared[j], -j), default=None)
        if best is not None and shared[best] > 0:
            partner[i] = best
            free.remove(best)
    return [(i, partner.get(i)) for i in range(len(a))] + [(None, j) for j in free]


def _row(a: Sequence[Version], b: Sequence[Version], pair: Pair) -> dict[str, Any]:
    before = a[pair[0]] if pair[0] is not None else None
    after = b[pair[1]] if pair[1] is not None else None
    lengths = [0.0 if version is None else version.duration for version in (before, after)]
    difference = lengths[1] - lengths[0]
    cause = None
    if before is not None and after is not None and abs(difference) > SAME:
        cause = blame(before, after)
    if before is None or after is None:
        match = "only in B" if before is None else "only in A"
    else:
        match = "same work" if before.work == after.work else "different simultaneous work"
    shown = before or after
    return {
        "a": None if pair[0] is None else pair[0] + 1,
        "b": None if pair[1] is None else pair[1] + 1,
        "work": [f"{task} {action}".strip() for task, action in sorted(shown.work)]
        if shown is not None
        else [],
        "match": match,
        "a_duration": None if before is None else lengths[0],
        "b_duration": None if after is None else lengths[1],
        "difference": difference,
        "a_bottleneck": None if before is None else before.parts.stage.bottleneck,
        "b_bottleneck": None if after is None else after.parts.stage.bottleneck,
        "blame": None if cause is None else asdict(cause),
    }


def _side(schedule: Schedule, name: str) -> dict[str, Any]:
    return {
        "schedule": name,
        "robot": schedule.robot.name,
        "duration": schedule.duration,
        "stages": len(stage_parts(schedule)),
    }


def _same_motion(a: Schedule, b: Schedule) -> bool:
    motion_a, motion_b = a.trajectory, b.trajectory
    return motion_a.joints == motion_b.joints and all(
        np.array_equal(getattr(motion_a, name), getattr(motion_b, name))
        for name in ("time", "position", "velocity", "acceleration")
    )


def _blamed(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Sum the stages' differences by cause, largest first."""
    differences: dict[str, list[float]] = {}
    for row in rows:
        if abs(row["difference"]) <= SAME:
            continue
        name = "stages without partner"
        if row["blame"] is not None:
            name = row["blame"]["joint"] or row["blame"]["part"]
        differences.setdefault(name, []).append(row["difference"])
    listed = [
        {"name": name, "stages": len(parts), "difference": sum(parts)}
        for name, parts in differences.items()
    ]
    return sorted(listed, key=lambda entry: -abs(entry["difference"]))


def _notes(a: Schedule, b: Schedule, pairs: Sequence[Pair]) -> list[Note]:
    """Compose notes on other differences: robots, limits, settings, order, missing data."""
    notes = []
    if a.robot.name != b.robot.name or set(a.trajectory.joints) != set(b.trajectory.joints):
        notes.append(_note("robots", names=[a.robot.name, b.robot.name]))
    notes += _limit_notes(a, b)
    settings_a, settings_b = a.provenance.settings, b.provenance.settings
    changed = [
        f"{key} {settings_a.get(key)} → {settings_b.get(key)}"
        for key in sorted({*settings_a, *settings_b})
        if settings_a.get(key) != settings_b.get(key)
    ]
    if changed:
        notes.append(_note("settings", changed=changed))
    places = [j for i, j in pairs if i is not None and j is not None]
    if any(later < earlier for earlier, later in pairwise(places)):
        notes.append(_note("order"))
    for schedule, side in ((a, "A"), (b, "B")):
        if overlap(schedule.stages):
            notes.append(_note("overlap", side=side))
        missing = [w for w in ("stages", "segments") if not getattr(schedule, w)]
        if missing:
            notes.append(_note("missing", side=side, missing=missing))
    return notes


def _limit_notes(a: Schedule, b: Schedule) -> list[Note]:
    """Compose the note on joints whose limits differ."""
    limits_a, limits_b = a.robot.limits, b.robot.limits
    both = [joint for joint in limits_a.joints if joint in limits_b.joints]
    if not both:
        return []
    limits_a, limits_b = limits_a.select(both), limits_b.select(both)
    differ = {
        joint
        for what in ("velocity", "acceleration", "jerk")
        for joint, x, y in zip(both, getattr(limits_a, what), getattr(limits_b, what), strict=True)
        if x != y
    }
    if not differ:
        return []
    named = [joint for joint in both if joint in differ]
    examples = ", ".join(named[:SHOWN]) + (", …" if len(named) > SHOWN else "")
    return [_note("limits", count=len(named), examples=examples)]
