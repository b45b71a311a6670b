"""Registry of a family of solvers: names, pure functions, references, reasons why not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, Protocol, TypeVar

from dualarm_cli.errors import UnknownSolverError
from dualarm_cli.records import dataclass

P = TypeVar("P")
S = TypeVar("S")


class Named(Protocol):
    """Anything that a registry can hold."""

    @property
    def name(self) -> str:
        """Word on the command line and in files."""

    @property
    def summary(self) -> str:
        """What it does, in one sentence."""

    @property
    def reference(self) -> str:
        """Paper and equation, or that it is our own."""


E = TypeVar("E", bound=Named)


def _always_supported(_: object) -> str | None:
    return None


@dataclass(frozen=True)
class Solver(Generic[P, S]):
    """One member of a family of interchangeable methods."""

    name: str
    """Word on the command line and in files."""
    solve: Callable[[P], S]
    """The method itself: a pure function from a problem to a solution."""
    summary: str
    """What it does, in one sentence."""
    reference: str
    """Paper and equation, or that it is our own."""
    why_unsupported: Callable[[P], str | None] = _always_supported
    """A reason why the problem is outside this method, or None."""


class Registry(Generic[E]):
    """The solvers of one family, best default first."""

    def __init__(self, family: str, option: str, solvers: list[E]) -> None:
        """Builds the family from an explicit list; names must differ.

        Args:
            family: what its members are.
            option: the option of the command line that names one.
            solvers: the members.
        """
        self.family, self.option = family, option
        self._solvers = {solver.name: solver for solver in solvers}
        if len(self._solvers) != len(solvers):
            raise ValueError(f"two {family} solvers share a name")

    def __iter__(self) -> Iterator[E]:
        """Iterates over the solvers in their listed order."""
        return iter(self._solvers.values())

    def __getitem__(self, name: str) -> E:
        """Returns the solver of that name.

        Raises:
            UnknownSolverError: no solver of the family has that name.
        """
        if name not in self._solvers:
            raise UnknownSolverError(self.option, name, list(self._solvers))
        return self._solvers[name]

    @property
    def names(self) -> list[str]:
        """Names in their listed order."""
        return list(self._solvers)
