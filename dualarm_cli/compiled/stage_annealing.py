"""Binding of `src/stage_annealing.c`: simulated annealing of the order of two arms' stages."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from ctypes import byref

import numpy as np
from numpy.typing import NDArray

from dualarm_cli.geometry.arrays import FloatArray, IntArray, SingleArray
from dualarm_cli.native import PointerStruct, library, pointer, whole

_pointer, _int64, _double = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
MAX_STAGES = 16
"""Maximum number of stages that a change replaces, as in C."""


def _singles(array: NDArray[np.floating]) -> SingleArray:
    return np.ascontiguousarray(array, dtype=np.float32)


class PairedStageTimes(PointerStruct):
    """Times of stages of two arms: `Problem` in C."""

    _fields_ = (
        ("length", _pointer * 2),
        ("least", _pointer * 2),
        ("pair_cost", _pointer),
        ("platform_return", _pointer),
        ("stops", _int64),
        ("angles", _int64),
        ("free_start", _int64),
    )

    @classmethod
    def of(
        cls,
        length: tuple[FloatArray, FloatArray],
        least: tuple[FloatArray, FloatArray],
        pair_cost: NDArray[np.floating] | None,
        platform_return: FloatArray,
        *,
        free_start: bool,
    ) -> PairedStageTimes:
        """Convert the times to single precision.

        Args:
            length: times of each arm, as in `StageProblem.length` [s], shape (s + 1, s + 2, f, f).
            least: their minima over both angles [s], shape (s + 1, s + 2).
            pair_cost: costs of simultaneous stops, as in `StageProblem.pair_cost` [s], shape (s + 2, s + 2, f).
            platform_return: times of the platform back from each angle [s], shape (f,).
            free_start: whether the platform may start at any angle.
        """
        tables = tuple(_singles(x) for x in (*length, *least))
        back = np.ascontiguousarray(platform_return, dtype=np.float64)
        cost = None if pair_cost is None else _singles(pair_cost)
        first, second, least_first, least_second = (pointer(x).value for x in tables)
        times = cls(
            (_pointer * 2)(first, second),
            (_pointer * 2)(least_first, least_second),
            None if cost is None else pointer(cost).value,
            pointer(back).value,
            len(length[0]) - 1,
            len(back),
            free_start,
        )
        times.held = (*tables, cost, back)
        return times


class AnnealedTasks(PointerStruct):
    """Tasks and their stops: `Tasks` in C."""

    _fields_ = (
        *(
            (name, _pointer)
            for name in ("begin", "stop", "task", "inner", "sorted", "same_size", "neighbours")
        ),
        ("tasks", _int64),
        ("neighbour_count", _int64),
        ("singles", _int64),
    )

    @classmethod
    def of(cls, tasks: Sequence[Sequence[int]], neighbours: IntArray) -> AnnealedTasks:
        """Build the structure of t tasks.

        Args:
            tasks: stops of each task, numbered from 0 on.
            neighbours: other tasks near each task, shape (t, k), k at least 1.
        """
        sizes = np.array([len(stops) for stops in tasks])
        stop = np.concatenate([np.array(stops, dtype=np.int64) for stops in tasks])
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
            whole(neighbours),
        )
        addresses = (pointer(x).value for x in held)
        structure = cls(*addresses, len(sizes), neighbours.shape[1], bool((sizes == 1).all()))
        structure.held = held
        return structure


class AnnealingSettings(PointerStruct):
    """Settings of the annealing: `Settings` in C."""

    _fields_ = (
        *((name, _int64) for name in ("exchanges", "permutations", "moves", "widths")),
        ("width", _pointer),
        *((name, _double) for name in ("far", "idle", "alone")),
    )

    @classmethod
    def of(
        cls,
        counts: tuple[int, int, int],
        widths: Sequence[int],
        fractions: tuple[float, float, float],
    ) -> AnnealingSettings:
        """Build the settings.

        Args:
            counts: exchanges of tasks, permutations of stops, and moves of runs of stages per round.
            widths: stages of a permutation, taken in turn by the rounds, up to MAX_STAGES.
            fractions: fractions of exchanges with a distant task, with an idle arm, and with new stages.
        """
        held = np.array(widths, dtype=np.int64)
        settings = cls(*counts, len(held), pointer(held).value, *fractions)
        settings.held = (held,)
        return settings


class AnnealedOrder(PointerStruct):
    """Order of stages with platform angles: `Order` in C.

    Stage 0 is the start, the last one the return. A change is evaluated with all other angles fixed, so the total time
    is never longer than the sum of the predicted changes.
    """

    _fields_ = (
        *((name, _pointer) for name in ("_stops", "_previous", "_next", "_angle")),
        *((name, _pointer) for name in ("_cost", "_reversed", "_sum", "_reversed_sum")),
        *((name, _pointer) for name in ("_idle_sum", "_place", "_idle", "_cut", "_best_stops")),
        *((name, _int64) for name in ("count", "_idle_count", "_cut_count", "_best_count")),
        ("best", _double),
        ("predicted", _double),
        ("_random", ctypes.c_uint64),
    )

    @classmethod
    def of(cls, times: PairedStageTimes, slots: IntArray, seed: int) -> AnnealedOrder:
        """Build an order, at platform angle 0 throughout.

        Args:
            times: times of its stages.
            slots: stops of both arms by stage, shape (n, 2), n at least 1.
            seed: 64-bit seed of the random numbers.
        """
        stops = times.stops
        # There is a stop in each stage, and there are more stages only while a change is applied.
        capacity = max(len(slots), stops) + MAX_STAGES + 3
        stages = np.full((capacity, 2), stops, dtype=np.int64)
        stages[1 : len(slots) + 1] = slots
        pairs = [np.full((capacity, 2), stops, dtype=np.int64) for _ in range(2)]
        numbers = [np.zeros(capacity) for _ in range(4)]
        places = [np.zeros(2 * capacity, dtype=np.int64) for _ in range(4)]
        held = (
            stages,
            *pairs,
            np.zeros(capacity, np.int64),
            *numbers,
            *places,
            np.zeros_like(stages),
        )
        order = cls(*(pointer(x).value for x in held), len(slots) + 2, 0, 0, 0, np.inf, 0.0, seed)
        order.held = (*held, np.empty((capacity, times.angles)))
        return order

    @property
    def slots(self) -> IntArray:
        """Stops of both arms by stage, shape (n, 2)."""
        slots: IntArray = np.array(self.held[0][1 : self.count - 1])
        return slots

    @property
    def angles(self) -> IntArray:
        """Angle indices at the start and of each stage, shape (n + 1,)."""
        angles: IntArray = np.array(self.held[3][: self.count - 1])
        return angles

    @property
    def total(self) -> float:
        """Total time [s]."""
        return float(self.held[6][self.count])

    @property
    def best_slots(self) -> IntArray:
        """Stops of the best order so far, with total time `best`, shape (m, 2)."""
        slots: IntArray = np.array(self.held[12][1 : self._best_count - 1])
        return slots


def anneal_stages(
    times: PairedStageTimes,
    tasks: AnnealedTasks,
    settings: AnnealingSettings,
    order: AnnealedOrder,
    rounds: range,
    cooling: tuple[float, float],
) -> None:
    """Anneal an order for some rounds, then choose all its angles again.

    Args:
        times: times of the stages.
        tasks: tasks and their stops.
        settings: settings of the annealing.
        order: the order, which is changed.
        rounds: indices of the rounds.
        cooling: temperature of the first round [s], and the factor from round to round.

    Raises:
        ValueError: more angles than the compiled function supports.
    """
    structures = (byref(x) for x in (times, tasks, settings, order))
    numbers = _int64(rounds.start), _int64(len(rounds)), *(_double(x) for x in cooling)
    buffer = pointer(order.held[-1])
    if library().anneal_stages(*structures, *numbers, buffer):
        raise ValueError(f"{times.angles} angles")
