"""Streaming JSON reader that reports the path of each invalid member."""

from __future__ import annotations

import codecs
import json
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from pathlib import Path
from typing import Any, BinaryIO, NoReturn, TypeVar

import numpy as np

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.records import dataclass


@dataclass(frozen=True)
class ReadingLimits:
    """Limits on the size of JSON documents."""

    value: int = 1 << 25
    """Maximum length of a value read in one piece [characters]."""
    cut: int = 16
    """Length of the text's end that may change its meaning with more input [characters]."""
    file: int = 4_000_000_000
    """Maximum size of a document [B]."""
    numbers: int = 200_000_000
    """Maximum total of numbers over the tables."""
    depth: int = 1
    """Maximum nesting depth of objects within an object of tables."""
    rows: int = 2_000_000
    """Maximum length of any other list."""
    batch: int = 1 << 20
    """Length of table text that is converted to an array at once [characters]."""
    block: int = 1 << 20
    """Number of bytes read at once."""


JSON = ReadingLimits()


class JsonStream:
    """Stream of a JSON text's values.

    NaN and infinities are allowed, as in Python's reader.
    """

    def __init__(
        self, file: BinaryIO, make_object: Callable[[list[tuple[str, Any]]], dict[str, Any]]
    ) -> None:
        """Start at a file's first character.

        Args:
            file: JSON in UTF-8.
            make_object: returns the object of the members of a value.
        """
        self._file = file
        self._decode = codecs.getincrementaldecoder("utf-8-sig")()
        self._values = json.JSONDecoder(object_pairs_hook=make_object)
        self._text, self._at, self._before, self._lines = "", 0, 0, 0
        self._ended = False

    @property
    def consumed(self) -> int:
        """Number of characters read."""
        return self._before + self._at

    def line_of(self, error: json.JSONDecodeError) -> int:
        """Compute the line in the file of a stream error.

        Lines are counted from 1.
        """
        return self._lines + error.lineno

    def peek(self) -> str:
        """Return the next character that is not white space; empty at the end."""
        while True:
            while self._at < len(self._text) and self._text[self._at] in " \t\n\r":
                self._at += 1
            if self._at < len(self._text):
                return self._text[self._at]
            if self._ended:
                return ""
            self._read_on()

    def value(self) -> Any:
        """Read the next value.

        Raises:
            json.JSONDecodeError: there is none, or its text is too long.
        """
        self.peek()
        while True:
            try:
                value, end = self._values.raw_decode(self._text, self._at)
            except json.JSONDecodeError as error:
                begun = error.msg.startswith("Unterminated string")
                if self._ended or (not begun and error.pos < len(self._text) - JSON.cut):
                    raise
            else:
                # A number at the end of the text may go on: 1.2 and then 5, or 5e and then -324.
                if self._ended or end < len(self._text) - JSON.cut:
                    self._at = end
                    return value
            if len(self._text) - self._at > JSON.value:
                raise self._error("A value is too long")
            self._read_on()

    def members(self) -> Iterator[str]:
        """Yield the keys of the next object; the caller reads each key's value."""
        for _ in self._entries("{", "}"):
            if self.peek() != '"':
                raise self._error("Expecting property name enclosed in double quotes")
            key = self.value()
            self._take(":", "Expecting ':' delimiter")
            yield key

    def items(self) -> Iterator[Any]:
        """Yield the values of the next list."""
        for _ in self._entries("[", "]"):
            yield self.value()

    def end(self) -> None:
        """Raise JSONDecodeError unless the text ends here.

        Raises:
            json.JSONDecodeError: something does.
        """
        if self.peek():
            raise self._error("Extra data")

    def _entries(self, begin: str, end: str) -> Iterator[None]:
        self._take(begin, "Expecting value")
        if self.peek() == end:
            self._at += 1
            return
        while True:
            yield
            if self.peek() == end:
                self._at += 1
                return
            self._take(",", "Expecting ',' delimiter")

    def _take(self, char: str, complaint: str) -> None:
        if self.peek() != char:
            raise self._error(complaint)
        self._at += 1

    def _error(self, message: str) -> json.JSONDecodeError:
        return json.JSONDecodeError(message, self._text, self._at)

    def _read_on(self) -> None:
        """Append the next block, at least as long as the remaining text.

        Each character is therefore copied at most twice.
        """
        rest = self._text[self._at :]
        self._lines += self._text.count("\n", 0, self._at)
        self._before += self._at
        block = self._file.read(max(JSON.block, len(rest)))
        self._ended = not block
        self._text, self._at = rest + self._decode.decode(block, final=self._ended), 0


Row = TypeVar("Row")

UNEVEN = "must be numbers, in rows of equal length"
_WORDS: dict[type, str] = {dict: "an object", list: "a list"}


class JsonReader:
    """Reader of one document; its methods take the path for messages."""

    def __init__(self, file: str) -> None:
        """Store the file's name for messages."""
        self._file = file

    def fail(self, where: str, what: str, line: int = 0) -> NoReturn:
        """Raise InputError for a member."""
        raise InputError([Diagnostic(self._file, line, 0, "E110", f"{where}: {what}")])

    def document(self, file: Path, tables: Collection[str]) -> dict[str, Any]:
        """Read the object in a file, including NaN and infinities.

        Args:
            file: the file.
            tables: members that are objects of tables, or of such objects; lists in them are returned as arrays.
        """
        try:
            if not file.is_file():
                self.fail(
                    "schedule",
                    "there is no such file; name a plan's folder or its schedule.json",
                )
            if file.stat().st_size > JSON.file:
                self.fail("schedule", f"is larger than {JSON.file // 1_000_000} MB")
            with file.open("rb") as opened:
                stream = JsonStream(opened, self._object)
                try:
                    return self._members(stream, tables)
                except json.JSONDecodeError as error:
                    line = stream.line_of(error)
                    self.fail("schedule", f"is not JSON: {error.msg}", line)
        except OSError as error:
            self.fail("schedule", f"cannot be read: {error.strerror}")
        except (UnicodeDecodeError, RecursionError, ValueError):
            self.fail("schedule", "is not JSON in UTF-8, or is nested too deeply")

    def _members(self, stream: JsonStream, tables: Collection[str]) -> dict[str, Any]:
        """Read the object of a whole text."""
        if stream.peek() != "{":
            stream.value()
            self.fail("schedule", "must be an object")
        members: list[tuple[str, Any]] = []
        for key in stream.members():
            if key in tables and stream.peek() == "{":
                members.append((key, self._tables(stream, key, [JSON.numbers])))
            elif stream.peek() == "[":
                members.append((key, self._list(stream, key)))
            else:
                members.append((key, stream.value()))
        stream.end()
        return self._object(members)

    def _list(self, stream: JsonStream, path: str) -> list[Any]:
        items = []
        for item in stream.items():
            items.append(item)
            if len(items) > JSON.rows:
                self.fail(path, f"has more than {JSON.rows:,} entries")
        return items

    def _tables(self, stream: JsonStream, path: str, left: list[int]) -> dict[str, Any]:
        """Read an object whose lists become arrays, also in nested objects.

        `left` is the number of numbers that may still come.
        """
        members: list[tuple[str, Any]] = []
        for key in stream.members():
            if stream.peek() == "[":
                table = self._table(stream, f"{path}.{key}", left[0])
                left[0] -= table.size
                members.append((key, table))
            elif stream.peek() == "{" and path.count(".") < JSON.depth:
                members.append((key, self._tables(stream, f"{path}.{key}", left)))
            else:
                members.append((key, stream.value()))
        return self._object(members)

    def _table(self, stream: JsonStream, path: str, max_numbers: int) -> FloatArray:
        """Read a list of numbers, or of rows of numbers, as an array."""
        parts: list[FloatArray] = []
        rows: list[Any] = []
        size, begun = 0, stream.consumed

        def close() -> None:
            part = self._numbers(rows, path)
            if parts and part.shape[1:] != parts[0].shape[1:]:
                self.fail(path, UNEVEN)
            parts.append(part)
            rows.clear()

        for row in stream.items():
            rows.append(row)
            if stream.consumed - begun > JSON.batch:
                close()
                size, begun = size + parts[-1].size, stream.consumed
                if size > max_numbers:
                    self.fail(path, f"has more than {max_numbers:,} numbers")
        if rows or not parts:
            close()
        return np.concatenate(parts)

    def _object(self, pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        members = dict(pairs)
        if len(members) < len(pairs):
            keys = [key for key, _ in pairs]
            self.fail(next(key for key in keys if keys.count(key) > 1), "is used twice")
        return members

    def member(self, parent: dict[str, Any], key: str, kind: type, path: str = "") -> Any:
        """Return a required member of a given type (dict or list)."""
        value = parent.get(key)
        if not isinstance(value, kind):
            self.fail(path or key, "is missing" if key not in parent else f"must be {_WORDS[kind]}")
        return value

    def text(self, parent: dict[str, Any], key: str, path: str, default: str = "") -> str:
        """Return an optional member that must be text."""
        value = parent.get(key, default)
        if not isinstance(value, str):
            self.fail(path, "must be text")
        return value

    def names(
        self,
        parent: dict[str, Any],
        key: str,
        path: str,
        default: Sequence[str] | None = None,
    ) -> list[str]:
        """Return a list of texts; it is required unless a default is given."""
        value = parent.get(key)
        if value is None and default is not None:
            return list(default)
        if not isinstance(value, list) or not all(isinstance(name, str) for name in value):
            self.fail(path, "must be a list of names" if key in parent else "is missing")
        return value

    def number(
        self, parent: dict[str, Any], key: str, path: str, default: float | None
    ) -> float | None:
        """Return a finite number, or the default if it is null or missing."""
        value = parent.get(key, default)
        if value is None:
            return default
        if key not in parent:
            return value
        if isinstance(value, bool) or not isinstance(value, int | float):
            self.fail(path, "must be a finite number")
        try:
            number = float(value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            self.fail(path, "must be a finite number")
        return number

    def instant(self, parent: dict[str, Any], key: str, path: str) -> float:
        """Return a required finite number."""
        value = self.number(parent, key, path, None)
        if value is None:
            self.fail(path, "is missing")
        return value

    def array(self, value: object, path: str, shape: tuple[int, ...]) -> FloatArray:
        """Return an array of a given shape; it may hold NaN and infinities."""
        array = self._numbers(value, path)
        if array.shape != shape:
            self.fail(path, f"must have shape {shape}, not {array.shape}")
        return array

    def _numbers(self, value: object, path: str) -> FloatArray:
        """Convert a value to an array of numbers of any shape."""
        try:
            array = np.asarray(value)
        except (TypeError, ValueError, OverflowError):
            self.fail(path, UNEVEN)
        # Without this check numpy would convert text, null and booleans to numbers.
        if array.size and array.dtype.kind not in "iuf":
            self.fail(path, "is missing" if value is None else "must be numbers")
        return array.astype(np.float64, copy=False)

    def each(
        self, parent: dict[str, Any], key: str, read: Callable[[dict[str, Any], str], Row]
    ) -> list[Row]:
        """Read every object of an optional list."""
        rows = parent.get(key)
        if rows is None:
            return []
        if not isinstance(rows, list):
            self.fail(key, "must be a list")
        items = []
        for k, row in enumerate(rows):
            if not isinstance(row, dict):
                self.fail(f"{key}[{k}]", "must be an object")
            items.append(read(row, f"{key}[{k}]"))
        return items
