"""Pairs that are said never to meet never do."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.collision.reach import can_meet
from dualarm_cli.collision.solids import cell_solids, geometry_model, pairs_that_must_keep_apart
from dualarm_cli.loading.tasks import load_job


@pytest.mark.parametrize("name", ["04_packing", "05_two_robots", "07_two_shelves"])
def test_pairs_that_cannot_meet_keep_apart_at_three_thousand_random_postures(tasks_folder, name):
    """Their least distance by coal is never less than what is required; and there are such pairs."""
    cell = load_job(tasks_folder / name / "tasks.yaml").cell
    model = pin.buildModelFromXML(cell.robot.urdf)
    solids = cell_solids(cell, model, [])
    pairs = [
        pair
        for pair in pairs_that_must_keep_apart(model, solids, cell)
        if not can_meet(model, solids[pair.first], solids[pair.second], pair)
    ]
    assert pairs
    geometry = geometry_model(solids, [(pair.first, pair.second) for pair in pairs])
    data, distances = model.createData(), pin.GeometryData(geometry)
    required = np.array([pair.required for pair in pairs])
    limits = cell.robot.limits
    random = np.random.default_rng(0)
    order = [cell.robot.joints.index(joint) for joint in model.names[1:]]
    for q in random.uniform(limits.lower, limits.upper, (3000, len(order)))[:, order]:
        pin.computeDistances(model, data, geometry, distances, q)
        found = np.array([result.min_distance for result in distances.distanceResults])
        assert (found >= required).all()
