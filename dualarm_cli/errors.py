"""Exceptions of the package, with their data and exit codes."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import field
from difflib import get_close_matches
from reprlib import repr as shortened
from typing import Any

from dualarm_cli.explanations import Explanation, explanations
from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal, codes, message
from dualarm_cli.system import memory_limit, peak_memory


def did_you_mean(word: str, words: list[str]) -> str:
    """Suggest the closest word as ", did you mean 'x'?", or an empty string."""
    match = get_close_matches(word, words, n=1, cutoff=0.6)
    return f", did you mean '{match[0]}'?" if match else ""


@dataclass(frozen=True)
class Diagnostic:
    """Error at a place of an input file."""

    file: str
    """Name of the file as given by the user."""
    line: int
    """Line, counted from 1; 0 for the whole file."""
    column: int
    """Column, counted from 1; 0 for the whole line."""
    code: str
    """Stable short code, such as E200."""
    message: str
    """Message: value, allowed values, remedy."""
    snippet: str = ""
    """Source line without its line end."""
    about: Mapping[str, object] = field(default_factory=dict, compare=False)
    """Task, arm, joint, measured and allowed value [SI units], as far as known."""

    @property
    def place(self) -> str:
        """Place `file:line:column`, as far as known."""
        parts = [self.file] + [str(n) for n in (self.line, self.column) if n]
        return ":".join(parts)

    def __str__(self) -> str:
        """Format the diagnostic as `file:line:column: CODE message`."""
        return f"{self.place}: {self.code} {self.message}"


class DualArmError(Exception):
    """Base class of the package's exceptions, with the exit code of the process."""

    exit_code = 4

    def __repr__(self) -> str:
        """Name the kind of error, with its text."""
        return f"<{type(self).__name__}: {self}>"

    def __reduce__(self) -> tuple[Any, ...]:
        """Describe the error for other processes; constructors differ in their arguments."""
        return _restored, (type(self), self.args, self.__dict__)


def _restored(
    kind: type[DualArmError], args: tuple[Any, ...], data: dict[str, Any]
) -> DualArmError:
    """Restore an error from another process."""
    error = kind.__new__(kind, *args)
    error.__dict__.update(data)
    return error


class InputError(DualArmError):
    """Invalid input, with all diagnostics of the files."""

    exit_code = 2

    def __init__(self, diagnostics: list[Diagnostic]) -> None:
        """Store the diagnostics, at least one."""
        self.diagnostics = list(diagnostics)
        super().__init__("\n".join(str(d) for d in self.diagnostics))


class UsageError(DualArmError):
    """Invalid option or argument."""

    exit_code = 2


class OutputError(DualArmError):
    """Output that cannot be written to the requested place."""

    exit_code = 2


class UnknownSolverError(UsageError):
    """Unknown name of a solver."""

    def __init__(self, option: str, name: str, names: list[str]) -> None:
        """Store the solvers' option, the requested name and the existing names."""
        self.option, self.name, self.names = option, name, names
        guess = did_you_mean(name, names) or ";"
        self.reason = f"there is no '{name}'{guess} known: {', '.join(names)}"
        super().__init__(f"{option}: {self.reason}")


class UnsupportedError(UsageError):
    """Request that a solver, robot or version does not support, with the reason."""


class MissingDependencyError(UsageError):
    """Missing optional library."""

    def __init__(self, library: str, extra: str) -> None:
        """Store the library and the package's extra that installs it."""
        self.library, self.extra = library, extra
        super().__init__(f"{library} is not installed: pip install 'dualarm[{extra}]'")


ALLOWED: Mapping[str, str] = {
    "job": "a Job; `load(…)` makes one",
    "jobs": "several Jobs, such as `[load(…), load(…)]`",
    **dict.fromkeys(
        ("plan", "schedule", "before", "after"),
        "a Plan, a Schedule or a path; `plan(job)` makes a Plan",
    ),
    "tasks": "a path, the name of a bundled job, or a mapping",
    "changes": "a mapping by pointer, such as {'cell:/clearance': '3 mm'}",
    "pointer": "text, such as 'cell:/clearance'",
    "study": "the path of a study file, the name of a bundled job, or a mapping",
    "code": "text, such as 'E610'",
    "path": "the path of a plan's folder or of its schedule.json",
    "rate": "a number [Hz]",
    "time": "a number [s]",
    "tilt": "a number [rad]",
    **dict.fromkeys(("height", "step", "handover"), "a number [m]"),
}
"""Allowed values of Python arguments, by name, for messages."""


def check_type(name: str, value: object, *types: type) -> None:
    """Refuse an argument in ALLOWED of a wrong type.

    Args:
        name: name of the argument.
        value: value of the argument.
        types: allowed types.

    Raises:
        UsageError: with the allowed values.
    """
    if not isinstance(value, types):
        raise UsageError(f"{name} {shortened(value)}: must be {ALLOWED[name]}")


def explain(code: str) -> Explanation:
    """Look up the explanation of an error code, such as E610.

    Raises:
        UsageError: unknown code.
    """
    check_type("code", code, str)
    wanted, texts = code.strip().upper(), explanations()
    if wanted not in texts:
        guess = did_you_mean(wanted, list(texts)) or ";"
        raise UsageError(
            f"there is no error code '{code}'{guess} in a shell, `dualarm explain` lists all"
        )
    return texts[wanted]


class InfeasibleError(DualArmError):
    """No feasible plan: failing tasks with their places and measured values."""

    exit_code = 3

    def __init__(self, *refusals: Refusal) -> None:
        """Store the refusals, at least one; several have the same error code."""
        self.refusals = refusals
        super().__init__(*refusals)

    def __str__(self) -> str:
        """Format the refusals as sentences with places."""
        return self.message()

    def message(self, begin: str = "") -> str:
        """Format the refusals, each with the same beginning."""
        return message(self.refusals, begin=begin)

    @property
    def code(self) -> str:
        """Stable short code, such as E620."""
        return codes()[self.refusals[0].key]


class BlockedError(InfeasibleError):
    """Stages that lack a motion, though another order or another arm may have one."""

    def __init__(
        self,
        *refusals: Refusal,
        stages: tuple[int, ...],
        alone: bool = False,
        never: tuple[tuple[str, str], ...] = (),
        unheld: tuple[tuple[str, str], ...] = (),
    ) -> None:
        """Store the numbers of the blocked stages, from 0; the return is the last one.

        Args:
            refusals: reasons.
            stages: numbers of the stages.
            alone: whether an arm collides in a stage independently of the other arm.
            never: (arm, task id) pairs whose every posture collides with the cell.
            unheld: (arm, task id) pairs whose part the arm could not hold still.
        """
        self.stages, self.alone, self.never, self.unheld = stages, alone, never, unheld
        super().__init__(*refusals)


_OUT_OF_MEMORY = (
    "bad_alloc",
    "Cannot allocate memory",
    "can't start new thread",
    "failed to map segment",
)
"""Phrases of libraries' messages about too little memory."""
_NEARLY_ALL = 0.75
"""Fraction of the allowed memory from which its limit may cause an error.

A library that no longer fits is not counted.
"""


def lacks_memory(error: BaseException) -> bool:
    """Estimate whether too little memory caused an error.

    Libraries that cannot be loaded for lack of memory appear as missing; hence the process's limit counts as well.
    """
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return True
    if any(words in str(error) for words in _OUT_OF_MEMORY):
        return True
    allowed = memory_limit()
    return allowed is not None and peak_memory() > _NEARLY_ALL * allowed
