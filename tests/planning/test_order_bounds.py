"""Bounds on all orders are bounds: from a free start too, and where one arm works while the other changes its tool."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.orders.model.order_model import OrderModel
from dualarm_cli.orders.model.stage_order_model import stage_problem
from dualarm_cli.orders.orders import PairedSearch
from dualarm_cli.orders.watch import Watch
from tests.packing_tasks import packing_job


@pytest.fixture(scope="module")
def job(tasks_folder):
    """Two parts for each arm, from anywhere and back there."""
    job = packing_job(tasks_folder, 4)
    return dataclasses.replace(job, order="optimise", start="free", returns=True)


def test_from_a_free_start_the_first_way_takes_nothing_and_the_last_one_what_it_takes_at_least(job):
    order = OrderModel.of(CellModel.from_cell(job.cell), job)
    problem = stage_problem(order)
    stops, seen = problem.stops, 0
    for length, work in zip(problem.length, problem.work, strict=True):
        for j in range(stops):
            made = np.flatnonzero(np.isfinite(work[j]))
            seen += len(made)
            # The platform turns between stages, which it does not before the first one.
            first = length[stops, j][:, made]
            np.testing.assert_allclose(first, problem.turn[:, made] + work[j, made], rtol=1e-5)
        for i in range(stops):
            for f in np.flatnonzero(np.isfinite(work[i])):
                there = length[i, :stops, f]
                possible = np.isfinite(there)
                assert (
                    length[i, stops, f, 0]
                    <= (there - np.where(possible, work, 0.0))[possible].min() + 1e-5
                )
    assert seen > 40


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_with_a_free_start_the_way_back_is_not_to_home(job, mode):
    """A bound for the way back home would be longer than a round that ends where it began."""
    one = OrderModel.of(CellModel.from_cell(job.cell), dataclasses.replace(job, mode=mode))
    problem = one.problem(0)
    away = OrderModel.of(
        CellModel.from_cell(job.cell), dataclasses.replace(job, mode=mode, start="home")
    ).problem(0)
    for arm, home in zip(problem.between, away.between, strict=True):
        there = np.isfinite(arm[-1, :-1])
        assert there.any()
        assert (arm[-1, :-1][there] == 0.0).all()
        rows = np.isfinite(arm[:-1, -1])
        assert (arm[:-1, -1][rows] <= home[:-1, -1][rows] + 1e-9).all()
        assert (arm[:-1, -1][rows] <= arm[:-1, :-1][rows].min(axis=1) + 1e-9).all()


def test_while_one_arm_changes_its_tool_the_other_works_and_no_bound_says_otherwise(tasks_folder):
    job = load_job(tasks_folder / "14_two_grippers" / "tasks.yaml")
    watch = Watch()
    watch.begin()
    model = CellModel.from_cell(job.cell)
    orders = PairedSearch.of(model, job, "quick", 0, watch, check_collisions=False).orders(watch)
    assert orders.bound is not None
    assert orders.bound <= min(one.total for one in orders.ranked)
