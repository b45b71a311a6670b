"""Polynomials through samples of a path."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.timing.shapes import differentiation_matrix, lagrange_basis


@pytest.mark.parametrize("samples", [8, 9, 65])
def test_polynomials_of_seventh_degree_come_back_exactly(line_reference, samples):
    """Eight neighbours determine a polynomial of seventh degree, at both ends of the path too."""
    polynomial = np.polynomial.Polynomial([0.3, -1, 2, 0.5, -3, 1, 4, -2])
    grid = np.linspace(0, 1, samples)
    share = np.concatenate([np.random.default_rng(1).uniform(0, 1, 200), grid])
    found = line_reference.interpolate_samples(polynomial(grid)[:, None], share)[:, 0]
    assert np.abs(found - polynomial(share)).max() < 1e-12


def test_ends_and_samples_are_kept(line_reference, lines):
    """A place on a sample is that sample; the ends to the last bit."""
    path = lines[0][0]
    found = line_reference.interpolate_samples(path, np.linspace(0, 1, 65))
    assert np.abs(found - path).max() < 1e-15
    assert np.array_equal(found[[0, -1]], path[[0, -1]])


def test_bases_sum_to_one_and_derivatives_are_those_of_polynomials():
    """The Lagrange basis is a partition of one; x³ has the derivative 3 x²."""
    nodes = np.linspace(0, 1, 7)
    x = np.linspace(-0.1, 1.1, 50)
    assert np.abs(lagrange_basis(nodes, x).sum(axis=1) - 1).max() < 1e-12
    assert np.abs(differentiation_matrix(nodes) @ nodes**3 - 3 * nodes**2).max() < 1e-12
