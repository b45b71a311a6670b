"""Reader of tasks, with the extensions of each kind of work."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Annotated, Any

from pydantic import create_model, model_validator

from dualarm_cli.files.cells.cell_frames import read_line
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import LineSection, refuse
from dualarm_cli.files.source.short_forms import ShortForm
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.curves import CurveReader
from dualarm_cli.files.tasks.grasps import fitting, grasped, open_grasps
from dualarm_cli.files.tasks.schema_tasks import (
    SIGNAL_KEYS,
    DefaultsSection,
    DwellSection,
    TargetSection,
    TaskHead,
    TaskSection,
    TasksFile,
)
from dualarm_cli.files.tasks.target_reader import TargetReader
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.dwell import Dwell, TimeRange
from dualarm_cli.model.job import ANY, Action, Job, JointTarget, Stop, Task
from dualarm_cli.model.lines import Line, LineDirections
from dualarm_cli.model.part_flow import kind_of_part
from dualarm_cli.model.place import Place
from dualarm_cli.records import dataclass

ACTIONS: tuple[Action, ...] = ("pick", "place", "move")
"""Actions of the core's own task keys."""


@dataclass(frozen=True)
class KindReading:
    """Keys, checks and readers that one kind of work adds to task files."""

    key: str = ""
    """Key of its tasks; empty if it only extends others."""
    plural: str = ""
    """Name of such tasks in messages."""
    needs: tuple[str, ...] = ()
    """Core keys that its tasks require."""
    task_keys: type[TaskHead] = TaskHead
    """Section with the additional keys of a task."""
    target_keys: type[TargetSection] = TargetSection
    """Section with the additional keys of a target."""
    defaults_keys: type[DefaultsSection] = DefaultsSection
    """Section with the additional keys of the defaults."""
    file_keys: type[TasksFile] = TasksFile
    """Section with the additional keys of the file."""
    check: Callable[[Document, Mapping[int, TaskSection], TasksFile | None, Findings], None] = (
        lambda document, tasks, model, findings: None
    )
    """Check across tasks, which notes errors; the file's content is None if its schema rejects it.
    """
    check_cell: Callable[[Document, TasksFile, Cell, Findings], None] = (
        lambda document, model, cell, findings: None
    )
    """Check against the cell, which notes errors."""
    shares: Callable[[TaskReader, TaskSection, Loc], list[Task]] = lambda reader, section, loc: []
    """Reader of a task of this kind: the share of each arm."""
    stop: Callable[[TaskReader, TargetSection, Loc, Stop], Stop] = (
        lambda reader, section, loc, stop: stop
    )
    """Extension of the stop of a target."""
    task: Callable[[TaskReader, TaskSection, Loc, Task], Task] = lambda reader, section, loc, task: (
        task
    )
    """Extension of a task of the core."""
    job: Callable[[Document, TasksFile, Job], Job] = lambda document, model, job: job
    """Extension of the job, after all checks."""


@dataclass(frozen=True)
class Schemas:
    """Sections of task files with the keys of all kinds of work."""

    file: type[TasksFile]
    """Section of the whole file."""
    task: type[TaskSection]
    """Section of a task."""
    defaults: type[DefaultsSection]
    """Section of the defaults."""


@cache
def schemas_of(kinds: tuple[KindReading, ...]) -> Schemas:
    """Build the core's sections with the keys of the given kinds."""
    target = _with(TargetSection, [kind.target_keys for kind in kinds])
    one_kind = model_validator(mode="after")(_one_kind_of(kinds))
    task = _with(
        TaskHead,
        [kind.task_keys for kind in kinds],
        TaskSection,
        {"one_kind": one_kind},
        pick=target | None,
        place=target | None,
        move=Annotated[target, ShortForm("posture")] | None,
    )
    defaults = _with(DefaultsSection, [kind.defaults_keys for kind in kinds])
    file = _with(
        TasksFile,
        [kind.file_keys for kind in kinds],
        defaults=defaults,
        tasks=list[task],  # type: ignore[valid-type]
    )
    return Schemas(file, task, defaults)


def _with(
    core: type[Any],
    kinds: Sequence[type[Any]],
    rest: type[Any] | None = None,
    validators: Any = None,
    **fields: Any,
) -> Any:
    """Build a section of the core with the keys of kinds.

    The keys of the kinds come before those of `rest`; `fields` replace types.
    """
    added = [kind for kind in reversed(kinds) if kind is not core]
    whole = rest or core
    changed: dict[str, Any] = {
        name: (type_, core.model_fields[name]) for name, type_ in fields.items()
    }
    return create_model(
        whole.__name__,
        __base__=(*([rest] if rest else []), *(added or [core])),
        __doc__=whole.__doc__,
        __validators__=validators,
        **changed,
    )


def _one_kind_of(kinds: Sequence[KindReading]) -> Callable[[TaskSection], TaskSection]:
    """Build the rule that a task has exactly one kind of work.

    A task needs an arm, unless its kind names the arms.
    """
    keyed = [kind for kind in kinds if kind.key]
    core = {"pick": ("place",), "place": ("pick",), **{kind.key: kind.needs for kind in keyed}}
    arms_named = {kind.key for kind in of_kinds("reading", "any")}

    def check_one_kind(section: TaskSection) -> TaskSection:
        keys = (*ACTIONS, *(kind.key for kind in keyed))
        given = [key for key in keys if getattr(section, key) is not None]
        if not given:
            alone = [kind.key for kind in keyed if not kind.needs]
            others = ", ".join(["pick and place", "move", *alone[:-1]])
            raise refuse(f"nothing to do; give {others}, or {alone[-1]}")
        first = next((kind.key for kind in keyed if kind.needs and kind.key in given), given[0])
        more = [key for key in given if key not in (first, *core.get(first, ()))]
        if more:
            raise refuse(f"'{more[0]}' does not go with '{first}'; make two tasks", more[0])
        if section.arm is None and not arms_named.intersection(given):
            raise refuse("'arm' is missing", code="E202")
        return section

    return check_one_kind


class TaskReader:
    """Converter of the tasks of one file to data."""

    def __init__(
        self,
        document: Document,
        targets: TargetReader,
        findings: Findings,
        defaults: DefaultsSection,
        curves: CurveReader,
    ) -> None:
        """Store a file, its cell and the list of errors.

        Args:
            document: the task file.
            targets: reads targets; has the cell with arms and parts.
            findings: where errors are noted.
            defaults: default values of tasks.
            curves: reads curves.
        """
        self.document, self.cell, self.findings = document, targets.cell, findings
        self.defaults, self.curves, self.targets = defaults, curves, targets
        self.arms = [arm.name for arm in self.cell.robot.arms]
        self._kinds: list[KindReading] = of_kinds("reading")

    def note(self, loc: Loc, message: str, code: str = "E300") -> None:
        """Note an error at a place of the file."""
        self.findings.add(self.document, loc, message, code)

    def place(self, loc: Loc) -> Place:
        """Look up the place of a value in the file."""
        return Place(self.document.source.name, *self.document.place(loc))

    def tasks(self, sections: Mapping[int, TaskSection]) -> tuple[Task, ...]:
        """Read the tasks in file order.

        Args:
            sections: valid tasks by their index in the file.
        """
        tasks: list[Task] = []
        for index, section in sections.items():
            loc: Loc = ("tasks", index)
            kinds = [
                kind for kind in self._kinds if kind.key and getattr(section, kind.key) is not None
            ]
            if kinds:
                tasks += self.signalled(kinds[0].shares(self, section, loc), section, loc)
                continue
            if (arm := self.arm(section, loc)) is None:
                continue
            stops = self.stops(section, loc, arm)
            task = self.task(section, loc, arm, stops, self.part(section, loc))
            choices = grasped(self, section, loc, task)
            for kind in self._kinds:
                choices = [kind.task(self, section, loc, choice) for choice in choices]
            choices = [choice for (choice,) in fitting(self, loc, [(c,) for c in choices])]
            tasks.append(open_grasps(self.signalled(choices, section, loc)))
        return tuple(tasks)

    def signalled(self, shares: Sequence[Task], section: TaskSection, loc: Loc) -> list[Task]:
        """Add its signals to each arm's share of a task; note unused signals.

        Args:
            shares: of one task.
            section: the task as the file has it.
            loc: where it stands.
        """
        sources = [
            source for source in (section.signals, self.defaults.signals) if source is not None
        ]
        actions = {stop.action for task in shares for stop in task.stops}
        used = {key for action in actions for key in SIGNAL_KEYS.get(action, ())}
        for key in section.signals.model_fields_set if section.signals and actions else ():
            if key not in used:
                message = f"the task never sets this signal: it has {' and '.join(sorted(actions))}"
                self.note((*loc, "signals", key), message)

        def signal(action: str) -> str:
            keys = SIGNAL_KEYS.get(action, ())
            names = (getattr(source, key) for source in sources for key in keys)
            return next((name for name in names if name is not None), "")

        def with_signals(task: Task) -> Task:
            stops = tuple(replace(stop, signal=signal(stop.action)) for stop in task.stops)
            return replace(task, stops=stops, grasps=tuple(map(with_signals, task.grasps)))

        return [with_signals(task) for task in shares]

    def arm(self, section: TaskSection, loc: Loc) -> str | None:
        """Read the arm of a task, ANY for either; None after noting an unknown arm.

        Args:
            section: the task as the file has it.
            loc: where it stands.
        """
        if section.arm not in (None, ANY, *self.arms):
            name = self.cell.robot.name
            message = f"{name} has no {section.arm} arm; it has {', '.join(self.arms)}"
            self.note((*loc, "arm"), message)
            return None
        # A task that only one arm can do belongs to that arm.
        return self.arms[0] if section.arm == ANY and len(self.arms) == 1 else section.arm

    def task(
        self, section: TaskSection, loc: Loc, arm: str, stops: tuple[Stop, ...], part: str
    ) -> Task:
        """Build a task with its order and times.

        Args:
            section: the task as the file has it.
            loc: where it stands.
            arm: arm of the task.
            stops: its targets.
            part: name of the carried part.
        """
        return Task(
            section.id,
            arm,
            stops,
            tuple(section.after),
            part,
            not_before=section.not_before or 0.0,
            not_after=math.inf if section.not_after is None else section.not_after,
            place=self.place(loc),
            touches=tuple(section.touches),
            leaves=self.defaults.leaves if section.leaves is None else section.leaves,
        )

    def part(self, section: TaskSection, loc: Loc) -> str:
        """Read the name of the carried part, after noting an unknown one.

        Args:
            section: the task as the file has it.
            loc: where it stands.
        """
        carries = section.pick is not None and section.place is not None
        if section.part is not None and not carries:
            message = "only a pick with its place carries a part; remove 'part'"
            self.note((*loc, "part"), message)
        part = section.part if section.part is not None else self.defaults.part
        if part is None or not carries:
            return ""
        kinds = [name for name in self.cell.parts if name == kind_of_part(name)]
        if part not in kinds:
            place: Loc = (*loc, "part") if section.part is not None else ("defaults", "part")
            message = f"the cell has no part {quote(part)}{suggest(part, kinds, 'parts')}"
            self.note(place, message)
        return part

    def check_posture(self, name: str | None, loc: Loc) -> bool:
        """Check that the robot has a posture, or note an error; None passes."""
        postures = list(self.cell.robot.postures)
        if name is None or name in postures:
            return True
        hint = suggest(name, postures, "choose one of")
        self.note(loc, f"{self.cell.robot.name} has no posture {quote(name)}{hint}")
        return False

    def stops(
        self, section: TaskSection, loc: Loc, arm: str, taker: str | None = None
    ) -> tuple[Stop, ...]:
        """Read the stops of a task of the core.

        Args:
            section: the task as the file has it.
            loc: where it stands.
            arm: arm of the task.
            taker: arm that takes the part over and places it; None if the same arm places it.
        """
        stops = []
        for action in ACTIONS:
            target_section, place = getattr(section, action), (*loc, action)
            if target_section is None:
                continue
            if target_section.by_joints is not None and arm == ANY:
                continue  # the rules across tasks have noted it
            by = taker if action == "place" and taker is not None else arm
            if not self.check_posture(target_section.posture, (*place, "posture")):
                continue
            target = self.targets.target(target_section, place, by)
            if target is None:
                continue
            lines = self._lines(section, target_section, place)
            if isinstance(target, JointTarget) and any(line.fixed for _, line in lines):
                message = (
                    "joint positions say nothing of the world: give in: tool to the directions of approach and "
                    "retract, or the target as a pose"
                )
                self.note((*place, target_section.by_joints or ""), message)
            dwell, varying = self._dwell(section, action == "move")
            (approach, towards), (retract, away) = lines
            straight = section.straight if section.straight is not None else self.defaults.straight
            ranges = self.targets.ranges(target_section, target, f"{section.id} {action}")
            where = self.place(place)
            stop = Stop(
                action, target, approach, retract, dwell, where, varying=varying, ranges=ranges
            )
            stop = replace(stop, directions=LineDirections(towards, away))
            if straight is not None:
                stop = replace(stop, straight=straight)
            blend = section.blend if section.blend is not None else self.defaults.blend
            if blend is not None and action == "move" and not (approach or retract or dwell.total):
                stop = replace(stop, blend=blend)
            for kind in self._kinds:
                stop = kind.stop(self, target_section, place, stop)
            stops.append(stop)
        return tuple(stops)

    def line(self, section: LineSection, loc: Loc) -> Line:
        """Read an approach or retract, as the last key of its location says."""
        outward = -1 if loc[-1] == "approach" else 1
        return read_line(self.document, loc, section, outward, self.cell.frames, self.findings)

    def _lines(self, section: TaskSection, target: TargetSection, loc: Loc) -> list[Line]:
        """Read approach and retract of a target; defaults are of picks and places."""
        lines = []
        for key in ("approach", "retract"):
            line: tuple[LineSection, Loc] = getattr(self.defaults, key), ("defaults", key)
            if loc[-1] == "move":
                line = LineSection.model_construct(distance=0.0), loc
            for stated, where in ((section, loc[:-1]), (target, loc)):
                if getattr(stated, key) is not None:
                    line = getattr(stated, key), (*where, key)
            lines.append(self.line(*line))
        return lines

    def _dwell(self, section: TaskSection, bare: bool) -> tuple[Dwell, tuple[TimeRange, ...]]:
        """Read a dwell and its varying parts; defaults are of picks and places."""
        dwell = section.dwell or (DwellSection() if bare else self.defaults.dwell)
        nominal = Dwell(*(part.nominal for part in dwell.parts))
        return nominal, tuple(part for part in dwell.parts if part.least < part.most)
