"""Refinement of a sampled sequence: one stage after the other, platform angle and both arms together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.continuation import moved_along
from dualarm_cli.postures.keep_clear import PLACES
from dualarm_cli.postures.numeric import AROUND, LINE_SAMPLES, SIDES
from dualarm_cli.postures.numeric import holds as way_holds
from dualarm_cli.postures.numeric_ways import NumericWays, clear_ones, followed
from dualarm_cli.postures.problem import Place
from dualarm_cli.postures.sampled_stops import SampledStage
from dualarm_cli.postures.stop_batch import StopBatch
from dualarm_cli.stages.sampled_plan import Choice, SampledPlan

FIRST_WIDTH, SHRINK = 0.3, 0.65
"""Half-width of the first sweep's variations [rad], and that of each other one as a share of the one before."""
ANGLE_WIDTH = 0.5
"""Half-width of the platform angle's variation as a share of that."""
GAIN = 1e-6
"""A change that saves less is not made [s]."""
TRIED = 3
"""Best pairs of a stage that are looked at closely."""


def polished(plan: SampledPlan, sweeps: int) -> SampledPlan:
    """Returns a plan that is nowhere slower, by sweeps of ever narrower variation over its stages.

    In a stage platform angle, self-motion, free yaws and drifts of both arms are varied together, and every pair of
    variations is judged by the lengths of the stage and of the ones that its end leads to; a change is made where the
    whole sequence becomes shorter, lines hold at DENSE_SAMPLES samples and both arms keep clear. Coordinate descent: a
    local optimum of what it varies, no more.

    Args:
        plan: to be refined.
        sweeps: how often all stages are gone through.
    """
    best, least = plan, plan.duration
    for sweep in range(sweeps):
        width = FIRST_WIDTH * SHRINK**sweep
        for k in range(len(plan.choices)):
            for choice in _promising(best, k, width):
                duration = best.duration_with(k, choice)
                if duration >= least - GAIN:
                    continue
                tried = best.with_choice(k, choice)
                if holds(tried, k):
                    best, least = tried, duration
                    break
    return best


def holds(plan: SampledPlan, k: int) -> bool:
    """Returns whether a stage's lines can be followed at many samples and its postures keep clear."""
    stage, choice = plan.stages[k], plan.choices[k]
    for arm, way in choice.ways.items():
        batch = StopBatch(tuple(stage.problems(choice.angle[None], arm)))
        if not way_holds(batch, stage.kinematics(arm), way):
            return False
    return stage.keep is None or bool(stage.keep.all_apart(places(plan, k))[0])


def places(plan: SampledPlan, k: int) -> dict[Place, FloatArray]:
    """Returns all joints of the robot [rad], (1, n), at the places of the stops of a stage."""
    before, choice = plan.positions()[k], plan.choices[k]
    model = plan.stages[k].model
    found: dict[Place, FloatArray] = {}
    for place in PLACES:
        row = np.array(before)
        row[model.platform_columns] = choice.angle
        for arm, way in choice.ways.items():
            at = {"approach": way.ends[0, 0], "target": way.q[0], "retract": way.ends[0, 1]}
            row[model.arms[arm].columns] = at[place]
        found[place] = row[None]
    return found


def _promising(plan: SampledPlan, k: int, width: float) -> list[Choice]:
    """Returns the best few variations of one stage by the lengths of the stages next to it."""
    stage, choice = plan.stages[k], plan.choices[k]
    angles = choice.angle[None]
    if stage.model.platform.is_turntable:
        limits = plan.job.cell.robot.limits.select(plan.job.cell.robot.platform)
        angles = angles + ANGLE_WIDTH * width * SIDES[:, None]
        angles = np.clip(angles, limits.lower, limits.upper)
    near = {arm: neighbours(stage, angles, arm, way, width) for arm, way in choice.ways.items()}
    costs = _Costs.of(plan, k)
    found: list[tuple[float, Choice]] = []
    for a, angle in enumerate(angles):
        own = {arm: ways.take(np.flatnonzero(ways.row == a)) for arm, ways in near.items()}
        if any(not len(ways) for ways in own.values()):
            continue
        total = costs.at(angle, own)
        for flat in np.argsort(total, axis=None, kind="stable")[:TRIED]:
            index = np.unravel_index(int(flat), total.shape)
            picked = {}
            for (arm, ways), i in zip(own.items(), index, strict=True):
                one = ways.take(np.array([int(i)]))
                picked[arm] = replace(one, row=np.zeros(1, dtype=np.int64))
            found.append((float(total[index]), Choice(np.array(angle), picked)))
    found.sort(key=lambda one: one[0])
    return [choice for _, choice in found[:TRIED]]


def neighbours(
    stage: SampledStage, angles: FloatArray, arm: str, way: NumericWays, width: float
) -> NumericWays:
    """Returns variations of a way that can be gone, the row being the number of the platform angle.

    Args:
        stage: the stage.
        angles: platform angles, shape (m, k).
        arm: its name.
        way: one way.
        width: half-width of the variation [rad].
    """
    batch, general = StopBatch(tuple(stage.problems(angles, arm))), stage.kinematics(arm)
    along = width * (AROUND if general.spare and not batch.given else AROUND[:1])
    turn = width * (SIDES if batch.free_yaw else SIDES[:1])
    drift = width * (SIDES if general.spare and batch.length.any() else SIDES[:1])
    a, y, s = (
        index.ravel()
        for index in np.meshgrid(*(np.arange(len(v)) for v in (angles, turn, along)), indexing="ij")
    )
    near = way.take(np.zeros(len(a), dtype=np.int64))
    near = replace(near, row=a, yaw=near.yaw + turn[y])
    if not batch.given:
        poses = near.poses(batch)
        q, met = moved_along(general, near.q, poses.R, poses.p, along[s])
        near = replace(near, q=q).take(np.flatnonzero(met))
    if batch.problems[0].clear is not None:
        near = clear_ones(batch, near)
    count, d = len(near), len(drift)
    each = near.take(np.repeat(np.arange(count), d))
    each = replace(each, drift=each.drift + np.tile(drift, count)[:, None])
    each = followed(batch, general, each, LINE_SAMPLES)
    # Lines do not depend on each other: every drift in with every drift out.
    own = d * np.repeat(np.arange(count), d * d)
    i = own + np.tile(np.repeat(np.arange(d), d), count)
    j = own + np.tile(np.arange(d), d * count)
    both = replace(
        each.take(i),
        drift=np.stack([each.drift[i, 0], each.drift[j, 1]], axis=1),
        ends=np.stack([each.ends[i, 0], each.ends[j, 1]], axis=1),
        line=np.stack([each.line[i, 0], each.line[j, 1]], axis=1),
    )
    return both.take(np.flatnonzero(np.isfinite(both.line).all(axis=1)))


@dataclass(frozen=True)
class _Costs:
    """Lengths of a stage and of those that depend on where it ends, the rest of a plan as it is."""

    plan: SampledPlan
    k: int
    before: FloatArray
    later: Mapping[int, FloatArray]
    """Stages whose transfers begin where this one ends (the return is one after the last), with all joints after
    their transfers [rad]."""

    @classmethod
    def of(cls, plan: SampledPlan, k: int) -> _Costs:
        """Returns what the costs of one stage need."""
        model, positions = plan.stages[k].model, plan.positions()
        later: dict[int, FloatArray] = {}
        waiting = set(plan.choices[k].ways)
        for n in range(k + 1, len(plan.choices)):
            row = np.array(positions[n + 1])
            for arm, way in plan.choices[n].ways.items():
                row[model.arms[arm].columns] = way.ends[0, 0]
            if n == k + 1 or waiting & set(plan.choices[n].ways):
                later[n] = row
            waiting -= set(plan.choices[n].ways)
            if not waiting:
                break
        if plan.job.returns and (waiting or k == len(plan.choices) - 1):
            later[len(plan.choices)] = positions[0]
        return cls(plan, k, positions[k], later)

    def at(self, angle: FloatArray, ways: Mapping[str, NumericWays]) -> FloatArray:
        """Returns the lengths [s] of all combinations of the arms' ways, one axis for each arm."""
        stage = self.plan.stages[self.k]
        model, clock = stage.model, stage.clock
        here = self.before[model.platform_columns]
        turn = float(clock.platform_times((angle - here)[None])[0])
        skips = self.plan.free_start and self.k == 0
        total: FloatArray = np.zeros((1,) * len(ways))
        length, arrived, work = total, total, total
        for arm, one in ways.items():
            moved = one.ends[:, 0] - self.before[model.arms[arm].columns]
            move = np.maximum(clock.arms[arm].law.duration(moved), turn) * (not skips)
            own = one.line.sum(axis=1) + stage.work[arm][1].dwell.total
            length = np.maximum(length, self._along(ways, arm, move + own))
            arrived = np.maximum(arrived, self._along(ways, arm, move))
            work = work + self._along(ways, arm, own)
        total = total + (arrived + work if stage.is_handover else length)
        for n, row in self.later.items():
            total = total + self._later(n, row, angle, ways)
        return total

    def _later(
        self, n: int, row: FloatArray, angle: FloatArray, ways: Mapping[str, NumericWays]
    ) -> FloatArray:
        """Returns the lengths of a later stage, the return included, with all joints after its transfer (columns,)."""
        stages, choices = self.plan.stages, self.plan.choices
        model, clock = stages[0].model, stages[0].clock
        before = self.plan.positions()[n]
        turned = row[model.platform_columns]
        here = angle if n == self.k + 1 else before[model.platform_columns]
        turn = float(clock.platform_times((turned - here)[None])[0])
        last = n == len(choices)
        length: FloatArray = np.full((1,) * len(ways), turn)
        arrived, both = length, 0.0
        for arm in model.arms if last else choices[n].ways:
            columns, work = model.arms[arm].columns, 0.0
            if not last:
                way = choices[n].ways[arm]
                work = float(way.line.sum()) + stages[n].work[arm][1].dwell.total
            between = any(arm in choices[m].ways for m in range(self.k + 1, n))
            law = clock.arms[arm].law
            if arm in ways and not between:
                move = law.duration(row[columns] - ways[arm].ends[:, 1])
                there = self._along(ways, arm, np.maximum(move, turn))
            else:
                move = law.duration((row - before)[columns])
                there = np.full((1,) * len(ways), max(float(move), turn))
            length = np.maximum(length, there + work)
            arrived, both = np.maximum(arrived, there), both + work
        return length if last or not stages[n].is_handover else arrived + both

    def _along(self, ways: Mapping[str, NumericWays], arm: str, values: FloatArray) -> FloatArray:
        """Returns one arm's values along its axis."""
        shape = [1] * len(ways)
        shape[list(ways).index(arm)] = len(values)
        return values.reshape(shape)
