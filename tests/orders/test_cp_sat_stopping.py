"""CP-SAT while someone wants it to stop."""

from __future__ import annotations

import os
import signal
import threading
import time
from itertools import pairwise

import numpy as np
import pytest

from dualarm_cli.orders.proof.cp_sat import prove
from dualarm_cli.orders.proof.relaxation import Relaxation

AT_ONCE = 6.0
"""Two seconds by the contract [s]; the rest is for a machine that does other things meanwhile."""


@pytest.fixture(scope="module")
def hard():
    """Sixty points of a square for two arms: hours of work for CP-SAT."""
    rng = np.random.default_rng(0)
    costs = []
    for _ in range(2):
        points = rng.random((61, 2))
        away = np.linalg.norm(points[:, None] - points[None], axis=2) + 0.1
        np.fill_diagonal(away, 0.0)
        costs.append(away)
    return Relaxation(tuple(costs), np.full(60, 0.1), before=((0, 5), (6, 9)))


def test_it_stops_when_told_with_the_bound_so_far(hard):
    """Within two seconds; what it has proven by then is what it told last, and holds."""
    told, asked = [], []

    def stop():
        if told and told[-1] > 1.0 and not asked:
            asked.append(time.monotonic())
        return bool(asked)

    found = prove(hard, None, 1e6, 0, stop, told.append)
    assert time.monotonic() - asked[0] < AT_ONCE
    assert found.bound >= 1.0
    assert found.bound >= told[-1] - 1e-9
    assert told == sorted(told)
    # One arm does all in the order of their numbers, which keeps both rules: an order, if not a good one.
    way = [60, *range(60), 60]
    assert found.bound <= sum(hard.cost[0][i, j] for i, j in pairwise(way))


def test_a_signal_is_seen_to_while_it_works(hard):
    """KeyboardInterrupt comes out within two seconds, and no thread goes on working."""
    sent = []

    def interrupt():
        sent.append(time.monotonic())
        os.kill(os.getpid(), signal.SIGINT)

    before = threading.active_count()
    timer = threading.Timer(1.0, interrupt)
    timer.start()
    with pytest.raises(KeyboardInterrupt):
        prove(hard, None, 1e6, 0)
    assert time.monotonic() - sent[0] < AT_ONCE
    timer.join()
    assert threading.active_count() == before


def test_the_answer_is_the_same_whoever_watches(hard):
    """A watcher that never stops it, and none: the same bound, to the last bit."""
    assert prove(hard, None, 0.2, 3) == prove(hard, None, 0.2, 3, lambda: False, lambda _: None)
