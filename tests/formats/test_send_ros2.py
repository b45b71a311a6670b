"""The documented action client: the goals it builds from real exports, and what it does with a ROS of stubs."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from dualarm_cli.formats import export

SCRIPT = Path(__file__).parents[2] / "docs/scripts/send_ros2.py"
NANO = 10**9


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """Returns the script as a module."""
    spec = importlib.util.spec_from_file_location("send_ros2", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_slower_goal_is_the_plan_on_another_clock(script, exported) -> None:
    """At s times the time: the same position, 1/s of the speed, 1/s² of the acceleration; fields are those of ROS."""
    document = json.loads(b"".join(export("ros2", exported.request(20.0, "quintic"))["left.json"]))
    trajectory = script.goal_fields(document, slower=2.5)["trajectory"]
    fields = {
        name
        for name, _ in get_typestore(Stores.ROS2_HUMBLE)
        .get_msgdef("trajectory_msgs/msg/JointTrajectoryPoint")
        .fields
    }
    assert all(set(point) <= fields for point in trajectory["points"])
    stamps = [point["time_from_start"] for point in trajectory["points"]]
    assert all(0 <= stamp["nanosec"] < NANO for stamp in stamps)
    time = np.array([stamp["sec"] + stamp["nanosec"] / NANO for stamp in stamps])
    assert time[-1] == pytest.approx(2.5 * exported.schedule.duration, abs=1e-8)
    motion = exported.schedule.trajectory.select(exported.schedule.robot.arms["left"].joints)
    position, velocity, _ = motion.at(time / 2.5)
    assert tuple(trajectory["joint_names"]) == motion.joints
    rows = trajectory["points"]
    np.testing.assert_allclose([p["positions"] for p in rows], position, atol=1e-8)
    np.testing.assert_allclose([2.5 * np.array(p["velocities"]) for p in rows], velocity, atol=1e-6)
    plain = [point["accelerations"] for point in document["points"]]
    np.testing.assert_allclose([p["accelerations"] for p in rows], np.array(plain) / 6.25)


def test_a_joint_that_is_elsewhere_a_turn_off_or_unknown_is_named(script) -> None:
    point = {"positions": [0.5, 1.0, -2.0], "velocities": [], "accelerations": []}
    document = {
        "joint_names": ["left_a", "left_b", "c"],
        "points": [point | {"time_from_start": {"sec": 0, "nanosec": 0}}],
    }
    fields = script.goal_fields(document, strip=["left_"])
    assert fields["trajectory"]["joint_names"] == ["a", "b", "c"]
    assert script.start_errors(fields, {"a": 0.505, "b": 0.995, "c": -2.0}, 0.01) == []
    errors = script.start_errors(fields, {"a": 0.5 + 2 * np.pi, "b": float("nan")}, 0.01)
    assert [error.partition(":")[0] for error in errors] == ["c", "a", "b"]


def done(value: object) -> SimpleNamespace:
    """Returns a future that is done."""
    return SimpleNamespace(result=lambda: value, done=lambda: True)


class Ros:
    """Stubs of the modules that the script imports, and what happened in them."""

    def __init__(self, codes: dict[str, int], refused: str = "", positions=None) -> None:
        """Sets what actions return, which of them rejects its goal, and where joints are."""
        self.sent: dict[str, SimpleNamespace] = {}
        self.cancelled: list[str] = []
        self.codes, self.refused, self.positions = codes, refused, positions or {}

    def client(self, node, kind, action):
        """Returns an action client that notes its goal."""

        def send(message):
            self.sent[action] = message
            outcome = SimpleNamespace(error_code=self.codes.get(action, 0), error_string="late")
            return done(
                SimpleNamespace(
                    accepted=action != self.refused,
                    get_result_async=lambda: done(SimpleNamespace(result=outcome)),
                    cancel_goal_async=lambda: self.cancelled.append(action),
                )
            )

        return SimpleNamespace(send_goal_async=send, wait_for_server=lambda timeout_sec: True)

    def modules(self) -> dict[str, object]:
        """Returns the stubs by the names of modules."""
        clock = SimpleNamespace(now=lambda: Instant(100.0))
        node = SimpleNamespace(get_clock=lambda: clock)
        message = SimpleNamespace(name=list(self.positions), position=list(self.positions.values()))
        rclpy = SimpleNamespace(
            init=lambda: None,
            create_node=lambda name: node,
            spin_once=lambda node, timeout_sec: None,
            spin_until_future_complete=lambda node, future, timeout_sec=None: None,
        )
        goal = SimpleNamespace(
            Goal=lambda: SimpleNamespace(trajectory=SimpleNamespace(header=SimpleNamespace()))
        )

        def fill(message, fields):
            message.fields = fields

        return {
            "rclpy": rclpy,
            "rclpy.action": SimpleNamespace(ActionClient=self.client),
            "rclpy.duration": SimpleNamespace(Duration=lambda seconds: seconds),
            "rclpy.wait_for_message": SimpleNamespace(
                wait_for_message=lambda *_, time_to_wait: (True, message)
            ),
            "control_msgs": SimpleNamespace(),
            "control_msgs.action": SimpleNamespace(FollowJointTrajectory=goal),
            "rosidl_runtime_py": SimpleNamespace(set_message_fields=fill),
            "sensor_msgs": SimpleNamespace(),
            "sensor_msgs.msg": SimpleNamespace(JointState=None),
        }


class Instant(float):
    """A time [s]."""

    def __add__(self, seconds):
        """Returns a later time."""
        return Instant(float(self) + seconds)

    def to_msg(self):
        """Returns the time of a message."""
        return float(self)


@pytest.mark.parametrize(
    ("codes", "refused", "shift", "status", "sent", "cancelled"),
    [
        ({}, "", 0.0, 0, {"/l", "/r"}, []),
        ({}, "", 0.1, 1, set(), []),
        ({"/r": -4}, "", 0.0, 1, {"/l", "/r"}, ["/l", "/r"]),
        ({}, "/r", 0.0, 1, {"/l", "/r"}, ["/l"]),
    ],
    ids=["both", "elsewhere", "one fails", "one is rejected"],
)
def test_goals_start_together_or_not_at_all(
    script, exported, tmp_path, codes, refused, shift, status, sent, cancelled
) -> None:
    """One stamp for all; no goal where a joint is elsewhere; the other arm stops where one fails."""
    files = export("ros2", exported.request(20.0))
    positions = {}
    for arm in ("left", "right"):
        (tmp_path / f"{arm}.json").write_bytes(b"".join(files[f"{arm}.json"]))
        document = json.loads((tmp_path / f"{arm}.json").read_text())
        values = np.array(document["points"][0]["positions"]) + shift
        positions |= dict(zip(document["joint_names"], values, strict=True))
    ros = Ros(codes, refused, positions)
    arguments = ["send", f"/l={tmp_path}/left.json", f"/r={tmp_path}/right.json"]
    with patch.dict(sys.modules, ros.modules()), patch.object(sys, "argv", arguments):
        assert script.main() == status
    assert set(ros.sent) == sent
    assert {m.trajectory.header.stamp for m in ros.sent.values()} <= {101.0}
    assert ros.cancelled == cancelled


@pytest.mark.parametrize(
    "arguments",
    [["/a=b"], ["/a=left.json", "--slower", "0.5"], ["/a=left.json", "--strip=l_", "--strip=r_"]],
)
def test_what_cannot_be_sent_is_a_usage_error(arguments, tmp_path) -> None:
    """A file that is none, a motion beyond limits, and names that the prefixes alone tell apart."""
    document = {"joint_names": ["l_j", "r_j"], "points": []}
    (tmp_path / "left.json").write_text(json.dumps(document))
    process = subprocess.run(
        [sys.executable, SCRIPT, *arguments], cwd=tmp_path, capture_output=True, check=False
    )
    assert process.returncode == 2
    assert b"Traceback" not in process.stderr
