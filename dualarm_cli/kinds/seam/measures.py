"""Measures of seams in a schedule, and their rows in reports."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinds.reporting import (
    KindMeasures,
    joint_use,
    least_clearance,
    methods_table,
    room_words,
)
from dualarm_cli.kinds.seam.checks import MeasuredSeam, OnSeam
from dualarm_cli.kinematics.manipulability import manipulability
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.job import Job
from dualarm_cli.model.process_work import SeamWork
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.tool_model import ToolModel

STANDS = 1e-6
"""Largest motion of a part that counts as standing [m, rad]."""


def seam_lines(report: dict[str, Any]) -> list[str]:
    """Write a sentence for every seam of a report.

    Args:
        report: as built by `build_report`.
    """
    lines = []
    for seam in report["seams"]:
        least = ", ".join(f"{arm} {m:.4g}" for arm, m in seam["least_manipulability"].items())
        start, end = seam["ramps"]
        lines.append(
            f"seam {seam['task']} by {seam['method']}: {seam['length'] * 1e3:.1f} mm at "
            f"{seam['speed'] * 1e3:.4g} mm/s in {seam['duration']:.3f} s "
            f"(ramps {start:.2f} and {end:.2f} s); chain closed to {_closed(seam)}; {part_words(seam)}; "
            + (
                f"tool leans up to {math.degrees(seam['lean']):.1f} deg; "
                if seam["lean"] > 1e-6
                else ""
            )
            + f"least manipulability {least}; {seam['limit_joint']} comes within "
            f"{room_words(seam)} of its limit, {seam['speed_joint']} uses "
            f"{seam['speed_share']:.0%} of its speed"
        )
    return lines


def _closed(seam: dict[str, Any]) -> str:
    """Format the residual of the chain; below a nanometre it means nothing."""
    off = seam["residual"]
    away = f"{off * 1e6:.2f} um" if off >= 1e-8 else f"{max(off * 1e9, 1.0):.0f} nm"
    return f"{away} and {seam['residual_angle'] * 1e6:.2f} urad"


def part_words(seam: dict[str, Any]) -> str:
    """Describe the pose of a resting part, or its motion."""
    x, y, z = seam["part_xyz"]
    roll, pitch, yaw = (math.degrees(angle) for angle in seam["part_rpy"])
    pose = f"xyz [{x:.4f}, {y:.4f}, {z:.4f}] m, rpy [{roll:.2f}, {pitch:.2f}, {yaw:.2f}] deg"
    if seam["part_way"] < STANDS and seam["part_turn"] < STANDS:
        travel = seam["platform_travel"]
        platform = 1e3 * travel if seam["platform_slides"] else math.degrees(travel)
        turns = ""
        if platform > 0.05:
            turns = f", the platform turns {platform:.1f} deg"
            if seam["platform_slides"]:
                turns = f", the platform moves {platform:.1f} mm"
        return f"the part stands at {pose}{turns}"
    distance, turn = seam["part_way"] * 1e3, math.degrees(seam["part_turn"])
    return f"the part moves {distance:.0f} mm and turns {turn:.0f} deg from {pose}"


def seams_table(section: dict[str, Any]) -> Any:
    """Build the table of each solver's seams; None without seams.

    Args:
        section: one member of the comparison's `comparisons`.
    """

    def cells(_: dict[str, Any], seam: dict[str, Any]) -> list[str]:
        least = seam["least_manipulability"]
        master = least.get(seam["master"])
        return [
            seam["method"],
            f"{seam['speed'] * 1e3:.4g}",
            f"{seam['duration']:.3f}",
            f"{seam['part_way'] * 1e3:.0f}",
            f"{math.degrees(seam['part_turn']):.0f}",
            f"{seam['residual'] * 1e6:.2f}",
            "–" if master is None else f"{master:.3g}",
            f"{least[seam['slave']]:.3g}",
        ]

    numbers = ("mm/s", "s", "part mm", "part °", "chain um", "M master", "M slave")
    return methods_table(section, "seam", ["solver"], numbers, cells)


SPACING = 0.005
"""Time between the instants at which bodies are measured [s]."""
STEADY = 0.999
"""Fraction of the largest speed from which on the speed counts as steady."""


@dataclass(frozen=True)
class SeamSamples:
    """Samples of one worked seam."""

    task: str
    """Id of the task."""
    method: str
    """The seam solver."""
    work: SeamWork
    """Seam as requested."""
    span: tuple[float, float]
    """Start and end [s]."""
    on: OnSeam
    """Tool and part at the verifier's instants."""
    time: FloatArray
    """Instants since the seam began [s], shape (k,)."""
    position: FloatArray
    """All joints [rad or m], shape (k, n)."""
    velocity: FloatArray
    """Velocities of all joints [rad/s or m/s], shape (k, n)."""
    arm_manipulability: dict[str, FloatArray]
    """Manipulability of each working arm by its own joints, shape (k,)."""

    @property
    def speed(self) -> FloatArray:
        """Speed along the seam at the verifier's instants [m/s], shape (m,)."""
        speeds: FloatArray = np.gradient(self.on.length, self.on.time)
        return speeds

    @property
    def lean(self) -> FloatArray:
        """Tilt of the tool's axis [rad], shape (m,)."""
        return self.on.lean


def seam_samples(schedule: Schedule, job: Job) -> list[SeamSamples]:
    """Sample the seams of a planned job, in their order.

    Args:
        schedule: the plan.
        job: its job.
    """
    if not job.has_seams:
        return []
    model, body = ToolModel(schedule), WholeBody(job.cell)
    samples = []
    for section in job.sections():
        work = section[0].seam
        if work is None:
            continue
        segments = [
            s
            for s in schedule.segments
            if (s.kind, s.arm, s.task) == ("seam", work.slave, section[0].id) and s.end > s.start
        ]
        if segments:
            samples.append(_sampled(schedule, job, model, body, work, segments[0]))
    return samples


def _sampled(
    schedule: Schedule,
    job: Job,
    model: ToolModel,
    body: WholeBody,
    work: SeamWork,
    segment: Segment,
) -> SeamSamples:
    count = max(2, int(np.ceil((segment.end - segment.start) / SPACING)) + 1)
    time = np.linspace(segment.start, segment.end, count)
    q, qd, _ = schedule.trajectory.select(body.joints).clamped(time)
    arm_columns = body.moves & ~body.moves_carried
    rows = {arm: body.arms.index(arm) for arm in work.arms}
    by_arm: dict[str, list[float]] = {arm: [] for arm in work.arms}
    for configuration in q:
        J = body.at(configuration).J
        for arm, a in rows.items():
            by_arm[arm].append(float(manipulability(J[6 * a : 6 * a + 6][:, arm_columns[a]])))
    methods = [s.platform_solver for s in schedule.stages if segment.task in s.tasks]
    return SeamSamples(
        segment.task,
        methods[0] if methods else "",
        work,
        (segment.start, segment.end),
        MeasuredSeam(schedule, job, model, work).during(segment),
        time - segment.start,
        q,
        qd,
        {arm: np.array(values) for arm, values in by_arm.items()},
    )


def seam_measures(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Measure every seam, JSON-ready [m, rad, s].

    Args:
        schedule: the plan, with its verification if there is one.
        job: its job.
    """
    return [_measured(schedule, job, seam) for seam in seam_samples(schedule, job)]


def _measured(schedule: Schedule, job: Job, seam: SeamSamples) -> dict[str, Any]:
    on, robot = seam.on, job.cell.robot
    working = [j for arm in robot.arms if arm.name in seam.work.arms for j in arm.joints]
    speed = seam.speed
    steady = np.flatnonzero(speed >= STEADY * speed.max())
    steps = log_rotation(product(np.swapaxes(on.R_part[:-1], -1, -2), on.R_part[1:]))
    numbers = [
        k
        for k, stage in enumerate(schedule.stages)
        if seam.task in stage.tasks and stage.start <= seam.span[0] < stage.end
    ]
    return {
        "task": seam.task,
        "method": seam.method,
        "master": seam.work.master,
        "slave": seam.work.slave,
        "length": seam.work.length,
        "duration": seam.span[1] - seam.span[0],
        "speed": float(np.median(speed[steady])),
        "ramps": [float(on.time[k] - on.time[0]) for k in steady[:1]]
        + [float(on.time[-1] - on.time[k]) for k in steady[-1:]],
        "residual": float(on.distance.max()),
        "residual_angle": float(on.angle.max()),
        "lean": float(on.lean.max()),
        "part_way": float(norm(np.diff(on.p_part, axis=0), axis=1).sum()),
        "part_turn": float(norm(steps, axis=1).sum()),
        "part_xyz": tuple(on.p_part[0].tolist()),
        "part_rpy": tuple(pin.rpy.matrixToRpy(on.R_part[0]).tolist()),
        "least_manipulability": {arm: float(m.min()) for arm, m in seam.arm_manipulability.items()},
        "manipulability": {arm: float(m.mean()) for arm, m in seam.arm_manipulability.items()},
        **joint_use(job, seam.position, seam.velocity, robot.columns(working)),
        "clearance": least_clearance(schedule, numbers),
    }


MEASURES = KindMeasures(
    "work", {"seams": seam_measures}, seam_lines, {"seams": seam_measures}, seams_table
)
