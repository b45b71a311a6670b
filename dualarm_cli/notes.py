"""Notes for the reader of a plan: sentences that keep their topic and the data in them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any


class Note(str):
    """Sentence of a plan with its topic before it, as reports and files have it."""

    topic: str
    """Subject by which notes are kept or left out."""
    key: str
    """Name of the sentence within its topic."""
    more: Mapping[str, object]
    """Data in the sentence."""

    @classmethod
    def of(
        cls, sentences: Mapping[str, Mapping[str, str]], topic: str, key: str, **more: Any
    ) -> Note:
        """Fill in a sentence of a room's table.

        Args:
            sentences: the table, by topic and key.
            topic: of the note.
            key: of its sentence.
            more: data that the sentence names.
        """
        note = cls(f"{topic}: {sentences[topic][key].format(**more)}")
        note.topic, note.key, note.more = topic, key, more
        return note


def is_about(note: str, *topics: str) -> bool:
    """State whether a note has one of some topics; plain text, as files leave it, has none."""
    return isinstance(note, Note) and note.topic in topics
