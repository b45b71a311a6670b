"""Motions in files: what is read, and what is refused with its place."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

from dualarm_cli.errors import InputError
from dualarm_cli.files.logged_motion import read_logged_motion

JOINTS = ("a", "b")


def point(time, positions, **others):
    """Returns a point of a JointTrajectory."""
    stamp = {"sec": int(time), "nanosec": round((time % 1) * 1e9)}
    return {"positions": positions, "time_from_start": stamp, **others}


GOOD = {
    "joint_names": ["b", "a"],
    "points": [
        point(0.0, [1.0, 2.0], velocities=[0.0, 0.0]),
        point(1.25, [3, 4.5], velocities=[0.5, 0.0]),
    ],
}


@pytest.mark.parametrize("suffix", ["json", "yaml", "yml"])
@pytest.mark.parametrize("wrapped", [False, True])
def test_a_joint_trajectory_is_read_as_it_is_or_as_a_goal(tmp_path, suffix, wrapped):
    """In JSON or YAML; whole numbers are numbers, empty accelerations are none."""
    document = {"trajectory": GOOD} if wrapped else GOOD
    file = tmp_path / f"log.{suffix}"
    file.write_text(json.dumps(document) if suffix == "json" else yaml.safe_dump(document))
    motion = read_logged_motion(file, JOINTS)
    assert motion.joints == ("b", "a")
    np.testing.assert_array_equal(motion.time, [0.0, 1.25])
    np.testing.assert_array_equal(motion.position, [[1.0, 2.0], [3.0, 4.5]])
    np.testing.assert_array_equal(motion.velocity, [[0.0, 0.0], [0.5, 0.0]])
    assert motion.acceleration is None


@pytest.mark.parametrize("names", ["a_position,b_position", "a,b"])
def test_a_csv_is_read_by_its_header(tmp_path, names):
    """Columns in any order, others beside them, remarks, blank lines, a byte-order mark."""
    file = tmp_path / "log.csv"
    text = f"# a log\n{names},state,time\n1,2,moving,0\n\n3,4,moving,0.5\n"
    file.write_text(text, encoding="utf-8-sig")
    motion = read_logged_motion(file, JOINTS)
    assert motion.joints == JOINTS
    np.testing.assert_array_equal(motion.time, [0.0, 0.5])
    np.testing.assert_array_equal(motion.position, [[1.0, 2.0], [3.0, 4.0]])
    assert motion.velocity is None


def test_velocities_count_where_all_joints_have_them(tmp_path):
    """Half of them are no basis for cubic interpolation."""
    file = tmp_path / "log.csv"
    file.write_text("time,a_position,a_velocity,b_position\n0,1,0,2\n1,1,0,2\n")
    assert read_logged_motion(file, JOINTS).velocity is None
    assert read_logged_motion(file, ("a",)).velocity is not None


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.txt", "", "neither .csv nor a JointTrajectory"),
        ("x.csv", "", "is empty"),
        ("x.csv", "a,b\n1,2\n", "has no column 'time'"),
        ("x.csv", "time,c\n0,1\n1,1\n", "no column of a joint"),
        ("x.csv", "time,a\n0,1\n", "at least two"),
        ("x.csv", "time,a\n0,1\n1\n", ":3: .*has 1 columns, the header 2"),
        ("x.csv", "time,a\n0,1\n1,nan\n", ":3: .*not finite"),
        ("x.csv", "time,a\n0,1\n1,fast\n", ":3: .*not finite"),
        ("x.csv", "time,a\n0,1\n1,1\n1,1\n", ":4: .*time 1 s is not after 1 s"),
        ("x.json", "[1]", "is no JointTrajectory"),
        ("x.json", "{", "neither YAML nor JSON"),
        ("x.yaml", "a: [", "neither YAML nor JSON"),
        ("x.yaml", "joint_names: [a]\npoints: 3", "must be a list of points"),
        ("x.yaml", "joint_names: [q]\npoints: []", "no joint 'q'"),
        ("x.yaml", "joint_names: [a, a]\npoints: []", "every joint once"),
        ("x.yaml", "joint_names: [a]\npoints: []", "at least two"),
    ],
)
def test_what_cannot_be_read_says_where_and_why(tmp_path, name, text, message):
    """File and line, or the point."""
    file = tmp_path / name
    file.write_text(text)
    with pytest.raises(InputError, match=message):
        read_logged_motion(file, JOINTS)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": [1.0]}, r"points\[1\].positions: must be 2 numbers"),
        ({"positions": [1.0, "x"]}, r"points\[1\].positions: must be 2 numbers"),
        ({"positions": [1.0, True]}, r"points\[1\].positions: must be 2 numbers"),
        ({"positions": [1.0, float("inf")]}, r"points\[1\].positions: .*not finite"),
        ({"velocities": []}, r"points\[1\].velocities: must be 2 numbers"),
        ({"time_from_start": 3.0}, r"points\[1\].time_from_start: must be"),
        ({"time_from_start": {"sec": 0, "nanosec": 0}}, r"points\[1\].*is not after"),
    ],
)
def test_a_bad_point_is_named(tmp_path, change, message):
    """By its number."""
    points = [GOOD["points"][0], GOOD["points"][1] | change]
    file = tmp_path / "log.json"
    file.write_text(json.dumps(GOOD | {"points": points}))
    with pytest.raises(InputError, match=message):
        read_logged_motion(file, JOINTS)


def test_a_missing_file_is_said(tmp_path):
    """No traceback."""
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_logged_motion(tmp_path / "none.csv", JOINTS)
