"""Order rules of picks and places that leave room for their parts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.crowding import Crowded, crowded_stops, is_same_spot
from dualarm_cli.collision.rooms import held_part, pinned
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.model.lying import lying_label
from dualarm_cli.model.part_flow import kind_of_part
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.notes import Note, is_about
from dualarm_cli.planning.notes import order_note, parts_note
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

Rules = dict[tuple[str, str], Crowded]
"""Pairs of tasks, first before second, with the crowded part.

The first must end before the second begins.
"""


@dataclass(frozen=True)
class RoomRules:
    """Order rules that follow from the room of a job's parts."""

    job: Job
    """Job in which crowded parts keep the yaw of the file."""
    rules: Rules
    """Tasks that have to be over before others."""
    notes: list[str]
    """Yaws that are kept."""

    @classmethod
    def of(cls, job: Job) -> RoomRules:
        """Find the rules of a job.

        A part whose yaw is open takes the room of all turns: at the file's yaw there may be room for both.
        """
        return cls(*_pinned(job, _rules(job)))

    def faults(self) -> list[Refusal]:
        """List parts that obstruct each other in every order."""
        job, rules = self.job, self.rules
        place = {task.id: k for k, task in reversed(list(enumerate(job.tasks)))}
        arms: dict[str, set[str]] = {}
        for task in job.tasks:
            arms.setdefault(task.id, set()).add(task.arm)
        refusals = []
        for (a, b), crowded in rules.items():
            later = place[crowded.task.id] > place[crowded.room.task.id]
            if (b, a) in rules:
                refusals += [_refusal("same_room", crowded)] if later else []
            elif job.order == "given" and place[a] > place[b] and arms[a] & arms[b]:
                refusals.append(_refusal("in_the_way", crowded))
        return refusals

    def ruled(self) -> Job:
        """Order a job's tasks by the room of their parts, with notes.

        A part that lies where another task's tool or part has to pass is placed after that task; one that waits there
        is picked before it. Parts that others take away again, and those of buffers, are left to the search.
        """
        job = self.job
        after = {task.id: set(task.after) for task in job.tasks}
        news = [(a, b) for a, b in self.rules if a not in after[b]]
        tasks = [
            replace(task, after=(*task.after, *(a for a, b in news if b == task.id)))
            for task in job.tasks
        ]
        orders = [order_note("after_part", later=b, first=a) for a, b in news]
        return replace(job, tasks=tuple(tasks), notes=(*job.notes, *self.notes, *orders))


def planned_around(job: Job, plan: Callable[[Job], Schedule], stop: Callable[[], bool]) -> Schedule:
    """Plan an open job; swap two tasks if a part obstructs one.

    The part is that of the other task.

    The rules of a job concern tools and parts: only a plan shows that a part obstructs a link.

    Args:
        job: job of open order.
        plan: function that plans it.
        stop: whether to end early, with the refusal of the given job.

    Raises:
        InfeasibleError: no order of such tasks has a plan; the refusal of the given job.
    """
    first: InfeasibleError | None = None
    ruled, tried = job, set[tuple[str, str]]()
    given = {(name, task.id) for task in job.tasks for name in task.after}
    while True:
        try:
            schedule = plan(ruled)
        except InfeasibleError as error:
            first = first or error
            pairs = _obstructed_tasks(job, error)
            open_pairs = [pair for pair in pairs if not given & {pair, pair[::-1]}]
            rules = [r for pair in open_pairs for r in (pair, pair[::-1]) if r not in tried]
            # Each costs a whole plan.
            if job.order == "given" or not rules or len(tried) == len(job.tasks) or stop():
                raise first from None
            tried.add(rules[0])
            ruled = _with_rule(ruled, *rules[0])
            continue
        if not tried:
            return schedule
        # Nothing is known of the orders that such a rule excludes.
        notes = tuple(
            note
            for note in schedule.notes
            if note in ruled.notes or not is_about(note, "order", "order bound")
        )
        return replace(schedule, order_grid_gap=None, notes=notes)


def _obstructed_tasks(job: Job, error: InfeasibleError) -> list[tuple[str, str]]:
    """List tasks that one arm cannot do, each with the obstructing task."""
    owners = {lying_label(task): task.id for task in job.tasks if task.part}
    names, pairs = {task.id for task in job.tasks}, []
    for refusal in error.refusals:
        cause = refusal.data.get("cause")
        bodies = (cause if isinstance(cause, Refusal) else refusal).data
        owner = owners.get(str(bodies.get("body_b")), refusal.task)
        # Returns belong to no task, tool changes to none of the job.
        if refusal.task in names and owner != refusal.task and not bodies.get("partner"):
            pairs.append((refusal.task, owner))
    return pairs


def _with_rule(job: Job, first: str, second: str) -> Job:
    """Return a job in which one task precedes another, and no longer follows it."""
    tasks = []
    for task in job.tasks:
        after = [name for name in task.after if (name, task.id) != (second, first)]
        tasks.append(replace(task, after=(*after, first) if task.id == second else tuple(after)))
    note = order_note("after_link", later=second, first=first)
    against = {"later": first, "first": second}
    notes = [text for text in job.notes if not (isinstance(text, Note) and text.data == against)]
    return replace(job, tasks=tuple(tasks), notes=(*notes, note))


def _rules(job: Job) -> Rules:
    """List the tasks to finish before others begin, each with its reason."""
    rules: Rules = {}
    for crowded in crowded_stops(job):
        rule = _rule(job, crowded)
        if rule is not None:
            rules.setdefault(rule, crowded)
    return rules


def _pinned(job: Job, rules: Rules) -> tuple[Job, Rules, list[str]]:
    """Fix the yaw of crowded parts; return the job, its rules and notes."""
    keys = {
        key
        for (first, second), crowded in rules.items()
        if (second, first) in rules
        for key in (crowded.room.key, (crowded.task.id, crowded.stop.action))
    }
    names: list[str] = []

    def kept(task: Task, stop: Stop) -> Stop:
        if (task.id, stop.action) not in keys or not isinstance(stop.target, PoseTarget):
            return stop
        if not stop.target.free_yaw:
            return stop
        names.append(f"{task.id} ({stop.action})")
        return replace(stop, target=pinned(stop.target, held_part(job.cell, task)))

    tasks = tuple(
        replace(task, stops=tuple(kept(task, stop) for stop in task.stops)) for task in job.tasks
    )
    if not names:
        return job, rules, []
    job = replace(job, tasks=tasks)
    return job, _rules(job), [parts_note("yaw", stops=names)]


def _rule(job: Job, crowded: Crowded) -> tuple[str, str] | None:
    """Return the task to finish first and the later one, or None.

    None where the search has to see.
    """
    room = crowded.room
    others = [
        stop.action
        for task in job.tasks
        for stop in task.stops
        if (task.id, stop.action) != room.key and is_same_spot((task, stop), room)
    ]
    if room.stop.buffer:
        return None
    if room.stop.action == "pick":
        # Several parts that use one place are there at different times.
        return None if others else (room.task.id, crowded.task.id)
    gone = room.task.leaves or "pick" in others
    return None if gone else (crowded.task.id, room.task.id)


def _refusal(key: str, crowded: Crowded) -> Refusal:
    task, room = crowded.task, crowded.room
    apart = crowded.distance
    how = "room_overlap" if apart < 0.0 else "room_gap"
    data = {
        "action": crowded.stop.action,
        "body": kind_of_part(crowded.body),
        "part": kind_of_part(room.task.part),
        "other_task": room.task.id,
        "there": room.stop.place,
        "verb": "waits" if room.stop.action == "pick" else "lies",
        "how": [Refusal(how, measured=abs(apart), allowed=crowded.needed, data={"spare": SLACK})],
    }
    return Refusal(key, crowded.stop.place, task.id, task.arm, data=data)
