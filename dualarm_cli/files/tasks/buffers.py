"""Buffers of task files: who puts parts into them and who takes them out, and numbers that no order can make good."""

from __future__ import annotations

from collections.abc import Mapping

from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document
from dualarm_cli.files.tasks.schema_tasks import TaskSection, TasksFile
from dualarm_cli.model.buffer import Buffer
from dualarm_cli.model.place import Place

USES = ("place", "pick")
"""Who puts parts into a buffer, and who takes them out."""


def check_buffers(
    document: Document,
    tasks: Mapping[int, TaskSection],
    model: TasksFile | None,
    findings: Findings,
) -> None:
    """Notes buffers that there are not, that a move names, and those whose numbers no order can make good.

    Args:
        document: the task file.
        tasks: the tasks that their schema accepts, by their index in the file.
        model: its content, None where its schema does not accept it.
        findings: where errors are noted.
    """
    raw = document.data.get("buffers")
    known = [name for name in raw if isinstance(name, str)] if isinstance(raw, dict) else []
    all_known = True
    for index, task in tasks.items():
        if task.move is not None and task.move.buffer is not None:
            message = "'buffer' goes with picks and places only; remove it"
            findings.add(document, ("tasks", index, "move", "buffer"), message)
        for action in USES:
            name = _buffer(task, action)
            if name is not None and name not in known:
                message = f"there is no buffer {quote(name)}{suggest(name, known, 'buffers')}"
                findings.add(document, ("tasks", index, action, "buffer"), message)
                all_known = False
    # What a misspelt name puts or takes would be missing in the numbers.
    if model is not None and all_known:
        _check_numbers(document, model, findings)


def _check_numbers(document: Document, model: TasksFile, findings: Findings) -> None:
    """Notes buffers that end with fewer parts than none, with more than there is room for, or not as they began."""
    for name, buffer in model.buffers.items():
        puts, takes = counted(model, name)
        end = buffer.initial + puts - takes
        numbers = f"{buffer.initial} at the start, puts: {puts}, takes: {takes}"
        if end < 0:
            message = (
                f"buffer {quote(name)} never holds as many parts as are taken: {numbers}; {-end} more must be put into "
                "it, or be in it at the start (initial)"
            )
        elif end > buffer.capacity:
            message = (
                f"buffer {quote(name)} has no room for all parts: {numbers}, so {end} are left where there is room for "
                f"{buffer.capacity} (capacity)"
            )
        elif model.return_ and end != buffer.initial:
            message = (
                f"with return: true the cycle cannot repeat: buffer {quote(name)} ends with {end} parts and began with "
                f"{buffer.initial} (puts: {puts}, takes: {takes}); let puts and takes be equally many, or say "
                "return: false"
            )
        else:
            continue
        findings.add(document, ("buffers", name), message)


def counted(model: TasksFile, name: str) -> tuple[int, int]:
    """Returns how often parts are put into a buffer, and how often they are taken out."""
    puts, takes = (sum(_buffer(task, action) == name for task in model.tasks) for action in USES)
    return puts, takes


def read_buffers(document: Document, model: TasksFile) -> tuple[dict[str, Buffer], list[str]]:
    """Returns the buffers of a file by name, and notes on those that nobody uses.

    Args:
        document: the task file.
        model: its content, in which everything has been checked.
    """
    found, notes = {}, []
    for name, section in model.buffers.items():
        line, column = document.place(("buffers", name))
        where = Place(document.source.name, line, column)
        found[name] = Buffer(section.capacity, section.initial, where)
        if counted(model, name) == (0, 0):
            notes.append(
                f"buffer {quote(name)}: no task uses it; a pick or place does with buffer: {name}"
            )
    return found, notes


def _buffer(task: TaskSection, action: str) -> str | None:
    """Returns the buffer that the pick or place of a task names; None for none."""
    target = getattr(task, action)
    return None if target is None else target.buffer
