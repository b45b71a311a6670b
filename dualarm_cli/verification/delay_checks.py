"""Tolerated delay of one arm, as proven and as required."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from dualarm_cli.collision.solids import (
    Pair,
    bodies_without_shape,
    cell_solids,
    pairs_that_must_keep_apart,
)
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule, ScheduleRobot
from dualarm_cli.model.verification import LONGEST_DELAY, ArmDelay, Check, Verdict
from dualarm_cli.verification.clearance_checks import touching_spans
from dualarm_cli.verification.delay_proof import ALWAYS, ArmPair, DelayProof, Spans
from dualarm_cli.verification.holding_spans import carrying_spans
from dualarm_cli.verification.line_spans import LineSpan
from dualarm_cli.verification.motion_checks import not_checked

SKEW = "skew"
"""Name of the check; it is there only where the job asks for it."""


def arm_delays(schedule: Schedule, job: Job, spans: Sequence[LineSpan]) -> tuple[ArmDelay, ...]:
    """Prove the tolerated delay of each of two arms with shapes.

    Late are the arm's joints, its tool and what it carries. The other arm and a platform keep to the plan's time, and
    both arms stay where the plan ends. Not counted are what may touch in a hand-over or on a seam, parts on the lines
    where they are picked and placed, and parts that are fed to their picks. Other parts that wait or lie are first met
    where the arm that takes or brings them carries them, as long as the platform stands.

    Args:
        schedule: with finite numbers and rising times.
        job: as it was done.
        spans: of the job's stops.
    """
    robot = job.cell.robot
    if len(robot.arms) != 2 or any("links" in one for one in bodies_without_shape(job.cell)):
        return ()
    schedule = replace(schedule, robot=ScheduleRobot.of_job(job))
    model = pin.buildModelFromXML(robot.urdf)
    solids = cell_solids(job.cell, model, job.carried())
    touches = [touch for kind in of_kinds("checks") for touch in kind.touches(job, spans)]
    joints = [{model.getJointId(name) for name in arm.joints} for arm in robot.arms]
    pairs = []
    for pair in pairs_that_must_keep_apart(model, solids, job.cell):
        one, other = solids[pair.first], solids[pair.second]
        if one.joint in joints[1] and other.joint in joints[0]:
            pair, one, other = Pair(pair.second, pair.first, pair.required), other, one
        if one.joint not in joints[0] or other.joint not in joints[1]:
            continue
        there = [
            _to_the_ends(schedule, carrying_spans(schedule, job, solid))
            if solid.carrier
            else ALWAYS
            for solid in (one, other)
        ]
        excused = _to_the_ends(
            schedule,
            [
                span
                for gripped in (False, True)
                for span in touching_spans(touches, one, other, gripped=gripped)
            ],
        )
        pairs.append(ArmPair(pair, (there[0], there[1]), excused))
    if not pairs:
        return ()
    asked = [figure for figure in (job.skew, job.budget and job.budget.skew) if figure]
    proof = DelayProof(model, schedule.trajectory, solids, pairs, max([LONGEST_DELAY, *asked]))
    found = []
    for late, arm in enumerate(robot.arms):
        least, bodies = proof.bracket(late, asked), None
        if least.pair >= 0:
            pair = pairs[least.pair].pair
            bodies = solids[pair.first].label, solids[pair.second].label
        lacking = None if bodies is None else least.broken
        time = None if bodies is None else least.time
        found.append(ArmDelay(arm.name, least.proven, lacking, bodies, time))
    return tuple(found)


def check_skew(job: Job, delays: Sequence[ArmDelay]) -> list[Check]:
    """Judge the tolerated delay that a job requires, if any.

    Args:
        job: as it was done.
        delays: that the motion tolerates; empty where none was proven.
    """
    if not job.skew:
        return []
    if not delays:
        return [not_checked(SKEW, "delays need two arms whose links have shapes")]
    worst = min(delays, key=lambda one: one.clear)
    verdict: Verdict = "passed" if worst.clear >= job.skew else "failed"
    return [Check(SKEW, verdict, worst.clear, job.skew, "s", str(worst))]


def _to_the_ends(schedule: Schedule, spans: Spans) -> Spans:
    """Extend spans that reach an end of the motion beyond it."""
    first, last = schedule.trajectory.time[0], schedule.trajectory.time[-1]
    return [
        (-np.inf if begin <= first else begin, np.inf if end >= last else end)
        for begin, end in spans
    ]
