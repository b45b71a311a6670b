"""Options that several commands share."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer


class Effort(StrEnum):
    """How hard to try: more time for a smaller gap."""

    quick = "quick"
    normal = "normal"
    thorough = "thorough"


EffortOption = Annotated[
    Effort, typer.Option("--effort", help="How hard to try: more planning time for a faster plan.")
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of all randomness.")
]
