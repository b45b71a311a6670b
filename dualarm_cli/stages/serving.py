"""Support of robots by methods and redundancy solvers, and the default choices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import ANY, JointTarget
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.notes import NoteTable
from dualarm_cli.stages.method import MethodProblem

CLOSED_FORMS, NUMERIC = "arm_angle", "numeric"
"""Redundancy solvers: of arms with closed forms, and of any arms."""
SEQUENCE, FIXED = "sequence", "fixed"
"""Methods that serve any arms."""
TOGETHER: Mapping[str, tuple[str, ...]] = dict.fromkeys((SEQUENCE, FIXED), (CLOSED_FORMS, NUMERIC))
"""Redundancy solvers that go together with a method; with all others it is CLOSED_FORMS."""

_GENERAL = "solvers: {which} not spherical-revolute-spherical; planned with redundancy {solver}"
_note = NoteTable(
    "solvers",
    general=_GENERAL,
    mixed=_GENERAL + ", which has closed forms for kind {kinds}",
    closed="solvers: planned with redundancy {solver}, in closed form for kind {kinds}",
)


def goes_together(method: str, redundancy: str) -> bool:
    """Return whether some robot supports a method with a redundancy solver."""
    return redundancy in TOGETHER.get(method, (CLOSED_FORMS,))


def own_redundancy(method: str, robot: Robot) -> str:
    """Return a method's default redundancy solver on a robot."""
    possible = TOGETHER.get(method, (CLOSED_FORMS,))
    return possible[-1] if robot.without_closed_form else possible[0]


def cell_model(cell: Cell, redundancy: str) -> CellModel:
    """Build a cell's kinematics for a redundancy solver, with or without closed forms.

    Raises:
        InputError: an arm is called srs and is not.
        UnsupportedError: an arm has too few joints.
    """
    return CellModel.from_cell(cell, numeric=redundancy == NUMERIC)


def served_settings(settings: PlanSettings, robot: Robot) -> tuple[PlanSettings, list[str]]:
    """Replace unsupported default settings; also return the replacements.

    Named settings stay: an unsupported solver among them is refused with its reason.

    Args:
        settings: settings of the command line or the file.
        robot: the robot.
    """
    default, solver = PlanSettings(), own_redundancy(settings.platform, robot)
    free = "redundancy" not in settings.named and settings.redundancy == default.redundancy
    if not free or solver == settings.redundancy:
        return settings, []
    kinds = [arm.kind for arm in robot.arms if arm.kind != "srs"]
    closed = " and ".join(dict.fromkeys(kind for kind in kinds if kind != "general"))
    note = _note(
        "closed" if "general" not in kinds else "mixed" if closed else "general",
        which=_which(robot),
        solver=solver,
        kinds=closed,
    )
    return replace(settings, redundancy=solver), [note]


def why_no_closed_form(robot: Robot) -> str | None:
    """Explain why a robot has no closed-form kinematics; None if it has."""
    if not robot.without_closed_form:
        return None
    return (
        f"{_which(robot)} not spherical-revolute-spherical; the platform methods {SEQUENCE} and {FIXED} "
        f"plan such arms, with redundancy {NUMERIC}"
    )


def why_redundancy_unserved(redundancy: str, robot: Robot) -> str | None:
    """Explain why no method supports a redundancy solver on a robot.

    None if a method does.
    """
    return why_no_closed_form(robot) if redundancy == CLOSED_FORMS else None


def why_unserved(method: str, redundancy: str, robot: Robot) -> str | None:
    """Explain why a robot does not support method and redundancy solver.

    None if it does.

    Args:
        method: its name.
        redundancy: the solver's name.
        robot: the robot.
    """
    if reason := why_redundancy_unserved(redundancy, robot):
        return reason
    if goes_together(method, redundancy):
        return None
    if reason := why_no_closed_form(robot):
        return reason
    possible = " or ".join(TOGETHER.get(method, (CLOSED_FORMS,)))
    return f"it needs redundancy {possible}, not {redundancy}"


def _which(robot: Robot) -> str:
    names = robot.without_closed_form
    return f"{' and '.join(names)} {'arm is' if len(names) == 1 else 'arms are'}"


ROOM = 0.1
"""Margin to position limits, as a fraction of full-speed braking distance.

It is that of a joint.
"""
MOST_ROOM = 0.05
"""Largest margin, as a fraction of the joint's range."""


def with_stopping_room(problem: MethodProblem) -> MethodProblem:
    """Narrow the joint limits so that line ends can be passed in motion.

    A joint that passes the outer end of a line in motion stops beyond it. Given configurations stay within the limits.

    Args:
        problem: problem with the robot's limits.
    """
    job, robot = problem.job, problem.job.cell.robot
    limits = robot.limits
    span = limits.upper - limits.lower
    travel = np.where(np.isfinite(span), span, 0.0) + 1.0
    ramps = limits.law.per_joint(travel * 1e3) - travel * 1e3 / limits.velocity
    room = np.minimum(ROOM * 0.5 * limits.velocity * ramps, MOST_ROOM * span)
    room[problem.model.platform_columns] = 0.0
    lower, upper = limits.lower + room, limits.upper - room
    start = np.array(job.start_joints)
    lower, upper = np.minimum(lower, start), np.maximum(upper, start)
    for task in job.tasks:
        for stop in task.stops:
            if isinstance(stop.target, JointTarget):
                for arm in robot.arms if task.arm == ANY else [robot.arm(task.arm)]:
                    columns = robot.columns(arm.joints)
                    given = stop.target.configurations
                    if given.shape[1] == len(columns):
                        lower[columns] = np.minimum(lower[columns], given.min(axis=0))
                        upper[columns] = np.maximum(upper[columns], given.max(axis=0))
    with_margin = replace(robot, limits=replace(limits, lower=lower, upper=upper))
    cell = replace(job.cell, robot=with_margin)
    model = cell_model(cell, problem.redundancy)
    # The problem decides whether the platform is fixed.
    model = replace(model, platform=problem.model.platform)
    return replace(problem, model=model, job=replace(job, cell=cell))
