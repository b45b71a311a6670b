"""Features of some operating systems, imported in no other module.

Without them results are the same: planning is one process without forks, a killed command may leave workers behind
without prctl, limits of memory go unnoticed without `resource`, and files are written without locks without `fcntl`.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

try:
    import fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]
try:
    import resource
except ImportError:
    resource = None  # type: ignore[assignment]

IS_LINUX = sys.platform == "linux"
"""Flag of Linux: safe forks, and workers that end with their parent.

Forks keep libraries usable.
"""
_PARENT_DEATH_SIGNAL = 1
"""Option PR_SET_PDEATHSIG of prctl."""


def core_count() -> int:
    """Count the cores that this process may use."""
    return len(os.sched_getaffinity(0)) if IS_LINUX else os.cpu_count() or 1


def memory_limit() -> int | None:
    """Read the limit of this process's address space [B], or None."""
    if resource is None:
        return None
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    return None if allowed == resource.RLIM_INFINITY else allowed


def peak_memory() -> int:
    """Read the largest address space of this process so far [B], 0 if unknown."""
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmPeak:"))
    except (OSError, StopIteration):
        return 0


def limit_resources(limits: Mapping[str, int]) -> None:
    """Limit this process by names of `resource`, such as RLIMIT_CPU."""
    for name, most in limits.items():
        resource.setrlimit(getattr(resource, name), (most, most))


def end_with_parent(parent: int) -> None:
    """Let this process end when its parent ends, where the system can.

    Args:
        parent: process id of the parent, which may have ended already.
    """
    if not IS_LINUX:
        return
    ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:  # the parent ended before this request
        os._exit(0)


def lock(handle: int) -> None:
    """Lock an open file without waiting.

    Raises:
        OSError: another process holds the lock, or the file system has none.
    """
    if fcntl is not None:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def memory_file() -> int:
    """Open a file without a name, in memory if possible.

    A full disk has no room for it.
    """
    if IS_LINUX:
        return os.memfd_create("errors")
    handle, name = tempfile.mkstemp()
    os.unlink(name)  # noqa: PTH108
    return handle
