"""Whether tasks can come after those that they are to come after, where the file gives the order."""

from __future__ import annotations

from dualarm_cli.loading.diagnostics import Findings
from dualarm_cli.loading.text_source import quote
from dualarm_cli.loading.yaml_source import Document
from dualarm_cli.model.job import ANY, Job, waiting_for_ever


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
        message = waiting_for_ever(waiting)
        findings.add(document, ("tasks", place[stuck.id], "after"), message)
