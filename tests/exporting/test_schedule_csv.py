"""schedule.csv: uniform samples and exact instants, doubles that survive, cells that no spreadsheet runs."""

from __future__ import annotations

import csv
import dataclasses
import io

import numpy as np
import pytest

from dualarm_cli.exporting.files import to_csv
from dualarm_cli.model.joint_motion import JointMotion


@pytest.fixture
def sampled(schedule):
    """A plainer motion: 0.7 s, constant jerk in one interval."""
    trajectory = dataclasses.replace(
        schedule.trajectory,
        time=np.array([0.0, 0.7]),
        position=np.array([[0.0, 1.0], [0.343, 1.0]]),
        velocity=np.array([[0.0, 0.0], [1.47, 0.0]]),
        acceleration=np.array([[0.0, 0.0], [4.2, 0.0]]),
    )
    return dataclasses.replace(schedule, motion=JointMotion.of(trajectory))


def written(schedule, rate):
    """Returns the whole file."""
    return b"".join(to_csv(schedule, rate))


def table(content):
    """Returns header and numbers of a CSV file."""
    header, *rows = csv.reader(io.StringIO(content.decode(), newline=""))
    return header, np.array(rows, dtype=np.float64)


def test_the_header_names_time_and_three_columns_of_each_joint(sampled):
    """In the schedule's order."""
    assert table(written(sampled, 10.0))[0] == [
        "time",
        "turn_position",
        "turn_velocity",
        "turn_acceleration",
        "lift_position",
        "lift_velocity",
        "lift_acceleration",
    ]


def test_samples_are_the_motion_with_jerk_six(sampled):
    """Q = t³, v = 3 t², a = 6 t of the first joint; the second stands at 1."""
    rows = table(written(sampled, 10.0))[1]
    t = rows[:, 0]
    assert np.allclose(rows[:, 1:4], np.column_stack([t**3, 3 * t**2, 6 * t]), rtol=0, atol=1e-15)
    assert np.array_equal(rows[:, 4:], np.tile([1.0, 0.0, 0.0], (len(t), 1)))


@pytest.mark.parametrize("rate", [0.5, 1.0, 10.0, 250.0, 333.0])
def test_uniform_samples_events_and_the_end_are_there_and_nothing_twice(sampled, rate):
    """Event times and the end bit for bit; a sample that differs from one by rounding gives way."""
    times = table(written(sampled, rate))[1][:, 0]
    events = [event.time for event in sampled.events]
    assert {0.0, 0.7, *events} <= set(times.tolist())
    assert np.diff(times).min() > 1e-9
    uniform = np.arange(int(0.7 * rate + 1e-9) + 1) / rate
    assert np.abs(times[:, None] - uniform).min(axis=0).max() < 1e-9
    assert len(times) <= len(uniform) + len({*events, 0.7})


def test_an_event_beside_a_sample_replaces_it(sampled):
    """0.1 + 0.2 is not 0.3 (0.30000000000000004): one row, the event's."""
    times = table(written(sampled, 10.0))[1][:, 0].tolist()
    assert 0.30000000000000004 in times
    assert 0.3 not in times
    assert len(times) == 8


def test_every_number_reads_back_to_the_same_double(schedule, sampled):
    """Also 5e-324 and 1e308; compared with the trajectory's own evaluation."""
    for one in (schedule, sampled):
        with np.errstate(all="ignore"):
            content = written(one, 10.0)
            rows = table(content)[1]
            expected = np.stack(one.trajectory.at(rows[:, 0]), axis=2).reshape(len(rows), -1)
        assert np.array_equal(rows[:, 1:], expected, equal_nan=True)


def test_long_tables_are_the_same_as_short_ones_put_together(sampled, monkeypatch):
    """Written in blocks of three rows and in one."""
    from dualarm_cli.exporting import files as schedule_csv

    whole = written(sampled, 100.0)
    monkeypatch.setattr(schedule_csv, "BLOCK", 3)
    assert written(sampled, 100.0) == whole
    assert whole.endswith(b"\n")
    assert b"\n\n" not in whole


def test_one_knot_is_one_row(sampled):
    """No time passes."""
    trajectory = sampled.trajectory
    one = dataclasses.replace(
        trajectory,
        time=trajectory.time[:1],
        **{k: getattr(trajectory, k)[:1] for k in ("position", "velocity", "acceleration")},
    )
    still = dataclasses.replace(sampled, motion=JointMotion.of(one), events=())
    assert len(table(written(still, 250.0))[1]) == 1


@pytest.mark.parametrize(
    "name", ["=cmd()", "+1", "-1", "@sum", "\tx", "\rx", 'a"b', "a,b", "a\nb", "a\rb", "ジョイント"]
)
def test_no_name_of_a_joint_is_a_formula_or_breaks_a_row(sampled, name):
    """A name comes from somebody's URDF."""
    trajectory = dataclasses.replace(sampled.trajectory, joints=(name, "lift"))
    content = written(dataclasses.replace(sampled, motion=JointMotion.of(trajectory)), 10.0)
    header, rows = table(content)
    assert len(header) == 7
    assert rows.shape == (8, 7)
    assert not header[1].startswith(("=", "+", "-", "@", "\t", "\r"))
    assert header[1].endswith("_position")
    assert content.count(b"\n") == 9
    assert b"\r" not in content
    assert header[4] == "lift_position"
