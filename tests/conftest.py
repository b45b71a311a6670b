"""What tests of every layer share."""

from __future__ import annotations

import importlib.util
import os
import shutil
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from hypothesis import settings

# As the command does for itself, and before numpy is loaded: small matrices, one thread.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).parent.parent
TINY_CELL = "dualarm: cell/1\nrobot: ../../robots/planar/robot.yaml\n"
TINY_TASKS = """\
dualarm: tasks/1
cell: cell.yaml
return: true
tasks:
  - {id: P1, arm: left, move: {xyz: [80 mm, X mm, 0], rpy: [180 deg, 0, 0], free: yaw}}
  - {id: P2, arm: right, move: {xyz: [50 mm, 100 mm, 0], rpy: [180 deg, 0, 0], free: yaw}}
"""
# The same examples every time, so that a change fails for what it did; DUALARM_EXPLORE=1 looks for others.
settings.register_profile("same", derandomize=True, deadline=None)
if not os.environ.get("DUALARM_EXPLORE"):
    settings.load_profile("same")


def pytest_configure(config: pytest.Config) -> None:
    """Lets Ctrl-C through to tests that send it: workers of pytest-xdist, and what they start, would ignore it."""
    if hasattr(config, "workerinput"):
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def tasks_folder() -> Path:
    """The shipped task files."""
    return ROOT / "tasks"


def _module(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).parent / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look themselves up there
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def general_robots() -> ModuleType:
    """Robots whose arms are not spherical-revolute-spherical: YUMI, NEXTAGE, SPHERICAL, UR5."""
    return _module("general_robots")


@pytest.fixture(scope="session")
def sliding_robots() -> ModuleType:
    """Robots with lifts and rails: write_robot, LIFT, RAIL, LONG."""
    return _module("sliding_robots")


@pytest.fixture(scope="session")
def wrist_arms() -> ModuleType:
    """Six-axis arms with closed forms, from random axes and from rows of Denavit and Hartenberg."""
    return _module("wrist_arms")


@pytest.fixture(scope="session")
def random_valid_jobs() -> ModuleType:
    """Random jobs of every kind of work on five robots, as files: write_random_job."""
    return _module("random_valid_jobs")


@pytest.fixture
def cells(
    tmp_path: Path, tasks_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[str]]:
    """Makes a project of some tiny cells in the working directory, and returns their task files.

    A planar robot of its own, planned in a fifth of a second; what an X stands for differs from cell to cell.
    """
    monkeypatch.chdir(tmp_path)

    def make(count: int, tasks: str = TINY_TASKS) -> list[str]:
        Path("dualarm.toml").touch()
        robots = tasks_folder.parent / "robots"
        shutil.copytree(robots / "bottin_planar", "robots/planar", dirs_exist_ok=True)
        names = []
        for number in range(count):
            folder = Path(f"cells/{number:03d}")
            folder.mkdir(parents=True)
            (folder / "cell.yaml").write_text(TINY_CELL)
            (folder / "tasks.yaml").write_text(tasks.replace("X", f"{10 + 0.1 * number:g}"))
            names.append(f"cells/{number:03d}/tasks.yaml")
        return names

    return make
