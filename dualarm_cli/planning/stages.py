"""Decisions, stage by stage: platform angle by its solver, then one posture per arm."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job, Stop, Task
from dualarm_cli.planning.platform_candidates import platform_candidates
from dualarm_cli.planning.reach import explain_reach, reachable_positions
from dualarm_cli.planning.stage_problems import Clock, stage_problems, stop_problems, stop_yaws
from dualarm_cli.redundancy import NoPosture, StopPosture, StopProblem, solve_stops

__all__ = [
    "ArmStop",
    "StagePlan",
    "choose_stages",
    "choose_stages_with",
    "stop_problems",
    "stop_yaws",
]

REACH = "reach"
"""What a stage's solver is called where none of its angles would do."""


@dataclass(frozen=True)
class ArmStop:
    """What one arm does in a stage."""

    arm: str
    """Name of the arm."""
    task: Task
    """The task it works on."""
    stop: Stop
    """The target."""
    problem: StopProblem
    """The stop as the redundancy solver saw it, for the lines."""
    posture: StopPosture
    """How the stop is made."""


@dataclass(frozen=True)
class StagePlan:
    """Everything decided about one stage; times follow from it."""

    start: FloatArray
    """All joints before [rad], shape (n,)."""
    arrival: FloatArray
    """All joints after the transfer [rad], shape (n,)."""
    end: FloatArray
    """All joints after the retracts [rad], shape (n,)."""
    stops: Mapping[str, ArmStop]
    """By arm; an arm without a partner's work in this stage is missing. Empty for a return."""
    solver: str
    """The method that gave the platform angle."""
    duration: float
    """Length of the stage [s]: transfers and dwells in closed form, lines as estimated."""


@dataclass(frozen=True)
class _Stage:
    """One stage to be decided, for whatever comes before it."""

    model: CellModel
    clock: Clock
    work: Mapping[str, tuple[Task, Stop]]
    redundancy: str
    refine: bool

    def from_position(
        self, position: FloatArray, angles: FloatArray
    ) -> list[dict[str, StopProblem]]:
        """Returns the arms' stops with the platform at positions (m, k)."""
        return stage_problems(
            self.model, self.clock, position, angles, self.work, refine=self.refine
        )


def choose_stages(
    model: CellModel,
    job: Job,
    platform: str,
    redundancy: str,
    *,
    refine: bool = True,
    count: int | None = None,
) -> list[StagePlan]:
    """Returns the stages of a job, decided greedily in their order.

    Args:
        model: the job's cell.
        job: what is to be done.
        platform: name of the platform solver.
        redundancy: name of the redundancy solver.
        refine: whether postures are refined; without it stages are decided faster, to compare.
        count: how many stages are decided; all of them by default.

    Raises:
        InfeasibleError: a target that no posture reaches, with its place and by how much it misses.
    """
    plans = choose_stages_with(model, job, [platform], redundancy, refine=refine, count=count)
    found = plans[platform]
    if isinstance(found, InfeasibleError):
        raise found
    return found


def choose_stages_with(
    model: CellModel,
    job: Job,
    platforms: Sequence[str],
    redundancy: str,
    *,
    refine: bool = True,
    count: int | None = None,
) -> dict[str, list[StagePlan] | InfeasibleError]:
    """Returns the stages of a job as several platform solvers decide them, each for itself, or why one cannot.

    Stage by stage all of them together, so that postures from every solver's positions are computed at once.

    Args:
        model: the job's cell.
        job: what is to be done.
        platforms: names of the platform solvers.
        redundancy: name of the redundancy solver.
        refine: whether postures are refined.
        count: how many stages are decided; all of them by default.
    """
    clock = Clock.of(model, job)
    home = np.array(job.cell.robot.postures["home" if job.start == "free" else job.start])
    plans: dict[str, list[StagePlan]] = {name: [] for name in platforms}
    failures: dict[str, InfeasibleError] = {}
    for work in job.stages()[:count]:
        stage = _Stage(model, clock, work, redundancy, refine)
        positions = {
            name: np.array(found[-1].end) if found else home
            for name, found in plans.items()
            if name not in failures
        }
        for name, plan in _choose_stage(stage, positions).items():
            if isinstance(plan, InfeasibleError):
                failures[name] = plan
            elif not plans[name] and job.start == "free":
                plans[name].append(replace(plan, start=plan.arrival))
            else:
                plans[name].append(plan)
    for found in plans.values():
        if job.returns and found:
            found.append(_return(model, clock, found))
    return {name: failures.get(name, plans[name]) for name in platforms}


def _return(model: CellModel, clock: Clock, plans: Sequence[StagePlan]) -> StagePlan:
    """Returns the last transfer, back to where the first one began."""
    position, first = plans[-1].end, plans[0].start
    moved = first - position
    longest = max(
        float(clock.platform_times(moved[model.platform_columns])),
        *(
            float(clock.arms[name].law.duration(moved[arm.columns]))
            for name, arm in model.arms.items()
        ),
    )
    return StagePlan(position, first, first, {}, "return", longest)


def _choose_stage(
    stage: _Stage, positions: Mapping[str, FloatArray]
) -> dict[str, StagePlan | InfeasibleError]:
    """Returns by solver the stage at the first platform position at which every arm finds a posture.

    Args:
        stage: what is to be done.
        positions: all joints before the stage [rad], shape (n,), by platform solver.
    """
    tries = {name: _tries(stage, position, name) for name, position in positions.items()}
    reasons: dict[str, Mapping[str, NoPosture]] = {name: {} for name in positions}
    found: dict[str, StagePlan | InfeasibleError] = {}
    while tries:
        asked = {name: next(angles, None) for name, angles in tries.items()}
        places = {name: one for name, one in asked.items() if one is not None}
        made = _try_places(stage, positions, places)
        for name, one in asked.items():
            if one is None:
                found[name] = _explain(stage, positions[name], reasons[name])
            elif isinstance(plan := made[name], StagePlan):
                found[name] = plan
            elif one[0] != REACH:
                reasons[name] = plan
        tries = {name: angles for name, angles in tries.items() if name not in found}
    return found


def _tries(stage: _Stage, position: FloatArray, platform: str) -> Iterator[tuple[str, FloatArray]]:
    """Yields platform positions to try, each with the name of what gave it."""
    here = position[stage.model.platform_columns]
    at_start = stage.from_position(position, here[None])[0]
    yield from platform_candidates(stage.model, position, at_start, platform)
    for angles in reachable_positions(stage.model, position, at_start):
        yield REACH, angles


def _try_places(
    stage: _Stage,
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
    return {
        name: _made(stage, positions[name], *places[name], problems[key], postures[key])
        for name, key in keys.items()
    }


def _made(
    stage: _Stage,
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
    arrival, end, longest = turned.copy(), turned.copy(), 0.0
    stops: dict[str, ArmStop] = {}
    for arm, posture in postures.items():
        if isinstance(posture, NoPosture):
            continue
        task, stop = stage.work[arm]
        stops[arm] = ArmStop(arm, task, stop, problems[arm], posture)
        columns = stage.model.arms[arm].columns
        arrival[columns], end[columns] = posture.q_approach, posture.q_retract
        longest = max(longest, posture.cost + stop.dwell.total)
    return StagePlan(np.array(position), arrival, end, stops, solver, longest)


def _explain(
    stage: _Stage, position: FloatArray, reasons: Mapping[str, NoPosture]
) -> InfeasibleError:
    """Returns what a person needs to mend a stage that cannot be made: only the arms at fault."""
    model = stage.model
    stops = stage.from_position(position, position[model.platform_columns][None])[0]
    faults = {name: explain_reach(model, position, stop) for name, stop in stops.items()}
    faults = {name: fault for name, fault in faults.items() if fault is not None}
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
    elif model.platform.is_turntable:
        where = "no posture at any platform angle"
    else:
        where = (
            "no posture with the platform held where it starts (this version turns one joint only)"
        )
    return InfeasibleError(where + " makes this stage:\n  " + "\n  ".join(lines))
