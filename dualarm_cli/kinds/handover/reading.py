"""Hand-overs of task files: giving tool's pose, and taking tool's grip."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from pydantic import Field, model_validator

from dualarm_cli.files.cells.grasps import MOST_GRASPS
from dualarm_cli.files.cells.schema_cell import Line as LineKey
from dualarm_cli.files.source.fields import FramedPose, Name, ToolPose, refuse, to_se3
from dualarm_cli.files.source.short_forms import OneOrMore
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.grasps import (
    allowed_grasps,
    are_posed,
    fitting,
    open_grasps,
    refuse_leaning,
    stop_by_grasp,
)
from dualarm_cli.files.tasks.schema_tasks import TaskHead, TaskSection, TasksFile
from dualarm_cli.files.tasks.task_reader import KindReading, TaskReader
from dualarm_cli.geometry.products import product
from dualarm_cli.model.job import ANY, Job, PoseTarget, Stop, Task
from dualarm_cli.model.lines import Line, LineDirections
from dualarm_cli.model.part_flow import Grasp, Handover, part_as_held
from dualarm_cli.model.place import Place

_NO_FREEDOM = {
    "joints": "two tools meet there, so it must be a pose; give xyz, with rpy or quat",
    "free": "the taking tool's pose follows from the giving one's, so both must be fixed",
    "symmetry": "the taking tool's pose follows from the giving one's, so both must be fixed",
}


class HandoverSection(FramedPose):
    """Place and grip of a hand-over."""

    at: Name | None = Field(
        default=None, description="Named frame that the pose is given in; same as `in`."
    )
    grip: ToolPose | None = Field(
        default=None,
        description="Pose of the taking tool's centre point in the frame of the giving tool's; required for a part "
        "without grasps.",
    )
    grasp: Annotated[list[Name], OneOrMore(), Field(min_length=1)] | None = Field(
        default=None,
        description="Grasp of the taking tool, or a list of grasps to choose from, for a part with grasps; default: "
        "all of the part in the cell file. The pose is then that of the part, and `grip` follows.",
    )
    approach: LineKey | None = Field(
        default=None,
        description="Straight approach of the taking tool [m]; default: that of the place.",
    )
    retract: LineKey | None = Field(
        default=None,
        description="Straight retract of the giving tool [m]; default: that of the pick.",
    )

    @model_validator(mode="before")
    @classmethod
    def _a_pose(cls, value: Any) -> Any:
        for key, why in _NO_FREEDOM.items():
            if isinstance(value, dict) and key in value:
                raise refuse(f"'{key}' does not go with 'handover': {why}", key)
        return value

    @model_validator(mode="after")
    def _whole(self) -> HandoverSection:
        if self.xyz is None:
            raise refuse(
                "the hand-over pose is missing; give xyz, with rpy or quat, of the giving tool"
            )
        if self.in_ is not None and self.at is not None:
            raise refuse("'in' and 'at' both name the frame; keep one", "in")
        if self.grip is None:
            return self
        if self.grasp is not None:
            raise refuse("'grip' follows from 'grasp'; keep one", "grip")
        if self.grip.xyz is None and self.grip.rpy is None and self.grip.quat is None:
            raise refuse(
                "both tools in the same pose; give xyz, rpy or quat of the taking tool in the giving one's frame",
                "grip",
            )
        return self


class HandoverTask(TaskHead):
    """Task with an optional hand-over."""

    handover: HandoverSection | None = Field(
        default=None,
        description="Where the part goes into the other arm's tool: the giving tool's pose, and the grip.",
    )

    @model_validator(mode="after")
    def _picked_and_placed(self) -> HandoverTask:
        missing = [key for key in ("pick", "place") if getattr(self, key) is None]
        if self.handover is not None and missing:
            raise refuse(
                f"'{missing[0]}' is missing: a hand-over has pick, handover and place", code="E202"
            )
        return self


def handed(reader: TaskReader, section: TaskSection, loc: Loc) -> list[Task]:
    """Create each arm's task of a hand-over: pick and give, take and place.

    Args:
        reader: of the file.
        section: the task as the file has it.
        loc: its location in the file.
    """
    assert isinstance(section, HandoverTask) and section.handover is not None  # selected by its key
    handover, place = section.handover, (*loc, "handover")
    arm = reader.arm(section, loc)
    if arm is None:
        return []
    if len(reader.arms) < 2:
        message = f"{reader.cell.robot.name} has one arm only; a hand-over needs two"
        reader.note(place, message)
        return []
    taker = ANY if arm == ANY else next(name for name in reader.arms if name != arm)
    part = reader.part(section, loc)
    refuse_leaning(
        reader, section, loc, "hand-overs have none; remove it, or hand over a part with grasps"
    )
    meets = reader.targets.pose(handover, handover.at, place)
    stops = {stop.action: stop for stop in reader.stops(section, loc, arm, taker)}
    pairs = _pairs(reader, section, handover, loc, part)
    if meets is None or len(stops) < 2 or pairs is None:
        return []
    pick, put = stops["pick"], stops["place"]
    whole, where = reader.task(section, loc, arm, (), part), reader.place(place)

    away = handover.retract and reader.line(handover.retract, (*place, "retract"))
    towards = handover.approach and reader.line(handover.approach, (*place, "approach"))

    def shares(pick: Stop, put: Stop, meeting: tuple[pin.SE3, pin.SE3]) -> list[Task]:
        lines = away or pick.lines[1], towards or put.lines[0]
        return handover_shares(whole, taker, (pick, put), meeting, lines, where)

    if not pairs:
        whole_grip = to_se3(handover.grip or ToolPose())
        return list(*fitting(reader, loc, [tuple(shares(pick, put, (meets, whole_grip)))]))
    choices = []
    for giving, taking in pairs:
        grip = giving.pose.actInv(taking.pose)
        by_giver = stop_by_grasp(reader, section, loc, pick, giving)
        by_taker = stop_by_grasp(reader, section, loc, put, taking)
        pair = shares(by_giver, by_taker, (meets * giving.pose, grip))
        choices.append(_by_grasps(pair, part, (giving, taking)))
    choices = fitting(reader, loc, choices)
    return [open_grasps(share) for share in zip(*choices, strict=True)]


def _by_grasps(shares: list[Task], part: str, grasps: tuple[Grasp, Grasp]) -> tuple[Task, ...]:
    """Set the grasps of a hand-over's shares, and the part as each tool holds it."""
    names = ", ".join(grasp.name for grasp in grasps)
    return tuple(
        replace(share, part=part_as_held(part, grasp.name), grasp=replace(grasp, pair=names))
        for share, grasp in zip(shares, grasps, strict=True)
    )


def _pairs(
    reader: TaskReader, section: TaskSection, handover: HandoverSection, loc: Loc, part: str
) -> list[tuple[Grasp, Grasp]] | None:
    """List the pairs of grasps of giving and taking tool.

    Empty for a part without grasps; None after noting an error. Two tools cannot have the same grasp at once.
    """
    place: Loc = (*loc, "handover")
    if not reader.cell.grasps.get(part):
        named = [where for where, keys in ((loc, section), (place, handover)) if keys.grasp]
        for where in named:
            message = "the part has no grasps; name them in the cell file, or remove 'grasp'"
            reader.note((*where, "grasp"), message)
        if handover.grip is None and not named:
            reader.note(place, "'grip' is missing, or grasps of the part in the cell", "E202")
        return None if named or handover.grip is None else []
    if handover.grip is not None:
        message = f"part {quote(part)} has grasps, from which the grip follows; remove 'grip'"
        reader.note((*place, "grip"), message)
        return None
    giving = allowed_grasps(reader, loc, part, section.grasp)
    taking = allowed_grasps(reader, place, part, handover.grasp)
    if giving is None or taking is None or not are_posed(reader, section, loc):
        return None
    pairs = [(give, take) for give in giving for take in taking if give.name != take.name]
    if not 0 < len(pairs) <= MOST_GRASPS:
        message = (
            f"giving and taking tool have {len(pairs)} pairs of different grasps of part {quote(part)}; 1 to "
            f"{MOST_GRASPS} are allowed: name some with 'grasp' of the task and 'grasp' of 'handover'"
        )
        reader.note(place, message)
        return None
    return pairs


def handover_shares(
    whole: Task,
    taker: str,
    stops: tuple[Stop, Stop],
    meeting: tuple[pin.SE3, pin.SE3],
    lines: tuple[Line, Line],
    place: Place,
) -> list[Task]:
    """Create the giving task, pick and give, and the taking one, take and place.

    The taker approaches and grips while the giver stands still; then the giver lets go and retracts.

    Args:
        whole: the task with the giving arm and the part as it is picked, without stops.
        taker: the taking arm.
        stops: the pick and the place.
        meeting: the giving tool's pose in the world, and the taking tool's in the giving one's frame.
        lines: the giving tool's retract, and the taking one's approach.
        place: of the hand-over in the file.
    """
    pick, put = stops
    pose, grip = meeting
    held = replace(whole, stops=(pick,)).upright
    x, y, z = product(grip.rotation.T, np.array(held or np.zeros(3))).tolist()
    work = Handover(whole.arm, taker, grip, place, (x, y, z) if held else None)
    (away, outward), (towards, inward) = lines
    give = Stop("give", PoseTarget(pose), 0.0, away, pick.dwell, place)
    give = replace(give, directions=LineDirections(retract=outward))
    take = Stop("take", PoseTarget(pose * grip), towards, 0.0, pick.dwell, place)
    take = replace(take, varying=pick.varying, directions=LineDirections(approach=inward))
    return [
        replace(whole, stops=(pick, give), handover=work),
        replace(
            whole,
            arm=taker,
            stops=(take, put),
            part=part_as_held(whole.part, whole.id),
            handover=work,
        ),
    ]


def with_taken_parts(document: Document, model: TasksFile, job: Job) -> Job:
    """Add every handed-over part to the cell as it hangs in the taking tool."""
    cell = job.cell
    for task in job.tasks:
        work = task.handover
        # The giving task comes first; the taking task's part is created here. Held by a grasp it is in the cell.
        gives = task.stops[0].action == "pick" and task.grasp is None
        if work is not None and gives and task.part:
            cell = cell.with_held_part(task.part, task.id, work.grip)
    return replace(job, cell=cell)


READING = KindReading(
    key="handover",
    plural="hand-overs",
    needs=("pick", "place"),
    task_keys=HandoverTask,
    shares=handed,
    job=with_taken_parts,
)
