"""Sends trajectories of `dualarm export --to ros2` to controllers of ROS 2, all with the same start time.

    python send_ros2.py ACTION=FILE.json [ACTION=FILE.json] --slower 4

ACTION is a FollowJointTrajectory action, such as /joint_trajectory_controller/follow_joint_trajectory. Nothing is sent
if a joint is not where its trajectory starts. `--dry-run` prints the goals and needs no ROS.
"""

import argparse
import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

NANO = 10**9
LEAD = 1.0  # time between sending and the common start [s]


def goal_fields(
    document: Mapping[str, Any], slower: float = 1.0, strip: Sequence[str] = ()
) -> dict[str, Any]:
    """Build the fields of a FollowJointTrajectory goal.

    Args:
        document: JointTrajectory of an export.
        slower: factor of the duration, at least 1: the same path at 1/slower of the speed.
        strip: prefixes that the controller's joint names do not have.
    """
    names = list(document["joint_names"])
    for prefix in strip:
        names = [name.removeprefix(prefix) for name in names]
    points = []
    for point in document["points"]:
        time = point["time_from_start"]
        instant = round((time["sec"] * NANO + time["nanosec"]) * slower)
        points.append(
            {
                "positions": point["positions"],
                "velocities": [v / slower for v in point["velocities"]],
                "accelerations": [a / slower**2 for a in point["accelerations"]],
                "time_from_start": {"sec": instant // NANO, "nanosec": instant % NANO},
            }
        )
    return {"trajectory": {"joint_names": names, "points": points}}


def start_errors(
    fields: Mapping[str, Any], positions: Mapping[str, float], tolerance: float
) -> list[str]:
    """List the joints that are not at the start of a trajectory.

    A whole turn off is an error, too: the joint would make that turn.
    """
    trajectory = fields["trajectory"]
    start = dict(zip(trajectory["joint_names"], trajectory["points"][0]["positions"], strict=True))
    missing = [f"{name}: not in the joint states" for name in start if name not in positions]
    return missing + [
        f"{name}: is at {positions[name]:.4f}, the trajectory starts at {value:.4f}"
        for name, value in start.items()
        if name in positions and not abs(positions[name] - value) <= tolerance
    ]


def joint_positions(node: Any, topic: str, names: Sequence[str]) -> dict[str, float]:
    """Read positions from a JointState topic, of which several nodes may publish parts."""
    from rclpy.wait_for_message import wait_for_message
    from sensor_msgs.msg import JointState

    positions: dict[str, float] = {}
    for _ in range(50):
        received, message = wait_for_message(JointState, node, topic, time_to_wait=2.0)
        if not received:
            break
        positions |= dict(zip(message.name, message.position, strict=True))
        if positions.keys() >= set(names):
            break
    return positions


def send(node: Any, goals: Sequence[tuple[str, Mapping[str, Any]]]) -> list[str]:
    """Send all goals with one start time; cancel all if one of them fails. Returns what failed."""
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient
    from rclpy.duration import Duration
    from rosidl_runtime_py import set_message_fields

    clients = [ActionClient(node, FollowJointTrajectory, action) for action, _ in goals]
    for client, (action, _) in zip(clients, goals, strict=True):
        if not client.wait_for_server(timeout_sec=5.0):
            return [f"{action}: no action server"]
    messages = [FollowJointTrajectory.Goal() for _ in goals]
    for message, (_, fields) in zip(messages, goals, strict=True):
        set_message_fields(message, fields)
    start = node.get_clock().now() + Duration(seconds=LEAD)
    for message in messages:
        message.trajectory.header.stamp = start.to_msg()
    sent = [client.send_goal_async(m) for client, m in zip(clients, messages, strict=True)]
    for future in sent:
        rclpy.spin_until_future_complete(node, future)
    handles = [future.result() for future in sent]
    failed = [
        f"{action}: rejected"
        for handle, (action, _) in zip(handles, goals, strict=True)
        if not handle.accepted
    ]
    if not failed and node.get_clock().now() >= start:
        failed = [f"accepted more than {LEAD:g} s after sending; raise LEAD"]
    results = [handle.get_result_async() for handle in handles if not failed]
    try:
        while not failed and not all(future.done() for future in results):
            rclpy.spin_once(node, timeout_sec=0.02)
            failed = _failures(goals, results)
        failed = failed or _failures(goals, results)
    finally:  # also after Ctrl-C
        if failed or not all(future.done() for future in results):
            for handle in handles:
                if handle.accepted:
                    rclpy.spin_until_future_complete(
                        node, handle.cancel_goal_async(), timeout_sec=1.0
                    )
    return failed


def _failures(goals: Sequence[tuple[str, Any]], results: Sequence[Any]) -> list[str]:
    done = [(a, f.result().result) for (a, _), f in zip(goals, results, strict=True) if f.done()]
    return [f"{a}: error {r.error_code} {r.error_string}" for a, r in done if r.error_code != 0]


def main() -> int:
    """Check where the robot is, then send."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("goals", nargs="+", metavar="ACTION=FILE.json")
    parser.add_argument("--slower", type=float, default=4.0, help="factor of the duration")
    parser.add_argument("--strip", action="append", default=[], help="prefix to remove from names")
    parser.add_argument("--states", action="append", help="topic of joint states, for all or each")
    parser.add_argument("--tolerance", type=float, default=0.01, help="at the start [rad or m]")
    parser.add_argument("--dry-run", action="store_true", help="print the goals as JSON")
    options = parser.parse_args()
    if not 1.0 <= options.slower < float("inf"):
        parser.error("--slower: must be at least 1; faster is beyond the limits of the plan")
    goals = []
    for entry in options.goals:
        action, _, file = entry.partition("=")
        if not file.endswith(".json"):
            parser.error(f"{entry}: must be ACTION=FILE.json")
        document = json.loads(Path(file).read_text(encoding="utf-8"))
        fields = goal_fields(document, options.slower, options.strip)
        names = fields["trajectory"]["joint_names"]
        if len(set(names)) < len(names):
            parser.error(f"{file}: --strip makes names of joints equal; send each arm's file")
        goals.append((action, fields))
    topics = options.states or ["/joint_states"]
    if len(topics) not in (1, len(goals)):
        parser.error("--states: name one topic, or one for each goal")
    if options.dry_run:
        print(json.dumps(dict(goals), indent=1))
        return 0

    import rclpy

    rclpy.init()
    node = rclpy.create_node("send_plan")
    problems = []
    for k, (_, fields) in enumerate(goals):
        names = fields["trajectory"]["joint_names"]
        positions = joint_positions(node, topics[k % len(topics)], names)
        problems += start_errors(fields, positions, options.tolerance)
    problems = problems or send(node, goals)
    for problem in problems:
        print(f"error: {problem}", file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
