"""What tests of every layer share."""

from __future__ import annotations

import importlib.util
import io
import os
import pickle
import shutil
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from hypothesis import settings

from dualarm_cli import background, effort

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


@pytest.fixture(scope="session", autouse=True)
def compiled_once(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Processes that tests start share their bytecode, also where nothing may be written beside the source."""
    with pytest.MonkeyPatch.context() as patch:
        # Workers of pytest-xdist have the width of the terminal, which tables in pipes keep to.
        patch.delenv("COLUMNS", raising=False)
        if os.environ.get("PYTHONDONTWRITEBYTECODE"):
            patch.delenv("PYTHONDONTWRITEBYTECODE")
            patch.setenv("PYTHONPYCACHEPREFIX", str(tmp_path_factory.mktemp("bytecode")))
        yield


@pytest.fixture(scope="session", autouse=True)
def one_process() -> Iterator[None]:
    """Commands that tests run in their own process make no copies of it: other tests have the other cores."""
    with pytest.MonkeyPatch.context() as patch:
        forbidding = background.allow_workers
        patch.setattr(background, "allow_workers", lambda _: forbidding(False))
        yield


SCALING, FULL = effort.stages.SCALING, dict(effort.EFFORTS)


def _searching(patch: pytest.MonkeyPatch, *, brief: bool) -> None:
    """Lets short jobs be searched as briefly as long ones, without simpler methods' plans beside, or as for users."""
    plain = replace(SCALING, max_factor=1, very_short=0)
    patch.setattr(effort.stages, "SCALING", plain if brief else SCALING)
    for name in ("quick", "normal"):
        full = FULL[name]
        own = replace(full, search=replace(full.search, begun=0)) if brief else full
        patch.setitem(effort.EFFORTS, name, own)


@pytest.fixture(scope="session", autouse=True)
def brief_searches() -> Iterator[None]:
    """Jobs of tests have few stages, for which `sequence` does several times as much as for each of many."""
    with pytest.MonkeyPatch.context() as patch:
        _searching(patch, brief=True)
        yield


@pytest.fixture(scope="session")
def as_for_users() -> Callable[[], AbstractContextManager[None]]:
    """Returns a context in which plans that several tests share are searched for as users' are."""

    @contextmanager
    def full() -> Iterator[None]:
        with pytest.MonkeyPatch.context() as patch:
            _searching(patch, brief=False)
            yield

    return full


@pytest.fixture(autouse=True)
def full_searches(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests marked `slow`, or `full_effort` as their expected numbers are those of users, search as users do."""
    if any(request.node.get_closest_marker(name) for name in ("slow", "full_effort")):
        _searching(monkeypatch, brief=False)


@pytest.fixture(scope="session")
def tasks_folder() -> Path:
    """The shipped task files."""
    return ROOT / "tasks"


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of all processes of a run."""
    own = tmp_path_factory.getbasetemp()
    return own.parent if "PYTEST_XDIST_WORKER" in os.environ else own


@pytest.fixture(scope="session")
def quick_plan(shared_folder: Path, tasks_folder: Path) -> Callable[[str], Any]:
    """Returns a bundled job's plan of quick effort, with its bound, planned once in a run; every call has its own."""
    from dualarm_cli.files.tasks.tasks import load_job
    from dualarm_cli.model.settings import PlanSettings
    from dualarm_cli.planning.planner import plan

    def planned(name: str) -> Any:
        kept = shared_folder / "schedules" / name
        if not kept.exists():
            made = plan(load_job(tasks_folder / name / "tasks.yaml"), PlanSettings(effort="quick"))
            part = kept.with_suffix(f".{os.getpid()}")
            part.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(pickle.dumps(made))
            part.replace(kept)
        return pickle.loads(kept.read_bytes())

    return planned


@pytest.fixture(scope="session")
def planned_files(
    shared_folder: Path, tasks_folder: Path, quick_plan: Callable[[str], Any]
) -> Callable[[str], Path]:
    """Returns the files that `dualarm plan JOB --effort quick` writes, made once in a run: for reading only.

    The motion is that of `quick_plan`, as both plan the same. What is printed, in 80 columns, is beside them in
    stdout.txt.
    """
    from dualarm_cli.cli.parts import output
    from dualarm_cli.cli.run import run
    from dualarm_cli.planning import planner

    def planned(name: str) -> Path:
        kept = shared_folder / "files" / name
        if not kept.exists():
            part = kept.with_suffix(f".{os.getpid()}")
            job = str(tasks_folder / name / "tasks.yaml")
            with pytest.MonkeyPatch.context() as patch, redirect_stdout(io.StringIO()) as printed:
                patch.setattr(output, "PIPE_WIDTH", 80)
                patch.setattr(planner, "plan", lambda *_, **__: quick_plan(name))
                code = run(
                    ["plan", job, "--effort", "quick", "--no-page", "-vv", "--out", str(part)]
                )
            assert code == 0
            (part / "stdout.txt").write_text(printed.getvalue())
            with suppress(OSError):  # another process was first
                part.replace(kept)
        return kept

    return planned


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
def line_reference() -> ModuleType:
    """The method of lines and launches in numpy."""
    return _module("line_reference")


@pytest.fixture(scope="session")
def plain_motion() -> ModuleType:
    """Joint motion of schedule.json, read without this program."""
    return _module("plain_motion")


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
