"""Rules across tasks: ids, precedence, sequences, windows, supported combinations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise

from dualarm_cli.errors import did_you_mean
from dualarm_cli.files.source.diagnostics import Findings
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Document, Loc
from dualarm_cli.files.tasks.schema_tasks import TaskSection, TasksFile
from dualarm_cli.kinds import of_kinds
from dualarm_cli.model.cell import Cell

NOT_AVAILABLE = "E310"
"""Code of features of the format that this version lacks."""
WINDOW = ("not_before", "not_after")
"""Keys of a task's window."""


def incompatible_tasks(what: str, tasks: Iterable[TaskSection]) -> list[TaskSection]:
    """Select the tasks that a kind of work or a setting excludes."""
    keys = [kind.key for kind in of_kinds("reading", what)]
    return [task for task in tasks if any(getattr(task, key) is not None for key in keys)]


def incompatible_kinds(what: str) -> str:
    """List in words the kinds of work that a kind or a setting excludes."""
    *first, last = [kind.plural for kind in of_kinds("reading", what)]
    return f"{', '.join(first)} and {last}" if first else str(last)


def check_tasks(document: Document, tasks: Mapping[int, TaskSection], findings: Findings) -> None:
    """Note every rule that tasks break: ids, order, windows, sequences, kinds.

    Args:
        document: the task file.
        tasks: valid tasks by their index in the file.
        findings: where errors are noted.
    """
    first: dict[str, int] = {}
    for index, task in tasks.items():
        loc = ("tasks", index, "id")
        if task.id in first:
            message = f"duplicate task id {quote(task.id)}, first at line {first[task.id]}"
            findings.add(document, loc, message, "E102")
        first.setdefault(task.id, document.place(loc)[0])
        _check_any(document, index, task, findings)
        _check_window(document, index, task, findings)
    in_a_row = check_sequences(document, tasks, findings)
    _check_precedence(document, tasks, in_a_row, findings)


def check_settings(document: Document, model: TasksFile, findings: Findings) -> None:
    """Note file settings incompatible with each other or with the file's tasks.

    Args:
        document: the task file.
        model: its content.
        findings: where errors are noted.
    """
    alone = incompatible_tasks("free", model.tasks)
    if model.mode == "free" and alone:
        message = (
            f"mode: free does not go with {incompatible_kinds('free')} (task {quote(alone[0].id)}) in this version; "
            "use mode: paired, or plan them in files of their own"
        )
        findings.add(document, ("mode",), message, NOT_AVAILABLE)
    timed = incompatible_tasks("window", model.tasks)
    for index, task in enumerate(model.tasks if timed else ()):
        for key in WINDOW:
            if getattr(task, key) is not None and task not in timed:
                message = (
                    f"{key} does not go with {incompatible_kinds('window')} (task {quote(timed[0].id)}) in "
                    "this version; plan them in files of their own"
                )
                findings.add(document, ("tasks", index, key), message, NOT_AVAILABLE)
    names = {task.id for task in incompatible_tasks("sequence", model.tasks)}
    for k, row in enumerate(model.sequences):
        for m, name in enumerate(row):
            if name in names:
                message = f"task {quote(name)} names its own arms; sequences hold picks, places and moves only"
                findings.add(document, ("sequences", k, m), message)
    if model.sequences and model.order == "given":
        message = (
            "order: given does all tasks in the file's order already; "
            "write order: optimise, or remove 'sequences'"
        )
        findings.add(document, ("sequences",), message)


def check_start(document: Document, cell: Cell, findings: Findings) -> None:
    """Note an unknown start posture."""
    postures = [*cell.robot.postures, "free"]
    start = document.data.get("start", "home")
    if isinstance(start, str) and start not in postures:
        message = (
            f"{cell.robot.name} has no posture {quote(start)}"
            f"{suggest(start, postures, 'choose one of')}"
        )
        findings.add(document, ("start",), message)


def check_skew(document: Document, cell: Cell, findings: Findings) -> None:
    """Note a skew in a cell with a single arm."""
    for section in ("timing", "budget"):
        given = document.data.get(section)
        if isinstance(given, dict) and "skew" in given and len(cell.robot.arms) == 1:
            message = f"no other arm to be late against: {cell.robot.name} has one arm; remove it"
            findings.add(document, (section, "skew"), message)


def _check_any(document: Document, index: int, task: TaskSection, findings: Findings) -> None:
    """Note what `arm: any` excludes."""
    if task.arm != "any":
        return
    for action in ("pick", "place", "move"):
        target = getattr(task, action)
        if target is not None and target.by_joints is not None:
            message = (
                "joint configurations belong to one arm; use arm: left or right, or give a pose"
            )
            findings.add(document, ("tasks", index, action, target.by_joints), message)
    for kind in of_kinds("reading", "any"):
        if getattr(task, kind.key) is not None:
            message = f"arm: any does not go with '{kind.key}'; it names its arms itself"
            findings.add(document, ("tasks", index, "arm"), message, NOT_AVAILABLE)


def _check_window(document: Document, index: int, task: TaskSection, findings: Findings) -> None:
    """Note a window that ends before it begins, or that the task cannot have."""
    early, late = task.not_before, task.not_after
    if early is not None and late is not None and late < early:
        message = f"not_after: {late:g} s is before not_before: {early:g} s"
        findings.add(document, ("tasks", index, "not_after"), message)
    for key in WINDOW:
        if getattr(task, key) is not None and incompatible_tasks("window", [task]):
            message = f"'{key}' goes with picks, places and moves only; remove it"
            findings.add(document, ("tasks", index, key), message)


def check_sequences(
    document: Document, tasks: Mapping[int, TaskSection], findings: Findings
) -> list[tuple[str, str]]:
    """Note impossible sequences; return pairs of tasks in direct succession."""
    arms = {task.id: task.arm for task in tasks.values()}
    ids = [t.get("id") for t in document.listed("tasks") if isinstance(t, dict)]
    follows, where = [], dict[str, int]()
    for k, names in enumerate(document.listed("sequences")):
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            continue  # the schema has noted it
        for m, name in enumerate(names):
            loc = ("sequences", k, m)
            if name not in ids:
                hint = did_you_mean(name, [n for n in ids if isinstance(n, str)])
                findings.add(document, loc, f"there is no task {quote(name)}{hint}")
            elif name in where:
                message = f"task {quote(name)} is in a sequence already (number {where[name] + 1})"
                findings.add(document, loc, message)
            where.setdefault(name, k)
        given = {arms[name]: name for name in names if arms.get(name) in ("left", "right")}
        if len(given) > 1:
            first, second = given.values()
            message = (
                f"one arm does a sequence; {quote(first)} and {quote(second)} have different arms"
            )
            findings.add(document, ("sequences", k), message)
        follows += list(pairwise(names))
    return follows


def _check_precedence(
    document: Document,
    tasks: Mapping[int, TaskSection],
    in_a_row: list[tuple[str, str]],
    findings: Findings,
) -> None:
    entries = document.listed("tasks")
    ids = [t["id"] for t in entries if isinstance(t, dict) and isinstance(t.get("id"), str)]
    known_ids = dict.fromkeys(ids)
    before: dict[str, list[str]] = {}
    for name, then in in_a_row:
        before.setdefault(then, []).append(name)
    index_of = {task.id: index for index, task in reversed(list(tasks.items()))}
    for index, task in tasks.items():
        for k, predecessor in enumerate(task.after):
            if predecessor == task.id:
                loc = ("tasks", index, "after", k)
                findings.add(document, loc, f"task {quote(predecessor)} cannot come after itself")
            elif _is_known(
                document, ("tasks", index, "after", k), predecessor, known_ids, findings
            ):
                before.setdefault(task.id, []).append(predecessor)
        _check_touches(document, index, task, known_ids, findings)
    ring = _find_ring(before)
    if ring:
        text = " after ".join(quote(name) for name in [*ring, ring[0]])
        place = next((index_of[name] for name in ring if name in index_of), 0)
        message = f"tasks wait for each other: {text}"
        if any(name in ring and then in ring for name, then in in_a_row):
            message += " (those of a sequence for the ones before them)"
        findings.add(document, ("tasks", place, "after"), message)


def _check_touches(
    document: Document,
    index: int,
    task: TaskSection,
    ids: Mapping[str, None],
    findings: Findings,
) -> None:
    """Note unknown tasks in `touches`, and its keys without a part."""
    for key in ("touches", "leaves"):
        if getattr(task, key) and (task.pick is None or task.place is None):
            message = f"only a pick with its place carries a part; remove '{key}'"
            findings.add(document, ("tasks", index, key), message)
    for k, neighbour in enumerate(task.touches):
        loc: Loc = ("tasks", index, "touches", k)
        if neighbour == task.id:
            findings.add(document, loc, f"the part of {quote(neighbour)} cannot touch itself")
        else:
            _is_known(document, loc, neighbour, ids, findings)


def _is_known(
    document: Document, loc: Loc, name: str, ids: Mapping[str, None], findings: Findings
) -> bool:
    """Check that a name is a task's; note it otherwise."""
    if name not in ids:
        hint = did_you_mean(name, list(ids))
        findings.add(document, loc, f"there is no task {quote(name)}{hint}")
    return name in ids


def _find_ring(before: Mapping[str, list[str]]) -> list[str]:
    """Find a cycle of tasks that wait for each other, without recursion."""
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
