"""Looked-up times never exceed the closed form and follow it closely."""

import numpy as np
import pytest

from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.timing.transfer_table import TransferTable

LAWS = {
    "one law": (np.array([1.0, 2.0, 4.0]), 1 / 0.3, 10 / 0.3),
    "no jerk": (np.array([1.0, 2.0, 4.0]), 1 / 0.3, np.inf),
}


@pytest.mark.parametrize("name", LAWS)
def test_times_are_just_below_the_closed_form(name: str) -> None:
    """Within two steps of the table, from below, for all pairs."""
    v, a, j = LAWS[name]
    law = RestToRest(v, a * v, j * v)
    low, high = np.full(3, -3.0), np.full(3, 3.0)
    table = TransferTable.of([law], low, high)
    random = np.random.default_rng(1)
    x, y = random.uniform(-3, 3, (2, 400, 3))
    looked_up = table.times(table.coordinates(x), table.coordinates(y))
    exact = law.duration(x[:, None] - y[None])
    # Two steps of the slowest joint: 6 rad over 32,000 steps.
    later = law.duration(np.maximum(np.abs(x[:, None] - y[None]) - 2 * 6.0 * v / 32_000, 0.0))
    assert len(table.classes) == 1
    assert (looked_up <= exact + 1e-6).all()
    assert (looked_up >= later - 1e-6).all()


def test_different_laws_are_kept_apart() -> None:
    """Two joints of one speed, one with a tenth of the acceleration: each has its own table."""
    law = RestToRest(np.ones(2), np.array([5.0, 0.5]), np.array([50.0, 5.0]))
    table = TransferTable.of([law], np.full(2, -2.0), np.full(2, 2.0))
    x = np.array([[0.0, 0.0]])
    y = np.array([[1.0, 0.0], [0.0, 1.0]])
    times = table.times(table.coordinates(x), table.coordinates(y))[0]
    assert len(table.classes) == 2
    assert times == pytest.approx(law.duration(y), rel=1e-3)


def test_coordinates_that_do_not_count_take_no_time() -> None:
    """Without joint 1 only joint 0's distance counts; without both, nothing."""
    law = RestToRest(np.ones(2), np.full(2, 5.0), np.full(2, 50.0))
    table = TransferTable.of([law], np.full(2, -2.0), np.full(2, 2.0))
    x, y = (table.coordinates(np.array([q])) for q in ([0.0, 0.0], [0.5, 1.5]))
    assert table.times(x, y, (1,))[0, 0] == pytest.approx(
        law.duration(np.array([0.5, 0.0])), rel=1e-3
    )
    assert table.times(x, y, (0, 1))[0, 0] == 0.0


def test_unbounded_joints_have_a_table_too() -> None:
    """A joint without position limits counts within two turns."""
    law = RestToRest(np.ones(1), np.full(1, 5.0), np.full(1, 50.0))
    table = TransferTable.of([law], np.array([-np.inf]), np.array([np.inf]))
    x, y = (table.coordinates(np.array([[q]])) for q in (-6.0, 6.0))
    assert table.times(x, y)[0, 0] == pytest.approx(law.duration(np.array([12.0])), rel=1e-3)


def test_joints_come_back_from_their_steps():
    """To half a step, which is the widest range over 64,000, wherever they are within it."""
    low, high = np.array([-3.0, -1.0]), np.array([3.0, 2.0])
    table = TransferTable.of([RestToRest(*(np.full(2, x) for x in (2.0, 10.0, 100.0)))], low, high)
    q = np.random.default_rng(0).uniform(low, high, (100, 2))
    back = table.joints(table.coordinates(q))
    assert np.abs(back - q).max() <= 6.0 / 64_000 + 1e-12
