"""Orders of asynchronous arms as numbers: tasks with several postures, and times between them."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.model.rest_to_rest import RestToRest
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.orders.rules.tool_stands import ToolStands
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ArmTasks:
    """What n tasks are to one arm: each in up to w ways, by the postures in which it is begun and left."""

    entry: FloatArray
    """Joints where a task begins, before its first approach [rad], shape (n, w, joints)."""
    leaving: FloatArray
    """Joints where it ends, after its last retract [rad], shape (n, w, joints)."""
    first: FloatArray
    """Time of its first stop, lines and dwell [s], infinite for a way that there is not, shape (n, w)."""
    second: FloatArray
    """Time from there to the end of its second stop, the transfer between them included [s], 0 for tasks of one stop,
    shape (n, w)."""
    start: FloatArray
    """Joints before the first task [rad], shape (joints,)."""
    law: RestToRest
    """Rest-to-rest times of the joints."""
    home: FloatArray | None = None
    """Joints to which it goes back [rad], shape (joints,); None for those before the first task."""
    free: bool = False
    """Whether it begins where its first transfer would end, and goes back there: the way there takes no time, and the
    way back counts as what it is at least, to any task."""

    def __post_init__(self) -> None:
        """Freezes the arrays."""
        for name in ("entry", "leaving", "first", "second", "start"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        if self.home is not None:
            object.__setattr__(self, "home", readonly(self.home))

    @property
    def options(self) -> int:
        """Most ways of a task."""
        return self.first.shape[1]

    @property
    def allowed(self) -> BoolArray:
        """Which tasks the arm can do in any way, shape (n,)."""
        return np.asarray(np.isfinite(self.first).any(axis=1))


@dataclass(frozen=True)
class SequencingProblem:
    """Tasks to be given to asynchronous arms and put in order, so that all is done soonest.

    Every arm begins in its start posture; the platform stands still, but for a turn before and after all.
    Nodes are ways of tasks: node t w + k is way k of task t; node n w is the arm's start.
    """

    arms: tuple[ArmTasks, ...]
    """One or two arms."""
    stops: tuple[int, ...]
    """How many stops each task has, 1 or 2."""
    returns: bool
    """Whether every arm goes back to its start, or to its home."""
    before: tuple[tuple[int, int], ...] = ()
    """Pairs of tasks of which the first is over before the second begins."""
    sequences: tuple[tuple[int, ...], ...] = ()
    """Tasks that one arm does one right after the other."""
    not_before: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Earliest instant at which a task's first stop may end its approach [s], shape (n,); empty for none."""
    not_after: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Latest instant at which a task may be over [s], shape (n,); empty for none."""
    in_file_order: bool = False
    """Whether each arm does its tasks in the order of their numbers."""
    turn: tuple[float, float] = (0.0, 0.0)
    """How long the platform turns before the first stop and after the last one [s]."""
    stores: Stores | None = None
    """Buffers for parts between stops; None without any. Stops are those of all tasks, one after the other."""
    lasts: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """How long before a stop is over its tool is at the target, and its dwell is over [s], shape (s, 2); empty without
    buffers."""
    stands: tuple[ToolStands | None, ...] = ()
    """By arm, the tools that it changes between its tasks, None for an arm that changes none; empty for no arm."""

    @property
    def tasks(self) -> int:
        """How many."""
        return len(self.stops)

    @property
    def options(self) -> int:
        """Most ways of a task."""
        return self.arms[0].options

    @property
    def start_node(self) -> int:
        """Number of the node that is an arm's start."""
        return self.tasks * self.options

    @cached_property
    def windows(self) -> bool:
        """Whether any task has a window."""
        return bool((self.not_before > 0.0).any() or np.isfinite(self.not_after).any())

    @cached_property
    def coupled(self) -> bool:
        """Whether arms depend on one another or on the time."""
        return bool(self.before) or self.windows or self.stores is not None

    @cached_property
    def between(self) -> tuple[FloatArray, ...]:
        """Times of transfers by arm [s], from where a node is left to where another is begun, shape (n w + 1, n w + 1).

        From the start no sooner than the platform is there; to the start 0 where there is no return. Where another tool
        is asked for, the whole change is part of it.
        """
        stands = self.stands or (None,) * len(self.arms)
        return tuple(self._between(*both) for both in zip(self.arms, stands, strict=True))

    @cached_property
    def length(self) -> tuple[FloatArray, ...]:
        """Times of the nodes themselves by arm [s], infinite for what there is not, shape (n w + 1,)."""
        return tuple(
            np.append((arm.first + arm.second).ravel(), 0.0).astype(np.float64) for arm in self.arms
        )

    def _between(self, arm: ArmTasks, stands: ToolStands | None) -> FloatArray:
        joints = len(arm.start)
        leaving = np.concatenate([arm.leaving.reshape(-1, joints), arm.start[None]])
        back = arm.start if arm.home is None else arm.home
        entry = np.concatenate([arm.entry.reshape(-1, joints), back[None]])
        n = len(entry)
        found = np.empty((n, n))
        rows = max(1, 2_000_000 // n)  # pairs of postures at once
        for k in range(0, n, rows):
            found[k : k + rows] = arm.law.duration(entry[None] - leaving[k : k + rows, None])
        found = np.where(np.isnan(found), np.inf, found)
        if arm.free:
            found[:-1, -1] = found[:-1].min(axis=1)
            found[-1, np.isfinite(found[-1])] = 0.0
        found[-1, :-1] = np.maximum(found[-1, :-1], self.turn[0])
        found[:-1, -1] = np.maximum(found[:-1, -1], self.turn[1]) if self.returns else 0.0
        found[-1, -1] = 0.0
        if stands is None:
            return found
        return stands.between_with_changes(
            found, entry, leaving, arm.law.duration, self.turn, returns=self.returns
        )


@dataclass(frozen=True)
class Order:
    """An answer: each arm's nodes one after the other."""

    nodes: tuple[tuple[int, ...], ...]
    """By arm, in the problem's order."""

    def tasks(self, ways: int) -> tuple[tuple[int, ...], ...]:
        """Returns each arm's tasks."""
        return tuple(tuple(node // ways for node in own) for own in self.nodes)
