"""schedule.csv: every row a step after the one before, digits that mean something, cells that no spreadsheet runs."""

from __future__ import annotations

import csv
import io
import json
import math
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from dualarm_cli.errors import UsageError
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.formats import tables
from dualarm_cli.formats.request import COLUMNS, columns_named
from dualarm_cli.formats.tables import samples_table
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory


@pytest.fixture
def sampled(quick_plan):
    """A plainer motion: 0.7 s, constant jerk of 6 in one joint, the other one stands at -1e-12."""
    trajectory = Trajectory(
        ("turn", "lift"),
        np.array([0.0, 0.7]),
        position=np.array([[0.0, -1e-12], [0.343, -1e-12]]),
        velocity=np.array([[0.0, 0.0], [1.47, 0.0]]),
        acceleration=np.array([[0.0, 0.0], [4.2, 0.0]]),
    )
    return replace(quick_plan("01_first_pick"), motion=JointMotion.of(trajectory))


def table(schedule, rate, columns=COLUMNS):
    """Returns header and cells of the table."""
    content = b"".join(samples_table(schedule, rate, columns)).decode()
    header, *rows = csv.reader(io.StringIO(content, newline=""))
    return header, rows


def test_the_header_names_time_and_what_is_asked_for_of_each_joint(sampled):
    """In the schedule's order of joints, in the user's order of columns."""
    assert table(sampled, 10.0)[0] == [
        "time",
        *("turn_position", "turn_velocity", "turn_acceleration"),
        *("lift_position", "lift_velocity", "lift_acceleration"),
    ]
    some = table(sampled, 10.0, ("velocity", "position"))[0]
    assert some == ["time", "turn_velocity", "turn_position", "lift_velocity", "lift_position"]


def test_samples_are_the_motion_with_jerk_six(sampled):
    """Q = t³, v = 3 t², a = 6 t: at tenths of a second these are short numbers; what stands is written as 0."""
    rows = table(sampled, 10.0)[1]
    assert rows[1] == ["0.1", "0.001", "0.03", "0.6", "0", "0", "0"]
    assert rows[5] == ["0.5", "0.125", "0.75", "3", "0", "0", "0"]
    assert rows[7] == ["0.7", "0.343", "1.47", "4.2", "0", "0", "0"]
    assert len(rows) == 8


@pytest.mark.parametrize("rate", [0.5, 1.0, 10.0, 17.0, 250.0, 333.0])
def test_time_is_uniform_and_the_last_row_is_at_the_end_or_a_part_of_a_step_later(sampled, rate):
    """Joints then stand where they are at the end."""
    rows = table(sampled, rate)[1]
    times = [float(row[0]) for row in rows]
    for k, time in enumerate(times):
        assert abs(Fraction(time) - k / Fraction(rate)) <= Fraction(1, 10**9)
    assert 0.7 - 1e-9 <= times[-1] < 0.7 + 1.0 / rate - 1e-9
    assert rows[-1][1] == "0.343"
    if times[-1] > 0.7 + 1e-6:
        assert rows[-1][2:4] == ["0", "0"]


def test_positions_are_those_of_schedule_json_to_half_a_billionth(quick_plan, plain_motion):
    """Against a reader of its own, and no digit behind the ninth, the seventh, the fifth."""
    schedule = quick_plan("01_first_pick")
    document = json.loads(b"".join(to_json(schedule, "robot.urdf", {})))
    header, rows = table(schedule, 17.0)
    for row in rows:
        expected = plain_motion.positions(document, min(float(row[0]), schedule.duration))
        for name, cell in zip(header[1:], row[1:], strict=True):
            joint, what = name.rsplit("_", 1)
            digits = len(cell.partition(".")[2])
            assert digits <= {"position": 9, "velocity": 7, "acceleration": 5}[what]
            if what == "position":
                # The time of the row is rounded as well.
                assert float(cell) == pytest.approx(expected[joint], abs=5.1e-10 + 3 * 5e-10)


def test_long_tables_are_the_same_as_short_ones_put_together(sampled, monkeypatch):
    """Written in blocks of three rows and in one."""
    whole = b"".join(samples_table(sampled, 100.0, COLUMNS))
    monkeypatch.setattr(tables, "BLOCK", 3)
    assert b"".join(samples_table(sampled, 100.0, COLUMNS)) == whole
    assert whole.endswith(b"\n")
    assert b"\n\n" not in whole


def test_one_knot_is_one_row(sampled):
    """No time passes."""
    motion = sampled.trajectory
    one = replace(
        motion,
        time=motion.time[:1],
        **{k: getattr(motion, k)[:1] for k in ("position", "velocity", "acceleration")},
    )
    still = replace(sampled, motion=JointMotion.of(one), events=())
    assert table(still, 250.0)[1] == [["0"] * 7]


@pytest.mark.parametrize("value", [1e6, 100.0, 12345678.9, -0.5, 2.0 / 3.0, -1e-10, 1e-9])
def test_numbers_are_plain_decimals(sampled, value):
    """Never with an exponent, a -0 or zeros at the end."""
    motion = sampled.trajectory
    moved = replace(motion, position=np.full((2, 2), value), velocity=np.zeros((2, 2)))
    still = replace(moved, acceleration=np.zeros((2, 2)))
    cell = table(replace(sampled, motion=JointMotion.of(still)), 1.0)[1][0][1]
    assert float(cell) == pytest.approx(value, abs=5e-10)
    assert "e" not in cell and cell != "-0"
    assert "." not in cell or not cell.endswith(("0", "."))
    assert math.copysign(1.0, float(cell)) == (
        1.0 if abs(value) < 5e-10 else math.copysign(1, value)
    )


@pytest.mark.parametrize(
    "name", ["=cmd()", "+1", "-1", "@sum", "\tx", "\rx", 'a"b', "a,b", "a\nb", "a\rb", "ジョイント"]
)
def test_no_name_of_a_joint_is_a_formula_or_breaks_a_row(sampled, name):
    """A name comes from somebody's URDF."""
    motion = replace(sampled.trajectory, joints=(name, "lift"))
    odd = replace(sampled, motion=JointMotion.of(motion))
    header, rows = table(odd, 10.0)
    assert len(header) == 7
    assert {len(row) for row in rows} == {7} and len(rows) == 8
    assert not header[1].startswith(("=", "+", "-", "@", "\t", "\r"))
    assert header[1].endswith("_position")
    assert b"\r" not in b"".join(samples_table(odd, 10.0, COLUMNS))
    assert header[4] == "lift_position"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["torque"], "no column 'torque'; choose of position, velocity, acceleration"),
        (["position", ""], "no column ''"),
        (["position", "position"], "names 'position' again"),
        ([], "names no column"),
    ],
)
def test_columns_that_are_not_there_are_refused(names, message):
    """With what there is."""
    with pytest.raises(UsageError, match=message):
        columns_named(names)
