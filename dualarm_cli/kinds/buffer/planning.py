"""Planner interface of buffers: a decided order needs parts and room for them."""

from __future__ import annotations

from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.model.job import Job
from dualarm_cli.orders.model.buffer_numbers import check_stage_levels


def checked_levels(job: Job) -> Job:
    """Check a job's buffer levels in the order of its stages.

    Returns the job.

    Raises:
        InfeasibleError: there is no part to take, or no room for one.
    """
    check_stage_levels(job)
    return job


PLANNING = KindPlanning(
    works=lambda task: any(stop.buffer for stop in task.stops), decided=checked_levels
)
