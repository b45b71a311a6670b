"""What avoiding collisions costs: the quick test against coal, and plans with and without collision checking.

    python -m benchmarks.quality.clearance [--stages 100]

Ratios within one run; the seconds depend on the machine.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from time import perf_counter

import numpy as np
import pinocchio as pin

from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.collision.solids import Pair, cell_solids, geometry_model
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

TASKS = Path(__file__).parents[2] / "tasks"
CELLS = ("04_packing", "06_shared_bin", "07_two_shelves", "08_narrow_bin")
POSTURES = 20_000


def quick_against_coal(name: str, cell: Cell) -> None:
    """Prints how long one posture takes by the quick test and by coal, with its broad phase and without.

    One arm's own pairs at postures all over its range, as the search filters its nodes, and all pairs at postures about
    home, as motions are looked at.
    """
    test = QuickTest(cell)
    limits = cell.robot.limits
    random = np.random.default_rng(0)
    everywhere = random.uniform(limits.lower, limits.upper, (POSTURES, len(limits.joints)))
    home = np.array(cell.robot.postures["home"])
    about = home + random.normal(scale=0.1, size=everywhere.shape)
    arm = test.arms[0]
    groups = {
        "one arm": [test.arm_pairs(arm)],
        "all": [test.cross(), *map(test.arm_pairs, test.arms)],
    }
    for what, some in groups.items():
        q = np.clip(everywhere if what == "one arm" else about, limits.lower, limits.upper)
        times = []
        for _ in range(2):
            begin = perf_counter()
            margins = np.min([test.margins(group, q) for group in some], axis=0)
            times.append((perf_counter() - begin) / POSTURES)
        pairs = list(dict.fromkeys(pair for group in some for pair in group.pairs))
        plain, broad, wrong = _by_coal(cell, pairs, q[: POSTURES // 4], margins)
        tell(
            f"{name}, {what}: {len(pairs)} pairs, quick test {min(times) * 1e6:.1f} us a posture, coal "
            f"{plain / min(times):.1f} times as long, with its broad phase {broad / min(times):.1f} "
            f"times; {(margins > 0).mean():.0%} called free, of those touching: {wrong}"
        )


def _by_coal(
    cell: Cell, pairs: list[Pair], q: np.ndarray, margins: np.ndarray
) -> tuple[float, float, int]:
    """Returns coal's times [s] without and with its broad phase, and how many touch that are called free."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    places = [(pair.first, pair.second) for pair in pairs]
    geometry = geometry_model(cell_solids(cell, model, []), places)
    data, results = model.createData(), pin.GeometryData(geometry)
    for k, pair in enumerate(pairs):
        results.collisionRequests[k].security_margin = pair.required
    manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(model, geometry, results)
    order = [cell.robot.joints.index(joint) for joint in model.names[1:]]
    rows = np.ascontiguousarray(q[:, order])
    times = []
    for args in ((manager,), (geometry, results)):
        begin = perf_counter()
        touching = [pin.computeCollisions(model, data, *args, row, True) for row in rows]
        times.append((perf_counter() - begin) / len(rows))
    wrong = int((np.array(touching) & (margins[: len(rows)] > 1e-6)).sum())
    return times[1], times[0], wrong


def plans(name: str, job: Job) -> None:
    """Prints how long a job is planned unchecked and clear, what it costs in cycle time, and what is proven."""
    times, cycles = [], []
    for check_collisions in (False, True):
        begin = perf_counter()
        schedule = plan_without_bound(job, PlanSettings(), check_collisions=check_collisions)
        times.append(perf_counter() - begin)
        cycles.append(schedule.duration)
    begin = perf_counter()
    found = verify(schedule, job, clearance=True)
    proof = perf_counter() - begin
    least = min(found.clearances, key=lambda stage: stage.margin)
    assert found.passed, found.failures
    print_row(
        f"`{name}`",
        len(job.stages()),
        f"{cycles[0]:.3f} s",
        f"{cycles[1]:.3f} s ({cycles[1] / cycles[0] - 1.0:+.1%})",
        f"{least.clearance * 1e3:.1f} mm of {least.required * 1e3:.1f} mm",
        f"{times[0]:.1f} s",
        f"{times[1]:.1f} s",
        f"{proof:.1f} s",
    )


def repeated(job: Job, stages: int) -> Job:
    """Returns a job with its tasks repeated until it has so many stages of one pick or place of each arm."""
    tasks = [
        dataclasses.replace(task, id=f"{task.id}-{k // len(job.tasks)}")
        for k, task in zip(range(stages), list(job.tasks) * stages, strict=False)
    ]
    return dataclasses.replace(job, tasks=tuple(tasks))


def main() -> None:
    """Runs all of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=100, help="of the long sequences")
    stages = parser.parse_args().stages
    jobs = {name: load_job(TASKS / name / "tasks.yaml") for name in CELLS}
    # The first plan pays for what is loaded once.
    plan_without_bound(load_job(TASKS / "01_first_pick" / "tasks.yaml"), PlanSettings())
    for name, job in jobs.items():
        quick_against_coal(name, job.cell)
    cycles = "cycle without checking", "collision-free", "least clearance proven"
    print_head("cell", "stages", *cycles, "planned without", "with", "verified")
    for name, job in jobs.items():
        plans(name, job)
    plans(CELLS[0], repeated(jobs[CELLS[0]], stages))


if __name__ == "__main__":
    main()
