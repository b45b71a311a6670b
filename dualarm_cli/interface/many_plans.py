"""Plans of many jobs in parallel processes, for studies in Python."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from typing import Unpack

from dualarm_cli.background import usable_cores
from dualarm_cli.errors import DualArmError, InfeasibleError, check_type
from dualarm_cli.interface import Plan, PlanOptions, Progress, plan_settings, planned
from dualarm_cli.model.job import Job
from dualarm_cli.model.place import tasks_name
from dualarm_cli.model.settings import PlanSettings, check_count
from dualarm_cli.system import IS_LINUX, end_with_parent


def plan_many(
    jobs: Iterable[Job],
    *,
    processes: int | None = None,
    progress: Progress | None = None,
    **options: Unpack[PlanOptions],
) -> list[Plan | InfeasibleError]:
    """Plan jobs in parallel processes.

    Each plan is that of `plan`, for any number of processes.

    An interrupt ends after the jobs that are being planned.

    Args:
        jobs: jobs in any number.
        processes: maximum number of processes; None for one per core.
        progress: callback, called after each job with its index, name and cycle time.
        options: options of `plan`.

    Returns:
        The plan of each job in order, or the error where a job has none.

    Raises:
        UsageError: a value that is not allowed.
        DualArmError: a process ended early, as by lack of memory.
    """
    check_count("processes", processes)
    check_type("jobs", jobs, Iterable)
    settings, queued = plan_settings(**options), list(jobs)
    for job in queued:
        check_type("job", job, Job)
    count = min(processes or usable_cores(), len(queued))
    plans: dict[int, Plan | InfeasibleError] = {}
    work = partial(_plan, settings=settings)

    def keep(index: int, result: Plan | InfeasibleError) -> None:
        plans[index] = result
        if progress is not None:
            name = tasks_name(queued[index].inputs)
            figure = f"{result.cycle_time:.3f} s" if isinstance(result, Plan) else "no plan"
            times = [plan.cycle_time for plan in plans.values() if isinstance(plan, Plan)]
            best = f"; best cycle time {min(times):.3f} s" if times else ""
            which = f"job {index}{name and f' ({name})'}: {figure}"
            progress(f"{len(plans)} of {len(queued)} jobs, {which}{best}")

    if count <= 1:
        for index, job in enumerate(queued):
            keep(index, work(job))
    else:
        # A forked process needs no `if __name__ == "__main__"` in the caller's script.
        context = multiprocessing.get_context("fork" if IS_LINUX else None)
        start = (os.getpid(),)
        with ProcessPoolExecutor(count, context, _begin, start) as pool:
            try:
                places = {pool.submit(work, job): index for index, job in enumerate(queued)}
                for done in as_completed(places):
                    keep(places[done], done.result())
            except BrokenProcessPool:
                message = "a planning process ended early, perhaps for lack of memory; use fewer"
                raise DualArmError(f"plan_many: {message} processes") from None
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [plans[index] for index in range(len(queued))]


def _begin(parent: int) -> None:
    """Prepare a planning process, which its parent's interrupt does not end."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent(parent)


def _plan(job: Job, settings: PlanSettings) -> Plan | InfeasibleError:
    """Plan a job, or return the reasons why it has no plan."""
    try:
        return planned(job, settings)
    except InfeasibleError as error:
        return error
