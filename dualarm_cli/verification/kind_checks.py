"""Interface by which kinds of work add checks to the verifier."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from dualarm_cli.model.job import Job, Task
from dualarm_cli.model.schedule import Event, Schedule
from dualarm_cli.model.verification import Check
from dualarm_cli.records import dataclass
from dualarm_cli.verification.measuring.criteria import Criterion
from dualarm_cli.verification.measuring.line_spans import LineSpan
from dualarm_cli.verification.measuring.tool_model import ToolModel

Subject = Literal["lines", "work", "order", "parts"]
"""Subject of a check, in the order of the list of checks.

Tools at targets and on lines, tools at work between them, assignment and order of tasks, places of parts.
"""


@dataclass(frozen=True)
class Evidence:
    """Input of checks: schedule, job, tool model, and line spans.

    The schedule has finite numbers and rising times.
    """

    schedule: Schedule
    """Schedule as in its file."""
    known_arms_only: Schedule
    """Schedule without the work of unknown arms, events with the velocities of the job's targets."""
    stated: tuple[Event, ...]
    """Events of `known_arms_only` as in the schedule's file."""
    job: Job | None
    """Job as in its file; None without a task file."""
    done: Job | None
    """Job as it was done: each task with the arm that did it."""
    model: ToolModel
    """Forward kinematics of the tools."""
    spans: tuple[LineSpan, ...]
    """Spans of the job's stops on their lines."""


@dataclass(frozen=True)
class Touch:
    """Two bodies that may touch during a span of time."""

    bodies: frozenset[tuple[str, str]]
    """Carrying arm, empty for none, and name of each body."""
    start: float
    """Start of the span [s]."""
    end: float
    """End of the span [s]."""
    gripped: bool
    """Flag of a grip, in which penetration is allowed as well."""


@dataclass(frozen=True)
class KindChecks:
    """Checks, criteria and permitted touches of one kind of work."""

    judge: Mapping[Subject, Callable[[Evidence], Sequence[Check]]]
    """Checks by subject; without work of the kind they are `not checked` or left out."""
    criteria: Mapping[str, Criterion]
    """Criteria of the checks by name."""
    touches: Callable[[Job, Sequence[LineSpan]], Sequence[Touch]] = lambda job, spans: ()
    """Bodies that may touch, from the job as done and the spans of its stops."""
    added: Callable[[Schedule, Job], Sequence[tuple[float, Task]]] = lambda schedule, job: ()
    """Tasks that a schedule adds to the job's, with their start times [s]."""
