"""Evaluation: result of planning and verifying one job, as plain data that JSON represents without loss."""

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
"""All statuses, best first."""
REPEATABLE: tuple[str, ...] = ("planned", "fails_verification", "infeasible")
"""Statuses that the same input always reproduces, so that results may be cached.

`bad_input` is as quick to determine again.
"""


@dataclass(frozen=True)
class Finding:
    """Message about a place in a file, or about the job."""

    message: str
    """Problem and remedy."""
    file: str = ""
    """Name of the file as the user gave it; empty without a known place."""
    line: int = 0
    """Line number, from 1; 0 for the whole file."""
    column: int = 0
    """Column number, from 1; 0 for the whole line."""

    def __str__(self) -> str:
        """Return `file:line:column: message`, or as much of it as is known."""
        place = ":".join([self.file, *(str(n) for n in (self.line, self.column) if n)])
        return f"{place}: {self.message}" if self.file else self.message


@dataclass(frozen=True)
class Evaluation:
    """Result of one job: figures of its plan, findings about its input."""

    case: str
    """Path of the task file relative to the working directory, with forward slashes."""
    status: Status
    """Outcome."""
    cycle_time: float | None = None
    """Duration of the motion [s]; the period if the motion closes."""
    closes: bool = False
    """Whether the motion ends where it began; then the cycle time is a period."""
    lower_bound: float | None = None
    """Lower bound of the cycle time of the same work [s], or None."""
    gap: float | None = None
    """Optimality gap: share of the cycle time above the lower bound."""
    clearance: float | None = None
    """Proven clearance of the pair that is nearest to its required distance [m]."""
    required_clearance: float | None = None
    """Required clearance of that pair [m]."""
    travel: float | None = None
    """Total travel of all revolute joints [rad]."""
    torque: float | None = None
    """Largest torque as a share of the joint's effort, or None."""
    torque_joint: str = ""
    """Joint of that torque; empty without torques."""
    limiting: Mapping[str, float] = field(default_factory=dict)
    """Time [s] by its cause: transfers by bottleneck joint, lines, dwells, and so on."""
    limits: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Finite limits by joint: acceleration, jerk, lower, upper, velocity [rad, s]."""
    sliding: tuple[str, ...] = ()
    """Names of the prismatic joints, whose limits are in m."""
    budgets: tuple[Kept, ...] = ()
    """Lines of the job's budget."""
    findings: tuple[Finding, ...] = ()
    """Errors and remarks."""
    caveats: tuple[str, ...] = ()
    """Sentences on the properties that the verifier could not check."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of every file that was read; see `loading.text_source`.

    Keys are paths relative to the task file's folder.
    """
    stages: Mapping[str, float] = field(default_factory=dict)
    """Length [s] of each stage by its work; of draws alone."""
    stated: Mapping[str, float] = field(default_factory=dict)
    """Cycle time [s] that the report states for dwells that vary; of draws alone."""
    schedule: str = ""
    """Text of `schedule.json`; empty unless requested for a cycle as long."""
    page: str = ""
    """Packed data of the plan's page; empty if not requested or without a plan."""

    @property
    def has_plan(self) -> bool:
        """Whether there is a verified plan."""
        return self.status == "planned"

    def as_document(self) -> dict[str, Any]:
        """Convert to JSON-ready data; `of_document` is the inverse."""
        document = asdict(self)
        for name in ("limiting", "stages", "stated"):
            document[name] = dict(getattr(self, name))
        document["limits"] = {joint: dict(limits) for joint, limits in self.limits.items()}
        document["inputs"] = dict(self.inputs)
        document["sliding"], document["caveats"] = list(self.sliding), list(self.caveats)
        for name in ("budgets", "findings"):
            document[name] = [asdict(entry) for entry in getattr(self, name)]
        return document

    @classmethod
    def of_document(cls, document: Any) -> Evaluation:
        """Build an evaluation from JSON data.

        Args:
            document: as `as_document` makes it, read from JSON.

        Raises:
            ValueError: it is anything else: a key too many or too few, a wrong type, a number that is not finite.
        """
        names = {entry.name for entry in fields(cls)}
        if not isinstance(document, dict) or set(document) != names:
            raise ValueError("not an evaluation: its keys differ")
        if not all(
            isinstance(document[name], str) for name in ("page", "schedule", "torque_joint")
        ):
            raise ValueError("page, schedule and torque_joint must be texts")
        if document["status"] not in STATUSES or not isinstance(document["case"], str):
            raise ValueError("not an evaluation: its case or status is invalid")
        for name in _FIGURES:
            _number(document[name], name)
        if type(document["closes"]) is not bool:
            raise ValueError("closes must be true or false")
        values = dict(document)
        for name in ("limiting", "stages", "stated"):
            values[name] = _numbers(document[name], name)
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


_FIGURES = (
    "cycle_time",
    "lower_bound",
    "gap",
    "clearance",
    "required_clearance",
    "travel",
    "torque",
)
_TYPES: dict[str, tuple[type, ...]] = {
    "str": (str,),
    "int": (int,),
    "bool": (bool,),
    "float": (float, int),
    "float | None": (float, int, type(None)),
}


def is_number(value: Any) -> bool:
    """Check that a JSON value is a finite number that fits a float."""
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
    """Build a Kept or a Finding from JSON data."""
    types = {entry.name: _TYPES[str(entry.type)] for entry in fields(kind)}
    if not isinstance(value, dict) or set(value) != set(types):
        raise ValueError(f"not a {kind.__name__}: its keys are other ones")
    for name, allowed in types.items():
        if type(value[name]) not in allowed:
            raise ValueError(f"{name} has a wrong type")
        if float in allowed:
            _number(value[name], name)
    return kind(**value)
