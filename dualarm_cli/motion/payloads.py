"""Payloads of the arms over a motion: parts and changed tools, from event to event."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pinocchio as pin

from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import ANY, GIVES, TAKES, Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class PayloadSpan:
    """Load of an arm during a span of time."""

    arm: str
    """Arm."""
    start: float
    """Start [s]."""
    end: float
    """End [s]."""
    held: Held
    """The part in its tool, or the tool."""
    task: str
    """Task that took it; empty for a tool that is on at the start."""

    @property
    def load(self) -> tuple[str, Held]:
        """Arm and what it holds, whenever that is."""
        return self.arm, self.held


def payload_spans(job: Job, motion: Motion) -> list[PayloadSpan]:
    """List what the arms carry, from event to event."""
    tasks = {(task.arm, task.id): task for task in job.tasks}
    loads, end = [], float(motion.trajectory.time[-1])
    for arm in (part.name for part in job.cell.robot.arms):
        # A tool that is on at the start stays on until it is left.
        taken: dict[bool, tuple[float, Held, str]] = {}
        if tool := job.cell.start_tool(arm):
            taken[True] = (0.0, Held(tool), "")
        for event in sorted(motion.events, key=lambda event: event.time):
            # A section's order may have chosen the arm of a task that any arm may do.
            task = tasks.get((event.arm, event.task)) or tasks.get((ANY, event.task))
            if event.arm != arm or task is None:
                continue
            if event.action in TAKES and (task.is_change or task.part):
                taken[task.is_change] = (
                    event.time,
                    Held(task.tool, "" if task.is_change else task.part),
                    task.id,
                )
            elif event.action in GIVES and task.is_change in taken:
                start, held, name = taken.pop(task.is_change)
                loads.append(PayloadSpan(arm, start, event.changes_held, held, name))
        loads += [PayloadSpan(arm, start, end, held, name) for start, held, name in taken.values()]
    return [load for load in loads if job.cell.load_inertia(load.arm, load.held).mass > 0.0]


def carried_inertias(job: Job, held: Sequence[PayloadSpan]) -> Mapping[str, pin.Inertia]:
    """Sum the inertias of the arms' loads."""
    total: dict[str, pin.Inertia] = {}
    for load in held:
        inertia = job.cell.load_inertia(load.arm, load.held)
        total[load.arm] = total[load.arm] + inertia if load.arm in total else inertia
    return total
