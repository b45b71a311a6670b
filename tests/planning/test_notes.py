"""Notes of plans: text for readers, data for the planner."""

from __future__ import annotations

import json
import pickle

import pytest

from dualarm_cli.notes import Note, is_about
from dualarm_cli.planning.notes import planning_note


def test_a_note_is_its_sentence_and_keeps_its_data() -> None:
    """Also in files and in another process."""
    note = planning_note("order bound", "stages", total=12.345, bound=11.5)
    assert note.startswith("order bound: on the grid of the search")
    assert "takes 12.35 s, no order takes less than 11.50 s" in note
    assert json.dumps([note]) == json.dumps([str(note)])
    again = pickle.loads(pickle.dumps(note))
    assert (again, again.topic, again.key) == (note, "order bound", "stages")
    assert again.more == {"total": 12.345, "bound": 11.5}


def test_topics_are_told_by_the_note_and_not_by_its_text() -> None:
    """A file may have a buffer named "order"."""
    note = planning_note("order", "best")
    assert is_about(note, "order bound", "order")
    assert not is_about(note, "order bound")
    assert not is_about("order: x holds nothing", "order")


def test_a_sentence_without_its_data_is_refused() -> None:
    """Where it is made, not where it is printed."""
    with pytest.raises(KeyError):
        planning_note("order", "sections", tried=3)
    with pytest.raises(KeyError):
        Note.of({}, "order", "best")


def test_a_sentence_counts_lists_and_asks_flags() -> None:
    """One or many by a list's length or a number; a flag is one or none."""
    table = {"x": "{rows:# task|# tasks} at {n:# angle|# angles}{turns:, turning|}"}
    assert Note.of(table, "mode", "x", rows=["a"], n=2, turns=True) == "1 task at 2 angles, turning"
    assert Note.of(table, "mode", "x", rows=[], n=1, turns=False) == "0 tasks at 1 angle"
