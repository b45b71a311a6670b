"""Detours that begin and end in motion: by a via point that need not be a stop, with the lines beside them.

The state in which an arm passes its via point is taken from the curve that is known to be collision-free, or is rest
where the detour stops there. Given that state the transfers before and after it are problems of their own, so that the
line on each side is chosen by itself. Whether the whole is collision-free is for the caller to find out. Our own.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.trajectory import Trajectory
from dualarm_cli.motion.bent_transfers import detour_pieces
from dualarm_cli.motion.blending import WORTH, passings_beside, with_ways
from dualarm_cli.motion.stop_motion import rates_between
from dualarm_cli.motion.transfers import PLATFORM, Drive, time_transfers
from dualarm_cli.postures.stage_plan import Detour, StagePlan
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import Launch
from dualarm_cli.timing.line_ends import Passings, quickest_pair
from dualarm_cli.timing.problem import TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer

SHARES = (0.5, 0.35, 0.65)
"""Where on a curve an arm may have its via point, as shares of the curve's time."""
PACES = (1.0, 0.75)
"""How fast it may be there, as shares of its velocity on the curve."""


@dataclass(frozen=True)
class BentWay:
    """A detour in motion."""

    detour: Detour
    """Its via point, with rates there; those at its ends follow from the lines."""
    lines: tuple[Launch | None, Launch | None]
    """How the ends of the retract before and of the approach after it are passed; None: at rest."""
    saved: float
    """How much quicker it is than the detour with lines at rest [s]."""


def bent_ways(
    drive: Drive, plans: Sequence[StagePlan], stopping: Collection[tuple[int, str]] = ()
) -> dict[tuple[int, str], list[BentWay]]:
    """Returns the detours that are quicker in motion, quickest first, by stage and arm.

    Where the tools' speed has a cap there are none.

    Args:
        drive: of the job.
        plans: its stages; lines beside detours are at rest.
        stopping: transfers between stops all the same, by the stage that they lead to and arm.
    """
    found = {}
    for k, plan in enumerate(plans):
        before = plans[k - 1] if k else None
        for name in plan.detours:
            if drive.cap is None and (k, name) not in stopping and name not in plan.waits:
                ways = _ways(drive, before, plan, name)
                if ways:
                    found[k, name] = ways
    return found


def with_bent_ways(
    drive: Drive, plans: Sequence[StagePlan], ways: Mapping[tuple[int, str], BentWay]
) -> list[StagePlan]:
    """Returns stages with detours in motion, and the lines beside them."""
    found = with_ways(plans, {key: way.lines for key, way in ways.items()})
    for (k, name), way in ways.items():
        plan, before = found[k], found[k - 1] if k else None
        ends = rates_between(drive, before, replace(plan, detours={})).get(name, (None, None))
        assert way.detour.rates is not None
        leaving, arriving = (np.zeros_like(way.detour.rates[1]) if r is None else r for r in ends)
        rates = np.stack([leaving, way.detour.rates[1], arriving])
        detour = replace(way.detour, rates=rates)
        found[k] = replace(plan, detours={**plan.detours, name: detour})
    return found


def _ways(drive: Drive, before: StagePlan | None, plan: StagePlan, name: str) -> list[BentWay]:
    """Returns the detours in motion of one arm in one stage that are quicker, quickest first."""
    retract, approach = passings_beside(drive, before, plan, name)
    if len(retract.ways) == len(approach.ways) == 1:
        return []
    platform = time_transfers(drive, plan, rates_between(drive, before, plan)).motion.get(PLATFORM)
    pieces = detour_pieces(drive, plan, name, platform)
    least = platform.duration if platform is not None and plan.stops else 0.0
    rest = max(sum(piece.duration for piece in pieces), least)
    rest += float(retract.time[0] + approach.time[0])
    found = []
    for via, rates in _vias(plan.detours[name], pieces[0]):
        i, j, time = _quickest(drive, plan, name, (retract, approach), (via, rates), least)
        if time < rest - WORTH:
            lines = retract.ways[i], approach.ways[j]
            ends = np.zeros_like(rates)
            detour = Detour(via[None], not rates.any(), np.stack([ends, rates, ends]))
            found.append(BentWay(detour, lines, rest - time))
    return sorted(found, key=lambda way: -way.saved)


def _vias(detour: Detour, whole: Trajectory) -> list[tuple[FloatArray, FloatArray]]:
    """Returns via points (n,) that a detour may have in motion, and rates (2, n) at them.

    Args:
        detour: at rest at both ends.
        whole: its motion, if it is a curve.
    """
    if detour.stops:
        return [(detour.points[0], np.zeros((2, detour.points.shape[1])))]
    found = []
    for share in SHARES:
        q, v, a = (row[0] for row in whole.at(np.array([share * whole.duration])))
        found += [(q, np.stack([pace * v, np.square(pace) * a])) for pace in PACES]
    return found


def _quickest(
    drive: Drive,
    plan: StagePlan,
    name: str,
    lines: tuple[Passings, Passings],
    state: tuple[FloatArray, FloatArray],
    least: float,
) -> tuple[int, int, float]:
    """Returns the ways of the lines that go best with a via point, and how long all takes [s].

    Args:
        drive: of the job.
        plan: the stage.
        name: the arm.
        lines: the retract before and the approach after the detour.
        state: via point (n,) and rates (2, n) there.
        least: how long the detour takes at least [s].
    """
    index, (via, rates), own = drive.columns[name], state, Passings.only(state[1])
    limits = drive.limits.select(drive.joints(name))
    retract, approach = lines
    out = TransferProblem(limits.joints, plan.start[index], via, limits)
    rest = MovingTransfer(out).duration(retract.rates[0], rates)
    i, _, first = quickest_pair(retract, own, out, rest)
    left = max(0.0, least - (first - float(retract.time[i])))
    if not np.isfinite(left):
        return 0, 0, np.inf
    on = TransferProblem(limits.joints, via, plan.arrival[index], limits, left)
    rest = MovingTransfer(on).duration(rates, approach.rates[0])
    _, j, second = quickest_pair(own, approach, on, rest)
    return i, j, first + second
