"""YAML parser that keeps line and column of every key and value."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import field
from functools import cache
from typing import Any

import yaml

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.overrides import Override
from dualarm_cli.files.source.text_source import TextSource, quote
from dualarm_cli.records import dataclass

MAX_NUMBER_LENGTH = 40
"""Maximum length of a number."""
_INT = re.compile(r"[-+]?(0|[1-9][0-9]*)", re.ASCII)
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|(0|[1-9][0-9]*)(\.[0-9]*)?)([eE][-+]?[0-9]+)?", re.ASCII)
_UNIT_OF_LIST = re.compile(r"[0-9]\s*\]\s*(%|[a-z][a-z/^0-9]*)\s*([]},#]|$)", re.ASCII)
_NON_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_WORDS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


class ScalarError(ValueError):
    """A number that is too long or not finite; its text is the whole message."""


def core_scalar(text: str) -> str | int | float | bool | None:
    """Interpret an unquoted scalar.

    Octal, hexadecimal, sexagesimal and date spellings and leading zeros stay text, so that
    a field of a number can report how to write it.

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


MAX_DEPTH = 40
"""Maximum nesting depth."""
MAX_NODES = 1_000_000
"""Maximum number of keys and values in one file."""
Loc = tuple[str | int, ...]
"""Keys and indices from the top of a file to a value."""

_CONFLICT = re.compile(r"^(<{7}|>{7}|\|{7})( |$)", re.MULTILINE)


class Node:
    """Place of a value and of its key."""

    __slots__ = ("children", "column", "key_column", "key_line", "line")

    def __init__(self, line: int, column: int, key: tuple[int, int]) -> None:
        """Store the places; children are added while the file is read."""
        self.line, self.column = line, column
        self.key_line, self.key_column = key
        self.children: dict[str | int, Node] = {}


@dataclass(frozen=True)
class Document:
    """Data of one YAML file, with the place of every part."""

    source: TextSource
    """The text."""
    data: Any
    """Mappings, lists, text, numbers, true, false, None."""
    root: Node
    """Tree of places."""
    diagnostics: list[Diagnostic] = field(default_factory=list)
    """Errors of single keys and numbers."""
    replaced: dict[Loc, tuple[Override, str]] = field(default_factory=dict)
    """Replaced values and their readable paths, by place."""

    def listed(self, key: str) -> list[Any]:
        """Return the unchecked entries of a list at the top level, else none."""
        entries = self.data.get(key)
        return entries if isinstance(entries, list) else []

    def place(self, loc: Iterable[str | int], key: bool = False) -> tuple[int, int]:
        """Find line and column of a value, or of its innermost known parent.

        Args:
            loc: keys and indices from the top.
            key: whether to locate the key instead of its value.
        """
        node = self.root
        for step in loc:
            child = node.children.get(step)
            if child is None:
                return node.line, node.column
            node = child
        return (node.key_line, node.key_column) if key else (node.line, node.column)

    def diagnostic(
        self, loc: Iterable[str | int], code: str, message: str, key: bool = False
    ) -> Diagnostic:
        """Create a diagnostic at the place of a value or of its key.

        An error of a replaced value is reported at the origin of the replacement.
        """
        steps = tuple(loc)
        finding = self.source.diagnostic(*self.place(steps, key), code, message)
        for length in range(len(steps), 0, -1):
            if steps[:length] in self.replaced:
                override, shown = self.replaced[steps[:length]]
                return override.blame(finding, shown)
        return finding


def parse_yaml(source: TextSource) -> Document:
    """Parse the data of a YAML text.

    Numbers are read as YAML 1.2 reads them, so `no` is text and `12:30` is not a number. Aliases,
    anchors and tags are refused: no input file needs them, and some crash a parser.

    Args:
        source: the text of one file.

    Raises:
        InputError: the text is not YAML, is empty, or is larger or deeper than the limits.
    """
    conflict = _CONFLICT.search(source.text)
    if conflict:
        line = source.text.count("\n", 0, conflict.start()) + 1
        message = f"merge-conflict marker '{conflict[1]}'; resolve the conflict first"
        raise InputError([source.diagnostic(line, 1, "E101", message)])
    builder = _Builder(source)
    try:
        for event in yaml.parse(source.text, Loader=_event_loader()):
            builder.feed(event)
    except yaml.MarkedYAMLError as error:
        raise InputError([_syntax_error(source, error)]) from None
    except yaml.reader.ReaderError as error:
        message = f"cannot be read as YAML: {error.reason}"
        raise InputError([source.diagnostic(1, 1, "E101", message)]) from None
    if builder.root is None or builder.data is None:
        message = "is empty; its first key must be 'dualarm', such as 'dualarm: tasks/1'"
        raise InputError([Diagnostic(source.name, 0, 0, "E101", message)])
    return Document(source, builder.data, builder.root, builder.diagnostics)


@cache
def _event_loader() -> Any:
    """Return the C parser if PyYAML was built with it, else the Python one."""
    return getattr(yaml, "CSafeLoader", yaml.SafeLoader)


def _syntax_error(source: TextSource, error: yaml.MarkedYAMLError) -> Diagnostic:
    mark = error.problem_mark or error.context_mark
    line, column = (mark.line + 1, mark.column + 1) if mark else (1, 1)
    if "nesting depth" in (error.problem or ""):
        # Newer parsers have a nesting limit, which counts brackets before they are parsed.
        return source.diagnostic(line, column, "E100", f"nesting deeper than {MAX_DEPTH}")
    text = source.lines[line - 1] if line <= len(source.lines) else ""
    if text[column - 1 : column] == "\t" or text[: column - 1].strip(" ").startswith("\t"):
        message = "a tab cannot indent YAML; use spaces"
    else:
        problem = error.problem or "cannot be read as YAML"
        context = f" {error.context}" if error.context else ""
        begun = error.context_mark
        since = f" (begun at line {begun.line + 1})" if begun and begun.line + 1 != line else ""
        message = f"not YAML: {problem}{context}{since}"
        if text[column - 1 : column] == "[" and text[: column - 1].rstrip()[-1:] not in (
            "",
            ",",
            ":",
            "{",
            "[",
        ):
            message += "; text with brackets needs quotes there"
        elif _UNIT_OF_LIST.search(text):
            message += "; a list has no unit: write one with each number, such as [80 ms, 120 ms]"
    return source.diagnostic(line, column, "E101", message)


class _Builder:
    """Builder of data and places from parser events, with an explicit stack."""

    def __init__(self, source: TextSource) -> None:
        self.source = source
        self.data: Any = None
        self.root: Node | None = None
        self.diagnostics: list[Diagnostic] = []
        self._stack: list[_Open] = []
        self._count = 0
        self._documents = 0

    def feed(self, event: Any) -> None:
        """Process one event.

        Raises:
            InputError: the file cannot be read further.
        """
        kind = type(event)
        if kind is yaml.ScalarEvent:
            self._check(event)
            self._scalar(event)
        elif kind is yaml.MappingStartEvent or kind is yaml.SequenceStartEvent:
            self._check(event)
            self._open(event, {} if kind is yaml.MappingStartEvent else [])
        elif kind is yaml.MappingEndEvent or kind is yaml.SequenceEndEvent:
            self._stack.pop()
        elif kind is yaml.AliasEvent:
            raise self._fatal(
                event, "E105", f"alias '*{event.anchor}' is not allowed; repeat the value"
            )
        elif kind is yaml.DocumentStartEvent:
            self._documents += 1
            if self._documents > 1:
                raise self._fatal(event, "E101", "a second document begins here; a file holds one")

    def _check(self, event: Any) -> None:
        self._count += 1
        if self._count > MAX_NODES:
            raise self._fatal(
                event,
                "E100",
                f"more than {MAX_NODES} keys and values; split the file, or put numbers into a CSV",
            )
        if event.anchor is not None:
            message = (
                f"anchor '&{event.anchor}' is not allowed; repeat the value where it is needed"
            )
            raise self._fatal(event, "E105", message)
        if event.tag is not None and event.tag != "!":
            raise self._fatal(event, "E105", f"tag {quote(event.tag)} is not allowed; remove it")

    def _fatal(self, event: Any, code: str, message: str) -> InputError:
        self._say(event, code, message)
        return InputError(self.diagnostics)

    def _say(self, event: Any, code: str, message: str) -> None:
        mark = event.start_mark
        self.diagnostics.append(
            self.source.diagnostic(mark.line + 1, mark.column + 1, code, message)
        )

    def _open(self, event: Any, container: Any) -> None:
        if len(self._stack) >= MAX_DEPTH:
            raise self._fatal(event, "E100", f"nesting deeper than {MAX_DEPTH}")
        top = self._stack[-1] if self._stack else None
        if top is not None and top.expects_key:
            raise self._fatal(event, "E101", "a key must be text, not a list or a mapping")
        self._stack.append(_Open(container, self._add(event, container)))

    def _scalar(self, event: Any) -> None:
        top = self._stack[-1] if self._stack else None
        if not event.value.isascii() and any("\ud800" <= c <= "\udfff" for c in event.value):
            raise self._fatal(event, "E101", "half a surrogate pair is not a character")
        if top is None or not top.expects_key:
            self._add(event, self._value(event))
            return
        mark = event.start_mark
        if event.value in top.node.children:
            first = top.node.children[event.value].key_line
            self._say(event, "E102", f"duplicate key {quote(event.value)}, first at line {first}")
            top.key = (None, (0, 0))
        else:
            top.key = (event.value, (mark.line + 1, mark.column + 1))

    def _value(self, event: Any) -> Any:
        if not event.implicit[0]:
            return event.value
        try:
            return core_scalar(event.value)
        except ScalarError as error:
            self._say(event, "E104", str(error))
            return 0

    def _add(self, event: Any, value: Any) -> Node:
        """Add a value to its container and return its place."""
        mark = event.start_mark
        line, column = mark.line + 1, mark.column + 1
        node = Node(line, column, (line, column))
        if not self._stack:
            self.data, self.root = value, node
            return node
        top = self._stack[-1]
        if isinstance(top.container, list):
            top.node.children[len(top.container)] = node
            top.container.append(value)
            return node
        name, (node.key_line, node.key_column) = top.key or (None, (0, 0))
        top.key = None
        if name is not None:
            top.container[name] = value
            top.node.children[name] = node
        return node


class _Open:
    """A mapping or list that is being read."""

    __slots__ = ("container", "key", "node")

    def __init__(self, container: Any, node: Node) -> None:
        self.container, self.node = container, node
        self.key: tuple[str | None, tuple[int, int]] | None = None

    @property
    def expects_key(self) -> bool:
        """Whether the next scalar is a key."""
        return isinstance(self.container, dict) and self.key is None
