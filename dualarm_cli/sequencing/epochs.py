"""Arms with clocks of their own on a platform that turns now and then: which tasks are done while it stands where."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.sequencing.exact import exact_order
from dualarm_cli.sequencing.problem import SequencingProblem
from dualarm_cli.sequencing.recreate import Recreator
from dualarm_cli.sequencing.stores import Stores
from dualarm_cli.sequencing.times import Timed
from dualarm_cli.sequencing.tool_stands import ToolStands

FEW = 5
"""So many tasks of one epoch are ordered exactly."""


@dataclass(frozen=True)
class Epoch:
    """What is done while the platform stands."""

    angle: int
    """Number of its angle."""
    tasks: tuple[int, ...]
    """Tasks, rising."""


@dataclass(frozen=True)
class EpochOrder:
    """An answer: epochs one after the other, with the order of each."""

    epochs: tuple[Epoch, ...]
    """In time order."""
    rows: tuple[tuple[tuple[int, ...], ...], ...]
    """By epoch and arm, the tasks in their order."""
    total: float
    """When all is done [s]; infinite where it cannot be."""
    late: float
    """By how much windows are missed, together [s]."""

    @property
    def worth(self) -> tuple[float, float]:
        """What is minimised: what is late, then the total [s]."""
        return (self.late, self.total)


@dataclass
class EpochProblem:
    """A job whose tasks are to be shared out to epochs."""

    problems: Mapping[int, SequencingProblem]
    """The whole job with the platform at each angle, by the angle's number."""
    turn: FloatArray
    """Platform times between angles [s], shape (f, f); angle 0 is where it starts."""
    seed: int
    """Of all randomness."""
    _known: dict[tuple[object, ...], Timed | None] = field(default_factory=dict)

    @property
    def sample(self) -> SequencingProblem:
        """The job at one of the angles, for what is the same at all of them."""
        return next(iter(self.problems.values()))

    @property
    def stands(self) -> tuple[ToolStands | None, ...]:
        """By arm, the tools that it changes, None for none; empty where no arm changes tools."""
        return self.sample.stands

    def evaluated(self, epochs: tuple[Epoch, ...], iterations: int) -> EpochOrder:
        """Returns epochs with the order of each, from where the one before leaves the arms.

        Args:
            epochs: what is done where.
            iterations: how often something is removed and put back in an epoch of many tasks.
        """
        starts = [np.asarray(arm.start) for arm in self.sample.arms]
        tools = [0 if one is None else one.start for one in self.stands]
        here, clock, late = 0, 0.0, 0.0
        rows: list[tuple[tuple[int, ...], ...]] = []
        for k, one in enumerate(epochs):
            last = k == len(epochs) - 1
            done = [t for before in epochs[:k] for t in before.tasks]
            problem = self.restricted(one, starts, here, clock, done, tools, last=last)
            if problem.stores is not None and not problem.stores.is_possible:
                return EpochOrder(epochs, (), np.inf, np.inf)
            key = (
                one,
                here,
                last,
                iterations,
                round(clock, 6) if problem.windows else 0.0,
                b"" if problem.stores is None else problem.stores.initial.tobytes(),
                *(start.tobytes() for start in starts),
                *tools,
            )
            if key not in self._known:
                self._known[key] = _ordered(problem, iterations, self.seed)
            found = self._known[key]
            if found is None or not np.isfinite(found.total):
                return EpochOrder(epochs, (), np.inf, np.inf)
            own = found.order.tasks(problem.ways)
            rows.append(tuple(tuple(one.tasks[k] for k in row) for row in own))
            clock += max(found.total, _idle_return(problem, found) if last else 0.0)
            late += found.late
            starts = leaving(problem, found, starts)
            tools = _tools_after(problem, found, tools)
            here = one.angle
        return EpochOrder(epochs, tuple(rows), clock, late)

    def restricted(
        self,
        epoch: Epoch,
        starts: Sequence[FloatArray],
        here: int,
        clock: float,
        done: Sequence[int] = (),
        tools: Sequence[int] = (),
        *,
        last: bool,
    ) -> SequencingProblem:
        """Returns the problem of one epoch.

        Args:
            epoch: its angle and tasks.
            starts: each arm's joints before it [rad].
            here: number of the angle at which the platform is before it.
            clock: when it begins [s].
            done: tasks that are over before it: what buffers hold then is what they have put in and taken out.
            tools: by arm the tool that is on before it; empty where no arm changes tools.
            last: whether it is the last one, after which all return where the job returns.
        """
        whole, own = self.problems[epoch.angle], list(epoch.tasks)
        number = {t: k for k, t in enumerate(own)}
        arms = tuple(
            replace(
                arm,
                entry=arm.entry[own],
                leaving=arm.leaving[own],
                first=arm.first[own],
                second=arm.second[own],
                start=start,
                home=arm.start,
            )
            for arm, start in zip(whole.arms, starts, strict=True)
        )
        back = whole.returns and last
        return SequencingProblem(
            arms,
            tuple(whole.stops[t] for t in own),
            back,
            tuple((number[a], number[b]) for a, b in whole.before if a in number and b in number),
            tuple(
                tuple(number[t] for t in row)
                for row in whole.sequences
                if all(t in number for t in row)
            ),
            np.maximum(0.0, whole.not_before[own] - clock) if whole.windows else np.zeros(0),
            whole.not_after[own] - clock if whole.windows else np.zeros(0),
            whole.in_file_order,
            (
                float(self.turn[here, epoch.angle]),
                float(self.turn[epoch.angle, 0]) if back else 0.0,
            ),
            *self._buffers(whole, own, done),
            stands=tuple(
                None if stands is None else replace(stands, tool=stands.tool[own], start=tool)
                for stands, tool in zip(whole.stands, tools, strict=True)
            ),
        )

    def _buffers(
        self, whole: SequencingProblem, own: Sequence[int], done: Sequence[int]
    ) -> tuple[Stores | None, FloatArray]:
        """Returns the buffers of some tasks after others, and how long before their ends stops' events are."""
        if whole.stores is None:
            return None, np.zeros((0, 2))
        first = np.concatenate([[0], np.cumsum(whole.stops)])
        rows, before = (
            [k for t in some for k in range(first[t], first[t + 1])] for some in (own, done)
        )
        return whole.stores.of(rows, before), whole.lasts[rows]


def leaving(
    problem: SequencingProblem, found: Timed, starts: Sequence[FloatArray]
) -> list[FloatArray]:
    """Returns where each arm is after its last task [rad]."""
    return [
        np.asarray(arm.leaving[nodes[-1] // problem.ways, nodes[-1] % problem.ways])
        if nodes
        else start
        for arm, nodes, start in zip(problem.arms, found.order.nodes, starts, strict=True)
    ]


def _tools_after(problem: SequencingProblem, found: Timed, tools: Sequence[int]) -> list[int]:
    """Returns by arm the tool that is on after its last task."""
    return (
        [
            int(stands.tool[nodes[-1] // problem.ways]) if nodes and stands is not None else tool
            for stands, nodes, tool in zip(problem.stands, found.order.nodes, tools, strict=True)
        ]
        if tools
        else []
    )


def _idle_return(problem: SequencingProblem, found: Timed) -> float:
    """Returns how long arms without a task take to where they go back to [s]."""
    if not problem.returns:
        return 0.0
    ways = [
        arm.law.duration(arm.home - arm.start)
        for arm, nodes in zip(problem.arms, found.order.nodes, strict=True)
        if not nodes and arm.home is not None
    ]
    return max(map(float, ways), default=0.0)


def _ordered(problem: SequencingProblem, iterations: int, seed: int) -> Timed | None:
    """Returns a good order of one epoch's tasks."""
    if problem.tasks <= FEW:
        return exact_order(problem)
    search = Recreator(problem, seed)
    first = search.first()
    return None if first is None else search.improve(first, iterations)
