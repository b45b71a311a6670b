"""From touched points to a judged transform: fit what is unknown of the robots, then solve."""

from __future__ import annotations

from dataclasses import dataclass, field

from dualarm_cli.calibration import CALIBRATION_SOLVERS
from dualarm_cli.calibration.consistency import TOUCH_NOISE, readings_apart
from dualarm_cli.calibration.joint_fit import JointFit, Side, fit_tools_and_pose
from dualarm_cli.calibration.judgement import Judgement, judge, mirrored
from dualarm_cli.calibration.problem import CalibrationProblem, refuse_few
from dualarm_cli.calibration.solution import CalibrationSolution
from dualarm_cli.calibration.tips import flange_poses, second_joint_height, touched_points
from dualarm_cli.calibration.tool_fit import HEIGHT, ToolFit, fit_tool
from dualarm_cli.errors import InfeasibleError, UsageError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.touches import Touches, TouchSide

UNSEEN_HEIGHT = (
    "base_height cannot be observed from joint readings alone: a robot that stands higher by h "
    "reads the same joints at the "
    "same points, and the transform takes up h; measure the points' coordinates as well (xyz beside joints)"
)


@dataclass(frozen=True)
class Calibration:
    """A transform, what was found of the robots along with it, and what there is to say of it."""

    method: str
    """Which method found it."""
    problem: CalibrationProblem
    """The points that it was found from."""
    solution: CalibrationSolution
    """The transform."""
    judgement: Judgement
    """How good it is."""
    tools: dict[str, ToolFit] = field(default_factory=dict)
    """What was fitted, by side."""
    second_joint: dict[str, float] = field(default_factory=dict)
    """How high the second joint's axis is above the base, fitted height included [m], by side."""
    notes: tuple[str, ...] = ()
    """What the reader should know of how it was found."""


def calibrate(touches: Touches, method: str, use: str) -> Calibration:
    """Returns where the right robot's base stands in the left one's.

    Args:
        touches: the points.
        method: name of a solver of the family.
        use: `joints` or `xyz`: which of the two is taken where a point has both.

    Raises:
        UsageError: something is to be fitted that the file has no readings for.
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
        raise InfeasibleError("; ".join([*wrong, *readings]))
    try:
        solution = CALIBRATION_SOLVERS[method].solve(problem)
    except InfeasibleError as error:
        # Readings that contradict each other are the likeliest reason.
        raise InfeasibleError("; ".join([str(error), *readings])) from None
    if joint_fit is not None and method == "least_squares":
        # The same transform; its uncertainty now has that of the tools in it.
        solution = joint_fit.solution
    elif joint_fit is not None:
        solution = CalibrationSolution(solution.rotation, solution.translation, None, None)
    elif tools:
        notes.append("the transform's uncertainty takes fitted tools and heights as exact")
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


def _measured_fits(touches: Touches) -> tuple[dict[str, ToolFit], list[str]]:
    """Returns the fits of the robots that have joint readings and coordinates of the same points, and notes."""
    tools: dict[str, ToolFit] = {}
    for side, touch in touches.sides.items() if touches.fit else ():
        both = touch.read & touch.measured
        if touch.robot is None or not both.any():
            continue
        flanges = flange_poses(touch.robot, touch.joints[both])
        tools[side] = fit_tool(flanges, touch.xyz[both], touch.tcp, touches.fit, touches.noise)
    notes = []
    if "base_height" in touches.fit and len(tools) < 2:
        sides = [
            side
            for side, touch in touches.sides.items()
            if side not in tools and touch.robot is not None
        ]
        notes = [f"{side}: {UNSEEN_HEIGHT}" for side in sides]
    return tools, notes


def _joint_fit(
    touches: Touches, tools: dict[str, ToolFit], use: str, notes: list[str]
) -> JointFit | None:
    """Returns the tools that only the transform can tell, along with it; None where there are none."""
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
    notes.append(
        "tools were fitted from joint readings alone, with the transform (nonlinear least squares); base heights "
        "cannot be observed that way: the transform takes them up"
    )
    return fit


def _tips(side: str, touch: TouchSide, fit: ToolFit | None, use: str) -> FloatArray:
    if fit is None:
        return touched_points(side, touch, use, touch.tcp)
    return touched_points(side, touch, use, fit.tool(touch.tcp), fit.value(HEIGHT, 0.0))


def _readings_disagree(touches: Touches, tools: dict[str, ToolFit]) -> list[str]:
    """Says how far coordinates and joint readings of the same points are apart, where noise does not explain it."""
    found = []
    for side, touch in touches.sides.items():
        both = touch.read & touch.measured
        if not both.any():
            continue
        fit = tools.get(side)
        apart = (_tips(side, touch, fit, "joints") - touch.xyz)[both]
        fitted = 0 if fit is None else int(fit.determined.sum())
        off = readings_apart(apart, touches.noise, fitted)
        if off is not None:
            noise = TOUCH_NOISE if touches.noise is None else touches.noise
            found.append(
                f"{side}: joint readings and coordinates of the same points are up to "
                f"{off * 1000:.4g} mm apart, more than a noise of {noise * 1000:g} mm explains; "
                "look at tool and robot file, or find them: --fit tool,base_height"
            )
    return found


def _second_joints(touches: Touches, tools: dict[str, ToolFit]) -> dict[str, float]:
    found = {}
    for side, fit in tools.items():
        robot = touches.sides[side].robot
        height = second_joint_height(robot) if robot is not None else None
        if height is not None and HEIGHT in fit.names and fit.determined[fit.names.index(HEIGHT)]:
            found[side] = height + fit.value(HEIGHT, 0.0)
    return found
