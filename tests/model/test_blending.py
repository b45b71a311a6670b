"""Blending laws: a family like the others, each with what every plan under it takes at least."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from dualarm_cli.cli.parts.options import Blend
from dualarm_cli.errors import UsageError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.blending import BLENDINGS, STOPPING, Blending
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings


def test_the_command_line_offers_the_family_and_takes_its_default_first():
    """The words of `--blend` are the names, and the default is the first of them."""
    assert sorted(one.value for one in Blend) == sorted(BLENDINGS.names)
    assert BLENDINGS.names[0] == PlanSettings().blend


@pytest.mark.parametrize("blending", list(BLENDINGS), ids=lambda one: one.name)
def test_no_law_takes_longer_than_from_rest_to_rest(blending: Blending):
    """What may pass in motion may stop as well: least times and reach bound those from rest to rest."""
    law = RestToRest(np.array([1.5, 3.0]), np.array([4.0, 20.0]), np.array([50.0, np.inf]))
    ways, times = np.linspace(0.0, 3.0, 31)[:, None], np.linspace(0.0, 2.0, 21)[:, None]
    least = blending.law(law)
    assert (least.per_joint(ways + np.zeros(2)) <= law.per_joint(ways + np.zeros(2))).all()
    assert (least.reachable_distance(times) >= law.reachable_distance(times) - 1e-12).all()


@pytest.mark.parametrize("blending", list(BLENDINGS), ids=lambda one: one.name)
def test_lines_are_no_longer_than_the_file_has_them(blending: Blending, tasks_folder):
    """And whole where tools stop at their ends, none of which is passed then."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    stops, straight = (
        [stop for task in one.tasks for stop in task.stops] for one in (job, blending.straight(job))
    )
    for stop, part in zip(stops, straight, strict=True):
        assert part.approach <= stop.approach
        assert part.retract <= stop.retract
    if blending is STOPPING:
        assert straight == stops
    assert any(map(blending.passes, stops)) == (blending is not STOPPING)


def test_a_schedule_with_a_law_that_there_is_not_is_refused():
    """With the name in it, and what there is; without any, tools stop."""

    def of(settings):
        schedule = SimpleNamespace(provenance=SimpleNamespace(settings=settings))
        return Schedule.blending.fget(schedule)

    assert of({}) is STOPPING
    assert of({"blend": "lines"}).name == "lines"
    for name in ("loops", ["lines"]):
        with pytest.raises(UsageError, match=r"settings\.blend .*lines, none; plan again"):
            of({"blend": name})
