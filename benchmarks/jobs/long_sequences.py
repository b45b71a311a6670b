"""Random long sequences as files: both arms pick and place at random targets, stage by stage.

python -m benchmarks.jobs.long_sequences --robot sda10f --stages 1000 --seed 0 --out DIR

Then plan and verify DIR/tasks.yaml by the command line.

One random stage in some thousands cannot be made, as the arms share no platform angle from which both reach their
targets, collision-free by themselves. Such stages are drawn again; all others are the same as without this test.
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dualarm_cli.effort import EFFORTS
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.postures.holding import Holding
from dualarm_cli.stages.plans.candidates import Grid, Nodes
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.plans.source import grid_nodes
from dualarm_cli.stages.search.exact_stages import ExactStages, free_nodes
from dualarm_cli.stages.search.node_plans import grid_angles
from dualarm_cli.stages.sequence_problem import sequence_problem

LINE = 0.08
"""Length of approach and retract [m]."""
BASES = {
    "left": {"robot": "iiwa14", "base": {"xyz": [-0.68, 0, 0]}},
    "right": {"robot": "iiwa14", "base": {"xyz": [0.68, 0, 0], "rpy": [0, 0, "180 deg"]}},
}


@dataclass(frozen=True)
class Room:
    """Where the left arm of a robot reaches everything with its tool down, and by how much both targets may turn.

    Attributes:
        robot: as the cell file names it.
        low: lower corner of the left arm's box [m].
        high: upper corner of it [m].
        mirror: signs by which the right arm's positions differ.
        yaw: how far tools turn about their own axes, either way [rad].
        turn: how far the targets of a stage turn together about the platform's axis, either way [rad].
    """

    robot: Any
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    mirror: tuple[float, float, float]
    yaw: float
    turn: float = 0.0


ROOMS = {
    "sda10f": Room(
        "sda10f", (0.36, 0.12, 0.75), (0.64, 0.52, 0.95), (1.0, -1.0, 1.0), 1.2, np.radians(60.0)
    ),
    "iiwa14": Room(BASES, (-0.22, 0.08, 0.15), (-0.06, 0.34, 0.35), (-1.0, -1.0, 1.0), 3.0),
}


def stage_targets(random: np.random.Generator, room: Room) -> dict[str, dict[str, Any]]:
    """Returns one target of each arm, both within reach at the platform angle by which they are turned."""
    turn = random.uniform(-room.turn, room.turn)
    c, s = np.cos(turn), np.sin(turn)
    targets = {}
    for arm, signs in (("left", (1.0, 1.0, 1.0)), ("right", room.mirror)):
        x, y, z = random.uniform(room.low, room.high) * signs
        yaw = turn + random.uniform(-room.yaw, room.yaw)
        xyz = [round(float(v), 4) for v in (c * x - s * y, s * x + c * y, z)]
        targets[arm] = {"xyz": xyz, "rpy": ["180 deg", 0, round(float(yaw), 4)]}
    return targets


def write_sequence(robot: str, stages: int, seed: int, folder: Path) -> None:
    """Writes cell.yaml and tasks.yaml of a random sequence, in JSON, which is YAML as well.

    Args:
        robot: one of ROOMS.
        stages: even number of stages; every task of an arm has two, a pick and a place.
        seed: of the targets.
        folder: where; it is made.
    """
    random = np.random.default_rng([seed, stages])
    targets = [stage_targets(random, ROOMS[robot]) for _ in range(stages)]
    unsure = list(range(stages))
    for attempt in itertools.count():
        _write(robot, targets, folder)
        unsure = impossible_stages(load_job(folder / "tasks.yaml"), unsure)
        if not unsure:
            return
        for k in unsure:
            targets[k] = stage_targets(
                np.random.default_rng([seed, stages, k, attempt]), ROOMS[robot]
            )


def impossible_stages(job: Job, stages: Iterable[int]) -> list[int]:
    """Returns which of some stages have no platform angle at which both arms have postures clear of all but each other.

    First on the grid of the planner's quick search; where the arms share none of its angles, on the exact intervals
    from which both reach their targets.

    Args:
        job: a sequence in which both arms work in every stage.
        stages: their numbers.
    """
    problem = sequence_problem(CellModel.from_cell(job.cell), job, Holding.of(job))
    exact = ExactStages(problem)
    mesh = EFFORTS["quick"].search.meshes[0]
    grid = Grid(grid_angles(problem, mesh.angle_step), mesh.arm_angles, mesh.most_nodes)
    found = []
    for k in stages:
        nodes = [grid_nodes(problem, a, k, grid) for a in range(len(problem.arms))]
        if _share_angle(problem, k, grid.angles, nodes):
            continue
        angles, own = exact.nodes(k, problem.settings.exact_angles, mesh.most_nodes)
        if not _share_angle(problem, k, angles, own):
            found.append(k)
    return found


def _share_angle(
    problem: SequenceProblem, k: int, angles: FloatArray, nodes: Sequence[Nodes | None]
) -> bool:
    """Returns whether all arms have nodes that are clear of all but the other arm at one platform angle at least."""
    shared = np.full(len(angles), bool(nodes))
    for a, own in enumerate(nodes):
        assert own is not None  # both arms work in every stage
        free = free_nodes(problem, a, k, angles, own, spare=0.0)
        shared &= np.bincount(free.angle_index, minlength=len(angles)) > 0
    return bool(shared.any())


def _write(robot: str, targets: Sequence[dict[str, dict[str, Any]]], folder: Path) -> None:
    """Writes the files of a sequence of targets, a pair to a stage."""
    tasks: list[dict[str, Any]] = []
    for k in range(len(targets) // 2):
        own: dict[str, dict[str, Any]] = {
            arm: {"id": f"{arm}-{k:05d}", "arm": arm} for arm in ("left", "right")
        }
        for kind, both in zip(("pick", "place"), targets[2 * k : 2 * k + 2], strict=True):
            for arm, target in both.items():
                own[arm][kind] = target
        tasks += own.values()
    tool = {
        "tcp": {"xyz": [0, 0, 0.12]},
        "mass": 1.2,
        "shapes": [{"capsule": {"radius": 0.03, "length": 0.08}, "xyz": [0, 0, 0.05]}],
    }
    cell = {
        "dualarm": "cell/1",
        "robot": ROOMS[robot].robot,
        "tools": {"left": tool, "right": tool},
    }
    head = {"dualarm": "tasks/1", "cell": "cell.yaml", "mode": "paired", "order": "given"}
    defaults = {"approach": LINE, "retract": LINE, "dwell": 0.17}
    job = head | {"start": "home", "return": False, "defaults": defaults, "tasks": tasks}
    folder.mkdir(parents=True, exist_ok=True)
    for name, document in (("cell.yaml", cell), ("tasks.yaml", job)):
        (folder / name).write_text(json.dumps(document, indent=1), encoding="utf-8")


def main() -> None:
    """Writes one sequence."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robot", choices=[*ROOMS], default="sda10f")
    parser.add_argument("--stages", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    write_sequence(arguments.robot, arguments.stages, arguments.seed, arguments.out)


if __name__ == "__main__":
    main()
