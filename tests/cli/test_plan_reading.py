"""`dualarm plan` with two cores: another process reads the job."""

from __future__ import annotations

import dataclasses
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job

JOBS = sorted(one.parent.name for one in Path(__file__).parents[2].glob("tasks/*/tasks.yaml"))


def assert_same(one: Any, other: Any, where: str) -> None:
    """Fails where two things differ, whatever they are made of."""
    assert type(one) is type(other), where
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other, err_msg=where)
        assert not other.flags.writeable or one.flags.writeable, where
    elif isinstance(one, pin.SE3):
        np.testing.assert_array_equal(one.homogeneous, other.homogeneous, err_msg=where)
    elif dataclasses.is_dataclass(one):
        for name in (f.name for f in dataclasses.fields(one)):
            assert_same(getattr(one, name), getattr(other, name), f"{where}.{name}")
    elif isinstance(one, dict):
        assert list(one) == list(other), where
        for key, value in one.items():
            assert_same(value, other[key], f"{where}[{key!r}]")
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), where
        for k, (value, there) in enumerate(zip(one, other, strict=True)):
            assert_same(value, there, f"{where}[{k}]")
    else:
        assert one == other, where


@pytest.mark.parametrize("name", JOBS)
def test_a_job_is_the_same_in_another_process(name: str, tasks_folder: Path) -> None:
    """And what is read-only stays so."""
    job = load_job(tasks_folder / name / "tasks.yaml")
    assert_same(job, pickle.loads(pickle.dumps(job, pickle.HIGHEST_PROTOCOL)), "job")


@pytest.mark.parametrize("cores", [1, 2])
def test_with_two_cores_the_process_that_plans_loads_no_reader(cores: int) -> None:
    code = (
        "import sys; from pathlib import Path; import dualarm_cli.background as background; "
        f"background.usable_cores = lambda: {cores}; from dualarm_cli.cli.plan import _read; "
        "job = _read(Path('01_first_pick')); "
        "print(len(job.tasks) > 0, 'dualarm_cli.files.tasks.tasks' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", str(cores == 1)]


@pytest.mark.parametrize("cores", [1, 2])
def test_mistakes_in_files_are_told_by_either(cores: int, tmp_path: Path) -> None:
    """All of them, with line and column, and once."""
    bad = "dualarm: tasks/1\ncell: nowhere.yaml\ntasks: 5\n"
    (tmp_path / "tasks.yaml").write_text(bad)
    code = (
        "import sys; import dualarm_cli.background as background; "
        f"background.usable_cores = lambda: {cores}; from dualarm_cli.cli.run import run; "
        "sys.exit(run(['plan', 'tasks.yaml']))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=tmp_path
    )
    assert done.returncode == 2
    assert done.stderr.count("error[E500]: tasks.yaml:2:7: ") == 1
    assert done.stderr.count("error[E200]: tasks.yaml:3:8: ") == 1
