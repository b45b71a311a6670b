"""Joints along a seam evened out: by the definition as a full matrix, and by what must stay as it is."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.kinds.seam.path import PATH, _smoothed


@pytest.mark.parametrize("width", [0.6, 1.2, 2.0])
def test_evening_out_is_the_least_of_change_and_fourth_differences(width):
    """(I + w D'D) x = q with D the fourth differences as a full matrix, w the eighth power of the width over pi."""
    q = np.random.default_rng(1).normal(size=(60, 3))
    D = np.diff(np.eye(60), 4, axis=0)
    weight = (width * PATH.per_node / np.pi) ** 8
    expected = np.linalg.solve(np.eye(60) + weight * D.T @ D, q)
    assert _smoothed(q, width) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("width", [0.0, 0.6, 1.2, 2.0, 3.0])
def test_evening_out_keeps_cubics_up_to_both_ends(width):
    """A motion of steady jerk has no jerk more afterwards, at its ends either."""
    s = np.linspace(0.0, 1.0, 641)
    q = np.stack([s**3 - s, 2.0 * s**2, 1.0 - s], axis=-1)
    found = _smoothed(q, width)
    assert found == pytest.approx(q, abs=1e-6)
    wide = slice(None, None, 32)
    assert np.diff(found[wide], 3, axis=0) == pytest.approx(np.diff(q[wide], 3, axis=0), abs=1e-6)


def test_evening_out_takes_corners_away():
    """An acceleration of alternating sign, a node long each: far less jerk, much the same way."""
    k = np.arange(641)
    acceleration = np.where((k // PATH.per_node) % 2 == 0, 1.0, -1.0)
    q = np.cumsum(np.cumsum(acceleration))[:, None] / 640.0**2
    before, after = (np.abs(np.diff(one, 3, axis=0)).max() for one in (q, _smoothed(q, 2.0)))
    assert after < before / 20.0
    assert np.abs(_smoothed(q, 2.0) - q).max() < 1e-3
