"""Registry of a family of solvers: names, functions, references, supported problems."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Generic, Protocol, TypeVar

from dualarm_cli.errors import UnknownSolverError
from dualarm_cli.records import dataclass

P = TypeVar("P")
S = TypeVar("S")


class Named(Protocol):
    """Interface of a registry's members."""

    @property
    def name(self) -> str:
        """Name on the command line and in files."""

    @property
    def summary(self) -> str:
        """Summary in a sentence."""

    @property
    def reference(self) -> str:
        """Source: paper and equation, or our own."""


E = TypeVar("E", bound=Named)


def _always_supported(_: object) -> str | None:
    return None


@dataclass(frozen=True)
class Solver(Generic[P, S]):
    """Member of a family of interchangeable solvers."""

    name: str
    """Name on the command line and in files."""
    solve: Callable[[P], S]
    """Pure function from a problem to a solution."""
    summary: str
    """Summary in a sentence."""
    reference: str
    """Source: paper and equation, or our own."""
    why_unsupported: Callable[[P], str | None] = _always_supported
    """Function from a problem to the reason why it is not supported, or None."""


class Registry(Generic[E]):
    """Solvers of a family, best default first."""

    def __init__(self, family: str, option: str, solvers: list[E]) -> None:
        """Register a list of solvers with different names.

        Args:
            family: name of the family.
            option: keyword of `plan`, and option of commands without its dashes.
            solvers: the members.
        """
        self.family, self.option = family, option
        self._solvers = {solver.name: solver for solver in solvers}
        if len(self._solvers) != len(solvers):
            raise ValueError(f"two {family} solvers share a name")

    def __iter__(self) -> Iterator[E]:
        """Iterate over the solvers in their listed order."""
        return iter(self._solvers.values())

    def __getitem__(self, name: str) -> E:
        """Return the solver of a name.

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
