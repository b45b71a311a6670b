"""Choice of one stage: postures at the first feasible platform position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import TURN, arctan2, cos, sin
from dualarm_cli.geometry.products import norm, product
from dualarm_cli.geometry.rotations import outward
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.srs_arm import closed_form
from dualarm_cli.platform_angle import PLATFORM_SOLVERS, PlatformProblem
from dualarm_cli.postures import NoPosture, StopPosture, StopProblem, solve_stops
from dualarm_cli.postures.clear_postures import (
    StageCollisionTest,
    explain_collision,
    scanned_angles,
)
from dualarm_cli.postures.reach import explain_reach, reachable_positions
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, giver_and_taker
from dualarm_cli.postures.stage_problems import StageStops
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.timing.stage_length import stage_length


def platform_candidates(
    model: CellModel, position: FloatArray, stops: Mapping[str, StopProblem], solver: str
) -> Iterator[tuple[str, FloatArray]]:
    """Yield a solver's platform positions, preferred first, with the method's name.

    No solver of the family has two elbows to balance, and the platform stays where it is, in a stage of joint
    targets only (they turn with it), in a stage with one arm at work, and where it is not one revolute joint.

    Args:
        model: the cell.
        position: all joints before the stage [rad], shape (n,).
        stops: the arms' stops as seen with the platform where it is.
        solver: name of the platform solver.
    """
    here = position[model.platform_columns]
    in_world = sum(stop.configurations is None for stop in stops.values())
    if not model.platform.is_turntable or len(stops) < 2 or not in_world or solver == "fixed":
        yield "fixed", here
        return
    solution = PLATFORM_SOLVERS[solver].solve(stage_problem(model, position, stops))
    limits = model.cell.robot.limits.select(model.platform.joints)
    for angle in solution.preferred(0):
        turns = TURN * np.arange(-2, 3)
        inside = [a for a in angle + turns if limits.lower[0] <= a <= limits.upper[0]]
        if inside:
            yield solver, np.array([min(inside, key=lambda a: abs(a - here[0]))])


def stage_problem(
    model: CellModel, position: FloatArray, stops: Mapping[str, StopProblem]
) -> PlatformProblem:
    """Build the platform-angle problem of a stage in which both arms work.

    The wrist centres are those of the transfer's end (the start of the approach), at the first yaw.
    """
    angle = float(position[model.platform_columns][0])
    shoulder, upper, fore, wrist, elbow = [], [], [], [], []
    for name, stop in stops.items():
        arm = model.arms[name].closed_form
        upper.append(arm.geometry.upper)
        fore.append(arm.geometry.fore)
        before = _wrist_before_approach(stop)
        if stop.configurations is None:
            shoulder.append(arm.geometry.shoulder)
            wrist.append(in_axis_frame(before, angle))
        else:
            # Joint targets turn with the platform: as for a shoulder on the axis, no angle changes the elbow.
            height = arm.geometry.shoulder[2]
            reach = float(norm(before - arm.geometry.shoulder))
            shoulder.append(np.array([0.0, 0.0, height]))
            wrist.append(np.array([reach, 0.0, height]))
        elbow.append(float(arm.elbow_interior_angle(stop.start[3])))
    points = np.array(shoulder)
    return PlatformProblem.broadcast(
        shoulder=(
            np.hypot(points[:, 0], points[:, 1]),
            arctan2(points[:, 1], points[:, 0]),
            points[:, 2],
        ),
        links=(np.array(upper), np.array(fore)),
        wrist=np.array(wrist)[None],
        angle_0=np.array([angle]),
        elbow_0=np.array([elbow]),
    )


def _wrist_before_approach(stop: StopProblem) -> FloatArray:
    """Compute the wrist centre before the approach, carried frame [m], shape (3,)."""
    R_tool = stop.R_base_tool[0]
    away = outward(stop.directions, R_tool, np.eye(3))[0]
    p_tool = stop.p_base_tool[0] + away * stop.approach
    wrist: FloatArray = closed_form(stop.arm).wrist_center(
        product(R_tool, stop.R_tool_flange), p_tool + product(R_tool, stop.p_tool_flange)
    )
    return wrist


def in_axis_frame(point: FloatArray, angle: float) -> FloatArray:
    """Transform a point from the carried frame to the fixed platform axis frame."""
    c, s = cos(angle), sin(angle)
    x, y, z = point
    return np.array([c * x - s * y, s * x + c * y, z])


REACH = "reach"
"""Solver name of a stage at which all of its solver's angles failed."""


@dataclass(frozen=True)
class OpenStage(StageStops):
    """Stage to be decided, independent of the previous stages."""

    redundancy: str
    """Name of the redundancy solver."""


def choose_stage(
    stage: OpenStage, positions: Mapping[str, FloatArray]
) -> dict[str, StagePlan | InfeasibleError]:
    """Choose by solver the first platform position at which every arm has a posture.

    Args:
        stage: what is to be done.
        positions: all joints before the stage [rad], shape (n,), by platform solver.
    """
    tries = {name: places_to_try(stage, position, name) for name, position in positions.items()}
    return {
        name: plan if isinstance(plan, StagePlan) else explain(stage, positions[name], plan)
        for name, plan in first_that_serve(stage, positions, tries).items()
    }


def first_that_serve(
    stage: OpenStage,
    positions: Mapping[str, FloatArray],
    tries: Mapping[str, Iterator[tuple[str, FloatArray]]],
) -> dict[str, StagePlan | Mapping[str, NoPosture]]:
    """Return each solver's stage at its first feasible position, or the arms' refusals.

    Args:
        stage: what is to be done.
        positions: all joints before the stage [rad], shape (n,), by name.
        tries: platform positions in order, each with the name of what gave it, by name.
    """
    remaining = dict(tries)
    reasons: dict[str, Mapping[str, NoPosture]] = {name: {} for name in remaining}
    outcomes: dict[str, StagePlan | Mapping[str, NoPosture]] = {}
    while remaining:
        attempts = {name: next(places, None) for name, places in remaining.items()}
        places = {name: attempt for name, attempt in attempts.items() if attempt is not None}
        plans = try_places(stage, positions, places)
        for name, attempt in attempts.items():
            if attempt is None:
                outcomes[name] = reasons[name]
            elif isinstance(plan := plans[name], StagePlan):
                outcomes[name] = plan
            elif attempt[0] != REACH:
                reasons[name] = plan
        remaining = {name: places for name, places in remaining.items() if name not in outcomes}
    return outcomes


def places_to_try(
    stage: OpenStage, position: FloatArray, platform: str
) -> Iterator[tuple[str, FloatArray]]:
    """Yield platform positions to try, each with its source's name."""
    at_start = stage.at_start(position)
    yield from platform_candidates(stage.model, position, at_start, platform)
    for angles in reachable_positions(stage.model, position, at_start):
        yield REACH, angles


def try_places(
    stage: OpenStage,
    positions: Mapping[str, FloatArray],
    places: Mapping[str, tuple[str, FloatArray]],
) -> dict[str, StagePlan | dict[str, NoPosture]]:
    """Plan the stage at one platform position by solver, or explain each arm's refusal.

    Args:
        stage: what is to be done.
        positions: all joints before the stage, by solver.
        places: what gave the platform position, and the position, by solver.
    """
    keys = {
        name: (positions[name].tobytes(), angles.tobytes()) for name, (_, angles) in places.items()
    }
    firsts = {key: name for name, key in reversed(keys.items())}
    problems = {
        key: stage.from_position(positions[name], places[name][1][None])[0]
        for key, name in firsts.items()
    }
    each = [(key, arm) for key, stops in problems.items() for arm in stops]
    answers = solve_stops(stage.redundancy, [problems[key][arm] for key, arm in each])
    postures: dict[tuple[bytes, bytes], dict[str, StopPosture | NoPosture]] = {}
    for (key, arm), answer in zip(each, answers, strict=True):
        postures.setdefault(key, {})[arm] = answer
    if stage.keep is not None:
        for key, name in firsts.items():
            angles = places[name][1]
            postures[key] = made_apart(
                stage, stage.keep, positions[name], angles, problems[key], postures[key]
            )
    return {
        name: stage_plan(stage, positions[name], *places[name], problems[key], postures[key])
        for name, key in keys.items()
    }


def made_apart(
    stage: OpenStage,
    keep: StageCollisionTest,
    position: FloatArray,
    angles: FloatArray,
    problems: Mapping[str, StopProblem],
    postures: dict[str, StopPosture | NoPosture],
) -> dict[str, StopPosture | NoPosture]:
    """Replace one arm's posture if the postures of two arms collide.

    Where nothing else is found, they need to only where their retracts end: one may wait for the other.

    Args:
        stage: what is to be done.
        keep: what has to be collision-free.
        position: all joints before the stage [rad], shape (n,).
        angles: where the platform is then, shape (k,).
        problems: the arms' stops there.
        postures: each arm's best one there.
    """
    reached = {arm: p for arm, p in postures.items() if isinstance(p, StopPosture)}
    if len(reached) < 2 or len(reached) < len(postures):
        return postures
    if keep.arms_clear(position, angles, reached):
        return postures
    tries: list[dict[str, StopPosture | NoPosture]] = []
    for kept, changed in (tuple(reached), tuple(reached)[::-1]):
        test = keep.test(changed, position, angles, stage.work, {kept: reached[kept]})
        [answer] = solve_stops(stage.redundancy, [replace(problems[changed], is_free=test)])
        if isinstance(answer, StopPosture):
            tries.append({kept: reached[kept], changed: answer})
    if not tries and keep.arms_clear(position, angles, reached, keep.common_places):
        return postures
    if not tries:
        return dict.fromkeys(postures, NoPosture(Refusal("arms_touch")))
    return min(
        tries, key=lambda pair: max(p.cost for p in pair.values() if isinstance(p, StopPosture))
    )


def stage_plan(
    stage: OpenStage,
    position: FloatArray,
    solver: str,
    angles: FloatArray,
    problems: Mapping[str, StopProblem],
    postures: Mapping[str, StopPosture | NoPosture],
) -> StagePlan | dict[str, NoPosture]:
    """Build the stage from its postures, or explain its refusal."""
    reasons = {arm: refusal for arm, refusal in postures.items() if isinstance(refusal, NoPosture)}
    if reasons:
        return reasons
    turned = np.array(position)
    turned[stage.model.platform_columns] = angles
    arrival, end = turned.copy(), turned.copy()
    stops: dict[str, ArmStop] = {}
    there, lines, dwells = [], [], []
    for arm, posture in postures.items():
        if isinstance(posture, NoPosture):
            continue
        task, stop = stage.work[arm]
        # A collision test is a local function, which no process can send to another one.
        stops[arm] = ArmStop(arm, task, stop, replace(problems[arm], is_free=None), posture)
        columns = stage.model.arms[arm].columns
        arrival[columns], end[columns] = posture.q_approach, posture.q_retract
        transfer = problems[arm].transfer_time(posture.q_approach - problems[arm].start)
        there.append(max(float(transfer), problems[arm].waiting))
        lines.append(posture.cost - there[-1])
        dwells.append(stop.dwell.total)
    length = stage_length(there, lines, dwells, giver_and_taker(stops) is not None)
    return StagePlan(np.array(position), arrival, end, stops, solver, float(length))


def explain_clearance(
    stage: OpenStage, keep: StageCollisionTest, position: FloatArray
) -> tuple[dict[str, Refusal], bool]:
    """Explain by arm which bodies collide in every posture.

    The flag says whether they collide at every platform angle.
    """
    angles = scanned_angles(stage.model, position)
    problems = stage.from_position(position, angles)
    faults = {
        arm: explain_collision(keep, arm, position, angles, [stops[arm] for stops in problems])
        for arm in stage.work
    }
    reasons = {arm: fault for arm, fault in faults.items() if fault is not None}
    if reasons:
        return reasons, True
    reason = "no_pair_of_postures" if len(stage.work) > 1 else "no_postures_together"
    return dict.fromkeys(stage.work, Refusal(reason)), False


def explain(
    stage: OpenStage, position: FloatArray, reasons: Mapping[str, NoPosture]
) -> InfeasibleError:
    """Explain an infeasible stage by the arms at fault.

    Where it is reached and lacks clearance, a BlockedError with the stage: in another order that may be different.
    """
    model = stage.model
    stops = stage.at_start(position)
    misses = {name: explain_reach(model, position, stop) for name, stop in stops.items()}
    faults = {name: fault for name, fault in misses.items() if fault is not None}
    everywhere = bool(faults)
    keep = None if faults else stage.keep
    if keep is not None:
        near, everywhere = explain_clearance(stage, keep, position)
        faults.update(near)
    if not faults:
        faults = {name: reason.reason for name, reason in reasons.items()}
        if model.platform.is_chosen and len(stage.work) > 1:
            common = "no_common_place" if model.platform.is_rail else "no_common_angle"
            faults = dict.fromkeys(stage.work, Refusal(common))
    if not model.platform.joints:
        key = "no_posture"
    elif not model.platform.is_chosen:
        key = "no_posture_from_start"
    elif model.platform.is_rail:
        key = "no_posture_at_any_place" if everywhere else "no_posture_at_places_tried"
    else:
        key = "no_posture_at_any_angle" if everywhere else "no_posture_at_angles_tried"
    refusals = []
    for name, fault in faults.items():
        task, stop = stage.work[name]
        data = {"action": stop.action, "cause": fault}
        refusals.append(Refusal(key, stop.place, task.id, name, data=data))
    if keep is not None:
        never = tuple((name, stage.work[name][0].id) for name in faults) if everywhere else ()
        return BlockedError(*refusals, stages=(keep.stage,), alone=everywhere, never=never)
    return InfeasibleError(*refusals)
