"""Plans whose tools pass the outer ends of lines, and targets, in motion wherever that is collision-free."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import replace

from dualarm_cli.clearing.cleared_plan import ClearedPlan
from dualarm_cli.clearing.repairs import Clearing, TimedPlan
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import Job
from dualarm_cli.motion.bent_passing import bent_ways, with_bent_ways
from dualarm_cli.motion.blending import passing_ways, with_ways
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.passed_targets import passed_targets, with_passed_targets
from dualarm_cli.motion.transfers import Drive
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.serving import with_stopping_room
from dualarm_cli.stages.stage_choice import REACH
from dualarm_cli.timing import TimingSolver


def with_room(
    problem: MethodProblem, solve: Callable[[MethodProblem], Decided]
) -> Callable[[MethodProblem], Decided]:
    """Returns a method that keeps joints so far from their limits that tools can pass lines' ends in motion.

    Args:
        problem: what it is asked, now and in variations.
        solve: the method; it serves where that leaves no plan.
    """
    with_margin = with_stopping_room(problem)
    serves = True

    def solved(asked: MethodProblem) -> Decided:
        nonlocal serves
        if serves:
            try:
                job = replace(asked.job, cell=with_margin.job.cell)
                found = solve(
                    replace(asked, model=with_margin.model, job=job, without_margin=asked)
                )
            except InfeasibleError:
                if asked.neighbourhood_only:
                    raise
                found = None
            # At the platform angle that a method wants, reach may end a little earlier.
            if found is not None and all(one.solver != REACH for one in found.stages):
                return found
            # Where room is missing once, it is missing in all variations.
            serves = False
        return solve(asked)

    return solved


def shortest_blended(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
) -> ClearedPlan:
    """Returns the shortest of a plan and its rivals when all are blended, see `blended_plan`."""
    best = blended_plan(problem, found, timing)
    for rival in found.rivals:
        plan = replace(found, cleared=rival, rivals=())
        try:
            other = blended_plan(problem, plan, timing)
        except InfeasibleError:
            continue
        best = min(best, other, key=lambda one: one.cleared.duration)
    return best


def blended_plan(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
    stopping: Collection[tuple[int, str]] = (),
) -> ClearedPlan:
    """Returns a plan whose tools pass the outer ends of lines in motion, wherever that is collision-free.

    Args:
        problem: what was asked.
        found: the plan with all stops.
        timing: how motions are timed.
        stopping: transfers between stops all the same, by the stage that they lead to and arm.
    """
    model, job, cache = problem.model, problem.job, found.cache
    drive = Drive.of(model, job, timing, cache)
    clearing = found.clearing(problem, timing)
    before = found.cleared.motion
    through = passed_targets(drive, found.cleared.plans, stopping)
    passing = with_passed_targets(drive, found.cleared.plans, through)
    widths = problem.settings.widths
    ways = dict(passing_ways(drive, passing, stopping, widths))
    colliding_stages: list[int] = []
    while ways or through:
        plans = with_ways(with_passed_targets(drive, found.cleared.plans, through), ways)
        try:
            motion = realise(model, job, plans, timing, cache)
        except InfeasibleError:
            if not through:
                raise
            # An arm cannot pass its target as late as the stage ends.
            through = {}
            ways = dict(passing_ways(drive, found.cleared.plans, stopping, widths))
            continue
        colliding_stages = clearing.colliding_stages(plans, motion) if clearing is not None else []
        # A stage has the transfers to its lines, and ends as those of the next one begin.
        own = {key for key in ways if key[0] in colliding_stages}
        own = own or {key for key in ways if key[0] - 1 in colliding_stages}
        passed = {k for k in through if {k, k + 1} & set(colliding_stages)}
        if not own and not passed:
            break
        for key in own:
            del ways[key]
        for k in passed:
            del through[k]
        # Ways beside it were chosen for that state.
        ways = {key: way for key, way in ways.items() if not {key[0], key[0] - 1} & passed}
    if colliding_stages or not (ways or through):
        plans, motion = found.cleared.plans, before
    plans, motion = _with_detours_in_motion(drive, job, clearing, plans, motion, stopping)
    gain = before.trajectory.duration - motion.trajectory.duration
    if gain <= 0.0:
        same = replace(found.cleared, motion=replace(before, gain=0.0))
        return replace(found, cleared=same, stopping=found.cleared)
    stages = tuple(
        replace(stage, saved=(other.end - other.start) - (stage.end - stage.start))
        for stage, other in zip(motion.stages, before.stages, strict=True)
    )
    motion = replace(motion, stages=stages, gain=gain)
    return replace(found, cleared=TimedPlan(plans, motion), stopping=found.cleared)


def _with_detours_in_motion(
    drive: Drive,
    job: Job,
    clearing: Clearing | None,
    plans: list[StagePlan],
    motion: Motion,
    stopping: Collection[tuple[int, str]],
) -> tuple[list[StagePlan], Motion]:
    """Returns stages and motion whose detours begin and end in motion, wherever that is quicker and collision-free."""
    tries = bent_ways(drive, plans, stopping)
    while tries:
        chosen = {key: ways[0] for key, ways in tries.items()}
        bent = with_bent_ways(drive, plans, chosen)
        try:
            found = realise(drive.model, job, bent, drive.timing, drive.cache)
        except InfeasibleError:
            # With what the platform does then, one of them cannot be timed.
            own = set(tries)
        else:
            colliding_stages = (
                clearing.colliding_stages(bent, found) if clearing is not None else []
            )
            own = {key for key in tries if key[0] in colliding_stages}
            own = own or {key for key in tries if key[0] - 1 in colliding_stages}
            if not colliding_stages and found.trajectory.duration < motion.trajectory.duration:
                return bent, found
            if not own:
                break
        # What collides is tried by the next via point.
        tries = {key: ways[key in own :] for key, ways in tries.items()}
        tries = {key: ways for key, ways in tries.items() if ways}
    return plans, motion
