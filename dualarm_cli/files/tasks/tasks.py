"""Task files to jobs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin
from pydantic import ValidationError

from dualarm_cli.errors import InputError
from dualarm_cli.files.cells.cells import build_cell
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import read_document, validate
from dualarm_cli.files.source.fields import to_se3
from dualarm_cli.files.source.overrides import Overrides
from dualarm_cli.files.source.projects import BadReferenceError, Project, display_name
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.buffers import check_buffers, read_buffers
from dualarm_cli.files.tasks.paths import PathReader
from dualarm_cli.files.tasks.schema_tasks import (
    DefaultsSection,
    DwellSection,
    HandoverSection,
    TaskSection,
    TasksFile,
    read_budget,
)
from dualarm_cli.files.tasks.targets import TargetReader
from dualarm_cli.files.tasks.task_rules import (
    check_belt_windows,
    check_settings,
    check_start,
    check_tasks,
    permission_notes,
)
from dualarm_cli.files.tasks.task_tools import ToolChoice, check_tool_changes
from dualarm_cli.files.tasks.work_shares import WorkReader
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.handover import Handover, taken_part, with_taken_part
from dualarm_cli.model.job import (
    ANY,
    Action,
    Dwell,
    Job,
    PoseTarget,
    Stop,
    Task,
    waiting_for_ever,
)
from dualarm_cli.model.place import Place


def check_order(document: Document, job: Job, findings: Findings) -> None:
    """Notes tasks that one arm, or a path between, does before those that they are to come after, and rings of waits.

    Args:
        document: the task file.
        job: what it says, with order: given.
        findings: where errors are noted.
    """
    arms: dict[str, set[str]] = {}
    sections: dict[str, int] = {}
    for number, section in enumerate(job.sections()):
        for task in section:
            arms.setdefault(task.id, set()).add(task.arm)
            sections[task.id] = number
    ids = [e.get("id") if isinstance(e, dict) else None for e in document.listed("tasks")]
    place = {name: number for number, name in reversed(list(enumerate(ids)))}
    wrong = False
    for task in {task.id: task for task in job.tasks}.values():
        for k, name in enumerate(task.after):
            if name not in sections or place[name] < place[task.id]:
                continue
            # Arms wait for one another, but nothing is done beside a path, and each arm keeps the file's order.
            both = arms[name] | arms[task.id]
            shared = ANY in both or arms[name] & arms[task.id]
            if sections[name] == sections[task.id] and not shared:
                continue
            message = (
                f"task {quote(task.id)} is to come after {quote(name)}, but order: given does it first; "
                "change their order in the file"
            )
            findings.add(document, ("tasks", place[task.id], "after", k), message)
            wrong = True
    if not wrong and job.is_decided and (waiting := job.stuck()):
        stuck = next(task for task in waiting if task.after)
        message = waiting_for_ever(waiting).sentence
        findings.add(document, ("tasks", place[stuck.id], "after"), message)


def handover_shares(
    whole: Task,
    taker: str,
    stops: tuple[Stop, Stop],
    meeting: tuple[pin.SE3, pin.SE3],
    place: Place,
) -> list[Task]:
    """Returns the giver's share of a hand-over, pick and give, and the taker's, take and place.

    The taker approaches and grips while the giver stands still; then the giver lets go and retracts.

    Args:
        whole: the task with the giving arm and the part as it is picked, without stops.
        taker: the taking arm.
        stops: the pick and the place.
        meeting: the giving tool's pose in the world, and the taking tool's in the giving one's frame.
        place: where the hand-over is written.
    """
    pick, put = stops
    pose, grip = meeting
    work = Handover(whole.arm, taker, grip, place)
    give = Stop("give", PoseTarget(pose), 0.0, pick.retract, pick.dwell, place)
    take = Stop("take", PoseTarget(pose * grip), pick.approach, 0.0, pick.dwell, place)
    return [
        replace(whole, stops=(pick, give), handover=work),
        replace(
            whole,
            arm=taker,
            stops=(take, put),
            part=taken_part(whole.part, whole.id),
            handover=work,
        ),
    ]


def cell_with_taken_parts(cell: Cell, tasks: tuple[Task, ...]) -> Cell:
    """Returns a cell that knows every part that is handed over also as it hangs in the taking tool.

    Args:
        cell: as its file has it.
        tasks: of the job.
    """
    for task in tasks:
        work = task.handover
        # The giver's share comes first; the taker's part is the one that is made here.
        if work is not None and task.stops[0].action == "pick" and task.part:
            cell = with_taken_part(cell, task.part, task.id, work.grip)
    return cell


_ACTIONS: tuple[Action, ...] = ("pick", "place", "move")


def load_job(
    path: str | Path, name: str | None = None, overrides: Mapping[str, Any] | None = None
) -> Job:
    """Returns the job that a task file describes, with its cell and robot.

    Args:
        path: the task file.
        name: what the user calls it; None for its path.
        overrides: values in place of those in the files, put there before these are checked; see `loading.overrides`.

    Raises:
        InputError: everything wrong with it and the files that it names.
    """
    project, name = Project.of(Path(path)), name or str(path)
    project.overrides = Overrides(overrides)
    document = read_document(project, Path(path), name, "tasks/1")
    findings = Findings()
    findings.extend(document.diagnostics)
    model = validate(document, TasksFile, findings)
    sections = _good_tasks(document, model)
    check_tasks(document, sections, findings)
    check_buffers(document, sections, model, findings)
    if model is not None:
        check_settings(document, model, findings)
    loaded = _load_cell(project, document, Path(path), findings)
    tasks: tuple[Task, ...] = ()
    if loaded is not None:
        check_start(document, loaded[0], findings)
        if model is not None:
            check_tool_changes(document, model, loaded[0], findings)
        defaults = model.defaults if model is not None else DefaultsSection()
        paths = PathReader(project, Path(path), document, loaded[0], findings)
        tasks = _TaskReader(document, defaults, loaded[0], findings, paths).tasks(sections)
    if loaded is not None:
        findings.extend(project.overrides.unused())
    findings.raise_if_any()
    if model is None or loaded is None:
        raise InputError(findings.diagnostics)
    cell, notes = cell_with_taken_parts(loaded[0], tasks), loaded[1]
    buffers, buffer_notes = read_buffers(document, model)
    caps = [c for c in (cell.tool_speed, model.limits.tool_speed) if c is not None]
    job = Job(
        cell,
        tasks,
        model.start,
        model.return_,
        model.speed,
        min(caps, default=None),
        dict(project.inputs),
        (*notes, *permission_notes(model), *buffer_notes),
        model.mode,
        model.order,
        tuple(tuple(names) for names in model.sequences),
        buffers=buffers,
        budget=read_budget(document, model.budget),
    )
    if job.order == "given":
        check_order(document, job, findings)
        findings.raise_if_any()
    return job


def _good_tasks(document: Document, model: TasksFile | None) -> dict[int, TaskSection]:
    """Returns the tasks that their schema accepts, so that the others do not hide their errors."""
    if model is not None:
        return dict(enumerate(model.tasks))
    good = {}
    for index, entry in enumerate(document.listed("tasks")):
        try:
            good[index] = TaskSection.model_validate(entry)
        except ValidationError:
            continue
    return good


def _load_cell(
    project: Project, document: Document, path: Path, findings: Findings
) -> tuple[Cell, tuple[str, ...]] | None:
    """Returns the cell with its notes, or None after noting what is wrong with it."""
    reference = document.data.get("cell")
    if not isinstance(reference, str):
        return None
    try:
        cell_path = project.follow(reference, path)
        return build_cell(project, cell_path, display_name(reference, document.source.name))
    except BadReferenceError as error:
        findings.add(document, ("cell",), str(error), "E500")
    except InputError as error:
        findings.extend(error.diagnostics)
    return None


class _TaskReader:
    """Turns the tasks of one file into nouns."""

    def __init__(
        self,
        document: Document,
        defaults: DefaultsSection,
        cell: Cell,
        findings: Findings,
        paths: PathReader,
    ) -> None:
        self._document, self._findings = document, findings
        self._defaults, self._robot = defaults, cell.robot
        self._parts = cell.parts
        self._arms = [arm.name for arm in cell.robot.arms]
        self._targets = TargetReader(document, cell, findings)
        self._works = WorkReader(document, cell, findings, paths)
        self._tools = ToolChoice(document, cell, defaults.tool, findings)

    def tasks(self, sections: dict[int, TaskSection]) -> tuple[Task, ...]:
        """Returns the tasks in file order."""
        found = []
        for index, section in sections.items():
            loc: Loc = ("tasks", index)
            if section.path is not None:
                found += self._works.followers(section, section.path, loc)
                continue
            if section.coordinate is not None:
                found += self._works.partners(section, section.coordinate, loc)
                continue
            if section.arm is None:
                continue
            if section.arm != ANY and section.arm not in self._arms:
                message = (
                    f"{self._robot.name} has no {section.arm} arm; it has {', '.join(self._arms)}"
                )
                self._findings.add(self._document, (*loc, "arm"), message)
                continue
            # What only one arm can do is that arm's.
            arm = self._arms[0] if section.arm == ANY and len(self._arms) == 1 else section.arm
            if section.handover is not None:
                found += self._handed(section, section.handover, loc, arm)
                continue
            arm, tool = self._tools.choose(section, loc, arm)
            stops = self._stops(section, loc, arm, tool)
            task = self._task(section, loc, arm, stops, self._part(section, loc))
            check_belt_windows(self._document, loc, task, self._findings)
            found.append(replace(task, tool=tool))
        return tuple(found)

    def _task(
        self, section: TaskSection, loc: Loc, arm: str, stops: tuple[Stop, ...], part: str
    ) -> Task:
        line, column = self._document.place(loc)
        return Task(
            section.id,
            arm,
            stops,
            tuple(section.after),
            part,
            not_before=section.not_before or 0.0,
            not_after=math.inf if section.not_after is None else section.not_after,
            place=Place(self._document.source.name, line, column),
        )

    def _handed(
        self, section: TaskSection, handover: HandoverSection, loc: Loc, arm: str
    ) -> list[Task]:
        """Returns each arm's share of a hand-over: pick and give, take and place."""
        place: Loc = (*loc, "handover")
        if len(self._arms) < 2:
            message = f"{self._robot.name} has one arm only; a hand-over takes two"
            self._findings.add(self._document, place, message)
            return []
        taker = ANY if arm == ANY else next(name for name in self._arms if name != arm)
        meets = self._targets.meeting(handover, place)
        stops = {stop.action: stop for stop in self._stops(section, loc, arm, "", taker)}
        whole = self._task(section, loc, arm, (), self._part(section, loc))
        if meets is None or len(stops) < 2:
            return []
        line, column = self._document.place(place)
        return handover_shares(
            whole,
            taker,
            (stops["pick"], stops["place"]),
            (meets, to_se3(handover.grip)),
            Place(self._document.source.name, line, column),
        )

    def _part(self, section: TaskSection, loc: Loc) -> str:
        """Returns the name of the part that is carried, after noting one that the cell does not have."""
        carries = section.pick is not None and section.place is not None
        if section.part is not None and not carries:
            message = "only a pick with its place carries a part; remove 'part'"
            self._findings.add(self._document, (*loc, "part"), message)
        part = section.part if section.part is not None else self._defaults.part
        if part is None or not carries:
            return ""
        if part not in self._parts:
            place: Loc = (*loc, "part") if section.part is not None else ("defaults", "part")
            message = (
                f"the cell has no part {quote(part)}{suggest(part, list(self._parts), 'parts')}"
            )
            self._findings.add(self._document, place, message)
        return part

    def _stops(
        self, section: TaskSection, loc: Loc, arm: str, tool: str, taker: str | None = None
    ) -> tuple[Stop, ...]:
        """Returns the stops of an arm; where another one takes over what it picks, the place is that one's."""
        stops = []
        for action in _ACTIONS:
            target_section = getattr(section, action)
            if target_section is None:
                continue
            if target_section.joints is not None and arm == ANY:
                continue  # the rules across tasks have said so
            by = taker if action == "place" and taker is not None else arm
            target = self._targets.target(target_section, (*loc, action), by)
            if target is None:
                continue
            target = self._tools.seen(target, (*loc, action), arm, tool)
            line, column = self._document.place((*loc, action))
            place = Place(self._document.source.name, line, column)
            around = self._surroundings(section, action == "move")
            belt = self._targets.belt(target_section, (*loc, action), action)
            stops.append(Stop(action, target, *around, place, target_section.buffer or "", belt))
        return tuple(stops)

    def _surroundings(self, section: TaskSection, bare: bool) -> tuple[float, float, Dwell]:
        """Returns approach, retract and dwell; defaults are for picks and places only."""
        approach = 0.0 if bare else self._defaults.approach
        retract = 0.0 if bare else self._defaults.retract
        dwell = DwellSection() if bare else self._defaults.dwell
        dwell = section.dwell if section.dwell is not None else dwell
        return (
            section.approach if section.approach is not None else approach,
            section.retract if section.retract is not None else retract,
            Dwell(dwell.gripper, dwell.settle, dwell.handshake),
        )
