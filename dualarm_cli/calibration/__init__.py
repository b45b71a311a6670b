"""Calibration solvers: the transform between two robots' bases from points both have touched."""

from __future__ import annotations

from dualarm_cli.calibration.problem import CalibrationProblem, CalibrationSolution
from dualarm_cli.calibration.rigid import solve_frame, solve_least_squares
from dualarm_cli.registry import Registry, Solver

CALIBRATION_SOLVERS: Registry[Solver[CalibrationProblem, CalibrationSolution]] = Registry(
    "calibration",
    "method",
    [
        Solver(
            name="least_squares",
            solve=solve_least_squares,
            summary="All points, least sum of squared distances; uncertainty from residuals or stated noise.",
            reference="[Kabsch1976]; [Umeyama1991] without scale",
        ),
        Solver(
            name="frame",
            solve=solve_frame,
            summary="A frame on the first three points, seen by both robots.",
            reference="[Qin2024] Eq. 7 to 10",
        ),
    ],
)

__all__ = ["CALIBRATION_SOLVERS", "CalibrationProblem", "CalibrationSolution"]
