"""Interface of kinds of work to the verifier."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.criteria import Criterion
from dualarm_cli.verification.line_spans import LineSpan
from dualarm_cli.verification.tool_model import ToolModel

Subject = Literal["lines", "work", "joints", "order", "parts"]
"""What is judged, in the order in which checks are listed: tools at targets and on their lines, tools at work between
them, joints, who does what in which order, where parts are."""


@dataclass(frozen=True)
class Evidence:
    """A schedule that is judged, with finite numbers and rising times."""

    schedule: Schedule
    """As it is."""
    known: Schedule
    """Without the work of arms that the robot does not have; its events move as the job's targets do."""
    stated: tuple[Event, ...]
    """The events of `known` as they are written."""
    job: Job | None
    """As its file leaves it; None where there is no task file."""
    done: Job | None
    """As it was done: each task with the arm that did it."""
    model: ToolModel
    """Where the tools are."""
    spans: tuple[LineSpan, ...]
    """Of the job's stops."""


@dataclass(frozen=True)
class Touch:
    """Two bodies that may touch for some time."""

    bodies: frozenset[tuple[str, str]]
    """The arm that carries each, empty for none, and its name."""
    start: float
    """From when on [s]."""
    end: float
    """Until when [s]."""
    gripped: bool
    """Whether one grips the other, so that nothing is asked of them; else they must not reach into one another."""


@dataclass(frozen=True)
class KindChecks:
    """What one kind of work adds to the verifier."""

    judge: Mapping[Subject, Callable[[Evidence], Sequence[Check]]]
    """Its checks by what they judge; where the job has none of its work they say so, or are left out."""
    criteria: Mapping[str, Criterion]
    """Criteria of all its checks by name."""
    touches: Callable[[Job, Sequence[LineSpan]], Sequence[Touch]] = lambda job, spans: ()
    """Which bodies may touch when, by the job as it was done and the spans of its stops."""
    added: Callable[[Schedule, Job], Sequence[tuple[float, Task]]] = lambda schedule, job: ()
    """What a schedule does besides the job's tasks, as tasks with the times at which they begin [s]."""
