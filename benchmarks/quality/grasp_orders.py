"""Orders with grasps against enumeration: every order and choice of grasps of small jobs is planned.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.quality.grasp_orders --jobs 5 --tasks 3`.

Random pegs on a table before an iiwa 14, each gripped from above in two turns that the place does not share. The plan
with `order: optimise` and open grasps is divided by the best plan of all orders and choices, each planned alone with
the same effort, collision-free.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound

CELL = """\
dualarm: cell/1
robot: iiwa14
tools: {left: {tcp: {xyz: [0, 0, 150 mm]}, shapes: [{cylinder: {radius: 20 mm, length: 100 mm}, xyz: [0, 0, 50 mm]}]}}
obstacles: {table: {box: [1, 2, 0.1], xyz: [0.6, 0, -0.05]}}
parts:
  peg:
    shapes: [{box: [30 mm, 30 mm, 80 mm], xyz: [0, 0, 40 mm]}]
    grasps:
      top:    {xyz: [0, 0, 80 mm], rpy: [180 deg, 0, 0]}
      turned: {xyz: [0, 0, 80 mm], rpy: [180 deg, 0, 120 deg]}
clearance: 5 mm
"""
HEAD = """\
dualarm: tasks/1
cell: cell.yaml
order: optimise
return: true
defaults: {part: peg, approach: 50 mm, retract: 50 mm, dwell: 0.1 s}
tasks:
"""


def random_job(folder: Path, tasks: int, rng: np.random.Generator) -> Job:
    """Make a job of pegs that stand apart from each other, picked on one side and placed on the other."""
    rows = []
    for k in range(tasks):
        row = f"  - {{id: t{k}, arm: left"
        for action, side in (("pick", 1.0), ("place", -1.0)):
            x, y = 0.4 + 0.12 * k, side * rng.uniform(0.1, 0.4)
            yaw = rng.uniform(-180.0, 180.0)
            row += f", {action}: {{xyz: [{x:.3f}, {y:.3f}, 0], rpy: [0, 0, {yaw:.1f} deg]}}"
        rows.append(f"{row}}}\n")
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(CELL)
    (folder / "tasks.yaml").write_text(HEAD + "".join(rows))
    return load_job(folder / "tasks.yaml")


def durations(job: Job, settings: PlanSettings) -> list[float]:
    """Plan every order with every choice of grasps [s]; infeasible ones are left out."""
    found = []
    names = [[(t.id, g.grasp.name) for g in t.grasps if g.grasp] for t in job.tasks]
    for choice in itertools.product(*names):
        decided = job.with_grasps(dict(choice))
        for tasks in itertools.permutations(decided.tasks):
            single = replace(decided, order="given", tasks=tasks)
            try:
                found.append(plan_without_bound(single, settings).duration)
            except InfeasibleError:
                continue
    return found


def main() -> None:
    """Print the ratio of each job."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--jobs", type=int, default=5)
    parser.add_argument("--tasks", type=int, default=3)
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    settings = PlanSettings(effort=given.effort)
    ratios = []
    for k in range(given.jobs):
        with tempfile.TemporaryDirectory() as folder:
            rng = np.random.default_rng([given.seed, k])
            job = random_job(Path(folder), given.tasks, rng)
            every = durations(job, settings)
            planned = plan_without_bound(job, settings).duration
        ratios.append(planned / min(every))
        print(
            f"job {k}: {planned:.3f} s, best of {len(every)} plans {min(every):.3f} s, median "
            f"{np.median(every):.3f} s, ratio {ratios[-1]:.4f}",
            flush=True,
        )
    print(f"median {np.median(ratios):.4f}, worst {max(ratios):.4f}")


if __name__ == "__main__":
    main()
