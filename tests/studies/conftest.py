"""Studies without planning: nouns by hand, and a desk whose plans are a function of the replaced values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from dualarm_cli.evaluation.request import Request
from dualarm_cli.evaluation.store import Store
from dualarm_cli.model.place import Place
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.model.studies.study import (
    OBJECTIVES,
    Amount,
    Level,
    Parameter,
    Sampling,
    Span,
    Study,
    StudyTasks,
    Target,
)
from dualarm_cli.studies.search import Desk

Figures = Callable[..., dict[str, float] | None]


def make_parameter(name: str, values: Sequence[Level] | tuple[float, float]) -> Parameter:
    """Returns a parameter of a cell's value of the same name: listed values, or two numbers for a range."""
    target = Target("cell", name, "set", (f"cell:/{name}",), (None,))
    if isinstance(values, tuple):
        low, high = values
        return Parameter(
            name, (target,), (), Span(Amount(low), Amount(high)), Place("s.yaml", 3, 3)
        )
    levels = tuple(v if isinstance(v, str | bool | Amount) else Amount(v) for v in values)
    return Parameter(name, (target,), levels, None, Place("s.yaml", 3, 3))


@pytest.fixture(scope="session")
def make_study() -> Callable[..., Study]:
    """Makes a study of one job from parameters by name."""

    def make(
        objectives: Sequence[str] = ("cycle_time",),
        sampling: Sampling | None = None,
        **parameters: Any,
    ) -> Study:
        return Study(
            "s.yaml",
            (StudyTasks(Path("tasks.yaml"), "tasks.yaml"),),
            tuple(make_parameter(name, values) for name, values in parameters.items()),
            tuple(OBJECTIVES[name] for name in objectives),
            sampling,
        )

    return make


class CountingRun:
    """Evaluates by a function of the replaced values; counts, and can stop in the middle."""

    def __init__(self, figures: Figures, backwards: bool = False) -> None:
        """Stores the function: figures by name, None for no plan."""
        self.figures, self.backwards = figures, backwards
        self.asked: list[dict[str, Any]] = []
        self.stop_after: int | None = None

    def __call__(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        """Yields answers, in the order of the requests or backwards."""
        order = list(enumerate(requests))
        for index, request in reversed(order) if self.backwards else order:
            if self.stop_after is not None and len(self.asked) >= self.stop_after:
                raise KeyboardInterrupt
            values = {key.removeprefix("cell:/"): v for key, v in request.overrides.items()}
            self.asked.append(values)
            yield index, self.answer(request, values)

    def answer(self, request: Request, values: dict[str, Any]) -> Evaluation:
        """Returns the evaluation of one request; its inputs are those of no file."""
        found = self.figures(**values) if values else {"cycle_time": 99.0}
        if found is None:
            return Evaluation(request.case, "infeasible", findings=(Finding("does not reach"),))
        if found.get("gap") is not None:
            found = {"lower_bound": found["cycle_time"] * (1.0 - found["gap"]), **found}
        return Evaluation(request.case, "planned", **found)


@pytest.fixture(scope="session")
def counting() -> type[CountingRun]:
    """The run whose plans are a function."""
    return CountingRun


@pytest.fixture(scope="session")
def desk() -> Callable[[CountingRun], Desk]:
    """Makes a desk without a store."""
    return lambda run, store=None: Desk(run, store)


@pytest.fixture
def store(tmp_path: Path) -> Store:
    """An empty store."""
    return Store(tmp_path / "cache")
