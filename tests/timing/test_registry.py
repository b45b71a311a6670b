"""The timing family as a whole."""

from __future__ import annotations

import subprocess
import sys

from dualarm_cli.timing import TIMING_SOLVERS


def test_the_default_is_ruckig_and_serves_jerk_limits(limits, without_jerk):
    """The others say why not, and serve joints without jerk limits."""
    assert TIMING_SOLVERS.names == ["ruckig", "toppra", "trapezoid"]
    reasons = {solver.name: solver.why_unsupported(limits) for solver in TIMING_SOLVERS}
    assert reasons["ruckig"] is None
    assert all("jerk limits" in reasons[name] for name in ("toppra", "trapezoid"))
    assert all(solver.why_unsupported(without_jerk) is None for solver in TIMING_SOLVERS)


def test_naming_the_solvers_loads_no_library():
    """A fresh interpreter that has the registry has neither ruckig nor toppra, scipy or matplotlib."""
    code = (
        "import sys, dualarm_cli.timing; "
        "print(sorted({'ruckig', 'toppra', 'scipy', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
