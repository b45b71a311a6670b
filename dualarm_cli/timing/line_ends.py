"""Pairs of lines whose outer ends are passed in motion, and the transfer between them.

A line away from a target, the transfer after it and the line to the next target take R + X + A. Each line has a family
of ways to pass its outer end (`timing/launch`), which fix the state of motion there; the transfer between two such
states is ruckig's. The pair of ways with the least R + X + A is found by a pattern search over both families. Our own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from dualarm_cli.compiled import trajectories
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.geometry.elementary import power
from dualarm_cli.records import dataclass
from dualarm_cli.timing.launch import COMPARED, CUTS, PROFILES, Launch, launches
from dualarm_cli.timing.line_profile import path_of
from dualarm_cli.timing.problem import LineProblem, TransferProblem
from dualarm_cli.timing.ruckig_ import MovingTransfer


@dataclass(frozen=True)
class LineEndSettings:
    """Resolution of the search for speeds at line ends."""

    middle: tuple[int, int] = 2, 5
    """A profile and a cut, as indices, that are quick under jerk limits."""
    even: tuple[int, int] = 8, 5
    """A profile and a cut, as indices, that are quick without jerk limits."""
    late: tuple[tuple[int, int], ...] = (0, 9), (8, 9)
    """Profiles and cuts, as indices, that leave a line slowly, for nearby position limits.

    The first pair is for jerk limits, the second one for none.
    """
    steps: tuple[tuple[int, int], ...] = (2, 4), (1, 2), (1, 1)
    """Steps of that search through PROFILES and CUTS, one width after the other."""
    less: float = 1e-9
    """Smallest difference that makes a time count as shorter [s]."""
    widest: tuple[float, ...] = 0.3, 0.3, 0.2, 0.03
    """First steps by which the numbers of a way are changed: constant, cruise, inner and cut; the next ones
    are halves."""
    numbers: tuple[int, ...] = 3, 0, 1, 2
    """The order in which they are changed: that which matters most first."""
    sweeps: int = 3
    """So often all numbers are changed by one width of steps, at most."""


ENDS = LineEndSettings()

REST = 0, len(CUTS)
"""What stands for rest: the last cut, after the whole profile."""
STARTS = tuple(
    pair
    for quick, slow in zip((ENDS.middle, ENDS.even), ENDS.late, strict=True)
    for pair in ((quick, quick), (slow, slow), (quick, REST), (REST, quick))
)
"""Pairs from whose best one the search for a pair begins, if rest at both lines is not better."""
RANGES = (0.0, 40.0, 1.0), (0.0, 40.0, 1.0), (0.2, 1.5, 0.0), (0.1, 0.98, 0.0)
"""Least and most of each number, and whether its steps grow with it."""


@dataclass(frozen=True)
class Passings:
    """One line: how long it takes and in which state its outer end is passed; the first is at rest."""

    ways: tuple[Launch | None, ...]
    """What each way is."""
    time: FloatArray
    """How long the line takes [s], shape (g,)."""
    rates: FloatArray
    """Velocities and accelerations at the outer end, in the direction of motion, shape (g, 2, n)."""
    line: LineProblem | None = None
    """The line, from its target outwards; None for no line."""
    away: bool = True
    """Whether the tool leaves the target on it; else it comes to it."""

    def index(self, profile: int, cut: int) -> int:
        """Returns the way with one of the PROFILES and CUTS; with a cut beyond them, or without a line, rest."""
        return 0 if cut >= len(CUTS) or len(self.ways) == 1 else 1 + profile * len(CUTS) + cut

    @classmethod
    def none(cls, joints: int) -> Passings:
        """Returns those of no line: rest."""
        return cls((None,), np.zeros(1), np.zeros((1, 2, joints)))

    @classmethod
    def only(cls, rates: FloatArray) -> Passings:
        """Returns those of a target that is passed in one state, shape (2, n)."""
        return cls((None,), np.zeros(1), rates[None])

    @classmethod
    def along(cls, problem: LineProblem, rest: float, *, away: bool) -> Passings:
        """Returns those of a line that is given from its target outwards.

        Args:
            problem: the line.
            rest: how long it takes from rest to rest [s].
            away: whether the tool leaves the target on it; else it comes to it.
        """
        found = launches(problem)
        velocity = found.velocity if away else -found.velocity
        rates = np.stack([velocity, found.acceleration], axis=1)
        return cls(
            (None, *found.ways),
            np.append(rest, found.time),
            np.concatenate([np.zeros((1, *rates.shape[1:])), rates]),
            problem,
            away,
        )


Place = tuple[int, int]
"""A profile and a cut, as indices."""


def quickest_pair(
    before: Passings, after: Passings, problem: TransferProblem, rest: float, room: float = 0.0
) -> tuple[int, int, float]:
    """Returns which ways of two lines go best with the transfer between them, and how long all three take [s].

    A pattern search: from the best of a few pairs to a better neighbour, profile and cut of one line or the cuts of
    both changed, until there is none. Never slower than from rest to rest; no optimality is claimed.

    Args:
        before: of the retract.
        after: of the approach.
        problem: the transfer; its rates do not count.
        rest: how long it takes from rest to rest [s].
        room: what it keeps free of limits of position [rad].
    """
    transfer, platform = MovingTransfer(problem, room), problem.minimum_duration
    times = before.time.tolist(), after.time.tolist()
    least = {(0, 0): times[0][0] + rest + times[1][0]}

    def time(pair: tuple[Place, Place], most: float) -> float:
        i, j = before.index(*pair[0]), after.index(*pair[1])
        if (i, j) not in least:
            lines = times[0][i] + times[1][j]
            if lines + platform >= most:
                return np.inf
            # What takes longer than the best pair known is not looked at again: that one only becomes better.
            least[i, j] = lines + transfer.duration(before.rates[i], after.rates[j], most - lines)
        return least[i, j]

    best, pair = least[0, 0], (REST, REST)
    for start in STARTS:
        if (found := time(start, best)) < best:
            best, pair = found, start
    for width in ENDS.steps:
        moved = True
        while moved:
            moved = False
            for one, other in _moves(*width):
                tried = _moved(pair[0], one), _moved(pair[1], other)
                if (found := time(tried, best)) < best - ENDS.less:
                    best, pair, moved = found, tried, True
    return before.index(*pair[0]), after.index(*pair[1]), best


@cache
def _moves(profiles: int, cuts: int) -> tuple[tuple[Place, Place], ...]:
    """Returns the changes of a pair that are tried, for steps through profiles and cuts."""
    still, ways = (0, 0), (-1, 1)
    single = [(0, k * cuts) for k in ways]
    both = [(p * profiles, k * cuts) for k in (0, *ways) for p in ways]
    return (
        *((one, still) for one in single),
        *((still, one) for one in single),
        *((one, other) for one in single for other in single),
        *((one, still) for one in both),
        *((still, one) for one in both),
    )


@cache
def _moved(place: Place, by: Place) -> Place:
    profile, cut = place[0] + by[0], place[1] + by[1]
    return min(max(profile, 0), len(PROFILES) - 1), min(max(cut, 0), len(CUTS))


@dataclass(frozen=True)
class _End:
    """One line, passed in some way that is changed."""

    time: float
    """How long it takes [s]."""
    rates: FloatArray
    """Velocities and accelerations at its outer end, in the direction of motion, shape (2, n)."""
    way: Launch | None
    """How its outer end is passed; None: at rest, which is not changed."""
    path: trajectories.Path | None = None
    """The line."""
    away: bool = True
    """Whether the tool leaves the target on it."""

    @classmethod
    def of(cls, lines: Passings, way: int) -> _End:
        """Returns a line passed in one of its ways."""
        launch, line, time, rates = lines.ways[way], lines.line, lines.time[way], lines.rates[way]
        if launch is None or line is None:
            return cls(float(time), rates, None)
        return cls(float(time), rates, launch, path_of(line), lines.away)

    def changed(self, halved: int, wanted: Sequence[int]) -> list[tuple[int, _End]]:
        """Returns the line with one of its way's numbers changed, each both up and down, with that number's index.

        Args:
            halved: how often the widest steps are halved.
            wanted: which numbers.
        """
        if self.way is None or self.path is None:
            return []
        own = [self.way.constant, self.way.cruise, self.way.inner, self.way.cut]
        numbers, which = [], []
        for number in wanted:
            least, most, relative = RANGES[number]
            step = ENDS.widest[number] * power(0.5, halved) * (1.0 + relative * own[number])
            for value in (own[number] + step, own[number] - step):
                if (value := min(max(value, least), most)) != own[number]:
                    numbers.append([*own[:number], value, *own[number + 1 :]])
                    which.append(number)
        if not numbers:
            return []
        asked = np.array(numbers)
        profiles, cuts = np.ascontiguousarray(asked[None, :, :3]), asked[None, :, 3].copy()
        estimates = trajectories.launched_lines(self.path, profiles, cuts, COMPARED)
        coordinate, time, velocity, acceleration = (x[0] for x in estimates)
        joints, towards = self.rates.shape[1], 1.0 if self.away else -1.0
        # A cap on the tool's speed is one more joint of the path.
        rates = np.stack([velocity[:, :joints] * towards, acceleration[:, :joints]], axis=1)
        found = []
        for k, (constant, cruise, inner, cut) in enumerate(numbers):
            way = Launch(constant, cruise, inner, cut, int(coordinate[k]))
            found.append(replace(self, time=float(time[k]), rates=rates[k], way=way))
        return list(zip(which, found, strict=True))


def refined_pair(
    lines: tuple[Passings, Passings],
    pair: tuple[int, int, float],
    problem: TransferProblem,
    widths: int,
    room: float = 0.0,
) -> tuple[Launch | None, Launch | None]:
    """Returns ways of two lines that go better with the transfer between them than a pair of their families does.

    A compass search over the numbers of both ways, one at a time, with ever smaller steps. What is at rest stays so.

    Args:
        lines: of the retract and of the approach.
        pair: the best of their ways, and how long all take with them [s], see `quickest_pair`.
        problem: the transfer; its rates do not count.
        widths: how many widths of steps are tried.
        room: what it keeps free of limits of position [rad].
    """
    if not widths:
        return lines[0].ways[pair[0]], lines[1].ways[pair[1]]
    ends = [_End.of(one, way) for one, way in zip(lines, pair[:2], strict=True)]
    transfer, best = MovingTransfer(problem, room), pair[2]
    for width in range(widths):
        for _ in range(ENDS.sweeps):
            moved = False
            for side in (0, 1):
                left = ends[side].changed(width, ENDS.numbers)
                while left:
                    number, one = left.pop(0)
                    tried = [one, ends[1]] if side == 0 else [ends[0], one]
                    spent = tried[0].time + tried[1].time
                    if spent + problem.minimum_duration >= best:
                        continue
                    time = spent + transfer.duration(tried[0].rates, tried[1].rates, best - spent)
                    if time < best - ENDS.less:
                        best, ends, moved = time, tried, True
                        left = one.changed(width, ENDS.numbers[ENDS.numbers.index(number) + 1 :])
            if not moved:
                break
    return ends[0].way, ends[1].way
