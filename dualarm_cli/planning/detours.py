"""Postures out of the way: where an arm goes and waits while the other one passes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.planning.keeping_clear import SLACK, STEP, keeps_clear, last_motion, sampled
from dualarm_cli.planning.motion import Motion, detour_pieces
from dualarm_cli.planning.stage_plan import Detour, StagePlan
from dualarm_cli.timing import TimingSolver

SHARES = (0.0, 0.5, 1.0)
"""Shares of the way to the posture after which the other arm leaves."""
PAUSE = 25
"""Pauses are found to so many instants."""
MOVES = ("transfer", "return")
"""Segments after which an arm is where its line begins."""
RANDOM = 200
"""Random postures that are drawn besides the robot's own."""
SPREAD = 0.5
"""Standard deviation of the random ones about start and goal [rad]."""
TRIED = 12
"""So many postures of an arm are tried out, the nearest ones first."""


def least_detour(
    model: CellModel,
    job: Job,
    plan: StagePlan,
    motion: Motion,
    timing: TimingSolver,
    test: QuickTest,
    seed: int,
) -> StagePlan | None:
    """Returns a stage in which one arm goes out of the other's way, None where none of those tried keeps clear.

    The arm goes to a posture that is free while the other one does what it does; the other one leaves meanwhile; then
    the arm goes on. Of postures, shares and pauses the shortest stage is taken.

    Args:
        model: the job's cell.
        job: what is to be done.
        plan: the stage, with no waits.
        motion: of this stage alone.
        timing: how transfers and lines are timed.
        test: the cell's quick test.
        seed: of the random postures.
    """
    if len(model.arms) < 2:
        return None
    blind = sampled(motion)
    best, least = None, np.iinfo(np.int64).max
    for name in model.arms:
        [other] = [key for key in model.arms if key != name]
        passing = last_motion(blind[:, model.arms[other].columns])
        for posture in _postures(model, job, plan, name, blind[: passing + 1], test, seed):
            way = _Way(model, job, plan, motion, name, posture, timing)
            for share in SHARES:
                delay = round(share * len(way.out))
                longest = PAUSE * (1 + (passing + delay) // PAUSE)
                if way.length(0, delay) >= least or not keeps_clear(test, way.rows(longest, delay)):
                    continue
                low, high = 0, longest
                while high - low > PAUSE:
                    middle = (low + high) // 2
                    if keeps_clear(test, way.rows(middle, delay)):
                        high = middle
                    else:
                        low = middle
                if way.length(high, delay) < least:
                    least = way.length(high, delay)
                    waits = {other: delay * STEP} if delay else {}
                    best = replace(plan, waits=waits, detours={name: Detour(posture, high * STEP)})
    return best


class _Way:
    """One arm's way by a posture, and everybody's joints along it at instants STEP apart."""

    def __init__(
        self,
        model: CellModel,
        job: Job,
        plan: StagePlan,
        motion: Motion,
        name: str,
        posture: FloatArray,
        timing: TimingSolver,
    ) -> None:
        limits = job.cell.robot.limits.scaled(job.speed)
        columns = {arm: model.arms[arm].columns for arm in model.arms}
        tried = replace(plan, detours={name: Detour(posture, 0.0)})
        pieces = detour_pieces(model, tried, name, columns, limits, timing, job.tool_speed)
        every = sampled(motion)
        ends = [s.end for s in motion.segments if s.arm == name and s.kind in MOVES]
        self._own = columns[name]
        [self._other] = [columns[arm] for arm in columns if arm != name]
        arrived = round(max(ends, default=0.0) / STEP)
        self._rest = every[arrived:, self._own]
        self._arrived = arrived
        self._every = every
        self._posture = posture
        rows = [every[:1, self._own]]
        for piece in pieces:
            rows.append(piece.at(np.arange(0.0, piece.duration, STEP))[0])
        self.out, self.on = (rows[1], rows[2]) if len(rows) > 2 else (rows[0], rows[-1])

    def length(self, pause: int, delay: int) -> int:
        """Returns how many instants the stage takes."""
        mine = max(self._arrived, len(self.out) + pause + len(self.on)) + len(self._rest)
        return max(mine, delay + len(self._every))

    def rows(self, pause: int, delay: int) -> FloatArray:
        """Returns all joints [rad], shape (t, columns), with a pause at the posture and a delay of the other arm."""
        length = self.length(pause, delay)
        result = np.empty((length, self._every.shape[1]))
        result[:] = self._every[np.minimum(np.arange(length), len(self._every) - 1)]
        late = np.clip(np.arange(length) - delay, 0, len(self._every) - 1)
        result[:, self._other] = self._every[late][:, self._other]
        # A line begins when the platform is there as well.
        waited = max(0, self._arrived - len(self.out) - pause - len(self.on))
        mine = np.concatenate(
            [
                self.out,
                np.tile(self._posture, (pause, 1)),
                self.on,
                np.tile(self._rest[:1], (waited, 1)),
                self._rest,
            ]
        )
        result[:, self._own] = mine[np.minimum(np.arange(length), len(mine) - 1)]
        return result


def _postures(
    model: CellModel,
    job: Job,
    plan: StagePlan,
    name: str,
    passing: FloatArray,
    test: QuickTest,
    seed: int,
) -> list[FloatArray]:
    """Returns postures of one arm that are free while the other one does what it does, the nearest ones first."""
    arm = model.arms[name]
    limits = job.cell.robot.limits.select(arm.arm.joints)
    here, there = plan.start[arm.columns], plan.arrival[arm.columns]
    random = np.random.default_rng(seed)
    about = np.stack([here, there, 0.5 * (here + there)])[random.integers(0, 3, RANDOM)]
    drawn = about + random.normal(scale=SPREAD, size=about.shape)
    home = job.cell.robot.postures["home"][arm.columns]
    every = np.vstack([here, home, drawn])
    every = np.clip(every, limits.lower, limits.upper)
    way = np.maximum(
        np.abs(every - here) / limits.velocity, np.abs(there - every) / limits.velocity
    ).max(axis=1)
    every = every[np.argsort(way, kind="stable")]
    found: list[FloatArray] = []
    some = passing[np.linspace(0, len(passing) - 1, 12).astype(int)]
    for posture in every:
        position = some.copy()
        position[:, arm.columns] = posture
        groups = (test.cross, *test.own.values())
        if all(bool((test.margins(group, position) >= SLACK).all()) for group in groups):
            found.append(posture)
            if len(found) == TRIED:
                break
    return found
