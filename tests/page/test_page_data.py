"""The page's data: evaluated as the page does it, it is the schedule."""

from __future__ import annotations

import base64
from dataclasses import replace
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.motion.joint_motion import JointMotion
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.model.shape import Shape
from dualarm_cli.page.packed import joint_knots
from dualarm_cli.page.page_data import without_report
from dualarm_cli.verification.clearance_proof import PROOF


def unpacked(text: str, kind: str = "<f8") -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=kind)


def position(knots: dict[str, str], time: float) -> float:
    """Returns where a joint is at a time: the cubic from the last knot that is not later."""
    t, q, v, a = (unpacked(knots[n]) for n in ("time", "position", "velocity", "acceleration"))
    k = max(0, min(int(np.searchsorted(t, time, "right")) - 1, len(t) - 2))
    dt, span = time - t[k], t[k + 1] - t[k]
    jerk = (a[k + 1] - a[k]) / span if span > 0 else 0.0
    return float(q[k] + dt * (v[k] + dt * (a[k] / 2 + dt * jerk / 6)))


def matrix(row: dict[str, Any]) -> FloatArray:
    """Returns a pose of the data as a homogeneous matrix, by the formula of unit quaternions."""
    x, y, z, w = row["quat"]
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = row["xyz"]
    return found


def body_poses(data: dict[str, Any], time: float) -> list[FloatArray]:
    """Returns where all bodies are, by Rodrigues' formula down the tree."""
    found: list[FloatArray] = []
    for body in data["bodies"]:
        before = np.eye(4) if body["parent"] < 0 else found[body["parent"]]
        moved = np.eye(4)
        if body["joint"] >= 0:
            q = position(data["joints"][body["joint"]]["knots"], time)
            axis = np.array(body["axis"])
            if body["slides"]:
                moved[:3, 3] = q * axis
            else:
                cross = np.cross(np.eye(3), -axis).T
                moved[:3, :3] += np.sin(q) * cross + (1 - np.cos(q)) * cross @ cross
        found.append(before @ matrix(body) @ moved)
    return found


def object_pose(data: dict[str, Any], carried: dict[str, Any], time: float) -> FloatArray:
    """Returns where a carried object is in the world, by its last keyframe."""
    step = [s for s in carried["keyframes"] if s["time"] <= time][-1]
    own = matrix(step)
    if step["body"] >= 0:
        return body_poses(data, time)[step["body"]] @ own
    own[:3, 3] += (time - step["time"]) * np.array(step["velocity"])
    return own


def test_joints_are_where_the_schedule_has_them(shown) -> None:
    """At 300 random times, from fewer knots than the schedule has."""
    rng = np.random.default_rng(0)
    times = rng.uniform(0.0, shown.schedule.duration, 300)
    names = [joint["name"] for joint in shown.data["joints"]]
    expected = shown.schedule.trajectory.select(names).at(times)[0]
    for column, joint in enumerate(shown.data["joints"]):
        found = [position(joint["knots"], t) for t in times.tolist()]
        assert np.abs(found - expected[:, column]).max() < 1e-9
    kept = sum(len(unpacked(joint["knots"]["time"])) for joint in shown.data["joints"])
    assert kept < 0.7 * shown.schedule.trajectory.position.size


def test_tools_are_where_pinocchio_has_them(shown) -> None:
    """The URDF's own kinematics against the data's bodies, to a nanometre."""
    model = pin.buildModelFromXML(shown.schedule.robot.urdf)
    kinematics = model.createData()
    for time in np.random.default_rng(1).uniform(0.0, shown.schedule.duration, 20).tolist():
        q = shown.schedule.trajectory.select(list(model.names)[1:]).at(np.array([time]))[0][0]
        pin.framesForwardKinematics(model, kinematics, q)
        poses = body_poses(shown.data, time)
        for name, arm in shown.schedule.robot.arms.items():
            flange = kinematics.oMf[model.getFrameId(arm.flange, pin.FrameType.BODY)]
            expected = (shown.schedule.robot.base * flange * arm.tcp).homogeneous
            row = shown.data["tcps"][name]
            assert np.abs(poses[row["body"]] @ matrix(row) - expected).max() < 1e-9
            drawn = poses[row["body"]] @ matrix(shown.data["flanges"][name])
            assert np.abs(drawn @ arm.tcp.homogeneous - expected).max() < 1e-9


def test_each_tool_has_a_line(shown) -> None:
    """Its arm, the axis of the flange and the length of the cell file's `tcp`."""
    assert len(shown.data["tools"]) == len(shown.job.cell.robot.arms)
    for arm, line in zip(shown.job.cell.robot.arms, shown.data["tools"], strict=True):
        length = 1e3 * float(np.linalg.norm(shown.job.cell.tools[arm.name].tcp.translation))
        assert line.startswith(f"{arm.name} tool: along +z of {arm.flange}")
        assert f"{length:.4g} mm long" in line


def test_carried_objects_do_not_jump_when_they_change_hands(shown) -> None:
    """Where one keyframe ends the next begins; what an arm lets go is where it was commanded."""
    changes = 0
    for carried in shown.data["objects"]:
        assert carried["keyframes"][0]["time"] == 0.0
        for step in carried["keyframes"][1:]:
            before = object_pose(shown.data, carried, step["time"] - 1e-7)
            after = object_pose(shown.data, carried, step["time"])
            assert np.abs(before - after).max() < 1e-5
            changes += 1
    held = [e for e in shown.data["events"] if e["action"] in ("pick", "place", "take_tool")]
    assert changes >= len(held)


def test_parts_lie_in_the_end_where_they_were_placed(shown) -> None:
    """The pose of the place event; on conveyors they have gone on since. Who took a part over has it elsewhere."""
    end = shown.schedule.duration
    handed = {event["task"] for event in shown.data["events"] if event["action"] == "take"}
    for event in shown.data["events"]:
        if event["action"] != "place" or event["task"] in handed:
            continue
        carried = next(t for t in shown.data["objects"] if t["name"] == event["task"])
        tool = next((t.tool for t in shown.job.tasks if t.id == event["task"]), "")
        gone = (end - event["time"]) * np.array(event.get("velocity", [0.0, 0.0, 0.0]))
        grip = shown.job.cell.T_own_tool(event["arm"], tool).translation
        commanded = matrix({"xyz": event["xyz"], "quat": event["quat_xyzw"]})
        expected = (commanded @ [*grip, 1.0])[:3] + gone
        assert object_pose(shown.data, carried, end)[:3, 3] == pytest.approx(expected, abs=1e-4)


def test_the_clearance_curves_meet_what_is_proven(shown) -> None:
    """At the verifier's instants one is not above what is proven, by its precision, and none anywhere below."""
    proven = shown.schedule.verification.clearances
    least: dict[float, float] = {}
    for curve in shown.data["clearances"]:
        distance = unpacked(curve["distance"], "<f4")
        points = unpacked(curve["points"], "<f4").reshape(-1, 2, 3)
        apart = np.linalg.norm(points[:, 0] - points[:, 1], axis=1)
        outside = distance > 0
        assert apart[outside] == pytest.approx(distance[outside], abs=1e-4)
        required = np.array(curve["required"])[unpacked(curve["pair"], "<u4")]
        for time, margin in zip(unpacked(curve["time"]), distance - required, strict=True):
            least[time] = min(margin, least.get(time, np.inf))
    for stage in proven:
        if stage.required >= 0.0:
            assert least[stage.time] <= stage.margin + PROOF.precision + 1e-6
    assert min(least.values()) >= min(stage.margin for stage in proven) - 1e-6


def test_near_links_are_those_with_few_joints_between_them(shown) -> None:
    """By the joints on the way from one link to the other in the URDF; obstacles and the other arm are never near."""
    parents = {
        joint.find("child").get("link"): (
            joint.find("parent").get("link"),
            joint.get("type") != "fixed",
        )
        for joint in ElementTree.fromstring(shown.job.cell.robot.urdf).iter("joint")
    }

    def way(link: str) -> list[tuple[str, bool]]:
        found = []
        while link in parents:
            found.append((link, parents[link][1]))
            link = parents[link][0]
        return found

    curves = {curve["name"]: curve["pairs"] for curve in shown.data["clearances"]}
    assert list(curves) == ["clearance", "near links"]
    for name, pairs in curves.items():
        for pair in pairs:
            if all(body in parents for body in pair):
                moving = set(way(pair[0])) ^ set(way(pair[1]))
                assert (sum(moves for _, moves in moving) <= 3) == (name == "near links"), pair
            obstacles = {obstacle.name for obstacle in shown.job.cell.obstacles}
            assert name == "clearance" or obstacles.isdisjoint(pair)


def test_knots_of_other_joints_are_left_out_and_jumps_stay() -> None:
    """Two joints: one whose jerk changes once, one whose acceleration jumps; the motion is the same to 1e-10."""
    time = np.array([0.0, 0.5, 1.0, 1.0, 1.5, 2.0])
    acceleration = np.array(
        [[0.0, 1.0], [1.0, 1.0], [2.0, 1.0], [2.0, -1.0], [2.0, -1.0], [2.0, -1.0]]
    )
    velocity, place = np.zeros((6, 2)), np.zeros((6, 2))
    for k in range(5):
        dt = time[k + 1] - time[k]
        a, b = acceleration[k], acceleration[k + 1]
        velocity[k + 1] = velocity[k] + dt * (a + b) / 2
        place[k + 1] = place[k] + dt * velocity[k] + dt**2 * (2 * a + b) / 6
    motion = JointMotion.of(Trajectory(("a", "b"), time, place, velocity, acceleration))
    assert joint_knots(motion, "b")[0].tolist() == [0.0, 1.0, 1.0, 2.0]
    first = joint_knots(motion, "a")
    assert first[0].tolist()[0] == 0.0
    assert 0.5 not in first[0].tolist()


def test_parts_come_and_go_as_the_bodies_that_collide(quick_plan, tasks_folder) -> None:
    """Put into a chute it is gone; out of the chute it is there as the tool comes for it; what waits and lies stays."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    schedule = quick_plan("01_first_pick")
    cell = replace(job.cell, parts={"ball": (Shape("sphere", (0.02,), pin.SE3.Identity()),)})
    plain = replace(job, cell=cell, tasks=tuple(replace(t, part="ball") for t in job.tasks))
    left, right = plain.tasks
    put = replace(left, stops=(left.stops[0], replace(left.stops[1], buffer="chute")))
    take = replace(right, stops=(replace(right.stops[0], buffer="chute"), right.stops[1]))
    chute = replace(plain, tasks=(put, take), buffers={"chute": Buffer(2)})
    place = next(e for e in schedule.events if (e.task, e.action) == (left.id, "place"))
    comes = next(s.start for s in schedule.segments if (s.task, s.kind) == (right.id, "approach"))
    ends = {}
    for name, one in (("plain", plain), ("chute", chute)):
        found = without_report(schedule, one)["objects"]
        steps = [t["keyframes"] for t in found if t["name"] in (left.id, right.id)]
        ends[name] = [[(row[k]["time"], row[k]["body"]) for k in (0, -1)] for row in steps]
    assert [row[0][0] for row in ends["plain"]] == [0.0, 0.0]
    assert all(row[1][1] == -1 for row in ends["plain"])
    assert ends["chute"][0] == [(0.0, -1), (pytest.approx(place.time + place.dwell), None)]
    assert ends["chute"][1][0] == (pytest.approx(comes, abs=5e-3), -1)
    assert ends["chute"][1][1][1] == -1


def test_something_decides_every_instant(shown) -> None:
    """Critical pieces cover the cycle, and every motion and dwell is a piece, as long as its segment at most."""
    data = shown.data
    segments, stages = data["segments"], data["stages"]
    ends = {k: (row["start"], row["end"]) for k, row in enumerate(segments)}
    clock, critical = 0.0, []
    for piece in data["pieces"]:
        start = stages[piece["stage"]]["start"]
        span = ends.get(piece["segment"], (start, start + piece["length"]))
        assert piece["length"] <= span[1] - span[0] + 2e-6
        critical += [span] if piece["slack"] == 0.0 else []
    if data["conveyors"]:
        return  # A part on a belt decides as well.
    for start, end in sorted(critical):
        assert start <= clock + 2e-6
        clock = max(clock, end)
    assert clock == pytest.approx(data["duration"], abs=2e-6)
    present = {piece["segment"] for piece in data["pieces"]}
    assert {k for k, row in enumerate(segments) if row["kind"] != "wait"} <= present
