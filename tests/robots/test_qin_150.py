"""The robot of [Qin2024] against the paper's numbers: home pose, Table 6 and the points printed beside it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot

# Table 6 [rad], and the printed points [m] with their minus signs restored.
TABLE_6 = {
    "M1": ([3.3501, -1.9332, 0.3150, -1.1992, 0.8205, -1.5709], [-1.2367, -0.0200, 1.4260]),
    "M2": ([2.9103, -1.7692, 0.5913, -2.4699, 1.0582, -1.5709], [-1.2527, 0.4883, 1.2630]),
    "M3": ([2.4076, -1.3606, -0.3061, 0.0, 1.5709, -1.5709], [-1.2466, 1.1244, 1.2638]),
    "S1": ([0.0525, -1.6430, 0.1389, -1.3936, 0.4213, -0.4161], [1.6304, -0.0542, 1.4159]),
    "S2": ([0.4697, -1.5182, 0.0881, -1.1845, 1.1627, -0.4936], [1.5355, 0.4484, 1.2480]),
    "S3": ([0.6904, -1.2629, 0.1824, -2.8633, 1.5296, -1.1215], [1.4557, 1.0791, 1.2716]),
}


def tip(q: list[float], tool: float) -> np.ndarray:
    """Returns the tip of a tool along the flange's z axis [m], in the base frame."""
    model = pin.buildModelFromXML(load_robot("qin_150").robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    point: np.ndarray = data.oMf[model.getFrameId("flange")].act(np.array([0.0, 0.0, tool]))
    return point


@pytest.mark.parametrize("name", TABLE_6)
def test_table_6_gives_the_printed_points(name: str) -> None:
    """With the 347 mm tool; 4-decimal angles at 2 m give 0.14 mm at most, allowed are 0.2 mm."""
    q, printed = TABLE_6[name]
    np.testing.assert_allclose(tip(q, 0.347), printed, atol=2e-4)


def test_table_6_is_within_the_limits() -> None:
    """Joint 1 is 192 deg at M1, which is why it is widened to 200 deg."""
    limits = load_robot("qin_150").robot.limits
    readings = np.array([q for q, _ in TABLE_6.values()])
    assert (readings > limits.lower).all()
    assert (readings < limits.upper).all()
    assert math.degrees(readings[:, 0].max()) == pytest.approx(191.95, abs=0.01)
    np.testing.assert_allclose(np.degrees(limits.upper[[0, 1, 2]]), [200, -5, 168])


@pytest.mark.parametrize(("posture", "side"), [("home", 1.0), ("mirrored", -1.0)])
def test_home_is_the_paper_s(posture: str, side: float) -> None:
    """(±90, -90, 0, 0, 90, ±90) deg: |y| = 350 + 1050 = 1400 mm; z = 335 + 1200 - 354 = 1181 mm with its tool."""
    q = load_robot("qin_150").robot.postures[posture]
    np.testing.assert_allclose(np.degrees(q), [side * 90, -90, 0, 0, 90, side * 90], atol=1e-12)
    np.testing.assert_allclose(tip(q.tolist(), 0.354), [0.0, side * 1.4, 1.181], atol=1e-12)


def test_two_of_them_make_a_cell(tmp_path: Path) -> None:
    """Two bases 2.8 m apart; 12 joints, one arm each."""
    (tmp_path / "cell.yaml").write_text(
        "dualarm: cell/1\nrobot: {left: {robot: qin_150}, right: {robot: qin_150, base: {xyz: [2.8, 0, 0]}}}\n"
    )
    cell = load_cell(tmp_path / "cell.yaml").cell
    assert [(arm.name, arm.kind, len(arm.joints)) for arm in cell.robot.arms] == [
        ("left", "spherical_wrist", 6),
        ("right", "spherical_wrist", 6),
    ]
    assert ("left_joint_2_link", "left_joint_4_link") in cell.robot.allowed_contacts
