"""Re-planned levers: the largest estimates by themselves and together, planned and verified anew."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import field, replace
from itertools import combinations
from pathlib import Path
from time import monotonic
from typing import Any

from dualarm_cli.evaluation.answers import Run, answers
from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.levers.changes import START, Lever
from dualarm_cli.levers.estimates import Estimate
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ReplanSettings:
    """Numbers of plans that are re-planned."""

    plans: int = 2
    """Number of plans without a limit of time.

    On two cores two take about as long as the plan did.
    """
    singles: int = 4
    """Number of levers that are planned by themselves before any are planned together."""
    together: int = 3
    """Largest number of levers in a combination; there is one combination of each size."""


REPLAN = ReplanSettings()


@dataclass(frozen=True)
class Replanned:
    """Levers together, planned and verified."""

    levers: tuple[Lever, ...]
    """The levers."""
    evaluation: Evaluation
    """Result of the changed job."""
    before: float
    """Cycle time of the plan that it is compared with [s]."""

    @property
    def gain(self) -> float | None:
        """Cycle time gained over the plan [s]; None without a verified plan."""
        return None if self.cycle_time is None else self.before - self.cycle_time

    @property
    def cycle_time(self) -> float | None:
        """Cycle time [s]; None without a verified plan."""
        return self.evaluation.cycle_time if self.evaluation.has_plan else None

    @property
    def names(self) -> list[str]:
        """Names of the levers with their changes."""
        return [str(lever) for lever in self.levers]


@dataclass
class Replanner:
    """Planner of changed jobs within a budget of time."""

    schedule: Schedule
    """The plan that levers are compared with."""
    request: Request
    """Request of the unchanged job."""
    run: Run
    """Function that evaluates requests."""
    store: Store | None
    """Store of evaluations, or None."""
    until: float | None = None
    """Instant of the monotonic clock after which nothing is begun [s], or None.

    The evaluating function leaves requests that run then unanswered.
    """
    batch: int = 2
    """Number of plans that are begun together, if there is a limit of time."""
    tell: Callable[[int, str], None] = lambda done, words: None
    """Progress callback: number of finished plans, and words."""
    results: list[Replanned] = field(default_factory=list)
    """All results so far."""
    cut: int = 0
    """Number of plans that were begun and not finished in time."""

    def plan(self, sets: Sequence[tuple[Lever, ...]], most: int | None = None) -> None:
        """Plan the first new sets of levers, as far as the time allows."""
        planned = {frozenset(map(str, result.levers)) for result in self.results}
        keys: dict[frozenset[str], tuple[Lever, ...]] = {}
        for levers in sets:
            keys.setdefault(frozenset(map(str, levers)), levers)
        left = [levers for key, levers in keys.items() if key not in planned][:most]
        fresh: list[Replanned] = []
        while left and (self.until is None or monotonic() < self.until):
            count = len(left) if self.until is None else self.batch
            now, left = left[:count], left[count:]
            requests = [replace(self.request, overrides=merged(levers)) for levers in now]
            by_index: dict[int, Replanned] = {}
            for answer in answers(requests, self.run, self.store):
                result = Replanned(now[answer.index], answer.evaluation, self.schedule.duration)
                by_index[answer.index] = result
                self.tell(len(self.results) + len(fresh) + len(by_index), "")
            fresh += [by_index[k] for k in sorted(by_index)]
            self.cut += len(now) - len(by_index)
        self.results += fresh


def merged(levers: Sequence[Lever]) -> dict[str, Any]:
    """Merge the values of levers that do not exclude each other."""
    return {key: value for lever in levers for key, value in lever.values.items()}


def request_of(schedule: Schedule, tasks: Path, case: str) -> Request:
    """Build the request that plans a job with the settings of a schedule."""
    recorded, default = schedule.provenance.settings, PlanSettings().as_dict()
    chosen: dict[str, Any] = {
        name: recorded[name] for name in ("timing", "blend", "effort", "seed")
    }
    # Methods are named only if they are not the defaults, and any of them by `redundancy`.
    platform, *methods = (
        recorded[name] if recorded[name] != default[name] else None
        for name in ("platform", "follower", "seam_solver", "redundancy")
    )
    method = next(filter(None, methods), None)
    return Request.of(tasks, case, platform=platform, redundancy=method, **chosen)


def replan(replanner: Replanner, estimates: Sequence[Estimate], target: float | None) -> None:
    """Plan the largest levers by themselves and together.

    Without a limit of time these are few plans, chosen by the estimates. Otherwise gains of new plans decide what is
    planned together, and then all other levers follow. All results are in the replanner.

    Args:
        replanner: plans changed jobs.
        estimates: of all levers, largest first.
        target: cycle time that is required [s], or None.
    """
    cell = [e for e in estimates if e.lever.kind != "robot"]
    free = _whole([e.lever for e in cell if e.gain is not None and e.gain > 0.0])
    unknown = [e.lever for e in cell if e.gain is None and not (free and e.lever.is_modelled)]
    # Where parts are on belts nothing has an estimate: changes of more values come first.
    unknown.sort(key=lambda lever: -len(lever.values) if lever.is_modelled else 0)
    unknown = _whole(unknown)
    # Another start takes no longer to plan than the job, and gains more than most numbers.
    starts = [lever for lever in unknown if lever.name == START]
    singles = [*starts, *free, *(lever for lever in unknown if lever not in starts)]
    if replanner.until is None:
        together = _together(replanner, estimates, target)[: 1 if target is None else None]
        replanner.plan([*together, *((lever,) for lever in singles)], REPLAN.plans)
        return
    first = singles[: REPLAN.singles]
    later = [lever for lever in (*unknown, *free) if lever not in first]
    for levers in (first, later):
        replanner.plan([(lever,) for lever in levers])
        replanner.plan(_together(replanner, estimates, target))


def _together(
    replanner: Replanner, estimates: Sequence[Estimate], target: float | None
) -> list[tuple[Lever, ...]]:
    """Select levers to plan together: the fewest for a target, the best of each size."""
    gains: dict[str, float] = {str(e.lever): e.gain for e in estimates if e.gain is not None}
    gains |= {r.names[0]: r.gain or 0.0 for r in replanner.results if len(r.levers) == 1}
    usable = [
        e.lever for e in estimates if e.lever.kind != "robot" and gains.get(str(e.lever), 0.0) > 0.0
    ]
    usable = _whole(sorted(usable, key=lambda lever: -gains[str(lever)]))
    sets = [
        best
        for size in range(REPLAN.together, 1, -1)
        if (best := _best(usable, size, gains)) is not None
    ]
    needed = 0.0 if target is None else replanner.schedule.duration - target
    return [*_least(usable, gains, needed), *sets] if needed > 0.0 else sets


def _whole(levers: Sequence[Lever]) -> list[Lever]:
    """Leave out levers that are parts of earlier ones."""
    return [
        lever
        for k, lever in enumerate(levers)
        if not any(lever.values.keys() < larger.values.keys() for larger in levers[:k])
    ]


def _best(
    levers: Sequence[Lever], size: int, gains: Mapping[str, float]
) -> tuple[Lever, ...] | None:
    """Select the levers that gain most together, if gains add up; None if too few exist."""
    sets = _compatible(levers[: 2 * REPLAN.together + size], size)
    return max(sets, key=lambda members: sum(gains[str(lever)] for lever in members), default=None)


def _least(
    levers: Sequence[Lever], gains: Mapping[str, float], needed: float
) -> list[tuple[Lever, ...]]:
    """Select the fewest levers whose gains add up to what is needed [s], if any do."""
    for size in range(1, REPLAN.together + 1):
        enough = [
            members
            for members in _compatible(levers[: 2 * REPLAN.together + size], size)
            if sum(gains[str(lever)] for lever in members) >= needed
        ]
        if enough:
            return [min(enough, key=lambda members: sum(gains[str(lever)] for lever in members))]
    return []


def _compatible(levers: Sequence[Lever], size: int) -> list[tuple[Lever, ...]]:
    return [
        members
        for members in combinations(levers, size)
        if not any(a.excludes(b) for a, b in combinations(members, 2))
    ]
