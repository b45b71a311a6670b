"""Budgets of task files."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from dualarm_cli.loading import quantities
from dualarm_cli.loading.fields import SMALLEST_POSITIVE, Distance, Quantity, Section, refuse
from dualarm_cli.loading.yaml_source import Document
from dualarm_cli.model.budget import Budget
from dualarm_cli.model.place import Place

_LongestTime = Annotated[float, Quantity(quantities.TIME, SMALLEST_POSITIVE)]


class BudgetSection(Section):
    """What every plan of the job must keep: a plan that does not is told, and ends with exit code 1."""

    cycle_time: _LongestTime | None = Field(default=None, description="Longest cycle time [s].")
    clearance: Distance | None = Field(
        default=None,
        description="Least distance of any two bodies that must keep apart [m].",
    )

    @model_validator(mode="after")
    def _something(self) -> BudgetSection:
        if self.cycle_time is None and self.clearance is None:
            raise refuse("an empty budget; give cycle_time, clearance or both, or remove it")
        return self


def read_budget(document: Document, section: BudgetSection | None) -> Budget | None:
    """Returns the budget of a task file with the places of its figures; None where it has none."""
    if section is None:
        return None
    places = {
        name: Place(document.source.name, *document.place(("budget", name)))
        for name in ("cycle_time", "clearance")
    }
    return Budget(section.cycle_time, section.clearance, places["cycle_time"], places["clearance"])
