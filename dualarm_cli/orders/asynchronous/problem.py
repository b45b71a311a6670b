"""Orders of asynchronous arms as numbers: tasks with several postures, and times between them."""

from __future__ import annotations

from dataclasses import field
from functools import cached_property

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, readonly
from dualarm_cli.model.motion.rest_to_rest import RestToRest
from dualarm_cli.orders.rules.stores import Stores
from dualarm_cli.orders.rules.tool_stands import ToolStands
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ArmTasks:
    """n tasks as one arm can do them, each with up to w options.

    An option is a pair of postures in which the task is begun and left.
    """

    entry: FloatArray
    """Joints where a task begins, before its first approach [rad], shape (n, w, joints)."""
    leaving: FloatArray
    """Joints where it ends, after its last retract [rad], shape (n, w, joints)."""
    first: FloatArray
    """Time of first stop, lines and dwell [s], shape (n, w).

    Infinite for an option that does not exist.
    """
    second: FloatArray
    """Time between the ends of both stops [s], shape (n, w).

    It includes the transfer between them; 0 for tasks of a single stop.
    """
    start: FloatArray
    """Joints before the first task [rad], shape (joints,)."""
    law: RestToRest
    """Rest-to-rest times of the joints."""
    home: FloatArray | None = None
    """Joints to return to [rad], shape (joints,); None for `start`."""
    free: bool = False
    """Whether the arm may start anywhere.

    It then begins where its first transfer would end and returns there: the first transfer takes no time, and the
    return counts as the shortest transfer to any task.
    """

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        for name in ("entry", "leaving", "first", "second", "start"):
            object.__setattr__(self, name, readonly(getattr(self, name)))
        if self.home is not None:
            object.__setattr__(self, "home", readonly(self.home))

    @property
    def options(self) -> int:
        """Maximum number of options of a task."""
        return self.first.shape[1]

    @property
    def allowed(self) -> BoolArray:
        """Tasks that the arm can do, shape (n,)."""
        return np.asarray(np.isfinite(self.first).any(axis=1))


@dataclass(frozen=True)
class SequencingProblem:
    """Assignment and sequencing of tasks for asynchronous arms, with the least makespan.

    Every arm begins in its start posture. The platform stands still, except for one turn before and one after all
    tasks. Nodes are options of tasks: node t w + k is option k of task t; node n w is the arm's start.
    """

    arms: tuple[ArmTasks, ...]
    """Tasks of the one or two arms."""
    stops: tuple[int, ...]
    """Number of stops of each task, 1 or 2."""
    returns: bool
    """Whether every arm returns to its start, or to its home."""
    before: tuple[tuple[int, int], ...] = ()
    """Precedence: pairs of tasks, the first finished before the second begins."""
    sequences: tuple[tuple[int, ...], ...] = ()
    """Tasks that one arm does directly one after the other."""
    not_before: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Earliest ends of tasks' first approaches [s], shape (n,); empty for none."""
    not_after: FloatArray = field(default_factory=lambda: np.zeros(0))
    """Latest instant at which a task may end [s], shape (n,); empty for none."""
    in_file_order: bool = False
    """Whether each arm does its tasks in the order of their numbers."""
    turn: tuple[float, float] = (0.0, 0.0)
    """Durations of the platform's turns before the first, after the last stop [s]."""
    stores: Stores | None = None
    """Buffers for parts between stops, or None; stops are numbered task by task."""
    lasts: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """Times before each stop's end [s], shape (s, 2).

    They are those of the arrival at the target and of the dwell's end; empty without buffers.
    """
    stands: tuple[ToolStands | None, ...] = ()
    """Tools that each arm changes between its tasks.

    None for an arm without tool changes, empty if no arm has any.
    """

    @property
    def tasks(self) -> int:
        """Number of tasks."""
        return len(self.stops)

    @property
    def options(self) -> int:
        """Maximum number of options of a task."""
        return self.arms[0].options

    @property
    def start_node(self) -> int:
        """Number of the start node of an arm."""
        return self.tasks * self.options

    @cached_property
    def windows(self) -> bool:
        """Whether any task has a window."""
        return bool((self.not_before > 0.0).any() or np.isfinite(self.not_after).any())

    @cached_property
    def coupled(self) -> bool:
        """Whether arms depend on each other or on time."""
        return bool(self.before) or self.windows or self.stores is not None

    @cached_property
    def between(self) -> tuple[FloatArray, ...]:
        """Transfer times by arm between nodes [s], square of size n w + 1.

        From the start no arm arrives before the platform; to the start it takes 0 without a return. If the next task
        requires another tool, the time includes the tool change.
        """
        stands = self.stands or (None,) * len(self.arms)
        return tuple(self._between(*both) for both in zip(self.arms, stands, strict=True))

    @cached_property
    def length(self) -> tuple[FloatArray, ...]:
        """Times of the nodes by arm [s], shape (n w + 1,).

        Infinite without an option.
        """
        return tuple(
            np.append((arm.first + arm.second).ravel(), 0.0).astype(np.float64) for arm in self.arms
        )

    def _between(self, arm: ArmTasks, stands: ToolStands | None) -> FloatArray:
        joints = len(arm.start)
        leaving = np.concatenate([arm.leaving.reshape(-1, joints), arm.start[None]])
        back = arm.start if arm.home is None else arm.home
        entry = np.concatenate([arm.entry.reshape(-1, joints), back[None]])
        n = len(entry)
        times = np.empty((n, n))
        rows = max(1, 2_000_000 // n)  # pairs of postures at once
        for k in range(0, n, rows):
            times[k : k + rows] = arm.law.duration(entry[None] - leaving[k : k + rows, None])
        times = np.where(np.isnan(times), np.inf, times)
        if arm.free:
            times[:-1, -1] = times[:-1].min(axis=1)
            times[-1, np.isfinite(times[-1])] = 0.0
        times[-1, :-1] = np.maximum(times[-1, :-1], self.turn[0])
        times[:-1, -1] = np.maximum(times[:-1, -1], self.turn[1]) if self.returns else 0.0
        times[-1, -1] = 0.0
        if stands is None:
            return times
        return stands.between_with_changes(
            times, entry, leaving, arm.law.duration, self.turn, returns=self.returns
        )


@dataclass(frozen=True)
class Order:
    """Nodes of each arm in their order."""

    nodes: tuple[tuple[int, ...], ...]
    """Nodes of each arm, numbered as in the problem."""

    def tasks(self, options: int) -> tuple[tuple[int, ...], ...]:
        """Look up each arm's tasks."""
        return tuple(tuple(node // options for node in nodes) for nodes in self.nodes)
