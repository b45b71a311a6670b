"""Values of a sampled path anywhere on it: local and global polynomials, in numpy alone."""

from __future__ import annotations

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray

STENCIL = 8
"""Neighbouring samples in the local interpolation of a path: polynomials of seventh degree."""
_NODES = np.arange(STENCIL, dtype=np.float64)
_OFFSETS = np.arange(STENCIL)


def interpolate_samples(values: FloatArray, share: FloatArray) -> FloatArray:
    """Returns a path at shares of its length, by local polynomials, shape (k, n).

    Both ends of the path come back exactly.

    Args:
        values: the path at equidistant samples, shape (m, n), m at least STENCIL.
        share: places in [0, 1], shape (k,).
    """
    last = len(values) - 1
    place = share * last
    first = place.astype(np.int64) - (STENCIL // 2 - 1)
    first = np.minimum(np.maximum(first, 0), last + 1 - STENCIL)
    basis = _products_of_others(_NODES, place - first) / _STENCIL_GAPS
    neighbours = values[first[:, None] + _OFFSETS]
    found: FloatArray = (basis[:, None, :] @ neighbours)[:, 0]
    found[share == 0.0] = values[0]
    found[share == 1.0] = values[-1]
    return found


def lagrange_basis(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Returns the Lagrange polynomials of m nodes at k places, shape (k, m).

    Each is the product of all other gaps x - node, taken from both sides so that nothing is divided by a gap: a
    place on a node is an ordinary place.
    """
    basis: FloatArray = _products_of_others(nodes, x) / _products_of_gaps(nodes)
    return basis


def _products_of_others(nodes: FloatArray, x: FloatArray) -> FloatArray:
    """Returns for each node the product of x less every other node, shape (k, m)."""
    gap = x[:, None] - nodes
    before, after = np.ones_like(gap), np.ones_like(gap)
    np.cumprod(gap[:, :-1], axis=1, out=before[:, 1:])
    np.cumprod(gap[:, :0:-1], axis=1, out=after[:, -2::-1])
    before *= after
    return before


def _products_of_gaps(nodes: FloatArray) -> FloatArray:
    """Returns for each node the product of its gaps to every other node, shape (m,)."""
    products: FloatArray = (nodes[:, None] - nodes + np.eye(len(nodes))).prod(axis=1)
    return products


def differentiation_matrix(nodes: FloatArray) -> FloatArray:
    """Returns the matrix from values at m nodes to their polynomial's derivative there, (m, m)."""
    weight = _products_of_gaps(nodes)
    D: FloatArray = weight[:, None] / (weight * (nodes[:, None] - nodes + np.eye(len(nodes))))
    np.fill_diagonal(D, 0.0)
    # A constant has no derivative.
    np.fill_diagonal(D, -D.sum(axis=1))
    return D


_STENCIL_GAPS = _products_of_gaps(_NODES)
