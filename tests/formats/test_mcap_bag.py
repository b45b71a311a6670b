"""The bag, read by two readers that share nothing: Foxglove's `mcap` and `rosbags`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader

from dualarm_cli.formats import export


@pytest.fixture(scope="module")
def bag(exported, tmp_path_factory) -> Path:
    """The bag's folder."""
    folder = tmp_path_factory.mktemp("bag")
    (folder / "bag").mkdir()
    for name, content in export("mcap", exported.request(50.0)).items():
        (folder / name).write_bytes(b"".join(content))
    return folder / "bag"


def by_rosbags(bag):
    """Returns messages by topic, each with its time [ns]."""
    found = {}
    with AnyReader([bag]) as reader:
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def by_mcap(bag):
    """Returns the same by the other reader, which finds the definitions within the file."""
    found = {}
    with (bag / "bag.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, value in reader.iter_decoded_messages():
            found.setdefault(channel.topic, []).append((message.log_time, value))
    return found


def seconds(stamp):
    """Returns a time of ROS [s]."""
    return stamp.sec + getattr(stamp, "nanosec", 0) * 1e-9


@pytest.mark.parametrize("read", [by_rosbags, by_mcap])
def test_both_readers_find_the_schedule(exported, bag, read):
    """Joint states, trajectories and events at their times, with the schedule's values."""
    schedule, topics = exported.schedule, read(bag)
    states = topics["/joint_states"]
    time = np.array([at for at, _ in states]) * 1e-9
    names = list(states[0][1].name)
    assert set(names) == set(schedule.robot.limits.joints)
    assert time[0] == 0.0
    assert time[-1] == pytest.approx(schedule.duration, abs=1.1e-9)
    np.testing.assert_allclose([seconds(m.header.stamp) for _, m in states], time, atol=1e-9)
    q, v, _ = schedule.trajectory.select(names).at(time)
    np.testing.assert_allclose([m.position for _, m in states], q, atol=1e-8)
    np.testing.assert_allclose([m.velocity for _, m in states], v, atol=1e-6)
    for arm, part in schedule.robot.arms.items():
        [(at, message)] = topics[f"/{arm}/joint_trajectory"]
        assert at == 0
        assert tuple(message.joint_names) == part.joints
        instants = np.array([seconds(point.time_from_start) for point in message.points])
        expected = schedule.trajectory.select(part.joints).at(instants)[0]
        np.testing.assert_allclose([p.positions for p in message.points], expected, atol=1e-8)
    events = [(at * 1e-9, json.loads(message.data)) for at, message in topics["/events"]]
    assert len(events) == len(schedule.events)
    for (at, row), event in zip(events, schedule.events, strict=True):
        assert at == pytest.approx(event.time, abs=1e-9)
        assert (row["arm"], row["task"], row["action"]) == (event.arm, event.task, event.action)
    [(at, text)] = topics["/robot_description"]
    assert at == 0
    assert text.data == schedule.robot.urdf


@pytest.mark.parametrize("read", [by_rosbags, by_mcap])
def test_chained_transforms_are_the_forward_kinematics(exported, bag, read):
    """From the world over /tf_static and /tf to every link, compared with pinocchio at some instants."""
    robot, topics = exported.schedule.robot, read(bag)
    model = pin.buildModelFromXML(robot.urdf)
    data = model.createData()
    fixed = topics["/tf_static"][0][1].transforms
    states = topics["/joint_states"]
    for k in (0, len(states) // 3, len(states) // 2, len(states) - 1):
        (_, state), (_, moving) = states[k], topics["/tf"][k]
        local = {t.child_frame_id: t for t in (*fixed, *moving.transforms)}
        q = np.zeros(model.nq)
        for name, value in zip(state.name, state.position, strict=True):
            q[model.idx_qs[model.getJointId(name)]] = value
        pin.framesForwardKinematics(model, data, q)
        for frame, placement in zip(model.frames, data.oMf, strict=True):
            if frame.type != pin.FrameType.BODY:
                continue
            pose, name = pin.SE3.Identity(), frame.name
            while name in local:
                about = local[name].transform
                xyz, quat = about.translation, about.rotation
                turn = pin.Quaternion(quat.w, quat.x, quat.y, quat.z).matrix()
                pose = pin.SE3(turn, np.array([xyz.x, xyz.y, xyz.z])) * pose
                name = local[name].header.frame_id
            assert name == "world"
            np.testing.assert_allclose(
                pose.homogeneous, (robot.base * placement).homogeneous, atol=1e-9
            )


def test_a_carried_part_is_where_the_tool_is(exported, bag):
    """After each pick the part's marker is fixed to a link of the arm; at each place it is the world's again."""
    markers = [m for at, row in by_rosbags(bag)["/markers"] for m in row.markers]
    obstacles = {m.id for m in markers if m.ns == "obstacle"}
    assert len(obstacles) >= len(exported.job.cell.obstacles)
    words = [m.text for m in markers if m.ns == "event"]
    events = exported.schedule.events
    assert words == [f"{e.arm}: {e.action} {e.task}" for e in events]
    parts = [m for m in markers if m.ns == "part"]
    if exported.job.cell.parts:
        assert {m.header.frame_id == "world" for m in parts} == {True, False}
