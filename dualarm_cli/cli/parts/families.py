"""Every family of methods, for lists and for completion; loaded when asked for."""

from __future__ import annotations

from typing import Any


def families() -> list[Any]:
    """Returns every family of methods: a registry each."""
    from dualarm_cli.calibration import CALIBRATION_SOLVERS
    from dualarm_cli.kinds import planning
    from dualarm_cli.platform_angle import PLATFORM_SOLVERS
    from dualarm_cli.postures import REDUNDANCY_SOLVERS
    from dualarm_cli.stages.methods import METHODS
    from dualarm_cli.timing import TIMING_SOLVERS

    return [
        METHODS,
        PLATFORM_SOLVERS,
        REDUNDANCY_SOLVERS,
        *(solvers for _, solvers in planning.families()),
        TIMING_SOLVERS,
        CALIBRATION_SOLVERS,
    ]
