"""Waits that keep arms clear of each other where their postures do not: the shortest that serve, stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.collision.quick_test import QuickTest
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.planning.detours import least_detour
from dualarm_cli.planning.keeping_clear import STEP, arms_alone_keep_clear, keeps_clear, last_motion
from dualarm_cli.planning.motion import Motion, realise
from dualarm_cli.planning.stage_plan import StagePlan
from dualarm_cli.timing import TimingSolver

DELAY_STEP = 0.05
"""Delays are multiples of this [s]."""


@dataclass(frozen=True)
class Cleared:
    """A plan after delays."""

    plans: list[StagePlan]
    """Its stages, some with waits."""
    motion: Motion
    """Their motion."""
    blocked: tuple[int, ...]
    """Stages that do not keep clear by any delay."""


def with_delays(
    model: CellModel,
    job: Job,
    plans: Sequence[StagePlan],
    motion: Motion,
    timing: TimingSolver,
    test: QuickTest,
    seed: int,
) -> Cleared:
    """Returns a plan in which arms wait at the start of stages in which they would not keep clear.

    Only one arm of a stage waits, in steps of DELAY_STEP; of all delays that serve, the one with the shortest stage is
    taken. What is between the instants is left to the verifier.

    Args:
        model: the job's cell.
        job: what is to be done.
        plans: its stages.
        motion: theirs, without waits.
        timing: how transfers and lines are timed.
        test: the cell's quick test.
        seed: of what is tried at random.
    """
    found, blocked = list(plans), []
    for k, stage in enumerate(motion.stages):
        count = max(2, int(np.ceil((stage.end - stage.start) / STEP)) + 1)
        position = motion.trajectory.at(np.linspace(stage.start, stage.end, count))[0]
        if keeps_clear(test, position):
            continue
        if not arms_alone_keep_clear(test, position):
            # Neither waiting nor making way mends what one arm does by itself.
            blocked.append(k)
            continue
        delay = _least_delay(model, test, position, (stage.end - stage.start) / (count - 1))
        if delay is not None:
            found[k] = replace(plans[k], waits=delay)
            continue
        alone = realise(model, job, [plans[k]], timing)
        detour = least_detour(model, job, plans[k], alone, timing, test, seed)
        if detour is None:
            blocked.append(k)
        else:
            found[k] = detour
    if all(new is old for new, old in zip(found, plans, strict=True)):
        return Cleared(found, motion, tuple(blocked))
    return Cleared(found, realise(model, job, found, timing), tuple(blocked))


def _least_delay(
    model: CellModel, test: QuickTest, position: FloatArray, step: float
) -> dict[str, float] | None:
    """Returns the delay of one arm that makes the stage shortest, None where no delay serves.

    Args:
        model: the cell.
        test: its quick test.
        position: all joints at instants a step apart [rad], shape (t, columns).
        step: time between them [s].
    """
    ends = {name: last_motion(position[:, arm.columns]) for name, arm in model.arms.items()}
    shift = max(1, round(DELAY_STEP / step))
    tries = []
    for name, end in ends.items():
        others = max((e for other, e in ends.items() if other != name), default=0)
        for delay in range(shift, max(others, 1) + shift, shift):
            tries.append((max(end + delay, others), delay, name))
    for length, delay, name in sorted(tries):
        columns = model.arms[name].columns
        longer = np.concatenate(
            [position, np.tile(position[-1], (max(0, length + 1 - len(position)), 1))]
        )
        delayed = longer.copy()
        delayed[:, columns] = longer[:1, columns]
        delayed[delay:, columns] = longer[:-delay, columns]
        if keeps_clear(test, delayed):
            return {name: delay * step}
    return None
