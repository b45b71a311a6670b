"""The order of a job's file as one of its orders: what is found must not be slower than what the file says."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.model.job import Job
from dualarm_cli.planning.buffer_numbers import served_pairing, used_buffers


def file_order(job: Job) -> Job | None:
    """Returns a job in the order of its file; None where that is given, or tears apart what is done in a row.

    Jobs with paths or seams have it among the orders of their sections.

    Args:
        job: arms may be open; they are then searched for.
    """
    if job.order == "given" or job.in_sections:
        return None
    found = replace(job, order="given")
    # Searches for arms keep what is done in a row.
    if found.is_decided and not all(_in_a_row(found, row) for row in job.sequences):
        return None
    return found


def stage_by_stage(job: Job) -> Job:
    """Returns a job as paired arms do it: each makes its next stop as soon as what comes before it is over.

    Raises:
        InfeasibleError: in the order that is given arms wait for one another for ever.
    """
    if job.is_decided and used_buffers(job):
        return replace(job, mode="paired", pairing=served_pairing(job))
    found = replace(job, mode="paired")
    if found.is_decided:
        found.stages()  # raises where there are none
    return found


def _in_a_row(job: Job, row: tuple[str, ...]) -> bool:
    """Returns whether one arm does tasks right after one another."""
    names = {
        name: [t.id for t in job.tasks if t.arm == name] for name in {t.arm for t in job.tasks}
    }
    return any(
        tuple(own[k : k + len(row)]) == tuple(row)
        for own in names.values()
        for k in range(len(own) - len(row) + 1)
    )
