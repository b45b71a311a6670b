"""NumPy's archive, Parquet and CSV, read by NumPy, pyarrow and csv."""

from __future__ import annotations

import csv
import io
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
import pytest

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


def test_events_are_a_table_of_their_own(exported):
    """Each with its stage, which contains it, and the pose of the tool."""
    rows = list(csv.DictReader(io.StringIO(content(exported, "csv", "events.csv").decode())))
    schedule = exported.schedule
    times = [event.time for event in schedule.events]
    assert [float(row["time"]) for row in rows] == pytest.approx(times, abs=5.1e-10)
    for row, event in zip(rows, schedule.events, strict=True):
        assert (row["arm"], row["task"], row["action"]) == (event.arm, event.task, event.action)
        stage = schedule.stages[int(row["stage"]) - 1]
        assert event.task in stage.tasks
        assert stage.start - 1e-9 <= event.time <= stage.end + 1e-9
        place = [float(row[axis]) for axis in "xyz"]
        np.testing.assert_allclose(place, event.pose.translation, atol=5.1e-10)
        x, y, z, w = (float(row[name]) for name in ("qx", "qy", "qz", "qw"))
        axis = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]
        np.testing.assert_allclose(axis, event.pose.rotation[:, 2], atol=1e-8)
        assert row["signal"] == event.signal


def test_a_task_that_looks_like_a_formula_is_text(exported):
    """In a spreadsheet, by the mark in front of it."""
    odd = tuple(replace(event, task="=1+1") for event in exported.schedule.events)
    request = replace(exported.request(), schedule=replace(exported.schedule, events=odd))
    text = b"".join(export("csv", request)["events.csv"]).decode()
    assert all(row["task"] == "'=1+1" for row in csv.DictReader(io.StringIO(text)))


def test_targets_have_joints_that_bring_the_tool_to_its_pose(exported):
    """By pinocchio on the URDF; lines begin and end in the axis of the tool, as far out as the task says."""
    rows = list(csv.DictReader(io.StringIO(content(exported, "csv", "targets.csv").decode())))
    schedule, robot = exported.schedule, exported.schedule.robot
    model = pin.buildModelFromXML(robot.urdf)
    data, place = model.createData(), {}
    for row in rows:
        arm = robot.arms[row["arm"]]
        joints = {name: float(row[name]) for name in robot.platform}
        joints |= {name: float(row[f"j{k + 1}"]) for k, name in enumerate(arm.joints)}
        q = np.array([joints.get(name, 0.0) for name in list(model.names)[1:]])
        pin.framesForwardKinematics(model, data, q)
        tool = robot.base * data.oMf[model.getFrameId(arm.flange)] * arm.tcp
        np.testing.assert_allclose(tool.translation, [float(row[a]) for a in "xyz"], atol=2e-6)
        turn = pin.Quaternion(*(float(row[name]) for name in ("qw", "qx", "qy", "qz")))
        np.testing.assert_allclose(tool.rotation, turn.toRotationMatrix(), atol=2e-6)
        place[row["arm"], row["task"], row["action"], row["point"]] = tool
    events = {(e.arm, e.task, e.action): e for e in schedule.events}
    assert {key[:3] for key in place if key[3] == "target"} == set(events)
    stops = exported.job.stops_by_key()
    lines = 0
    for key, event in events.items():
        stop = stops.get(key)
        if stop is None or event.moves:
            continue
        for point, length in (("approach", stop.approach), ("retract", stop.retract)):
            assert ((*key, point) in place) == (length > 0.0)
            if length > 0.0:
                beside = place[*key, "target"].actInv(place[*key, point])
                np.testing.assert_allclose(beside.translation, [0.0, 0.0, -length], atol=1e-4)
                lines += 1
    assert lines or not any(not event.moves for event in schedule.events)
