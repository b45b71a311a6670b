"""Task files to jobs."""

from __future__ import annotations

import math
from pathlib import Path

from pydantic import ValidationError

from dualarm_cli.errors import InputError
from dualarm_cli.loading.cells import build_cell
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.documents import read_document, validate
from dualarm_cli.loading.paths import PathReader, check_arms
from dualarm_cli.loading.projects import BadReferenceError, Project, display_name
from dualarm_cli.loading.schema_paths import PathSection
from dualarm_cli.loading.schema_seams import CoordinateSection
from dualarm_cli.loading.schema_tasks import DefaultsSection, DwellSection, TaskSection, TasksFile
from dualarm_cli.loading.seams import SeamReader
from dualarm_cli.loading.targets import TargetReader
from dualarm_cli.loading.task_order import check_order
from dualarm_cli.loading.task_rules import check_settings, check_tasks, permission_notes
from dualarm_cli.loading.text_source import quote, suggest
from dualarm_cli.loading.yaml_source import Document, Loc
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import (
    ANY,
    Action,
    Dwell,
    Job,
    PoseTarget,
    SeamTarget,
    Stop,
    Task,
)
from dualarm_cli.model.place import Place

FREE_START = "free"
"""What a file says where the planner shall choose the start posture."""
SEAM_KEYS = {
    "arm": "it names master and slave itself",
    "approach": "write it into its entry",
    "retract": "write it into its exit",
    "dwell": "write it into its entry and exit",
    "part": "its own part says where the part is held",
}
"""What is said of keys that a coordinate task has elsewhere."""
_ACTIONS: tuple[Action, ...] = ("pick", "place", "move")


def load_job(path: str | Path) -> Job:
    """Returns the job that a task file describes, with its cell and robot.

    Args:
        path: the task file.

    Raises:
        InputError: everything wrong with it and the files that it names.
    """
    project, name = Project.of(Path(path)), str(path)
    document = read_document(project, Path(path), name, "tasks/1")
    findings = Findings()
    findings.extend(document.diagnostics)
    model = validate(document, TasksFile, findings)
    sections = _good_tasks(document, model)
    check_tasks(document, sections, findings)
    if model is not None:
        check_settings(document, model, findings)
    loaded = _load_cell(project, document, Path(path), findings)
    tasks: tuple[Task, ...] = ()
    order_notes: list[str] = []
    if loaded is not None:
        _check_start(document, loaded[0], findings)
        defaults = model.defaults if model is not None else DefaultsSection()
        paths = PathReader(project, Path(path), document, loaded[0], findings)
        tasks = _TaskReader(document, defaults, loaded[0], findings, paths).tasks(sections)
        if not findings.diagnostics and model is not None and model.order == "given":
            order_notes = check_order(document, tasks, findings, model.mode)
    findings.raise_if_any()
    if model is None or loaded is None:
        raise InputError(findings.diagnostics)
    cell, notes = loaded
    caps = [c for c in (cell.tool_speed, model.limits.tool_speed) if c is not None]
    return Job(
        cell,
        tasks,
        model.start,
        model.return_,
        model.speed,
        min(caps, default=None),
        dict(project.inputs),
        (*notes, *permission_notes(model), *order_notes),
        model.mode,
        model.order,
        tuple(tuple(names) for names in model.sequences),
    )


def _good_tasks(document: Document, model: TasksFile | None) -> dict[int, TaskSection]:
    """Returns the tasks that their schema accepts, so that the others do not hide their errors."""
    if model is not None:
        return dict(enumerate(model.tasks))
    raw = document.data.get("tasks")
    good = {}
    for index, entry in enumerate(raw if isinstance(raw, list) else []):
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


def _check_start(document: Document, cell: Cell, findings: Findings) -> None:
    known = [*cell.robot.postures, FREE_START]
    start = document.data.get("start", "home")
    if isinstance(start, str) and start not in known:
        message = (
            f"{cell.robot.name} has no posture {quote(start)}"
            f"{suggest(start, known, 'choose one of')}"
        )
        findings.add(document, ("start",), message)


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
        self._document, self._findings, self._paths = document, findings, paths
        self._defaults, self._robot = defaults, cell.robot
        self._parts = cell.parts
        self._arms = [arm.name for arm in cell.robot.arms]
        self._targets = TargetReader(document, cell, findings)
        self._seams = SeamReader(document, cell, paths)

    def tasks(self, sections: dict[int, TaskSection]) -> tuple[Task, ...]:
        """Returns the tasks in file order."""
        found = []
        for index, section in sections.items():
            loc: Loc = ("tasks", index)
            if section.path is not None:
                found += self._followers(section, section.path, loc)
                continue
            if section.coordinate is not None:
                found += self._partners(section, section.coordinate, loc)
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
            stops = self._stops(section, loc, arm)
            part = self._part(section, loc)
            line, column = self._document.place(loc)
            task = Task(
                section.id,
                arm,
                stops,
                tuple(section.after),
                part,
                not_before=section.not_before or 0.0,
                not_after=math.inf if section.not_after is None else section.not_after,
                place=Place(self._document.source.name, line, column),
            )
            found.append(task)
        return tuple(found)

    def _followers(self, section: TaskSection, path: PathSection, loc: Loc) -> list[Task]:
        """Returns each arm's share of a path task: where its tool ends is its one stop."""
        place: Loc = (*loc, "path")
        wrong = check_arms(dict.fromkeys(self._arms), path, section.arm)
        if section.arm == "any":
            return []
        if wrong:
            self._findings.add(self._document, place, wrong)
            return []
        for key in ("approach", "retract", "dwell", "part"):
            if getattr(section, key) is not None:
                message = f"'{key}' does not go with a path; remove it"
                self._findings.add(self._document, (*loc, key), message)
        work = self._paths.work(path, place, section.arm or path.arm)
        if work is None:
            return []
        found = []
        for arm, way in work.paths.items():
            end = PoseTarget(way.pose(way.length))
            stop = Stop("path", end, 0.0, 0.0, Dwell(), work.place)
            found.append(Task(section.id, arm, (stop,), tuple(section.after), path=work))
        return found

    def _partners(
        self, section: TaskSection, coordinate: CoordinateSection, loc: Loc
    ) -> list[Task]:
        """Returns each arm's share of a coordinate task."""
        for key in ("arm", "approach", "retract", "dwell", "part"):
            if getattr(section, key) is not None:
                instead = SEAM_KEYS.get(key, "remove it")
                message = f"'{key}' does not go with a coordinate task; {instead}"
                self._findings.add(self._document, (*loc, key), message)
        work = self._seams.work(coordinate, (*loc, "coordinate"))
        if work is None:
            return []
        found = []
        for arm in work.arms:
            # The master only holds still while the slave comes, dwells and leaves.
            works = arm == work.slave
            first = Stop(
                "seam_start",
                SeamTarget(work),
                work.approach if works else 0.0,
                0.0,
                Dwell(gripper=work.dwell_start if works else 0.0),
                work.place,
            )
            last = Stop(
                "seam_end",
                SeamTarget(work),
                0.0,
                work.retract if works else 0.0,
                Dwell(gripper=work.dwell_end if works else 0.0),
                work.place,
            )
            found.append(Task(section.id, arm, (first, last), tuple(section.after), seam=work))
        return found

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

    def _stops(self, section: TaskSection, loc: Loc, arm: str) -> tuple[Stop, ...]:
        stops = []
        for action in _ACTIONS:
            target_section = getattr(section, action)
            if target_section is None:
                continue
            if target_section.joints is not None and arm == ANY:
                continue  # the rules across tasks have said so
            target = self._targets.target(target_section, (*loc, action), arm)
            if target is None:
                continue
            line, column = self._document.place((*loc, action))
            place = Place(self._document.source.name, line, column)
            around = self._surroundings(section, action == "move")
            belt = self._targets.belt(target_section, (*loc, action), action)
            stops.append(Stop(action, target, *around, place, belt))
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
