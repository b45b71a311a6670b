"""Judge a plan from its files alone: own forward kinematics, own shapes, own rules, no code of the package.

python -m benchmarks.correctness.judge PLAN TASKS

Reads schedule.json and robot.urdf of a plan folder, and the task and cell files that the job was written in, as plain
YAML in metres and radians (as `tests/random_valid_jobs.py` writes them). Looks at knots and at instants 4 ms apart;
coal computes the distances. Prints what is violated, and by how much; exit code 1 if anything is.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import coal
import numpy as np
import yaml

STEP = 0.004
"""Time between two instants [s]."""
LINE = 1.5e-4
"""Distance and angle by which a tool may be beside its line [m, rad]."""
POSE = 5e-6
"""Distance and angle by which a tool may be beside its target [m, rad]."""
DEPTH = 6e-4
"""Depth to which a part may press into what it lies on, and a tool into its own part [m]."""
SLACK = 2e-5
"""Distance by which a sampled clearance may fall short [m]."""


def rotation(rpy: Any) -> np.ndarray:
    """Compute the rotation of roll, pitch and yaw about fixed axes, shape (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    return z @ y @ x


def frame(xyz: Any = (0, 0, 0), rpy: Any = (0, 0, 0)) -> np.ndarray:
    """Compute a homogeneous transform, shape (4, 4)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation(np.asarray(rpy, float)), xyz
    return pose


def frame_of(entry: dict[str, Any]) -> np.ndarray:
    """Compute the transform of a mapping with `xyz` and `rpy`, or with `quat_xyzw`."""
    if "quat_xyzw" not in entry:
        return frame(entry.get("xyz", (0, 0, 0)), entry.get("rpy", (0, 0, 0)))
    x, y, z, w = entry["quat_xyzw"]
    pose = np.eye(4)
    pose[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    pose[:3, 3] = entry["xyz"]
    return pose


def angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute the angle between rotations, shapes (..., 3, 3)."""
    half = np.linalg.norm(a - b, axis=(-2, -1)) / (2 * math.sqrt(2))
    return 2 * np.arcsin(np.minimum(half, 1.0))


@dataclass
class Shape:
    """A convex shape on a link or in the world."""

    body: str
    link: str
    pose: np.ndarray
    geometry: Any
    radius: float
    group: str = "link"


def shapes_of(
    body: str, link: str, entries: list[dict[str, Any]], base: np.ndarray, group: str
) -> list[Shape]:
    """Read the shapes of a cell file: boxes, spheres, cylinders, capsules, half spaces."""
    found = []
    for entry in entries:
        pose = base @ frame_of(entry)
        if "box" in entry:
            size = np.array(entry["box"], float)
            found.append(
                Shape(body, link, pose, coal.Box(*size), float(np.linalg.norm(size) / 2), group)
            )
        elif "sphere" in entry:
            value = entry["sphere"]
            r = value["radius"] if isinstance(value, dict) else value
            found.append(Shape(body, link, pose, coal.Sphere(r), r, group))
        elif "cylinder" in entry or "capsule" in entry:
            kind = "cylinder" if "cylinder" in entry else "capsule"
            r, h = entry[kind]["radius"], entry[kind]["length"]
            make = coal.Cylinder if kind == "cylinder" else coal.Capsule
            found.append(Shape(body, link, pose, make(r, h), r + h / 2, group))
        elif "half_space" in entry:
            n = pose[:3, 2]
            plane = coal.Halfspace(n, float(n @ pose[:3, 3]))
            found.append(Shape(body, link, np.eye(4), plane, math.inf, group))
        else:
            raise ValueError(f"shape {entry}")
    return found


def gap_between(a: Shape, here: np.ndarray, b: Shape, there: np.ndarray) -> float:
    """Compute the distance of two shapes at poses (4, 4) [m]; negative where they overlap."""
    places = [coal.Transform3s(pose[:3, :3], pose[:3, 3]) for pose in (here, there)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    coal.distance(a.geometry, places[0], b.geometry, places[1], request, result)
    return float(result.min_distance)


class Robot:
    """The links of robot.urdf, their motion and their shapes."""

    def __init__(self, path: Path, base: np.ndarray) -> None:
        """Read the links and joints."""
        root = ElementTree.parse(path).getroot()
        self.base, self.joints = base, {}
        for joint in root.findall("joint"):
            origin, axis, limit = joint.find("origin"), joint.find("axis"), joint.find("limit")
            self.joints[joint.find("child").get("link")] = (
                joint.get("name"),
                joint.get("type"),
                joint.find("parent").get("link"),
                self._origin(origin),
                np.array(_floats(axis.get("xyz"))) if axis is not None else np.array([1.0, 0, 0]),
                None if limit is None else {k: float(v) for k, v in limit.attrib.items()},
            )
        self.shapes = []
        for link in root.findall("link"):
            name = link.get("name")
            for collision in link.findall("collision"):
                pose, geometry = (
                    self._origin(collision.find("origin")),
                    collision.find("geometry")[0],
                )
                if geometry.tag == "box":
                    size = _floats(geometry.get("size"))
                    made, r = coal.Box(*size), float(np.linalg.norm(size) / 2)
                elif geometry.tag == "sphere":
                    r = float(geometry.get("radius"))
                    made = coal.Sphere(r)
                elif geometry.tag == "cylinder":
                    r, h = float(geometry.get("radius")), float(geometry.get("length"))
                    made, r = coal.Cylinder(r, h), r + h / 2
                else:
                    raise ValueError(geometry.tag)
                self.shapes.append(Shape(name, name, pose, made, r))

    @staticmethod
    def _origin(element: Any) -> np.ndarray:
        if element is None:
            return np.eye(4)
        return frame(_floats(element.get("xyz", "0 0 0")), _floats(element.get("rpy", "0 0 0")))

    def moving(self, link: str) -> str:
        """Return the link at the joint that moves a link: fixed joints are followed upwards."""
        while link in self.joints and self.joints[link][1] == "fixed":
            link = self.joints[link][2]
        return link

    def parent(self, link: str) -> str | None:
        """Return the moving link before a moving link."""
        return self.moving(self.joints[link][2]) if link in self.joints else None

    def poses(self, positions: dict[str, np.ndarray], count: int) -> dict[str, np.ndarray]:
        """Compute the poses of all links in the world, shapes (count, 4, 4)."""
        found: dict[str, np.ndarray] = {}

        def pose(link: str) -> np.ndarray:
            if link not in found:
                if link not in self.joints:
                    found[link] = np.broadcast_to(self.base, (count, 4, 4))
                else:
                    name, kind, parent, origin, axis, _ = self.joints[link]
                    local = np.broadcast_to(origin, (count, 4, 4))
                    if kind in ("revolute", "continuous"):
                        local = local @ _turn(axis, positions[name])
                    elif kind == "prismatic":
                        shift = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
                        shift[:, :3, 3] = positions[name][:, None] * axis
                        local = local @ shift
                    found[link] = pose(parent) @ local
            return found[link]

        for link in self.joints:
            pose(link)
        return found


def _floats(text: str) -> list[float]:
    return [float(part) for part in text.split()]


def _turn(axis: np.ndarray, q: np.ndarray) -> np.ndarray:
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    made = np.broadcast_to(np.eye(4), (len(q), 4, 4)).copy()
    made[:, :3, :3] += np.sin(q)[:, None, None] * k + (1 - np.cos(q))[:, None, None] * (k @ k)
    return made


@dataclass
class Motion:
    """Knots of every group, followed from anchor to anchor as the reference says."""

    document: dict[str, Any]
    tracks: dict[str, tuple[np.ndarray, ...]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Integrate all groups."""
        for group, part in self.document["motion"].items():
            time, a = np.array(part["time"]), np.array(part["acceleration"])
            stated = {k: i for i, k in enumerate(part["anchor"])}
            q, v = np.zeros_like(a), np.zeros_like(a)
            for k in range(len(time)):
                if k in stated:
                    q[k], v[k] = part["position"][stated[k]], part["velocity"][stated[k]]
                else:
                    h = time[k] - time[k - 1]
                    v[k] = v[k - 1] + h * (a[k - 1] + a[k]) / 2
                    q[k] = q[k - 1] + h * v[k - 1] + h * h * (2 * a[k - 1] + a[k]) / 6
            self.tracks[group] = (time, q, v, a)

    def at(self, times: np.ndarray) -> dict[str, np.ndarray]:
        """Compute the position of every joint at instants."""
        found = {}
        for group, joints in self.document["robot"]["groups"].items():
            time, q, v, a = self.tracks[group]
            k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, len(time) - 1)
            n = np.minimum(k + 1, len(time) - 1)
            dt = (np.minimum(times, time[-1]) - time[k])[:, None]
            h = np.maximum(time[n] - time[k], 1e-300)[:, None]
            jerk = np.where(n[:, None] > k[:, None], (a[n] - a[k]) / h, 0.0)
            position = q[k] + v[k] * dt + a[k] * dt**2 / 2 + jerk * dt**3 / 6
            for i, joint in enumerate(joints):
                found[joint] = position[:, i]
        return found

    def violations(self, limits: dict[str, Any], urdf: dict[str, Any], speed: float) -> list[str]:
        """Compare position, velocity, acceleration and jerk of every joint with its limits, between knots as well."""
        found = []
        for group, joints in self.document["robot"]["groups"].items():
            time, q, v, a = self.tracks[group]
            h = np.diff(time)[:, None]
            ahead_q = q[:-1] + h * v[:-1] + h * h * (2 * a[:-1] + a[1:]) / 6
            ahead_v = v[:-1] + h * (a[:-1] + a[1:]) / 2
            if len(h):
                worst = max(np.abs(ahead_q - q[1:]).max(), np.abs(ahead_v - v[1:]).max())
                if worst > 2e-7:
                    found.append(f"{group}: knots disagree by {worst:.2e}")
            fine = np.unique(
                np.concatenate([np.linspace(0, time[-1], int(time[-1] / 0.001) + 2), time])
            )
            k = np.clip(np.searchsorted(time, fine, side="right") - 1, 0, len(time) - 1)
            n = np.minimum(k + 1, len(time) - 1)
            dt, step = (fine - time[k])[:, None], np.maximum(time[n] - time[k], 1e-300)[:, None]
            jerk = np.where(n[:, None] > k[:, None], (a[n] - a[k]) / step, 0.0)
            velocity = v[k] + a[k] * dt + jerk * dt**2 / 2
            position = q[k] + v[k] * dt + a[k] * dt**2 / 2 + jerk * dt**3 / 6
            for i, joint in enumerate(joints):
                limit, maker = limits[joint], urdf[joint]
                lower, upper = maker.get("lower", -math.inf), maker.get("upper", math.inf)
                over = max(lower - position[:, i].min(), position[:, i].max() - upper)
                if over > 1e-8:
                    found.append(f"{joint}: position {over:.2e} beyond its limit")
                top = min(limit["velocity"], maker["velocity"] * speed)
                if np.abs(velocity[:, i]).max() > top * (1 + 1e-6) + 1e-9:
                    found.append(
                        f"{joint}: velocity {np.abs(velocity[:, i]).max() / top:.6f} of its limit"
                    )
                if np.abs(a[:, i]).max() > limit["acceleration"] * (1 + 1e-6):
                    found.append(
                        f"{joint}: acceleration {np.abs(a[:, i]).max() / limit['acceleration']:.6f}"
                    )
                if limit.get("jerk") is not None:
                    change = np.abs(np.diff(a[:, i])) - limit["jerk"] * h[:, 0]
                    if len(change) and change.max() > 1e-5 * limit["acceleration"]:
                        found.append(
                            f"{joint}: jerk beyond its limit, by {change.max():.2e} rad/s2"
                        )
            for name, rows in (("velocity", v), ("acceleration", a)):
                if max(np.abs(rows[0]).max(), np.abs(rows[-1]).max()) > 1e-7 and name == "velocity":
                    found.append(f"{group}: {name} at an end of the motion")
        return found


class Judge:
    """What the files ask for, compared with what the plan does."""

    def __init__(self, plan: Path, tasks: Path) -> None:
        """Read the files."""
        self.document = json.loads((plan / "schedule.json").read_text())
        self.job = yaml.safe_load(tasks.read_text())
        self.cell = yaml.safe_load((tasks.parent / self.job["cell"]).read_text())
        self.robot = Robot(plan / "robot.urdf", frame_of(self.document["robot"]["base"]))
        self.motion = Motion(self.document)
        self.tasks = {task["id"]: task for task in self.job["tasks"]}
        self.found: list[str] = []
        self.arms = self.document["robot"]["arms"]
        end = self.document["duration"]
        knots = np.concatenate([track[0] for track in self.motion.tracks.values()])
        self.times = np.unique(
            np.concatenate([np.arange(0.0, end, STEP), knots[knots <= end], [end]])
        )
        self.poses = self.robot.poses(self.motion.at(self.times), len(self.times))
        self.events = sorted(self.document["events"], key=lambda e: (e["time"], e["arm"]))

    def defaults(self, key: str, task: dict[str, Any], fallback: Any) -> Any:
        """Return what holds for a task; defaults for targets are not those of moves."""
        if "move" in task and key in ("approach", "retract", "dwell", "straight"):
            return task.get(key, fallback)
        return task.get(key, self.job.get("defaults", {}).get(key, fallback))

    def tcp(self, arm: str, time: float) -> np.ndarray:
        """Return the tool centre point in the flange frame while a tool is mounted, shape (4, 4)."""
        return frame_of(self.tool(arm, time).get("tcp", {}))

    def tool(self, arm: str, time: float) -> dict[str, Any]:
        """Return the entry of the tool that an arm has at an instant: the stand's tool from the end of its taking."""
        changes = self.cell.get("tool_changes", {}).get(arm)
        plain = self.cell.get("tools", {}).get(arm, {})
        if changes is None:
            return plain
        name = changes["start"]
        for event in self.events:
            if event["arm"] == arm and event["action"] in ("take_tool", "leave_tool"):
                if event["time"] + event["dwell"] > time + 1e-9:
                    break
                name = event["task"].split()[1] if event["action"] == "take_tool" else "none"
        return changes["tools"][name] if name != "none" else plain

    def tool_poses(self, arm: str, times: np.ndarray, tcp: np.ndarray) -> np.ndarray:
        """Compute the poses of a tool centre point at instants, shape (n, 4, 4)."""
        links = self.robot.poses(self.motion.at(times), len(times))
        return links[self.arms[arm]["flange"]] @ tcp

    def run(self) -> list[str]:
        """Judge everything; return the violations."""
        urdf = {joint[0]: joint[5] for joint in self.robot.joints.values() if joint[1] != "fixed"}
        speed = self.job.get("speed", 1.0)
        speed = float(speed.strip("%")) / 100 if isinstance(speed, str) else float(speed)
        self.found += self.motion.violations(self.document["robot"]["limits"], urdf, speed)
        self._judge_return()
        self._judge_events()
        self._judge_rules()
        self._judge_clearance()
        return self.found

    def _judge_return(self) -> None:
        start, end = (self.motion.at(np.array([t])) for t in (0.0, self.document["duration"]))
        if self.job.get("return"):
            worst = max(abs(float(start[j][0] - end[j][0])) for j in start)
            if worst > 1e-7:
                self.found.append(f"does not return: {worst:.2e} rad")

    def _judge_events(self) -> None:
        """Compare tools with targets at events, in dwells and on lines."""
        for event in self.events:
            task = self.tasks.get(event["task"])
            if task is None or event["action"] not in {"pick", "place", "move"} & task.keys():
                continue
            target, arm, where = (
                task[event["action"]],
                event["arm"],
                f"{event['task']} {event['action']}",
            )
            if "joints" in target or "at" in target:
                continue
            tcp = self.tcp(arm, event["time"])
            stay = np.linspace(event["time"], event["time"] + event["dwell"], 9)
            asked = frame_of(target)
            belt = self._belt(target)
            offset = np.zeros(3) if belt is None else belt * (event["time"] - target["passes"])
            if belt is not None:
                travelled = float(np.linalg.norm(belt) * (event["time"] - target["passes"]))
                if not -1e-6 <= travelled <= target["within"] + 1e-6:
                    self.found.append(f"{where}: met {travelled:.4f} m along its belt")
            poses = self.tool_poses(arm, stay, tcp)
            moved = (
                asked[:3, 3]
                + offset
                + np.outer(stay - stay[0], np.zeros(3) if belt is None else belt)
            )
            slack = POSE if belt is None else 2e-4
            if "move" in task and not event["dwell"]:
                slack += self.defaults("blend", task, 0.0)
            worst = np.linalg.norm(poses[:, :3, 3] - moved, axis=1).max()
            if worst > slack:
                self.found.append(f"{where}: {worst * 1e3:.4f} mm beside the target")
            turned = self._turned(poses, asked, target)
            if turned > (POSE if belt is None else 2e-4):
                self.found.append(f"{where}: turned by {turned:.2e} rad from the target")
            dwell = self.defaults("dwell", task, 0.0)
            dwell = sum(dwell.values()) if isinstance(dwell, dict) else dwell
            if abs(dwell - event["dwell"]) > 1e-9:
                self.found.append(f"{where}: dwells {event['dwell']} s, not {dwell} s")
            if belt is None:
                for key, side in (("approach", -1), ("retract", 1)):
                    self._judge_line(event, task, key, side, tcp)

    def _belt(self, target: dict[str, Any]) -> np.ndarray | None:
        if "conveyor" not in target:
            return None
        return np.array(self.cell["conveyors"][target["conveyor"]]["velocity"], float)

    @staticmethod
    def _turned(poses: np.ndarray, asked: np.ndarray, target: dict[str, Any]) -> float:
        """Compute the angle from the nearest allowed orientation; all poses have to share one."""
        if target.get("free") == "yaw":
            spins = [math.atan2(*(asked[:3, :3].T @ poses[0, :3, :3])[[1, 0], 0])]
        else:
            count = target.get("symmetry", 1)
            spins = [2 * math.pi * k / count for k in range(count)]
        return float(
            min(angle(poses[:, :3, :3], asked[:3, :3] @ rotation((0, 0, s))).max() for s in spins)
        )

    def _judge_line(
        self, event: dict[str, Any], task: dict[str, Any], key: str, side: int, tcp: Any
    ) -> None:
        """Follow a tool outwards from its target until it is as far out as its straight part is long."""
        length = self.defaults(key, task, 0.0)
        straight = min(length, self.defaults("straight", task, math.inf))
        if straight <= 0.0:
            return
        begin = event["time"] + (event["dwell"] if side > 0 else 0.0)
        times = begin + side * np.arange(0.0, 6.0, 0.001)
        times = times[(times >= 0.0) & (times <= self.document["duration"])]
        poses = self.tool_poses(event["arm"], times, tcp)
        target = self.tool_poses(event["arm"], np.array([begin]), tcp)[0]
        local = np.einsum("ij,nj->ni", target[:3, :3].T, poses[:, :3, 3] - target[:3, 3])
        out = -local[:, 2]
        beyond = np.flatnonzero(out >= straight - 1e-5)
        where = f"{event['task']} {event['action']} {key}"
        if not len(beyond):
            self.found.append(
                f"{where}: comes no further out than {out.max():.4f} m of {straight} m"
            )
            return
        on = slice(0, int(beyond[0]))
        beside = np.linalg.norm(local[on, :2], axis=1).max(initial=0.0)
        turned = angle(poses[on, :3, :3], target[:3, :3]).max(initial=0.0)
        if beside > LINE or turned > LINE:
            self.found.append(
                f"{where}: {beside * 1e3:.3f} mm and {turned:.2e} rad beside its line"
            )

    def _judge_rules(self) -> None:
        """Check that everything is done once, by an allowed arm, in an allowed order, within its times."""
        spans: dict[str, tuple[float, float]] = {}
        for name, task in self.tasks.items():
            events = [e for e in self.events if e["task"] == name]
            stops = [key for key in ("pick", "place", "move", "path", "coordinate") if key in task]
            done = [e["action"] for e in events]
            plain = [key for key in ("pick", "place", "move") if key in task]
            if any(done.count(key) != 1 for key in plain) or not events or not stops:
                self.found.append(f"{name}: done {done}")
                continue
            if plain and len(plain) == 2 and done.index("pick") > done.index("place"):
                self.found.append(f"{name}: placed before it is picked")
            arm = task.get("arm", "any")
            if arm != "any" and "handover" not in task and any(e["arm"] != arm for e in events):
                self.found.append(f"{name}: done by the other arm")
            approach = 0.0
            spans[name] = (events[0]["time"] - approach, events[-1]["time"] + events[-1]["dwell"])
            if events[0]["time"] < task.get("not_before", 0.0) - 1e-6:
                self.found.append(f"{name}: begins at {events[0]['time']:.4f} s")
            # A window is one of the task's first target.
            if events[0]["time"] > task.get("not_after", math.inf) + 1e-6:
                self.found.append(f"{name}: begins at {events[0]['time']:.4f} s")
        for name, task in self.tasks.items():
            for earlier in (
                task.get("after", [])
                if isinstance(task.get("after", []), list)
                else [task["after"]]
            ):
                if name in spans and earlier in spans and spans[name][0] < spans[earlier][1] - 1e-6:
                    self.found.append(f"{name} begins before {earlier} is done")
        for group in self.job.get("sequences", []):
            order = [e["task"] for e in self.events if e["arm"] == self._arm_of(group[0])]
            order = [t for k, t in enumerate(order) if k == 0 or order[k - 1] != t]
            at = [order.index(t) for t in group if t in order]
            if at != list(range(at[0], at[0] + len(group))):
                self.found.append(f"sequence {group} is not done in one run")
        for name, buffer in self.job.get("buffers", {}).items():
            held = buffer.get("initial", 0)
            steps = []
            for event in self.events:
                task = self.tasks.get(event["task"], {})
                target = task.get(event["action"], {})
                if isinstance(target, dict) and target.get("buffer") == name:
                    put = event["action"] == "place"
                    steps.append(
                        (event["time"] + (event["dwell"] if put else 0.0), 1 if put else -1)
                    )
            for _, change in sorted(steps):
                held += change
                if not 0 <= held <= buffer["capacity"]:
                    self.found.append(f"buffer {name} holds {held}")

    def _arm_of(self, task: str) -> str:
        return next((e["arm"] for e in self.events if e["task"] == task), "")

    # Clearance ------------------------------------------------------------------------------------

    def _judge_clearance(self) -> None:
        """Sample the distance of all pairs of bodies that move against each other."""
        required = float(self.cell.get("clearance", 0.0))
        allowed = self._contacts()
        poses = dict(self.poses)
        poses["world"] = np.broadcast_to(np.eye(4), (len(self.times), 4, 4))
        shapes = list(self.robot.shapes)
        for name, entry in self.cell.get("obstacles", {}).items():
            shapes += shapes_of(name, "world", [entry], np.eye(4), "obstacle")
        present: dict[str, np.ndarray] = {}
        near: dict[tuple[str, str], tuple[np.ndarray, float]] = {}
        for arm, part in self.arms.items():
            flange = part["flange"]
            for name, entry, when in self._tools(arm):
                shapes += shapes_of(name, flange, entry.get("shapes", []), np.eye(4), "tool")
                present[name] = when
        for body, link, base, when, entries, touching in self._parts():
            poses.setdefault(link, poses["world"])
            shapes += shapes_of(body, link, entries, base, "part")
            present[body] = when
            near |= {(body, other): mask for other, mask in touching.items()}
        self._compare(shapes, poses, present, near, allowed, required)

    def _compare(
        self, shapes: Any, poses: Any, present: Any, near: Any, allowed: Any, required: float
    ) -> None:
        everywhere = np.ones(len(self.times), bool)
        worst: dict[tuple[str, str], tuple[float, float]] = {}
        for i, a in enumerate(shapes):
            for b in shapes[i + 1 :]:
                if a.body == b.body or not self._checked(a, b, allowed):
                    continue
                when = present.get(a.body, everywhere) & present.get(b.body, everywhere)
                limit = np.full(len(self.times), required)
                pa, pb = poses[a.link] @ a.pose, poses[b.link] @ b.pose
                for one, two in ((a, b), (b, a)):
                    for key in (two.body, two.group, f"{two.body} beyond its lines"):
                        mask, least = near.get((one.body, key), (~everywhere, 0.0))
                        if isinstance(least, int):
                            # No deeper than where the line ends.
                            least = min(0.0, gap_between(a, pa[least], b, pb[least])) - DEPTH
                        limit[mask] = least
                gap = np.linalg.norm(pa[:, :3, 3] - pb[:, :3, 3], axis=1) - a.radius - b.radius
                if math.isinf(a.radius) or math.isinf(b.radius):
                    gap = np.full(len(self.times), -1.0)
                for k in np.flatnonzero(when & (gap < limit)):
                    lack = limit[k] - gap_between(a, pa[k], b, pb[k])
                    if lack > SLACK and lack > worst.get((a.body, b.body), (0.0, 0.0))[0]:
                        worst[a.body, b.body] = (lack, float(self.times[k]))
        for (a, b), (lack, time) in worst.items():
            self.found.append(f"{a} and {b} lack {lack * 1e3:.2f} mm at {time:.3f} s")

    def _checked(self, a: Shape, b: Shape, allowed: set[frozenset[str]]) -> bool:
        """Decide whether a pair of bodies has to keep its clearance."""
        if frozenset((a.body, b.body)) in allowed:
            return False
        one, two = self.robot.moving(a.link), self.robot.moving(b.link)
        if "world" in (a.link, b.link):
            fixed = [s for s in (a, b) if s.link == "world"]
            other = two if a.link == "world" else one
            if len(fixed) == 2:
                return False
            return self.robot.parent(other) is not None
        if one == two:
            return False
        robots = self.robot.parent(one), self.robot.parent(two)
        return robots[0] != two and robots[1] != one

    def _contacts(self) -> set[frozenset[str]]:
        """Read the allowed contacts of the cell and of the robots that it names."""
        found = {frozenset(pair) for pair in self.cell.get("allowed_contacts", [])}
        robots = self.cell["robot"]
        entries = (
            {"": robots}
            if isinstance(robots, str)
            else {f"{k}_": v["robot"] for k, v in robots.items()}
        )
        for prefix, name in entries.items():
            path = Path(__file__).parents[2] / "robots" / name / "robot.yaml"
            file = yaml.safe_load(path.read_text())
            found |= {
                frozenset(prefix + link for link in pair)
                for pair in file.get("allowed_contacts", [])
            }
        return found

    def _tools(self, arm: str) -> list[tuple[str, dict[str, Any], np.ndarray]]:
        """Return the tools that an arm has in turn: name, entry and when."""
        entries = [self.tool(arm, t) for t in self.times]
        found = []
        for k, entry in enumerate({id(e): e for e in entries}.values()):
            when = np.array([e is entry for e in entries])
            found.append((f"{arm}_tool" + (f"#{k}" if k else ""), entry, when))
        return found

    def _line_times(self, event: dict[str, Any], which: str) -> tuple[float, float]:
        """Return when the segments approach, dwell and retract of a target begin and end, as the schedule has them."""
        spans = [
            (s["start"], s["end"])
            for s in self.document["segments"]
            if s["arm"] == event["arm"]
            and s["task"] == event["task"]
            and s["action"] == event["action"]
            and s["kind"] in which.split()
        ]
        spans.append((event["time"], event["time"] + event["dwell"]))
        return min(s[0] for s in spans), max(s[1] for s in spans)

    def _parts(self) -> list[Any]:
        """Return carried parts, waiting parts and placed parts: body, link, pose, when, shapes, allowed touches."""
        found: list[Any] = []
        parts = self.cell.get("parts", {})
        for name, task in self.tasks.items():
            kind = self.defaults("part", task, None) if "pick" in task and "place" in task else None
            if kind is None or "handover" in task:
                continue
            events = {e["action"]: e for e in self.events if e["task"] == name}
            if len(events) != 2:
                continue
            pick, place = events["pick"], events["place"]
            arm, shapes = pick["arm"], parts[kind]["shapes"]
            tcp = self.tcp(arm, pick["time"])
            t = self.times
            pick_line, place_line = (
                self._line_times(pick, "approach dwell retract"),
                self._line_times(place, "approach dwell retract"),
            )
            carried = (t >= pick["time"]) & (t <= place["time"])
            low = carried & ((t <= pick_line[1]) | (t >= place_line[0]))
            body = f"part of {name}"
            found.append(
                (
                    body,
                    self.arms[arm]["flange"],
                    tcp,
                    carried,
                    shapes,
                    {"obstacle": (low, -DEPTH)},
                )
            )
            for label, event, line, sign in (
                ("waiting", pick, pick_line, -1),
                ("placed", place, place_line, 1),
            ):
                target = task[event["action"]]
                if (
                    "conveyor" in target
                    or "buffer" in target
                    or target.get("leaves")
                    or "at" in target
                ):
                    continue
                there = t < event["time"] if sign < 0 else t > event["time"] + event["dwell"]
                pose = self.tool_poses(arm, np.array([event["time"]]), tcp)[0]
                on_line = (t >= line[0]) & (t <= line[1])
                stops = [
                    (e["time"], e["time"] + e["dwell"]) for e in self.events if e["arm"] == arm
                ]
                before = max((end for _, end in stops if end <= event["time"]), default=0.0)
                over = event["time"] + event["dwell"]
                after = min((begin for begin, _ in stops if begin >= over - 1e-9), default=math.inf)
                near = (t >= before) & (t <= after) & ~on_line
                end = int(np.argmin(np.abs(t - line[sign > 0])))
                touching: dict[str, tuple[np.ndarray, float]] = {}
                for tool, _, _ in self._tools(arm):
                    touching |= {
                        f"{tool} beyond its lines": (near, end),
                        tool: (on_line, -math.inf),
                    }
                found.append((f"{label} part of {name}", "world", pose, there, shapes, touching))
        return found


def main() -> None:
    """Judge one plan."""
    parser = argparse.ArgumentParser()
    parser.add_argument("plan", type=Path)
    parser.add_argument("tasks", type=Path)
    arguments = parser.parse_args()
    found = Judge(arguments.plan, arguments.tasks).run()
    print("\n".join(found) or "nothing violated")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
