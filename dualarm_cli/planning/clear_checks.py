"""What no plan can keep clear, told before one is looked for."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.gripping import too_near
from dualarm_cli.errors import InfeasibleError, millimetres
from dualarm_cli.model.job import PoseTarget
from dualarm_cli.planning.holding import Holding
from dualarm_cli.planning.method import MethodProblem


def check_start(problem: MethodProblem, holding: Holding) -> None:
    """Refuses a start in which something touches: no motion begins there.

    Raises:
        InfeasibleError: with the posture, the bodies and what is missing.
    """
    job, cell = problem.job, holding.cell
    if job.start == "free":
        return
    position = np.array(job.cell.robot.postures[job.start])
    held = holding.before[0]
    one, other, margin = cell.nearest(position, held)
    if margin < 0.0:
        raise InfeasibleError(
            f"start: in posture '{job.start}' {one} and {other} lack {millimetres(margin)} of "
            f"clearance; start in another posture (`start: free` leaves it open), move what is in the way, or allow "
            "the pair less"
        )


def check_parts(problem: MethodProblem, holding: Holding) -> None:
    """Refuses parts that reach into something where they are picked or placed, and tools at stands: no posture helps.

    Raises:
        InfeasibleError: with task, part or tool, obstacle and depth, of all of them.
    """
    lines = []
    stages = problem.job.stages()
    for (k, arm), (depth, into) in holding.misfits.items():
        task, stop = stages[k][arm]
        if isinstance(stop.target, PoseTarget) and stop.target.free_yaw:
            continue  # between the turns that were tried there are others
        what = f"tool '{task.tool}'" if task.is_change else f"part '{task.part}'"
        lines.append(
            f"{stop.place}: task '{task.id}': where {arm} has to {stop.action.split('_')[0]} it or on the line there, "
            f"{what} reaches {millimetres(depth)} into '{into}', at best"
        )
    if lines:
        raise InfeasibleError(
            "no posture helps where a part or a tool reaches into something:\n  "
            + "\n  ".join(lines)
            + "\nwhat helps: another target or stand, a part or an obstacle of another size, a shorter line, or "
            "`allowed_contacts` for the two"
        )


def check_grips(problem: MethodProblem) -> None:
    """Refuses hand-overs in which tools or part are too near to each other: no posture changes that.

    Raises:
        InfeasibleError: with task, bodies and what is missing, of all of them.
    """
    tasks = problem.job.tasks
    takes = {task.id: task.stops[0] for task in tasks if task.stops[0].action == "take"}
    lines = []
    for task in tasks:
        work, give = task.handover, task.stops[-1]
        if work is None or give.action != "give":
            continue
        lengths = takes[task.id].approach, give.retract
        for one in too_near(problem.job.cell, work, task.id, task.part, *lengths):
            lines.append(
                f"{work.place}: task '{task.id}': {one.where} {' and '.join(one.bodies)} lack "
                f"{millimetres(one.margin)} of clearance"
            )
    if lines:
        raise InfeasibleError(
            "no posture helps where tools and part are too near to each other in a hand-over:\n  "
            + "\n  ".join(lines)
            + "\nwhat helps: another `grip`, a longer `approach` or `retract`, or a clearance of its own "
            "(`clearances`) for the two"
        )
