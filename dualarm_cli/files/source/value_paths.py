"""Paths to values of files, such as `obstacles.table.xyz[2]`: parsing, look-up, JSON pointers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

from dualarm_cli.errors import did_you_mean
from dualarm_cli.files.source.text_source import quote, suggest
from dualarm_cli.files.source.yaml_source import Loc
from dualarm_cli.records import dataclass

_STEP = re.compile(r"""\[\s*(?:"([^"]*)"|'([^']*)'|([^\]'"]*?))\s*\]|\.?([^.\[\]]+)""")


class PathError(ValueError):
    """A path that cannot be read or leads nowhere; its text is the whole message."""

    def __init__(self, message: str, lacks: bool = False, guessed: bool = False) -> None:
        """Store the message and its kind.

        Args:
            message: the whole text.
            lacks: whether a key or entry is missing.
            guessed: whether the message guesses the key or entry that was meant.
        """
        super().__init__(message)
        self.lacks, self.guessed = lacks, guessed


@dataclass(frozen=True)
class PathStep:
    """Step of a path."""

    text: str
    """Key, name or index."""
    dotted: bool
    """Whether dots enclose it: it may be part of a dotted key."""


def read_path(text: str) -> tuple[PathStep, ...]:
    """Parse the steps of a path.

    Args:
        text: such as `base.xyz[2]`, `frames["bin.slot_3"].xyz[0]` or `tasks.tray-1.pick.xyz[0]`.

    Raises:
        PathError: it cannot be read.
    """
    steps, end = [], 0
    while end < len(text):
        match = _STEP.match(text, end)
        given = next((g for g in match.groups() if g), None) if match else None
        if match is None or given is None or not given.strip():
            raise PathError(
                f"{quote(text)} cannot be read from character {end + 1} on; write one such as base.xyz[2]"
            )
        steps.append(PathStep(given.strip(), match[4] is not None))
        end = match.end()
    if not steps:
        raise PathError("is empty; write a path such as base.xyz[2]")
    return tuple(steps)


def find_value(data: Any, text: str, file: str) -> Loc:
    """Find the place of the single value that a path leads to.

    Entries of lists are found by index from 0, or by their name or id. Keys may have dots.

    Args:
        data: content of a file.
        text: the path.
        file: what the user calls the file.

    Raises:
        PathError: it leads nowhere, to several values, or to a mapping or a list.
    """
    steps = read_path(text)
    search = _Search(data, steps)
    locs = list(search.places(data, 0, ()))
    if not locs:
        raise search.failure(file)
    if len(locs) > 1:
        targets = " and ".join(shown_path(data, loc) for loc in locs)
        raise PathError(f"{quote(text)} leads to {targets} in {file}; write the one that is meant")
    value = value_at(data, locs[0])
    if isinstance(value, dict | list):
        inside = _names(value)
        kind = "a mapping" if isinstance(value, dict) else f"a list of {len(value)}"
        what = f"; in it: {', '.join(inside[:12])}" if inside else ""
        raise PathError(f"{quote(text)} is {kind} in {file}; name one value of it{what}")
    return locs[0]


def value_at(data: Any, loc: Loc) -> Any:
    """Look up the value at a place."""
    for step in loc:
        data = data[step]
    return data


def shown_path(data: Any, loc: Loc) -> str:
    """Format a place as a readable path, with list entries by name."""
    text = ""
    for step in loc:
        name = _name_of(data[step]) if isinstance(step, int) else None
        if isinstance(step, int):
            text += f".{name}" if name is not None else f"[{step}]"
        else:
            text += f'["{step}"]' if "." in step or "[" in step else f".{step}"
        data = data[step]
    return text.lstrip(".")


def to_pointer(loc: Loc) -> str:
    """Format a place as a JSON pointer."""
    return "".join(f"/{str(step).replace('~', '~0').replace('/', '~1')}" for step in loc)


def pointer_steps(pointer: str) -> list[str]:
    """Split a JSON pointer into its keys and indices."""
    return [step.replace("~1", "/").replace("~0", "~") for step in pointer.split("/")[1:]]


def from_pointer(data: Any, pointer: str, may_add: bool = False) -> Loc:
    """Find the place of a JSON pointer in a file's data.

    Args:
        data: content of a file.
        pointer: such as `/base/xyz/2` or `/tasks/tray-1/pick`; entries of lists by index, name or id.
        may_add: whether the last key may be missing in its mapping.

    Raises:
        PathError: the place does not exist.
    """
    loc: Loc = ()
    names = pointer_steps(pointer)
    for k, name in enumerate(names):
        last = k == len(names) - 1
        if isinstance(data, list):
            index = int(name) if name.isascii() and name.isdigit() and int(name) < len(data) else -1
            entries = _names(data)
            if index < 0 and name not in entries:
                listed = suggest(name, entries, "there")
                raise PathError(f"a list of {len(data)} has no {quote(name)}{listed}")
            index = index if index >= 0 else entries.index(name)
            loc, data = (*loc, index), data[index]
        elif not isinstance(data, dict):
            raise PathError(f"{quote(data)} has no {quote(name)} in it")
        elif name in data or (may_add and last):
            loc, data = (*loc, name), data.get(name)
        else:
            raise PathError(f"no {quote(name)}{suggest(name, [str(key) for key in data], 'there')}")
    return loc


class _Search:
    """Search for every place that a path may mean, with the deepest place reached."""

    def __init__(self, data: Any, steps: tuple[PathStep, ...]) -> None:
        self.data, self.steps = data, steps
        self._deepest: tuple[int, Loc] = (0, ())

    def places(self, node: Any, k: int, loc: Loc) -> Iterator[Loc]:
        """Yield the places reached by the steps from the k-th on."""
        if k > self._deepest[0]:
            self._deepest = (k, loc)
        if k == len(self.steps):
            yield loc
            return
        for key, taken in self._matches(node, k):
            yield from self.places(node[key], k + taken, (*loc, key))

    def _matches(self, node: Any, k: int) -> Iterator[tuple[str | int, int]]:
        """Yield matching keys or indices, with the number of steps that each takes."""
        for taken in range(len(self.steps) - k, 0, -1):
            steps = self.steps[k : k + taken]
            if taken > 1 and not all(step.dotted for step in steps):
                continue
            name = ".".join(step.text for step in steps)
            if isinstance(node, dict) and name in node:
                yield name, taken
            elif isinstance(node, list):
                for index, entry in enumerate(node):
                    if _name_of(entry) == name or (taken == 1 and name == str(index)):
                        yield index, taken

    def failure(self, file: str) -> PathError:
        """Create the error of a path that leads nowhere."""
        k, loc = self._deepest
        node = value_at(self.data, loc)
        where = f"{quote(shown_path(self.data, loc))} of {file}" if loc else file
        missing = self.steps[k].text
        if not isinstance(node, dict | list):
            return PathError(f"{where} is {quote(node)}; there is no {quote(missing)} in it")
        names = _names(node)
        if not loc:
            names = [name for name in names if name != "dualarm"]
        if isinstance(node, list) and all(name.isdecimal() for name in names):
            span = f"its entries are [0] to [{len(node) - 1}]" if node else "it is empty"
            return PathError(f"{where} has no {quote(missing)}; {span}", True)
        message = f"{where} has no {quote(missing)}{suggest(missing, names, 'there')}"
        return PathError(message, True, bool(did_you_mean(missing, names)))


def _name_of(entry: Any) -> str | None:
    """Return the name or id of a list entry."""
    if not isinstance(entry, dict):
        return None
    return next((entry[key] for key in ("name", "id") if isinstance(entry.get(key), str)), None)


def _names(node: Any) -> list[str]:
    """List the names in a mapping or a list."""
    if isinstance(node, dict):
        return [str(key) for key in node]
    return [_name_of(entry) or str(index) for index, entry in enumerate(node)]
