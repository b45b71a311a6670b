"""Two versions of one stage: which part of which arm made the one longer than the other, and which joint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.model.schedule import DURATION, TOOL_SPEED, Schedule
from dualarm_cli.planning.stage_parts import StageParts
from dualarm_cli.timing.rest_to_rest import RestToRest

KINDS = (("transfer", "return"), ("approach",), ("dwell",), ("retract",), ("path",), ("seam",))
"""Parts of an arm's work, by what they are called together."""
SAME_ANGLE = 1e-6
"""Displacements nearer than this are one [rad]."""


@dataclass(frozen=True)
class Version:
    """One stage of one schedule."""

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
        found = frozenset(
            (part.task, part.action)
            for parts in self.parts.arms.values()
            for part in parts
            if part.task
        )
        # Work that takes no time at all has no parts, but an event.
        stage = self.parts.stage
        return found or frozenset(
            (event.task, event.action)
            for event in self.schedule.events
            if event.task in stage.tasks and stage.start <= event.time <= stage.end
        )

    def arm_for(self, work: frozenset[tuple[str, str]], name: str) -> str:
        """Returns the arm that does most of some work; the one of that name where none does any."""
        shared = {
            arm: len({(part.task, part.action) for part in parts} & work)
            for arm, parts in self.parts.arms.items()
        }
        best = max(shared, key=lambda arm: (shared[arm], arm == name), default=name)
        return best if shared.get(best) else name

    def times(self, arm: str) -> dict[str, float]:
        """Returns how long an arm's parts take, and how long it waits between them [s]."""
        times = {kinds[0]: self.parts.length(arm, *kinds) for kinds in KINDS}
        parts = self.parts.arms.get(arm, ())
        end = parts[-1].end if parts else self.parts.stage.start
        times["wait"] = max(0.0, end - self.parts.stage.start - sum(times.values()))
        return times

    def arrival(self, arm: str) -> float:
        """Returns when an arm's transfer is over [s]."""
        return self.parts.arrival(arm)

    def displacement(self, joint: str, arm: str) -> float | None:
        """Returns how far a joint moves in an arm's transfer [rad]; None where there is no such joint."""
        trajectory = self.schedule.trajectory
        if joint not in trajectory.joints:
            return None
        times = np.array([self.parts.stage.start, self.arrival(arm)])
        q = trajectory.at(times)[0][:, trajectory.joints.index(joint)]
        return float(abs(q[1] - q[0]))


@dataclass(frozen=True)
class Blame:
    """What made one version of a stage longer."""

    part: str
    """transfer, approach, dwell, retract or wait."""
    arm: str
    """The arm that ends the longer version."""
    joint: str
    """The joint that decides the longer version's transfer; empty for other parts."""
    cause: str
    """displacement, limits or timing for a transfer; time for other parts."""
    a_time: float
    """How long the part takes in A [s]."""
    b_time: float
    """How long it takes in B [s]."""
    a_displacement: float | None
    """How far the joint moves in A [rad]; None where no joint is to blame."""
    b_displacement: float | None
    """How far it moves in B [rad]."""

    @property
    def name(self) -> str:
        """The joint, or what the part is."""
        return self.joint or self.part


def blame(a: Version, b: Version) -> Blame:
    """Returns what made one of two versions of a stage longer.

    The longer version lasts as long as its critical arm, whose parts add up to it, while the same arm's parts in the
    shorter version add up to no more than that one. So some part of that arm grew at least by its share of the
    difference; the one that grew most is to blame.

    Args:
        a: before.
        b: after, not equally long.
    """
    longer, shorter = (b, a) if b.duration > a.duration else (a, b)
    arm = longer.parts.critical
    own = frozenset((part.task, part.action) for part in longer.parts.arms.get(arm, ()))
    other = shorter.arm_for(own - {("", "")}, arm)
    long_times, short_times = longer.times(arm), shorter.times(other)
    part = max(long_times, key=lambda name: long_times[name] - short_times[name])
    arms = (other, arm) if longer is b else (arm, other)
    times = [version.times(name)[part] for version, name in zip((a, b), arms, strict=True)]
    joint = _slowest_joint(longer, arm) if part == "transfer" else ""
    if not joint:
        return Blame(part, arm, "", "time", times[0], times[1], None, None)
    moved = [v.displacement(joint, name) for v, name in zip((a, b), arms, strict=True)]
    cause = _cause(a, b, joint, times[1] - times[0], moved)
    return Blame(part, arm, joint, cause, times[0], times[1], moved[0], moved[1])


def _slowest_joint(version: Version, arm: str) -> str:
    """Returns the joint that decides an arm's transfer: the stated one, else by its least time, else the farthest."""
    robot, stated = version.schedule.robot, version.parts.stage.bottleneck
    known = robot.arms.get(arm)
    joints = [*(robot.platform or ()), *(known.joints if known is not None else ())]
    if stated in joints or (
        stated not in ("", DURATION, TOOL_SPEED) and not version.parts.stage.tasks
    ):
        return stated
    moved = {joint: version.displacement(joint, arm) or 0.0 for joint in joints}
    moved = {joint: way for joint, way in moved.items() if way > SAME_ANGLE}
    least = {joint: _least_time(version, joint, way) for joint, way in moved.items()}
    if any(time is None for time in least.values()):
        return max(moved, key=lambda joint: moved[joint], default="")
    return max(least, key=lambda joint: least[joint] or 0.0, default="")


def _least_time(version: Version, joint: str, way: float | None) -> float | None:
    """Returns the closed-form time of a way under the schedule's limits [s]; None where it states none."""
    limits = version.schedule.robot.limits
    if way is None or joint not in limits.joints:
        return None
    one = limits.select([joint])
    if not (np.isfinite(one.velocity[0]) and np.isfinite(one.acceleration[0])):
        return None
    law = RestToRest(one.velocity, one.acceleration, one.jerk)
    return float(law.duration(np.array([way])))


def _cause(a: Version, b: Version, joint: str, difference: float, moved: list[float | None]) -> str:
    """Returns what most of a transfer's difference comes from: a longer way, other limits, or other timing."""
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
