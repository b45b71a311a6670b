"""Layout studies: parameters of files, the values they take, and what is to become good."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from pathlib import Path
from typing import Literal

from dualarm_cli.model.place import Place
from dualarm_cli.records import dataclass

Apply = Literal["set", "shift", "scale"]
Sense = Literal["minimise", "maximise"]
SamplingMethod = Literal["latin_hypercube", "halton"]
DIGITS = 12
"""Significant digits of computed values, so that 0.1 + 2 * 0.1 is 0.3, as people write it."""


@dataclass(frozen=True)
class Amount:
    """A number as it stands in a file, with its unit if it has one."""

    number: float
    """The number; an int where it was written as one and has no unit."""
    unit: str = ""
    """Unit as written; nothing for a plain number, which is SI."""
    factor: float = 1.0
    """SI value of one unit."""
    base: str = ""
    """SI unit of the same dimension; nothing for plain numbers and fractions."""

    @property
    def si(self) -> float:
        """Its value in SI."""
        return self.number * self.factor

    @property
    def written(self) -> float | str:
        """How it is written into a file."""
        return f"{self.number!r} {self.unit}" if self.unit else self.number

    @property
    def shown(self) -> str:
        """How it is shown to people, to six digits."""
        return f"{self.number:.6g} {self.unit}" if self.unit else f"{self.number:.6g}"


Level = Amount | str | bool
"""One value of a parameter."""
Point = tuple[Level, ...]
"""One value of every parameter, in their order."""


@dataclass(frozen=True)
class Target:
    """A value of a file that a parameter changes."""

    role: str
    """Which file: tasks, cell, robot, robot.left, robot.right."""
    path: str
    """Path to the value, as written."""
    apply: Apply
    """set: the parameter is the value; shift: is added to the file's; scale: multiplies it."""
    keys: tuple[str, ...]
    """By task file: `role:/json/pointer` of the value."""
    found: tuple[Amount | str | bool | None, ...]
    """By task file: what the file has; None where that is nothing."""


@dataclass(frozen=True)
class Span:
    """All values between two, both of one unit."""

    low: Amount
    """Least value."""
    high: Amount
    """Greatest value."""

    def at(self, share: float) -> Amount:
        """Returns the value at a share of the way, from 0 to 1."""
        low, high = self.low, self.high
        number = tidy(low.number + share * (high.number - low.number))
        return Amount(float(number), low.unit, low.factor, low.base)


@dataclass(frozen=True)
class Parameter:
    """Something that a study varies."""

    name: str
    """What the user calls it."""
    targets: tuple[Target, ...]
    """What it changes, all together."""
    levels: tuple[Level, ...]
    """Its values; empty where it has a span."""
    span: Span | None
    """Its range where that has no steps."""
    place: Place
    """Where the study file has it."""

    @property
    def unit(self) -> str:
        """Unit of its numbers; nothing where they are plain or where it is text."""
        if self.span is not None:
            return self.span.low.unit
        first = self.levels[0]
        return first.unit if isinstance(first, Amount) else ""

    @property
    def is_numeric(self) -> bool:
        """Whether its values are numbers."""
        return self.span is not None or all(isinstance(level, Amount) for level in self.levels)


@dataclass(frozen=True)
class Sampling:
    """How points are spread over the ranges without steps."""

    method: SamplingMethod
    """latin_hypercube or halton."""
    count: int
    """How many points."""
    seed: int
    """Seed of the spread."""


@dataclass(frozen=True)
class Objective:
    """What is to become small or large."""

    name: str
    """As in study files."""
    title: str
    """As tables and figures call it."""
    sense: Sense
    """Which way is better."""
    unit: str
    """SI unit."""
    shown_unit: str
    """Unit in tables and figures."""
    shown_factor: float
    """Shown numbers are SI numbers times this."""
    digits: int
    """Digits after the point of shown numbers: what looks alike counts as alike."""

    def cost(self, value: float) -> float:
        """Returns a number that is the smaller the better, in whole steps."""
        steps = round(value / self.step)
        return (steps if self.sense == "minimise" else -steps) * self.step

    def shown(self, value: float | None) -> str:
        """Returns a value as tables show it, without its unit."""
        return "–" if value is None else f"{value * self.shown_factor:.{self.digits}f}"

    @property
    def step(self) -> float:
        """The least difference that shows [SI]: nobody builds a cell by a smaller one, and proofs are no finer."""
        return float(10.0**-self.digits / self.shown_factor)

    @property
    def label(self) -> str:
        """Title with the shown unit."""
        return f"{self.title} [{self.shown_unit}]"


OBJECTIVES: Mapping[str, Objective] = {
    objective.name: objective
    for objective in (
        Objective("cycle_time", "cycle time", "minimise", "s", "s", 1.0, 3),
        Objective("gap", "gap to the bound", "minimise", "", "%", 100.0, 1),
        Objective("clearance", "clearance", "maximise", "m", "mm", 1e3, 1),
        Objective("travel", "joint travel", "minimise", "rad", "rad", 1.0, 2),
    )
}
"""What a study can be asked to improve, by the names in study files."""


@dataclass(frozen=True)
class StudyTasks:
    """A task file of a study."""

    path: Path
    """Where it is."""
    name: str
    """What the user would call it."""


@dataclass(frozen=True)
class Study:
    """What is varied, over which values, and what is to become good."""

    name: str
    """The study file, as the user names it."""
    tasks: tuple[StudyTasks, ...]
    """The jobs; every point is planned for all of them."""
    parameters: tuple[Parameter, ...]
    """What is varied."""
    objectives: tuple[Objective, ...]
    """What is to become good, most important first."""
    sampling: Sampling | None
    """How ranges without steps are sampled; None where the file does not say."""
    settings: Mapping[str, str | int] = field(default_factory=dict)
    """Settings of planning that the file gives, by the names of PlanSettings."""
    setting_places: Mapping[str, Place] = field(default_factory=dict)
    """Where the file gives them."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the study file and of all files of the jobs."""


def tidy(number: float) -> float:
    """Returns a computed number as people would write it: to twelve digits; 0 has no sign."""
    return float(f"{number:.{DIGITS}g}") + 0.0
