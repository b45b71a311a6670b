"""Random jobs of every kind of work on five robots, as files: what a careful user could have written.

Targets lie in a box before each arm in which it works well, so that most jobs have a plan. Whether one has is for the
planner to find out; what it must never do with such a file is to crash, or to make a plan that fails verification.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

Document = dict[str, Any]


@dataclass(frozen=True)
class Bench:
    """One robot, its tools and where it works.

    Attributes:
        robot: as the cell file names it.
        near: corners of the box of the left arm's targets [m]; the right arm's has the signs of `mirror`.
        shared: corners of the box that both arms reach [m].
        mirror: signs by which the right arm's positions differ from the left arm's.
        tool: length of the tools [m].
        rpy: roll and pitch of the tools at targets, before a yaw about the world's z axis [rad].
        yaws: how far targets are turned about z [rad].
        line: length of approach and retract [m].
        table: heights of a table's upper face that is below all targets [m], or None.
        changes: whether jobs with tool changes are made for it.
        seams: pose of a part's frame in the left flange for seams [m], or None.
    """

    robot: Any
    near: tuple[tuple[float, float, float], tuple[float, float, float]]
    shared: tuple[tuple[float, float, float], tuple[float, float, float]]
    mirror: tuple[float, float, float] = (1.0, -1.0, 1.0)
    tool: float = 0.12
    rpy: tuple[float, float] = (math.pi, 0.0)
    yaws: float = 0.8
    line: float = 0.06
    table: float | None = None
    changes: bool = False
    seams: bool = False


BENCHES = {
    "sda10f": Bench(
        "sda10f",
        ((0.38, 0.12, 0.80), (0.62, 0.50, 0.95)),
        ((0.50, -0.12, 0.82), (0.62, 0.12, 0.95)),
        table=0.70,
        changes=True,
        seams=True,
    ),
    "iiwa14": Bench(
        {
            "left": {"robot": "iiwa14", "base": {"xyz": [-0.68, 0, 0]}},
            "right": {"robot": "iiwa14", "base": {"xyz": [0.68, 0, 0], "rpy": [0, 0, math.pi]}},
        },
        ((-0.22, 0.08, 0.15), (-0.06, 0.34, 0.35)),
        ((-0.08, -0.15, 0.15), (0.08, 0.15, 0.30)),
        mirror=(-1.0, -1.0, 1.0),
        tool=0.15,
        table=-0.02,
        seams=True,
    ),
    "yumi": Bench(
        "yumi",
        ((0.34, 0.10, 0.05), (0.45, 0.28, 0.14)),
        ((0.36, -0.06, 0.06), (0.44, 0.06, 0.14)),
        tool=0.08,
        line=0.04,
        table=-0.02,
    ),
    "nextage": Bench(
        "nextage",
        ((0.32, 0.12, 0.86), (0.42, 0.28, 0.98)),
        ((0.34, -0.06, 0.88), (0.42, 0.06, 0.98)),
        line=0.05,
        table=0.74,
        changes=True,
    ),
    "openarm": Bench(
        "openarm",
        ((0.34, 0.12, 0.44), (0.46, 0.28, 0.60)),
        ((0.36, -0.04, 0.48), (0.42, 0.04, 0.58)),
        tool=0.08,
        rpy=(math.pi, -math.pi / 2),
        yaws=0.3,
        line=0.04,
    ),
}


def write_random_job(seed: int, folder: Path, bench: Bench | None = None) -> str:
    """Writes cell.yaml and tasks.yaml of one job.

    Args:
        seed: of everything that is drawn; 300 seeds in a row have each kind on each robot that it is made for.
        folder: where; it must exist.
        bench: the robot; one of BENCHES by default.

    Returns:
        What the job is, in a few words.
    """
    names = list(BENCHES)
    name, kind = names[seed % len(names)], KINDS[seed // len(names) % len(KINDS)]
    draw = _Draw(np.random.default_rng([seed, 20]), bench or BENCHES[name])
    cell, tasks = kind(draw)
    (folder / "dualarm.toml").touch()
    for file, document in (("cell.yaml", cell), ("tasks.yaml", tasks)):
        (folder / file).write_text(json.dumps(document, indent=1))  # which is YAML as well
    return f"seed {seed}: {kind.__name__.strip('_')} on {name}, {tasks.get('mode')}, {tasks.get('order')}"


class _Draw:
    """Everything that is drawn for one job."""

    def __init__(self, random: np.random.Generator, bench: Bench) -> None:
        self.random, self.bench = random, bench

    def chance(self, probability: float) -> bool:
        return bool(self.random.random() < probability)

    def one_of(self, *values: Any) -> Any:
        return values[int(self.random.integers(len(values)))]

    def number(self, low: float, high: float) -> float:
        return round(float(self.random.uniform(low, high)), 4)

    def count(self, low: int, high: int) -> int:
        return int(self.random.integers(low, high + 1))

    def arm(self) -> str:
        return str(self.one_of("left", "right"))

    def point(self, arm: str, shared: bool = False) -> list[float]:
        low, high = self.bench.shared if shared else self.bench.near
        point = np.round(self.random.uniform(low, high), 4)
        signs = np.array(self.bench.mirror if arm == "right" and not shared else (1.0, 1.0, 1.0))
        return [float(v) for v in signs * point]

    def pose(self, arm: str, shared: bool = False) -> Document:
        """A target of an arm: tools as the bench has them, any yaw about the tool's axis where it is left open."""
        target: Document = {"xyz": self.point(arm, shared)}
        freedom = self.one_of("none", "yaw", "symmetry")
        yaw = (
            0.0
            if freedom == "none" and self.chance(0.7)
            else self.number(-self.bench.yaws, self.bench.yaws)
        )
        roll, pitch = self.bench.rpy
        target["rpy"] = [roll, pitch, yaw]
        if freedom == "yaw":
            target["free"] = "yaw"
        elif freedom == "symmetry":
            target["symmetry"] = self.one_of(2, 4)
        return target

    def cell(self) -> Document:
        length = self.bench.tool
        tool: Document = {"tcp": {"xyz": [0, 0, length]}}
        if self.chance(0.7):
            capsule = {"radius": 0.02, "length": round(length - 0.05, 4)}
            tool |= {"mass": 0.5, "shapes": [{"capsule": capsule, "xyz": [0, 0, length / 2]}]}
        cell: Document = {
            "dualarm": "cell/1",
            "robot": self.bench.robot,
            "tools": {"left": tool, "right": tool},
        }
        if self.bench.table is not None and self.chance(0.5):
            low, high = self.bench.near
            reach = [max(abs(low[k]), abs(high[k])) for k in (0, 1)]
            middle = (low[0] + high[0]) / 2 if self.bench.mirror[0] > 0 else 0.0
            size = [round(min(2 * reach[0], 0.6), 3), round(2 * reach[1], 3), 0.02]
            place = [round(middle, 3), 0, self.bench.table - 0.01]
            cell["obstacles"] = {"table": {"box": size, "xyz": place}}
        if self.chance(0.5):
            cell["clearance"] = self.one_of(0.0, 0.003, 0.008)
        return cell

    def job(self) -> Document:
        """What stands above the tasks."""
        line = self.bench.line
        defaults: Document = {"approach": line, "retract": line, "dwell": self.number(0.0, 0.3)}
        if self.chance(0.2):
            defaults = {"dwell": {"gripper": 0.1, "settle": 0.03}}
        job: Document = {"dualarm": "tasks/1", "cell": "cell.yaml"}
        job["start"] = self.one_of("home", "home", "free")
        job["return"] = self.chance(0.5)
        if self.chance(0.2):
            job["speed"] = self.one_of("50%", "80%")
        return job | {"defaults": defaults}

    def work(self, name: str, arm: str) -> Document:
        """A task of an arm: a pick and a place, or a move."""
        task: Document = {"id": name, "arm": arm}
        if self.chance(0.25):
            return task | {"move": self.pose(arm)}
        return task | {"pick": self.pose(arm), "place": self.pose(arm, self.chance(0.2))}

    def somebody(self, arm: str) -> str:
        """The arm of a task whose targets are drawn for `arm`: now and then whichever suits."""
        return "any" if self.chance(0.3) else arm


def _tasks(draw: _Draw, count: int, *, open_order: bool) -> list[Document]:
    tasks = []
    for k in range(count):
        arm = draw.arm()
        task = draw.work(f"task-{k}", arm)
        task["arm"] = draw.somebody(arm) if open_order else arm
        tasks.append(task)
    return tasks


def _add_after(draw: _Draw, tasks: list[Document], probability: float) -> None:
    """Lets tasks come after earlier ones, so that the file's order is one that they allow."""
    for k, task in enumerate(tasks[1:], start=1):
        if draw.chance(probability):
            earlier = draw.random.choice(k, size=min(k, draw.count(1, 2)), replace=False)
            task["after"] = [tasks[int(i)]["id"] for i in sorted(earlier)]


def _given(draw: _Draw) -> tuple[Document, Document]:
    """Picks and moves in the file's order, some after others."""
    tasks = _tasks(draw, draw.count(1, 6), open_order=False)
    _add_after(draw, tasks, draw.one_of(0.0, 0.5))
    head = {"mode": draw.one_of("paired", "free"), "order": "given"}
    return draw.cell(), draw.job() | head | {"tasks": tasks}


def _open(draw: _Draw) -> tuple[Document, Document]:
    """The planner's order, some tasks after others, some in sequences."""
    tasks = _tasks(draw, draw.count(2, 6), open_order=True)
    _add_after(draw, tasks, draw.one_of(0.0, 0.3))
    job = draw.job() | {"mode": draw.one_of("paired", "free"), "order": "optimise"}
    if draw.chance(0.2) and len(tasks) > 2 and "after" not in tasks[-1] | tasks[-2]:
        tasks[-1]["arm"] = tasks[-2]["arm"]
        job["sequences"] = [[tasks[-2]["id"], tasks[-1]["id"]]]
    return draw.cell(), job | {"tasks": tasks}


def _windows(draw: _Draw) -> tuple[Document, Document]:
    """Tasks that must not begin before a time, or not after one."""
    order = draw.one_of("given", "optimise")
    tasks = _tasks(draw, draw.count(2, 5), open_order=order == "optimise")
    for task in tasks:
        if draw.chance(0.5):
            task["not_before"] = draw.number(0.0, 6.0)
        if draw.chance(0.2):
            task["not_after"] = draw.number(20.0, 40.0)
    _add_after(draw, tasks, draw.one_of(0.0, 0.3))
    head = {"mode": draw.one_of("paired", "free"), "order": order}
    return draw.cell(), draw.job() | head | {"tasks": tasks}


def _carried(draw: _Draw) -> tuple[Document, Document]:
    """Boxes that arms carry, above a table."""
    cell = draw.cell()
    cell["parts"] = {"box": {"shapes": [{"box": [0.03, 0.03, 0.02], "xyz": [0, 0, 0.012]}]}}
    order = draw.one_of("given", "optimise")
    tasks = _tasks(draw, draw.count(2, 4), open_order=order == "optimise")
    for task in tasks:
        if "pick" in task and draw.chance(0.7):
            task["part"] = "box"
    _add_after(draw, tasks, draw.one_of(0.0, 0.3))
    head = {"mode": draw.one_of("paired", "free"), "order": order}
    return cell, draw.job() | head | {"tasks": tasks}


def _buffered(draw: _Draw) -> tuple[Document, Document]:
    """One arm fills a buffer, the other one empties it."""
    order, count = draw.one_of("given", "optimise"), draw.count(1, 3)
    giver, taker = draw.one_of(("left", "right"), ("right", "left"))
    put, take = draw.pose(giver, shared=True), draw.pose(taker, shared=True)
    initial = draw.one_of(0, 0, 1)
    tasks: list[Document] = []
    for k in range(count):
        place, pick = dict(put) | {"buffer": "chute"}, dict(take) | {"buffer": "chute"}
        tasks.append({"id": f"put-{k}", "arm": giver, "pick": draw.pose(giver), "place": place})
        tasks.append({"id": f"take-{k}", "arm": taker, "pick": pick, "place": draw.pose(taker)})
    if draw.chance(0.4):
        tasks.append({"id": "away", "arm": draw.arm()})
        tasks[-1]["move"] = draw.pose(tasks[-1]["arm"])
    buffers = {"chute": {"capacity": draw.count(max(initial, 1), 3), "initial": initial}}
    head = {"mode": draw.one_of("paired", "free"), "order": order, "buffers": buffers}
    return draw.cell(), draw.job() | head | {"tasks": tasks}


def _handed_over(draw: _Draw) -> tuple[Document, Document]:
    """Parts that go from one arm's tool to the other one's, and other work."""
    cell = draw.cell()
    order = draw.one_of("given", "optimise")
    low, high = np.array(draw.bench.shared[0]), np.array(draw.bench.shared[1])
    middle = np.round((low + high) / 2 + [0.0, 0.0, 0.05], 4)
    tasks: list[Document] = []
    for k in range(draw.count(1, 3)):
        if draw.chance(0.3):
            tasks.extend(_tasks(draw, 1, open_order=False))
            tasks[-1]["id"] = f"other-{k}"
            continue
        giver, taker = draw.one_of(("left", "right"), ("right", "left"))
        # The giving tool points to where the taking arm stands.
        roll = math.pi / 2 if giver == "left" else -math.pi / 2
        meeting = {
            "xyz": [float(v) for v in middle],
            "rpy": [roll, 0, 0] if draw.bench.mirror[0] > 0 else [0, roll, 0],
            "grip": {"xyz": [0, 0, draw.one_of(0.08, 0.104)], "rpy": [math.pi, 0, 0]},
        }
        task = {"id": f"flip-{k}", "arm": giver, "pick": draw.pose(giver)}
        tasks.append(task | {"handover": meeting, "place": draw.pose(taker)})
    _add_after(draw, tasks, draw.one_of(0.0, 0.3))
    head = {"mode": draw.one_of("paired", "paired", "free"), "order": order}
    return cell, draw.job() | head | {"tasks": tasks}


def _conveyed(draw: _Draw) -> tuple[Document, Document]:
    """Parts that are picked from a belt or put onto one while it moves."""
    cell = draw.cell()
    speed = draw.number(0.02, 0.12)
    sideways = draw.bench.mirror[0] > 0
    cell["conveyors"] = {"belt": {"velocity": [0, -speed, 0] if sideways else [0, speed, 0]}}
    order = draw.one_of("given", "optimise")
    tasks: list[Document] = []
    passes = draw.number(0.2, 1.5)
    for k in range(draw.count(1, 4)):
        arm = draw.arm()
        task = draw.work(f"part-{k}", arm)
        stops = [key for key in ("pick", "place") if key in task]
        if stops:
            belt = {"conveyor": "belt", "passes": passes, "within": draw.number(0.1, 0.3)}
            passes = round(passes + draw.number(2.0, 5.0), 3)
            task[draw.one_of(*stops)] |= belt
        tasks.append(task)
    head = {"mode": draw.one_of("paired", "paired", "free"), "order": order}
    return cell, draw.job() | head | {"tasks": tasks}


def _changed_tools(draw: _Draw) -> tuple[Document, Document]:
    """Tools that the left arm changes at stands; jobs without tool changes for robots that they are not made for."""
    if not draw.bench.changes:
        return _open(draw)
    cell = draw.cell()
    roll, pitch = draw.bench.rpy
    tools: Document = {}
    low, high = np.array(draw.bench.near[0]), np.array(draw.bench.near[1])
    for name, length, share in (("fingers", 0.12, (0.1, 0.95)), ("suction", 0.10, (0.7, 1.0))):
        stand = [float(v) for v in np.round(low + (high - low) * [*share, 1.0], 4)]
        stand[2] = round(stand[2] + 0.08, 4)
        tools[name] = {
            "tcp": {"xyz": [0, 0, length]},
            "shapes": [{"cylinder": {"radius": 0.02, "length": 0.05}, "xyz": [0, 0, 0.07]}],
            "stand": {"xyz": stand, "rpy": [roll, pitch, 0]},
        }
    cell["tools"]["left"] = {"tcp": {"xyz": [0, 0, 0.04]}}
    changes = {"start": draw.one_of("fingers", "none"), "time": draw.number(0.2, 0.8)}
    cell["tool_changes"] = {"left": changes | {"approach": 0.06, "retract": 0.06, "tools": tools}}
    order = draw.one_of("given", "optimise")
    tasks = _tasks(draw, draw.count(2, 4), open_order=False)
    for task in tasks:
        if task["arm"] == "left":
            task["tool"] = draw.one_of("fingers", "suction")
    _add_after(draw, tasks, draw.one_of(0.0, 0.3))
    head = {"mode": draw.one_of("paired", "free"), "order": order}
    return cell, draw.job() | head | {"tasks": tasks}


def _paths(draw: _Draw) -> tuple[Document, Document]:
    """Tool paths of one arm or both, between picks."""
    tasks: list[Document] = []
    for k in range(draw.count(1, 3)):
        if draw.chance(0.4):
            tasks.extend(_tasks(draw, 1, open_order=False))
            tasks[-1]["id"] = f"pick-{k}"
            continue
        path: Document = {"speed": draw.number(0.03, 0.15), "slower": "allowed"}
        if draw.chance(0.6):
            path |= {"arm": draw.arm()}
            path["through"] = _way(draw, path["arm"])
        else:
            path |= {arm: {"through": _way(draw, arm)} for arm in ("left", "right")}
        tasks.append({"id": f"path-{k}", "path": path})
    _add_after(draw, tasks, draw.one_of(0.0, 0.3))
    head = {"mode": "paired", "order": draw.one_of("given", "optimise")}
    return draw.cell(), draw.job() | head | {"tasks": tasks}


def _way(draw: _Draw, arm: str) -> list[Document]:
    """A straight line and perhaps a piece of a circle, about level."""
    start = np.array(draw.point(arm))
    roll, pitch = draw.bench.rpy
    first: Document = {"xyz": start.tolist(), "rpy": [roll, pitch, 0]}
    heading = draw.number(-math.pi, math.pi)
    step = draw.number(0.03, 0.08) * np.array([math.cos(heading), math.sin(heading), 0.0])
    end = np.round(start + step, 4)
    way: list[Document] = [first, {"xyz": end.tolist()}]
    if draw.chance(0.5):
        centre = np.round(end + 0.5 * step[[1, 0, 2]] * [1, -1, 1], 4)
        turn = {"about": centre.tolist(), "axis": [0, 0, 1], "angle": draw.number(0.5, 3.0)}
        way.append({"turn": turn | {"tool": "keeps"}})
    return way


def _seams(draw: _Draw) -> tuple[Document, Document]:
    """Seams on a part in the left hand; paths for robots that seams are not made for."""
    if not draw.bench.seams:
        return _paths(draw)
    cell: Document = {
        "dualarm": "cell/1",
        "robot": draw.bench.robot,
        "tools": {"left": {"tcp": {"xyz": [0, 0, 0.1]}}, "right": {"tcp": {"xyz": [0, 0, 0.2]}}},
    }
    radius = draw.number(0.03, 0.07)
    curve = draw.one_of(
        {"kind": "saddle", "main_radius": radius, "branch_radius": round(0.8 * radius, 4)},
        {"kind": "arc", "radius": radius, "begin": 0, "finish": draw.number(1.0, 6.0)},
        {"kind": "ellipse", "semi_axes": [radius, round(0.6 * radius, 4)]},
        {"kind": "line", "start": [0, 0, 0], "end": [radius, 0, 0]},
        {"kind": "spline", "points": [[0, 0, 0], [radius, 0.01, 0], [2 * radius, 0, 0.01]]},
    )
    tool: Document = {"standoff": draw.one_of(0.0, 0.002)}
    if draw.chance(0.7):
        tool["free"] = "spin"
    if draw.chance(0.5):
        tool["tilt"] = draw.number(0.05, 0.3)
    seam: Document = {"master": "left", "slave": "right", "curve": curve, "tool": tool}
    seam |= {"part": {"xyz": [0, 0, 0.2]}, "speed": draw.number(0.02, 0.2), "slower": "allowed"}
    if draw.chance(0.5):
        seam["hold"] = "still"
    if draw.chance(0.5):
        seam |= {"entry": {"approach": 0.03, "dwell": 0.2}, "exit": {"retract": 0.03}}
    tasks: list[Document] = [{"id": "seam", "coordinate": seam}]
    if draw.chance(0.4):
        tasks.extend(_tasks(draw, draw.count(1, 2), open_order=False))
    job = draw.job()
    return cell, job | {"mode": "paired", "order": "given", "tasks": tasks}


KINDS: tuple[Callable[[_Draw], tuple[Document, Document]], ...] = (
    _given,
    _open,
    _windows,
    _carried,
    _buffered,
    _handed_over,
    _conveyed,
    _changed_tools,
    _paths,
    _seams,
    _given,
    _open,
)
