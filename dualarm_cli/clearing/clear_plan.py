"""A method's quickest collision-free plan: first without collision checking, then with it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import field, replace

import numpy as np

from dualarm_cli.clearing.repairs import Cleared, Clearing
from dualarm_cli.clearing.stage_samples import StageSamples, alone_clear, stage_samples
from dualarm_cli.collision.lying import too_near
from dualarm_cli.effort import EFFORTS, less_effort
from dualarm_cli.errors import BlockedError, InfeasibleError
from dualarm_cli.model.job import Job, PoseTarget
from dualarm_cli.motion.bent_passing import bent_ways, with_bent_ways
from dualarm_cli.motion.blending import passing_ways, with_ways
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.passed_targets import passed_targets, with_passed_targets
from dualarm_cli.motion.transfers import Drive, Known
from dualarm_cli.motion.waiting import transfer_ends
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import StagePlan, same_postures
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.plans.clearance import Barred
from dualarm_cli.stages.serving import with_stopping_room
from dualarm_cli.stages.stage_choice import REACH
from dualarm_cli.timing import TimingSolver

MOST_PAIRS = 30
"""Most pairs of bodies that a message lists, worst first."""


def check_start(problem: MethodProblem, holding: Holding) -> None:
    """Refuses a start that is not collision-free: no motion begins there.

    Raises:
        InfeasibleError: with the posture, all pairs of bodies and what each lacks.
    """
    job, cell = problem.job, holding.cell
    if job.start == "free":
        return
    position = np.array(job.start_joints)
    held = holding.before[0]
    lacking = cell.lacking(position, held)
    if lacking:
        pairs = [
            Refusal("touches", measured=-margin, more={"one": one, "other": other})
            for one, other, margin in lacking
        ]
        rest = len(pairs) - MOST_PAIRS
        more = {
            "posture": job.start,
            "pairs": pairs[:MOST_PAIRS],
            "rest": f", and {rest} more pairs" if rest > 0 else "",
        }
        raise InfeasibleError(Refusal("start_touches", more=more))


def check_parts(problem: MethodProblem, holding: Holding) -> None:
    """Refuses parts that reach into something where they are picked or placed, and tools at stands: no posture helps.

    Raises:
        InfeasibleError: with task, part or tool, obstacle and depth, of all of them.
    """
    found = []
    stages = problem.job.stages()
    for (k, arm), (depth, into) in holding.misfits.items():
        task, stop = stages[k][arm]
        if isinstance(stop.target, PoseTarget) and stop.target.free_yaw:
            continue  # between the turns that were tried there are others
        what = "tool_reaches_into" if task.is_change else "part_reaches_into"
        held = task.tool if task.is_change else task.part
        more = {"action": stop.action.split("_")[0], "held": held, "into": into}
        found.append(Refusal(what, stop.place, task.id, arm, depth, more=more))
    if found:
        raise InfeasibleError(*found)


def check_grips(problem: MethodProblem) -> None:
    """Refuses hand-overs in which tools or part are too near to each other: no posture changes that.

    Raises:
        InfeasibleError: with task, bodies and what is missing, of all of them.
    """
    tasks = problem.job.tasks
    takes = {task.id: task.stops[0] for task in tasks if task.stops[0].action == "take"}
    found = []
    for task in tasks:
        work, give = task.handover, task.stops[-1]
        if work is None or give.action != "give":
            continue
        lengths = takes[task.id].approach, give.retract
        for one in too_near(problem.job.cell, work, task.id, task.part, *lengths):
            more = {"where": one.where, "one": one.bodies[0], "other": one.bodies[1]}
            found.append(
                Refusal("grip_touches", work.place, task.id, task.arm, -one.margin, more=more)
            )
    if found:
        raise InfeasibleError(*found)


MANY = 0.02
"""Share of stages; where lines touch in more of them, another order is better than repairing."""


def refuse_touching_lines(clearing: Clearing, plans: list[StagePlan], motion: Motion) -> None:
    """Refuses many stages in which both arms' lines touch: no repairing helps them as much as another order.

    Args:
        clearing: the job.
        plans: its stages.
        motion: theirs.

    Raises:
        BlockedError: with those stages.
    """
    apart = tuple(clearing.side_by_side(plans, clearing.touching(plans, motion)))
    if len(apart) > max(1.0, MANY * len(plans)):
        raise BlockedError(*why_blocked(clearing, Cleared(plans, motion, apart)), stages=apart)


def why_blocked(clearing: Clearing, found: Cleared | None) -> list[Refusal]:
    """Returns which stages collide, with the pair of bodies and what is missing."""
    if found is None:
        return [Refusal("not_clear")]
    refusals, cell = [], clearing.holding.cell
    standing = _standing(clearing.job, found)
    for k in found.blocked:
        samples = stage_samples(found.motion, k, k, clearing.holding)
        margins = cell.margins(samples.position, samples.held)
        worst = int(np.argmin(margins))
        one, other, margin = cell.nearest(samples.position[worst], samples.held[worst])
        stage = found.motion.stages[k]
        stops = list(found.plans[k].stops.values())
        more = {
            "one": one,
            "other": other,
            "when": (stage.end - stage.start) * worst / (len(margins) - 1),
            "stage": k + 1,
            "beside": [
                Refusal("beside", None, stop.task.id, stop.arm, more={"there": stop.stop.place})
                for stop in stops[1:]
            ],
            "standing": standing,
        }
        refused = Refusal("return_touches", measured=max(0.0, -margin), more=more)
        for stop in stops[:1]:
            whose = stop.stop.place, stop.task.id, stop.arm
            refused = Refusal("stage_touches", *whose, refused.measured, more=more)
        refusals.append(refused)
    return refusals


def _standing(job: Job, found: Cleared) -> list[Refusal]:
    """Returns which arms stand where they started in stages that collide, as their work begins later."""
    standing = []
    for arm in job.cell.robot.arms:
        first = next((k for k, plan in enumerate(found.plans) if arm.name in plan.stops), 0)
        if found.blocked and min(found.blocked) < first:
            more = {
                "posture": job.start_posture,
                "stage": first + 1,
                "start": [Refusal("starts_there")] if job.start == "free" else [],
            }
            standing.append(Refusal("stands_in_the_way", arm=arm.name, more=more))
    return standing


COSTLY = 1.5
"""What repairing a stage costs that is worth looking for another one, at full speed [s]."""


def bars_of(clearing: Clearing, tried: Cleared) -> list[Barred]:
    """Returns what a plan's blocked stages have to be different in, and what its repaired ones really cost."""
    found = []
    everything = tuple(range(len(clearing.job.cell.robot.joints)))
    # With a cap on the tools' speed all takes longer than the search thinks.
    thought = sum(plan.duration for plan in tried.plans) / clearing.holding.pace
    slow = clearing.holding.pace
    if thought > 0.0:
        slow = max(slow, tried.motion.trajectory.duration / thought)
    for k, (plan, stage) in enumerate(zip(tried.plans, tried.motion.stages, strict=True)):
        if not plan.detours and not plan.waits:
            continue
        straight = clearing.alone(replace(plan, detours={}, waits={}))
        cost = stage.end - stage.start - straight.trajectory.duration
        if cost > COSTLY * slow:
            found.append(Barred(k, everything, plan.start, plan.arrival, cost))
    for k in tried.blocked:
        plan, stage = tried.plans[k], tried.motion.stages[k]
        samples = stage_samples(tried.motion, k, k, clearing.holding)
        margins = clearing.holding.cell.margins(samples.position, samples.held)
        ends = transfer_ends(tried.motion.segments, stage.start, stage.end)
        length = stage.end - stage.start
        arrived = (min(ends, default=stage.end) - stage.start) / length if length > 0 else 0.0
        worst = int(np.argmin(margins)) / (len(margins) - 1)
        start = None if plan.stops and worst >= arrived else plan.start
        found.append(Barred(k, _joints_at_fault(clearing, samples), start, plan.arrival))
    return found


def _joints_at_fault(clearing: Clearing, samples: StageSamples) -> tuple[int, ...]:
    """Returns the columns of the arm that collides by itself, or else of all joints."""
    model, cell = clearing.model, clearing.holding.cell
    for a, name in enumerate(cell.arms):
        if not alone_clear(cell, samples, a):
            return (*model.platform_columns, *model.arms[name].columns)
    return tuple(range(samples.position.shape[1]))


NEGLIGIBLE = 0.005
"""Share of the cycle time; where repairing the unchecked plan costs no more, no other plan is looked for."""
FEW = 0.34
"""Share of stages; an unchecked plan in which more of them collide is not repaired."""
DEAR = 0.25
"""Share of the cycle time; where avoiding collisions costs more, a note says so."""
SHOWN = 5e-4
"""Costs that are shown as more than nothing [s]."""
RIVALS = 0.08
"""Share of the cycle time; where avoiding collisions costs more, simpler methods' plans may do better."""
UNLUCKY = 0.03
"""Share of the cycle time; where avoiding collisions costs more, the plan of less effort may do better: it starts
elsewhere."""
ROOM_COSTS = 0.01
"""Share of the cycle time; where blending gains less, a plan without room for it may be quicker."""
ALIKE = 0.03
"""Share of the cycle time with stops; a plan that takes longer by more is hardly shorter when both are blended."""
ROUNDS = 3
"""So many times a method decides anew without the stages that would not do."""


@dataclass(frozen=True)
class ClearedPlan:
    """A method's plan, repaired and timed."""

    decided: Decided
    """What it came from."""
    cleared: Cleared
    """The plan that is collision-free."""
    unchecked: float
    """Duration of the method's plan where nothing has to be collision-free [s]."""
    replanned: bool
    """Whether other postures or platform angles were needed."""
    checked: bool = True
    """Whether anything had to be collision-free."""
    known: Known = field(default_factory=Known, compare=False, repr=False)
    """What was timed for it."""
    rivals: tuple[Cleared, ...] = field(default=(), compare=False, repr=False)
    """Other collision-free plans of the method that take longer with all stops, but perhaps not in motion."""
    stopping: Cleared | None = field(default=None, compare=False, repr=False)
    """The plan with all stops that it was blended from; None where it is that."""
    standing: Cleared | None = field(default=None, compare=False, repr=False)
    """The plan that it came from, in which platform and arms stand in dwells and the platform on lines; None where it
    is that."""

    @property
    def cost(self) -> float | None:
        """How much longer the plan, with all stops, is than the unchecked one [s].

        None where nothing had to be collision-free.
        """
        if not self.checked:
            return None
        motion = (self.standing or self.cleared).motion
        return motion.trajectory.duration + (motion.gain or 0.0) - self.unchecked


def quickest_clear(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    progress: Callable[[str], None],
    *,
    clear: bool = True,
    crossing: bool = True,
) -> ClearedPlan:
    """Returns the quickest plan of a method that is collision-free, see `_quickest_with_stops`.

    Where the problem allows it, tools then pass the outer ends of lines in motion; the method keeps joints so far from
    their limits of position that they can.

    Args:
        problem: what the method is asked.
        solve: the method.
        timing: how motions are timed.
        progress: receives what is being done.
        clear: whether anything has to be collision-free.
        crossing: whether arms have to be clear of one another.

    Raises:
        InfeasibleError: no posture reaches a target, or nothing that was found is collision-free.
    """
    if not has_blends(problem):
        return _quickest_with_stops(
            problem, solve, timing, progress, clear=clear, crossing=crossing
        )
    found = _quickest_with_stops(
        problem,
        with_room(problem, solve),
        timing,
        progress,
        clear=clear,
        crossing=crossing,
    )
    progress("blending lines and transfers")
    blended = _shortest_blended(problem, found, timing, clear=clear, crossing=crossing)
    motion = blended.cleared.motion
    if (motion.gain or 0.0) > ROOM_COSTS * motion.trajectory.duration:
        return blended
    # Room may cost more than it gains.
    found = _quickest_with_stops(problem, solve, timing, progress, clear=clear, crossing=crossing)
    other = _shortest_blended(problem, found, timing, clear=clear, crossing=crossing)
    return min(blended, other, key=lambda one: one.cleared.motion.trajectory.duration)


def _shortest_blended(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
    *,
    clear: bool,
    crossing: bool,
) -> ClearedPlan:
    """Returns the shortest of a plan and its rivals when all are blended, see `blended_plan`."""
    best = blended_plan(problem, found, timing, clear=clear, crossing=crossing)
    for rival in found.rivals:
        plan = replace(found, cleared=rival, rivals=())
        try:
            other = blended_plan(problem, plan, timing, clear=clear, crossing=crossing)
        except InfeasibleError:
            continue
        best = min(best, other, key=lambda one: one.cleared.motion.trajectory.duration)
    return best


def has_blends(problem: MethodProblem) -> bool:
    """Returns whether there are outer ends of lines, or targets, that tools may pass in motion."""
    stops = (stop for task in problem.job.tasks for stop in task.stops)
    return problem.blend and any(stop.approach or stop.retract or stop.blend for stop in stops)


def with_room(
    problem: MethodProblem, solve: Callable[[MethodProblem], Decided]
) -> Callable[[MethodProblem], Decided]:
    """Returns a method that keeps joints so far from their limits that tools can pass lines' ends in motion.

    Args:
        problem: what it is asked, now and in variations.
        solve: the method; it serves where that leaves no plan.
    """
    roomy = with_stopping_room(problem)
    serves = True

    def solved(asked: MethodProblem) -> Decided:
        nonlocal serves
        if serves:
            try:
                job = replace(asked.job, cell=roomy.job.cell)
                found = solve(replace(asked, model=roomy.model, job=job, own=asked))
            except InfeasibleError:
                if asked.only_near:
                    raise
                found = None
            # At the platform angle that a method wants, reach may end a little earlier.
            if found is not None and all(one.solver != REACH for one in found.stages):
                return found
            # Where room is missing once, it is missing in all variations.
            serves = False
        return solve(asked)

    return solved


def blended_plan(
    problem: MethodProblem,
    found: ClearedPlan,
    timing: TimingSolver,
    stopping: Collection[tuple[int, str]] = (),
    *,
    clear: bool = True,
    crossing: bool = True,
) -> ClearedPlan:
    """Returns a plan whose tools pass the outer ends of lines in motion, wherever that is collision-free.

    Args:
        problem: what was asked.
        found: the plan with all stops.
        timing: how motions are timed.
        stopping: transfers between stops all the same, by the stage that they lead to and arm.
        clear: whether anything has to be collision-free.
        crossing: whether arms have to be clear of one another.
    """
    model, job, known = problem.model, problem.job, found.known
    drive = Drive.of(model, job, timing, known)
    clearing = None
    if clear:
        holding = Holding.of(job, crossing=crossing)
        clearing = Clearing(model, job, holding, timing, problem.seed, known)
    before = found.cleared.motion
    through = passed_targets(drive, found.cleared.plans, stopping)
    passing = with_passed_targets(drive, found.cleared.plans, through)
    widths = EFFORTS[problem.effort].widths
    ways = dict(passing_ways(drive, passing, stopping, widths))
    touching: list[int] = []
    while ways or through:
        plans = with_ways(with_passed_targets(drive, found.cleared.plans, through), ways)
        try:
            motion = realise(model, job, plans, timing, known)
        except InfeasibleError:
            if not through:
                raise
            # An arm cannot pass its target as late as the stage ends.
            through = {}
            ways = dict(passing_ways(drive, found.cleared.plans, stopping, widths))
            continue
        touching = clearing.touching(plans, motion) if clearing is not None else []
        # A stage has the transfers to its lines, and ends as those of the next one begin.
        own = {key for key in ways if key[0] in touching}
        own = own or {key for key in ways if key[0] - 1 in touching}
        passed = {k for k in through if {k, k + 1} & set(touching)}
        if not own and not passed:
            break
        for key in own:
            del ways[key]
        for k in passed:
            del through[k]
        # Ways beside it were chosen for that state.
        ways = {key: way for key, way in ways.items() if not {key[0], key[0] - 1} & passed}
    if touching or not (ways or through):
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
    return replace(found, cleared=Cleared(plans, motion, ()), stopping=found.cleared)


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
            found = realise(drive.model, job, bent, drive.timing, drive.known)
        except InfeasibleError:
            # With what the platform does then, one of them cannot be timed.
            own = set(tries)
        else:
            touching = clearing.touching(bent, found) if clearing is not None else []
            own = {key for key in tries if key[0] in touching}
            own = own or {key for key in tries if key[0] - 1 in touching}
            if not touching and found.trajectory.duration < motion.trajectory.duration:
                return bent, found
            if not own:
                break
        # What collides is tried by the next via point.
        tries = {key: ways[key in own :] for key, ways in tries.items()}
        tries = {key: ways for key, ways in tries.items() if ways}
    return plans, motion


def _quickest_with_stops(
    problem: MethodProblem,
    solve: Callable[[MethodProblem], Decided],
    timing: TimingSolver,
    progress: Callable[[str], None],
    *,
    clear: bool = True,
    crossing: bool = True,
) -> ClearedPlan:
    """Returns the quickest plan of a method that is collision-free, with all tools stopping at both ends of lines.

    The method decides without collision checking. Where that plan is collision-free, or repairing it costs next to
    nothing, it is the plan. Otherwise the method decides anew with collision checking, and again without stages that
    collide when they are timed, whatever is done about them.

    Args:
        problem: what the method is asked.
        solve: the method.
        timing: how motions are timed.
        progress: receives what is being done.
        clear: whether anything has to be collision-free.
        crossing: whether arms have to be clear of one another.

    Raises:
        InfeasibleError: no posture reaches a target, or nothing that was found is collision-free.
    """
    model, job = problem.model, problem.job
    holding = None
    if clear:
        # What no plan can repair is refused before one is looked for.
        holding = Holding.of(job, crossing=crossing)
        check_start(problem, holding)
        check_parts(problem, holding)
        check_grips(problem)
    unchecked = solve(problem)
    progress("timing the motion")
    known = Known()
    timed = _timed(problem, unchecked, timing, known)
    reference = timed[0][1].trajectory.duration
    if holding is None:
        return ClearedPlan(
            unchecked,
            Cleared(*timed[0], ()),
            reference,
            replanned=False,
            checked=False,
            known=known,
            rivals=tuple(
                Cleared(*one, ())
                for one in timed[1:]
                if problem.blend and one[1].trajectory.duration <= (1.0 + ALIKE) * reference
            ),
        )
    clearing = Clearing(model, job, holding, timing, problem.seed, known)
    best, clear_plans = None, list[Cleared]()
    for plans, motion in timed:
        done = best is not None and best.is_done_within(motion.trajectory.duration)
        near = motion.trajectory.duration <= (1.0 + ALIKE) * reference
        if done and not (problem.blend and near):
            break
        touching = clearing.touching(plans, motion)
        if not touching:
            clear_plans.append(Cleared(plans, motion, ()))
            best = _better(best, clear_plans[-1])
        elif not done and len(touching) <= max(1, FEW * len(plans)):
            progress("avoiding collisions")
            best = _better(best, clearing.cleared(plans, motion, touching, give_up=True))
    if best is not None and not best.blocked:
        cost = best.motion.trajectory.duration - reference
        if cost <= NEGLIGIBLE * reference:
            rivals = tuple(one for one in clear_plans if one is not best)
            return ClearedPlan(
                unchecked, best, reference, replanned=False, known=known, rivals=rivals
            )
    found = None
    if best is not None:
        found = ClearedPlan(unchecked, best, reference, replanned=False, known=known)
    unchecked_plan = timed[0]
    asked = replace(
        problem,
        holding=holding,
        unchecked=tuple(unchecked_plan[0]),
        touching=tuple(clearing.touching(*unchecked_plan)),
    )
    failure: InfeasibleError | None = None
    decided = unchecked
    before: list[StagePlan] | None = None
    for _ in range(ROUNDS):
        progress("choosing postures again, avoiding collisions")
        good = found is not None and not found.cleared.blocked and not _is_unlucky(found)
        try:
            decided = solve(replace(asked, only_near=good))
        except InfeasibleError as error:
            failure = error
            break
        timed = _timed(problem, decided, timing, known)
        if not problem.patient:
            refuse_touching_lines(clearing, *timed[0])
        tried = _cleared(clearing, timed)
        if found is None or _badness(tried) < _badness(found.cleared):
            found = ClearedPlan(decided, tried, reference, replanned=True, known=known)
        bars = bars_of(clearing, tried)
        # Only a method over the whole sequence does something else with what is known now.
        if decided.hopeless or not bars or (tried.blocked and not problem.patient):
            break
        if before is not None and same_postures(decided.stages, before):
            break
        before = decided.stages
        asked = replace(
            asked,
            barred=(*asked.barred, *bars),
            unchecked=tuple(before),
            touching=(*_touching(clearing, timed, before), *(bar.stage for bar in bars)),
        )
    if found is not None and decided.simpler is not None and _is_dear(found):
        progress("comparing with simpler plans")
        simpler = Decided([], alternatives=tuple(decided.simpler()))
        found = _with_rivals(found, clearing, _timed(problem, simpler, timing, known))
    if found is not None and not found.cleared.blocked:
        less = less_effort(problem.effort)
        if less is None or not _is_unlucky(found):
            return found
        progress("comparing with the plan of less effort")
        try:
            other = _quickest_with_stops(
                replace(problem, effort=less),
                solve,
                timing,
                progress,
                clear=clear,
                crossing=crossing,
            )
        except InfeasibleError:
            return found
        quicker = min(found, other, key=lambda one: _badness(one.cleared))
        return replace(quicker, unchecked=min(found.unchecked, other.unchecked))
    blocked = () if found is None else found.cleared.blocked
    reasons = why_blocked(clearing, None if found is None else found.cleared)
    alone = found is not None and any(clearing.fails_alone(found.cleared, k) for k in blocked)
    raise failure or BlockedError(*reasons, stages=blocked, alone=alone)


def _is_unlucky(found: ClearedPlan) -> bool:
    """Returns whether a collision-free plan is worth another look: avoiding collisions costs much."""
    return (found.cost or 0.0) > UNLUCKY * found.unchecked


def _is_dear(found: ClearedPlan) -> bool:
    """Returns whether simpler plans are worth a look: this one collides, or it avoids that at a cost."""
    return bool(found.cleared.blocked) or (found.cost or 0.0) > RIVALS * found.unchecked


def _with_rivals(
    found: ClearedPlan, clearing: Clearing, timed: list[tuple[list[StagePlan], Motion]]
) -> ClearedPlan:
    """Returns the best of what was found and of simpler plans after repairing."""
    if not timed:
        return found
    tried = _cleared(clearing, timed, None if found.cleared.blocked else found.cleared)
    if _badness(tried) < _badness(found.cleared):
        return replace(found, decided=Decided(tried.plans), cleared=tried, replanned=True)
    return found


def _touching(
    clearing: Clearing, timed: list[tuple[list[StagePlan], Motion]], plan: list[StagePlan]
) -> list[int]:
    """Returns the stages of one of several timed plans that collide."""
    [motion] = [motion for stages, motion in timed if stages is plan]
    return clearing.touching(plan, motion)


def _timed(
    problem: MethodProblem, decided: Decided, timing: TimingSolver, known: Known
) -> list[tuple[list[StagePlan], Motion]]:
    """Returns a method's plans with their motions, quickest first."""
    plans = [stages for stages in (decided.stages, *decided.alternatives) if stages]
    timed = [
        (stages, realise(problem.model, problem.job, stages, timing, known)) for stages in plans
    ]
    return sorted(timed, key=lambda one: one[1].trajectory.duration)


def _cleared(
    clearing: Clearing,
    timed: list[tuple[list[StagePlan], Motion]],
    best: Cleared | None = None,
) -> Cleared:
    """Returns the best of some plans after repairing, or one that is known if that is better."""
    for plans, motion in timed:
        if best is not None and best.is_done_within(motion.trajectory.duration):
            break
        best = _better(best, clearing.cleared(plans, motion, clearing.touching(plans, motion)))
    assert best  # a method always has a plan of its own
    return best


def _better(one: Cleared | None, other: Cleared) -> Cleared:
    return other if one is None or _badness(other) < _badness(one) else one


def _badness(found: Cleared) -> tuple[int, float]:
    return len(found.blocked), found.motion.trajectory.duration


def _detours(arm: str, stages: list[int]) -> str:
    """Returns how a note tells of an arm's detours, by their stages."""
    if len(stages) == 1:
        return f"{arm} makes a detour in stage {stages[0]}"
    return f"{arm} makes {len(stages)} detours (stages {', '.join(map(str, stages))})"


def clearance_notes(parts: Sequence[tuple[ClearedPlan, int]]) -> list[str]:
    """Returns what was done for clearance, and what it cost against the plan where nothing could touch.

    Args:
        parts: the plans of a job's sections that had to be collision-free, each with the number of its first stage.
    """
    done, detours = [], dict[str, list[int]]()
    for found, first in parts:
        for k, stage in enumerate(found.cleared.plans, first):
            done += [f"{arm} waits {wait:.2f} s in stage {k}" for arm, wait in stage.waits.items()]
            for arm in stage.detours:
                detours.setdefault(arm, []).append(k)
    changed = bool(done or detours)
    done += [_detours(arm, stages) for arm, stages in detours.items()]
    if any(found.replanned for found, _ in parts):
        done.insert(0, "other postures or platform angles were chosen")
    costs = [found.cost for found, _ in parts if found.cost is not None]
    cost, unchecked = sum(costs), sum(found.unchecked for found, _ in parts)
    if not costs or (not done and abs(cost) < SHOWN):
        return []
    if not done:
        done.append("a slower, collision-free plan was chosen")
    what = f"this costs {cost:.3f} s"
    if cost < 0.0:
        what = f"it is {-cost:.3f} s shorter: the method does not always find the fastest plan"
    notes = [
        f"clearance: {', '.join(done)}; with stops at all lines' ends, compared with the plan without collision "
        f"checking ({unchecked:.3f} s), {what}"
    ]
    if cost > DEAR * unchecked:
        notes.append(
            f"clearance costs {cost / unchecked:.0%} of the cycle time: other methods (`dualarm compare "
            "solvers`) or another cell layout may be faster"
        )
    if changed:
        notes.append(
            "sensitivity: transfers that wait or are curved to avoid collisions count as straight ones, and their "
            "extra time as constant"
        )
    return notes
