"""Motions in files: what is read, and what is refused with its place."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import yaml

from dualarm_cli.errors import InputError
from dualarm_cli.files import logged_motion
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


BOMB = "\n".join([f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(9)])
"""Lists in lists by aliases, nine deep: 387 million entries."""


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.txt", "", "neither .csv nor a JointTrajectory"),
        ("x.csv", "", "is empty"),
        ("x.csv", "a,b\n1,2\n", "has no column 'time'"),
        ("x.csv", "time,c\n0,1\n1,1\n", "no column of a joint"),
        ("x.csv", "time,a\n0,1\n", "at least 2"),
        ("x.csv", "time,a\n0,1\n1\n", ":3: .*has 1 columns, the header 2"),
        ("x.csv", "time,a\n0,1\n1,nan\n", ":3: .*must hold finite numbers"),
        ("x.csv", "time,a\n0,1\n1,fast\n", ":3: .*must hold finite numbers"),
        ("x.csv", "time,a\n0,1\n1,2e9\n", ":3: .*hold finite numbers up to 1e"),
        ("x.csv", f"time,a\n0,1\n1,{'9' * 400}\n", ":3: .*must hold finite numbers"),
        ("x.csv", f"time,a,b\n0,1,1\n\n1,1,{'9' * 131073}\n", ":4: .*is no CSV: field larger"),
        ("x.csv", 'time,a\n0,1\n"1,1\n2,1\n', ":3: .*is no CSV: unexpected end of data"),
        (
            "x.csv",
            "time,a\n0,1\n5e-324,1\n1e-323,1\n",
            ":3: .*time 4.94.*e-324 s must be at least 1 ns after 0 s",
        ),
        ("x.csv", "time,a,a\n0,1,1\n1,1,1\n", ":1: .*has two columns 'a'"),
        ("x.csv", "time,a\n0,1\n1,1\n1,1\n", ":4: .*time 1 s must be at least 1 ns after 1 s"),
        ("x.json", "[1]", "is not a JointTrajectory"),
        ("x.json", "{", "E101 not YAML"),
        ("x.yaml", "a: [", "E101 not YAML"),
        ("x.yaml", "joint_names: [a]\npoints: 3", "must be a list of points"),
        ("x.yaml", "joint_names: [q]\npoints: []", "no joint 'q'"),
        ("x.yaml", "joint_names: [a, a]\npoints: []", "every joint once"),
        ("x.yaml", "joint_names: [a]\npoints: []", "at least 2"),
        ("x.yaml", BOMB, "E105 anchor"),
        ("x.yaml", "!!python/object:a {}", "E105 tag"),
        ("x.yaml", f"joint_names: [{'9' * 5000}]", "E104 number of 5000 characters"),
        ("x.json", f'{{"joint_names": [{"9" * 5000}]}}', "number of 5000 characters"),
        ("x.json", f'{{"joint_names": {"[" * 100000}', "E100 nesting deeper"),
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
        ({"positions": [1.0, float("inf")]}, r"points\[1\].positions: must be finite"),
        ({"positions": [1.0, 10**39]}, r"points\[1\].positions: must be finite numbers up to 1e"),
        (
            {"time_from_start": {"sec": 1, "nanosec": 10**9}},
            r"nanosec: 0 to 999999999}, not {sec: 1,",
        ),
        ({"velocities": []}, r"points\[1\].velocities: must be 2 numbers"),
        ({"time_from_start": 3.0}, r"points\[1\].time_from_start: must be"),
        ({"time_from_start": {"sec": 0, "nanosec": 0}}, r"points\[1\].*at least 1 ns after"),
    ],
)
def test_a_bad_point_is_named(tmp_path, change, message):
    """By its number."""
    points = [GOOD["points"][0], GOOD["points"][1] | change]
    file = tmp_path / "log.json"
    file.write_text(json.dumps(GOOD | {"points": points}))
    with pytest.raises(InputError, match=message):
        read_logged_motion(file, JOINTS)


@pytest.mark.parametrize("suffix", ["csv", "json", "yaml"])
def test_what_never_ends_is_not_waited_for(tmp_path, suffix):
    """A pipe that nobody writes to, and a device that a link leads to."""
    os.mkfifo(tmp_path / f"pipe.{suffix}")
    (tmp_path / f"zero.{suffix}").symlink_to("/dev/zero")
    for name in ("pipe", "zero"):
        with pytest.raises(InputError, match="is not a regular file"):
            read_logged_motion(tmp_path / f"{name}.{suffix}", JOINTS)


def test_more_samples_than_are_read_are_refused(tmp_path, monkeypatch):
    """Counted while they are read, in batches; as many as are allowed are whole."""
    limits = replace(logged_motion.LOG, max_samples=25, batch=10)
    monkeypatch.setattr(logged_motion, "LOG", limits)
    file = tmp_path / "log.csv"
    for count in (25, 26):
        file.write_text("time,b,a\n" + "".join(f"{k},{2 * k},{3 * k}\n" for k in range(count)))
        if count == 25:
            motion = read_logged_motion(file, JOINTS)
            np.testing.assert_array_equal(motion.position, np.outer(np.arange(25), [3, 2]))
    with pytest.raises(InputError, match=r":27: .*more samples than the 25"):
        read_logged_motion(file, JOINTS)


def test_a_missing_file_is_said(tmp_path):
    """No traceback."""
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_logged_motion(tmp_path / "none.csv", JOINTS)
