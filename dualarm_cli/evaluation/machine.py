"""Class of the processor and C library, which may decide a plan's last digits.

Ruckig, pinocchio and the solvers take sines and roots from the C library, which has variants for processors.
"""

from __future__ import annotations

import platform
from pathlib import Path

LEVELS = (("x86-64-v4", "avx512f"), ("x86-64-v3", "fma"))
"""Classes of x86-64 processors, each with a flag that lower ones lack."""


def machine() -> str:
    """Return the processor's class and the C library, as in "x86-64-v3, glibc 2.36"."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    flags = next((set(line.split()) for line in lines if line.startswith("flags")), set())
    level = next((name for name, flag in LEVELS if flag in flags), platform.machine())
    return ", ".join(filter(None, [level, " ".join(platform.libc_ver()).strip()]))


def other_machine(made_on: str) -> str:
    """Describe how a baseline's machine differs from this one; empty if unknown."""
    here = machine()
    if made_on in ("", here):
        return ""
    return f"the baseline was made on {made_on}, this is {here}"
