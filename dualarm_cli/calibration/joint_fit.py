"""Tools and transform together, from joint readings alone: the same points touched by both robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dualarm_cli.calibration.observability import Sight, look
from dualarm_cli.calibration.rigid import fit_rigid, refuse_loose_turn
from dualarm_cli.calibration.solution import CalibrationSolution
from dualarm_cli.calibration.tips import Flanges
from dualarm_cli.calibration.tool_fit import TOOL, ToolFit
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.rotations import skew

ITERATIONS = 100
"""Steps at most; from a tool that is right to some centimetres four are enough."""
HALVINGS = 30
"""How often a step that makes it worse is halved."""
CONVERGED = 1e-12
"""A step below this is the last one [m, rad]."""
POSE = ("x", "y", "z", "turn about x", "turn about y", "turn about z")


@dataclass(frozen=True)
class JointFit:
    """The tools of one or both robots, and the transform."""

    tools: dict[str, ToolFit]
    """By side."""
    solution: CalibrationSolution
    """Where the right base stands, with the tools' uncertainty in its covariance."""


@dataclass(frozen=True)
class Side:
    """What is known of one robot's points."""

    flanges: Flanges | None
    """Where its flange was; None where its tips are known."""
    tips: FloatArray
    """Its tips: known, or with the tool to begin with [m], shape (n, 3)."""
    tool: FloatArray
    """The tool to begin with [m], shape (3,)."""


def fit_tools_and_pose(sides: dict[str, Side], noise: float | None) -> JointFit:
    """Returns tools and transform of least squares by Gauss-Newton: tip_left = R tip_right + t at every point.

    The heights of the bases cannot be among the unknowns: tips that are all raised are a shift, which t takes up.

    Args:
        sides: both robots, left and right; those with flanges have unknown tools.
        noise: standard deviation of each coordinate of a touched point [m]; None to estimate it from the residuals.

    Raises:
        InfeasibleError: the readings do not determine the transform; with the directions that they do not see.
    """
    unknown = [side for side, data in sides.items() if data.flanges is not None]
    names = [*POSE, *(f"{side} {name}" for side in unknown for name in TOOL)]
    tools = {side: data.tool for side, data in sides.items()}
    rest, J, scale, G, pose = _linearised(sides, tools)
    for _ in range(ITERATIONS):
        step = -look(J, scale).inverse @ rest
        size, squares = 1.0, float(rest @ rest)
        for _ in range(HALVINGS):
            trial = {
                side: tools[side] + size * step[6 + 3 * k : 9 + 3 * k]
                for k, side in enumerate(unknown)
            }
            rest, J, scale, G, pose = _linearised(sides, {**tools, **trial})
            if float(rest @ rest) <= squares:
                break
            size /= 2.0
        tools = {**tools, **trial}
        if size * float(np.abs(step[6:]).max()) < CONVERGED:
            break
    sight = look(J, scale)
    # Of a direction that is not seen, the origin's shift by its turn must not be forgotten.
    pose_seen = sight.seen[:6] & ~((np.abs(G) > 0.0) @ ~sight.seen)[:6]
    if not pose_seen.all():
        raise InfeasibleError(_unseen_message(sight, names, len(rest) // 3))
    covariance, degrees = _noise(sight, rest, noise)
    fits = {
        side: _tool_fit(sight, names, 6 + 3 * k, tools[side], covariance, degrees, rest)
        for k, side in enumerate(unknown)
    }
    spread = None
    if covariance is not None:
        spread = (G @ covariance @ G.T)[:6, :6]
        refuse_loose_turn(spread, degrees, float(np.sqrt(rest @ rest / len(rest))))
    return JointFit(fits, CalibrationSolution(*pose, spread, degrees))


def _linearised(
    sides: dict[str, Side], tools: dict[str, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Returns residuals, Jacobian, scale, map to the origin's pose, and the best pose, for given tools.

    The pose is that of least squares for these tools, so that only tools take steps; its columns (shift of the
    centroid, turn about it) stand in the Jacobian nevertheless, which makes the step the one of all unknowns.
    """
    tips = {
        side: data.tips if data.flanges is None else data.flanges.tips(tools[side])
        for side, data in sides.items()
    }
    R, t = fit_rigid(tips["left"], tips["right"])
    middle = tips["left"].mean(axis=0)
    seen = tips["right"] @ R.T + t
    x = seen - middle
    n = len(x)
    blocks = [np.broadcast_to(-np.eye(3), (n, 3, 3)), skew(x)]
    left, right = sides["left"].flanges, sides["right"].flanges
    blocks += [left.rotation] if left is not None else []
    blocks += [-R @ right.rotation] if right is not None else []
    J = np.concatenate(blocks, axis=2).reshape(3 * n, -1)
    scale = np.ones(J.shape[1])
    scale[3:6] = 1.0 / max(float(np.sqrt((x**2).sum() / n)), 1e-9)
    G = np.eye(J.shape[1])
    G[:3, 3:6] = -skew(t - middle)
    return (tips["left"] - seen).ravel(), J, scale, G, (R, t)


def _noise(
    sight: Sight, rest: FloatArray, noise: float | None
) -> tuple[FloatArray | None, int | None]:
    """Returns the covariance of all unknowns, None where nothing tells the noise, and its degrees of freedom."""
    degrees = len(rest) - sight.rank
    if noise is not None:
        return sight.covariance(2.0 * noise**2), None
    if degrees <= 0:  # as many unknowns as equations: nothing is left that would tell
        return None, degrees
    return sight.covariance(float(rest @ rest) / degrees), degrees


def _tool_fit(
    sight: Sight,
    names: list[str],
    first: int,
    tool: FloatArray,
    covariance: FloatArray | None,
    degrees: int | None,
    rest: FloatArray,
) -> ToolFit:
    part = slice(first, first + 3)
    seen: BoolArray = sight.seen[part]
    words = sight.in_words(names) if not seen.all() else []
    own = None if covariance is None else readonly(covariance[part, part])
    rms = float(np.sqrt(rest @ rest / (len(rest) // 3)))
    return ToolFit(TOOL, readonly(tool), seen, own, degrees, rms, tuple(words))


def _unseen_message(sight: Sight, names: list[str], points: int) -> str:
    count = len(names)
    lines = "; ".join(sight.in_words(names))
    few = f"{points} points give {3 * points} equations for {count} unknowns; " * (
        3 * points < count
    )
    return (
        f"tools and transform are not determined together: {few}not seen: {lines}. Touch at least "
        f"{-(-count // 3) + 1} points, each "
        "with the tool turned another way about all three axes, or measure the tools and fit none"
    )
