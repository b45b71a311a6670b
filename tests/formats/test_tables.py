"""NumPy's archive, Parquet and CSV, read by NumPy, pyarrow and csv."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pyarrow.parquet as pq

from dualarm_cli.formats import export


def content(exported, name, file, rate=40.0):
    """Returns a file of an export."""
    return b"".join(export(name, exported.request(rate))[file])


def test_the_archive_is_the_schedule_at_its_times(exported):
    """Samples equal the schedule's to the last digit; events are all there."""
    arrays = np.load(io.BytesIO(content(exported, "npz", "schedule.npz")), allow_pickle=False)
    schedule = exported.schedule
    joints = arrays["joints"].tolist()
    q, v, a = schedule.trajectory.select(joints).at(arrays["time"])
    np.testing.assert_array_equal(arrays["position"], q)
    np.testing.assert_array_equal(arrays["velocity"], v)
    np.testing.assert_array_equal(arrays["acceleration"], a)
    assert arrays["event_time"].tolist() == [event.time for event in schedule.events]
    assert arrays["event_task"].tolist() == [event.task for event in schedule.events]
    poses = [event.pose.homogeneous for event in schedule.events]
    np.testing.assert_array_equal(arrays["event_pose"], poses)


def test_the_archive_is_the_same_bytes_again(exported):
    """It carries no time of day."""
    assert content(exported, "npz", "schedule.npz") == content(exported, "npz", "schedule.npz")


def test_parquet_has_a_column_for_each_rate_with_its_unit(exported):
    """Values equal the schedule's to the last digit."""
    schedule = exported.schedule
    table = pq.read_table(io.BytesIO(content(exported, "parquet", "schedule.parquet")))
    time = table["time"].to_numpy()
    for joint in schedule.robot.limits.joints:
        rates = schedule.trajectory.select([joint]).at(time)
        for name, values in zip(("position", "velocity", "acceleration"), rates, strict=True):
            column = f"{joint}_{name}"
            np.testing.assert_array_equal(table[column].to_numpy(), values[:, 0])
            unit = table.schema.field(column).metadata[b"unit"].decode()
            assert unit.startswith("m" if joint in schedule.robot.sliding else "rad")
    events = pq.read_table(io.BytesIO(content(exported, "parquet", "events.parquet")))
    assert events["time"].to_pylist() == [event.time for event in schedule.events]
    assert events["z"].to_pylist() == [event.pose.translation[2] for event in schedule.events]


def test_csv_at_any_rate_is_the_schedule(exported):
    """Positions agree with the schedule's to 1e-9."""
    text = content(exported, "csv", "schedule.csv", 17.0).decode()
    rows = list(csv.DictReader(io.StringIO(text)))
    time = np.array([float(row["time"]) for row in rows])
    for joint in exported.schedule.robot.limits.joints:
        expected = exported.schedule.trajectory.select([joint]).at(time)[0][:, 0]
        found = [float(row[f"{joint}_position"]) for row in rows]
        np.testing.assert_allclose(found, expected, atol=2e-9)


def test_events_are_a_table_of_their_own(exported):
    """Each with its stage, which contains it, and the pose of the tool."""
    rows = list(csv.DictReader(io.StringIO(content(exported, "csv", "events.csv").decode())))
    schedule = exported.schedule
    assert [float(row["time"]) for row in rows] == [event.time for event in schedule.events]
    for row, event in zip(rows, schedule.events, strict=True):
        assert (row["arm"], row["task"], row["action"]) == (event.arm, event.task, event.action)
        stage = schedule.stages[int(row["stage"])]
        assert event.task in stage.tasks
        assert stage.start - 1e-9 <= event.time <= stage.end + 1e-9
        place = [float(row[axis]) for axis in "xyz"]
        np.testing.assert_array_equal(place, event.pose.translation)
        x, y, z, w = (float(row[name]) for name in ("qx", "qy", "qz", "qw"))
        axis = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]
        np.testing.assert_allclose(axis, event.pose.rotation[:, 2], atol=1e-12)


def test_a_task_that_looks_like_a_formula_is_text(exported):
    """In a spreadsheet, by the mark in front of it."""
    odd = tuple(replace(event, task="=1+1") for event in exported.schedule.events)
    request = replace(exported.request(), schedule=replace(exported.schedule, events=odd))
    text = b"".join(export("csv", request)["events.csv"]).decode()
    assert all(row["task"] == "'=1+1" for row in csv.DictReader(io.StringIO(text)))
