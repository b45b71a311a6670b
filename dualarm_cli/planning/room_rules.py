"""Orders of picks and places that leave room for their parts."""

from __future__ import annotations

from dataclasses import replace

from dualarm_cli.collision.clearance import SLACK
from dualarm_cli.collision.crowding import Crowded, crowded_stops, is_same_spot
from dualarm_cli.collision.rooms import held_part, pinned
from dualarm_cli.model.job import Job, PoseTarget, Stop, Task
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal

Rules = dict[tuple[str, str], Crowded]
"""Tasks of which the first must be over before the second begins, and why."""


@dataclass(frozen=True)
class RoomRules:
    """Orders that the rooms of a job's parts leave."""

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
        """List parts that are in each other's way, whatever the arms do."""
        job, rules = self.job, self.rules
        place = {task.id: k for k, task in reversed(list(enumerate(job.tasks)))}
        arms: dict[str, set[str]] = {}
        for task in job.tasks:
            arms.setdefault(task.id, set()).add(task.arm)
        found = []
        for (one, other), crowded in rules.items():
            later = place[crowded.task.id] > place[crowded.room.task.id]
            if (other, one) in rules:
                found += [_refusal("same_room", crowded)] if later else []
            elif job.order == "given" and place[one] > place[other] and arms[one] & arms[other]:
                found.append(_refusal("in_the_way", crowded))
        return found

    def ruled(self) -> Job:
        """Order a job's tasks by the room of their parts, with notes.

        A part that lies where another task's tool or part has to pass is placed after that task; one that waits there
        is picked before it. Parts that others take away again, and those of buffers, are left to the search.
        """
        job = self.job
        after = {task.id: set(task.after) for task in job.tasks}
        news = [(one, other) for one, other in self.rules if one not in after[other]]
        tasks = [
            replace(task, after=(*task.after, *(one for one, other in news if other == task.id)))
            for task in job.tasks
        ]
        orders = [
            f"order: {other} comes after {one}, as its part would be in the way"
            for one, other in news
        ]
        return replace(job, tasks=tuple(tasks), notes=(*job.notes, *self.notes, *orders))


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
        for (one, other), crowded in rules.items()
        if (other, one) in rules
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
    note = "parts: near others these keep the yaw of the file, although it is free"
    return job, _rules(job), [f"{note}: {', '.join(names)}"]


def _rule(job: Job, crowded: Crowded) -> tuple[str, str] | None:
    """Return the task to finish first and the later one, or None.

    None where the search has to see.
    """
    room = crowded.room
    others = [
        stop.action
        for task in job.tasks
        for stop in task.stops
        if (task.id, stop.action) != room.key and is_same_spot(stop, room)
    ]
    if room.stop.buffer:
        return None
    if room.stop.action == "pick":
        # Of several parts that come to one place only one is there at a time.
        return None if others else (room.task.id, crowded.task.id)
    gone = room.task.leaves or "pick" in others
    return None if gone else (crowded.task.id, room.task.id)


def _refusal(what: str, crowded: Crowded) -> Refusal:
    task, room = crowded.task, crowded.room
    apart = crowded.distance
    how = "room_overlap" if apart < 0.0 else "room_gap"
    more = {
        "action": crowded.stop.action,
        "body": _named(crowded.body),
        "part": _named(room.task.part),
        "other": room.task.id,
        "there": room.stop.place,
        "verb": "waits" if room.stop.action == "pick" else "lies",
        "how": [Refusal(how, measured=abs(apart), allowed=crowded.needed, more={"spare": SLACK})],
    }
    return Refusal(what, crowded.stop.place, task.id, task.arm, more=more)


def _named(part: str) -> str:
    return part.partition("@")[0]
