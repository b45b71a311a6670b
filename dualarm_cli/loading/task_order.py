"""Whether tasks come after those that they are to come after, where the file gives the order."""

from __future__ import annotations

from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.yaml_source import Document
from dualarm_cli.model.job import ANY, Task


def check_order(
    document: Document, tasks: tuple[Task, ...], findings: Findings, mode: str
) -> list[str]:
    """Returns notes on tasks that do not come after others as they are to; on one arm that is an error of the file.

    Args:
        document: the task file.
        tasks: its tasks.
        findings: where errors are noted.
        mode: paired or free; arms with clocks of their own wait for one another's tasks.
    """
    next_stage: dict[str, int] = {}
    spans: dict[str, tuple[str, int, int]] = {}
    sections: dict[str, int] = {}
    begun_by: dict[str, tuple[str, int]] = {}
    paths = 0
    for task in tasks:
        first = next_stage.get(task.arm, 0)
        # Nothing else is done while a path is followed: it and what comes after wait for all before.
        if task.alone and task.id not in sections:
            paths += 1
        sections.setdefault(task.id, 2 * paths - task.alone)
        if task.handover is not None and task.id in begun_by:
            # Both arms meet: the one that is early waits. The taking arm is the one that ends the task.
            met = max(first + 1, next_stage[task.handover.giver])
            next_stage |= {task.handover.giver: met, task.arm: met + 1}
        else:
            next_stage[task.arm] = first + len(task.stops)
            begun_by[task.id] = task.arm, first
        spans[task.id] = task.arm, first, next_stage[task.arm]
    ids = [e.get("id") if isinstance(e, dict) else None for e in document.listed("tasks")]
    notes = []
    for task in {task.id: task for task in tasks}.values():
        arm, first = begun_by[task.id]
        for k, name in enumerate(task.after):
            if name not in spans or name == task.id or first >= spans[name][2]:
                continue
            if sections[name] < sections[task.id]:
                continue
            if ANY in (arm, spans[name][0]):
                if ids.index(name) < ids.index(task.id):
                    continue
            elif spans[name][0] != arm and (begun_by[name][0] != arm or begun_by[name][1] < first):
                if mode == "free":
                    continue
                notes.append(
                    f"after: with order: given task {quote(task.id)} does not wait for {quote(name)}, "
                    "as their arms do their tasks side by side"
                )
                continue
            message = (
                f"task {quote(task.id)} is to come after {quote(name)}, but order: given does it first; "
                "change their order in the file"
            )
            findings.add(document, ("tasks", ids.index(task.id), "after", k), message)
    return notes
