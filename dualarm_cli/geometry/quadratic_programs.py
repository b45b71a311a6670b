"""The solver of quadratic programs, as it is on every processor."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any


@cache
def plain_piqp() -> Any:
    """Load piqp's variant for any processor, not that for the machine's instructions."""
    return import_module("piqp.piqp_python")
