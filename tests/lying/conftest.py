"""Small jobs with parts that wait and lie."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job

ROD = "shapes: [{capsule: {radius: 20 mm, length: 60 mm}, xyz: [0, 0, 40 mm]}]"
PALM = "shapes: [{box: [160 mm, 160 mm, 40 mm], xyz: [0, 0, 95 mm]}]"
PARTS = {
    "tower": "{shapes: [{box: [60 mm, 60 mm, 300 mm], xyz: [0, 0, 155 mm]}]}",
    "cube": "{shapes: [{box: [60 mm, 60 mm, 100 mm], xyz: [0, 0, 55 mm]}]}",
    "tall": "{shapes: [{box: [60 mm, 60 mm, 200 mm], xyz: [0, 0, 105 mm]}]}",
    "flat": "{shapes: [{box: [60 mm, 60 mm, 40 mm], xyz: [0, 0, 25 mm]}]}",
}
"""Each hangs 5 mm below the tool centre point."""
TABLE = 0.48
"""Height of the table's top [m]."""


@pytest.fixture(scope="session")
def write_job(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Writes a job of an SDA10F at a table."""

    def written(
        *tasks: str,
        tool: str = ROD,
        clearance: str = "5 mm",
        head: str = "",
        cell: str = "",
        start: str = "free",
        defaults: str = "",
    ) -> Path:
        folder = tmp_path_factory.mktemp("lying")
        (folder / "dualarm.toml").write_text("")
        parts = "\n".join(f"  {name}: {shapes}" for name, shapes in PARTS.items())
        (folder / "cell.yaml").write_text(
            "dualarm: cell/1\nrobot: sda10f\ntools:\n"
            f"  left: {{tcp: {{xyz: [0, 0, 120 mm]}}, {tool}}}\n"
            f"  right: {{tcp: {{xyz: [0, 0, 120 mm]}}, {ROD}}}\n"
            f"parts:\n{parts}\nclearance: {clearance}\n"
            f"obstacles: {{table: {{box: [1.2, 2.0, 0.04], xyz: [0.60, 0, 0.46]}}}}\n{cell}\n"
        )
        lines = "\n".join(f"  - {task}" for task in tasks)
        (folder / "tasks.yaml").write_text(
            f"dualarm: tasks/1\ncell: cell.yaml\nstart: {start}\n{head}\n"
            f"defaults: {{approach: 60 mm, retract: 60 mm, dwell: 0.15, part: cube{defaults}}}\n"
            f"tasks:\n{lines}\n"
        )
        return folder / "tasks.yaml"

    return written


@pytest.fixture(scope="session")
def job_of(write_job: Callable[..., Path]) -> Callable[..., Job]:
    """Reads such a job."""
    return lambda *tasks, **keys: load_job(write_job(*tasks, **keys))


@pytest.fixture(scope="session")
def task() -> Callable[..., str]:
    """Writes a pick and a place, the tool centre points at x, y and height over the table's top [m]."""

    def written(
        name: str,
        pick: tuple[float, float, float],
        place: tuple[float, float, float],
        more: str = "",
        arm: str = "left",
        free: str = "",
    ) -> str:
        def pose(at: tuple[float, float, float]) -> str:
            x, y, height = at
            return f"{{xyz: [{x}, {y}, {TABLE + height:.4f}], rpy: [180 deg, 0, 0]{free}}}"

        return f"{{id: {name}, arm: {arm}, pick: {pose(pick)}, place: {pose(place)}{more}}}"

    return written
