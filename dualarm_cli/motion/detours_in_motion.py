"""Detours in motion, with a via point instead of a curve.

The arm passes its via point in the state of a collision-free curve. Given that state, the transfers before and after it
are independent problems, so that the launch on each side is chosen separately. The caller checks for collisions. The
method is ours.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.motion.blending import MIN_GAIN, adjacent_passings, with_launches
from dualarm_cli.motion.curved_transfers import detour_pieces
from dualarm_cli.motion.stop_motion import rates_between
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import Launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

SHARES = (0.5, 0.35, 0.65)
"""Positions of via points on a curve, as fractions of its duration."""
PACES = (1.0, 0.75)
"""Speeds at via points, as fractions of the speed on the curve."""


@dataclass(frozen=True)
class MovingDetour:
    """Detour in motion, with the launches of its lines."""

    detour: Detour
    """Via point with its rates; rates at the ends follow from the lines."""
    lines: tuple[Launch | None, Launch | None]
    """Launches of the retract before and the approach after it; None at rest."""
    saved: float
    """Time gained over the detour with lines at rest [s]."""


def moving_detours(
    drive: Drive, plans: Sequence[StagePlan], stopping: Collection[tuple[int, str]] = ()
) -> dict[tuple[int, str], list[MovingDetour]]:
    """Find the detours that are faster in motion, fastest first, by stage and arm.

    There are none if tool speed is limited.

    Args:
        drive: of the job.
        plans: stages of the job; lines next to detours are at rest.
        stopping: transfers that stay at rest, by the stage at their end and the arm.
    """
    detours = {}
    for k, plan in enumerate(plans):
        before = plans[k - 1] if k else None
        for name in plan.detours:
            if not drive.to(plan).caps and (k, name) not in stopping and name not in plan.waits:
                candidates = _arm_detours(drive, before, plan, name)
                if candidates:
                    detours[k, name] = candidates
    return detours


def with_moving_detours(
    drive: Drive, plans: Sequence[StagePlan], chosen: Mapping[tuple[int, str], MovingDetour]
) -> list[StagePlan]:
    """Build stages with given detours in motion and the lines next to them."""
    changed = with_launches(plans, {key: choice.lines for key, choice in chosen.items()})
    for (k, name), choice in chosen.items():
        plan, before = changed[k], changed[k - 1] if k else None
        ends = rates_between(drive, before, replace(plan, detours={})).get(name, (None, None))
        assert choice.detour.rates is not None
        leaving, arriving = (
            np.zeros_like(choice.detour.rates[1]) if r is None else r for r in ends
        )
        rates = np.stack([leaving, choice.detour.rates[1], arriving])
        detour = replace(choice.detour, rates=rates)
        changed[k] = replace(plan, detours={**plan.detours, name: detour})
    return changed


def _arm_detours(
    drive: Drive, before: StagePlan | None, plan: StagePlan, name: str
) -> list[MovingDetour]:
    """Find the faster detours in motion of one arm in one stage, fastest first."""
    retract, approach = adjacent_passings(drive, before, plan, name)
    if len(retract.launches) == len(approach.launches) == 1:
        return []
    retract, under = retract.within(drive.to(plan).group_limits[name]), drive.to(plan)
    platform = time_transfers(under, plan, rates_between(drive, before, plan)).motion.get(PLATFORM)
    pieces = detour_pieces(drive, plan, name, platform)
    least = platform.duration if platform is not None and plan.stops else 0.0
    at_rest = max(sum(piece.duration for piece in pieces), least)
    at_rest += float(retract.time[0] + approach.time[0])
    detours = []
    for via, rates in _vias(plan.detours[name], pieces[0]):
        i, j, time = _quickest(drive, plan, name, (retract, approach), (via, rates), least)
        if time < at_rest - MIN_GAIN:
            lines = retract.launches[i], approach.launches[j]
            ends = np.zeros_like(rates)
            detour = Detour(via[None], not rates.any(), np.stack([ends, rates, ends]))
            detours.append(MovingDetour(detour, lines, at_rest - time))
    return sorted(detours, key=lambda candidate: -candidate.saved)


def _vias(detour: Detour, whole: Trajectory) -> list[tuple[FloatArray, FloatArray]]:
    """List via points (n,) for a detour in motion, with their rates (2, n).

    Args:
        detour: detour at rest at both ends.
        whole: its motion, if it is a curve.
    """
    if detour.stops:
        return [(detour.points[0], np.zeros((2, detour.points.shape[1])))]
    vias = []
    for fraction in SHARES:
        q, v, a = (row[0] for row in whole.clamped(np.array([fraction * whole.duration])))
        vias += [(q, np.stack([pace * v, np.square(pace) * a])) for pace in PACES]
    return vias


def _quickest(
    drive: Drive,
    plan: StagePlan,
    name: str,
    lines: tuple[Passings, Passings],
    state: tuple[FloatArray, FloatArray],
    least: float,
) -> tuple[int, int, float]:
    """Choose the launches around a via point; return also the total time [s].

    Args:
        drive: of the job.
        plan: the stage.
        name: the arm.
        lines: passings of the retract before and of the approach after the detour.
        state: via point (n,) and rates (2, n) there.
        least: minimum duration of the detour [s].
    """
    index, (via, rates), at_via = drive.columns[name], state, Passings.only(state[1])
    limits = drive.to(plan).group_limits[name]
    retract, approach = lines
    to_via = TransferProblem(limits.joints, plan.start[index], via, limits)
    at_rest = MovingTransfer(to_via).duration(retract.rates[0], rates)
    i, _, first = quickest_pair(retract, at_via, to_via, at_rest)
    remaining = max(0.0, least - (first - float(retract.time[i])))
    if not np.isfinite(remaining):
        return 0, 0, np.inf
    onward = TransferProblem(limits.joints, via, plan.arrival[index], limits, remaining)
    at_rest = MovingTransfer(onward).duration(rates, approach.rates[0])
    _, j, second = quickest_pair(at_via, approach, onward, at_rest)
    return i, j, first + second
