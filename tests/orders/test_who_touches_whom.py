"""Which stops of two arms are not made in one stage: the table of all pairs, and when lines that touch are repaired."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from dualarm_cli.clearing import blocked as clear_words
from dualarm_cli.clearing.repairs import TimedPlan
from dualarm_cli.effort import EFFORTS, ClearanceSettings
from dualarm_cli.errors import BlockedError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.orders.model import meeting
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.refusals import Refusal, message


@pytest.fixture(scope="module")
def packing(tasks_folder):
    """All targets of a cell for both arms, each in the cheapest posture at three platform angles."""
    job = load_job(tasks_folder / "04_packing" / "tasks.yaml")
    tasks = tuple(dataclasses.replace(t, arm="any") for t in job.tasks)
    order = OrderModel.of(CellModel.from_cell(job.cell), dataclasses.replace(job, tasks=tasks))
    stops = [(t, s) for t, task in enumerate(order.tasks) for s in range(len(task.stops))]
    reached = order.reached().any(axis=(0, 1))
    angles = np.flatnonzero(reached)[[0, reached.sum() // 2, -1]]
    chosen = []
    for name in order.model.arms:
        own = np.full((3, len(stops), 3, 7), np.nan)
        for k, (t, s) in enumerate(stops):
            for f, angle in enumerate(angles.tolist()):
                rows = order.rows(name, t, s, angle)
                if len(rows):
                    nodes = order.nodes[name, t, s]
                    places = nodes.q_approach, nodes.q_target, nodes.q_retract
                    own[:, k, f] = [place[rows[0]] for place in places]
        chosen.append(own)
    return order, stops, chosen


def test_pairs_touch_where_arms_do_at_the_same_place_of_their_lines(packing):
    """One posture after the other: at both ends of both lines, and half-way."""
    order, stops, chosen = packing
    table = meeting.meeting_costs(order, stops, chosen)
    held = meeting._held(order, stops)
    columns = [order.model.arms[name].columns for name in order.model.arms]
    seen = {0.0: 0, np.inf: 0}
    rng = np.random.default_rng(0)
    for i, j in rng.integers(len(stops), size=(60, 2)).tolist():
        for f in range(3):
            one, other = chosen[0][:, i, f], chosen[1][:, j, f]
            if np.isnan(one).any() or np.isnan(other).any():
                assert table[i, j, f] == 0.0
                continue
            least = np.inf
            for a, b, share in ((0, 0, 0), (0, 1, 0.5), (1, 1, 0), (1, 2, 0.5), (2, 2, 0)):
                position = np.array(order.start)
                position[columns[0]] = one[a] + share * (one[b] - one[a])
                position[columns[1]] = other[a] + share * (other[b] - other[a])
                both = np.array([[held[i], held[j]]])
                least = min(least, float(order.clearance.cross_margins(position[None], both)[0]))
            assert table[i, j, f] == (np.inf if least < 0.0 else 0.0)
            seen[table[i, j, f]] += 1
    assert min(seen.values()) >= 5
    assert (table[-2:] == 0.0).all()
    assert (table[:, -2:] == 0.0).all()


def test_how_many_are_looked_at_at_once_and_what_is_far_apart_change_nothing(packing, monkeypatch):
    """Seven pairs at once; and all of them along their lines, however far apart they are."""
    table = meeting.meeting_costs(*packing)
    for name, value in (("AT_ONCE", 7), ("FAR", np.inf)):
        with monkeypatch.context() as patch:
            patch.setattr(meeting, name, value)
            np.testing.assert_array_equal(meeting.meeting_costs(*packing), table)


@pytest.mark.parametrize(("stages", "few"), [(10, 1), (100, 2), (300, 6)])
def test_a_few_stages_in_which_lines_touch_are_mended_more_are_refused(stages, few, monkeypatch):
    """One of fifty stages; one in any case."""

    class Blocked:
        """Its first stages touch."""

        settings = EFFORTS["normal"].clearing

        settings = ClearanceSettings()

        def __init__(self, count):
            self.count = count

        def colliding_stages(self, plans, _motion):
            return list(range(len(plans)))

        def side_by_side(self, _plans, colliding_stages):
            return colliding_stages[: self.count]

    monkeypatch.setattr(clear_words, "why_blocked", lambda *_: [Refusal("not_clear")])
    plan = TimedPlan([None] * stages, None)
    clear_words.refuse_touching_lines(Blocked(few), plan)
    with pytest.raises(BlockedError) as caught:
        clear_words.refuse_touching_lines(Blocked(few + 1), plan)
    assert caught.value.stages == tuple(range(few + 1))


@pytest.mark.parametrize("start", ["free", "home"])
def test_an_arm_that_stands_where_it_started_is_told_with_a_way_out(
    start, tasks_folder, monkeypatch
):
    """The left arm works in two stages, the right one from the third on; only while it stands is that said of it."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    stop, task = SimpleNamespace(place=None), SimpleNamespace(id="a")
    work = SimpleNamespace(arm="left", stop=stop, task=task)
    plans = [SimpleNamespace(stops={arm: work}) for arm in ("left", "left", "right", "left")]
    cell = SimpleNamespace(
        margins=lambda *_: np.array([-1.0, 0.0]),
        cross_margins=lambda *_: np.zeros(1),
        nearest=lambda *_: ("l", "r", -1.0),
        skew=0.0,
        least_spare_tilt=lambda *_: ("left", np.inf),
    )
    clearing = SimpleNamespace(
        job=dataclasses.replace(job, start=start),
        holding=SimpleNamespace(cell=cell),
        model=SimpleNamespace(platform=SimpleNamespace(is_chosen=False)),
        tried={"delays"},
    )
    samples = SimpleNamespace(position=np.zeros((2, 14)), held=np.zeros((2, 2)))
    monkeypatch.setattr(clear_words, "stage_samples", lambda *_: samples)
    motion = SimpleNamespace(stages=[SimpleNamespace(start=0.0, end=1.0)] * 4)

    def said_of(*blocked):
        found = TimedPlan(plans, motion, blocked)
        return message(clear_words.why_blocked(clearing, found))

    said = "the right arm stands in posture 'home' before stage 3, its first: a `move`"
    assert said in said_of(1, 3)
    assert ("in stage 1 it starts there" in said_of(1)) == (start == "free")
    assert "stands in posture" not in said_of(2, 3)
    assert "left arm stands" not in said_of(0)
    # Nobody bent a transfer, and there is no platform to turn.
    assert said_of(0).splitlines()[0].endswith("was found (tried: other postures, delays):")


@pytest.mark.parametrize(
    ("margin", "what"), [(0.001, "stage_lacks_skew"), (-0.001, "stage_touches")]
)
def test_a_stage_that_is_clear_in_step_lacks_room_for_a_late_arm(
    tasks_folder, monkeypatch, margin, what
):
    """With 50 ms asked for: what touches anyhow is told as that."""
    job = load_job(tasks_folder / "05_two_robots" / "tasks.yaml")
    work = SimpleNamespace(
        arm="left", stop=SimpleNamespace(place=job.tasks[0].place), task=SimpleNamespace(id="a")
    )
    cell = SimpleNamespace(
        margins=lambda *_: np.array([margin, 1.0]),
        cross_margins=lambda *_: np.array([margin]),
        nearest=lambda *_: ("l", "r", margin),
        skew=0.05,
        least_spare_tilt=lambda *_: ("left", np.inf),
    )
    clearing = SimpleNamespace(
        job=job,
        holding=SimpleNamespace(cell=cell),
        model=SimpleNamespace(platform=SimpleNamespace(is_chosen=False)),
        tried=set(),
    )
    samples = SimpleNamespace(position=np.zeros((2, 14)), held=np.zeros((2, 2)))
    monkeypatch.setattr(clear_words, "stage_samples", lambda *_: samples)
    motion = SimpleNamespace(stages=[SimpleNamespace(start=0.0, end=1.0)])
    found = TimedPlan([SimpleNamespace(stops={"left": work})], motion, (0,))
    [refusal] = clear_words.why_blocked(clearing, found)
    assert (refusal.key, refusal.allowed == 0.05) == (what, margin > 0.0)
