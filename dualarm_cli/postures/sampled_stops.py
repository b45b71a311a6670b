"""Ways of one arm to make one stop, sampled over platform angles: what `sampled` chooses from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.kinematics.general_arm import GeneralArm
from dualarm_cli.model.job import Stop, Task
from dualarm_cli.postures import StopProblem
from dualarm_cli.postures.keep_clear import KeepClear
from dualarm_cli.postures.numeric import LINE_SAMPLES
from dualarm_cli.postures.numeric_ways import NumericWays, clear_ones, followed, target_ways
from dualarm_cli.postures.stage_problems import Clock, stage_problems
from dualarm_cli.postures.stop_batch import StopBatch

TURN = 2.0 * np.pi
MOST_YAWS = 6
"""Yaws that are sampled where any will do; those between them are for the refinement."""


@dataclass(frozen=True)
class StopSamples:
    """N ways of one arm to make its stop in one stage; every array has N rows."""

    ways: NumericWays
    """Where they lead; the row is the number of the platform angle."""
    work: FloatArray
    """Time of approach, dwell and retract [s]."""

    def take(self, index: IntArray | BoolArray) -> StopSamples:
        """Returns some of the samples."""
        return StopSamples(self.ways.take(index), self.work[index])

    @property
    def first(self) -> FloatArray:
        """Joints where the approach begins [rad], shape (N, n)."""
        return self.ways.ends[:, 0]

    @property
    def last(self) -> FloatArray:
        """Joints where the retract ends [rad], shape (N, n)."""
        return self.ways.ends[:, 1]


@dataclass(frozen=True)
class SampledStage:
    """One stage, to be looked at from any platform angle."""

    model: CellModel
    clock: Clock
    work: Mapping[str, tuple[Task, Stop]]
    position: FloatArray
    """All joints that turns are counted from [rad], shape (n,): the start."""
    keep: KeepClear | None

    @property
    def is_handover(self) -> bool:
        """Whether a part goes from arm to arm in it."""
        return any(stop.action == "give" for _, stop in self.work.values())

    def problems(self, angles: FloatArray, arm: str) -> list[StopProblem]:
        """Returns the stop of one arm with the platform at angles (m, k)."""
        found = stage_problems(
            self.model,
            self.clock,
            self.position,
            angles,
            {arm: self.work[arm]},
            refine=True,
            keep=self.keep,
        )
        problems = [stops[arm] for stops in found]
        if self.keep is None:
            return problems
        # What the other arm does then is not known yet: it is looked at in pairs.
        both = dict.fromkeys(self.model.arms)
        return [
            replace(one, clear=self.keep.test(arm, self.position, angle, both))
            for one, angle in zip(problems, angles, strict=True)
        ]

    def kinematics(self, arm: str) -> GeneralArm:
        """Returns an arm's kinematics.

        Raises:
            UnsupportedError: it was measured in closed form.
        """
        found = self.model.arms[arm].kinematics
        if not isinstance(found, GeneralArm):
            raise UnsupportedError("sampled inverse kinematics needs --redundancy numeric")
        return found

    def samples(self, angles: FloatArray, arm: str, most: int) -> StopSamples:
        """Returns ways to make the stop whose lines can be followed and whose ends keep clear.

        Args:
            angles: platform angles, shape (m, k).
            arm: its name.
            most: how many at one platform angle.
        """
        problems = [_few_yaws(one) for one in self.problems(angles, arm)]
        batch, general = StopBatch(tuple(problems)), self.kinematics(arm)
        ways, _ = target_ways(batch, general, curves=len(angles) == 1)
        ways = clear_ones(batch, thinned(ways, 2 * most))
        ways = followed(batch, general, ways, LINE_SAMPLES)
        ways = ways.take(np.flatnonzero(np.isfinite(ways.line).all(axis=1)))
        ways = with_turns(thinned(clear_ones(batch, ways), most), general, batch.given)
        return StopSamples(ways, ways.line.sum(axis=1) + self.work[arm][1].dwell.total)


def thinned(ways: NumericWays, most: int) -> NumericWays:
    """Returns at most so many ways of each platform angle, evenly out of their order."""
    order = np.argsort(ways.row, kind="stable")
    edges = np.searchsorted(ways.row[order], np.arange(ways.row.max(initial=-1) + 2))
    kept = [
        order[np.unique(np.linspace(low, high - 1, most).round().astype(np.int64))]
        if high - low > most
        else order[low:high]
        for low, high in pairwise(edges.tolist())
    ]
    return ways.take(np.concatenate([*kept, np.empty(0, dtype=np.int64)]))


def with_turns(ways: NumericWays, arm: GeneralArm, given: bool) -> NumericWays:
    """Returns ways together with the same ones whole turns away, as far as limits allow.

    Args:
        ways: whose lines are followed.
        arm: their arm.
        given: whether targets are configurations, which have no other turns.
    """
    if given:
        return ways
    for joint in range(arm.axes):
        low, high = arm.lower[joint], arm.upper[joint]
        # Of joints without limits one turn each way will do.
        low, high = max(low, -1.5 * TURN), min(high, 1.5 * TURN)
        if high - low < TURN:
            continue
        found = [ways]
        for turn in (-2.0 * TURN, -TURN, TURN, 2.0 * TURN):
            places = np.concatenate([ways.q[:, None], ways.ends], axis=1)[:, :, joint] + turn
            index = np.flatnonzero(((places >= low) & (places <= high)).all(axis=1))
            some = ways.take(index)
            shift = np.where(np.arange(arm.axes) == joint, turn, 0.0)
            found.append(replace(some, q=some.q + shift, ends=some.ends + shift))
        ways = NumericWays.together(found)
    return ways


def _few_yaws(problem: StopProblem) -> StopProblem:
    if not problem.free_yaw or len(problem.yaw) <= MOST_YAWS:
        return problem
    return replace(problem, yaw=problem.yaw[:: -(-len(problem.yaw) // MOST_YAWS)])
