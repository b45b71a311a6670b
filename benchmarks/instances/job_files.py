"""The files of a job, written as a person would: robot, cell and tasks in a folder."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

DATA = Path(__file__).parent / "data"
"""Numbers of the instances, in the form that the scripts here read."""


def numbers(values: Iterable[float]) -> str:
    """Returns numbers as a YAML list, in full precision."""
    return f"[{', '.join(repr(float(value)) for value in values)}]"


def configurations(rows: Iterable[Sequence[float]]) -> str:
    """Returns a target of joint configurations to choose from."""
    return f"{{joints: [{', '.join(numbers(row) for row in rows)}]}}"


def posture(joints: Sequence[str], values: Iterable[float]) -> str:
    """Returns a named posture's content."""
    pairs = zip(joints, values, strict=True)
    return f"{{{', '.join(f'{joint}: {float(value)!r}' for joint, value in pairs)}}}"


def accelerations(joints: Sequence[str], limits: Iterable[str]) -> str:
    """Returns the lines under `limits` of a robot file: no jerk limits, every number assumed."""
    return "".join(
        f"  {joint}: {{acceleration: {limit}, jerk: none, source: assumed}}\n"
        for joint, limit in zip(joints, limits, strict=True)
    )


def write_job(folder: Path, *, tasks: str, cell: str, robot: str | None = None) -> Path:
    """Returns the task file of a job after writing its files.

    Args:
        folder: where; it is made if need be.
        tasks: content of tasks.yaml without its kind and the cell's name.
        cell: content of cell.yaml without its kind.
        robot: content of robot.yaml without its kind; None for a bundled robot.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if robot is not None:
        (folder / "robot.yaml").write_text(f"dualarm: robot/1\n{robot}", encoding="utf-8")
    (folder / "cell.yaml").write_text(f"dualarm: cell/1\n{cell}", encoding="utf-8")
    path = folder / "tasks.yaml"
    path.write_text(f"dualarm: tasks/1\ncell: cell.yaml\n{tasks}", encoding="utf-8")
    return path
