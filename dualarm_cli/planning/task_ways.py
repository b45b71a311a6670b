"""One arm's ways to do a task: postures of its stops that are cheap and not all alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.planning.stage_problems import Clock
from dualarm_cli.planning.stop_nodes import StopNodes
from dualarm_cli.sequencing.problem import ArmTasks

SIMILAR = 0.08
"""Postures of a stop that are nearer to one another than this are one [s]."""
DEARER = 0.6
"""Postures that cost more than this beyond the best one's are left out [s]."""
HUB_ROUNDS = 2
"""So often the middle of an arm's work is looked for from the one before."""
MOST_GIVEN = 160
"""Most ways of tasks whose targets are joint configurations."""


@dataclass(frozen=True)
class Ways:
    """One arm's ways to do one task; m of them."""

    entry: FloatArray
    """Joints where its first approach begins [rad], shape (m, joints)."""
    leaving: FloatArray
    """Joints where its last retract ends [rad], shape (m, joints)."""
    first: FloatArray
    """Time of its first stop, lines and dwell [s], shape (m,)."""
    second: FloatArray
    """Time from there to the end of its second stop [s], 0 for tasks of one stop, shape (m,)."""
    lead: float
    """How long its first line takes at least [s], infinite without any way."""
    tail: float
    """How long its last line takes at least [s], infinite without any way."""

    @classmethod
    def none(cls, joints: int) -> Ways:
        """Returns that there is no way, for an arm of some joints."""
        empty = np.zeros(0)
        return cls(np.zeros((0, joints)), np.zeros((0, joints)), empty, empty, np.inf, np.inf)


def hub(
    model: CellModel,
    job: Job,
    name: str,
    nodes: Mapping[tuple[str, int, int], StopNodes],
    clock: Clock,
) -> FloatArray:
    """Returns the joints in the middle of one arm's work [rad]: medians of its stops' postures nearest to them.

    From the start; given configurations have no choice that could gather about it.
    """
    start = np.array(job.cell.robot.postures["home" if job.start == "free" else job.start])
    hub: FloatArray = start[model.arms[name].columns]
    own = [one for (arm, _, _), one in nodes.items() if arm == name and len(one.work)]
    for _ in range(HUB_ROUNDS if own else 0):
        nearest = []
        for one in own:
            rows = np.arange(len(one.work))
            nearest.append(
                one.entry[int(stop_costs(one, rows, hub, clock.arms[name].law.duration).argmin())]
            )
        hub = np.median(nearest, axis=0)
    return hub


def stop_costs(nodes: StopNodes, rows: IntArray, start: FloatArray, duration: object) -> FloatArray:
    """Returns what postures cost about: from the start, the work, and back [s]."""
    assert callable(duration)
    found: FloatArray = (
        duration(nodes.entry[rows] - start)
        + nodes.work[rows]
        + duration(start - nodes.leaving[rows])
    )
    return found


def spread(ends: FloatArray, cost: FloatArray, most: int, duration: object) -> IntArray:
    """Returns the cheapest postures that are not too near to one another, at most so many."""
    assert callable(duration)
    order = np.argsort(cost, kind="stable")
    kept: list[int] = []
    for k in order.tolist():
        if len(kept) == most or (cost[k] > cost[order[0]] + DEARER and most != MOST_GIVEN):
            break
        if kept and most != MOST_GIVEN and duration(ends[kept] - ends[k]).min() < SIMILAR:
            continue
        kept.append(k)
    return np.array(kept, dtype=np.int64)


def widened(arm: ArmTasks, width: int) -> ArmTasks:
    """Returns the same with more ways, which there are not."""
    more = width - arm.ways
    if more == 0:
        return arm
    pad = ((0, 0), (0, more))
    entry = np.pad(arm.entry, (*pad, (0, 0)), constant_values=np.nan)
    leaving = np.pad(arm.leaving, (*pad, (0, 0)), constant_values=np.nan)
    first = np.pad(arm.first, pad, constant_values=np.inf)
    second = np.pad(arm.second, pad)
    return replace(arm, entry=entry, leaving=leaving, first=first, second=second)
