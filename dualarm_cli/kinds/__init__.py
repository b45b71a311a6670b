"""Kinds of work that the planner's core does not know: one folder each, and the one list of them."""

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
"""The kinds, each a folder here, with what this version does not plan together with it in one file.

That is another kind, or of the file `mode: free`, a task with a window of time, `arm: any` of such a task itself, and
a sequence. Picks, places and bare moves are the core's own.
"""


def of_kinds(name: str, apart_from: str | None = None) -> list[Any]:
    """Returns what the kinds have under one name, in the order of their list.

    `of_kinds("checks")` is the constant CHECKS of each `kinds/<kind>/checks.py`. They are imported only here, when they
    are asked for, so that the verifier loads checks and no planner, and a room can use what is built upon it.

    Args:
        name: of the module; a kind may do without it.
        apart_from: what the kinds do not go with; None for all kinds.
    """
    kinds = [k for k, apart in KINDS.items() if apart_from is None or apart_from in apart]
    modules = (f"{__name__}.{kind}.{name}" for kind in kinds)
    return [getattr(import_module(one), name.upper()) for one in modules if find_spec(one)]


__all__ = ["KINDS", "of_kinds"]
