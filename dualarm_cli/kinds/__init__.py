"""Kinds of work that the planner's core does not know: one folder each, and the one list of them."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import Any

KINDS = ("path", "seam", "conveyor", "handover", "tool_change", "buffer")
"""The kinds, each a folder here. Picks, places and bare moves are the core's own."""


def of_kinds(name: str) -> list[Any]:
    """Returns what the kinds have under one name, in the order of their list.

    `of_kinds("checks")` is the constant CHECKS of each `kinds/<kind>/checks.py`. They are imported only here, when they
    are asked for, so that the verifier loads checks and no planner, and a room can use what is built upon it.

    Args:
        name: of the module; a kind may do without it.
    """
    modules = (f"{__name__}.{kind}.{name}" for kind in KINDS)
    return [getattr(import_module(one), name.upper()) for one in modules if find_spec(one)]


__all__ = ["KINDS", "of_kinds"]
