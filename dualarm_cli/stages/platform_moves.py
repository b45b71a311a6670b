"""Moves into a stage, as input of the platform solvers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.errors import UnsupportedError, UsageError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.platform_angle import PlatformProblem
from dualarm_cli.postures.stage_problems import stop_problems
from dualarm_cli.stages.method import MethodProblem
from dualarm_cli.stages.serving import why_no_closed_form
from dualarm_cli.stages.stage_by_stage import choose_stages
from dualarm_cli.stages.stage_choice import in_axis_frame, stage_problem


def stage_move(job: Job, stage: int) -> tuple[PlatformProblem, FloatArray]:
    """Return the move into a stage and both wrist positions before it.

    The stages before are planned with the `exact` platform solver. The wrists are where the transfer ends: at the start
    of the approach.

    Args:
        job: cell and tasks.
        stage: number of the stage, from 1.

    Returns:
        The problem of one move, and wrist centres in the platform's axis frame [m], shape (2, 3).

    Raises:
        UsageError: there is no such stage, or only one arm works in it.
        UnsupportedError: the robot has no platform of one revolute joint or not two arms.
    """
    if job.moves:
        raise UnsupportedError(
            "a single move has no time at which a part on a conveyor is met; `dualarm plan` plans the whole of it"
        )
    model = CellModel.from_cell(job.cell)
    if model.platform.is_rail:
        raise UnsupportedError(
            f"{job.cell.robot.name} has a platform that slides: there is no platform angle to choose; `dualarm plan` "
            "chooses its positions"
        )
    if not model.platform.is_turntable or len(model.arms) != 2:
        raise UnsupportedError(
            f"{job.cell.robot.name} is not two arms on one turning platform: no angle to choose"
        )
    if reason := why_no_closed_form(job.cell.robot):
        raise UnsupportedError(f"{job.cell.robot.name} has no elbows to balance: {reason}")
    if not job.is_decided:
        raise UsageError(
            "the tasks have no stages yet, as their arms or order are not fixed; plan them, or write order: given and "
            "arm: left or right"
        )
    work = job.stages()
    if not 1 <= stage <= len(work):
        raise UsageError(f"--stage {stage}: the tasks have stages 1 to {len(work)}")
    if len(work[stage - 1]) != 2:
        raise UsageError(f"--stage {stage}: only one arm works in it; choose a stage with both")
    if job.in_sections:
        raise UsageError(
            f"--stage {stage}: the tasks follow paths or seams, which are planned by themselves; name a task file of "
            "picks, places and moves"
        )
    # One stage more than lies before it where there is none: a free start is known only then.
    before_it = replace(job, returns=False)
    count = stage - 1 or (1 if job.start == "free" else 0)
    plans = choose_stages(MethodProblem(model, before_it, "arm_angle"), "exact", count=count)
    position = job.start_joints
    if plans:
        position = plans[-1].end if stage > 1 else plans[0].start
    stops = stop_problems(model, job, position, work[stage - 1])
    angle = float(position[model.platform_columns][0])
    before = [
        in_axis_frame(arm.wrist_center(*arm.forward(stops[name].start)), angle)
        for name, arm in ((name, model.arms[name].closed_form) for name in stops)
    ]
    return stage_problem(model, position, stops), np.array(before)
