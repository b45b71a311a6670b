"""Hand-overs: each arm's share of the task, and the part as it hangs in the taking tool."""

from __future__ import annotations

from dataclasses import replace

import pinocchio as pin

from dualarm_cli.model.cell import Cell
from dualarm_cli.model.handover import Handover, taken_part, with_taken_part
from dualarm_cli.model.job import PoseTarget, Stop, Task
from dualarm_cli.model.place import Place


def handover_shares(
    whole: Task,
    taker: str,
    stops: tuple[Stop, Stop],
    meeting: tuple[pin.SE3, pin.SE3],
    place: Place,
) -> list[Task]:
    """Returns the giver's share of a hand-over, pick and give, and the taker's, take and place.

    The taker approaches and grips while the giver stands still; then the giver lets go and retracts.

    Args:
        whole: the task with the giving arm and the part as it is picked, without stops.
        taker: the taking arm.
        stops: the pick and the place.
        meeting: the giving tool's pose in the world, and the taking tool's in the giving one's frame.
        place: where the hand-over is written.
    """
    pick, put = stops
    pose, grip = meeting
    work = Handover(whole.arm, taker, grip, place)
    give = Stop("give", PoseTarget(pose), 0.0, pick.retract, pick.dwell, place)
    take = Stop("take", PoseTarget(pose * grip), pick.approach, 0.0, pick.dwell, place)
    return [
        replace(whole, stops=(pick, give), handover=work),
        replace(
            whole,
            arm=taker,
            stops=(take, put),
            part=taken_part(whole.part, whole.id),
            handover=work,
        ),
    ]


def cell_with_taken_parts(cell: Cell, tasks: tuple[Task, ...]) -> Cell:
    """Returns a cell that knows every part that is handed over also as it hangs in the taking tool.

    Args:
        cell: as its file has it.
        tasks: of the job.
    """
    for task in tasks:
        work = task.handover
        # The giver's share comes first; the taker's part is the one that is made here.
        if work is not None and task.stops[0].action == "pick" and task.part:
            cell = with_taken_part(cell, task.part, task.id, work.grip)
    return cell
