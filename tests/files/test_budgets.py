"""Budgets of task files: what is read, in which units, and what is refused with its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.tasks.tasks import load_job

TASKS = """\
dualarm: tasks/1
cell: cell.yaml
budget: BUDGET
tasks:
  - {id: a, arm: left, move: {xyz: [0.4, 0.1, 0.9]}}
"""


def write(project: Path, budget: str) -> None:
    """Writes a job with a budget."""
    (project / "tasks.yaml").write_text(TASKS.replace("BUDGET", budget))


@pytest.mark.parametrize(
    ("budget", "cycle_time", "clearance"),
    [
        ("{cycle_time: 12 s, clearance: 20 mm}", 12.0, 0.02),
        ("{cycle_time: 2 min}", 120.0, None),
        ("{clearance: 0}", None, 0.0),
        ("{cycle_time: 800 ms, clearance: 0.01}", 0.8, 0.01),
    ],
)
def test_budgets_are_read_with_their_units_and_places(
    project: Path, budget: str, cycle_time: float | None, clearance: float | None
) -> None:
    """Either figure or both; a job without one has none."""
    write(project, budget)
    found = load_job("tasks.yaml").budget
    assert found is not None
    assert (found.cycle_time, found.clearance) == (cycle_time, clearance)
    if cycle_time is not None:
        column = TASKS.splitlines()[2].index("BUDGET") + budget.index("cycle_time: ") + 13
        assert str(found.cycle_time_place) == f"tasks.yaml:3:{column}"
    (project / "tasks.yaml").write_text(TASKS.replace("budget: BUDGET\n", ""))
    assert load_job("tasks.yaml").budget is None


def test_a_delay_between_arms_needs_two_of_them(project: Path) -> None:
    """A cell of one arm has nothing to be late against, neither to plan for nor to compare with."""
    write(project, "{skew: 20 ms}")
    (project / "cell.yaml").write_text("dualarm: cell/1\nrobot: iiwa7\n")
    timed = (
        (project / "tasks.yaml").read_text().replace("tasks:\n", "timing: {skew: 20 ms}\ntasks:\n")
    )
    (project / "tasks.yaml").write_text(timed)
    with pytest.raises(InputError) as caught:
        load_job("tasks.yaml")
    refused = "E300 no other arm to be late against: KUKA LBR iiwa 7 R800 has one arm; remove it"
    for place in ("3:16", "4:16"):
        assert f"tasks.yaml:{place}: {refused}" in str(caught.value)


@pytest.mark.parametrize(
    ("budget", "place", "words"),
    [
        ("{}", "3:9", "an empty budget"),
        ("12 s", "3:9", "must be a mapping"),
        ("{cycle_time: 12 mm}", "3:22", "unit 'mm'"),
        ("{cycle_time: 0}", "3:22", "time must be positive"),
        ("{cycle_time: -1 s}", "3:22", "time must be positive"),
        ("{clearance: -1 mm}", "3:21", "length must be at least 0"),
        ("{cycle_time: .inf}", "3:22", "not"),
        ("{cycletime: 12 s}", "3:10", "did you mean 'cycle_time'"),
    ],
)
def test_what_is_no_budget_is_refused_at_its_place(
    project: Path, budget: str, place: str, words: str
) -> None:
    """With what is allowed."""
    write(project, budget)
    with pytest.raises(InputError) as error:
        load_job("tasks.yaml")
    assert f"tasks.yaml:{place}" in str(error.value)
    assert words in str(error.value)


def test_a_skew_is_asked_for_in_a_budget_and_of_the_planner(project: Path) -> None:
    """With its unit; twenty without one is no delay of an arm but a slip of the unit."""
    write(project, "{skew: 20 ms}")
    job = load_job("tasks.yaml")
    assert job.budget is not None
    assert (job.budget.skew, job.skew) == (0.02, 0.0)
    assert str(job.budget.skew_place) == "tasks.yaml:3:16"
    text = TASKS.replace("budget: BUDGET", "timing: {skew: 0.3}")
    (project / "tasks.yaml").write_text(text)
    assert load_job("tasks.yaml").skew == 0.3
    for wrong, words in (("20", "at most 1"), ("0 s", "must be positive"), ("5 mm", "unit 'mm'")):
        (project / "tasks.yaml").write_text(text.replace("0.3", wrong))
        with pytest.raises(InputError) as raised:
            load_job("tasks.yaml")
        assert words in str(raised.value)
