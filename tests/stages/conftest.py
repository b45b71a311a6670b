"""Short random sequences for the search over a whole sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.srs_arm import SrsArm
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import Job, JointTarget, Place, PoseTarget, Stop, Task
from dualarm_cli.stages.plans.problem import SequenceProblem
from dualarm_cli.stages.sequence_problem import sequence_problem

PACKING = Path(__file__).parents[2] / "tasks" / "04_packing" / "tasks.yaml"


@pytest.fixture(scope="session")
def packing() -> Job:
    return load_job(PACKING)


@pytest.fixture(scope="session")
def random_job(packing: Job) -> Callable[..., Job]:
    """Random stops of the SDA10F before it: (seed, stages per arm, options) -> Job."""

    def make(
        seed: int,
        stages: tuple[int, int] = (4, 4),
        *,
        line: float = 0.0,
        dwell: float = 0.0,
        free_yaw: bool = False,
        symmetry: int = 1,
        start: str = "home",
        returns: bool = False,
        joints: bool = False,
    ) -> Job:
        random = np.random.default_rng(seed)
        tasks = []
        for arm, side, count in (("left", 1, stages[0]), ("right", -1, stages[1])):
            for k in range(count):
                radius, azimuth = random.uniform(0.45, 0.75), side * random.uniform(0.1, 1.2)
                turn = pin.rpy.rpyToMatrix(np.pi, 0.0, random.uniform(-np.pi, np.pi))
                place = np.array(
                    [radius * np.cos(azimuth), radius * np.sin(azimuth), random.uniform(0.75, 1.0)]
                )
                target = PoseTarget(pin.SE3(turn, place), free_yaw, symmetry)
                if joints and k % 2:
                    home = packing.cell.robot.postures["home"]
                    q = home[packing.cell.robot.columns(packing.cell.robot.arms[side < 0].joints)]
                    target = JointTarget(q + random.uniform(-0.2, 0.2, (2, 7)))
                stop = Stop("move", target, line, line, Dwell(dwell), Place("random", 1, 1))
                tasks.append(Task(f"{arm}-{k}", arm, (stop,)))
        return replace(packing, tasks=tuple(tasks), start=start, returns=returns)

    return make


@pytest.fixture(scope="session")
def random_problem(random_job: Callable[..., Job]) -> Callable[..., SequenceProblem]:
    def make(*args: object, **options: object) -> SequenceProblem:
        job = random_job(*args, **options)
        return sequence_problem(CellModel.from_cell(job.cell), job)

    return make


@pytest.fixture(scope="module", params=["sda10f", "iiwa7", "bottin_planar"])
def arm(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> SrsArm:
    """The first arm of a bundled robot, its shoulder 0.2 m and more beside the platform's axis."""
    folder = tmp_path_factory.mktemp("cell")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\nrobot: {request.param}\n")
    cell = load_cell(folder / "cell.yaml").cell
    return next(iter(CellModel.from_cell(cell).arms.values())).kinematics
