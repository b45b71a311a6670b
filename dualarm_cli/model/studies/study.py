"""Layout studies: parameters of files, their values, and the objectives."""

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
"""Significant digits of computed values, so that 0.1 + 2 * 0.1 is 0.3."""


@dataclass(frozen=True)
class Amount:
    """Number in a file, with its unit if it has one."""

    number: float
    """Number as written; an int only if written as one and without unit."""
    unit: str = ""
    """Unit as written; empty for a plain number, which is SI."""
    factor: float = 1.0
    """SI value of one unit."""
    base: str = ""
    """SI unit of the same dimension; empty for plain numbers and fractions."""

    @property
    def si(self) -> float:
        """Value in SI units."""
        return self.number * self.factor

    @property
    def written(self) -> float | str:
        """Value as it is written into a file."""
        return f"{self.number!r} {self.unit}" if self.unit else self.number

    @property
    def shown(self) -> str:
        """Value for users, with six digits."""
        return f"{self.number:.6g} {self.unit}" if self.unit else f"{self.number:.6g}"


Level = Amount | str | bool
"""Value of a parameter."""
Point = tuple[Level, ...]
"""Values of all parameters, in their order."""


@dataclass(frozen=True)
class Target:
    """Value of a file that a parameter changes."""

    role: str
    """File of the value: tasks, cell, robot, robot.left, robot.right."""
    path: str
    """Path to the value, as written."""
    apply: Apply
    """Operation: set replaces, shift adds to, scale multiplies the file's value."""
    keys: tuple[str, ...]
    """Location of the value as `role:/json/pointer`, for each task file."""
    present: tuple[Amount | str | bool | None, ...]
    """Present value, for each task file; None for no value."""


@dataclass(frozen=True)
class Span:
    """Range between two values of one unit."""

    low: Amount
    """Smallest value."""
    high: Amount
    """Largest value."""

    def at(self, fraction: float) -> Amount:
        """Interpolate a value at a fraction from 0 to 1."""
        low, high = self.low, self.high
        number = tidy(low.number + fraction * (high.number - low.number))
        return Amount(float(number), low.unit, low.factor, low.base)


@dataclass(frozen=True)
class Parameter:
    """Quantity that a study varies."""

    name: str
    """Name as the user gave it."""
    targets: tuple[Target, ...]
    """Values of files that it changes together."""
    levels: tuple[Level, ...]
    """Values to try; empty for a span."""
    span: Span | None
    """Range to sample; None for given values."""
    place: Place
    """Place of the parameter in the study file."""

    @property
    def unit(self) -> str:
        """Unit of its numbers; empty for plain numbers and texts."""
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
    """Sampling of ranges."""

    method: SamplingMethod
    """Method: latin_hypercube or halton."""
    count: int
    """Number of points."""
    seed: int
    """Random seed."""


@dataclass(frozen=True)
class Objective:
    """Quantity to minimise or maximise."""

    name: str
    """Name in study files."""
    title: str
    """Name in tables and figures."""
    sense: Sense
    """Direction: minimise or maximise."""
    unit: str
    """SI unit."""
    shown_unit: str
    """Unit in tables and figures."""
    shown_factor: float
    """Factor from SI units to shown units."""
    digits: int
    """Decimal places of shown numbers; values that look equal count as equal."""

    def cost(self, value: float) -> float:
        """Compute a cost to minimise, in whole steps."""
        steps = round(value / self.step)
        return (steps if self.sense == "minimise" else -steps) * self.step

    def shown(self, value: float | None) -> str:
        """Format a value for tables, without its unit."""
        return "–" if value is None else f"{value * self.shown_factor:.{self.digits}f}"

    @property
    def step(self) -> float:
        """Smallest shown difference [SI]; finer differences are irrelevant to a layout."""
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
        Objective("torque", "torque share", "minimise", "", "%", 100.0, 1),
    )
}
"""Objectives of studies, by their names in study files."""


@dataclass(frozen=True)
class StudyTasks:
    """Task file of a study."""

    path: Path
    """Path of the file."""
    name: str
    """Name for users."""


@dataclass(frozen=True)
class Study:
    """Layout study: jobs, parameters, objectives and sampling."""

    name: str
    """Study file, as the user names it."""
    tasks: tuple[StudyTasks, ...]
    """Jobs; every point is planned for all of them."""
    parameters: tuple[Parameter, ...]
    """Quantities to vary."""
    objectives: tuple[Objective, ...]
    """Objectives, most important first."""
    sampling: Sampling | None
    """Sampling of ranges; None for the default."""
    settings: Mapping[str, str | int] = field(default_factory=dict)
    """Planner settings from the file, by the names of PlanSettings."""
    setting_places: Mapping[str, Place] = field(default_factory=dict)
    """Places of these settings in the file."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """SHA-256 of the study file and of all files of the jobs."""


def tidy(number: float) -> float:
    """Round a computed number to twelve digits; 0 gets no sign."""
    return float(f"{number:.{DIGITS}g}") + 0.0
