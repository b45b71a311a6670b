"""The one exception tree; every class carries its data and its exit code."""

from __future__ import annotations

import errno
import resource
from collections.abc import Mapping
from dataclasses import field
from difflib import get_close_matches
from pathlib import Path

from dualarm_cli.records import dataclass
from dualarm_cli.refusals import Refusal, codes, told


def did_you_mean(word: str, known: list[str]) -> str:
    """Returns ", did you mean 'x'?" for the closest known word, or an empty string."""
    match = get_close_matches(word, known, n=1, cutoff=0.6)
    return f", did you mean '{match[0]}'?" if match else ""


@dataclass(frozen=True)
class Diagnostic:
    """One thing wrong with one place of an input file."""

    file: str
    """File as the user would name it."""
    line: int
    """Line, counted from 1; 0 when the file as a whole is meant."""
    column: int
    """Column, counted from 1; 0 when the line as a whole is meant."""
    code: str
    """Stable short code, such as E200."""
    message: str
    """What was found, what is allowed, what to do."""
    snippet: str = ""
    """The offending source line, without its end."""
    about: Mapping[str, object] = field(default_factory=dict, compare=False)
    """Task, arm, joint, measured value and allowed value or range [SI units], where known."""

    @property
    def place(self) -> str:
        """`file:line:column`, or less where less is known."""
        parts = [self.file] + [str(n) for n in (self.line, self.column) if n]
        return ":".join(parts)

    def __str__(self) -> str:
        """Returns `file:line:column: CODE message`."""
        return f"{self.place}: {self.code} {self.message}"


class DualArmError(Exception):
    """Everything dualarm raises on purpose; `exit_code` is what the process ends with."""

    exit_code = 4


class InputError(DualArmError):
    """Bad input or usage; carries every diagnostic of the file at once."""

    exit_code = 2

    def __init__(self, diagnostics: list[Diagnostic]) -> None:
        """Stores the diagnostics, at least one."""
        self.diagnostics = list(diagnostics)
        super().__init__("\n".join(str(d) for d in self.diagnostics))


class UsageError(DualArmError):
    """An option or argument that cannot be used as given."""

    exit_code = 2


class OutputError(DualArmError):
    """A result that cannot be written where the user asked for it."""

    exit_code = 2


class UnknownSolverError(UsageError):
    """A solver name that its family does not have."""

    def __init__(self, option: str, name: str, known: list[str]) -> None:
        """Stores the option that names the family's solvers, the name asked for and the names there are."""
        self.option, self.name, self.known = option, name, known
        guess = did_you_mean(name, known) or ";"
        self.reason = f"there is no '{name}'{guess} known: {', '.join(known)}"
        super().__init__(f"{option}: {self.reason}")


class UnsupportedError(UsageError):
    """A request that a solver, a robot or this version does not serve, with the reason."""


class MissingDependencyError(UsageError):
    """An optional library that is not installed."""

    def __init__(self, library: str, extra: str) -> None:
        """Stores the library and the extra of this package that brings it."""
        self.library, self.extra = library, extra
        super().__init__(f"{library} is not installed: pip install 'dualarm[{extra}]'")


class InfeasibleError(DualArmError):
    """No feasible plan: the task that fails, where it is written, and how far it misses."""

    exit_code = 3

    def __init__(self, *refusals: Refusal) -> None:
        """Stores what cannot be done, at least one thing; several are of one kind."""
        self.refusals = refusals
        super().__init__(*refusals)

    def __str__(self) -> str:
        """Returns what is wrong in sentences, with places."""
        return told(self.refusals)

    @property
    def code(self) -> str:
        """Stable short code, such as E620."""
        return codes()[self.refusals[0].what]


class BlockedError(InfeasibleError):
    """Stages that collide, whatever is done about them."""

    def __init__(
        self,
        *refusals: Refusal,
        stages: tuple[int, ...],
        alone: bool = False,
        never: tuple[tuple[str, str], ...] = (),
    ) -> None:
        """Stores the numbers of the stages, from 0; that of the return is the number of all others.

        Args:
            refusals: what is wrong.
            stages: the numbers.
            alone: whether in one of them an arm collides even by itself, whatever the other one does.
            never: arms and ids of tasks that no posture of the arm does clear of the cell, in whatever order.
        """
        self.stages, self.alone, self.never = stages, alone, never
        super().__init__(*refusals)


_OUT_OF_MEMORY = (
    "bad_alloc",
    "Cannot allocate memory",
    "can't start new thread",
    "failed to map segment",
)
"""What libraries say that have too little memory, whatever they raise."""
_NEARLY_ALL = 0.75
"""What share of the memory that is allowed is nearly all: a library that does not fit any more is not counted."""


def lacks_memory(error: BaseException) -> bool:
    """Returns whether an error comes of too little memory, as far as it can be told.

    Libraries that cannot be loaded for it say that they are missing; hence the process's limit counts as well.
    """
    if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM:
        return True
    if any(words in str(error) for words in _OUT_OF_MEMORY):
        return True
    allowed = resource.getrlimit(resource.RLIMIT_AS)[0]
    try:
        lines = Path("/proc/self/status").read_text().splitlines()
        peak = next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmPeak:"))
    except (OSError, StopIteration):
        return False
    return allowed != resource.RLIM_INFINITY and peak > _NEARLY_ALL * allowed
