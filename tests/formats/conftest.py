"""Plans that are exported."""

from __future__ import annotations

from dataclasses import dataclass

import pytest

from dualarm_cli.files.source.bundled import bundled_tasks
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.formats.request import ExportRequest
from dualarm_cli.model.job import Job
from dualarm_cli.model.schedule import Schedule


@dataclass(frozen=True)
class Exported:
    """A plan, and its job."""

    job: Job
    schedule: Schedule

    def request(self, rate: float = 100.0, interpolation: str = "cubic", **others) -> ExportRequest:
        """Returns a request for it."""
        return ExportRequest(self.schedule, self.job, rate, interpolation, **others)


@pytest.fixture(scope="session", params=["01_first_pick", "13_hand_over", "15_conveyor"])
def exported(request, quick_plan) -> Exported:
    """Plans with a platform, with parts that change hands, and with parts that move on a conveyor."""
    job = load_job(bundled_tasks()[request.param])
    return Exported(job, quick_plan(request.param))
