"""The compiled function of `src/stage_annealing.c`: rounds of annealing of an order of two arms' stages."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray, SingleArray
from dualarm_cli.native import PointerStruct, library, pointer, whole

_pointer, _int64, _double = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
MOST_STAGES = 16
"""Stages that one change may replace, as in C."""


def _singles(array: NDArray[np.floating]) -> SingleArray:
    return np.ascontiguousarray(array, dtype=np.float32)


class PairedLengths(PointerStruct):
    """Lengths of stages: `Problem` in C."""

    _fields_ = (
        ("length", _pointer * 2),
        ("least", _pointer * 2),
        ("apart", _pointer),
        ("turns_back", _pointer),
        ("stops", _int64),
        ("angles", _int64),
        ("free_start", _int64),
    )

    @classmethod
    def of(
        cls,
        length: tuple[FloatArray, FloatArray],
        least: tuple[FloatArray, FloatArray],
        apart: NDArray[np.floating] | None,
        turns_back: FloatArray,
        *,
        free_start: bool,
    ) -> PairedLengths:
        """Returns the lengths, in single precision.

        Args:
            length: by arm, as `StageProblem.length` has them [s], shape (s + 1, s + 2, f, f).
            least: the least of them over both angles [s], shape (s + 1, s + 2).
            apart: as `StageProblem.apart` has it [s], shape (s + 2, s + 2, f).
            turns_back: how long the platform takes back from each angle [s], shape (f,).
            free_start: whether the platform may stand at any angle to begin with.
        """
        tables = tuple(_singles(x) for x in (*length, *least))
        back = np.ascontiguousarray(turns_back, dtype=np.float64)
        near = None if apart is None else _singles(apart)
        one, other, low, high = (pointer(x).value for x in tables)
        own = cls(
            (_pointer * 2)(one, other),
            (_pointer * 2)(low, high),
            None if near is None else pointer(near).value,
            pointer(back).value,
            len(length[0]) - 1,
            len(back),
            free_start,
        )
        own.held = (*tables, near, back)
        return own


class AnnealedTasks(PointerStruct):
    """What tasks consist of: `Tasks` in C."""

    _fields_ = (
        *(
            (name, _pointer)
            for name in ("begin", "stop", "task", "inner", "sorted", "alike", "near")
        ),
        ("tasks", _int64),
        ("nears", _int64),
        ("singles", _int64),
    )

    @classmethod
    def of(cls, tasks: Sequence[Sequence[int]], near: IntArray) -> AnnealedTasks:
        """Returns the tasks.

        Args:
            tasks: stops of each, numbered from 0 on; t of them.
            near: other tasks that are near each, shape (t, k); k is 1 or more.
        """
        sizes = np.array([len(own) for own in tasks])
        stop = np.concatenate([np.array(own, dtype=np.int64) for own in tasks])
        task, inner = np.zeros(len(stop) + 1, np.int64), np.zeros(len(stop) + 1, np.int64)
        for t, stops in enumerate(tasks):
            task[list(stops)], inner[list(stops[:-1])] = t, 1
        order = np.argsort(sizes, kind="stable")
        sides = [np.searchsorted(sizes[order], sizes, side) for side in ("left", "right")]
        held = (
            whole(np.concatenate([[0], np.cumsum(sizes)])),
            stop,
            task,
            inner,
            whole(order),
            whole(np.stack(sides, axis=1)),
            whole(near),
        )
        places = (pointer(x).value for x in held)
        own = cls(*places, len(sizes), near.shape[1], bool((sizes == 1).all()))
        own.held = held
        return own


class AnnealingShares(PointerStruct):
    """How much of what is tried: `Shares` in C."""

    _fields_ = (
        *((name, _int64) for name in ("exchanges", "changes", "moves", "widths")),
        ("width", _pointer),
        *((name, _double) for name in ("far", "idle", "alone")),
    )

    @classmethod
    def of(
        cls,
        counts: tuple[int, int, int],
        widths: Sequence[int],
        shares: tuple[float, float, float],
    ) -> AnnealingShares:
        """Returns the numbers.

        Args:
            counts: exchanges of tasks, changes within a few stages, and moves of runs of stages, in each round.
            widths: so many stages those changes are, round after round; up to MOST_STAGES.
            shares: of exchanges that are with a task that is not near, with an idle arm, and with stages of its own.
        """
        held = np.array(widths, dtype=np.int64)
        own = cls(*counts, len(held), pointer(held).value, *shares)
        own.held = (held,)
        return own


class StageLine(PointerStruct):
    """An order with a platform angle for each stage: `Line` in C. Stage 0 is the start, the last one the way back.

    All other angles stay as they are when a change is priced, so that an order is never longer than its changes say.
    """

    _fields_ = (
        *((name, _pointer) for name in ("_rows", "_came", "_next", "_angle")),
        *((name, _pointer) for name in ("_cost", "_turned", "_sum", "_turned_sum")),
        *((name, _pointer) for name in ("_halves", "_place", "_idle", "_cut", "_best_rows")),
        *((name, _int64) for name in ("count", "_idles", "_cuts", "_best_count")),
        ("best", _double),
        ("claimed", _double),
        ("_random", ctypes.c_uint64),
    )

    @classmethod
    def of(cls, lengths: PairedLengths, slots: IntArray, seed: int) -> StageLine:
        """Returns an order with the best angles for it.

        Args:
            lengths: of its stages.
            slots: the order, shape (n, 2); n is 1 or more.
            seed: of all that is drawn, of 64 bits.
        """
        stops = lengths.stops
        # There is a stop in each stage; more of them only while a task goes to others.
        room = max(len(slots), stops) + MOST_STAGES + 3
        stages = np.full((room, 2), stops, dtype=np.int64)
        stages[1 : len(slots) + 1] = slots
        pairs = [np.full((room, 2), stops, dtype=np.int64) for _ in range(2)]
        numbers = [np.zeros(room) for _ in range(4)]
        places = [np.zeros(2 * room, dtype=np.int64) for _ in range(4)]
        held = (stages, *pairs, np.zeros(room, np.int64), *numbers, *places, np.zeros_like(stages))
        own = cls(*(pointer(x).value for x in held), len(slots) + 2, 0, 0, 0, np.inf, 0.0, seed)
        own.held = (*held, np.empty((room, lengths.angles)))
        return own

    @property
    def slots(self) -> IntArray:
        """The order, shape (n, 2)."""
        found: IntArray = np.array(self.held[0][1 : self.count - 1])
        return found

    @property
    def angles(self) -> IntArray:
        """The angle at the start, and of each stage, shape (n + 1,)."""
        found: IntArray = np.array(self.held[3][: self.count - 1])
        return found

    @property
    def total(self) -> float:
        """When all is done [s]."""
        return float(self.held[6][self.count])

    @property
    def best_slots(self) -> IntArray:
        """The best order so far, of which `best` is the total [s], shape (m, 2)."""
        found: IntArray = np.array(self.held[12][1 : self._best_count - 1])
        return found


def anneal_stages(
    lengths: PairedLengths,
    tasks: AnnealedTasks,
    shares: AnnealingShares,
    line: StageLine,
    rounds: range,
    heat: tuple[float, float],
) -> None:
    """Makes some rounds of annealing, and then chooses all angles anew.

    Args:
        lengths: of stages.
        tasks: what they consist of.
        shares: how much of what is tried in each round.
        line: the order, which is changed.
        rounds: their numbers.
        heat: temperature in the first of them [s], and by which factor it changes with each.

    Raises:
        ValueError: there are more angles than the function has room for.
    """
    structures = (byref(one) for one in (lengths, tasks, shares, line))
    numbers = _int64(rounds.start), _int64(len(rounds)), *(_double(x) for x in heat)
    over = pointer(line.held[-1])
    if library().anneal_stages(*structures, *numbers, over):
        raise ValueError(f"{lengths.angles} angles")
