"""The first tasks of the bundled packing job, those of both arms in turn."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from pathlib import Path

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job


def packing_job(tasks_folder: Path, count: int) -> Job:
    """Returns the job with its first tasks."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    arms = ([task for task in job.tasks if task.arm == arm] for arm in ("left", "right"))
    return replace(job, tasks=tuple(chain(*zip(*arms, strict=True)))[:count])
