"""Ways between stages: a table and a list of the possible ones say the same."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dualarm_cli.orders.proof.graph import (
    SPARSE,
    DenseEdges,
    SparseEdges,
    edges_from_rows,
    sparse_edges,
)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), n=st.integers(1, 9), share=st.floats(0.0, 1.0))
def test_a_table_and_a_list_say_the_same(seed, n, share):
    rng = np.random.default_rng(seed)
    table = rng.uniform(0.1, 2.0, (n, n)).astype(np.float32)
    table[rng.random((n, n)) > share] = np.inf
    goes, came = np.nonzero(np.isfinite(table))
    mixed = rng.permutation(len(goes))
    few = sparse_edges(goes[mixed], came[mixed], table[goes, came][mixed], n, n)
    every = DenseEdges(table)
    values = rng.uniform(-1.0, 1.0, n).astype(np.float32)
    some, others = rng.permutation(n)[: max(1, n // 2)], rng.permutation(n)[: max(1, n - 1)]
    one, other = rng.integers(0, n, 12), rng.integers(0, n, 12)
    for a, b in (
        (every, few),
        (every.turned(), few.turned()),
        (every.part(some, others), few.part(some, others)),
    ):
        m = len(some) if b.count == len(some) else n
        np.testing.assert_array_equal(a.least(values[:m]), b.least(values[:m]))
        np.testing.assert_array_equal(a.rows(np.arange(m)), b.rows(np.arange(m)))
        np.testing.assert_array_equal(a.into(0), b.into(0))
    np.testing.assert_array_equal(every.one_by_one(one, other), table[other, one])
    np.testing.assert_array_equal(few.one_by_one(one, other), table[other, one])
    np.testing.assert_array_equal(every.turned().into(0), table[:, 0])
    rows = (table[k : k + 2] for k in range(0, n, 2))
    made = edges_from_rows(rows, n)
    assert isinstance(made, SparseEdges if np.isfinite(table).mean() < SPARSE else DenseEdges)
    np.testing.assert_array_equal(made.rows(np.arange(n)), table.T)
    there = np.argwhere(np.isfinite(table))[::2]
    more = rng.uniform(0.0, 1.0, len(there))
    longer = table.copy()
    longer[there[:, 0], there[:, 1]] += more
    for ways in (every, few):
        found = ways.longer(there[:, 1], there[:, 0], more).rows(np.arange(n)).T
        np.testing.assert_allclose(found, longer, rtol=1e-6)
    np.testing.assert_array_equal(every.table, table)
