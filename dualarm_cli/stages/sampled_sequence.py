"""A sequence of sampled stops, and what each arm alone needs from each of them to the end."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray, IntArray
from dualarm_cli.postures.sampled_stops import StopSamples

Law = Callable[[FloatArray], FloatArray]
"""Times [s], shape (...), of displacements (..., n) [rad]."""
Costs = Callable[[int, FloatArray, Mapping[str, FloatArray], Mapping[str, IntArray]], FloatArray]
"""Stage, platform angles (s, k), joints before by arm (s, n) and samples taken by arm (s,): extra costs [s], (s,)."""


@dataclass(frozen=True)
class SampledSequence:
    """What the beam searches."""

    angles: FloatArray
    """Platform angles, shape (m, k); where the platform starts first."""
    stages: Sequence[Mapping[str, StopSamples]]
    """By stage, samples of the arms that have a stop in it."""
    start: Mapping[str, FloatArray]
    """Joints of each arm at the start [rad]."""
    arm_law: Mapping[str, Law]
    """Transfer times of each arm."""
    platform_law: Law
    """Times of the platform."""
    free_start: bool
    """Whether the first transfer is left out and a return leads to where the first approach begins."""
    returns: bool
    """Whether the sequence ends where it began."""
    extra: Costs | None = None
    """What a choice costs beyond its time."""


def time_to_go(problem: SampledSequence, arm: str) -> list[FloatArray]:
    """Returns by stage what the arm alone needs in any case after each of its samples there [s], (N,).

    Where it has no stop in a stage the entry is empty.
    """
    found: list[FloatArray] = [np.empty(0)] * len(problem.stages)
    later: tuple[int, StopSamples] | None = None
    for k in range(len(problem.stages) - 1, -1, -1):
        own = problem.stages[k].get(arm)
        if own is None:
            continue
        if later is None:
            closes = problem.returns and not problem.free_start
            move = problem.arm_law[arm](problem.start[arm] - own.last)
            found[k] = move if closes else np.zeros(len(own.work))
        else:
            n, then = later
            move = problem.arm_law[arm](then.first[None] - own.last[:, None])
            if n == k + 1:
                turned = problem.angles[then.ways.row][None] - problem.angles[own.ways.row][:, None]
                move = np.maximum(move, problem.platform_law(turned))
            after = move + then.work + found[n]
            found[k] = after.min(axis=1) if after.shape[1] else np.full(len(own.work), np.inf)
        later = k, own
    return found
