"""JSON Schema of quantities: a number, or text with a unit."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pydantic.config import JsonDict

from dualarm_cli.files.source.quantities import Dimension

NUMBER = r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?"
"""Pattern of numbers as files spell them: a decimal point, no leading zero."""
_SPELLINGS = {"^2": "(\\^2|2|²)", "^3": "(\\^3|3|³)", "um": "[uµμ]m", "deg": "(deg|°)"}
"""Patterns of what units may be written as."""


def quantity_schema(
    dimensions: Sequence[Dimension],
    low: float = -math.inf,
    high: float = math.inf,
    words: Sequence[str] = (),
) -> JsonDict:
    """Returns the JSON Schema of a number within a range, or of text with a unit.

    A schema cannot say the range of text with a unit.

    Args:
        dimensions: what it may be.
        low: least plain number.
        high: greatest plain number.
        words: patterns of texts that may stand in place of a quantity.
    """
    units = [unit for dimension in dimensions for unit in dimension.units if unit]
    plain = " or ".join(dict.fromkeys(d.unit for d in dimensions if d.unit))
    number: JsonDict = {"type": "number", "title": plain or "number"}
    if low > -math.inf:
        number["minimum"] = low
    if high < math.inf:
        number["maximum"] = high
    text: JsonDict = {
        "type": "string",
        "title": f"with a unit: {', '.join(units)}" if units else "number as text",
        "pattern": "|".join(f"^{one}$" for one in (text_pattern(dimensions), *words)),
    }
    return {"anyOf": [number, text]}


def text_pattern(dimensions: Sequence[Dimension]) -> str:
    """Returns the pattern of a number as text, with or without a unit of some dimensions."""
    units = [_unit(unit) for dimension in dimensions for unit in dimension.units if unit]
    return rf"\s*{NUMBER}\s*" + (rf"({'|'.join(units)})?\s*" if units else "")


def _unit(unit: str) -> str:
    """Returns the pattern of a unit's spellings."""
    for plain, pattern in _SPELLINGS.items():
        unit = unit.replace(plain, pattern)
    return unit
