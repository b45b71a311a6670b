"""Evaluation: what planning and judging one job came to, as plain data that goes through JSON without loss."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict, field, fields
from typing import Any, Literal, get_args

from dualarm_cli.model.budget import Kept
from dualarm_cli.records import dataclass

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
        """Returns it as JSON-ready data; `of_document` gives the same value back."""
        document = asdict(self)
        document["limiting"] = dict(self.limiting)
        document["limits"] = {joint: dict(limits) for joint, limits in self.limits.items()}
        document["inputs"] = dict(self.inputs)
        document["sliding"], document["caveats"] = list(self.sliding), list(self.caveats)
        for name in ("budgets", "findings"):
            document[name] = [asdict(entry) for entry in getattr(self, name)]
        return document

    @classmethod
    def of_document(cls, document: Any) -> Evaluation:
        """Returns the value that a document holds.

        Args:
            document: as `as_document` makes it, read from JSON.

        Raises:
            ValueError: it is anything else: a key too many or too few, a wrong type, a number that is not finite.
        """
        known = {entry.name for entry in fields(cls)}
        if not isinstance(document, dict) or set(document) != known:
            raise ValueError("not an evaluation: its keys differ")
        if not isinstance(document["page"], str):
            raise ValueError("page must be text")
        if document["status"] not in STATUSES or not isinstance(document["case"], str):
            raise ValueError("not an evaluation: its case or status is invalid")
        for name in _FIGURES:
            _number(document[name], name)
        if type(document["closes"]) is not bool:
            raise ValueError("closes must be true or false")
        values = dict(document)
        values["limiting"] = _numbers(document["limiting"], "limiting")
        limits = _mapping(document["limits"], "limits")
        values["limits"] = {joint: _numbers(entry, joint) for joint, entry in limits.items()}
        inputs = _mapping(document["inputs"], "inputs")
        if not all(isinstance(digest, str) for digest in inputs.values()):
            raise ValueError("inputs must be hashes")
        values["inputs"] = inputs
        values["sliding"] = tuple(_list(document["sliding"]))
        values["caveats"] = tuple(_list(document["caveats"]))
        if not all(isinstance(caveat, str) for caveat in values["caveats"]):
            raise ValueError("caveats must be texts")
        values["budgets"] = tuple(_entry(Kept, item) for item in _list(document["budgets"]))
        values["findings"] = tuple(_entry(Finding, item) for item in _list(document["findings"]))
        return cls(**values)


_FIGURES = ("cycle_time", "lower_bound", "gap", "clearance", "required_clearance", "travel")
_TYPES: dict[str, tuple[type, ...]] = {
    "str": (str,),
    "int": (int,),
    "bool": (bool,),
    "float": (float, int),
    "float | None": (float, int, type(None)),
}


def is_number(value: Any) -> bool:
    """Check that a value of a JSON file is a finite number which a float can hold."""
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _number(value: Any, name: str) -> None:
    if value is not None and not is_number(value):
        raise ValueError(f"{name} must be a finite number")


def _mapping(value: Any, name: str) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{name} must be a mapping")
    return value


def _numbers(value: Any, name: str) -> dict[str, float]:
    for key, number in _mapping(value, name).items():
        if number is None:
            raise ValueError(f"{name} {key} must be a finite number")
        _number(number, f"{name} {key}")
    return dict(value)


def _list(value: Any) -> list[Any]:
    if not isinstance(value, list):
        raise ValueError("budgets, findings, caveats and sliding joints must be lists")
    return value


def _entry(kind: type[Any], value: Any) -> Any:
    """Returns a Kept or a Finding; raises ValueError for anything else."""
    types = {entry.name: _TYPES[str(entry.type)] for entry in fields(kind)}
    if not isinstance(value, dict) or set(value) != set(types):
        raise ValueError(f"not a {kind.__name__}: its keys are other ones")
    for name, allowed in types.items():
        if type(value[name]) not in allowed:
            raise ValueError(f"{name} has a wrong type")
        if float in allowed:
            _number(value[name], name)
    return kind(**value)
