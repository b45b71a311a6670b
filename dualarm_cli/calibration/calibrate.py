"""Calibration from touched points: fit unknown tools and heights, solve, and assess the result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field

import numpy as np

from dualarm_cli.calibration import CALIBRATION_SOLVERS
from dualarm_cli.calibration.judgement import (
    LEVELS,
    Judgement,
    judge,
    mirrored,
    readings_apart,
)
from dualarm_cli.calibration.problem import CalibrationProblem, CalibrationSolution, refuse_few
from dualarm_cli.calibration.rigid import fit_rigid, refuse_loose_turn
from dualarm_cli.calibration.spread import Sight, look
from dualarm_cli.calibration.tool_fit import (
    HEIGHT,
    TOOL,
    Flanges,
    ToolFit,
    fit_tool,
    flange_poses,
    second_joint_height,
    touched_points,
)
from dualarm_cli.errors import InfeasibleError, UsageError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.geometry.rotations import skew
from dualarm_cli.model.touches import Touches, TouchSide
from dualarm_cli.notes import Note, NoteTable
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

ITERATIONS = 100
"""Maximum number of Gauss-Newton steps.

Four suffice from a tool that is right to some centimetres.
"""
HALVINGS = 30
"""Maximum number of halvings of a step that increases the residuals."""
CONVERGED = 1e-12
"""Step size below which the iteration has converged [m, rad]."""
POSE = ("x", "y", "z", "turn about x", "turn about y", "turn about z")


@dataclass(frozen=True)
class JointFit:
    """Fitted tools of one or both robots, and the transform."""

    tools: dict[str, ToolFit]
    """Fitted tools by side."""
    solution: CalibrationSolution
    """Pose of the right base; its covariance includes the tools' uncertainty."""


@dataclass(frozen=True)
class Side:
    """Readings of one robot: flange poses or known tips."""

    flanges: Flanges | None
    """Flange poses; None if the tips are known."""
    tips: FloatArray
    """Tips [m], shape (n, 3): known, or with the initial tool."""
    tool: FloatArray
    """Initial tool [m], shape (3,)."""


def fit_tools_and_pose(sides: dict[str, Side], noise: float | None) -> JointFit:
    """Fit tools and transform by Gauss-Newton: tip_left = R tip_right + t everywhere.

    The heights of the bases cannot be unknowns: raising all tips is a shift, which t absorbs.

    Args:
        sides: both robots, left and right; those with flanges have unknown tools.
        noise: standard deviation of each coordinate of a touched point [m]; None to estimate it from the residuals.

    Raises:
        InfeasibleError: the readings do not determine the transform; with the unobservable directions.
    """
    unknown = [side for side, data in sides.items() if data.flanges is not None]
    names = [*POSE, *(f"{side} {name}" for side in unknown for name in TOOL)]
    tools = {side: data.tool for side, data in sides.items()}
    residuals, J, scale, G, pose = _linearised(sides, tools)
    for _ in range(ITERATIONS):
        step = -look(J, scale).inverse @ residuals
        size, squares = 1.0, float(residuals @ residuals)
        for _ in range(HALVINGS):
            trial = {
                side: tools[side] + size * step[6 + 3 * k : 9 + 3 * k]
                for k, side in enumerate(unknown)
            }
            residuals, J, scale, G, pose = _linearised(sides, {**tools, **trial})
            if float(residuals @ residuals) <= squares:
                break
            size /= 2.0
        tools = {**tools, **trial}
        if size * float(np.abs(step[6:]).max()) < CONVERGED:
            break
    sight = look(J, scale)
    # An unobservable turn also moves the origin.
    pose_seen = sight.seen[:6] & ~((np.abs(G) > 0.0) @ ~sight.seen)[:6]
    if not pose_seen.all():
        raise InfeasibleError(_unseen(sight, names, len(residuals) // 3))
    covariance, degrees = _noise(sight, residuals, noise)
    rms = float(np.sqrt(residuals @ residuals / (len(residuals) // 3)))
    fits = {}
    for k, side in enumerate(unknown):
        part = slice(6 + 3 * k, 9 + 3 * k)
        seen: BoolArray = sight.seen[part]
        tool_covariance = None if covariance is None else readonly(covariance[part, part])
        tool = readonly(tools[side])
        notes = () if seen.all() else tuple(sight.in_words(names))
        fits[side] = ToolFit(TOOL, tool, seen, tool_covariance, degrees, rms, notes)
    spread = None
    if covariance is not None:
        spread = (G @ covariance @ G.T)[:6, :6]
        refuse_loose_turn(spread, degrees, float(np.sqrt(residuals @ residuals / len(residuals))))
    return JointFit(fits, CalibrationSolution(*pose, spread, degrees))


def _linearised(
    sides: dict[str, Side], tools: dict[str, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Linearise the residuals at given tools.

    Returns residuals, Jacobian, scale, map to the origin's pose, and the best pose. The pose is that of least squares
    for these tools, so that only tools take steps; its columns (shift of the centroid, turn about it) are in the
    Jacobian nevertheless, which makes the step that of all unknowns.
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
    sight: Sight, residuals: FloatArray, noise: float | None
) -> tuple[FloatArray | None, int | None]:
    """Estimate the covariance of all unknowns and its degrees of freedom.

    The covariance is None if the noise is neither stated nor observable.
    """
    degrees = len(residuals) - sight.rank
    if noise is not None:
        return sight.covariance(2.0 * noise**2), None
    if degrees <= 0:  # as many unknowns as equations: the noise is unobservable
        return None, degrees
    return sight.covariance(float(residuals @ residuals) / degrees), degrees


def _unmatched(causes: Sequence[Refusal | str]) -> InfeasibleError:
    return InfeasibleError(Refusal("points_do_not_match", data={"causes": causes}))


def _unseen(sight: Sight, names: list[str], points: int) -> Refusal:
    count = len(names)
    counts = {"points": points, "equations": 3 * points, "unknowns": count}
    few = [Refusal("few_equations", data=counts)] if 3 * points < count else []
    least = -(-count // 3) + 1
    data = {"few": few, "unseen": sight.in_words(names), "least": least}
    return Refusal("tools_unseen", measured=points, allowed=least, data=data)


_note = NoteTable(
    "calibration",
    unseen_height="{side}: base_height cannot be observed from joint readings alone: a robot mounted higher by "
    "h has the same joint readings at the same points, and the transform absorbs h; measure the points' "
    "coordinates as well (xyz in addition to joints)",
    joints_alone="tools were fitted from joint readings alone, with the transform (nonlinear least squares); "
    "base heights cannot be observed: the transform absorbs them",
    exact_tools="the transform's uncertainty treats fitted tools and heights as exact",
    readings_differ="{side}: joint readings and coordinates of the same points differ by up to {off:.4g} mm, "
    "more than a noise of {noise:g} mm explains; check the tool and robot files, or fit them: "
    "--fit tool,base_height",
)
"""Notes on a calibration."""


@dataclass(frozen=True)
class Calibration:
    """Calibrated transform with fitted tools, quality and notes."""

    method: str
    """Name of the method."""
    problem: CalibrationProblem
    """Calibration points."""
    solution: CalibrationSolution
    """Transform between the bases."""
    judgement: Judgement
    """Quality of the calibration."""
    tools: dict[str, ToolFit] = field(default_factory=dict)
    """Fitted tools by side."""
    second_joint: dict[str, float] = field(default_factory=dict)
    """Height of joint 2's axis above the base [m], by side.

    It includes the fitted height.
    """
    notes: tuple[Note, ...] = ()
    """Notes on the method for the reader."""


def calibrate(touches: Touches, method: str, use: str) -> Calibration:
    """Calibrate the right robot's base in the left one's frame.

    Args:
        touches: the points.
        method: name of a solver of the family.
        use: `joints` or `xyz`: the reading that is used if a point has both.

    Raises:
        UsageError: the file has no readings for a quantity to be fitted.
        InfeasibleError: the points do not determine it.
    """
    refuse_few(len(touches.names))
    tools, notes = _measured_fits(touches)
    joint_fit = _joint_fit(touches, tools, use, notes)
    if joint_fit is not None:
        tools |= joint_fit.tools
    tips = {side: _tips(side, touch, tools.get(side), use) for side, touch in touches.sides.items()}
    problem = CalibrationProblem(
        tips["left"], tips["right"], touches.names, touches.noise, touches.origin
    )
    readings = _readings_disagree(touches, tools)
    if wrong := mirrored(problem):
        raise _unmatched([*wrong, *readings])
    try:
        solution = CALIBRATION_SOLVERS[method].solve(problem)
    except InfeasibleError as error:
        # Readings that contradict each other are the likeliest reason.
        raise _unmatched([*error.refusals, *readings]) from None
    if joint_fit is not None and method == "least_squares":
        # The same transform; its uncertainty now includes that of the tools.
        solution = joint_fit.solution
    elif joint_fit is not None:
        solution = CalibrationSolution(solution.rotation, solution.translation, None, None)
    elif tools:
        notes.append(_note("exact_tools"))
    notes += readings
    return Calibration(
        method,
        problem,
        solution,
        judge(problem, solution, method, 3 * len(joint_fit.tools) if joint_fit is not None else 0),
        tools,
        _second_joints(touches, tools),
        tuple(notes),
    )


def _measured_fits(touches: Touches) -> tuple[dict[str, ToolFit], list[Note]]:
    """Fit the robots that have joint readings and coordinates of the same points.

    Returns fits by side, and notes.
    """
    tools: dict[str, ToolFit] = {}
    for side, touch in touches.sides.items() if touches.fit else ():
        both = touch.read & touch.measured
        if touch.robot is None or not both.any():
            continue
        flanges = flange_poses(touch.robot, touch.joints[both])
        tools[side] = fit_tool(flanges, touch.xyz[both], touch.tcp, touches.fit, touches.noise)
    notes = list[Note]()
    if "base_height" in touches.fit and len(tools) < 2:
        sides = [
            side
            for side, touch in touches.sides.items()
            if side not in tools and touch.robot is not None
        ]
        notes = [_note("unseen_height", side=side) for side in sides]
    return tools, notes


def _joint_fit(
    touches: Touches, tools: dict[str, ToolFit], use: str, notes: list[Note]
) -> JointFit | None:
    """Fit the tools that only the transform can determine, or return None."""
    if not touches.fit:
        return None
    unknown = [s for s, t in touches.sides.items() if s not in tools and t.read.all()]
    if not unknown and not tools:
        raise UsageError("fit: needs joint readings of a robot; the file has coordinates only")
    if "tool" not in touches.fit or not unknown:
        return None
    sides = {}
    for side, touch in touches.sides.items():
        fitted = touch.robot is not None and side in unknown
        flanges = flange_poses(touch.robot, touch.joints) if fitted and touch.robot else None
        tips = _tips(side, touch, tools.get(side), use)
        sides[side] = Side(flanges, tips, touch.tcp)
    fit = fit_tools_and_pose(sides, touches.noise)
    notes.append(_note("joints_alone"))
    return fit


def _tips(side: str, touch: TouchSide, fit: ToolFit | None, use: str) -> FloatArray:
    if fit is None:
        return touched_points(side, touch, use, touch.tcp)
    return touched_points(side, touch, use, fit.tool(touch.tcp), fit.value(HEIGHT, 0.0))


def _readings_disagree(touches: Touches, tools: dict[str, ToolFit]) -> list[Note]:
    """List discrepancies of coordinates and joint readings that noise does not explain."""
    warnings = []
    for side, touch in touches.sides.items():
        both = touch.read & touch.measured
        if not both.any():
            continue
        fit = tools.get(side)
        differences = (_tips(side, touch, fit, "joints") - touch.xyz)[both]
        fitted = 0 if fit is None else int(fit.determined.sum())
        off = readings_apart(differences, touches.noise, fitted)
        if off is not None:
            noise = LEVELS.touch_noise if touches.noise is None else touches.noise
            warnings.append(_note("readings_differ", side=side, off=off * 1e3, noise=noise * 1e3))
    return warnings


def _second_joints(touches: Touches, tools: dict[str, ToolFit]) -> dict[str, float]:
    heights = {}
    for side, fit in tools.items():
        robot = touches.sides[side].robot
        height = second_joint_height(robot) if robot is not None else None
        if height is not None and HEIGHT in fit.names and fit.determined[fit.names.index(HEIGHT)]:
            heights[side] = height + fit.value(HEIGHT, 0.0)
    return heights
