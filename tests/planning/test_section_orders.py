"""Orders of paths among each other and of all other tasks around them."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.bound.job_bound import job_bound
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.planning.section_plans import section_orders
from dualarm_cli.verification import verify

CELL = """dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [0, 0, 120 mm]}}
clearance: 5 mm
"""
PATH = """  - id: {name}
    path:
      arm: {arm}
      speed: 200 mm/s
      through:
        - {{xyz: [0.50, {y}, 0.85], rpy: [180 deg, 0, 0]}}
        - {{xyz: [0.58, {y}, 0.85]}}
"""
PART = """  - id: {name}
    arm: {arm}
    pick:  {{xyz: [0.45, {y}, 0.90], rpy: [180 deg, 0, 0]}}
    place: {{xyz: [0.60, {y}, 0.90], rpy: [180 deg, 0, 0]}}
"""


@pytest.fixture(scope="module")
def job(tmp_path_factory):
    """A part, a path, a part, a path, a part: the file tears the parts apart for nothing."""
    folder = tmp_path_factory.mktemp("sections")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text(CELL)
    tasks = (
        PART.format(name="a", arm="left", y=0.35)
        + PATH.format(name="p", arm="left", y=0.20)
        + PART.format(name="b", arm="right", y=-0.35)
        + PATH.format(name="q", arm="right", y=-0.20)
        + PART.format(name="c", arm="right", y=-0.45)
    )
    head = "dualarm: tasks/1\ncell: cell.yaml\norder: optimise\nreturn: true\n"
    (folder / "tasks.yaml").write_text(f"{head}defaults: {{dwell: 0.1 s}}\ntasks:\n{tasks}")
    return load_job(folder / "tasks.yaml")


@pytest.fixture(scope="module")
def model(job):
    """Its cell."""
    return CellModel.from_cell(job.cell)


def with_after(job, pairs):
    """Returns the job with precedence: pairs of ids, the second one after the first."""
    tasks = tuple(
        replace(task, after=tuple(a for a, b in pairs if b == task.id)) for task in job.tasks
    )
    return replace(job, tasks=tasks)


def runs(job):
    """Returns how many runs of other tasks there are."""
    return sum(not section[0].alone for section in job.sections())


PAIRS = st.lists(
    st.tuples(st.sampled_from("apbqc"), st.sampled_from("apbqc")).filter(lambda p: p[0] < p[1]),
    max_size=4,
    unique=True,
)


@given(pairs=PAIRS)
@settings(max_examples=60, deadline=None)
def test_orders_keep_precedence_and_have_as_few_runs_as_may_be(job, model, pairs):
    """Against every order of the five tasks: all kept, the fewest runs among them, the file's order first."""
    asked = with_after(job, pairs)
    found = section_orders(model, asked, 1000)
    assert found[0].tasks == asked.tasks
    kept = []
    for order in permutations(asked.tasks):
        names = [task.id for task in order]
        if all(names.index(a) < names.index(b) for a, b in pairs):
            kept.append(replace(asked, tasks=order))
    for one in found[1:]:
        # Within a run precedence is kept when the run is ordered.
        place = {t.id: k for k, section in enumerate(one.sections()) for t in section}
        assert sorted(t.id for t in one.tasks) == ["a", "b", "c", "p", "q"]
        assert all(place[a] <= place[b] for a, b in pairs)
    fewest = min(runs(one) for one in kept)
    if len(found) > 1:
        assert runs(found[1]) == min(fewest, min(runs(one) for one in found[1:]))
    else:
        assert runs(found[0]) == fewest


def test_an_order_of_sections_that_is_quicker_is_taken_and_passes_every_check(job):
    """One run of parts in place of three; two of them side by side."""
    quick = PlanSettings(effort="quick")
    given = plan_without_bound(replace(job, order="given"), quick)
    found = plan_without_bound(job, quick)
    assert found.duration < 0.9 * given.duration
    assert verify(found, job).passed, [c for c in verify(found, job).checks if not c.passed]
    assert any("sections in another order" in note for note in found.notes)
    bound = job_bound(job, "quick").value
    assert 0.0 < bound <= found.duration
    # Torn apart as in the file the parts take longer: what bounds that order does not bound them all.
    assert bound <= job_bound(replace(job, order="given"), "quick").value + 1e-9


def test_precedence_between_paths_and_parts_is_kept_by_the_plan(job):
    """The second path before the first, and the last part before both."""
    asked = with_after(job, [("q", "p"), ("c", "q")])
    found = plan_without_bound(asked, PlanSettings(effort="quick"))
    judged = verify(found, asked)
    assert judged.passed, [c for c in judged.checks if not c.passed]
    first = {}
    for event in sorted(found.events, key=lambda event: event.time):
        first.setdefault(event.task, event.time)
    assert first["c"] < first["q"] < first["p"]


def test_both_shares_of_a_handover_stay_in_one_run(job, tasks_folder):
    """Whatever the order of the paths: else the arms would not meet."""
    handed = load_job(tasks_folder / "13_hand_over" / "tasks.yaml").tasks[:2]
    more = replace(job, tasks=(*job.tasks[:2], *handed, *job.tasks[2:]), order="optimise")
    orders = section_orders(CellModel.from_cell(more.cell), more, 24)
    assert len(orders) > 1
    for one in orders:
        assert sorted(t.id for t in one.tasks) == sorted(t.id for t in more.tasks)
        for section in one.sections():
            shares = [task.stops[0].action for task in section if task.handover is not None]
            assert shares in ([], ["pick", "take"])
        met = [stage for stage in one.stages() if "give" in {s.action for _, s in stage.values()}]
        assert [{s.action for _, s in stage.values()} for stage in met] == [{"give", "take"}]


def test_seams_that_open_late_bound_open_orders_by_the_best_one(tasks_folder):
    """The bound of all orders is that of the best of them, not of the file's: what waits may be done last."""
    whole = load_job(tasks_folder / "10_seam" / "tasks.yaml")
    seam = next(task for task in whole.tasks if task.seam is not None)
    opens = {"late": 100.0, "early": 0.0, "middle": 40.0}
    rows = [
        replace(seam, id=name, seam=replace(seam.seam, not_before=time))
        for name, time in opens.items()
    ]
    least = min(
        job_bound(replace(whole, tasks=tasks, order="given"), "quick").value
        for tasks in permutations(rows)
    )
    found = job_bound(replace(whole, tasks=tuple(rows), order="optimise"), "quick").value
    # Those of a given order are rounded down by 1e-5.
    assert found == pytest.approx(least, rel=2e-5)
    assert found < job_bound(replace(whole, tasks=tuple(rows), order="given"), "quick").value
