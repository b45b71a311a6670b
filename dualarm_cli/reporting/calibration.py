"""What a calibration found, as a JSON-ready document; SI units and rad."""

from __future__ import annotations

from typing import Any

from dualarm_cli.calibration.calibrate import Calibration
from dualarm_cli.calibration.confidence import LEVEL, half_widths, region_limit
from dualarm_cli.calibration.spread import Spread
from dualarm_cli.calibration.tool_fit import ToolFit
from dualarm_cli.geometry.rotations import rpy_angles, to_quaternion


def calibration_document(result: Calibration) -> dict[str, Any]:
    """Returns everything known of a calibration.

    Args:
        result: what was found.
    """
    solution, judgement, problem = result.solution, result.judgement, result.problem
    return {
        "format": "dualarm.calibration/1",
        "method": result.method,
        "points": list(problem.names),
        "T_left_right": {
            "xyz": solution.translation.tolist(),
            "rpy": rpy_angles(solution.rotation).tolist(),
            "quat_xyzw": to_quaternion(solution.rotation).tolist(),
            "matrix": solution.matrix.tolist(),
        },
        "residuals": [
            {"point": name, "distance": float(distance), "vector": vector.tolist()}
            for name, distance, vector in zip(
                problem.names, judgement.distances, judgement.residuals, strict=True
            )
        ],
        "rms": judgement.rms,
        "uncertainty": _uncertainty(result),
        "distances": [
            {"points": [pair.first, pair.second], "left": pair.left, "right": pair.right}
            for pair in judgement.pairs
        ],
        "spread": {"left": _spread(judgement.left), "right": _spread(judgement.right)},
        "fit": {side: _fit(fit) for side, fit in result.tools.items()},
        "second_joint_height": dict(result.second_joint),
        "notes": list(result.notes),
        "warnings": list(judgement.warnings),
    }


def _uncertainty(result: Calibration) -> dict[str, Any] | None:
    solution, widths = result.solution, result.judgement.widths
    if solution.covariance is None or widths is None:
        return None
    return {
        "level": LEVEL,
        "source": "stated noise" if solution.degrees is None else "residuals",
        "degrees_of_freedom": solution.degrees,
        "translation": widths[:3].tolist(),
        "rotation": widths[3:].tolist(),
        "covariance": solution.covariance.tolist(),
        "region_limit": region_limit(solution.degrees),
    }


def _spread(spread: Spread) -> dict[str, Any]:
    return {
        "length": spread.length,
        "height": spread.height,
        "ratio": spread.ratio,
        "deviations": list(spread.deviations),
    }


def _fit(fit: ToolFit) -> dict[str, Any]:
    """Returns what was fitted of one robot; null for what the data do not determine."""
    widths = fit_widths(fit)
    return {
        "values": {
            name: float(fit.values[k]) if fit.determined[k] else None
            for k, name in enumerate(fit.names)
        },
        "half_widths": {
            name: widths[k] if fit.determined[k] else None for k, name in enumerate(fit.names)
        },
        "degrees_of_freedom": fit.degrees,
        "rms": fit.rms,
        "not_observed": list(fit.unseen),
    }


def fit_widths(fit: ToolFit) -> list[float | None]:
    """Returns the half widths of the 95 % intervals of what was fitted [m]; None where nothing tells the noise."""
    if fit.covariance is None:
        return [None] * len(fit.names)
    return [float(width) for width in half_widths(fit.covariance, fit.degrees)]
