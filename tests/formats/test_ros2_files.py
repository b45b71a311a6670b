"""JointTrajectory files, read by PyYAML and json, and held against ROS's own message definitions."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from rosbags.typesys import Stores, get_typestore

from dualarm_cli.formats import export


def read(files, name):
    """Returns a file's document."""
    text = b"".join(files[name]).decode()
    return json.loads(text) if name.endswith("json") else yaml.load(text, yaml.CSafeLoader)


def check_type(store, kind, value):
    """Fails where a document is not what a message definition says: its fields, and their types."""
    fields = dict(store.get_msgdef(kind).fields)
    assert set(value) == set(fields)
    for name, (node, about) in fields.items():
        given = value[name]
        if node.name == "NAME":
            check_type(store, about, given)
        elif node.name == "BASE":
            whole = about[0] in ("int32", "uint32")
            assert isinstance(given, int if whole else str)
        else:
            assert isinstance(given, list)
            inner = about[0]
            for one in given:
                if inner[0].name == "NAME":
                    check_type(store, inner[1], one)
                else:
                    assert isinstance(one, {"float64": float, "string": str}[inner[1][0]])


@pytest.mark.parametrize(
    ("form", "interpolation"),
    [("yaml", "linear"), ("json", "linear"), ("json", "cubic"), ("yaml", "quintic")],
)
def test_every_group_is_the_schedule_at_its_points(exported, form, interpolation):
    """Joints, times and values equal those of the schedule; only what the receiver uses is there."""
    request = exported.request(20.0, interpolation)
    files = export("ros2", request)
    robot = exported.schedule.robot
    groups = {name: arm.joints for name, arm in robot.arms.items()}
    groups["both_arms"] = tuple(joint for arm in robot.arms.values() for joint in arm.joints)
    if robot.platform:
        groups["platform"] = robot.platform
    assert set(files) == {f"{group}.{form}" for group in groups for form in ("yaml", "json")}
    store = get_typestore(Stores.ROS2_HUMBLE)
    for group, joints in groups.items():
        document = read(files, f"{group}.{form}")
        check_type(store, "trajectory_msgs/msg/JointTrajectory", document)
        assert tuple(document["joint_names"]) == joints
        points = document["points"]
        stamps = [p["time_from_start"] for p in points]
        time = np.array([s["sec"] + s["nanosec"] * 1e-9 for s in stamps])
        assert time[0] == 0.0
        assert (np.diff(time) > 0).all()
        assert time[-1] == pytest.approx(exported.schedule.duration, abs=1.1e-9)
        rates = exported.schedule.trajectory.select(joints).at(time)
        names = ("positions", "velocities", "accelerations")
        kept = {"linear": 1, "cubic": 2, "quintic": 3}[interpolation]
        for k, name in enumerate(names):
            if k >= kept:
                assert all(point[name] == [] for point in points)
                continue
            # A point in the same nanosecond as a jump of acceleration may be on either side of it.
            slack = {0: 1e-8, 1: 1e-6}.get(k)
            if slack is not None:
                np.testing.assert_allclose([p[name] for p in points], rates[k], atol=slack)
        # Controllers refuse a trajectory that does not end at rest.
        if kept > 1:
            assert np.abs(points[-1]["velocities"]).max() < 1e-7


def test_the_platform_moves_with_the_controller_that_has_it(exported):
    """Of its own, of both arms or of one arm; it is base first."""
    robot = exported.schedule.robot
    for choice, holder in (("own", "platform"), ("both", "both_arms"), ("left", "left")):
        files = export("ros2", exported.request(20.0, platform=choice))
        has = {
            name.removesuffix(".json")
            for name in files
            if name.endswith(".json")
            and set(robot.platform) & set(read(files, name)["joint_names"])
        }
        assert has == ({holder} if robot.platform else set())


def test_points_of_a_uniform_trajectory_are_apart_as_the_rate_says(exported):
    """With --uniform there are none at knots."""
    document = read(export("ros2", exported.request(50.0, uniform=True)), "left.json")
    stamps = [p["time_from_start"] for p in document["points"]]
    time = np.array([s["sec"] * 10**9 + s["nanosec"] for s in stamps])
    assert set(np.diff(time)[:-1].tolist()) == {20_000_000}
