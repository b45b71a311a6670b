"""Choice of grasps against single grasps throughout, and orders with grasps against enumeration.

Run `OPENBLAS_NUM_THREADS=1 python -m benchmarks.quality.grasp_orders singles --jobs 20`, or `pairs` or `orders`.

- `singles`: two to four random pegs before an iiwa 14, or as many bars before both arms of an SDA10F, in the given
  order, with two or three grasps from above in random turns, the third one leaning. The plan with open grasps is
  divided by the best plan with one grasp throughout.
- `pairs`: one or two bars that an SDA10F hands over, by the best plan with one pair of grasps throughout.
- `orders`: three pegs with two grasps. The plan with `order: optimise` and open grasps is divided by the best plan of
  all orders and choices.

Every plan is made alone with the same effort, collision-free. Processor times are those of planning without the bound.
"""

from __future__ import annotations

import argparse
import itertools
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np

from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound

PEGS = """\
dualarm: cell/1
robot: iiwa14
tools: {left: {tcp: {xyz: [0, 0, 150 mm]}, shapes: [{cylinder: {radius: 20 mm, length: 100 mm}, xyz: [0, 0, 50 mm]}]}}
obstacles: {table: {box: [1, 2, 0.1], xyz: [0.6, 0, -0.05]}}
clearance: 5 mm
parts:
  part:
    shapes: [{box: [30 mm, 30 mm, 80 mm], xyz: [0, 0, -40 mm]}]
    grasps:
"""
BARS = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
  right: {tcp: {xyz: [0, 0, 120 mm]}, shapes: [{capsule: {radius: 30 mm, length: 80 mm}, xyz: [0, 0, 50 mm]}]}
clearance: 5 mm
parts:
  part:
    shapes: [{box: [40 mm, 60 mm, 100 mm], xyz: [0, 0, -52 mm]}]
    grasps:
"""
HEAD = """\
dualarm: tasks/1
cell: cell.yaml
return: true
defaults: {approach: 50 mm, retract: 50 mm, dwell: 0.1 s, part: part}
tasks:
"""


def grasps(name: str, z: float, roll: float, turns: Sequence[float] | FloatArray) -> str:
    """Write grasps at one height [m] in turns [deg], the third one leaning by 25°."""
    return "".join(
        f"      {name}{k}: {{xyz: [0, 0, {z}], rpy: [{roll + 25 * (k == 2)} deg, 0, {turn:.1f} deg]}}\n"
        for k, turn in enumerate(turns)
    )


def target(rng: np.random.Generator, x: float, y: float, z: float, roll: float = 0.0) -> str:
    """Write a pose of the part at random yaw."""
    yaw = rng.uniform(-180.0, 180.0)
    return f"{{xyz: [{x:.3f}, {y:.3f}, {z:.3f}], rpy: [{roll} deg, 0, {yaw:.1f} deg]}}"


def pegs(rng: np.random.Generator, tasks: int, turns: Sequence[float] | FloatArray) -> list[str]:
    """Write a cell and tasks: pegs are picked on one side of a table and placed on the other."""
    rows = []
    for k in range(tasks):
        ends = [
            target(rng, 0.43 + 0.08 * k, side * rng.uniform(0.1, 0.3), 0.08) for side in (1.0, -1.0)
        ]
        rows.append(f"  - {{id: t{k}, arm: left, pick: {ends[0]}, place: {ends[1]}}}\n")
    return [PEGS + grasps("top", 0.0, 180.0, turns), HEAD + "".join(rows)]


def bars(rng: np.random.Generator, tasks: int, turns: Sequence[float] | FloatArray) -> list[str]:
    """Write a cell and tasks: each arm moves half of the bars on its own side."""
    rows = []
    for k in range(tasks):
        arm, side = (("left", 1.0), ("right", -1.0))[k % 2]
        x = 0.45 + 0.15 * (k // 2)
        ends = [target(rng, x, side * (y + rng.uniform(0.0, 0.08)), 0.84) for y in (0.25, 0.45)]
        rows.append(f"  - {{id: t{k}, arm: {arm}, pick: {ends[0]}, place: {ends[1]}}}\n")
    return [BARS + grasps("top", 0.0, 180.0, turns), HEAD + "".join(rows)]


def handed(rng: np.random.Generator, tasks: int) -> list[str]:
    """Write a cell and tasks: the left arm hands bars to the right one, with four pairs of grasps."""
    rows = []
    for k in range(tasks):
        x = 0.45 + 0.15 * k
        pick = target(rng, x, rng.uniform(0.25, 0.50), 0.84)
        place = target(rng, x, -rng.uniform(0.25, 0.50), 0.74, 180.0)
        meeting = f"xyz: [0.55, 0, {rng.uniform(1.0, 1.15):.3f}], rpy: [-90 deg, 0, 0]"
        rows.append(
            f"  - {{id: t{k}, arm: left, grasp: [top0, top1], pick: {pick}, "
            f"handover: {{{meeting}, grasp: [low0, low1]}}, place: {place}}}\n"
        )
    ways = [rng.uniform(-180.0, 180.0, 2) for _ in range(2)]
    cell = BARS + grasps("top", 0.0, 180.0, ways[0]) + grasps("low", -0.104, 0.0, ways[1])
    return [cell, HEAD + "".join(rows)]


def job_of(work: str, rng: np.random.Generator, folder: Path) -> Job:
    """Make a random job of one kind in a folder."""
    if work == "orders":
        cell, tasks = pegs(rng, 3, (0.0, 120.0))
    elif work == "pairs":
        cell, tasks = handed(rng, int(rng.integers(1, 3)))
    else:
        turns = rng.uniform(-180.0, 180.0, rng.integers(2, 4))
        cell, tasks = (pegs, bars)[rng.integers(2)](rng, int(rng.integers(2, 5)), turns)
    (folder / "dualarm.toml").write_text("")
    (folder / "cell.yaml").write_text(cell)
    (folder / "tasks.yaml").write_text(tasks)
    job = load_job(folder / "tasks.yaml")
    return replace(job, order="optimise") if work == "orders" else job


def singles(job: Job) -> Iterator[Job]:
    """Decide one grasp, or one pair of grasps, throughout."""
    for grasp in job.tasks[0].grasps:
        if grasp.grasp:
            yield job.with_grasps(dict.fromkeys((t.id for t in job.tasks), grasp.grasp.choice))


def orders(job: Job) -> Iterator[Job]:
    """Decide every order with every choice of grasps."""
    names = [[(t.id, g.grasp.name) for g in t.grasps if g.grasp] for t in job.tasks]
    for choice in itertools.product(*names):
        decided = job.with_grasps(dict(choice))
        for tasks in itertools.permutations(decided.tasks):
            yield replace(decided, order="given", tasks=tasks)


def planned(job: Job, settings: PlanSettings) -> tuple[float, float]:
    """Plan a job: its duration, infinite without a plan, and the processor time [s]."""
    begin = process_time()
    try:
        duration = plan_without_bound(job, settings).duration
    except InfeasibleError:
        duration = np.inf
    return duration, process_time() - begin


def main() -> None:
    """Print the ratios of each job, their counts and medians."""
    parser = argparse.ArgumentParser()
    parser.add_argument("work", choices=("singles", "pairs", "orders"))
    parser.add_argument("--jobs", type=int, default=5)
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--first", type=int, default=0, help="number of the first job")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    settings = PlanSettings(effort=given.effort)
    ratios, times = [], []
    for k in range(given.first, given.first + given.jobs):
        with tempfile.TemporaryDirectory() as folder:
            job = job_of(given.work, np.random.default_rng([given.seed, k]), Path(folder))
            decided = orders(job) if given.work == "orders" else singles(job)
            alone = np.array([planned(single, settings) for single in decided])
            duration, time = planned(job, settings)
        possible = np.isfinite(alone[:, 0])
        ratios.append(duration / alone[:, 0].min() if possible.any() else np.nan)
        times.append(time / np.median(alone[:, 1]))
        tell(
            f"job {k}: {len(job.tasks)} tasks on {job.cell.robot.name}, {duration:.3f} s ({time:.1f} s of processor); "
            f"{possible.sum()} of {len(alone)} alone have a plan, best {alone[:, 0].min():.3f} s, "
            f"{np.median(alone[:, 1]):.1f} s of processor each; ratio {ratios[-1]:.4f}"
        )
    found = np.array(ratios)[np.isfinite(ratios)]
    print_head("jobs", "", "shorter", "longer", "cycle, mean", "least", "processor time, median")
    print_row(
        f"`{given.work}`",
        len(found),
        (found < 0.9999).sum(),
        (found > 1.0001).sum(),
        f"{found.mean():.3f}",
        f"{found.min():.3f}",
        f"{np.median(times):.1f}",
    )


if __name__ == "__main__":
    main()
