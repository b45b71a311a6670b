"""Throughput report of a schedule: the document behind every table.

It includes all waits of the arms with their reasons and lengths.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, cast, get_args

import numpy as np

from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job
from dualarm_cli.model.lying import lying_parts
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.place import tasks_name
from dualarm_cli.model.schedule import WORK_ENDS, Event, Schedule, Segment, Stage, WaitReason
from dualarm_cli.model.verification import Verification, nearest
from dualarm_cli.motion.waiting import MOVES
from dualarm_cli.notes import Note, filled
from dualarm_cli.records import field_values
from dualarm_cli.report.bodies import bodies, cell_notes
from dualarm_cli.report.document import Report
from dualarm_cli.report.measures import elbow_imbalance, joint_travel, platform_travel, stage_care
from dualarm_cli.report.sensitivity import sensitivity
from dualarm_cli.report.stage_parts import StageParts, blending_rows, stage_parts
from dualarm_cli.report.torques import torque_members
from dualarm_cli.verification.budget_checks import judge_budget
from dualarm_cli.verification.measuring.tolerances import TOL
from dualarm_cli.verification.motion_checks import jerk_fraction, velocity_extrema
from dualarm_cli.verification.varied_cycle import varied_cycle

SHORTEST_CYCLE = 1e-3
"""Shortest cycle with a meaningful throughput [s]."""
ASSUMED = {
    ("cell", "no_tool"): "no tool on {arm} arm",
    ("cell", "no_clearance"): "clearance 0 mm",
    ("dwell", "none"): "no dwell at {stops:# stop|# stops}",
}
"""Assumptions in short, by topic and key of their notes."""


def build_report(schedule: Schedule, job: Job) -> Report:
    """Build the report as a JSON-ready document [s, rad, m].

    Args:
        schedule: a planned schedule, with its verification where there is one.
        job: the planned job.
    """
    drawn = drawn_out(schedule)
    torques, stage_torques = torque_members(schedule, job)
    stages = _stage_rows(schedule), stage_torques, stage_care(schedule, job)
    members: dict[str, Any] = {
        "format": "dualarm.report/1",
        "robot": schedule.robot.name,
        "cycle_time": schedule.duration,
        "closes": job.returns,
        "parts": count_parts(job),
        "parts_per_hour": throughput(schedule, job),
        "lower_bound": schedule.lower_bound,
        "gap": relative_gap(schedule),
        "grid_gap": schedule.grid_gap,
        "order_grid_gap": schedule.order_grid_gap,
        "mode": job.mode,
        "order": job.order,
        "open": not job.is_decided,
        "bodies": bodies(job),
        "collisions": _collisions(schedule),
        "smallest_clearance": smallest_clearance(schedule),
        "near_links": _near_links(schedule),
        "skew": skew_sentence(schedule.verification, job),
        "clearance_cost": schedule.clearance_cost,
        "blending": blending_rows(schedule, job),
        "budget": [
            field_values(line) | {"text": str(line)} for line in judge_budget(schedule, job)
        ],
        "varying": _varying(schedule, job),
        **_kind_rows("work", schedule, job),
        "stages": [
            row | {"torque": torque} | care for row, torque, care in zip(*stages, strict=True)
        ],
        "torques": torques,
        "bottlenecks": _bottlenecks(schedule),
        "arms": {
            name: _arm_use(schedule, name) | {"drawn_out_for_platform": drawn[name]}
            for name in schedule.robot.arms
        },
        **_kind_rows("arms", schedule, job),
        "waits": wait_rows(schedule, job),
        **_kind_rows("waits", schedule, job),
        "limits_used": _limits_used(schedule),
        "sliding_joints": [j for j in schedule.trajectory.joints if j in schedule.robot.sliding],
        "platform_slides": schedule.robot.platform_slides,
        "platform_travel": platform_travel(schedule) or 0.0,
        "elbow_imbalance": elbow_imbalance(schedule),
        "joint_travel": joint_travel(schedule, schedule.trajectory.joints),
        "speed": job.speed,
        "tool_speed_cap": job.tool_speed,
        "assumed_limits": assumed_joints(schedule),
        "assumptions": assumed_lines(schedule),
        "without_jerk_limit": joints_without_jerk_limit(schedule),
        "sensitivity": [field_values(entry) for entry in sensitivity(_as_capped(schedule, job))],
        "verification": verification_document(schedule.verification),
        "settings": dict(schedule.provenance.settings),
        "notes": [*cell_notes(job), *schedule.notes],
    }
    members["assumed"] = _assumptions(members)
    return cast(Report, members)


def _assumptions(members: Mapping[str, Any]) -> list[str]:
    """List in short what the result assumes."""
    counts = (
        ("limits of {of:# joint|# joints}", members["assumed_limits"]),
        ("no jerk limit of {of:# joint|# joints}", members["without_jerk_limit"]),
        ("no shape of {of:# part|# parts}", members["bodies"]["without_part"]),
    )
    texts = [filled(text, {"of": of}) for text, of in counts if of]
    checks = (members["verification"] or {"checks": []})["checks"]
    for check in checks:
        if (check["name"], check["verdict"]) == ("torque", "not checked"):
            measured = check["measured"] is not None
            texts.append("torques (no limit)" if measured else "torques (unchecked)")
    noted = [n for n in members["notes"] if isinstance(n, Note) and (n.topic, n.key) in ASSUMED]
    return texts + [filled(ASSUMED[note.topic, note.key], note.data) for note in noted]


def _varying(schedule: Schedule, job: Job) -> dict[str, Any] | None:
    """Build the row of cycle times with dwells that vary, with a sentence, or None."""
    varied = varied_cycle(schedule, job)
    if varied is None:
        return None
    text = (
        f"{varied.dwells} dwells vary: 95 % of the cycles take at most {varied.percentile_95:.3f} s (dwells "
        f"independent), the longest {varied.worst:.3f} s (all at their longest)"
    )
    return field_values(varied) | {"text": text}


def _kind_rows(section: str, schedule: Schedule, job: Job) -> dict[str, Any]:
    """Collect the measures of the kinds of work in a section of the report."""
    kinds = [kind for kind in of_kinds("measures") if kind.report_section == section]
    return {key: rows(schedule, job) for kind in kinds for key, rows in kind.rows.items()}


def count_parts(job: Job) -> int:
    """Count the tasks that pick or place; a hand-over counts once."""
    picks = (t.id for t in job.tasks if any(stop.action in ("pick", "place") for stop in t.stops))
    return len(set(picks))


def throughput(schedule: Schedule, job: Job) -> float | None:
    """Compute the parts per hour; None for a motion too short."""
    duration = schedule.duration
    return 3600.0 * count_parts(job) / duration if duration > SHORTEST_CYCLE else None


def plan_title(schedule: Schedule) -> str:
    """Name a plan by task file, folder of `tasks.yaml`, or robot."""
    return tasks_name(schedule.provenance.inputs) or schedule.robot.name


def relative_gap(schedule: Schedule) -> float | None:
    """Compute (duration - lower bound) / duration; None without a bound."""
    bound, duration = schedule.lower_bound, schedule.duration
    return (duration - bound) / duration if bound is not None and duration > 0 else None


def assumed_joints(schedule: Schedule) -> list[str]:
    """Return the joints whose acceleration or jerk limits are assumed."""
    limits = schedule.robot.limits
    assumed = {*limits.assumed("acceleration"), *limits.assumed("jerk")}
    return [joint for k, joint in enumerate(limits.joints) if k in assumed]


def assumed_lines(schedule: Schedule) -> list[str]:
    """Return a sentence for each kind of limit that is assumed, with its joints."""
    limits = schedule.robot.limits
    accelerations = set(limits.assumed("acceleration"))
    jerks = {k for k in limits.assumed("jerk") if np.isfinite(limits.jerk[k])}
    kinds = (
        ("acceleration and jerk", accelerations & jerks),
        ("acceleration", accelerations - jerks),
        ("jerk", jerks - accelerations),
    )
    return [
        f"{kind} limits are assumed, not the maker's, for {len(columns)} joints: "
        f"{', '.join(limits.joints[k] for k in sorted(columns))}"
        for kind, columns in kinds
        if columns
    ]


def joints_without_jerk_limit(schedule: Schedule) -> list[str]:
    """List the joints without a jerk limit."""
    limits = schedule.robot.limits
    return [j for j, jerk in zip(limits.joints, limits.jerk, strict=True) if np.isinf(jerk)]


def smallest_clearance(schedule: Schedule) -> dict[str, Any] | None:
    """Find the stage with the least clearance margin (`nearest`), or None without a proof."""
    stages = schedule.verification.clearances if schedule.verification is not None else ()
    return None if (stage := nearest(stages)) is None else field_values(stage)


def _near_links(schedule: Schedule) -> dict[str, Any] | None:
    """Find the near links with the least clearance margin, or None."""
    stages = schedule.verification.clearances if schedule.verification is not None else ()
    near = [stage for stage in stages if stage.near]
    return field_values(nearest(near)) if near else None


def _collisions(schedule: Schedule) -> str:
    """Compose the sentence on the proven clearance."""
    stage = smallest_clearance(schedule)
    if stage is None:
        return "not checked"
    body_a, body_b = stage["bodies"]
    verdict = "none" if stage["margin"] >= -TOL.clearance_slack else "CLEARANCE MISSED"
    caveats = schedule.verification.caveats if schedule.verification is not None else ()
    text = (
        f"{verdict}{' between bodies with shapes' if caveats else ''}; least clearance proven: "
        f"{stage['clearance'] * 1e3:.1f} mm where {stage['required'] * 1e3:.1f} mm are required, "
        f"{body_a} and {body_b} at {stage['time']:.3f} s"
    )
    near = _near_links(schedule)
    if near is not None and not stage["near"]:
        text += f"; near links: {near['clearance'] * 1e3:.1f} mm, {' and '.join(near['bodies'])}"
    return text


def skew_sentence(verification: Verification | None, job: Job) -> str | None:
    """Write a sentence on each arm's tolerated delay, or None.

    Args:
        verification: of a plan.
        job: the planned job.
    """
    if verification is None or not verification.delays:
        return None
    delays = verification.delays
    if all(delay.lacking is None and delay.clear == delays[0].clear for delay in delays):
        delays = (replace(delays[0], arm="either"),)
    text = ", ".join(map(str, delays))
    together = dict.fromkeys(
        task.id
        for task in job.tasks
        if task.handover or (task.seam and (task.seam.master or task.seam.touches))
    )
    if together:
        text += f"; both arms work together in {', '.join(together)}, which needs them in step"
    if any(part.fed for part in lying_parts(job, [(t, s) for t in job.tasks for s in t.stops])):
        text += "; parts that are fed to their picks are not counted"
    return text


def verification_document(verification: Verification | None) -> dict[str, Any] | None:
    """Build the document of a verification, JSON-ready, or None."""
    if verification is None:
        return None
    return {
        "passed": verification.passed,
        "caveats": list(verification.caveats),
        "checks": [field_values(check) for check in verification.checks],
        "clearances": [field_values(stage) for stage in verification.clearances],
        "delays": [field_values(delay) for delay in verification.delays],
    }


def _stage_rows(schedule: Schedule) -> list[dict[str, Any]]:
    parts = stage_parts(schedule) if schedule.stages else []
    timed = {(part.task, part.action) for part in schedule.segments}
    # With a free start and without lines and dwell a stop takes no time.
    untimed = [e for e in schedule.events if timed and (e.task, e.action) not in timed]
    return [_stage_row(part.stage, _work(part, schedule, untimed)) for part in parts]


def _work(parts: StageParts, schedule: Schedule, untimed: Sequence[Event]) -> list[dict[str, str]]:
    """List the work of each arm in a stage, without arms that only wait."""
    work = []
    for arm in schedule.robot.arms:
        arm_work: list[Segment | Event] = [part for part in parts.arms.get(arm, ()) if part.task]
        arm_work = arm_work or [e for e in untimed if e.arm == arm and e.task in parts.stage.tasks]
        work += [{"arm": arm, "action": part.action, "task": part.task} for part in arm_work[-1:]]
    return work


def _stage_row(stage: Stage, work: list[dict[str, str]]) -> dict[str, Any]:
    row = field_values(stage) | {"duration": stage.end - stage.start}
    del row["arm"]
    return row | {"tasks": list(stage.tasks), "work": work}


def _as_capped(schedule: Schedule, job: Job) -> Schedule:
    """Let transfers that care slows count as slowed by a limit of tool speed."""
    if not job.slows or job.tool_speed is not None:
        return schedule
    return replace(schedule, robot=replace(schedule.robot, tool_speed=np.inf))


def _bottlenecks(schedule: Schedule) -> dict[str, int]:
    """Count the stages by the joint that decides them, largest first."""
    names = [stage.bottleneck for stage in schedule.stages if stage.bottleneck]
    counts = {name: names.count(name) for name in sorted(set(names))}
    return dict(sorted(counts.items(), key=lambda item: -item[1]))


def _arm_use(schedule: Schedule, arm: str) -> dict[str, Any]:
    """Compute how long one arm does each activity [s], and its working fraction."""
    times = dict.fromkeys(("transfer", "approach", "dwell", "retract", "return", *WORK_ENDS), 0.0)
    shares = dict.fromkeys(("gripper", "settle", "handshake"), 0.0)
    for segment in schedule.segments:
        if segment.arm != arm:
            continue
        if segment.kind in times:
            times[segment.kind] += segment.end - segment.start
        if segment.dwell is not None:
            for name in shares:
                shares[name] += getattr(segment.dwell, name)
    busy = sum(times.values())
    duration = schedule.duration
    waiting = max(0.0, duration - busy)
    return times | {
        "dwell_shares": shares,
        "waiting": waiting,
        "waited": waited(schedule, arm),
        "utilisation": busy / duration if duration > 0 else 0.0,
    }


def _limits_used(schedule: Schedule) -> dict[str, dict[str, float]]:
    """Compute the largest used fraction of each limit of each joint."""
    trajectory = schedule.trajectory
    limits = schedule.robot.limits.select(trajectory.joints)
    peak = {
        "velocity": velocity_extrema(trajectory) / limits.velocity,
        "acceleration": np.abs(trajectory.acceleration).max(axis=0) / limits.acceleration,
        "jerk": jerk_fraction(trajectory, limits),
    }
    return {
        joint: {name: float(share[k]) for name, share in peak.items()}
        for k, joint in enumerate(trajectory.joints)
    }


REASONS: tuple[str, ...] = get_args(WaitReason)[1:]
UNSTATED = "unstated"
"""Reason of a wait without a stated reason."""
SAME_LENGTH = 1e-6
"""Tolerance of equal times [s]."""


def wait_rows(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """List every wait as a JSON-ready row, in time order.

    Times are in s. `task` is what the arm is about to do, `for` the arm and task that it waits for; both None where
    that is not known, `for` also where it waits for the platform or for a time. Of the other arm it is what it does
    when the wait ends.

    Args:
        schedule: with segments.
        job: what it was planned for: it says which tasks come after which.
    """
    work = _arm_work(schedule)
    after = {task.id: task.after for task in job.tasks}
    waits = sorted(
        (s for s in schedule.segments if s.kind == "wait" and s.end - s.start > SAME_LENGTH),
        key=lambda part: (part.start, part.arm),
    )
    ends = {why: find for kind in of_kinds("measures") for why, find in kind.waits.items()}
    rows = []
    for wait in waits:
        cause: Segment | Event | None = None
        # Reasons that depend on the other arm.
        if wait.reason in ("partner", "shared_zone", "end"):
            cause = _meanwhile(wait, work)
        elif wait.reason == "after":
            cause = _before(wait, after.get(wait.task, ()), work)
        elif wait.reason in ends:
            cause = ends[wait.reason](wait, schedule, job)
        rows.append(
            {
                "arm": wait.arm,
                "start": wait.start,
                "end": wait.end,
                "length": wait.end - wait.start,
                "reason": wait.reason or UNSTATED,
                "task": wait.task or None,
                "for": cause and {"arm": cause.arm, "task": cause.task or None},
            }
        )
    return rows


def waited(schedule: Schedule, arm: str) -> dict[str, float]:
    """Sum an arm's waiting times by reason [s].

    All reasons are keys; `unstated` is one if the schedule gives no reason for a wait.
    """
    times = dict.fromkeys(REASONS, 0.0)
    for part in schedule.segments:
        if part.arm == arm and part.kind == "wait":
            reason = part.reason or UNSTATED
            times[reason] = times.get(reason, 0.0) + part.end - part.start
    return times


def drawn_out(schedule: Schedule) -> dict[str, float]:
    """Compute by how much the platform lengthens each arm's transfers [s].

    Platform and arms leave together, and an arm that would be there before the platform moves more slowly instead of
    waiting at the end. What it would wait is the platform's own time less the arm's, in each transfer that lasts as
    long as the platform's.

    Args:
        schedule: with stages and segments.
    """
    times = dict.fromkeys(schedule.robot.arms, 0.0)
    segments = {(s.arm, s.start, s.end) for s in schedule.segments if s.kind in MOVES}
    for stage_part in stage_parts(schedule):
        stage = stage_part.stage
        for arm, parts in stage_part.arms.items():
            alone = stage.arm_times.get(arm)
            if alone is None or arm not in times:
                continue
            for part in parts:
                lasts = abs(part.end - part.start - stage.platform_time) <= SAME_LENGTH
                # A transfer that ends with a wait for the platform was not slowed.
                if part.kind in MOVES and lasts and (arm, part.start, part.end) in segments:
                    times[arm] += max(0.0, stage.platform_time - alone)
    return times


def _arm_work(schedule: Schedule) -> dict[str, list[Segment]]:
    """List each arm's segments without waits, in time order."""
    work: dict[str, list[Segment]] = {}
    for part in sorted(schedule.segments, key=lambda part: part.start):
        if part.kind != "wait":
            work.setdefault(part.arm, []).append(part)
    return work


def _meanwhile(wait: Segment, work: Mapping[str, Sequence[Segment]]) -> Segment | None:
    """Find the segment of another arm at the end of a wait, or None.

    Of several it is the one that ends last.
    """
    candidates = []
    for arm, parts in work.items():
        last = bisect_left(parts, wait.end - SAME_TIME, key=lambda part: part.start) - 1
        if arm != wait.arm and last >= 0 and parts[last].end > wait.start + SAME_TIME:
            candidates.append(parts[last])
    return max(candidates, key=lambda part: part.end, default=None)


def _before(
    wait: Segment, after: Sequence[str], work: Mapping[str, Sequence[Segment]]
) -> Segment | None:
    """Find the last segment, by a wait's end, of its predecessor tasks, or None."""
    candidates = [
        part
        for parts in work.values()
        for part in parts
        if part.task in after and part.end <= wait.end + SAME_LENGTH
    ]
    return max(candidates, key=lambda part: part.end, default=None)
