"""Reader of task files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.cells.cells import build_cell
from dualarm_cli.files.source.bundled import task_file
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.documents import read_document, validate
from dualarm_cli.files.source.overrides import Overrides
from dualarm_cli.files.source.projects import Project, display_name, noted
from dualarm_cli.files.source.text_source import quote
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.files.tasks.care import with_care
from dualarm_cli.files.tasks.curves import CurveReader
from dualarm_cli.files.tasks.expansion import expand_tasks
from dualarm_cli.files.tasks.schema_tasks import TaskSection, TasksFile, read_budget
from dualarm_cli.files.tasks.target_reader import TargetReader
from dualarm_cli.files.tasks.task_reader import Schemas, TaskReader, schemas_of
from dualarm_cli.files.tasks.task_rules import (
    check_settings,
    check_skew,
    check_start,
    check_tasks,
)
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.job import ANY, Job, Task
from dualarm_cli.model.place import Place


def check_order(document: Document, job: Job, findings: Findings) -> None:
    """Note tasks whose file order contradicts their precedence, and cycles of waits.

    A contradiction needs one arm, or a path between both tasks.

    Args:
        document: the task file.
        job: its content, with order: given.
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
            # Arms wait for each other, but a path allows no parallel task, and each arm keeps the file's order.
            both = arms[name] | arms[task.id]
            shared = ANY in both or arms[name] & arms[task.id]
            if sections[name] == sections[task.id] and not shared:
                continue
            message = (
                f"task {quote(task.id)} must come after {quote(name)}, but order: given puts it first; "
                "change their order in the file"
            )
            findings.add(document, ("tasks", place[task.id], "after", k), message)
            wrong = True
    if wrong or not job.is_decided:
        return
    try:
        job.stages()
    except InfeasibleError as error:
        [waiting] = error.refusals
        findings.add(document, ("tasks", place[waiting.task], "after"), waiting.sentence)


def load_job(
    path: str | Path | Mapping[str, Any],
    name: str | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Job:
    """Read the job in a task file, with its cell and robot.

    Args:
        path: the task file, the name of a bundled job, or the content of a task file.
        name: its name in messages; None for its path.
        overrides: replacements for values of the files, applied before validation; see
            `files.source.overrides`.

    Raises:
        InputError: everything wrong with it and the files that it names.
    """
    project, path, name = _project_of(path, name)
    project.overrides = Overrides(overrides)
    document = read_document(project, path, name, "tasks/1")
    findings = Findings(document.diagnostics)
    kinds = of_kinds("reading")
    schemas, of_cell = schemas_of(tuple(kinds)), Findings()
    loaded = _load_cell(project, document, path, of_cell)
    expansion = expand_tasks(document, loaded and loaded[0], project, path, findings)
    model = validate(document, schemas.file, findings)
    sections = _good_tasks(document, model, schemas)
    check_tasks(document, sections, findings)
    for kind in kinds:
        kind.check(document, sections, model, findings)
    if model is not None:
        check_settings(document, model, findings)
    findings.extend(of_cell.diagnostics)
    tasks: tuple[Task, ...] = ()
    if loaded is not None:
        cell, notes = loaded
        check_start(document, cell, findings)
        check_skew(document, cell, findings)
        if model is not None:
            for kind in kinds:
                kind.check_cell(document, model, cell, findings)
        defaults = schemas.defaults() if model is None else model.defaults
        curves = CurveReader(project, path, document, cell, findings)
        targets = TargetReader(document, cell, findings, expansion.poses)
        cell, tasks = with_care(TaskReader(document, targets, findings, defaults, curves), sections)
        findings.extend(project.overrides.unused())
    if model is None or loaded is None or findings.diagnostics:
        findings.fail()
    caps = [c for c in (cell.tool_speed, model.limits.tool_speed) if c is not None]
    job = Job(
        cell,
        tasks,
        model.start,
        model.return_,
        model.speed,
        min(caps, default=None),
        dict(project.inputs),
        (*notes, *expansion.notes),
        model.mode,
        model.order,
        tuple(tuple(names) for names in model.sequences),
        budget=read_budget(document, model.budget),
        start_place=Place(document.source.name, *document.place(("start",))),
        skew=0.0 if model.timing is None else model.timing.skew,
    )
    for kind in kinds:
        job = kind.job(document, model, job)
    if job.order == "given":
        check_order(document, job, findings)
        findings.raise_if_any()
    return job


def _project_of(
    source: str | Path | Mapping[str, Any], name: str | None
) -> tuple[Project, Path, str]:
    if isinstance(source, Mapping):
        project, path = Project.in_memory(source, "tasks")
        return project, path, path.name
    path, called = task_file(source)
    return Project.of(path), path, name or called


def _good_tasks(
    document: Document, model: TasksFile | None, schemas: Schemas
) -> dict[int, TaskSection]:
    """Select the valid tasks, so that the others do not hide their errors."""
    if model is not None:
        return dict(enumerate(model.tasks))
    good = {}
    for index, entry in enumerate(document.listed("tasks")):
        try:
            good[index] = schemas.task.model_validate(entry)
        except ValidationError:
            continue
    return good


def _load_cell(
    project: Project, document: Document, path: Path, findings: Findings
) -> tuple[Cell, tuple[str, ...]] | None:
    """Read the cell with its notes, or None after noting errors."""
    reference = document.data.get("cell")
    if not isinstance(reference, str):
        return None
    with noted(findings, document, ("cell",)):
        cell_path = project.follow(reference, path)
        return build_cell(project, cell_path, display_name(reference, document.source.name))
    return None
