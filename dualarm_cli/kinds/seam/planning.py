"""Planner interface of seams: each with the transfer to its approach."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.planning import (
    KindPlanning,
    Section,
    SectionBuilder,
    SectionTools,
    ToolPoses,
    add_transfer,
    drawn_out_transfer,
    tilt_faults,
)
from dualarm_cli.kinds.seam.closed_chain import SEAM_SOLVERS
from dualarm_cli.kinds.seam.messages import seam_bound, seam_faults, seam_notes
from dualarm_cli.kinds.seam.plan import SeamPlanner
from dualarm_cli.kinds.seam.record import PlannedSeam, add_seam
from dualarm_cli.kinematics.dynamics import Dynamics
from dualarm_cli.model.job import Job, PoseTarget
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.process_work import SeamWork
from dualarm_cli.motion.builder import Motion
from dualarm_cli.notes import Note
from dualarm_cli.refusals import Refusal

SAME = 1e-9
"""Tolerance of equal configurations [rad]."""
SEAMS_KEPT = Note(
    "sensitivity: seams count as constant, and so do waits for not_before", "sensitivity"
)
"""Note on the assumptions of sensitivities."""


def add_seam_section(
    tools: SectionTools,
    record: SectionBuilder,
    section: Section,
    current: FloatArray | None,
    after: Section,
) -> None:
    """Append a seam with the transfer to its approach.

    Args:
        tools: the planner.
        record: the plan so far.
        section: the seam's tasks, one per working arm.
        current: joints before it [rad or m], shape (n,); None for any.
        after: the next section; if it is a seam, its start counts.

    Raises:
        InfeasibleError: it cannot be worked.
    """
    work = section[0].seam
    assert work is not None
    job = tools.problem.job
    tools.problem.progress(f"working {section[0].id}")
    home = np.array(job.cell.robot.postures["home"])
    planner = SeamPlanner(
        job,
        tools.timing,
        tools.problem.effort,
        tools.problem.seed,
        tools.check_collisions,
        current is None,
        tools.settings.seam_solver,
        Dynamics(job.cell, {}) if tools.problem.limits_torques else None,
    )
    planned = planner.plan(
        section[0].id, work, home if current is None else current, after[0].seam if after else None
    )
    begin, name = record.clock, section[0].id
    if current is not None and np.abs(planned.start_joints - current).max() > SAME:
        try:
            transfer = tools.transfer(current, planned.start_joints)
        except InfeasibleError as error:
            data = {"cause": error}
            raise InfeasibleError(
                Refusal("no_way_to_seam", work.place, name, work.slave, data=data)
            ) from None
        motion, notes = tools.shaped(transfer)
        record.notes += notes
        _check_entry(work, job.speed, motion.trajectory.duration + planned.lead_time, name)
        add_transfer(record, _timed_entry(work, job.speed, motion, planned), section)
        record.count(transfer)
    else:
        _check_entry(work, job.speed, planned.lead_time, name)
    add_seam(record, tools.problem.model, section, planned, begin, job.speed)
    record.notes += seam_notes(job, section[0].id, work, planned.seam)


def _check_entry(work: SeamWork, pace: float, taken: float, task: str) -> None:
    """Refuse a motion to a seam that takes longer than its entry's duration.

    Raises:
        InfeasibleError: transfer, approach and dwell take more than the entry's duration.
    """
    allowed = math.inf if work.entry_duration is None else work.entry_duration / pace
    if taken > allowed + SAME_TIME:
        raise InfeasibleError(
            Refusal("entry_too_short", work.place, task, work.slave, taken, allowed)
        )


def _timed_entry(work: SeamWork, pace: float, motion: Motion, planned: PlannedSeam) -> Motion:
    """Stretch the transfer to a seam to the duration of its entry."""
    if work.entry_duration is None:
        return motion
    return drawn_out_transfer(motion, work.entry_duration / pace - planned.lead_time)


def seam_opens(section: Section) -> float:
    """Compute the earliest begin of a seam's dwell [s]."""
    work = section[0].seam
    assert work is not None
    return max(0.0, work.not_before - work.dwell_start)


def seam_poses(job: Job, section: Section, share: float) -> ToolPoses:
    """Return the known tool poses at a fraction of a seam.

    At its ends the slave's pose is that at the start of the approach and the end of the retract. Poses are unknown
    without the part's pose, and for a slave whose tool may tilt.
    """
    work = section[0].seam
    assert work is not None
    poses: dict[str, PoseTarget] = {}
    if work.master is not None and not work.hold.given:
        return poses
    part = work.part
    if work.master is not None:
        part = _pose(*work.hold.at(np.array([share])))
        flange = part * work.part.inverse()
        poses[work.master] = PoseTarget(flange * job.cell.tools[work.master].tcp)
    if work.tool.tilt == 0.0:
        line = {0.0: work.approach, 1.0: work.retract}.get(share, 0.0)
        offset = np.array([0.0, 0.0, -work.tool.standoff - line])
        tool = part * _pose(*work.tool_frames(np.array([share]))) * pin.SE3(np.eye(3), offset)
        poses[work.slave] = PoseTarget(tool, free_yaw=work.tool.free_spin)
    return poses


def _pose(R: FloatArray, p: FloatArray) -> pin.SE3:
    """Return the first pose of rotations (k, 3, 3) and positions (k, 3) [m]."""
    return pin.SE3(R[0], p[0])


def least_entry(job: Job, section: Section) -> float:
    """Return the entry's duration without the dwell at its end [s], or 0."""
    work = section[0].seam
    assert work is not None
    return max(
        0.0, (work.entry_duration or 0.0) / job.under(section[0].care).speed - work.dwell_start
    )


def least_time(job: Job, section: Section) -> float:
    """Compute the lower bound on a seam's duration [s]."""
    work = section[0].seam
    assert work is not None
    return seam_bound(work, job.under(section[0].care).speed)


PLANNING = KindPlanning(
    works=lambda task: task.seam is not None,
    solvers=SEAM_SOLVERS,
    setting="seam_solver",
    does="works seams",
    check=lambda job: [*seam_faults(job), *tilt_faults(job, "seam", seam_poses)],
    notes=lambda job, settings, motion: [SEAMS_KEPT],
    add=add_seam_section,
    opens=seam_opens,
    along=seam_poses,
    least_transfer=least_entry,
    least=least_time,
)
