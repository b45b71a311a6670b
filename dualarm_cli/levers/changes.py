"""Levers of a job: changes of its files that may shorten the cycle.

A lever replaces values as a study does (`files/source/overrides`). Its sizes are what an engineer would try first:
half a length or dwell, 20 mm or 5 degrees of a frame, a fifth more acceleration.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from dualarm_cli.files.source.amounts import read_amount, scaled, shifted
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.source.quantities import QuantityError
from dualarm_cli.files.source.value_paths import PathError, from_pointer, to_pointer, value_at
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.studies.studies import job_documents
from dualarm_cli.model.robot import Robot
from dualarm_cli.model.studies.study import Amount
from dualarm_cli.records import dataclass

LeverKind = Literal["process", "search", "layout", "robot"]
"""Kind of a lever: lines, dwells and limits; arms and order; places; another robot."""


@dataclass(frozen=True)
class LeverSizes:
    """Sizes of the changes that are tried."""

    half: float = 0.5
    """Factor on lengths, gripper times and masses."""
    clearance: float = 0.2
    """Factor on the clearance."""
    faster: float = 1.2
    """Factor on speeds, accelerations and jerks of joints, and on the limit of tool speed."""
    wider: float = 2.0
    """Factor on the deviation at blended targets and corners."""
    shift: str = "20 mm"
    """Displacement of frames along each axis."""
    turn: str = "5 deg"
    """Rotation of frames about the vertical axis."""


SIZES = LeverSizes()
CLEARANCE, MASS, BLEND, START = "clearance", "mass of tools and parts", "blend", "start"
PLAIN_UNITS = {
    **dict.fromkeys(("approach", "retract", "distance", "straight", "blend", "clearance"), "m"),
    **dict.fromkeys(("dwell", "gripper", "settle", "handshake", "skew"), "s"),
    "tool_speed": "m/s",
    "mass": "kg",
}
"""Units of plain numbers, by the key of the value. Accelerations depend on the joint."""


@dataclass(frozen=True)
class Lever:
    """Change of a job's files."""

    name: str
    """Name of the value, such as `gripper` or `frame tray: x`."""
    change: str
    """Old and new value, or the difference."""
    kind: LeverKind
    """Kind of the change."""
    values: Mapping[str, Any]
    """New values, by role and JSON pointer."""
    faster: tuple[str, ...] = ()
    """Joints with a higher speed limit, which only the robot's URDF has."""
    is_indirect: bool = False
    """Whether its gain is in fewer collisions, smaller torques, corners, or limits of single stages."""

    @property
    def is_modelled(self) -> bool:
        """Whether times of motions and dwells show its gain.

        They do not for orders and arms, nor for collisions and torques.
        """
        return self.kind != "search" and not self.is_indirect

    @property
    def is_number(self) -> bool:
        """Whether it changes numbers, so that there are parts of it; names have none."""
        return self.kind != "search" and "tasks:/start" not in self.values

    def excludes(self, lever: Lever) -> bool:
        """Whether both change the same value, or the same lines.

        What of a line is straight is no more than its length.
        """
        of_lines = {self.name, lever.name} - {"approach", "retract", "approach and retract"}
        return of_lines == {"straight"} or not self.values.keys().isdisjoint(lever.values)

    def __str__(self) -> str:
        """Name the lever with its change."""
        return f"{self.name} {self.change}".rstrip()


def documents_of(tasks: Path) -> dict[str, Document]:
    """Read the files of a job by role.

    Args:
        tasks: the task file.

    Raises:
        InputError: the task file cannot be read.
    """
    return job_documents(Project.of(tasks), tasks, tasks.name)


def value_of(documents: Mapping[str, Document], key: str) -> Any:
    """Look up the value that a lever changes; None where the file has none.

    Args:
        documents: files of the job by role.
        key: role and JSON pointer.
    """
    role, _, pointer = key.partition(":")
    data = documents[role].data
    try:
        return value_at(data, from_pointer(data, pointer))
    except PathError:
        return None


def levers(documents: Mapping[str, Document]) -> list[Lever]:
    """List the levers of a job.

    Args:
        documents: files of the job by role.
    """
    places = {role: list(_places(document.data, ())) for role, document in documents.items()}
    return [
        *_lengths(documents, places),
        *_dwells(documents, places),
        *_limits(documents, places),
        *_starts(documents),
        *_decisions(documents["tasks"]),
        *_grasps(documents),
        *(_frames(documents["cell"]) if "cell" in documents else []),
        *_joints(documents),
    ]


def _places(node: Any, loc: Loc) -> Iterator[Loc]:
    """Yield the place of every value of a mapping in a file, outside lists of numbers."""
    entries: Iterable[tuple[str | int, Any]] = ()
    if isinstance(node, dict):
        entries = node.items()
    elif isinstance(node, list):
        entries = enumerate(node)
    for key, value in entries:
        if isinstance(key, str):
            yield (*loc, key)
        yield from _places(value, (*loc, key))


Change = Callable[[Amount], Amount]


def _amount(value: Any) -> Amount | None:
    """Read a number above 0; None for anything else."""
    try:
        amount = read_amount(value)
    except QuantityError:
        return None
    return amount if amount.si > 0.0 else None


def _times(factor: float) -> Change:
    def changed(amount: Amount) -> Amount:
        new = scaled(amount, Amount(factor))
        is_whole = float(new.number).is_integer()
        return replace(new, number=int(new.number)) if is_whole else new

    return changed


def _share(factor: float) -> Change:
    """Multiply a share of full speed or acceleration, up to the whole."""

    def changed(amount: Amount) -> Amount:
        new = _times(factor)(amount)
        return new if new.si < 1.0 else replace(new, number=round(1.0 / new.factor))

    return changed


def _lever(
    name: str,
    kind: LeverKind,
    documents: Mapping[str, Document],
    places: Iterable[tuple[str, Loc]],
    change: Change,
    *,
    is_indirect: bool = False,
) -> list[Lever]:
    """Build the lever that changes the numbers at some places; nothing without any."""
    values, pairs = {}, []
    for role, loc in places:
        value = value_at(documents[role].data, loc)
        # Least, nominal and greatest time of a dwell change together.
        among = (
            [((*loc, k), time) for k, time in enumerate(value)] if isinstance(value, list) else []
        )
        for place, number in among or [(loc, value)]:
            amount = _amount(number)
            if amount is not None:
                new = change(amount)
                values[f"{role}:{to_pointer(place)}"] = new.written
                pairs.append((str(loc[-1]), amount, new))
    return [Lever(name, changed_by(pairs), kind, values, (), is_indirect)] if values else []


def changed_by(pairs: Sequence[tuple[str, Amount, Amount]]) -> str:
    """Describe a change by its old and new value, or by a percentage.

    A percentage, or the least and the greatest, is that of places with different values.

    Args:
        pairs: key, old value and new value of each place.
    """
    words = set()
    for key, old, new in pairs:
        unit = "" if old.unit else PLAIN_UNITS.get(key, "")
        words.add(f"{old.shown} to {new.shown} {unit}".rstrip())
    shares = sorted(new.si / old.si for _, old, new in pairs if old.si)
    if len(words) == 1 or not shares:
        return min(words)
    ends = (f"{100.0 * (share - 1.0):+.3g}%" for share in (shares[0], shares[-1]))
    return " to ".join(dict.fromkeys(ends))


def _named(places: Mapping[str, list[Loc]], role: str, *names: str) -> list[tuple[str, Loc]]:
    return [(role, loc) for loc in places.get(role, []) if loc[-1] in names]


def _lengths(documents: Mapping[str, Document], places: Mapping[str, list[Loc]]) -> Iterator[Lever]:
    """Yield levers of the lengths of lines, in task file and grasps."""
    for names in (("approach",), ("retract",), ("approach", "retract"), ("straight",)):
        lines = [*_named(places, "tasks", *names), *_named(places, "cell", *names)]
        for role in ("tasks", "cell"):
            distances = _named(places, role, "distance")
            lines += [place for place in distances if place[1][-2] in names]
        yield from _lever(" and ".join(names), "process", documents, lines, _times(SIZES.half))


def _dwells(documents: Mapping[str, Document], places: Mapping[str, list[Loc]]) -> Iterator[Lever]:
    """Yield levers of the parts of dwells."""
    whole = _named(places, "tasks", "dwell")
    yield from _lever("dwell", "process", documents, whole, _times(SIZES.half))
    for part, factor in (("gripper", SIZES.half), ("settle", 0.0), ("handshake", 0.0)):
        parts = [place for place in _named(places, "tasks", part) if "dwell" in place[1]]
        yield from _lever(part, "process", documents, parts, _times(factor))


def _limits(documents: Mapping[str, Document], places: Mapping[str, list[Loc]]) -> Iterator[Lever]:
    """Yield levers of speeds, clearance, delays of arms, and masses."""
    caps = [*_named(places, "tasks", "tool_speed"), *_named(places, "cell", "tool_speed")]
    yield from _lever("tool speed", "process", documents, caps, _times(SIZES.faster))
    amount = _amount(documents["tasks"].data.get("speed"))
    slowed = [("tasks", ("speed",))] if amount is not None and amount.si < 1.0 else []
    yield from _lever("speed", "process", documents, slowed, _share(SIZES.faster))
    shares = _named(places, "tasks", "speed", "acceleration")
    careful = [place for place in shares if place[1][0] == "tasks" and len(place[1]) == 3]
    parts = _named(places, "cell", "speed", "acceleration")
    careful += [place for place in parts if "while_holding" in place[1]]
    yield from _lever("care", "process", documents, careful, _share(SIZES.faster), is_indirect=True)
    gap = [place for place in _named(places, "cell", "clearance") if len(place[1]) == 1]
    yield from _lever(
        CLEARANCE, "process", documents, gap, _times(SIZES.clearance), is_indirect=True
    )
    blends = _named(places, "tasks", "blend")
    yield from _lever(BLEND, "process", documents, blends, _times(SIZES.wider), is_indirect=True)
    skew = [place for place in _named(places, "tasks", "skew") if "timing" in place[1]]
    yield from _lever("skew", "process", documents, skew, _times(SIZES.half), is_indirect=True)
    mass = [p for p in _named(places, "cell", "mass") if p[1][0] in ("tools", "parts")]
    yield from _lever(MASS, "process", documents, mass, _times(SIZES.half), is_indirect=True)


def _decisions(document: Document) -> Iterator[Lever]:
    """Yield levers of what the task file decides and the planner could: order, arms, mode."""
    data = document.data
    if data.get("order", "given") == "given":
        yield Lever("order", "given to optimise", "search", {"tasks:/order": "optimise"})
    # The giver of a hand-over and of a bare move stays.
    tasks = [
        (k, task)
        for k, task in enumerate(document.listed("tasks"))
        if isinstance(task, dict)
        and task.get("arm") in ("left", "right")
        and "handover" not in task
    ]
    if tasks:
        values = {f"tasks:/tasks/{k}/arm": "any" for k, _ in tasks}
        yield Lever("arms", "of the file to any", "search", values)
        values = {"tasks:/order": "optimise", **values}
        yield Lever("arms and order", "of the file to any", "search", values)
    mode = data.get("mode", "paired")
    alternative = "free" if mode == "paired" else "paired"
    yield Lever("mode", f"{mode} to {alternative}", "search", {"tasks:/mode": alternative})


def _starts(documents: Mapping[str, Document]) -> Iterator[Lever]:
    """Yield levers of the posture in which a closed cycle begins and ends.

    A free one changes the whole plan.
    """
    data = documents["tasks"].data
    present = data.get("start", "home")
    if data.get("return") is not True or present == "free":
        return
    postures = [
        name
        for role, document in documents.items()
        if role.startswith("robot") and isinstance(document.data.get("postures"), dict)
        for name in document.data["postures"]
    ]
    yield Lever(START, f"{present} to free", "search", {"tasks:/start": "free"})
    for name in dict.fromkeys(postures):
        if name != present:
            change = f"{present} to {name}"
            yield Lever("start posture", change, "process", {"tasks:/start": name})


def _grasps(documents: Mapping[str, Document]) -> Iterator[Lever]:
    """Yield the lever that lets the planner choose among all grasps of parts."""
    parts = documents["cell"].data.get("parts") if "cell" in documents else None
    every = {
        name: list(part["grasps"])
        for name, part in (parts.items() if isinstance(parts, dict) else ())
        if isinstance(part, dict) and isinstance(part.get("grasps"), dict)
    }
    tasks = documents["tasks"]
    defaults = tasks.data.get("defaults")
    values = {}
    for k, task in enumerate(tasks.listed("tasks")):
        if not isinstance(task, dict):
            continue
        part = task.get("part", defaults.get("part") if isinstance(defaults, dict) else None)
        for tool, keys in (("", task), ("/handover", task.get("handover"))):
            if not isinstance(keys, dict) or "grasp" not in keys:
                continue
            chosen = keys["grasp"] if isinstance(keys["grasp"], list) else [keys["grasp"]]
            if len(every.get(part, ())) > len(chosen):
                values[f"tasks:/tasks/{k}{tool}/grasp"] = every[part]
    if values:
        yield Lever("grasps", "of the file to any", "search", values)


def joint_speeds(robot: Robot) -> list[Lever]:
    """List levers of the speed limits of joints: all, of the platform, and each one.

    Args:
        robot: of the job; its URDF has the limits.
    """
    change = f"{SIZES.faster - 1.0:+.0%}"
    groups = {"all joints": robot.joints, "the platform": robot.platform}
    groups |= {joint: (joint,) for joint in robot.joints if joint not in robot.platform}
    return [
        Lever(f"speed of {name}", change, "robot", {}, joints)
        for name, joints in groups.items()
        if joints
    ]


def _frames(cell: Document) -> Iterator[Lever]:
    """Yield levers of the places of frames: along each axis, and about the vertical one."""
    frames = cell.data.get("frames")
    by, turn = read_amount(SIZES.shift), read_amount(SIZES.turn)
    for name, frame in frames.items() if isinstance(frames, dict) else ():
        if not isinstance(frame, dict) or not isinstance(frame.get("xyz"), list):
            continue
        turns = frame.get("rpy", [0, 0, 0])
        for sign, word in ((1, "+"), (-1, "-")):
            for axis, letter in enumerate("xyz"):
                old = read_amount(frame["xyz"][axis])
                new = shifted(old, Amount(sign * by.number, by.unit, by.factor, by.base)).written
                at = f"cell:{to_pointer(('frames', name, 'xyz', axis))}"
                yield Lever(f"frame {name}: {letter}", word + by.shown, "layout", {at: new})
            if "quat" in frame or not isinstance(turns, list):
                continue
            added = Amount(sign * turn.number, turn.unit, turn.factor, turn.base)
            old = read_amount(turns[2])
            yaw: Any = shifted(old, added).written if old.si else added.written
            place: Loc = ("frames", name, "rpy", 2)
            if "rpy" not in frame:
                yaw, place = [0, 0, yaw], place[:-1]
            at = f"cell:{to_pointer(place)}"
            yield Lever(f"frame {name}: yaw", word + turn.shown, "layout", {at: yaw})


def _joints(documents: Mapping[str, Document]) -> Iterator[Lever]:
    """Yield levers of the acceleration and jerk of joints: all, of the platform, and each one."""
    faster = _times(SIZES.faster)
    every: list[tuple[str, Loc]] = []
    for role, document in documents.items():
        limits = document.data.get("limits")
        if not role.startswith("robot") or not isinstance(limits, dict):
            continue
        by_joint = {
            joint: [
                (role, ("limits", joint, key)) for key in ("acceleration", "jerk") if key in rates
            ]
            for joint, rates in limits.items()
            if isinstance(rates, dict)
        }
        every += [place for places in by_joint.values() for place in places]
        platform = document.data.get("platform")
        joints = [platform] if isinstance(platform, str) else platform or []
        turning = [place for joint in joints for place in by_joint.get(joint, [])]
        yield from _lever("acceleration of the platform", "robot", documents, turning, faster)
        for joint, places in by_joint.items():
            if joint not in joints:
                name = f"acceleration of {joint_name(role, joint)}"
                yield from _lever(name, "robot", documents, places, faster)
    yield from _lever("acceleration of all joints", "robot", documents, every, faster)


def joint_name(role: str, joint: str) -> str:
    """Name a joint of a robot file as the robot of the cell has it.

    Args:
        role: of the file: `robot`, or `robot.left` and `robot.right` of a pair.
        joint: its name in the file.
    """
    side = role.partition(".")[2]
    return f"{side}_{joint}" if side and not joint.startswith(f"{side}_") else joint
