"""Measuring how far seven axes are from spherical-revolute-spherical."""

from __future__ import annotations

import numpy as np
import pytest

from dualarm_cli.errors import UnsupportedError
from dualarm_cli.geometry.joint_axes import SrsGeometry
from dualarm_cli.kinematics.srs.srs_canonical import SrsCanonical
from dualarm_cli.kinematics.srs_arm import SrsArm


def test_known_arms_are_exact_with_their_published_links(chains):
    """SDA10F 360/360 mm, iiwa14 420/400, OpenArm 220/216."""
    for name, links in (
        ("sda10f_left", (0.36, 0.36)),
        ("sda10f_right", (0.36, 0.36)),
        ("iiwa14", (0.42, 0.40)),
        ("openarm", (0.22, 0.216)),
        ("bent", (0.42, 0.40)),
    ):
        geometry = SrsGeometry.measure(*chains[name].measured())
        assert geometry.is_srs(1e-12), name
        np.testing.assert_allclose((geometry.upper, geometry.fore), links, atol=1e-12)


def test_sda10f_centres_are_where_the_fact_sheet_says(chains):
    """S (0.1, 0.265, 1.2), E (0.1, 0.625, 1.2), W (0.1, 0.985, 1.2), right arm mirrored."""
    for name, s in (("sda10f_left", 1), ("sda10f_right", -1)):
        geometry = SrsGeometry.measure(*chains[name].measured())
        centres = (geometry.shoulder, geometry.elbow, geometry.wrist)
        for point, y in zip(centres, (0.265, 0.625, 0.985), strict=True):
            np.testing.assert_allclose(point, [0.1, s * y, 1.2], atol=1e-12)


@pytest.mark.parametrize("offset", [1e-5, 3e-4, 0.02])
def test_an_axis_moved_sideways_is_measured_as_moved(chains, offset):
    """Axis 2 of the iiwa (along y) moved by d in x: gaps d; two axes stay, so the centre moves d/3.

    The farthest axis is then 2d/3 from it.
    """
    axes, points, R, p = chains["iiwa14"].measured()
    points[1, 0] += offset
    deviation = SrsGeometry.measure(axes, points, R, p).deviation
    np.testing.assert_allclose(deviation.gaps, [offset, offset, 0, 0, 0, 0], atol=1e-14)
    np.testing.assert_allclose(deviation.shoulder, 2 * offset / 3, rtol=1e-9)
    assert deviation.elbow < 1e-14 and deviation.wrist < 1e-14 and deviation.angle < 1e-14


def test_an_elbow_offset_is_measured_between_its_axes(chains):
    """Axis 4 (along y) moved by 45 mm in x misses axes 3 and 5 by 45 mm."""
    axes, points, R, p = chains["iiwa14"].measured()
    points[3, 0] += 0.045
    deviation = SrsGeometry.measure(axes, points, R, p).deviation
    np.testing.assert_allclose(deviation.gaps, [0, 0, 0.045, 0.045, 0, 0], atol=1e-14)
    np.testing.assert_allclose(deviation.elbow, 0.03, rtol=1e-9)


def test_a_tilted_axis_is_measured_as_tilted(chains):
    """Axis 6 tilted towards axis 5 about their meeting point deviates by its angle."""
    axes, points, R, p = chains["iiwa14"].measured()
    axes[5] = [0.0, np.cos(2e-3), np.sin(2e-3)]
    geometry = SrsGeometry.measure(axes, points, R, p)
    np.testing.assert_allclose(geometry.deviation.angle, 2e-3, rtol=1e-9)
    assert geometry.is_srs(2.1e-3) and not geometry.is_srs(1.9e-3)


def test_yumi_is_refused_with_its_measured_offsets(chains):
    """The data sheet's offsets are in the message, in mm."""
    geometry = SrsGeometry.measure(*chains["yumi"].measured())
    expected = [0.03, 0.03, 0.04188, 0.0405, 0.027, 0.027]
    np.testing.assert_allclose(geometry.deviation.gaps, expected, atol=1e-9)
    with pytest.raises(UnsupportedError, match=r"30, 30, 41\.9, 40\.5, 27, 27 mm"):
        SrsArm(geometry, -np.ones(7), np.ones(7))


def test_parallel_axes_are_measured_without_failing():
    """Seven parallel axes are no arm at all: the distances are those of the lines."""
    axes = np.tile([0.0, 0.0, 1.0], (7, 1))
    points = np.zeros((7, 3))
    points[:, 0] = 0.1 * np.arange(7)
    geometry = SrsGeometry.measure(axes, points, np.eye(3), np.zeros(3))
    np.testing.assert_allclose(geometry.deviation.gaps, 0.1, atol=1e-12)
    np.testing.assert_allclose(geometry.deviation.angle, np.pi / 2, atol=1e-12)
    assert not geometry.is_srs(1e-6)


def test_canonical_angles_are_zero_where_links_and_axes_line_up(chains):
    """SDA10F is stretched at q = 0: no offsets at joints 2, 4, 6, whatever its signs."""
    for name in ("sda10f_left", "sda10f_right", "iiwa14"):
        canonical = SrsCanonical.of(SrsGeometry.measure(*chains[name].measured()))
        np.testing.assert_allclose(canonical.offset[[1, 3, 5]], 0.0, atol=0.0)
    # OpenArm's axis 7 stands across its forearm at q = 0.
    openarm = SrsCanonical.of(SrsGeometry.measure(*chains["openarm"].measured()))
    np.testing.assert_allclose(np.abs(openarm.offset[5]), np.pi / 2, atol=1e-12)
