"""How long a stage takes right after another one: a table, or only what is possible where that is little."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from dualarm_cli.geometry.arrays import BoolArray, FloatArray, IntArray, SingleArray

SPARSE = 0.25
"""Where fewer of all ways are possible only those are kept."""


class Ways(Protocol):
    """Lengths of ways [s] from m nodes to n nodes, infinite where there is none; in single precision."""

    def least(self, values: SingleArray) -> SingleArray:
        """Returns the least of length and a value of the node that is come from, (m,), by node gone to, (n,)."""
        ...

    def rows(self, came: IntArray) -> SingleArray:
        """Returns the lengths from some nodes, shape (k, n)."""
        ...

    def into(self, node: int) -> SingleArray:
        """Returns the lengths to one node, shape (m,)."""
        ...

    def one_by_one(self, came: IntArray, goes: IntArray) -> SingleArray:
        """Returns the lengths from nodes to nodes, pair by pair, shape (k,)."""
        ...

    def part(self, came: IntArray, goes: IntArray) -> Ways:
        """Returns the ways from some nodes to some others."""
        ...

    def turned(self) -> Ways:
        """Returns the same ways backwards."""
        ...

    def longer(self, came: IntArray, goes: IntArray, more: FloatArray) -> Ways:
        """Returns ways of which some, all of them there, take longer [s], pair by pair; no pair is named twice."""
        ...


@dataclass(frozen=True)
class AllWays:
    """Every way."""

    table: SingleArray
    """By node gone to and node come from, so that `least` goes through memory in its order, shape (n, m)."""

    def least(self, values: SingleArray) -> SingleArray:
        """See `Ways`."""
        return np.asarray((self.table + values).min(axis=1))

    def rows(self, came: IntArray) -> SingleArray:
        """See `Ways`."""
        return np.asarray(self.table[:, came].T)

    def into(self, node: int) -> SingleArray:
        """See `Ways`."""
        return np.asarray(self.table[node])

    def one_by_one(self, came: IntArray, goes: IntArray) -> SingleArray:
        """See `Ways`."""
        return np.asarray(self.table[goes, came])

    def part(self, came: IntArray, goes: IntArray) -> AllWays:
        """See `Ways`."""
        return AllWays(np.ascontiguousarray(self.table[goes][:, came]))

    def turned(self) -> AllWays:
        """See `Ways`."""
        return AllWays(np.ascontiguousarray(self.table.T))

    def longer(self, came: IntArray, goes: IntArray, more: FloatArray) -> AllWays:
        """See `Ways`."""
        table = self.table.copy()
        table[goes, came] += more
        return AllWays(table)


@dataclass(frozen=True)
class FewWays:
    """Only the ways that there are, by node gone to."""

    begin: IntArray
    """Where the ways to each node begin, and where all end, shape (n + 1,)."""
    came: IntArray
    """The node that each comes from, shape (ways,)."""
    length: SingleArray
    """Its length [s], shape (ways,)."""
    count: int
    """How many nodes there are to come from."""

    def least(self, values: SingleArray) -> SingleArray:
        """See `Ways`."""
        found = np.full(len(self.begin) - 1, np.inf, dtype=np.float32)
        some = np.flatnonzero(np.diff(self.begin))
        if len(some):
            whole = self.length + values[self.came]
            found[some] = np.minimum.reduceat(whole, self.begin[some])
        return found

    def rows(self, came: IntArray) -> SingleArray:
        """See `Ways`."""
        found = np.full((len(came), len(self.begin) - 1), np.inf, dtype=np.float32)
        row = np.full(self.count, -1)
        row[came] = np.arange(len(came))
        own = row[self.came]
        there = own >= 0
        found[own[there], self._goes[there]] = self.length[there]
        return found

    def into(self, node: int) -> SingleArray:
        """See `Ways`."""
        found = np.full(self.count, np.inf, dtype=np.float32)
        own = slice(self.begin[node], self.begin[node + 1])
        found[self.came[own]] = self.length[own]
        return found

    def one_by_one(self, came: IntArray, goes: IntArray) -> SingleArray:
        """See `Ways`."""
        found = np.full(len(goes), np.inf, dtype=np.float32)
        at, there = self._at(came, goes)
        found[there] = self.length[at[there]]
        return found

    def part(self, came: IntArray, goes: IntArray) -> FewWays:
        """See `Ways`."""
        number, place = np.full(self.count, -1), np.full(len(self.begin) - 1, -1)
        number[came], place[goes] = np.arange(len(came)), np.arange(len(goes))
        own = place[self._goes]
        kept = (own >= 0) & (number[self.came] >= 0)
        return few_ways(own[kept], number[self.came[kept]], self.length[kept], len(goes), len(came))

    def turned(self) -> FewWays:
        """See `Ways`."""
        return few_ways(self.came, self._goes, self.length, self.count, len(self.begin) - 1)

    def longer(self, came: IntArray, goes: IntArray, more: FloatArray) -> FewWays:
        """See `Ways`."""
        length = self.length.copy()
        at, there = self._at(came, goes)
        length[at[there]] += more[there]
        return replace(self, length=length)

    def _at(self, came: IntArray, goes: IntArray) -> tuple[IntArray, BoolArray]:
        """Returns where pairs are among the ways, and whether they are."""
        wanted = goes * self.count + came
        at = np.searchsorted(self._key, wanted)
        there = at < len(self._key)
        there[there] = self._key[at[there]] == wanted[there]
        return at, there

    @cached_property
    def _goes(self) -> IntArray:
        return np.repeat(np.arange(len(self.begin) - 1), np.diff(self.begin))

    @cached_property
    def _key(self) -> IntArray:
        # Ways are sorted by node gone to, then by node come from.
        return self._goes * self.count + self.came


def few_ways(goes: IntArray, came: IntArray, length: SingleArray, n: int, m: int) -> FewWays:
    """Returns ways that are in any order, shape (ways,) each, to n nodes from m nodes."""
    order = np.lexsort((came, goes))
    begin = np.concatenate([[0], np.cumsum(np.bincount(goes, minlength=n))])
    return FewWays(begin, came[order], length[order], m)


def ways_of(rows: Iterator[SingleArray], nodes: int) -> Ways:
    """Returns ways given by the nodes they go to, some rows (k, m) at a time, for as many nodes in all."""
    none = np.zeros(0, dtype=np.int64)
    goes, came, length, done = [none], [none], [np.zeros(0, dtype=np.float32)], 0
    for some in rows:
        there = np.isfinite(some)
        u, v = np.nonzero(there)
        goes.append(u + done)
        came.append(v)
        length.append(some[there].astype(np.float32))
        done += len(some)
    where, whence, lasts = np.concatenate(goes), np.concatenate(came), np.concatenate(length)
    if len(where) < SPARSE * nodes * nodes:
        return few_ways(where, whence, lasts, nodes, nodes)
    table = np.full((nodes, nodes), np.inf, dtype=np.float32)
    table[where, whence] = lasts
    return AllWays(table)
