"""Whole sequences of any arms: sampled inverse kinematics of every stop, beam search, then refinement."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.postures.keep_clear import PLACES, KeepClear
from dualarm_cli.postures.problem import Place
from dualarm_cli.postures.sampled_stops import SampledStage, StopSamples
from dualarm_cli.postures.stage_plan import StagePlan
from dualarm_cli.postures.stage_problems import Clock
from dualarm_cli.stages.method import Decided, MethodProblem
from dualarm_cli.stages.sampled_beam import beam_search
from dualarm_cli.stages.sampled_plan import Choice, SampledPlan
from dualarm_cli.stages.sampled_polish import holds, polished
from dualarm_cli.stages.sampled_sequence import SampledSequence
from dualarm_cli.stages.search.clearance import ALIKE, LIKE, Barred
from dualarm_cli.stages.serving import FIXED, SAMPLED
from dualarm_cli.stages.stages import choose_stages

TOGETHER, AT_LAST = 10.0, 1000.0
"""What it costs where two arms are too near to each other on their stops: one may wait for the other, but not where
both are in the end [s]."""
BARRED = 10.0
"""What it costs at most to do what turned out not to keep clear [s]."""
REPEATS = 8
"""So many times the search goes on without samples whose lines do not hold between their samples."""


@dataclass(frozen=True)
class SampledEffort:
    """How hard `sampled` tries."""

    step: float
    """Spacing of the platform angles [rad]."""
    alone: int
    """Samples of a stop where the platform does not turn."""
    turning: int
    """Samples of a stop at each platform angle."""
    width: int
    """States that the beam keeps."""
    refinements: int
    """Stages that are refined, sweeps times stages, and at least one sweep."""


EFFORTS: Mapping[str, SampledEffort] = {
    "quick": SampledEffort(np.radians(20.0), 48, 6, 16, 24),
    "normal": SampledEffort(np.radians(10.0), 96, 10, 48, 72),
    "thorough": SampledEffort(np.radians(5.0), 192, 20, 128, 216),
}
MOST_SWEEPS = 14
"""Sweeps of refinement at most: widths are below a thousandth then."""


def solve_sampled(problem: MethodProblem) -> Decided:
    """Returns a plan over the whole sequence for any arms.

    Every stop is sampled: over platform angles (where one can be chosen), yaws, branches and self-motion; lines are
    followed; a beam search with the paired cost of both arms and the platform takes one way of each stop
    (`beam_search`), and coordinate descent refines them (`polished`). Where no common platform angle is among the
    samples of some stage, the greedy plan of `fixed` is taken, which looks more closely, or its reason told.

    Raises:
        InfeasibleError: a target that no posture reaches.
    """
    effort = EFFORTS[problem.effort]
    stages = _stages(problem)
    angles = _angles(problem, effort)
    most = effort.turning if len(angles) > 1 else effort.alone
    samples = [_samples(stage, angles, most) for stage in stages]
    plan = _searched(problem, stages, angles, samples, effort.width)
    if plan is None:
        return Decided(_greedy(problem))
    sweeps = int(np.clip(effort.refinements // len(stages), 1, MOST_SWEEPS))
    return Decided(polished(plan, sweeps).plans(SAMPLED), simpler=lambda: _simpler(problem))


def _samples(stage: SampledStage, angles: FloatArray, most: int) -> dict[str, StopSamples]:
    """Returns each arm's ways to make its stop; in a hand-over with what the other arm's lines and dwell take at least.

    Those come before or after one's own.
    """
    own = {arm: stage.samples(angles, arm, most) for arm in stage.work}
    if not stage.is_handover:
        return own
    least = {arm: one.work.min(initial=np.inf) for arm, one in own.items()}
    return {
        arm: replace(one, work=one.work + sum(least[other] for other in own if other != arm))
        for arm, one in own.items()
    }


def _greedy(problem: MethodProblem) -> list[StagePlan]:
    """Returns the plan of `fixed`."""
    return choose_stages(
        problem.model, problem.job, FIXED, problem.redundancy, holding=problem.holding
    )


def _simpler(problem: MethodProblem) -> list[list[StagePlan]]:
    """Returns the plan of `fixed` to compare with; none where it has none, which says nothing against other plans."""
    with suppress(InfeasibleError):
        return [_greedy(problem)]
    return []


def _stages(problem: MethodProblem) -> list[SampledStage]:
    model, job = problem.model, problem.job
    clock = Clock.of(model, job)
    home = np.array(job.start_joints)
    found = []
    for k, work in enumerate(job.stages()):
        keep = None if problem.holding is None else KeepClear(model, problem.holding, k)
        found.append(SampledStage(model, clock, work, home, keep))
    return found


def _angles(problem: MethodProblem, effort: SampledEffort) -> FloatArray:
    """Returns the platform angles that are sampled, where it starts first, shape (m, k)."""
    model, job = problem.model, problem.job
    home = job.start_joints
    here: FloatArray = home[model.platform_columns][None]
    if not model.platform.is_turntable:
        return here
    limits = job.cell.robot.limits.select(model.platform.joints)
    low, high = max(limits.lower[0], here[0, 0] - np.pi), min(limits.upper[0], here[0, 0] + np.pi)
    below, above = int((here[0, 0] - low) / effort.step), int((high - here[0, 0]) / effort.step)
    others = np.delete(np.arange(-below, above + 1), below)
    return np.concatenate([here, here + effort.step * others[:, None]])


def _searched(
    problem: MethodProblem,
    stages: list[SampledStage],
    angles: FloatArray,
    samples: list[dict[str, StopSamples]],
    width: int,
) -> SampledPlan | None:
    """Returns the beam's plan whose lines hold, or None."""
    model, job = problem.model, problem.job
    clock, home = stages[0].clock, stages[0].position
    for _ in range(REPEATS):
        sequence = SampledSequence(
            angles,
            samples,
            {arm: home[one.columns] for arm, one in model.arms.items()},
            {arm: one.law.duration for arm, one in clock.arms.items()},
            clock.platform_times,
            job.start == "free",
            job.returns,
            None if problem.holding is None else _Extra(problem, stages, samples).costs,
        )
        taken = beam_search(sequence, width)
        if taken is None:
            return None
        plan = SampledPlan(job, stages, _choices(angles, samples, taken))
        wrong = [k for k in range(len(stages)) if not _lines_hold(plan, k)]
        if not wrong:
            return plan
        for k in wrong:
            for arm, index in taken[k].items():
                if not _lines_hold(plan, k, arm):
                    rest = np.delete(np.arange(len(samples[k][arm].work)), index)
                    samples[k][arm] = samples[k][arm].take(rest)
    return None


def _lines_hold(plan: SampledPlan, k: int, arm: str | None = None) -> bool:
    """Returns whether the lines of a stage, or of one arm in it, hold between the samples; clearance apart."""
    stage, choice = replace(plan.stages[k], keep=None), plan.choices[k]
    if arm is not None:
        choice = replace(choice, ways={arm: choice.ways[arm]})
    stages = [*plan.stages[:k], stage, *plan.stages[k + 1 :]]
    return holds(replace(plan, stages=stages).with_choice(k, choice), k)


def _choices(
    angles: FloatArray, samples: list[dict[str, StopSamples]], taken: list[dict[str, int]]
) -> tuple[Choice, ...]:
    found = []
    for one, own in zip(samples, taken, strict=True):
        ways = {arm: one[arm].ways.take(np.array([index])) for arm, index in own.items()}
        row = int(next(iter(ways.values())).row[0])
        zero = np.zeros(1, dtype=np.int64)
        ways = {arm: replace(way, row=zero) for arm, way in ways.items()}
        found.append(Choice(angles[row], ways))
    return tuple(found)


@dataclass(frozen=True)
class _Extra:
    """What choices of a stage cost for clearance."""

    problem: MethodProblem
    stages: list[SampledStage]
    samples: list[dict[str, StopSamples]]

    def costs(
        self,
        k: int,
        angles: FloatArray,
        before: Mapping[str, FloatArray],
        chosen: Mapping[str, IntArray],
    ) -> FloatArray:
        """Returns extra costs of choices of a stage [s], as `Costs` says."""
        stage, found = self.stages[k], np.zeros(len(angles))
        if stage.keep is None:
            return found
        rows = {place: self._rows(k, angles, before, chosen, place) for place in PLACES}
        found += TOGETHER * ~stage.keep.all_apart(rows)
        found += AT_LAST * ~stage.keep.all_apart(
            {place: rows[place] for place in stage.keep.at_once}
        )
        for barred in self.problem.barred:
            if barred.stage == k:
                found += self._barred(barred, rows["approach"], before)
        return found

    def _rows(
        self,
        k: int,
        angles: FloatArray,
        before: Mapping[str, FloatArray],
        chosen: Mapping[str, IntArray],
        place: Place,
    ) -> FloatArray:
        """Returns all joints at a place of the stops [rad], shape (s, n)."""
        model = self.problem.model
        rows = np.tile(self.stages[k].position, (len(angles), 1))
        rows[:, model.platform_columns] = angles
        for arm, q in before.items():
            if arm in chosen:
                ways = self.samples[k][arm].ways
                at = {"approach": ways.ends[:, 0], "target": ways.q, "retract": ways.ends[:, 1]}
                q = at[place][chosen[arm]]
            rows[:, model.arms[arm].columns] = q
        return rows

    def _barred(
        self, barred: Barred, arrival: FloatArray, before: Mapping[str, FloatArray]
    ) -> FloatArray:
        """Returns what it costs to do much the same as what turned out not to keep clear [s], shape (s,)."""
        columns = list(barred.columns)
        far = np.abs(arrival[:, columns] - barred.arrival[columns]).max(axis=1)
        near = far < (ALIKE if barred.start is None else LIKE)
        for arm, q in before.items() if barred.start is not None else ():
            own = self.problem.model.arms[arm].columns
            if barred.start is not None and set(own) <= set(columns):
                near &= np.abs(q - barred.start[own]).max(axis=1) < LIKE
        return np.where(near, min(barred.cost, BARRED), 0.0)
