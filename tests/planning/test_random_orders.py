"""Random jobs with open orders on a bare SDA10F: whatever is found has a plan, and the plan passes every check."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

from dualarm_cli.effort import EFFORTS, TrialEffort
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.orders import order_trials
from dualarm_cli.orders.order_trials import orders_to_plan
from dualarm_cli.orders.orders import PairedSearch
from dualarm_cli.orders.watch import Watch
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

AT_LIMITS = (82, 157, 161, 594)
"""Seeds of jobs in which the search's postures leave joint limits: its last joint is open, or between a line's ends."""


def target(random):
    """A pose in front of the robot, tool down, at times with any yaw."""
    side = 1 if random.random() < 0.5 else -1
    radius, azimuth = random.uniform(0.4, 0.8), side * random.uniform(0.0, np.radians(80.0))
    height = random.uniform(0.7, 1.05)
    place = [radius * np.cos(azimuth), radius * np.sin(azimuth), height]
    found = {
        "xyz": [round(float(x), 3) for x in place],
        "rpy": ["180 deg", 0, f"{round(float(random.uniform(-180, 180)))} deg"],
    }
    if random.random() < 0.3:
        found["free"] = "yaw"
    return found


def random_tasks(seed):
    """A task file: four moves, or picks with places, most of them for any arm, one after another one."""
    random = np.random.default_rng(seed)
    tasks = []
    for k in range(4):
        kind = random.choice(["move", "pp"])
        arm = "any" if random.random() < 0.7 else str(random.choice(["left", "right"]))
        stops = ("move",) if kind == "move" else ("pick", "place")
        tasks.append({"id": f"t{k}", "arm": arm, **{stop: target(random) for stop in stops}})
    first, then = sorted(random.choice(4, 2, replace=False).tolist())
    tasks[then]["after"] = [f"t{first}"]
    found = {
        "dualarm": "tasks/1",
        "cell": "cell.yaml",
        "order": "optimise",
        "return": bool(random.random() < 0.5),
        "tasks": tasks,
    }
    if random.random() < 0.3:
        found["start"] = "free"
    if random.random() < 0.7:
        line, back = (f"{int(random.uniform(0, 100))} mm" for _ in range(2))
        found["defaults"] = {"approach": line, "retract": back, "dwell": 0.1}
    return found


@pytest.fixture
def random_job(tmp_path):
    """Makes the job of a seed."""
    (tmp_path / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")

    def made(seed, **changes):
        path = tmp_path / "tasks.yaml"
        path.write_text(yaml.safe_dump(random_tasks(seed) | changes))
        return load_job(path)

    return made


def searched(job):
    """The search for a job's orders, and what it finds."""
    watch = Watch()
    watch.begin()
    search = PairedSearch.of(
        CellModel.from_cell(job.cell), job, "quick", 0, watch, check_collisions=True
    )
    return search, search.orders(watch).ranked


@pytest.mark.parametrize("seed", AT_LIMITS)
def test_every_order_is_tried_with_a_plan_within_limits(random_job, seed, monkeypatch):
    """Also where the search's own postures are beyond them: all orders are possible, so all of them are tried."""
    search, found = searched(random_job(seed))
    some = replace(EFFORTS["quick"], trials=TrialEffort(100, 0, 100))
    monkeypatch.setattr(order_trials, "EFFORTS", {"quick": some})
    tried = orders_to_plan(search, found, "quick", Watch())
    assert len(tried) == len(found)
    assert all(np.isfinite(one.expected) for one in tried)


def test_orders_of_which_none_can_be_tried_are_planned_as_they_are(random_job, monkeypatch):
    """In the order in which they were found."""
    search, found = searched(random_job(0))
    assert len(found) > 1
    monkeypatch.setattr(order_trials, "repaired", lambda *_: None)
    assert orders_to_plan(search, found, "quick", Watch()) == found


@pytest.mark.parametrize(
    "seed",
    [82, 161, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (157, 594))],
)
def test_their_plans_pass_every_check(random_job, seed):
    """The slow ones' orders are tried above, each with a plan."""
    job = random_job(seed)
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    assert verify(schedule, job, clearance=True).failures == ()
