"""Notes of plans: text for readers, data for the planner."""

from __future__ import annotations

import json
import pickle

import pytest

from dualarm_cli.notes import NoteTable, is_about
from dualarm_cli.planning.notes import order_bound_note, order_note


def test_a_note_is_its_sentence_and_keeps_its_data() -> None:
    """Also in files and in another process."""
    note = order_bound_note("stages", total=12.345, bound=11.5)
    assert note.startswith("order bound: on the grid of the search")
    assert "takes 12.35 s, no order takes less than 11.50 s" in note
    assert json.dumps([note]) == json.dumps([str(note)])
    again = pickle.loads(pickle.dumps(note))
    assert (again, again.topic, again.key) == (note, "order bound", "stages")
    assert again.data == {"total": 12.345, "bound": 11.5}


def test_topics_are_told_by_the_note_and_not_by_its_text() -> None:
    """A file may have a buffer named "order"."""
    note = order_note("best")
    assert is_about(note, "order bound", "order")
    assert not is_about(note, "order bound")
    assert not is_about("order: x holds nothing", "order")


def test_a_sentence_without_its_data_is_refused() -> None:
    """Where it is made, not where it is printed."""
    with pytest.raises(KeyError):
        order_note("sections", tried=3)
    with pytest.raises(KeyError):
        order_note("worst")


def test_a_sentence_counts_lists_and_asks_flags() -> None:
    """One or many by a list's length or a number; a flag is one or none."""
    note = NoteTable("mode", x="{rows:# task|# tasks} at {n:# angle|# angles}{turns:, turning|}")
    assert note("x", rows=["a"], n=2, turns=True) == "1 task at 2 angles, turning"
    assert note("x", rows=[], n=1, turns=False) == "0 tasks at 1 angle"


def test_a_list_shows_its_first_eight_names() -> None:
    """The others are counted."""
    note = NoteTable("robot", x="fixed: {joints:listed}")
    assert note("x", joints=[*"abcdefgh"]) == "fixed: a, b, c, d, e, f, g, h"
    assert note("x", joints=[*"abcdefghij"]) == "fixed: a, b, c, d, e, f, g, h and 2 more"
