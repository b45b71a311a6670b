"""Plain YAML scalars as YAML 1.2's core schema reads them, with numbers that stay finite."""

from __future__ import annotations

import math
import re

from dualarm_cli.loading.text_source import quote

MAX_NUMBER_LENGTH = 40
"""Longest spelling of a number."""
_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)", re.ASCII)
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?", re.ASCII)
_NON_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


class ScalarError(ValueError):
    """A number that is too long or not finite; its text is the whole message."""


def core_scalar(text: str) -> str | int | float | bool | None:
    """Returns what an unquoted scalar means.

    Octal, hexadecimal, sexagesimal and date spellings and leading zeros stay text, so that
    whoever wants a number there can say what to write instead.

    Args:
        text: the scalar as written.

    Raises:
        ScalarError: a number of absurd length, an infinity or not a number.
    """
    if text in _WORDS:
        return _WORDS[text]
    if not (text[0] in "+-." or text[0].isdigit()):
        return text
    is_float = _FLOAT.fullmatch(text)
    if is_float and len(text) > MAX_NUMBER_LENGTH:
        raise ScalarError(f"number of {len(text)} characters; at most {MAX_NUMBER_LENGTH} are read")
    if _NON_FINITE.fullmatch(text) or (is_float and not math.isfinite(float(text))):
        raise ScalarError(f"non-finite number {quote(text)} is not allowed")
    if _INT.fullmatch(text):
        return int(text)
    return float(text) if is_float else text
