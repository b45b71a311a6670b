"""Notes on a plan: sentences with their topic and data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from string import Formatter
from typing import Any

MAX_LISTED = 8
"""Maximum number of names in a list of a note."""


class Note(str):
    """Sentence on a plan in reports and files, with its topic and data."""

    topic: str
    """Topic by which notes are selected."""
    key: str
    """Name of the sentence within its topic."""
    data: Mapping[str, object]
    """Data in the sentence."""

    def __new__(cls, text: str, topic: str = "", key: str = "", **data: Any) -> Note:
        """Make a note of a complete sentence."""
        note = super().__new__(cls, text)
        note.topic, note.key, note.data = topic, key, data
        return note


class NoteTable:
    """Sentences of the notes on one topic; a call makes a note."""

    def __init__(self, topic: str, **sentences: str) -> None:
        """Store the topic, and its sentences by key."""
        self.topic, self.sentences = topic, sentences

    def __call__(self, key: str, **data: Any) -> Note:
        """Make a note by filling data into the sentence of a key."""
        return Note(filled(self.sentences[key], data), self.topic, key, **data)


def is_about(note: str, *topics: str) -> bool:
    """Check whether a note has one of several topics; plain text has none."""
    return isinstance(note, Note) and note.topic in topics


def listed(names: Sequence[str]) -> str:
    """Join names for a note, only the first of many."""
    shown = ", ".join(names[:MAX_LISTED])
    more = len(names) - MAX_LISTED
    return f"{shown} and {more} more" if more > 0 else shown


def of_arm(arm: str, thing: str, arms: int) -> str:
    """Name an arm's thing, such as `left tool`; `tool` for the only arm of a robot."""
    return thing if arms == 1 else f"{arm} {thing}"


def millimetres(length: float) -> str:
    """Format a length [m] in millimetres with a decimal; 0.0 becomes "less than 0.1"."""
    shown = f"{abs(length) * 1e3:.1f}"
    return "less than 0.1 mm" if shown == "0.0" else f"{shown} mm"


class _SentenceFormatter(Formatter):
    """Formatter with further specs for sentences.

    `mm` formats lengths, `and` joins quoted items, `*` joins items by the text after it, `listed` joins the first items
    of many, `singular|plural` chooses by number, with `#` for the number, or by a flag.
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Format a value for a sentence."""
        if format_spec == "mm":
            return millimetres(value)
        if format_spec == "and":
            return " and ".join(f"'{item}'" for item in value)
        if format_spec == "listed":
            return listed(value)
        if format_spec.startswith("*"):
            return format_spec[1:].join(map(str, value))
        if "|" in format_spec:
            singular, plural = format_spec.split("|")
            count = value if isinstance(value, int) else len(value)
            return (singular if count == 1 else plural).replace("#", str(count))
        return str(super().format_field(value, format_spec))


_FORMATTER = _SentenceFormatter()


def filled(sentence: str, data: Mapping[str, object]) -> str:
    """Fill data into a sentence of a table; refusals and notes become their sentences."""
    return _FORMATTER.vformat(sentence, (), data)
