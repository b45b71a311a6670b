"""Repairs of colliding stages: delays, curved transfers and via points."""

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
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.motion.builder import Motion
from dualarm_cli.motion.curved_transfers import CurveCost, curve, quick_curves
from dualarm_cli.motion.motion import realise
from dualarm_cli.motion.transfers import Drive, MotionCache, keeps_tool_speed
from dualarm_cli.postures.holding import Holding
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing import TimingSolver


@dataclass(frozen=True)
class ViaSettings:
    """Search for a via point at which an arm stops, where no curve is collision-free."""

    spreads: tuple[float, ...] = (0.2, 0.4, 0.7, 1.1)
    """Standard deviations of random postures about the transfer [rad]."""
    postures: int = 120
    """Number of random postures of each spread."""
    leg_samples: int = 13
    """Points of each leg, to and from the via point."""
    timed: int = 24
    """Maximum number of via points, nearest first, that are timed."""


VIA = ViaSettings()


def quickest_stop(
    context: StageContext, name: str, is_free: Callable[[StageSamples], bool], with_other: bool
) -> StagePlan | None:
    """Find the quickest via point at which an arm stops and is collision-free.

    Return its stage, or None.
    """
    start, goal, posture = _drawn(context, name)
    limits = context.job.cell.robot.limits.select(context.model.arms[name].arm.joints)
    posture = posture[((posture >= limits.lower) & (posture <= limits.upper)).all(axis=1)]
    progress = np.linspace(0.0, 1.0, VIA.leg_samples)[:, None]
    to_via = start + progress * (posture[:, None] - start)
    from_via = posture[:, None] + progress * (goal - posture[:, None])
    legs = np.concatenate([to_via, from_via[:, 1:]], axis=1)
    straight = start + np.linspace(0.0, 1.0, legs.shape[1])[:, None] * (goal - start)
    motion = context.motions[name]
    lack = missing_clearance(context, name, motion, straight, with_other)(legs)
    length = sum(
        (np.abs(leg[:, -1] - leg[:, 0]) / limits.velocity).max(axis=1) for leg in (to_via, from_via)
    )
    best, shortest = None, np.inf
    order = np.argsort(np.where(lack == 0.0, length, np.inf), kind="stable")
    for k in order[: min(VIA.timed, int((lack == 0.0).sum()))]:
        detour = Detour(posture[k : k + 1], stops=True)
        motions = {**context.motions, name: context.detoured(name, detour)}
        stage = combined(context.model, context.samples, motions, {})
        if len(stage.position) < shortest and is_free(stage):
            shortest = len(stage.position)
            best = replace(context.plan, detours={**context.plan.detours, name: detour})
    return best


def _drawn(context: StageContext, name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Draw random postures (k, n) about an arm's transfer; return its start, its goal and them."""
    arm = context.model.arms[name]
    start, goal = context.plan.start[arm.columns], context.plan.arrival[arm.columns]
    random = np.random.default_rng(context.seed)
    progress = random.uniform(0.25, 0.75, (len(VIA.spreads) * VIA.postures, 1))
    spread = np.repeat(VIA.spreads, VIA.postures)[:, None]
    noise = random.normal(size=(len(progress), len(start))) * spread
    return start, goal, start + progress * (goal - start) + noise


def quickest_curve(
    context: StageContext, name: str, is_free: Callable[[StageSamples], bool], with_other: bool
) -> StagePlan | None:
    """Find the fastest collision-free curve of one arm's transfer; None if none is found.

    Curves are optimised against the estimated simultaneous motion of platform and other arm; the best ones are timed
    and checked exactly. Without a collision-free curve a via point is looked for, at which the arm stops.

    Args:
        context: the stage.
        name: the arm.
        is_free: collision check of the stage with a curve.
        with_other: whether clearance to the other arm counts in the optimisation.
    """
    arm, arm_motion = context.model.arms[name], context.motions[name]
    start, goal = context.plan.start[arm.columns], context.plan.arrival[arm.columns]
    limits = context.drive.group_limits[name]
    pace = 1.0 / context.job.speed
    transfer_time = arm_motion.arrival * context.samples.step
    rounds = context.settings.curve_rounds
    points = start + np.linspace(0.0, 1.0, rounds[0])[:, None] * (goal - start)
    for samples, next_samples in pairwise((*rounds, rounds[-1])):
        missing = missing_clearance(context, name, arm_motion, points, with_other)
        tool = tool_times(context, name, arm_motion, points)
        cost = CurveCost(limits, transfer_time, missing, samples, pace, tool)
        curves = quick_curves(start, goal, cost, context.seed)
        timed = []
        for controls in curves[: context.settings.timed_curves]:
            detour = Detour(controls, stops=False)
            try:
                timed.append(context.detoured(name, detour))
            except InfeasibleError:
                # The platform alone may move the tool faster than its limit.
                continue
            stage = combined(
                context.model, context.samples, {**context.motions, name: timed[-1]}, {}
            )
            if is_free(stage):
                return replace(context.plan, detours={**context.plan.detours, name: detour})
        if not timed:
            break
        # The timed curve improves the estimate of the simultaneous motion.
        arm_motion, points = timed[0], curve(start, curves[0], goal, next_samples)
    return quickest_stop(context, name, is_free, with_other)


@dataclass(frozen=True)
class TimedPlan:
    """Plan with its motion, and the stages that repairs could not clear."""

    plans: list[StagePlan]
    """Stages in order; the return, if any, is the last one."""
    motion: Motion
    """Motion of all stages."""
    blocked: tuple[int, ...] = ()
    """Stages that no repair cleared; empty before repairs."""

    @property
    def duration(self) -> float:
        """Duration of the motion [s]."""
        return self.motion.trajectory.duration

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key of plans: number of blocked stages, then duration [s]."""
        return len(self.blocked), self.duration

    def is_done_within(self, duration: float) -> bool:
        """Return whether the plan is collision-free within a duration [s]."""
        return not self.blocked and self.duration <= duration


@dataclass(frozen=True)
class Clearing:
    """Collision checks and repairs of one job, with their caches."""

    model: CellModel
    """The job's cell."""
    job: Job
    """Tasks and limits."""
    holding: Holding
    """Bodies that must not collide."""
    timing: TimingSolver
    """Solver that times transfers and curves."""
    seed: int
    """Seed of the curve search."""
    cache: MotionCache = field(default_factory=MotionCache)
    """Motions timed so far; repaired stages keep their lines."""
    seen: dict[tuple[Hashable, ...], bool] = field(default_factory=dict)
    """Cached results of collision checks by stage key: True if collision-free."""
    tried: set[str] = field(default_factory=set)
    """Repairs that were tried: `delays`, `detours`."""
    settings: ClearanceSettings = ClearanceSettings()
    """Settings of the repairs."""

    def timed(self, plans: list[StagePlan]) -> Motion:
        """Time all stages as one motion."""
        return realise(self.model, self.job, plans, self.timing, self.cache)

    def alone(self, plan: StagePlan) -> Motion:
        """Time one stage by itself."""
        return realise(self.model, self.job, [plan], self.timing, self.cache, clock=None)

    def colliding_stages(self, plans: Sequence[StagePlan], motion: Motion) -> list[int]:
        """Return the colliding stages of a motion; results are cached."""
        keys = [_stage_key(k, plan, plans[k - 1] if k else None) for k, plan in enumerate(plans)]
        if self.holding.cell.skew > 0.0:
            # A late arm still performs the previous stage, which therefore belongs to the key.
            keys = list(zip(keys, [(), *keys[:-1]], strict=True))
        unseen = [k for k, key in enumerate(keys) if key not in self.seen]
        stages = [self._sampled(motion, k) for k in unseen]
        for k, clear in zip(unseen, which_are_clear(self.holding.cell, stages), strict=True):
            self.seen[keys[k]] = bool(clear)
        return [k for k, key in enumerate(keys) if not self.seen[key]]

    def is_clear_at(self, plans: Sequence[StagePlan], k: int, start: float) -> bool:
        """Check a stage and the one before it for collisions.

        Args:
            plans: all stages.
            k: index of the stage.
            start: start of stage k - 2, from which both are timed [s].
        """
        # The first stage gives the second one its start in motion.
        first = max(0, k - 2)
        try:
            motion = realise(
                self.model,
                self.job,
                list(plans[first : k + 1]),
                self.timing,
                self.cache,
                clock=start,
            )
        except InfeasibleError:
            return False
        stages = [
            self._sampled(motion, n, first) for n in range(max(0, k - 1) - first, k + 1 - first)
        ]
        return bool(which_are_clear(self.holding.cell, stages).all())

    def repaired(
        self, plan: TimedPlan, colliding_stages: Sequence[int], *, give_up: bool = False
    ) -> TimedPlan:
        """Repair the stages of a plan that collide.

        Args:
            plan: stages and their motion.
            colliding_stages: the stages that collide.
            give_up: whether the first failed repair ends all repairs.
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

    def fails_alone(self, plan: TimedPlan, k: int) -> bool:
        """Return whether one arm of a stage collides regardless of the other arm."""
        samples = stage_samples(plan.motion, k, k, self.holding)
        cell = self.holding.cell
        return not all(alone_clear(cell, samples, a) for a in range(len(cell.arms)))

    def side_by_side(
        self, plans: Sequence[StagePlan], colliding_stages: Sequence[int]
    ) -> list[int]:
        """Return the two-arm stages in which the arms' lines collide."""
        return [
            k
            for k in colliding_stages
            if k < len(plans)
            and len(plans[k].stops) == 2
            and not _lines_apart(self._context(plans[k], k))
        ]

    def _sampled(self, motion: Motion, k: int, first: int = 0) -> StageSamples:
        """Sample stage k of a motion, with the previous stage if arms may be late.

        The motion begins with stage `first` of the job.
        """
        samples = stage_samples(motion, k, first + k, self.holding)
        if k and self.holding.cell.skew > 0.0:
            before = stage_samples(motion, k - 1, first + k - 1, self.holding)
            samples = replace(samples, before=before)
        return samples

    def _repaired(self, plan: StagePlan, k: int, before: StageSamples | None) -> StagePlan | None:
        """Repair one stage; None if no repair makes it collision-free."""
        candidate, first = plan, self._context(plan, k, before)
        arms = range(len(first.cell.arms))
        if not (_ends_apart(first) and all(_repairable(first, a) for a in arms)):
            return None
        for _ in range(self.settings.repairs):
            context = first if candidate is plan else self._context(candidate, k, before)
            repaired = self._next(context)
            if repaired is candidate and (candidate is plan or self._within_cap(candidate)):
                return candidate
            if repaired is None or repaired is candidate:
                return None
            candidate = repaired
        return None

    def _within_cap(self, plan: StagePlan) -> bool:
        """Return whether all tools of a repaired stage stay below the tool speed limit."""
        drive = Drive.of(self.model, self.job, self.timing).to(plan)
        return not drive.caps or keeps_tool_speed(self.model, drive.caps, self.alone(plan))

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
        """Apply the next repair; return the same plan if clear, None if impossible."""
        cell, samples = context.cell, context.samples
        for a, name in enumerate(cell.arms):
            if alone_clear(cell, samples, a):
                continue
            if name in context.plan.detours:
                return None

            def is_free(stage: StageSamples, a: int = a) -> bool:
                return alone_clear(cell, stage, a)

            self.tried.add("detours")
            return quickest_curve(context, name, is_free, with_other=False)
        if apart(cell, samples):
            return context.plan
        if context.plan.waits:
            return None
        return self._made_apart(context)

    def _made_apart(self, context: StageContext) -> StagePlan | None:
        """Separate the arms by a delay or a curve; return the shortest repair."""
        self.tried.add("delays")
        delayed = _least_delay(context)
        short = self.settings.short_delay * self.holding.pace
        if delayed is not None and sum(delayed.waits.values()) <= short:
            return delayed
        candidates = [delayed] if delayed is not None else []

        def is_free(stage: StageSamples) -> bool:
            return is_clear(context.cell, stage)

        free = [name for name in context.cell.arms if name not in context.plan.detours]
        self.tried.update(["detours"] if free else [])
        curves = (quickest_curve(context, name, is_free, with_other=True) for name in free)
        candidates += [candidate for candidate in curves if candidate is not None]
        candidates = [candidate for candidate in candidates if self._within_cap(candidate)]
        if not candidates:
            return None
        lengths = [self.alone(candidate).trajectory.duration for candidate in candidates]
        return candidates[int(np.argmin(lengths))]


def _stage_key(k: int, plan: StagePlan, before: StagePlan | None) -> tuple[Hashable, ...]:
    """Return a hashable key of a stage's motion."""
    postures = [plan.start, plan.arrival, plan.end]
    for stop in plan.stops.values():
        posture = stop.posture
        postures += [
            posture.q_target,
            np.array([posture.psi_target, posture.psi_approach, posture.psi_retract]),
        ]
    passes: list[Hashable] = [*plan.passes.items(), *plan.waits.items()]
    for name, detour in plan.detours.items():
        rates = detour.rates is None or np.asarray(detour.rates).tobytes()
        passes.append(("by", name, detour.stops, detour.points.tobytes(), rates))
    passes += [("through", name, rate.tobytes()) for name, rate in plan.through.items()]
    if before is not None:
        passes += [("from", name, rate.tobytes()) for name, rate in before.through.items()]
        passes += [
            ("left", launch) for launch in before.passes.items() if launch[0][1] == "retract"
        ]
    return (k, *passes, *(posture.tobytes() for posture in postures))


def _repairable(context: StageContext, a: int) -> bool:
    """Return whether an arm is clear at the start and from arrival on."""
    name = context.cell.arms[a]
    arrival = context.motions[name].arrival
    first, from_arrival = context.samples.position[:1], context.samples.position[arrival:]
    held = context.samples.held
    rows = StageSamples(
        np.concatenate([first, from_arrival]), np.concatenate([held[:1], held[arrival:]])
    )
    return bool(
        (context.cell.arm_margins(a, rows.position, rows.held[:, a], ground=True) >= KEPT).all()
    )


def _ends_apart(context: StageContext) -> bool:
    """Return whether the arms are clear of each other where the stage begins and ends.

    Repairs leave both as they are.
    """
    rows, samples = [0, -1], context.samples
    margins = context.cell.cross_margins(samples.position[rows], samples.held[rows])
    return bool((margins >= KEPT).all())


def _lines_apart(context: StageContext) -> bool:
    """Return whether the arms are clear if their lines begin simultaneously."""
    first = {
        name: arm_motion.arrival if arm_motion.meets is None else arm_motion.meets
        for name, arm_motion in context.motions.items()
    }
    lines = {name: arm_motion.q[first[name] :] for name, arm_motion in context.motions.items()}
    length = max(len(line) for line in lines.values())
    position = np.tile(context.plan.arrival, (length, 1))
    held = np.empty((length, len(lines)), dtype=np.int64)
    for a, (name, line) in enumerate(lines.items()):
        rows = np.minimum(np.arange(length), len(line) - 1)
        position[:, context.model.arms[name].columns] = line[rows]
        held[:, a] = context.motions[name].held[first[name] :][rows]
    return bool((context.cell.cross_margins(position, held) >= 0.0).all())


def _least_delay(context: StageContext) -> StagePlan | None:
    """Delay one arm so that the stage is clear and shortest; None if impossible."""
    for delay, name in _delays(context):
        stage = combined(context.model, context.samples, context.motions, {name: delay})
        if is_clear(context.cell, stage):
            return replace(context.plan, waits={name: delay * context.samples.step})
    return None


def _delays(context: StageContext) -> Iterator[tuple[int, str]]:
    """Yield (delay in samples, arm), shortest stage first."""
    shift = max(1, round(context.settings.delay_step / (context.job.speed * context.samples.step)))
    delays = []
    for name, arm_motion in context.motions.items():
        others = max((w.end for name_b, w in context.motions.items() if name_b != name), default=0)
        for delay in range(shift, max(others, 1) + shift, shift):
            delays.append((max(arm_motion.end + delay, others), delay, name))
    for _, delay, name in sorted(delays):
        yield delay, name
