"""One stage: postures at platform positions of one's choice, and the first position that will do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Stop, Task
from dualarm_cli.planning.keep_clear import KeepClear
from dualarm_cli.planning.platform_candidates import platform_candidates
from dualarm_cli.planning.reach import explain_reach, reachable_positions
from dualarm_cli.planning.stage_plan import ArmStop, StagePlan, stage_length
from dualarm_cli.planning.stage_problems import Clock, stage_problems
from dualarm_cli.planning.touching import angles_looked_at, explain_touching
from dualarm_cli.redundancy import NoPosture, StopPosture, StopProblem, solve_stops

MEET = (
    "its posture and the other arm's are too near to each other, whichever of those tried they take"
)
"""Why there is none for two arms together."""
REACH = "reach"
"""What a stage's solver is called where none of its angles would do."""


@dataclass(frozen=True)
class Stage:
    """One stage to be decided, for whatever comes before it."""

    model: CellModel
    clock: Clock
    work: Mapping[str, tuple[Task, Stop]]
    redundancy: str
    refine: bool
    keep: KeepClear | None = None

    def from_position(
        self, position: FloatArray, angles: FloatArray
    ) -> list[dict[str, StopProblem]]:
        """Returns the arms' stops with the platform at positions (m, k)."""
        return stage_problems(
            self.model, self.clock, position, angles, self.work, refine=self.refine, keep=self.keep
        )

    def at_start(self, position: FloatArray) -> dict[str, StopProblem]:
        """Returns the arms' stops with the platform where it is."""
        return self.from_position(position, position[self.model.platform_columns][None])[0]


def choose_stage(
    stage: Stage, positions: Mapping[str, FloatArray]
) -> dict[str, StagePlan | InfeasibleError]:
    """Returns by solver the stage at the first platform position at which every arm finds a posture.

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
    stage: Stage,
    positions: Mapping[str, FloatArray],
    tries: Mapping[str, Iterator[tuple[str, FloatArray]]],
) -> dict[str, StagePlan | Mapping[str, NoPosture]]:
    """Returns by name the stage at the first place to try that serves, or the arms' reasons against its own last one.

    Args:
        stage: what is to be done.
        positions: all joints before the stage [rad], shape (n,), by name.
        tries: platform positions in order, each with the name of what gave it, by name.
    """
    left = dict(tries)
    reasons: dict[str, Mapping[str, NoPosture]] = {name: {} for name in left}
    found: dict[str, StagePlan | Mapping[str, NoPosture]] = {}
    while left:
        asked = {name: next(places, None) for name, places in left.items()}
        places = {name: one for name, one in asked.items() if one is not None}
        made = try_places(stage, positions, places)
        for name, one in asked.items():
            if one is None:
                found[name] = reasons[name]
            elif isinstance(plan := made[name], StagePlan):
                found[name] = plan
            elif one[0] != REACH:
                reasons[name] = plan
        left = {name: places for name, places in left.items() if name not in found}
    return found


def places_to_try(
    stage: Stage, position: FloatArray, platform: str
) -> Iterator[tuple[str, FloatArray]]:
    """Yields platform positions to try, each with the name of what gave it."""
    at_start = stage.at_start(position)
    yield from platform_candidates(stage.model, position, at_start, platform)
    for angles in reachable_positions(stage.model, position, at_start):
        yield REACH, angles


def try_places(
    stage: Stage,
    positions: Mapping[str, FloatArray],
    places: Mapping[str, tuple[str, FloatArray]],
) -> dict[str, StagePlan | dict[str, NoPosture]]:
    """Returns by solver the stage at one platform position, or every arm's reason against it.

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
    stage: Stage,
    keep: KeepClear,
    position: FloatArray,
    angles: FloatArray,
    problems: Mapping[str, StopProblem],
    postures: dict[str, StopPosture | NoPosture],
) -> dict[str, StopPosture | NoPosture]:
    """Returns postures of two arms that keep clear of each other: of one of them, another one where they do not.

    Where nothing else is found, they need to only where their retracts end: one may wait for the other.

    Args:
        stage: what is to be done.
        keep: what has to keep clear.
        position: all joints before the stage [rad], shape (n,).
        angles: where the platform is then, shape (k,).
        problems: the arms' stops there.
        postures: each arm's best one there.
    """
    found = {arm: one for arm, one in postures.items() if isinstance(one, StopPosture)}
    if len(found) < 2 or len(found) < len(postures):
        return postures
    if keep.apart(position, angles, found):
        return postures
    tries: list[dict[str, StopPosture | NoPosture]] = []
    for kept, other in (tuple(found), tuple(found)[::-1]):
        test = keep.test(other, position, angles, stage.work, {kept: found[kept]})
        [answer] = solve_stops(stage.redundancy, [replace(problems[other], clear=test)])
        if isinstance(answer, StopPosture):
            tries.append({kept: found[kept], other: answer})
    if not tries and keep.apart(position, angles, found, keep.at_once):
        return postures
    if not tries:
        return dict.fromkeys(postures, NoPosture(MEET))
    return min(
        tries, key=lambda pair: max(p.cost for p in pair.values() if isinstance(p, StopPosture))
    )


def stage_plan(
    stage: Stage,
    position: FloatArray,
    solver: str,
    angles: FloatArray,
    problems: Mapping[str, StopProblem],
    postures: Mapping[str, StopPosture | NoPosture],
) -> StagePlan | dict[str, NoPosture]:
    """Returns the stage from its postures, or the reasons against it."""
    reasons = {arm: one for arm, one in postures.items() if isinstance(one, NoPosture)}
    if reasons:
        return reasons
    turned = np.array(position)
    turned[stage.model.platform_columns] = angles
    arrival, end = turned.copy(), turned.copy()
    stops: dict[str, ArmStop] = {}
    there: dict[str, float] = {}
    work: dict[str, tuple[Stop, float]] = {}
    for arm, posture in postures.items():
        if isinstance(posture, NoPosture):
            continue
        task, stop = stage.work[arm]
        stops[arm] = ArmStop(arm, task, stop, problems[arm], posture)
        columns = stage.model.arms[arm].columns
        arrival[columns], end[columns] = posture.q_approach, posture.q_retract
        own = problems[arm].transfer_time(posture.q_approach - problems[arm].start)
        there[arm] = max(float(own), problems[arm].waiting)
        work[arm] = stop, posture.cost - there[arm]
    return StagePlan(np.array(position), arrival, end, stops, solver, stage_length(there, work))


def explain_clearance(
    stage: Stage, keep: KeepClear, position: FloatArray
) -> tuple[dict[str, str], bool]:
    """Returns by arm what it is too near to whatever it does, or what both are where each alone could do it.

    And whether that is so at all platform angles.
    """
    angles = angles_looked_at(stage.model, position)
    problems = stage.from_position(position, angles)
    faults = {
        arm: explain_touching(keep, arm, position, angles, [stops[arm] for stops in problems])
        for arm in stage.work
    }
    found = {arm: fault for arm, fault in faults.items() if fault is not None}
    together = "and the other arm's" if len(stage.work) > 1 else "along its lines"
    if found:
        return found, True
    reason = f"postures that keep clear were found for single places, but none for this stop {together} together"
    return dict.fromkeys(stage.work, reason), False


def explain(
    stage: Stage, position: FloatArray, reasons: Mapping[str, NoPosture]
) -> InfeasibleError:
    """Returns what a person needs to mend a stage that cannot be made: only the arms at fault.

    Where it is reached and lacks clearance, a BlockedError with the stage: in another order that may be different.
    """
    model = stage.model
    stops = stage.at_start(position)
    misses = {name: explain_reach(model, position, stop) for name, stop in stops.items()}
    faults = {name: fault for name, fault in misses.items() if fault is not None}
    everywhere = bool(faults)
    keep = None if faults else stage.keep
    if keep is not None:
        faults, everywhere = explain_clearance(stage, keep, position)
    if not faults:
        faults = {name: reason.reason for name, reason in reasons.items()}
        if model.platform.is_turntable and len(stage.work) > 1:
            faults = dict.fromkeys(
                stage.work, "reached, but at no platform angle that suits both arms"
            )
    lines = []
    for name, fault in faults.items():
        task, stop = stage.work[name]
        lines.append(f"{stop.place}: task '{task.id}': {name} arm cannot {stop.action}: {fault}")
    if not model.platform.joints:
        where = "no posture"
    elif model.platform.is_turntable and everywhere:
        where = "no posture at any platform angle"
    elif model.platform.is_turntable:
        where = "no posture at the platform angles that this method tries"
    else:
        where = (
            "no posture with the platform held where it starts (this version turns one joint only)"
        )
    message = where + " makes this stage:\n  " + "\n  ".join(lines)
    if keep is not None:
        never = tuple((name, stage.work[name][0].id) for name in faults) if everywhere else ()
        return BlockedError(message, (keep.stage,), alone=everywhere, never=never)
    return InfeasibleError(message)
