"""Buffers of task files, and checks of their numbers of parts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated

from pydantic import Field, model_validator

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.fields import Name, Section, refuse
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_tasks import TargetSection, TaskSection, TasksFile
from dualarm_cli.files.tasks.task_reader import KindReading, TaskReader
from dualarm_cli.model.job import Job, Stop
from dualarm_cli.model.part_flow import Buffer
from dualarm_cli.model.place import Place
from dualarm_cli.notes import NoteTable

MOST_PARTS = 1_000_000
"""Maximum number of parts of a buffer."""
_note = NoteTable(
    "buffers",
    unused="buffer {quoted}: no task uses it; a pick or place does with buffer: {buffer}",
)


class BufferSection(Section):
    """Buffer of identical parts between tasks."""

    capacity: Annotated[int, Field(ge=1, le=MOST_PARTS)] = Field(
        description="How many parts it has room for."
    )
    initial: Annotated[int, Field(ge=0, le=MOST_PARTS)] = Field(
        default=0, description="How many parts are in it at the start."
    )

    @model_validator(mode="after")
    def _room_for_all(self) -> BufferSection:
        if self.initial > self.capacity:
            text = (
                f"{self.initial} parts at the start; there is room for {self.capacity} (capacity)"
            )
            raise refuse(text, "initial")
        return self


class BufferTarget(TargetSection):
    """Target that may be at a buffer."""

    buffer: Name | None = Field(
        default=None,
        description="Buffer that a place puts its part into, or a pick takes one out of.",
    )


class BuffersFile(TasksFile):
    """Task file with buffers."""

    buffers: dict[Name, BufferSection] = Field(
        default_factory=dict,
        description="Buffers for parts between tasks, by name.",
    )


USES = ("place", "pick")
"""Actions that put parts into a buffer, and take them out."""


def check_buffers(
    document: Document,
    tasks: Mapping[int, TaskSection],
    model: TasksFile | None,
    findings: Findings,
) -> None:
    """Report unknown buffers, buffers of moves, and numbers of parts that no order satisfies.

    Args:
        document: the task file.
        tasks: valid tasks, by their index in the file.
        model: its content, or None if it is invalid.
        findings: receives the errors.
    """
    raw = document.data.get("buffers")
    names = [name for name in raw if isinstance(name, str)] if isinstance(raw, dict) else []
    all_known = True
    for index, task in tasks.items():
        if _buffer(task, "move") is not None:
            message = "'buffer' goes with picks and places only; remove it"
            findings.add(document, ("tasks", index, "move", "buffer"), message)
        for action in USES:
            name = _buffer(task, action)
            if name is not None and name not in names:
                message = f"there is no buffer {quote(name)}{suggest(name, names, 'buffers')}"
                findings.add(document, ("tasks", index, action, "buffer"), message)
                all_known = False
    # Numbers would lack the parts of misspelt buffers.
    if isinstance(model, BuffersFile) and all_known:
        _check_numbers(document, model, findings)


def _check_numbers(document: Document, model: BuffersFile, findings: Findings) -> None:
    """Report buffers that end with a negative, excessive or changed number of parts."""
    for name, buffer in model.buffers.items():
        puts, takes = _counted(model, name)
        end = buffer.initial + puts - takes
        numbers = f"{buffer.initial} at the start, puts: {puts}, takes: {takes}"
        if end < 0:
            message = (
                f"buffer {quote(name)} never holds as many parts as are taken: {numbers}; {-end} more must be put into "
                "it, or be in it at the start (initial)"
            )
        elif end > buffer.capacity:
            message = (
                f"buffer {quote(name)} has no room for all parts: {numbers}, so {end} remain where there is room for "
                f"{buffer.capacity} (capacity)"
            )
        elif model.return_ and end != buffer.initial:
            message = (
                f"with return: true the cycle cannot repeat: buffer {quote(name)} ends with {end} parts and began with "
                f"{buffer.initial} (puts: {puts}, takes: {takes}); make the numbers of picks and places equal, "
                "or write return: false"
            )
        else:
            continue
        findings.add(document, ("buffers", name), message)


def _counted(model: BuffersFile, name: str) -> tuple[int, int]:
    """Count the parts that are put into a buffer and taken out."""
    puts, takes = (sum(_buffer(task, action) == name for task in model.tasks) for action in USES)
    return puts, takes


def with_buffers(document: Document, model: TasksFile, job: Job) -> Job:
    """Add the buffers of a file to its job, with notes on unused ones.

    Args:
        document: the task file.
        model: its checked content.
        job: the job without buffers.
    """
    assert isinstance(model, BuffersFile)  # the registry of kinds guarantees it
    buffers, notes = {}, []
    for name, section in model.buffers.items():
        line, column = document.place(("buffers", name))
        place = Place(document.source.name, line, column)
        buffers[name] = Buffer(section.capacity, section.initial, place)
        if _counted(model, name) == (0, 0):
            data = {"quoted": quote(name), "buffer": name}
            notes.append(_note("unused", **data))
    return replace(job, buffers=buffers, notes=(*job.notes, *notes))


def at_buffer(reader: TaskReader, section: TargetSection, loc: Loc, stop: Stop) -> Stop:
    """Attach the buffer of a target to its stop."""
    assert isinstance(section, BufferTarget)  # the registry of kinds guarantees it
    return replace(stop, buffer=section.buffer or "")


def _buffer(task: TaskSection, action: str) -> str | None:
    """Return the buffer of one of a task's targets, or None."""
    target = getattr(task, action)
    return target.buffer if isinstance(target, BufferTarget) else None


READING = KindReading(
    target_keys=BufferTarget,
    file_keys=BuffersFile,
    check=check_buffers,
    stop=at_buffer,
    job=with_buffers,
)
