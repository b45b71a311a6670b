"""What is measured of seams as they are worked: the closed chain, speed, the part's motion, room to limits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.rotations import log_rotation
from dualarm_cli.kinematics.manipulability import manipulability
from dualarm_cli.kinematics.whole_body import WholeBody
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.model.seam import SeamWork
from dualarm_cli.verification.seam_places import OnSeam, on_seam
from dualarm_cli.verification.tool_model import ToolModel

SPACING = 0.005
"""Time between the instants at which bodies are measured [s]."""
STEADY = 0.999
"""Share of the largest speed from which on the tool counts as at its steady speed."""


@dataclass(frozen=True)
class SeamSamples:
    """One seam as it is worked."""

    task: str
    """Id of the task."""
    method: str
    """The seam solver."""
    work: SeamWork
    """What was asked for."""
    span: tuple[float, float]
    """From when to when [s]."""
    on: OnSeam
    """Tool and part at the verifier's instants."""
    time: FloatArray
    """Instants since the seam began [s], shape (k,)."""
    position: FloatArray
    """All joints [rad], shape (k, n)."""
    velocity: FloatArray
    """Their velocities [rad/s], shape (k, n)."""
    alone: dict[str, FloatArray]
    """Manipulability of each working arm by its own joints, shape (k,)."""

    @property
    def speed(self) -> FloatArray:
        """Speed along the seam at the verifier's instants, by differences [m/s], shape (m,)."""
        found: FloatArray = np.gradient(self.on.length, self.on.time)
        return found

    @property
    def lean(self) -> FloatArray:
        """By how much the tool's axis leans away from where it should point [rad], shape (m,)."""
        return self.on.lean


def seam_samples(schedule: Schedule, job: Job) -> list[SeamSamples]:
    """Returns the seams of a planned job as they are worked, in their order.

    Args:
        schedule: the plan.
        job: what it was planned for.
    """
    if not job.has_seams:
        return []
    model, body = ToolModel(schedule), WholeBody(job.cell)
    found = []
    for section in job.sections():
        work = section[0].seam
        if work is None:
            continue
        own = [
            s
            for s in schedule.segments
            if (s.kind, s.arm, s.task) == ("seam", work.slave, section[0].id) and s.end > s.start
        ]
        if own:
            found.append(_sampled(schedule, job, model, body, work, own[0]))
    return found


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
    q, qd, _ = schedule.trajectory.select(body.joints).at(time)
    own = body.moves & ~body.moves_carried
    rows = {arm: body.arms.index(arm) for arm in work.arms}
    alone: dict[str, list[float]] = {arm: [] for arm in work.arms}
    for configuration in q:
        J = body.at(configuration).J
        for arm, a in rows.items():
            alone[arm].append(float(manipulability(J[6 * a : 6 * a + 6][:, own[a]])))
    methods = [s.platform_solver for s in schedule.stages if segment.task in s.tasks]
    return SeamSamples(
        segment.task,
        methods[0] if methods else "",
        work,
        (segment.start, segment.end),
        on_seam(schedule, job, model, work, segment),
        time - segment.start,
        q,
        qd,
        {arm: np.array(values) for arm, values in alone.items()},
    )


def seam_measures(schedule: Schedule, job: Job) -> list[dict[str, Any]]:
    """Returns what is measured of every seam, JSON-ready; m, rad, s.

    Args:
        schedule: the plan, with its verification where there is one.
        job: what it was planned for.
    """
    limits = job.cell.robot.limits.scaled(job.speed)
    clearances = schedule.verification.clearances if schedule.verification is not None else ()
    return [
        _measured(schedule, job, seam, limits, clearances) for seam in seam_samples(schedule, job)
    ]


def _measured(
    schedule: Schedule, job: Job, seam: SeamSamples, limits: Any, clearances: Any
) -> dict[str, Any]:
    on, robot = seam.on, job.cell.robot
    working = [j for arm in robot.arms if arm.name in seam.work.arms for j in arm.joints]
    columns = robot.columns(working)
    room = np.minimum(seam.position - limits.lower, limits.upper - seam.position).min(axis=0)
    nearest = columns[int(np.argmin(room[columns]))]
    share = (np.abs(seam.velocity) / limits.velocity).max(axis=0)
    fastest = int(np.argmax(share))
    travel = np.abs(np.diff(seam.position, axis=0)).sum(axis=0)
    speed = seam.speed
    steady = np.flatnonzero(speed >= STEADY * speed.max())
    steps = log_rotation(np.swapaxes(on.R_part[:-1], -1, -2) @ on.R_part[1:])
    numbers = [
        k
        for k, stage in enumerate(schedule.stages)
        if seam.task in stage.tasks and stage.start <= seam.span[0] < stage.end
    ]
    clear = [c.clearance for c in clearances if c.stage in numbers]
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
        "part_way": float(np.linalg.norm(np.diff(on.p_part, axis=0), axis=1).sum()),
        "part_turn": float(np.linalg.norm(steps, axis=1).sum()),
        "part_xyz": on.p_part[0].tolist(),
        "part_rpy": pin.rpy.matrixToRpy(on.R_part[0]).tolist(),
        "least_manipulability": {arm: float(m.min()) for arm, m in seam.alone.items()},
        "manipulability": {arm: float(m.mean()) for arm, m in seam.alone.items()},
        "joint_travel": float(travel.sum()),
        "platform_travel": float(travel[robot.columns(robot.platform)].sum()),
        "limit_room": float(room[nearest]),
        "limit_joint": limits.joints[nearest],
        "speed_share": float(share[fastest]),
        "speed_joint": limits.joints[fastest],
        "clearance": min(clear, default=None),
    }
