"""Cycle times with dwells that vary: nominal, 95th percentile, worst.

The arms of a real cell wait for grippers and signals. From the segments of a schedule follows what waits for what:
an arm for itself, in synchronous stages for the other arm, and elsewhere at its waits. Motions keep their lengths.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.dwell import TimeRange
from dualarm_cli.model.job import Job
from dualarm_cli.model.motion.trajectory import SAME_TIME
from dualarm_cli.model.schedule import Schedule, Segment
from dualarm_cli.records import dataclass

FOR_OTHERS = frozenset({"partner", "end", "after", "buffer", "shared_zone"})
"""Reasons of waits that end with something that the other arm does."""


@dataclass(frozen=True)
class VariationSettings:
    """Sampling of dwells that vary independently."""

    samples: int = 20_000
    """Number of cycles that are drawn."""
    seed: int = 0
    """Seed of the draws."""
    percentile: float = 95.0
    """Percentage of the cycles that the stated time is not exceeded by."""


VARIATION = VariationSettings()


@dataclass(frozen=True)
class VariedCycle:
    """Cycle times of a plan whose dwells vary."""

    least: float
    """Cycle time with every dwell at its least [s]."""
    nominal: float
    """Cycle time of the plan [s]."""
    percentile_95: float
    """Time that 95 % of the cycles do not exceed, with independent dwells [s]."""
    worst: float
    """Cycle time with every dwell at its most [s]."""
    dwells: int
    """Number of dwells that vary."""

    def at(self, which: str) -> float:
        """Return the time that a budget names: nominal, 95% or worst [s]."""
        return {"nominal": self.nominal, "95%": self.percentile_95, "worst": self.worst}[which]


def varied_cycle(schedule: Schedule, job: Job) -> VariedCycle | None:
    """Compute the cycle times of a plan whose dwells vary; None if none does.

    Between least, nominal and most each part of a dwell is distributed as a triangle; parts of all dwells are drawn
    independently of each other. Targets on conveyors cannot wait, so that jobs with them have none.

    Args:
        schedule: the plan, with its segments.
        job: the job that it was planned for.
    """
    spreads = {
        (task.id, str(stop.action)): stop.varying
        for task in job.tasks
        for stop in task.stops
        if stop.varying
    }
    if not spreads or job.moves or not schedule.segments:
        return None
    varying = _of_segments(schedule, spreads)
    count = VARIATION.samples
    random = np.random.default_rng(VARIATION.seed)
    longer: dict[int, FloatArray] = {}
    for k, spread in varying.items():
        # The first two rows are the extremes.
        drawn = sum((part.drawn(random.random(count)) for part in spread), np.zeros(count))
        ends = [sum(part.least for part in spread), sum(part.most for part in spread)]
        nominal = sum(part.nominal for part in spread)
        longer[k] = np.concatenate([ends, drawn]) - nominal
    times = cycle_times(schedule, longer, 2 + count)
    # Draws do not miss the stated share by rounding down.
    limit = np.percentile(times[2:], VARIATION.percentile, method="higher")
    return VariedCycle(
        float(times[0]), schedule.duration, float(limit), float(times[1]), len(varying)
    )


def _of_segments(
    schedule: Schedule, spreads: Mapping[tuple[str, str], tuple[TimeRange, ...]]
) -> dict[int, tuple[TimeRange, ...]]:
    """Select the dwells that vary among the segments, by index."""
    return {
        k: spreads[part.task, part.action]
        for k, part in enumerate(schedule.segments)
        if part.kind == "dwell" and (part.task, part.action) in spreads
    }


def cycle_times(schedule: Schedule, longer: Mapping[int, FloatArray], count: int) -> FloatArray:
    """Compute when a plan ends if some of its segments take longer [s], shape (count,).

    Args:
        schedule: the plan, with its segments.
        longer: additional time of segments by index [s], (count,); negative for shorter ones.
        count: number of cases.
    """
    parts, barriers, passed = schedule.segments, _barriers(schedule), 0
    ready: dict[str, FloatArray] = {arm: np.zeros(count) for arm in schedule.robot.arms}
    planned = dict.fromkeys(ready, 0.0)
    last = {arm: max((p.end for p in parts if p.arm == arm), default=0.0) for arm in ready}

    def released(part: Segment) -> FloatArray:
        """Return when the other arm is as far as at a segment's planned end [s]."""
        others = [arm for arm in ready if arm != part.arm and part.end <= last[arm] + SAME_TIME]
        times = [ready[arm] + max(0.0, part.end - planned[arm]) for arm in others]
        return np.maximum.reduce([np.zeros(count), *times])

    # What depends on the other arm comes after what ends at the same time.
    depends = [p.kind == "wait" or p.action == "give" for p in parts]
    for k in sorted(range(len(parts)), key=lambda k: (parts[k].end, depends[k])):
        part = parts[k]
        while passed < len(barriers) and part.start >= barriers[passed] - SAME_TIME:
            together = np.maximum.reduce(list(ready.values()))
            ready = {arm: together for arm in ready}
            planned = dict.fromkeys(ready, barriers[passed])
            passed += 1
        arrives, length = ready[part.arm], part.end - part.start
        if part.action == "take" and part.kind not in ("wait", "transfer"):
            # The taker approaches once the giver has arrived, also where it need not wait in the plan.
            arrived = [ready[arm] for arm in ready if planned[arm] <= part.start + SAME_TIME]
            arrives = np.maximum.reduce([arrives, *arrived])
        is_for_other = part.kind == "wait" and part.reason in FOR_OTHERS
        if is_for_other and not barriers:
            # A wait of no length is rounding.
            end = np.maximum(arrives, released(part)) if length > SAME_TIME else arrives
        elif is_for_other and part.reason != "shared_zone":
            # Synchronous arms wait for the end of the stage, at whatever place.
            end = arrives
        elif part.kind == "wait" and part.reason == "window":
            end = np.maximum(arrives, part.end)
        elif part.kind == "dwell" and part.action == "give":
            # The giver stands until the taker has gripped.
            end = np.maximum(arrives, released(part)) + longer.get(k, 0.0)
        else:
            end = arrives + length + longer.get(k, 0.0)
        ready, planned = {**ready, part.arm: end}, {**planned, part.arm: part.end}
    return np.maximum.reduce(list(ready.values()))


def _barriers(schedule: Schedule) -> list[float]:
    """List the instants at which all arms begin together: stages that do not overlap [s]."""
    starts = [stage.start for stage in schedule.stages]
    ends = [stage.end for stage in schedule.stages]
    overlapping = any(b < e - SAME_TIME for b, e in zip(starts[1:], ends[:-1], strict=True))
    return [] if overlapping else starts
