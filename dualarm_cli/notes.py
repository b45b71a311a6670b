"""Notes for the reader of a plan: sentences that keep their topic and the data in them."""

from __future__ import annotations

from collections.abc import Mapping
from string import Formatter
from typing import Any


class Note(str):
    """Sentence of a plan, as reports and files have it, with what it is about."""

    topic: str
    """Subject by which notes are kept or left out."""
    key: str
    """Name of the sentence within its topic."""
    more: Mapping[str, object]
    """Data in the sentence."""

    def __new__(cls, text: str, topic: str = "", key: str = "", **more: Any) -> Note:
        """Make a note of a whole sentence."""
        note = super().__new__(cls, text)
        note.topic, note.key, note.more = topic, key, more
        return note

    @classmethod
    def of(cls, sentences: Mapping[str, str], topic: str, key: str, **more: Any) -> Note:
        """Fill in a sentence of a room's table.

        Args:
            sentences: the table, by key.
            topic: of the note.
            key: of its sentence.
            more: data that the sentence names.
        """
        return cls(filled(sentences[key], more), topic, key, **more)


def is_about(note: str, *topics: str) -> bool:
    """State whether a note has one of some topics; plain text, as files leave it, has none."""
    return isinstance(note, Note) and note.topic in topics


def millimetres(length: float) -> str:
    """Returns a length [m] in millimetres with one decimal; what would be 0.0 is less than 0.1."""
    shown = f"{abs(length) * 1e3:.1f}"
    return "less than 0.1 mm" if shown == "0.0" else f"{shown} mm"


class _SentenceFormatter(Formatter):
    """`str.format` with five specs more: mm, and, `*` before what joins, `one|many`, and `#` in it for how many.

    `if so|if not` takes flags.
    """

    def format_field(self, value: Any, format_spec: str) -> str:
        """Returns a value as a sentence tells it."""
        if format_spec == "mm":
            return millimetres(value)
        if format_spec == "and":
            return " and ".join(f"'{one}'" for one in value)
        if format_spec.startswith("*"):
            return format_spec[1:].join(map(str, value))
        if "|" in format_spec:
            one, many = format_spec.split("|")
            count = value if isinstance(value, int) else len(value)
            return (one if count == 1 else many).replace("#", str(count))
        return str(super().format_field(value, format_spec))


_FORMATTER = _SentenceFormatter()


def filled(sentence: str, data: Mapping[str, object]) -> str:
    """Fill data into a sentence of a table; refusals and notes among them become their sentences."""
    return _FORMATTER.vformat(sentence, (), data)
