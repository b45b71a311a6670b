"""Measures that compare methods: bottlenecks, care, travel of elbows and platform."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from dualarm_cli.model.job import GIVES, TAKES, Job
from dualarm_cli.model.part_flow import Care, kind_of_part
from dualarm_cli.model.schedule import TOOL_SPEED, WORK_ENDS, Schedule, Stage
from dualarm_cli.records import dataclass
from dualarm_cli.report.stage_parts import PLATFORM, StageParts, overlap, stage_parts

ELBOW = 3
"""Index of the elbow among the joints of a 7-axis arm."""
AXES = 7
LINES, DWELLS, REMAINDER = "lines", "dwells", "other"
WORK = {kind: f"{kind}s" for kind in WORK_ENDS}
"""Names of work during motion, by its kind of segment."""
NO_TRANSFERS = (LINES, DWELLS, *WORK.values(), REMAINDER)
"""Names of time shares other than transfers; `other` is waiting inside an arm's work."""
MIN_REMAINDER = 1e-6
"""Tolerance of rounding [s]."""


@dataclass(frozen=True)
class Bottlenecks:
    """Components of a motion's duration, along each stage's critical arm."""

    stages: dict[str, int]
    """Number of stages by the joint group that decides their transfers, largest first."""
    time: dict[str, float]
    """Time of transfers by deciding group, of lines and of dwells [s].

    The sum is the duration of the motion.
    """

    @property
    def transfers(self) -> float:
        """Total time of transfers [s]."""
        return sum(time for name, time in self.time.items() if name not in NO_TRANSFERS)


def bottlenecks(schedule: Schedule) -> Bottlenecks:
    """Split the duration of a schedule by its bottlenecks.

    A stage ends with the arm that finishes last, its critical arm, so the stage is that arm's transfer, lines and
    dwell. The transfer is decided by the platform or by the arm, whichever alone needs longer. Where stages overlap,
    since the arms run asynchronously, the length is that of the arm that is done last: its stages, and `other`
    for what it waits.

    Args:
        schedule: with stages and segments, or with events at least.
    """
    groups = [*([PLATFORM] if schedule.robot.platform else []), *schedule.robot.arms]
    time = dict.fromkeys([*groups, LINES, DWELLS], 0.0)
    counts: Counter[str] = Counter()
    parts = stage_parts(schedule)
    counts.update(part.group for part in parts if part.group)
    _add_shares(schedule, parts, time, lambda part: part.group)
    ranked = sorted(counts.items(), key=lambda item: (-item[1], groups.index(item[0])))
    return Bottlenecks(dict(ranked), time)


def limiting_times(schedule: Schedule) -> dict[str, float]:
    """Split the duration of a schedule [s] as `bottlenecks` does, but transfers by joint.

    Args:
        schedule: with stages and segments, or with events at least.
    """
    time: dict[str, float] = {}
    _add_shares(schedule, stage_parts(schedule), time, lambda part: _joint(schedule, part))
    return {name: length for name, length in time.items() if length > MIN_REMAINDER}


def _add_shares(
    schedule: Schedule,
    parts: Sequence[StageParts],
    time: dict[str, float],
    name_of: Callable[[StageParts], str],
) -> None:
    """Add the time shares of all stages of the critical arm to `time`.

    Transfers are added under the name of what decides them.
    """
    last = _last_arm(parts) if overlap(schedule.stages) else ""
    for part in parts:
        if last and part.critical != last:
            continue
        for name, length in _shares(part).items():
            name = name_of(part) if name == part.group else name
            time[name] = time.get(name, 0.0) + length
    if last and (rest := schedule.duration - sum(time.values())) > MIN_REMAINDER:
        time[REMAINDER] = time.get(REMAINDER, 0.0) + rest


def _joint(schedule: Schedule, part: StageParts) -> str:
    """Find the deciding group's slowest joint in a stage.

    It is the group if the joint is unknown.
    """
    robot, stage = schedule.robot, part.stage
    joints = robot.platform if part.group == PLATFORM else robot.arms[part.group].joints
    if stage.bottleneck in joints:
        return stage.bottleneck
    timed = [joint for joint in joints if stage.joint_times.get(joint, 0.0) > 0.0]
    return max(timed, key=lambda joint: stage.joint_times[joint], default=part.group)


def _last_arm(parts: Sequence[StageParts]) -> str:
    """Find the arm whose work ends last; empty without work."""
    ends: dict[str, float] = {}
    for part in parts:
        if part.critical:
            end = part.arms[part.critical][-1].end
            ends[part.critical] = max(end, ends.get(part.critical, end))
    return max(ends, key=lambda arm: ends[arm], default="")


def _shares(part: StageParts) -> dict[str, float]:
    """Split a stage's duration by what decides it [s]."""
    arm = part.critical
    whole = part.stage.end - part.stage.start
    if not arm:
        return {part.group or REMAINDER: whole}
    shares = {
        LINES: part.length(arm, "approach", "retract"),
        DWELLS: part.length(arm, "dwell"),
    }
    for kind, name in WORK.items():
        if (time := part.length(arm, kind)) > 0.0:
            shares[name] = time
    transfer = part.length(arm, "transfer", "return")
    if part.group:
        shares[part.group] = transfer
    rest = whole - sum(shares.values())
    if rest > MIN_REMAINDER:
        shares[REMAINDER] = rest
    return shares


def elbow_imbalance(schedule: Schedule) -> float | None:
    """Compute the mean elbow imbalance of the transfers [rad].

    It is the mean of ||Δq4 left| − |Δq4 right||, which [Bottin2021] makes zero.

    Transfers of both arms count, including the return. None without two arms of seven revolute joints, or without such
    a transfer, and if stages overlap: no transfer is then of both arms.

    Args:
        schedule: with stages.
    """
    arms = schedule.robot.arms
    turning = [[j for j in arm.joints if j not in schedule.robot.sliding] for arm in arms.values()]
    sevens = all(len(joints) == AXES for joints in turning)
    if len(arms) != 2 or not sevens or overlap(schedule.stages):
        return None
    trajectory = schedule.trajectory
    columns = [trajectory.joints.index(joints[ELBOW]) for joints in turning]
    parts = [part for part in stage_parts(schedule) if len(part.arms) == 2]
    if not parts:
        return None
    before = np.array([part.stage.start for part in parts])
    sizes = []
    for name, column in zip(arms, columns, strict=True):
        after = np.array([part.arrival(name) for part in parts])
        moved = trajectory.clamped(after)[0][:, column] - trajectory.clamped(before)[0][:, column]
        sizes.append(np.abs(moved))
    return float(np.abs(sizes[0] - sizes[1]).mean())


def platform_travel(schedule: Schedule) -> float | None:
    """Compute the path length of the platform's joints, or None.

    Revolute joints count [rad]; prismatic joints only if all slide [m].
    """
    robot = schedule.robot
    if not robot.platform:
        return None
    joints = tuple(j for j in robot.platform if robot.platform_slides or j not in robot.sliding)
    return sum(joint_travel(schedule, joints).values())


def joint_travel(schedule: Schedule, joints: tuple[str, ...]) -> dict[str, float]:
    """Compute the path length of each joint [rad or m] between knots.

    Args:
        schedule: whose trajectory is measured.
        joints: names of the joints.
    """
    trajectory = schedule.trajectory
    length = np.abs(np.diff(trajectory.position, axis=0)).sum(axis=0)
    return {joint: float(length[trajectory.joints.index(joint)]) for joint in joints}


def stage_care(schedule: Schedule, job: Job) -> list[dict[str, str]]:
    """Describe the limits that slow each stage, such as `cup: speed 0.5`; empty for none."""
    stages = schedule.stages
    if not job.slows:
        return [{"care": ""} for _ in stages]
    return [{"care": ", ".join(dict.fromkeys(_of_stage(schedule, job, s)))} for s in stages]


def _of_stage(schedule: Schedule, job: Job, stage: Stage) -> Iterator[str]:
    """List the limits of one stage."""
    robot, name = schedule.robot, stage.bottleneck
    for task in job.tasks:
        events = [e for e in schedule.events if e.task == task.id]
        for arm in {e.arm for e in events}:
            times = {e.action: e.time for e in events if e.arm == arm}
            taken = min((times[a] for a in times if a in TAKES), default=np.inf)
            given = max((times[a] for a in times if a in GIVES), default=-np.inf)
            holds = taken < stage.start < given
            joints = (*robot.arms[arm].joints, *(robot.platform if holds else ()))
            limits = [(task.id, task.care)] if task.id in stage.tasks or holds else []
            limits += [(kind_of_part(task.part), task.holding)] if holds else []
            for of, care in limits:
                if name in joints or (name == TOOL_SPEED and care.tool_speed < np.inf):
                    yield from (f"{of}: {text}" for text in [_words(care)] if text)


def _words(care: Care) -> str:
    """Name the limits that slow a motion."""
    shares = {"speed": care.speed, "acceleration": care.acceleration}
    words = [f"{key} {share:.3g}" for key, share in shares.items() if share < 1.0]
    words += [f"tool speed {care.tool_speed:.3g} m/s"] if care.tool_speed < np.inf else []
    return " and ".join(words)
