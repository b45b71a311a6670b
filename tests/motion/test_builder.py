"""Groups keep one clock, however many stages there are."""

from __future__ import annotations

import numpy as np

from dualarm_cli.motion.builder import MotionBuilder
from dualarm_cli.timing.composition import hold


def test_groups_that_add_up_other_pieces_stay_together() -> None:
    """After 20,000 stages of 0.7 s: one group stands all along, the other one seven times 0.1 s."""
    record, stages = MotionBuilder(), 20_000
    for k in range(stages):
        record.clock = 0.7 * k
        record.add("whole", hold(("s",), np.zeros(1), 0.7))
        for _ in range(7):
            record.add("parts", hold(("e",), np.zeros(1), 0.1))
    whole, parts = record.joined("whole").time, record.joined("parts").time[::7]
    assert len(whole) == len(parts) == stages + 1
    assert np.abs(whole - 0.7 * np.arange(stages + 1)).max() < 1e-11
    assert np.abs(whole - parts).max() < 1e-11
