"""Fastest single stage: platform angle and both arms' postures optimised together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, distinct
from dualarm_cli.geometry.elementary import power
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.postures import NoPosture, StopPosture, StopProblem
from dualarm_cli.postures.arm_angle import choose_near
from dualarm_cli.postures.reach import moved_flanges
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.postures.target_grid import least_transfer_times
from dualarm_cli.records import dataclass
from dualarm_cli.stages.stage_choice import (
    OpenStage,
    choose_stage,
    explain,
    first_that_serve,
    places_to_try,
    platform_candidates,
    stage_plan,
)
from dualarm_cli.timing.stage_length import stage_length

MINIMUM_TIME = "minimum_time"
"""Name of the method, and what its stages' solver is called."""
SIMPLER = ("fixed", "exact", "linearised")
"""Platform solvers that no stage of this method is slower than from the same start."""


@dataclass(frozen=True)
class MoveSettings:
    """Settings of the search for the fastest move of one stage."""

    grid_step: float = np.radians(5.0)
    """Spacing of the platform angles of the first estimate of a stage's time [rad]."""
    free_yaws: int = 4
    """Yaws that are looked at for it where any will do."""
    promising: int = 3
    """Platform angles besides the simpler solvers' at which postures are chosen."""
    zoom: tuple[float, ...] = tuple(np.linspace(-1.0, 1.0, 7).tolist())
    """Platform angles tried in a bracket, as fractions of its half-width.

    In the first round the half-width is `grid_step`."""
    zoom_rounds: int = 3
    """Rounds of ever narrower brackets."""
    zoom_shrink: float = 0.35
    """Half-width of a bracket as a share of that of the round before."""
    posture_width: float = 0.12
    """Half-width of the variation of postures in the first round [rad]."""
    travel_allowed: float = 0.01
    """Largest excess of a posture's time over the best one [s].

    It covers the cost of the joints' travel; slower postures are left out.
    """


MOVE = MoveSettings()


def choose_quickest(stage: OpenStage, position: FloatArray) -> StagePlan | InfeasibleError:
    """Find the fastest stage from a position, or explain why there is none.

    The stage lasts as long as the slower arm: max(T_platform, T_arm) + approach + dwell + retract. For a given platform
    angle the arms are independent, so the duration is a function of one variable. It is estimated without lines on a
    grid of angles and at every candidate of the `exact` solver (roots, stationary points, ends of reach). Postures are
    chosen in full at its best local minima and at the angles of SIMPLER. Around the best, angle and postures are
    refined together in ever narrower brackets. Among equally fast stages the least platform turn wins. Without
    refinement, brackets are omitted, and SIMPLER if any other angle is feasible.

    With refinement, by the same estimate, the stage is never longer than that of `fixed`, `exact` or `linearised` from
    the same position. It may not be the global minimum: grid and brackets can miss it.

    Args:
        stage: tasks of the stage.
        position: all joints before the stage [rad], shape (n,).
    """
    model = stage.model
    if not model.platform.is_chosen:
        plan = choose_stage(stage, {"fixed": position})["fixed"]
        return replace(plan, solver=MINIMUM_TIME) if isinstance(plan, StagePlan) else plan
    places = {
        f"{MINIMUM_TIME} {k}": [(MINIMUM_TIME, np.array([angle]))]
        for k, angle in enumerate(_promising(stage, position))
    }
    attempts = {name: iter(rows) for name, rows in places.items()}
    outcomes: dict[str, StagePlan | Mapping[str, NoPosture]] = {}
    if not stage.refine:
        outcomes = first_that_serve(stage, dict.fromkeys(attempts, position), attempts)
    if not any(isinstance(plan, StagePlan) for plan in outcomes.values()):
        attempts = {name: places_to_try(stage, position, name) for name in SIMPLER}
        attempts |= {name: iter(rows) for name, rows in places.items()}
        outcomes = first_that_serve(stage, dict.fromkeys(attempts, position), attempts)
    plans = [plan for plan in outcomes.values() if isinstance(plan, StagePlan)]
    if not plans:
        reasons = outcomes["fixed"]
        return explain(stage, position, {} if isinstance(reasons, StagePlan) else reasons)
    best = _quickest(stage, plans)
    if stage.refine:
        best = _zoomed(stage, position, best)
    return replace(best, solver=MINIMUM_TIME)


def _angle(stage: OpenStage, plan: StagePlan) -> float:
    return float(plan.arrival[stage.model.platform_columns[0]])


def _step(stage: OpenStage) -> float:
    """Return the spacing of platform positions: `grid_step`, or its equivalent on a rail.

    In rad, or in m on a rail.
    """
    limits = stage.model.cell.robot.limits
    column = stage.model.platform_columns[0]
    return stage.model.platform.spacing(
        MOVE.grid_step, float(limits.lower[column]), float(limits.upper[column])
    )


def _quickest(stage: OpenStage, plans: Sequence[StagePlan]) -> StagePlan:
    """Return the fastest stage; among equals, the one with the smallest platform move."""
    column = stage.model.platform_columns[0]
    least = min(plan.duration for plan in plans) + SAME_TIME
    return min(
        (plan for plan in plans if plan.duration <= least),
        key=lambda plan: abs(plan.arrival[column] - plan.start[column]),
    )


def _promising(stage: OpenStage, position: FloatArray) -> FloatArray:
    """Return the best local minima of the estimated stage time, as platform angles [rad]."""
    model, at_start = stage.model, stage.at_start(position)
    here, low, high = model.platform_around(position)
    step = _step(stage)
    below, above = int((here - low) / step), int((high - here) / step)
    grid = here + step * np.arange(-below, above + 1)
    balanced = [float(a[0]) for _, a in platform_candidates(model, position, at_start, "exact")]
    angles = distinct(np.concatenate([grid, balanced, [low, high]]))
    angles = angles[(angles >= low) & (angles <= high)]
    time = _first_idea(stage, at_start, angles - here)
    before, after = np.append(np.inf, time[:-1]), np.append(time[1:], np.inf)
    minima = np.flatnonzero(np.isfinite(time) & (time <= before) & (time <= after))
    order = np.lexsort((np.abs(angles[minima] - here), time[minima]))
    return angles[minima[order[: MOVE.promising]]]


def _first_idea(
    stage: OpenStage, at_start: Mapping[str, StopProblem], turn: FloatArray
) -> FloatArray:
    """Estimate the stage time after further platform moves [s], shape (m,).

    Lines are left out, and what the arms of a hand-over wait for each other.
    """
    waiting = stage.clock.platform_times(turn[:, None])
    there, dwells = [np.zeros(len(turn))], [0.0]
    for name, problem in at_start.items():
        if problem.free_yaw:
            few = problem.yaw[:: max(1, len(problem.yaw) // MOVE.free_yaws)]
            problem = replace(problem, yaw=few)
        # Where the transfer ends: at the start of the approach, if there is one.
        R, p = moved_flanges(problem, stage.model.platform, turn)[1 if problem.approach > 0 else 0]
        transfer = least_transfer_times(problem, np.broadcast_to(R, (*p.shape[:2], 3, 3)), p)
        there.append(np.maximum(transfer, waiting))
        dwells.append(stage.work[name][1].dwell.total)
    return stage_length(there, dwells)


def _zoomed(stage: OpenStage, position: FloatArray, best: StagePlan) -> StagePlan:
    """Refine a stage's platform angle in ever narrower brackets."""
    column = stage.model.platform_columns[0]
    limits = stage.model.cell.robot.limits
    for k in range(MOVE.zoom_rounds):
        shrink = power(MOVE.zoom_shrink, k)
        angles = _angle(stage, best) + _step(stage) * shrink * np.array(MOVE.zoom)
        angles = np.clip(angles, limits.lower[column], limits.upper[column])
        made = _stages_near(stage, position, angles, best, MOVE.posture_width * shrink)
        best = _quickest(stage, [best, *made])
    return best


def _stages_near(
    stage: OpenStage, position: FloatArray, angles: FloatArray, like: StagePlan, width: float
) -> list[StagePlan]:
    """Compute stages at platform angles (m,) near a given stage; leave out slower ones."""
    problems = stage.from_position(position, angles[:, None])
    each = [(k, arm) for k in range(len(angles)) for arm in problems[k]]
    answers = choose_near(
        [problems[k][arm] for k, arm in each],
        [like.stops[arm].posture for _, arm in each],
        [like.duration - stage.work[arm][1].dwell.total + MOVE.travel_allowed for _, arm in each],
        width,
    )
    postures: list[dict[str, StopPosture]] = [{} for _ in angles]
    for (k, arm), answer in zip(each, answers, strict=True):
        if answer is not None:
            postures[k][arm] = answer
    plans = []
    for k, chosen in enumerate(postures):
        apart = stage.keep is None or stage.keep.arms_clear(position, angles[k : k + 1], chosen)
        if len(chosen) == len(problems[k]) and apart:
            plan = stage_plan(stage, position, MINIMUM_TIME, angles[k : k + 1], problems[k], chosen)
            if isinstance(plan, StagePlan):
                plans.append(plan)
    return plans
