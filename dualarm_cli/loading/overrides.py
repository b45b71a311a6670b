"""Values in place of those that stand in a file: what a study varies, and nothing else."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from dualarm_cli.errors import InputError
from dualarm_cli.loading.text_source import quote, suggest
from dualarm_cli.loading.yaml_source import Document, Loc

KINDS = ("tasks", "cell", "robot")
"""Kinds of files whose values may be replaced."""


def with_overrides(document: Document, values: Mapping[str, Any]) -> Document:
    """Returns a document with some of its values replaced; places stay those of what was replaced.

    Args:
        document: of any kind.
        values: by kind and JSON pointer, such as `cell:/frames/bin/xyz/0`; those of other kinds are passed over.

    Raises:
        InputError: a pointer that leads nowhere. A key that a mapping lacks is added to it, an entry of a list is not.
    """
    kind = str(document.data.get("dualarm", "")).partition("/")[0]
    own = {name: value for name, value in values.items() if name.partition(":")[0] == kind}
    if not own:
        return document
    data = copy.deepcopy(document.data)
    for name, value in own.items():
        _put(document, data, name, value)
    return replace(document, data=data)


def steps_of(pointer: str) -> list[str]:
    """Returns the keys and indices of a JSON pointer, as text."""
    return [step.replace("~1", "/").replace("~0", "~") for step in pointer.split("/")[1:]]


def _put(document: Document, data: Any, name: str, value: Any) -> None:
    """Puts one value where a pointer says.

    Raises:
        InputError: it leads nowhere.
    """
    holder, loc = data, list[str | int]()
    steps = steps_of(name.partition(":")[2])
    for number, step in enumerate(steps):
        key: str | int = step
        last = number == len(steps) - 1
        if isinstance(holder, list):
            if not (step.isascii() and step.isdigit() and int(step) < len(holder)):
                raise _nowhere(document, loc, name, f"a list of {len(holder)} has no {quote(step)}")
            key = int(step)
        elif not isinstance(holder, dict):
            raise _nowhere(document, loc, name, f"{quote(holder)} has no {quote(step)} in it")
        elif step not in holder and not last:
            known = [str(key) for key in holder]
            raise _nowhere(document, loc, name, f"no {quote(step)}{suggest(step, known, 'there')}")
        if last:
            holder[key] = copy.deepcopy(value)
            return
        holder = holder[key]
        loc.append(key)
    raise _nowhere(document, loc, name, "write a pointer such as cell:/clearance")


def _nowhere(document: Document, loc: list[str | int], name: str, reason: str) -> InputError:
    place: Loc = tuple(loc)
    return InputError([document.diagnostic(place, "E300", f"{name} leads nowhere: {reason}")])
