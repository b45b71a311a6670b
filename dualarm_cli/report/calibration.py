"""Report of a calibration as a JSON-ready document; SI units and rad."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from dualarm_cli.calibration.calibrate import Calibration
from dualarm_cli.calibration.tool_fit import HEIGHT, ToolFit
from dualarm_cli.geometry.rotations import rpy_angles, to_quaternion

if TYPE_CHECKING:
    from rich.console import Console
from typing import Any

from dualarm_cli.calibration.spread import SPREAD, Spread, half_widths, region_limit
from dualarm_cli.report.printable import numbers, print_lines


def calibration_document(result: Calibration) -> dict[str, Any]:
    """Build the document of a calibration.

    Args:
        result: the calibration.
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
        "level": SPREAD.level,
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
    """Summarise the fit of a robot, null for values without data."""
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
    """Compute the half widths of 95 % intervals of fitted values [m].

    None where the noise is unknown.
    """
    if fit.covariance is None:
        return [None] * len(fit.names)
    return [float(width) for width in half_widths(fit.covariance, fit.degrees)]


def print_calibration(result: Calibration, console: Console) -> None:
    """Print transform, residuals, distances, spread and fits.

    Args:
        result: the calibration.
        console: output.
    """
    from rich.table import Table

    judgement, names = result.judgement, result.problem.names
    print_lines(console, *_transform(result))
    columns = numbers("mm", "x mm", "y mm", "z mm")
    title = f"residuals, RMS {_mm(judgement.rms)} mm"
    table = Table("point", *columns, title=title, title_justify="left")
    for name, distance, vector in zip(names, judgement.distances, judgement.residuals, strict=True):
        table.add_row(name, _mm(distance), *(_mm(v) for v in vector))
    console.print(table)
    columns = numbers("left mm", "right mm", "difference mm")
    table = Table("points", *columns, title="distances", title_justify="left")
    pairs = sorted(judgement.pairs, key=lambda pair: -abs(pair.left - pair.right))
    for pair in pairs[:10]:
        name = f"{pair.first}, {pair.second}"
        table.add_row(name, _mm(pair.left), _mm(pair.right), _mm(pair.left - pair.right))
    console.print(table)
    if len(pairs) > 10:
        console.print(f"the 10 of {len(pairs)} distances that differ most", markup=False)
    print_lines(console, *_spread_lines(result), *_fits(result))


def _transform(result: Calibration) -> list[str]:
    solution, widths = result.solution, result.judgement.widths
    rpy, quat = rpy_angles(solution.rotation), to_quaternion(solution.rotation)
    degrees = ", ".join(f"{math.degrees(a):.4f}" for a in rpy)
    lines = [
        f"T_left_right by {result.method} from {len(result.problem.names)} points (right base to left base)",
        f"xyz [{_list(solution.translation, 6)}] m",
        f"rpy [{_list(rpy, 6)}] rad = [{degrees}] deg",
        f"quat [{_list(quat, 7)}] (x, y, z, w)",
        *(f"  [{'  '.join(f'{v:9.6f}' for v in row)}]" for row in solution.matrix),
    ]
    if widths is None:
        return [*lines, "95 %: not known"]
    source = "the stated noise"
    if solution.degrees is not None:
        source = f"the residuals, {solution.degrees} degrees of freedom"
    turn = ", ".join(f"{math.degrees(w):.3g}" for w in widths[3:])
    shift = ", ".join(f"{w * 1000:.3g}" for w in widths[:3])
    return [
        *lines,
        f"95 %: ± [{shift}] mm, ± [{turn}] deg about x, y, z of the left base (from {source})",
    ]


def _spread_lines(result: Calibration) -> list[str]:
    judgement = result.judgement
    both = (("left", judgement.left), ("right", judgement.right))
    return [
        f"spread {side}: {_mm(s.length)} mm long, {_mm(s.height)} mm off that line; root mean squares "
        f"{', '.join(_mm(v) for v in s.deviations)} mm"
        for side, s in both
    ]


def _fits(result: Calibration) -> list[str]:
    lines = []
    for side, fit in result.tools.items():
        text = ", ".join(_fitted(fit, k) for k in range(len(fit.names)))
        lines.append(f"fitted {side}: {text}; residuals {_mm(fit.rms, 3)} mm RMS")
        lines += [f"fitted {side}: not seen by the data: {words}" for words in fit.unseen]
        if side in result.second_joint:
            height = _mm(result.second_joint[side], 2)
            lines.append(
                f"fitted {side}: the second joint's axis is then {height} mm above the base"
            )
    return lines


def _fitted(fit: ToolFit, k: int) -> str:
    name = "base height (added to the robot file's)" if fit.names[k] == HEIGHT else fit.names[k]
    if not fit.determined[k]:
        return f"{name} not determined"
    width = fit_widths(fit)[k]
    sure = " (unknown uncertainty)" if width is None else f" ± {_mm(width, 2)}"
    return f"{name} {_mm(float(fit.values[k]), 2)}{sure} mm"


def _list(values: np.ndarray, digits: int) -> str:
    return ", ".join(f"{v + 0.0:.{digits}f}" for v in values)


def _mm(value: float, digits: int = 1) -> str:
    """Format a length in mm; adding zero turns -0.0 into 0.0."""
    return f"{round(float(value) * 1000.0, digits) + 0.0:.{digits}f}"
