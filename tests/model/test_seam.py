"""Seams: how the tool stands on the curve by hand, where the part is held, who works."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.model.curves.contours import LineContour
from dualarm_cli.model.curves.feature_curve import FeatureCurve
from dualarm_cli.model.curves.tool_path import Line, ToolPath
from dualarm_cli.model.process_work import Hold, SeamTool, SeamWork, longest_ramp

LINE = FeatureCurve(
    LineContour(np.zeros(3), np.array([0.2, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])),
    pin.SE3.Identity(),
)


def work(**changes):
    """A line of 0.2 m along x, seen from z."""
    values = {"master": "left", "slave": "right", "part": pin.SE3.Identity(), "curve": LINE}
    values |= {"tool": SeamTool(), "hold": Hold(), "speed": 0.1}
    return SeamWork(**(values | changes))


def test_the_tool_points_into_the_surface_with_its_x_along_the_curve():
    """Without angles: x to x, z to -z, and so y to -y."""
    assert SeamTool().R_curve_tool.tolist() == np.diag([1.0, -1.0, -1.0]).tolist()


@pytest.mark.parametrize(
    ("work_angle", "travel_angle", "z"),
    [
        # About x by 30 deg: -z goes to (0, sin 30, -cos 30).
        (30.0, 0.0, [0.0, 0.5, -np.sqrt(0.75)]),
        # About y by 30 deg: -z goes to (-sin 30, 0, -cos 30): its tip lags, the tool leans forwards.
        (0.0, 30.0, [-0.5, 0.0, -np.sqrt(0.75)]),
        # First the turn about the tangent, then about the turned y: in fixed axes the travel angle acts first.
        (90.0, 30.0, [-0.5, np.sqrt(0.75), 0.0]),
        (-90.0, -30.0, [0.5, -np.sqrt(0.75), 0.0]),
    ],
)
def test_work_and_travel_angles_by_hand(work_angle, travel_angle, z):
    """Where the tool's axis points in the curve's frame."""
    tool = SeamTool(work_angle=np.radians(work_angle), travel_angle=np.radians(travel_angle))
    R = tool.R_curve_tool
    assert R[:, 2] == pytest.approx(z, abs=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)
    expected = (
        pin.utils.rotate("x", np.radians(work_angle))
        @ pin.utils.rotate("y", np.radians(travel_angle))
        @ np.diag([1.0, -1.0, -1.0])
    )
    assert pytest.approx(expected, abs=1e-15) == R


def test_frames_of_the_tool_go_along_the_seam():
    """Half of 0.2 m is at (0.1, 0, 0); turned about the tangent by 90 degrees the tool's axis is along +y."""
    R, p = work(tool=SeamTool(work_angle=np.pi / 2)).tool_frames(np.array([0.0, 0.5]))
    assert p == pytest.approx(np.array([[0.0, 0, 0], [0.1, 0, 0]]), abs=1e-12)
    assert R[:, :, 2] == pytest.approx(np.array([[0.0, 1.0, 0.0]] * 2), abs=1e-12)
    assert work().length == pytest.approx(0.2)


def test_a_part_stands_still_or_follows_a_way_at_the_seam_s_share():
    """At a pose everywhere; along 0.4 m, a quarter of it after a quarter of the seam."""
    pose = pin.SE3(pin.utils.rotate("z", 0.3), np.array([0.5, 0.0, 1.0]))
    still = Hold(pose=pose)
    R, p = still.at(np.array([0.0, 0.7]))
    assert np.array_equal(R, [pose.rotation] * 2)
    assert p.tolist() == [[0.5, 0.0, 1.0]] * 2
    end = pin.SE3(pose.rotation, pose.translation + np.array([0.0, 0.4, 0.0]))
    moves = Hold(part_path=ToolPath((Line(pose, end),)))
    R, p = moves.at(np.array([0.25, 1.0]))
    assert p == pytest.approx(np.array([[0.5, 0.1, 1.0], [0.5, 0.4, 1.0]]))
    assert (still.given, still.stands, moves.given, moves.stands) == (True, True, True, False)
    assert (Hold().given, Hold().stands) == (False, False)
    assert (Hold(still=True).given, Hold(still=True).stands) == (False, True)


def test_the_arms_that_work_are_the_slave_and_then_the_master():
    """Without a master only the slave."""
    assert work().arms == ("right", "left")
    assert work(master=None).arms == ("right",)


def test_seams_can_be_keys_whatever_their_curves_are_made_of():
    """Curves with arrays have no hash; a seam is the same as itself alone."""
    one, other = work(), work()
    assert list(dict.fromkeys([one, other, one])) == [one, other]
    assert one != other


def test_ramps_last_twice_what_the_file_s_acceleration_takes():
    """100 mm/s at 20 mm/s²: 5 s, twice that; at half the pace twice as long; never less than 1.2 s."""
    slow = work(acceleration=0.02)
    assert longest_ramp(slow, 1.0) == pytest.approx(10.0)
    assert longest_ramp(slow, 0.5) == pytest.approx(20.0)
    assert longest_ramp(work(acceleration=5.0), 1.0) == pytest.approx(1.2)
    assert longest_ramp(work(), 0.5) == pytest.approx(2.4)
