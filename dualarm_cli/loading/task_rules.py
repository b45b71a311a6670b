"""Rules across tasks: unique ids, precedence without cycles, what cannot be planned yet."""

from __future__ import annotations

from collections.abc import Mapping

from dualarm_cli.errors import did_you_mean
from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.schema_tasks import TaskSection, TasksFile
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.yaml_source import Document

NOT_AVAILABLE = "E310"
"""Code of what the format has and this version has not."""


def check_tasks(document: Document, tasks: Mapping[int, TaskSection], findings: Findings) -> None:
    """Notes duplicate ids, impossible precedence and kinds of task that cannot be planned yet.

    Args:
        document: the task file.
        tasks: the tasks that their schema accepts, by their index in the file.
        findings: where errors are noted.
    """
    first: dict[str, int] = {}
    for index, task in tasks.items():
        loc = ("tasks", index, "id")
        if task.id in first:
            message = f"duplicate task id {quote(task.id)}, first at line {first[task.id]}"
            findings.add(document, loc, message, "E102")
        first.setdefault(task.id, document.place(loc)[0])
        if task.arm == "any":
            message = "arm: any is not available in this version; use left or right"
            findings.add(document, ("tasks", index, "arm"), message, NOT_AVAILABLE)
    _check_precedence(document, tasks, findings)


def check_settings(document: Document, model: TasksFile, findings: Findings) -> None:
    """Notes settings of the whole file that cannot be planned yet.

    Args:
        document: the task file.
        model: its content.
        findings: where errors are noted.
    """
    for key, found, instead in (("mode", model.mode, "paired"), ("order", model.order, "given")):
        if found != instead:
            message = f"{key}: {found} is not available in this version; use {key}: {instead}"
            findings.add(document, (key,), message, NOT_AVAILABLE)


def permission_notes(model: TasksFile) -> list[str]:
    """Returns notes on what the file permits or demands and the present planner does not use."""
    defaults, notes = model.defaults, []
    if defaults.straight is not None:
        notes.append(
            "straight: not used; every approach and retract is straight over its whole length"
        )
    for key in ("dwell_motion", "line_motion"):
        if getattr(defaults, key) == "allowed":
            during = "dwells" if key == "dwell_motion" else "lines"
            notes.append(f"{key}: allowed was not used; the platform stands still during {during}")
    return notes


def _check_precedence(
    document: Document, tasks: Mapping[int, TaskSection], findings: Findings
) -> None:
    raw = document.data.get("tasks")
    entries = raw if isinstance(raw, list) else []
    known = [t["id"] for t in entries if isinstance(t, dict) and isinstance(t.get("id"), str)]
    known_set = set(known)
    before: dict[str, list[str]] = {}
    index_of = {task.id: index for index, task in reversed(list(tasks.items()))}
    for index, task in tasks.items():
        for k, other in enumerate(task.after):
            loc = ("tasks", index, "after", k)
            if other == task.id:
                findings.add(document, loc, f"task {quote(other)} cannot come after itself")
            elif other not in known_set:
                hint = did_you_mean(other, known)
                findings.add(document, loc, f"there is no task {quote(other)}{hint}")
            else:
                before.setdefault(task.id, []).append(other)
    ring = _find_ring(before)
    if ring:
        text = " after ".join(quote(name) for name in [*ring, ring[0]])
        findings.add(
            document, ("tasks", index_of[ring[0]], "after"), f"tasks wait for each other: {text}"
        )


def _find_ring(before: Mapping[str, list[str]]) -> list[str]:
    """Returns one ring of tasks that wait for each other, or nothing; no recursion."""
    done: set[str] = set()
    for start in before:
        path, branches = [start], [iter(before[start])]
        on_path = {start}
        while path and start not in done:
            step = next(branches[-1], None)
            if step is None:
                branches.pop()
                done.add(path[-1])
                on_path.discard(path.pop())
            elif step in on_path:
                return path[path.index(step) :]
            elif step not in done:
                path.append(step)
                on_path.add(step)
                branches.append(iter(before.get(step, ())))
    return []
