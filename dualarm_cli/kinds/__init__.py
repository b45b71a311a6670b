"""Kinds of work besides picks, places and moves, and their list.

Each has a folder here.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import Any

KINDS: Mapping[str, tuple[str, ...]] = {
    "path": ("free", "window", "any", "sequence", "conveyor", "tool_change"),
    "seam": ("free", "window", "any", "sequence", "conveyor", "tool_change"),
    "conveyor": (),
    "handover": ("sequence", "conveyor", "tool_change"),
    "tool_change": (),
    "buffer": (),
}
"""Kinds of work by folder name, with the features unsupported with each.

A feature is another kind in the same file, `mode: free`, a task with a time window, `arm: any` of such a
task itself, and a sequence. Picks, places and bare moves belong to the core.

That is another kind, or of the file `mode: free`, a task with a window of time, `arm: any` of such a task itself, and
a sequence. Picks, places and bare moves are the core's own.
"""


def of_kinds(name: str, apart_from: str | None = None) -> list[Any]:
    """Load a constant of every kind that has it, in the list's order.

    `of_kinds("checks")` is the constant CHECKS of each `kinds/<kind>/checks.py`. They are imported on
    demand: the verifier loads checks and no planner, and a module can load kinds that import it.

    Args:
        name: of the module; kinds without it are skipped.
        apart_from: feature that the kinds cannot be combined with; None for all kinds.
    """
    kinds = [k for k, excluded in KINDS.items() if apart_from is None or apart_from in excluded]
    modules = (f"{__name__}.{kind}.{name}" for kind in kinds)
    return [getattr(import_module(module), name.upper()) for module in modules if find_spec(module)]


__all__ = ["KINDS", "of_kinds"]
