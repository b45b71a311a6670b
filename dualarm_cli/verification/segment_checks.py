"""Check of what a schedule calls the stretches of its arms' work: waits, transfers, returns, paths and seams.

Approaches, dwells and retracts are measured with the lines and the dwells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.model.schedule import Event, Schedule, Segment
from dualarm_cli.model.verification import Check
from dualarm_cli.verification import tolerances as tol
from dualarm_cli.verification.as_done import in_time
from dualarm_cli.verification.motion_checks import judge, not_checked
from dualarm_cli.verification.tool_checks import dense_times

NAME = "segment_kinds"
"""Name of the check."""
ENDS = {"path": "path", "seam": "seam_end"}
"""The action of the event that a path or a seam leads to."""


def check_segment_kinds(schedule: Schedule) -> Check:
    """Checks that every segment is what the motion and the events show.

    An arm stands still while it waits; its transfers lead to its next event, its returns come after the last one; paths
    and seams belong to events of their own. Only waits have reasons, and one for the end of the work has no work
    behind it.

    Args:
        schedule: what is judged, with finite numbers and rising times.
    """
    if not schedule.segments:
        return not_checked(NAME, "the schedule lists none")
    faults = []
    last = max((e.time for e in schedule.events), default=-np.inf)
    for arm in schedule.robot.arms:
        events = _Events.of([e for e in schedule.events if e.arm == arm], last)
        for segment in schedule.segments:
            if segment.arm == arm and (fault := _fault(schedule, segment, events)):
                of = f" of {segment.task}" if segment.task else ""
                faults.append(
                    f"{arm} {segment.kind}{of} from {segment.start:.4f} to {segment.end:.4f} s: {fault}"
                )
    where = faults[0] if faults else "every segment is what the motion shows"
    return judge(NAME, len(faults), 0, "", where)


@dataclass(frozen=True)
class _Events:
    """One arm's events, to be looked up: there may be as many as segments."""

    ordered: Sequence[Event]
    """In time order."""
    times: FloatArray
    """When each one is [s]."""
    keys: frozenset[tuple[str, str]]
    """Their tasks and actions."""
    last: float
    """When the last event of any arm is [s]; -inf for none."""

    @classmethod
    def of(cls, events: Sequence[Event], last: float) -> _Events:
        ordered = in_time(events)
        times = np.array([e.time for e in ordered], dtype=np.float64)
        return cls(ordered, times, frozenset((e.task, e.action) for e in ordered), last)

    def ahead(self, segment: Segment) -> Event | None:
        """Returns the first event at the end of a segment or later that is not over when it starts."""
        first = int(np.searchsorted(self.times, segment.end - tol.SAME_TIME))
        later = (self.ordered[k] for k in range(first, len(self.ordered)))
        return next((e for e in later if e.time + e.dwell > segment.start + tol.SAME_TIME), None)


def _fault(schedule: Schedule, segment: Segment, events: _Events) -> str:
    """Returns what of a segment is not so, by its arm's events, or an empty string."""
    if segment.reason and segment.kind != "wait":
        return f"a reason to wait is given ('{segment.reason}')"
    key = (segment.task, segment.action)
    ahead = events.ahead(segment)
    due = (ahead.task, ahead.action) if ahead else ("", "")
    if segment.kind == "wait":
        if moved := first_move(schedule, segment.arm, segment.start, segment.end):
            return f"the arm moves at {moved:.4f} s"
        if segment.reason == "end" and ahead:
            return f"its work is not done: {' '.join(due)} follows"
    elif segment.kind == "return":
        if any(key):
            return "a return belongs to no task"
        if ahead:
            return f"{' '.join(due)} follows, returns come last"
    elif segment.kind == "transfer":
        if any(key) and key != due:
            return f"the arm's next event is {' '.join(due).strip() or 'none'}, not {' '.join(key)}"
        # An arm that only makes room may be on its way beyond the last event, but it leaves before.
        if not any(key) and events.last < segment.start + tol.SAME_TIME:
            return "nothing follows; a way back is a return"
    elif segment.kind in ENDS:
        due = (segment.task, ENDS[segment.kind])
        if key != due or due not in events.keys:
            return f"the arm has no event {' '.join(due)} that it leads to"
    return ""


def first_move(schedule: Schedule, arm: str, start: float, end: float) -> float:
    """Returns when an arm's own joints are first seen away from where they are at the start [s]; 0 for never.

    Args:
        schedule: the motion; of an arm of which it does not know the joints nothing is seen.
        arm: which one.
        start: from when on [s].
        end: until when [s].
    """
    joints = schedule.robot.arms[arm].joints
    if not joints or not end > start:
        return 0.0
    columns = [schedule.trajectory.joints.index(name) for name in joints]
    times = dense_times(schedule.trajectory.time, start, end)
    q = schedule.trajectory.at(times)[0][:, columns]
    moved = np.flatnonzero(np.abs(q - q[0]).max(axis=1) > tol.STANDS)
    return float(times[moved[0]]) if len(moved) else 0.0
