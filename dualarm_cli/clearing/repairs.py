"""Repairs of stages that collide: a delay or a curved transfer."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import field, replace
from itertools import pairwise

import numpy as np

from dualarm_cli.clearing.stage_samples import (
    KEPT,
    StageContext,
    StageSamples,
    alone_clear,
    apart,
    arm_motions,
    combined,
    is_clear,
    missing_clearance,
    stage_samples,
    tool_times,
    which_are_clear,
)
from dualarm_cli.effort import ClearanceSettings
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.motion.bent_transfers import CurveCost, curve, quick_curves
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import MotionCache, largest_tool_speed
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing import TimingSolver


def quickest_curve(
    context: StageContext, name: str, clear: Callable[[StageSamples], bool], with_other: bool
) -> StagePlan | None:
    """Returns the stage with the quickest of some curves of one arm that are collision-free, None for none.

    Curves are looked for beside what the platform and the other arm do meanwhile, as far as that is known before a
    curve is timed; the best ones are timed, and looked at again.

    Args:
        context: the stage.
        name: the arm.
        clear: whether a stage with another way of the arm is collision-free.
        with_other: whether the other arm counts while curves are looked for.
    """
    arm, way = context.model.arms[name], context.motions[name]
    start, goal = context.plan.start[arm.columns], context.plan.arrival[arm.columns]
    limits = context.job.limits.select(arm.arm.joints)
    pace = 1.0 / context.job.speed
    least = way.arrival * context.samples.step
    rounds = context.settings.curve_rounds
    points = start + np.linspace(0.0, 1.0, rounds[0])[:, None] * (goal - start)
    for samples, later in pairwise((*rounds, rounds[-1])):
        missing = missing_clearance(context, name, way, points, with_other)
        tool = tool_times(context, name, way, points)
        cost = CurveCost(limits, least, missing, samples, pace, tool)
        found = quick_curves(start, goal, cost, context.seed)
        timed = []
        for controls in found[: context.settings.timed_curves]:
            detour = Detour(controls)
            try:
                timed.append(context.detoured(name, detour))
            except InfeasibleError:
                # With the platform's motion the tool is too fast at any speed of the arm.
                continue
            stage = combined(
                context.model, context.samples, {**context.motions, name: timed[-1]}, {}
            )
            if clear(stage):
                return replace(context.plan, detours={**context.plan.detours, name: detour})
        if not timed:
            break
        # What the others do while the arm is where is known better now.
        way, points = timed[0], curve(start, found[0], goal, later)
    return None


@dataclass(frozen=True)
class TimedPlan:
    """Plan with its motion, and the stages that repairs could not clear."""

    plans: list[StagePlan]
    """Stages in order; the return, if any, is the last one."""
    motion: Motion
    """Motion of all stages."""
    blocked: tuple[int, ...] = ()
    """Stages that collide whatever was tried; empty as long as nothing was tried."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.motion.trajectory.duration

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key of plans: number of blocked stages, then duration [s]."""
        return len(self.blocked), self.duration

    def is_done_within(self, duration: float) -> bool:
        """Returns whether the whole plan is collision-free and takes no longer than a duration [s]."""
        return not self.blocked and self.duration <= duration


@dataclass(frozen=True)
class Clearing:
    """What repairing is done with."""

    model: CellModel
    """The job's cell."""
    job: Job
    """What is to be done."""
    holding: Holding
    """What has to be collision-free."""
    timing: TimingSolver
    """How transfers and curves are timed."""
    seed: int
    """Of what is tried at random."""
    cache: MotionCache = field(default_factory=MotionCache)
    """What is timed already: repaired stages keep their lines."""
    seen: dict[tuple[Hashable, ...], bool] = field(default_factory=dict)
    """Which stages are collision-free, as far as known, by their number and all that their motion depends on."""
    tried: set[str] = field(default_factory=set)
    """Repairs that were tried: `delays`, `detours`."""
    settings: ClearanceSettings = ClearanceSettings()
    """Numbers of the repairs."""

    def timed(self, plans: list[StagePlan]) -> Motion:
        """Returns the motion of all stages."""
        return realise(self.model, self.job, plans, self.timing, self.cache)

    def alone(self, plan: StagePlan) -> Motion:
        """Returns the motion of one stage by itself."""
        return realise(self.model, self.job, [plan], self.timing, self.cache, clock=None)

    def colliding_stages(self, plans: Sequence[StagePlan], motion: Motion) -> list[int]:
        """Returns the stages of a motion that collide; how long arms wait in them must always be the same."""
        keys = [_stage_key(k, plan, plans[k - 1] if k else None) for k, plan in enumerate(plans)]
        if self.holding.cell.skew > 0.0:
            # An arm that is late is in the stage before for some time.
            keys = list(zip(keys, [(), *keys[:-1]], strict=True))
        news = [k for k, key in enumerate(keys) if key not in self.seen]
        stages = [self._sampled(motion, k) for k in news]
        for k, clear in zip(news, which_are_clear(self.holding.cell, stages), strict=True):
            self.seen[keys[k]] = bool(clear)
        return [k for k, key in enumerate(keys) if not self.seen[key]]

    def repaired(
        self, plan: TimedPlan, colliding_stages: Sequence[int], *, give_up: bool = False
    ) -> TimedPlan:
        """Repair the stages of a plan that collide.

        Args:
            plan: stages and their motion.
            colliding_stages: the stages that collide.
            give_up: whether nothing more is repaired after the first stage that cannot be.
        """
        stages, blocked = list(plan.plans), []
        for k in colliding_stages:
            repaired = self._repaired(stages[k], k, self._sampled(plan.motion, k).before)
            if repaired is not None:
                stages[k] = repaired
            elif give_up:
                return replace(plan, blocked=tuple(colliding_stages))
            else:
                blocked.append(k)
        is_changed = len(blocked) < len(colliding_stages)
        motion = self.timed(stages) if is_changed else plan.motion
        return TimedPlan(stages, motion, tuple(blocked))

    def fails_alone(self, found: TimedPlan, k: int) -> bool:
        """Returns whether an arm collides in a stage of a plan whatever the other one does."""
        samples = stage_samples(found.motion, k, k, self.holding)
        cell = self.holding.cell
        return not all(alone_clear(cell, samples, a) for a in range(len(cell.arms)))

    def side_by_side(
        self, plans: Sequence[StagePlan], colliding_stages: Sequence[int]
    ) -> list[int]:
        """Returns the stages of two arms in which these touch where they work, not on their ways only."""
        return [
            k
            for k in colliding_stages
            if k < len(plans)
            and len(plans[k].stops) == 2
            and not _lines_apart(self._context(plans[k], k))
        ]

    def _sampled(self, motion: Motion, k: int) -> StageSamples:
        """Returns one stage of a whole motion, with the one before where an arm may be late."""
        samples = stage_samples(motion, k, k, self.holding)
        if k and self.holding.cell.skew > 0.0:
            samples = replace(samples, before=stage_samples(motion, k - 1, k - 1, self.holding))
        return samples

    def _repaired(self, plan: StagePlan, k: int, before: StageSamples | None) -> StagePlan | None:
        """Returns a stage that is collision-free, None where nothing that was tried does."""
        tried, first = plan, self._context(plan, k, before)
        if not all(_repairable(first, a) for a in range(len(first.cell.arms))):
            return None
        for _ in range(self.settings.repairs):
            context = first if tried is plan else self._context(tried, k, before)
            found = self._next(context)
            if found is tried and (tried is plan or self._within_cap(tried)):
                return tried
            if found is None or found is tried:
                return None
            tried = found
        return None

    def _within_cap(self, plan: StagePlan) -> bool:
        """Returns whether no tool is faster than its cap in a repaired stage, in which all move otherwise now."""
        if self.job.tool_speed is None:
            return True
        whole = self.alone(plan).trajectory
        fastest = largest_tool_speed(
            self.model, list(self.model.arms), lambda time: whole.at(time)[0], whole.duration
        )
        return fastest <= self.job.tool_speed

    def _context(self, plan: StagePlan, k: int, before: StageSamples | None = None) -> StageContext:
        motion = self.alone(plan)
        samples = replace(stage_samples(motion, 0, k, self.holding), before=before)
        motions = arm_motions(self.model, motion, 0, samples)
        joints = self.job.cell.robot.platform
        platform = motion.trajectory.select(joints) if joints else None
        return StageContext(
            self.model,
            self.job,
            self.holding.cell,
            plan,
            samples,
            motions,
            platform,
            self.timing,
            self.seed,
            self.settings,
        )

    def _next(self, context: StageContext) -> StagePlan | None:
        """Returns the stage with one thing repaired, the same where there is nothing, None where that cannot be."""
        cell, samples = context.cell, context.samples
        for a, name in enumerate(cell.arms):
            if alone_clear(cell, samples, a):
                continue
            if name in context.plan.detours:
                return None

            def clear(stage: StageSamples, a: int = a) -> bool:
                return alone_clear(cell, stage, a)

            self.tried.add("detours")
            return quickest_curve(context, name, clear, with_other=False)
        if apart(cell, samples):
            return context.plan
        if context.plan.waits:
            return None
        return self._made_apart(context)

    def _made_apart(self, context: StageContext) -> StagePlan | None:
        """Returns the shortest stage found in which the arms are clear of each other."""
        self.tried.add("delays")
        delayed = _least_delay(context)
        short = self.settings.short_delay * self.holding.pace
        if delayed is not None and sum(delayed.waits.values()) <= short:
            return delayed
        tries = [delayed] if delayed is not None else []

        def clear(stage: StageSamples) -> bool:
            return is_clear(context.cell, stage)

        free = [name for name in context.cell.arms if name not in context.plan.detours]
        self.tried.update(["detours"] if free else [])
        curves = (quickest_curve(context, name, clear, with_other=True) for name in free)
        tries += [one for one in curves if one is not None]
        tries = [one for one in tries if self._within_cap(one)]
        if not tries:
            return None
        lengths = [self.alone(one).trajectory.duration for one in tries]
        return tries[int(np.argmin(lengths))]


def _stage_key(k: int, plan: StagePlan, before: StagePlan | None) -> tuple[Hashable, ...]:
    """Returns all that the motion of a stage that nobody waits in depends on, its number first."""
    postures = [plan.start, plan.arrival, plan.end]
    for stop in plan.stops.values():
        made = stop.posture
        postures += [
            made.q_target,
            np.array([made.psi_target, made.psi_approach, made.psi_retract]),
        ]
    passes: list[Hashable] = [*plan.passes.items()]
    passes += [
        ("by", name, one.points.tobytes(), one.rates is None or np.asarray(one.rates).tobytes())
        for name, one in plan.detours.items()
    ]
    passes += [("through", name, rate.tobytes()) for name, rate in plan.through.items()]
    if before is not None:
        passes += [("from", name, rate.tobytes()) for name, rate in before.through.items()]
        passes += [("left", way) for way in before.passes.items() if way[0][1] == "retract"]
    return (k, *passes, *(posture.tobytes() for posture in postures))


def _repairable(context: StageContext, a: int) -> bool:
    """Returns whether an arm is collision-free at both ends of its transfer and from there on."""
    name = context.cell.arms[a]
    arrival = context.motions[name].arrival
    first, rest = context.samples.position[:1], context.samples.position[arrival:]
    held = context.samples.held
    rows = StageSamples(np.concatenate([first, rest]), np.concatenate([held[:1], held[arrival:]]))
    return bool(
        (context.cell.own_margins(a, rows.position, rows.held[:, a], ground=True) >= KEPT).all()
    )


def _lines_apart(context: StageContext) -> bool:
    """Returns whether the arms are clear of each other if all of them begin their lines at once."""
    first = {
        name: way.arrival if way.meets is None else way.meets
        for name, way in context.motions.items()
    }
    rests = {name: way.q[first[name] :] for name, way in context.motions.items()}
    length = max(len(rest) for rest in rests.values())
    position = np.tile(context.plan.arrival, (length, 1))
    held = np.empty((length, len(rests)), dtype=np.int64)
    for a, (name, rest) in enumerate(rests.items()):
        rows = np.minimum(np.arange(length), len(rest) - 1)
        position[:, context.model.arms[name].columns] = rest[rows]
        held[:, a] = context.motions[name].held[first[name] :][rows]
    return bool((context.cell.cross_margins(position, held) >= 0.0).all())


def _least_delay(context: StageContext) -> StagePlan | None:
    """Returns the stage with the delay of one arm that makes it shortest, None where no delay serves."""
    for delay, name in _delays(context):
        stage = combined(context.model, context.samples, context.motions, {name: delay})
        if is_clear(context.cell, stage):
            return replace(context.plan, waits={name: delay * context.samples.step})
    return None


def _delays(context: StageContext) -> Iterator[tuple[int, str]]:
    """Yields delays and arms, those that make the stage shortest first."""
    shift = max(1, round(context.settings.delay_step / (context.job.speed * context.samples.step)))
    tries = []
    for name, way in context.motions.items():
        others = max((w.end for other, w in context.motions.items() if other != name), default=0)
        for delay in range(shift, max(others, 1) + shift, shift):
            tries.append((max(way.end + delay, others), delay, name))
    for _, delay, name in sorted(tries):
        yield delay, name
