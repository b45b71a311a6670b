"""A JSON document read piece by piece: memory holds what is made of it, never all of its text."""

from __future__ import annotations

import codecs
import json
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

BLOCK = 1 << 20
"""Bytes that are read at a time."""
LARGEST_VALUE = 1 << 25
"""Longest text of a value that is taken in one piece [characters]."""
CUT = 16
"""So many last characters of what was read may mean something else with the missing rest."""
_SPACE = " \t\n\r"


class JsonStream:
    """The values of one JSON text in their order; numbers may be NaN and infinite, as in Python's own reader."""

    def __init__(
        self, file: BinaryIO, make_object: Callable[[list[tuple[str, Any]]], dict[str, Any]]
    ) -> None:
        """Starts at a file's first character.

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
        """Characters that are read."""
        return self._before + self._at

    def line_of(self, error: json.JSONDecodeError) -> int:
        """Returns the line of the file, counted from 1, that an error of this reader is at."""
        return self._lines + error.lineno

    def peek(self) -> str:
        """Returns the next character that is no space; empty at the end."""
        while True:
            while self._at < len(self._text) and self._text[self._at] in _SPACE:
                self._at += 1
            if self._at < len(self._text):
                return self._text[self._at]
            if self._ended:
                return ""
            self._read_on()

    def value(self) -> Any:
        """Returns the next value.

        Raises:
            json.JSONDecodeError: there is none, or its text is too long.
        """
        self.peek()
        while True:
            try:
                value, end = self._values.raw_decode(self._text, self._at)
            except json.JSONDecodeError as error:
                begun = error.msg.startswith("Unterminated string")
                if self._ended or (not begun and error.pos < len(self._text) - CUT):
                    raise
            else:
                # A number at the end of the text may go on: 1.2 and then 5, or 5e and then -324.
                if self._ended or end < len(self._text) - CUT:
                    self._at = end
                    return value
            if len(self._text) - self._at > LARGEST_VALUE:
                raise self._error("A value is too long")
            self._read_on()

    def members(self) -> Iterator[str]:
        """Yields the keys of the object that comes next; whoever asks reads each one's value."""
        for _ in self._entries("{", "}"):
            if self.peek() != '"':
                raise self._error("Expecting property name enclosed in double quotes")
            key = self.value()
            self._take(":", "Expecting ':' delimiter")
            yield key

    def items(self) -> Iterator[Any]:
        """Yields the values of the list that comes next."""
        for _ in self._entries("[", "]"):
            yield self.value()

    def end(self) -> None:
        """Makes sure that nothing follows.

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
        """Appends more of the file to the text that is left: at least as much again, so that all is read but twice."""
        rest = self._text[self._at :]
        self._lines += self._text.count("\n", 0, self._at)
        self._before += self._at
        block = self._file.read(max(BLOCK, len(rest)))
        self._ended = not block
        self._text, self._at = rest + self._decode.decode(block, final=self._ended), 0
