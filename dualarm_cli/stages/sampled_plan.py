"""A sequence of chosen ways, with its time by closed forms, and as stages."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.postures.numeric_ways import NumericWays
from dualarm_cli.postures.sampled_stops import SampledStage
from dualarm_cli.postures.stage_plan import ArmStop, StagePlan, stage_length

RETURN = "return"
"""What the solver of the last transfer is called."""


@dataclass(frozen=True)
class Choice:
    """What is decided about one stage."""

    angle: FloatArray
    """Where the platform stands, shape (k,)."""
    ways: dict[str, NumericWays]
    """How each arm at work makes its stop: one way each."""


@dataclass(frozen=True)
class SampledPlan:
    """All stages of a job, decided."""

    job: Job
    """What is to be done."""
    stages: Sequence[SampledStage]
    """Its stages."""
    choices: tuple[Choice, ...]
    """By stage."""

    def with_choice(self, k: int, choice: Choice) -> SampledPlan:
        """Returns the plan with another choice in one stage."""
        return replace(self, choices=(*self.choices[:k], choice, *self.choices[k + 1 :]))

    @property
    def free_start(self) -> bool:
        """Whether the plan begins where its first approaches do."""
        return self.job.start == "free"

    @property
    def start(self) -> FloatArray:
        """All joints in the beginning [rad], shape (n,)."""
        model = self.stages[0].model
        position = np.array(self.stages[0].position)
        if self.free_start:
            position[model.platform_columns] = self.choices[0].angle
            for arm, way in self.choices[0].ways.items():
                position[model.arms[arm].columns] = way.ends[0, 0]
        return position

    def positions(self) -> list[FloatArray]:
        """Returns all joints before each stage and after the last one [rad], each (n,)."""
        return self._positions

    @cached_property
    def _positions(self) -> list[FloatArray]:
        found = [self.start]
        for choice in self.choices:
            found.append(self._after(found[-1], choice))
        return found

    def plans(self, solver: str) -> list[StagePlan]:
        """Returns the stages as every method decides them, the return last where there is one.

        Args:
            solver: name of the method.
        """
        model, clock = self.stages[0].model, self.stages[0].clock
        positions, found = self.positions(), []
        for k, (stage, choice) in enumerate(zip(self.stages, self.choices, strict=True)):
            before = positions[k]
            turn = choice.angle - before[model.platform_columns]
            waiting = float(clock.platform_times(turn[None])[0])
            arrival, stops = np.array(positions[k + 1]), {}
            for arm, way in choice.ways.items():
                columns = model.arms[arm].columns
                arrival[columns] = way.ends[0, 0]
                moved = arrival[columns] - before[columns]
                skips = self.free_start and k == 0
                move = 0.0 if skips else float(clock.arms[arm].law.duration(moved))
                time = max(move, waiting) + float(way.line.sum())
                [problem] = stage.problems(choice.angle[None], arm)
                problem = replace(problem, start=before[columns], waiting=waiting)
                task, stop = stage.work[arm]
                stops[arm] = ArmStop(arm, task, stop, problem, way.posture(0, time))
            length = self._length(k, choice, before)
            found.append(StagePlan(before, arrival, positions[k + 1], stops, solver, length))
        if self.job.returns:
            moved = positions[0] - positions[-1]
            times = [float(clock.platform_times(moved[model.platform_columns][None])[0])]
            for arm, one in model.arms.items():
                times.append(float(clock.arms[arm].law.duration(moved[one.columns])))
            first = positions[0]
            found.append(StagePlan(positions[-1], first, first, {}, RETURN, max(times)))
        return found

    @property
    def duration(self) -> float:
        """Time of the whole sequence by closed forms and estimated lines [s]."""
        return math.fsum(self._lengths)

    def duration_with(self, k: int, choice: Choice) -> float:
        """Returns the duration of the plan with another choice in one stage [s].

        Only the stages up to where every joint is again where it was are judged anew, so that refining a long sequence
        costs what its stages cost and not their square.

        Args:
            k: the stage.
            choice: what is decided about it.
        """
        if k == 0 and self.free_start:
            return self.with_choice(k, choice).duration
        positions, lengths = self.positions(), list(self._lengths)
        position = positions[k]
        for j in range(k, len(self.choices)):
            one = choice if j == k else self.choices[j]
            lengths[j] = self._length(j, one, position)
            position = self._after(position, one)
            if np.array_equal(position, positions[j + 1]):
                return math.fsum(lengths)
        lengths[-1] = self._closing(positions[0], position)
        return math.fsum(lengths)

    @cached_property
    def _lengths(self) -> list[float]:
        """Lengths of the stages and at last of the return, 0 where there is none [s]."""
        positions = self.positions()
        found = [self._length(k, choice, positions[k]) for k, choice in enumerate(self.choices)]
        return [*found, self._closing(positions[0], positions[-1])]

    def _after(self, before: FloatArray, choice: Choice) -> FloatArray:
        """Returns all joints after a stage [rad], shape (n,)."""
        model, position = self.stages[0].model, np.array(before)
        position[model.platform_columns] = choice.angle
        for arm, way in choice.ways.items():
            position[model.arms[arm].columns] = way.ends[0, 1]
        return position

    def _length(self, k: int, choice: Choice, before: FloatArray) -> float:
        """Returns the length of a stage that begins with given joints [s]."""
        stage = self.stages[k]
        there: dict[str, float] = {}
        work: dict[str, tuple[Stop, float]] = {}
        model, clock = stage.model, stage.clock
        turn = choice.angle - before[model.platform_columns]
        waiting = float(clock.platform_times(turn[None])[0])
        for arm, way in choice.ways.items():
            moved = way.ends[0, 0] - before[model.arms[arm].columns]
            skips = self.free_start and k == 0
            move = 0.0 if skips else float(clock.arms[arm].law.duration(moved))
            there[arm] = max(move, waiting)
            work[arm] = stage.work[arm][1], float(way.line.sum())
        return stage_length(there, work)

    def _closing(self, first: FloatArray, last: FloatArray) -> float:
        """Returns the length of the return from the last joints to the first [s]."""
        if not self.job.returns:
            return 0.0
        model, clock = self.stages[0].model, self.stages[0].clock
        moved = first - last
        closing = float(clock.platform_times(moved[model.platform_columns][None])[0])
        for arm, one in model.arms.items():
            closing = max(closing, float(clock.arms[arm].law.duration(moved[one.columns])))
        return closing
