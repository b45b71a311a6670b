"""Carried objects of a page: poses and carriers over time.

They are parts and changed tools.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from dualarm_cli.model.cell import Held
from dualarm_cli.model.job import CHANGES, GIVES, TAKES, Job, PoseTarget, Task
from dualarm_cli.model.lying import lying_parts
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.page.scene import WORLD_BODY, DrawnHulls, drawn, placed, poses_at, tcp
from dualarm_cli.verification.lying_bodies import ExecutedJob

STILL = [0.0, 0.0, 0.0]


def carried_objects(schedule: Schedule, job: Job, hulls: DrawnHulls) -> list[dict[str, Any]]:
    """List every part and changed tool with its keyframes.

    Args:
        schedule: who does what when.
        job: as it was done (`job_as_done`).
        hulls: where hulls of meshes are put.
    """
    follow = _Follower(schedule, job)
    rows = []
    tasks: dict[str, list[Task]] = {}
    for task in job.tasks:
        if not task.is_change:
            tasks.setdefault(task.id, []).append(task)
    for name, shares in tasks.items():
        events = [e for e in schedule.events if e.task == name and e.action in CHANGES]
        if events:
            shapes = job.cell.parts.get(shares[0].part, ())
            drawn_solids = [drawn(shape, pin.SE3.Identity(), hulls) for shape in shapes]
            grips = {task.arm: job.cell.T_own_tool(task.arm, task.tool) for task in shares}
            steps = follow.keyframes(events, grips)
            rows.append({"name": name, "role": "part", "solids": drawn_solids, "keyframes": steps})
    for arm, changes in job.cell.tool_changes.items():
        for tool, changed in changes.tools.items():
            shapes, _ = job.cell.held_shapes(arm, Held(tool))
            drawn_solids = [drawn(shape, pin.SE3.Identity(), hulls) for shape in shapes]
            swaps = {t.id for t in job.tasks if t.is_change and (t.arm, t.tool) == (arm, tool)}
            events = [e for e in schedule.events if e.arm == arm and e.task in swaps]
            if changes.start == tool:
                first = follow.carried(arm, pin.SE3.Identity(), 0.0)
            else:
                first = _lying(changed.stand, 0.0)
            steps = follow.keyframes(events, {arm: pin.SE3.Identity()}, first)
            rows.append({"name": tool, "role": "tool", "solids": drawn_solids, "keyframes": steps})
    return rows


def clip_to_lifetimes(rows: Sequence[dict[str, Any]], motion: ExecutedJob) -> list[dict[str, Any]]:
    """Clip the keyframes of parts to the lifetimes of their bodies in the verification.

    Args:
        rows: of `carried_objects`.
        motion: what was done when.
    """
    shown = []
    lives = {lying.key: motion.lies(lying) for lying in lying_parts(motion.job, motion.visits)}
    for carried in rows:
        steps = [dict(step) for step in carried["keyframes"]]
        for key, event in motion.events.items():
            stop = motion.stops[key][1]
            is_positioned = isinstance(stop.target, PoseTarget) and carried["role"] == "part"
            if key[1] != carried["name"] or not is_positioned or not carried["solids"]:
                continue
            begin, end = lives.get(key, (event.changes_held, event.changes_held))
            if stop.action == "pick":
                offset = begin * np.array(steps[0]["velocity"])
                steps[0] |= {"time": begin, "xyz": (np.array(steps[0]["xyz"]) + offset).tolist()}
            elif stop.action == "place" and end < motion.schedule.duration:
                steps.append({**steps[-1], "time": end, "body": None})
        shown.append({**carried, "keyframes": steps})
    return shown


class _Follower:
    """Tracer of the objects that arms carry."""

    def __init__(self, schedule: Schedule, job: Job) -> None:
        self.cell = job.cell
        self.trajectory = schedule.trajectory.select(job.cell.robot.joints)
        self.model = pin.buildModelFromXML(job.cell.robot.urdf)
        self.arms = [arm.name for arm in job.cell.robot.arms]

    def keyframes(
        self,
        events: Sequence[Event],
        grips: dict[str, pin.SE3],
        first: dict[str, Any] | None = None,
    ) -> list[dict[str, Any]]:
        """Compute the keyframes of an object: its body and pose from each time on.

        Args:
            events: at which its carrier changes.
            grips: by arm, the object's frame in that of the flange-mounted tool centre point.
            first: keyframe at the start; None derives it from the first event.
        """
        steps: list[dict[str, Any]] = [] if first is None else [first]
        for event in sorted(events, key=lambda e: e.changes_held):
            time = event.changes_held
            if not steps:
                steps.append(self._before(event, grips[event.arm]))
            pose = self._pose(steps[-1], time)
            if event.action in TAKES:
                T_tcp_object = self._tcp_pose(event.arm, time).actInv(pose)
                steps.append(self.carried(event.arm, T_tcp_object, time))
            elif event.action != "give":  # a giving arm releases it after the other's grip
                steps.append(_lying(pose, time, event.velocity))
        return steps

    def carried(self, arm: str, T_tcp_object: pin.SE3, time: float) -> dict[str, Any]:
        """Build the keyframe of an object that an arm carries from a time on."""
        body, T_body_tcp = tcp(self.model, self.cell, arm)
        about = {"time": time, "body": body, "velocity": STILL}
        return about | placed(T_body_tcp * T_tcp_object)

    def _before(self, event: Event, grip: pin.SE3) -> dict[str, Any]:
        """Derive the first keyframe from the first event: lying, or carried by the arm."""
        if event.action in GIVES:
            return self.carried(event.arm, grip, 0.0)
        pose = self._tcp_pose(event.arm, event.time) * grip
        back = pin.SE3(np.eye(3), -event.time * np.array(event.velocity))
        return _lying(back * pose, 0.0, event.velocity)

    def _tcp_pose(self, arm: str, time: float) -> pin.SE3:
        body, T_body_tcp = tcp(self.model, self.cell, arm)
        return self._bodies(time)[body] * T_body_tcp

    def _pose(self, step: dict[str, Any], time: float) -> pin.SE3:
        """Compute the world pose of an object at a time after its last keyframe."""
        pose = pin.SE3(pin.Quaternion(np.array(step["quat"])).matrix(), np.array(step["xyz"]))
        if step["body"] != WORLD_BODY:
            return self._bodies(time)[step["body"]] * pose
        offset = (time - step["time"]) * np.array(step["velocity"])
        return pin.SE3(np.eye(3), offset) * pose

    def _bodies(self, time: float) -> Sequence[pin.SE3]:
        positions = self.trajectory.clamped(np.array([time]))[0][0]
        return poses_at(self.model, self.cell.robot, self.cell.base, positions)


def _lying(
    pose: pin.SE3, time: float, velocity: Sequence[float] = (0.0, 0.0, 0.0)
) -> dict[str, Any]:
    about = {"time": time, "body": WORLD_BODY, "velocity": list(velocity)}
    return about | placed(pose)
