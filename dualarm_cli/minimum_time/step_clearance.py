"""What many different steps into one stage cost for clearance: what the beam sees of it."""

from __future__ import annotations

import numpy as np

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.minimum_time.clearance import SAMPLES, SequenceClearance
from dualarm_cli.minimum_time.plan_clearance import TURNS, move_waits


def step_waits(
    test: SequenceClearance,
    stage: int,
    start: FloatArray,
    arrival: FloatArray,
    target: FloatArray,
    end: FloatArray,
) -> FloatArray:
    """Returns about what n steps into a stage cost for clearance [s], infinite for none, shape (n,).

    Each arm by itself is free at its stops, which are nodes. What is looked at is each arm on its straight move, and
    both arms together there and at their stops; as in `plan_clearance`.

    Args:
        test: what keeps clear.
        stage: its number.
        start: all joints before it [rad], shape (n, columns).
        arrival: after the transfer, shape (n, columns).
        target: at the targets, shape (n, columns).
        end: after the retracts, shape (n, columns).
    """
    n, before, after = len(start), test.before[stage], test.after[stage]
    way = test.along(start, arrival)
    held = np.repeat([before, test.at_targets[stage], after], [len(way) + n, n, n], axis=0)
    cross = test.cell.cross_margins(np.concatenate([way, arrival, target, end]), held)
    lacks = np.zeros(len(way))
    for a in range(len(before)):
        own = test.cell.own_margins(a, way, np.full(len(way), before[a]))
        lacks = np.maximum(lacks, -own)
    apart = np.all((cross[: len(way)] >= 0.0).reshape(n, SAMPLES), axis=1)
    stops = (cross[len(way) :] >= SLACK).reshape(3, n)
    waits = move_waits(test.pace, lacks.reshape(n, SAMPLES).max(axis=1), apart)
    waits = np.maximum(waits, test.known_costs(stage, start, arrival))
    must = test.handing[stage] and stage not in test.settled
    turns = np.inf if must else test.pace * TURNS
    waits += np.where(stops[:2].all(axis=0), 0.0, turns)
    return waits if stage in test.settled else np.where(stops[2], waits, np.inf)
