"""Optimisation of the launches of two lines and the transfer between them.

A line away from a target, the transfer after it and the line to the next target take R + X + A. Each line has a family
of launches (`timing/launch`), which determine the state of motion at its outer end; the transfer between two such
states is computed by ruckig. A pattern search over both families minimises R + X + A. The method is ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from functools import cache

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import COMPARED, CUTS, PROFILES, Launch, launches
from dualarm_cli.timing.line_profile import path_of
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer


@dataclass(frozen=True)
class LineEndSettings:
    """Settings of the search for launches."""

    middle: tuple[int, int] = 2, 5
    """Indices of a profile and a cut that are fast under jerk limits."""
    even: tuple[int, int] = 8, 5
    """Indices of a profile and a cut that are fast without jerk limits."""
    late: tuple[tuple[int, int], ...] = (0, 9), (8, 9)
    """Indices of profiles and cuts with slow ends, for nearby position limits.

    The first pair is for jerk limits, the second one for none.
    """
    steps: tuple[tuple[int, int], ...] = (2, 4), (1, 2), (1, 1)
    """Step widths of the pattern search through PROFILES and CUTS."""
    less: float = 1e-9
    """Smallest gain of an improvement [s]."""
    widest: tuple[float, ...] = 0.3, 0.3, 0.2, 0.03
    """First step widths of the refinement: constant, cruise, inner and cut.

    The following widths are halves.
    """
    numbers: tuple[int, ...] = 3, 0, 1, 2
    """Order in which the numbers of a launch are refined, the most effective first."""
    sweeps: int = 3
    """Maximum number of sweeps per step width."""


ENDS = LineEndSettings()

REST = 0, len(CUTS)
"""Index pair that stands for rest: the last cut, after the whole profile."""
STARTS = tuple(
    pair
    for quick, slow in zip((ENDS.middle, ENDS.even), ENDS.late, strict=True)
    for pair in ((quick, quick), (slow, slow), (quick, REST), (REST, quick))
)
"""Start pairs of the pattern search, in addition to rest at both lines."""
RANGES = (0.0, 40.0, 1.0), (0.0, 40.0, 1.0), (0.2, 1.5, 0.0), (0.1, 0.98, 0.0)
"""Smallest and largest value of each number, and whether steps are relative."""


@dataclass(frozen=True)
class Passings:
    """Launches of one line with times and end states; the first is at rest."""

    launches: tuple[Launch | None, ...]
    """Launches; None is at rest."""
    time: FloatArray
    """Time of the line with each launch [s], shape (g,)."""
    rates: FloatArray
    """Rates at the outer end in the direction of motion, shape (g, 2, n)."""
    line: LineProblem | None = None
    """Line from its target outwards; None without a line."""
    away: bool = True
    """Whether the tool departs from the target; otherwise it arrives."""

    @property
    def indices(self) -> Mapping[Place, int]:
        """Indices of launches by those of profile and cut; without a line all are at rest."""
        return _indices(len(self.launches) > 1)

    def within(self, limits: JointLimits) -> Passings:
        """Let launches with rates beyond other limits take forever."""
        rates = np.abs(self.rates)
        beyond = rates > np.stack([limits.velocity, limits.acceleration])
        time = np.where(beyond.any(axis=(1, 2)), np.inf, self.time)
        return replace(self, time=time) if beyond.any() else self

    @classmethod
    def none(cls, joints: int) -> Passings:
        """Build the passings of no line: at rest."""
        return cls((None,), np.zeros(1), np.zeros((1, 2, joints)))

    @classmethod
    def only(cls, rates: FloatArray) -> Passings:
        """Build the passings of a target that is passed with rates of shape (2, n)."""
        return cls((None,), np.zeros(1), rates[None])

    @classmethod
    def along(cls, problem: LineProblem, rest: float, *, away: bool) -> Passings:
        """Build the passings of a line that is given from its target outwards.

        Args:
            problem: the line.
            rest: its duration from rest to rest [s].
            away: whether the tool departs from the target; otherwise it arrives.
        """
        family = launches(problem)
        velocity = family.velocity if away else -family.velocity
        rates = np.stack([velocity, family.acceleration], axis=1)
        return cls(
            (None, *family.launches),
            np.append(rest, family.time),
            np.concatenate([np.zeros((1, *rates.shape[1:])), rates]),
            problem,
            away,
        )


Place = tuple[int, int]
"""Indices of a profile and a cut."""


def quickest_pair(
    before: Passings,
    after: Passings,
    problem: TransferProblem,
    rest: float,
    room: float = 0.0,
    start: tuple[int, int] | None = None,
) -> tuple[int, int, float]:
    """Find the best launches of two lines; return also the total time [s].

    A pattern search: from the best of a few pairs, or a given one, to a better neighbour, changing profile and cut of
    one line or the cuts of both, until there is none. Never slower than from rest to rest; optimality is not
    guaranteed.

    Args:
        before: passings of the retract.
        after: passings of the approach.
        problem: the transfer; its rates are ignored.
        rest: its duration from rest to rest [s].
        room: margin to position limits [rad].
        start: indices of the launches where the search starts; None for the best of STARTS.
    """
    transfer, platform = MovingTransfer(problem, room), problem.minimum_duration
    times = before.time.tolist(), after.time.tolist()
    least = {(0, 0): times[0][0] + rest + times[1][0]}
    first, second = before.indices, after.indices

    def time(pair: tuple[Place, Place], limit: float) -> float:
        i, j = first[pair[0]], second[pair[1]]
        if (i, j) not in least:
            lines = times[0][i] + times[1][j]
            if lines + platform >= limit:
                return np.inf
            least[i, j] = lines + transfer.duration(before.rates[i], after.rates[j], limit - lines)
        return least[i, j]

    best, pair = least[0, 0], (REST, REST)
    # The best pair only improves: a pair that was not better never is.
    starts = STARTS if start is None else ((_place(start[0]), _place(start[1])),)
    tried = set(starts)
    for candidate in starts:
        if (total := time(candidate, best)) < best:
            best, pair = total, candidate
    for width in ENDS.steps:
        moved = True
        while moved:
            moved = False
            for step, other_step in _moves(*width):
                candidate = _moved(pair[0], step), _moved(pair[1], other_step)
                if candidate in tried:
                    continue
                tried.add(candidate)
                if (total := time(candidate, best)) < best - ENDS.less:
                    best, pair, moved = total, candidate, True
    return first[pair[0]], second[pair[1]], best


def _place(index: int) -> Place:
    """Return the indices of profile and cut of a launch."""
    return divmod(index - 1, len(CUTS)) if index else REST


@cache
def _indices(has_launches: bool) -> Mapping[Place, int]:
    """Number the launches by their indices of profile and cut; the last cut stands for rest."""
    cuts = len(CUTS)
    return {
        (profile, cut): 1 + profile * cuts + cut if has_launches and cut < cuts else 0
        for profile in range(len(PROFILES))
        for cut in range(cuts + 1)
    }


@cache
def _moves(profiles: int, cuts: int) -> tuple[tuple[Place, Place], ...]:
    """List the changes of a pair for steps through profiles and cuts."""
    still, signs = (0, 0), (-1, 1)
    single = [(0, k * cuts) for k in signs]
    both = [(p * profiles, k * cuts) for k in (0, *signs) for p in signs]
    return (
        *((step, still) for step in single),
        *((still, step) for step in single),
        *((first, second) for first in single for second in single),
        *((step, still) for step in both),
        *((still, step) for step in both),
    )


@cache
def _moved(place: Place, by: Place) -> Place:
    profile, cut = place[0] + by[0], place[1] + by[1]
    return min(max(profile, 0), len(PROFILES) - 1), min(max(cut, 0), len(CUTS))


@dataclass(frozen=True)
class _End:
    """Line with a launch that is refined."""

    time: float
    """Duration of the line [s]."""
    rates: FloatArray
    """Rates at its outer end in the direction of motion, shape (2, n)."""
    launch: Launch | None
    """Launch at its outer end; None at rest, which is not refined."""
    path: trajectories.Path | None = None
    """Path of the line with its limits."""
    away: bool = True
    """Whether the tool departs from the target."""

    @classmethod
    def of(cls, lines: Passings, index: int) -> _End:
        """Build a line with one of its launches."""
        launch, line, time, rates = (
            lines.launches[index],
            lines.line,
            lines.time[index],
            lines.rates[index],
        )
        if launch is None or line is None:
            return cls(float(time), rates, None)
        return cls(float(time), rates, launch, path_of(line), lines.away)

    def changed(self, halved: int, varied_numbers: Sequence[int]) -> _Variants:
        """Vary numbers of the launch up and down.

        Args:
            halved: number of halvings of the widest steps.
            varied_numbers: indices of the numbers to vary.
        """
        variants = _Variants(self)
        if self.launch is None or self.path is None:
            return variants
        current = [self.launch.constant, self.launch.cruise, self.launch.inner, self.launch.cut]
        share = power(0.5, halved)
        for number in varied_numbers:
            least, largest, relative = RANGES[number]
            step = ENDS.widest[number] * share * (1.0 + relative * current[number])
            for value in (current[number] + step, current[number] - step):
                if (value := min(max(value, least), largest)) != current[number]:
                    variants.numbers.append([*current[:number], value, *current[number + 1 :]])
                    variants.varied.append(number)
        if not variants.numbers:
            return variants
        numbers = np.array(variants.numbers)
        profiles, cuts = np.ascontiguousarray(numbers[None, :, :3]), numbers[None, :, 3].copy()
        estimates = trajectories.launched_lines(self.path, profiles, cuts, COMPARED)
        coordinate, time, velocity, acceleration = (x[0] for x in estimates)
        joints, towards = self.rates.shape[1], 1.0 if self.away else -1.0
        # With a limit of tool speed the path has one more joint.
        variants.rates = np.empty((len(time), 2, joints))
        variants.rates[:, 0] = velocity[:, :joints] * towards
        variants.rates[:, 1] = acceleration[:, :joints]
        variants.time, variants.coordinate = time.tolist(), coordinate.tolist()
        return variants


@dataclass
class _Variants:
    """Variants of the launch of a line, each by one number."""

    line: _End
    """Line with the launch that is varied."""
    numbers: list[list[float]] = field(default_factory=list)
    """Constant, cruise, inner and cut of each variant."""
    varied: list[int] = field(default_factory=list)
    """Index of the number that is varied."""
    time: list[float] = field(default_factory=list)
    """Duration of the line [s]."""
    coordinate: list[int] = field(default_factory=list)
    """Index of the path coordinate, see `Launch`."""
    rates: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 0)))
    """Rates at the outer end in the direction of motion, shape (k, 2, n)."""

    def end(self, k: int) -> _End:
        """Build the line with a variant."""
        constant, cruise, inner, cut = self.numbers[k]
        launch = Launch(constant, cruise, inner, cut, self.coordinate[k])
        return _End(self.time[k], self.rates[k], launch, self.line.path, self.line.away)


def refined_pair(
    lines: tuple[Passings, Passings],
    pair: tuple[int, int, float],
    problem: TransferProblem,
    widths: int,
    room: float = 0.0,
) -> tuple[Launch | None, Launch | None]:
    """Refine the launches of two lines together with the transfer between them.

    A compass search over the numbers of both launches, one at a time, with decreasing steps. A line at rest stays so.

    Args:
        lines: passings of the retract and of the approach.
        pair: indices of their best launches, and the total time [s], see `quickest_pair`.
        problem: the transfer; its rates are ignored.
        widths: number of step widths.
        room: margin to position limits [rad].
    """
    if not widths:
        return lines[0].launches[pair[0]], lines[1].launches[pair[1]]
    ends = [_End.of(passings, index) for passings, index in zip(lines, pair[:2], strict=True)]
    transfer, best = MovingTransfer(problem, room), pair[2]
    for width in range(widths):
        for _ in range(ENDS.sweeps):
            moved = False
            for side in (0, 1):
                variants, k = ends[side].changed(width, ENDS.numbers), 0
                while k < len(variants.time):
                    line_time = variants.time[k] + ends[1 - side].time
                    if line_time + problem.minimum_duration < best:
                        fixed, varied = ends[1 - side].rates, variants.rates[k]
                        leaving, arriving = (fixed, varied) if side else (varied, fixed)
                        time = line_time + transfer.duration(leaving, arriving, best - line_time)
                        if time < best - ENDS.less:
                            best, ends[side], moved = time, variants.end(k), True
                            following = ENDS.numbers.index(variants.varied[k]) + 1
                            variants = ends[side].changed(width, ENDS.numbers[following:])
                            k = 0
                            continue
                    k += 1
            if not moved:
                break
    return ends[0].launch, ends[1].launch
