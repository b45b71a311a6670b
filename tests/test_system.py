"""A machine without what Linux has: every module is imported, and a plan is the same."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dualarm_cli import load, plan

ROOT = Path(__file__).parents[1]
WITHOUT = """
import os, pkgutil, sys
sys.modules |= dict.fromkeys(("fcntl", "resource"))
for name in ("fork", "memfd_create", "sched_getaffinity"):
    delattr(os, name)
import dualarm_cli.system
dualarm_cli.system.IS_LINUX = False
for module in pkgutil.walk_packages(dualarm_cli.__path__, "dualarm_cli."):
    if not module.name.startswith("dualarm_cli.bundled"):
        __import__(module.name)
from dualarm_cli import load, plan
from dualarm_cli.background import BackgroundCall, allow_workers, usable_cores
from dualarm_cli.system import end_with_parent, memory_file, memory_limit
assert usable_cores() >= 1 and memory_limit() is None
end_with_parent(0)
with allow_workers(True), BackgroundCall(os.getpid) as call:
    assert call.result() == os.getpid()
handle = memory_file()
os.write(handle, b"kept")
assert os.pread(handle, 9, 0) == b"kept" and os.fstat(handle).st_nlink == 0
plan(load("01_first_pick"), effort="quick").write(sys.argv[1], page=False)
"""


@pytest.mark.full_effort
def test_a_system_without_forks_locks_and_limits_plans_the_same(tmp_path: Path) -> None:
    """Byte for byte: modules that only some systems have are missing, and so are calls of Linux."""
    command = [sys.executable, "-c", WITHOUT, str(tmp_path / "without")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    plan(load("01_first_pick"), effort="quick").write(tmp_path / "with", page=False)
    for path in (tmp_path / "with").iterdir():
        assert path.read_bytes() == (tmp_path / "without" / path.name).read_bytes()
