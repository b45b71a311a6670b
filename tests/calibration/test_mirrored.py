"""Points of one robot that are the mirror image of the other's: no transform is given."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.calibration.calibrate import calibrate
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.calibration.points import load_points

POINTS = """\
dualarm: points/1
points:
  - {name: A, left: {xyz: [0.7, 0.1, 0.5]}, right: {xyz: [0.1, SIGN0.7, 0.5]}}
  - {name: B, left: {xyz: [0.9, 0.2, 0.6]}, right: {xyz: [0.2, SIGN0.9, 0.6]}}
  - {name: C, left: {xyz: [0.6, 0.5, 0.9]}, right: {xyz: [0.5, SIGN0.6, 0.9]}}
  - {name: D, left: {xyz: [0.8, 0.6, 0.3]}, right: {xyz: [0.6, SIGN0.8, 0.3]}}
  - {name: E, left: {xyz: [0.5, 0.3, 0.7]}, right: {xyz: [0.3, SIGN0.5, 0.7]}}
"""


def test_a_lost_sign_is_refused_and_the_right_one_is_not(tmp_path: Path) -> None:
    """Axes x and y exchanged is a reflection; with one sign turned it is a quarter turn about z, exactly."""
    (tmp_path / "dualarm.toml").write_text("")
    path = tmp_path / "points.yaml"
    path.write_text(POINTS.replace("SIGN", ""))
    with pytest.raises(InfeasibleError, match="mirror image"):
        calibrate(load_points(path).touches, "least_squares", "joints")
    path.write_text(POINTS.replace("SIGN", "-"))
    found = calibrate(load_points(path).touches, "least_squares", "joints")
    assert found.judgement.rms < 1e-12
