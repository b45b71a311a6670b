"""Evaluation: what planning and judging one job came to, as plain data that goes through JSON without loss."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import field
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar, Literal, get_args

from dualarm_cli.model.budget import Kept
from dualarm_cli.records import dataclass

if TYPE_CHECKING:
    from pydantic import ConfigDict, TypeAdapter

Status = Literal[
    "planned",
    "fails_verification",
    "infeasible",
    "bad_input",
    "timed_out",
    "crashed",
    "internal_error",
]
STATUSES: tuple[Status, ...] = get_args(Status)
"""All of them, best first."""
REPEATABLE: tuple[str, ...] = ("planned", "fails_verification", "infeasible")
"""What the same input always comes to again, so that it may be kept; `bad_input` is as quick to find anew."""


@dataclass(frozen=True)
class Finding:
    """Something to be said about a place of a file, or about the case as a whole."""

    message: str
    """What was found, and what to do."""
    file: str = ""
    """The file as the user would name it; empty where no place is known."""
    line: int = 0
    """Line from 1; 0 for the file as a whole."""
    column: int = 0
    """Column from 1; 0 for the line as a whole."""

    def __str__(self) -> str:
        """Returns `file:line:column: message`, or less where less is known."""
        place = ":".join([self.file, *(str(n) for n in (self.line, self.column) if n)])
        return f"{place}: {self.message}" if self.file else self.message


@dataclass(frozen=True)
class Evaluation:
    """What one job came to: figures where there is a plan, findings where there is something to say."""

    __pydantic_config__: ClassVar[ConfigDict] = {
        "strict": True,
        "extra": "forbid",
        "allow_inf_nan": False,
    }

    case: str
    """The task file as the user names it, relative to the working directory, with forward slashes."""
    status: Status
    """How it ended."""
    cycle_time: float | None = None
    """Length of the motion [s]: the period of the repeating cycle where it closes."""
    closes: bool = False
    """Whether the motion ends where it began, so that the cycle time is a period."""
    lower_bound: float | None = None
    """No plan of the same work is faster [s]; None where no bound is known."""
    gap: float | None = None
    """By what share of its length the plan is above the bound."""
    clearance: float | None = None
    """The least clearance proven over the whole motion, nearest to what is required there [m]."""
    required_clearance: float | None = None
    """What is required of that pair [m]."""
    travel: float | None = None
    """Way of all turning joints together [rad]."""
    limiting: Mapping[str, float] = field(default_factory=dict)
    """What the length is made of [s]: transfers by the joint that decides them, lines, dwells, and so on."""
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """By joint what it may do, as used: acceleration, jerk, lower, upper, velocity [rad, s]; infinite ones left out."""
    sliding: tuple[str, ...] = ()
    """The joints that slide: their limits are in m."""
    budgets: tuple[Kept, ...] = ()
    """The job's budget, line by line."""
    findings: tuple[Finding, ...] = ()
    """What is wrong, or is to be known."""
    caveats: tuple[str, ...] = ()
    """Sentences on what the verifier's pass leaves open."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file that was read, by its name from the task file's folder; see `loading.text_source`."""
    page: str = ""
    """Data of the plan's page, packed; empty where none were asked for, or there is no plan."""

    @property
    def has_plan(self) -> bool:
        """Whether there is a plan that the verifier passes."""
        return self.status == "planned"

    def as_document(self) -> dict[str, Any]:
        """Convert the evaluation to JSON-ready data; `of_document` gives the same value back."""
        document: dict[str, Any] = _adapter().dump_python(self, mode="json")
        return document

    @classmethod
    def of_document(cls, document: Any) -> Evaluation:
        """Restore the evaluation of a document.

        Args:
            document: as `as_document` makes it, read from JSON.

        Raises:
            ValueError: it is anything else: a key too many or too few, a wrong type, a number that is not finite.
        """
        found = _adapter().validate_json(json.dumps(document, default=str))
        if found.as_document() != document:
            raise ValueError("not an evaluation: a key is missing")
        return found


@cache
def _adapter() -> TypeAdapter[Evaluation]:
    """Build the converter between evaluations and JSON."""
    from pydantic import TypeAdapter

    return TypeAdapter(Evaluation)


def is_number(value: Any) -> bool:
    """Check that a value of a JSON file is a finite number which a float can hold."""
    return type(value) in (int, float) and abs(value) <= sys.float_info.max
