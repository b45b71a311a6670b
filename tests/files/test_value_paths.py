"""Paths to values of files: found by key, name and index, said precisely where they lead nowhere."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dualarm_cli.files.source.value_paths import (
    PathError,
    find_value,
    from_pointer,
    shown_path,
    to_pointer,
    value_at,
)

DATA = {
    "dualarm": "cell/1",
    "base": {"xyz": [1, 2, 3]},
    "frames": {"bin": {"xyz": [4, 5, 6]}, "bin.slot": {"xyz": [7, 8, 9]}},
    "obstacles": [{"name": "table", "xyz": [0, 0, 10]}, {"name": "left wall", "xyz": [0, 0, 11]}],
    "clearance": 12,
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("clearance", 12),
        ("base.xyz[2]", 3),
        ("base.xyz.2", 3),
        ("base . xyz [ 1 ]", 2),
        ("frames.bin.xyz[0]", 4),
        ("frames.bin.slot.xyz[0]", 7),
        ('frames["bin.slot"].xyz[0]', 7),
        ("frames['bin.slot'].xyz[0]", 7),
        ("obstacles.table.xyz[2]", 10),
        ("obstacles[table].xyz[2]", 10),
        ("obstacles.left wall.xyz[2]", 11),
        ("obstacles[1].xyz[2]", 11),
    ],
)
def test_a_path_leads_to_its_value(path: str, value: int) -> None:
    """By hand; keys may have dots, entries of lists have names."""
    assert value_at(DATA, find_value(DATA, path, "f")) == value


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("", "is empty"),
        ("base..xyz", "cannot be read from character 5 on"),
        ("base.xyz[", "cannot be read from character 9 on"),
        ("bas.xyz[2]", "f has no 'bas', did you mean 'base'? There: base, frames, obstacles, clearance"),
        ("base.xzy[2]", "'base' of f has no 'xzy', did you mean 'xyz'? There: xyz"),
        ("base.xyz[3]", "'base.xyz' of f has no '3'; its entries are [0] to [2]"),
        ("base.xyz[-1]", "'base.xyz' of f has no '-1'"),
        ("obstacles.tabel.xyz[0]", "'obstacles' of f has no 'tabel', did you mean 'table'? There: table, left wall"),
        ("clearance.x", "'clearance' of f is 12; there is no 'x' in it"),
        ("base.xyz", "is a list of 3 in f; name one value of it; in it: 0, 1, 2"),
        ("base", "is a mapping in f; name one value of it; in it: xyz"),
    ],
)  # fmt: skip
def test_a_path_that_leads_nowhere_says_what_there_is(path: str, message: str) -> None:
    """The step that is missing, and what stands in its place."""
    with pytest.raises(PathError) as error:
        find_value(DATA, path, "f")
    assert message in str(error.value)


def test_a_path_with_two_meanings_is_refused() -> None:
    """A key with a dot and a key within a key."""
    data = {"a": {"b": 1}, "a.b": 2}
    with pytest.raises(PathError, match=r"leads to .* and .*; write the one that is meant"):
        find_value(data, "a.b", "f")
    assert value_at(data, find_value(data, '["a.b"]', "f")) == 2
    assert value_at(data, find_value(data, "a[b]", "f")) == 1


KEYS = st.text(st.characters(codec="ascii", exclude_characters="\"'[]\x00"), min_size=1).filter(
    lambda text: text.strip() == text
)
TREES: st.SearchStrategy[Any] = st.recursive(
    st.integers(),
    lambda inner: st.dictionaries(KEYS, inner, min_size=1) | st.lists(inner, min_size=1),
    max_leaves=12,
).filter(lambda tree: isinstance(tree, dict))


def _leaves(node: Any, loc: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if not isinstance(node, dict | list):
        return [loc]
    entries = node.items() if isinstance(node, dict) else enumerate(node)
    return [leaf for key, child in entries for leaf in _leaves(child, (*loc, key))]


@given(TREES)
def test_every_value_has_a_pointer_and_a_path_that_lead_back(tree: Any) -> None:
    """Also where keys have dots, slashes and tildes."""
    for loc in _leaves(tree):
        assert from_pointer(tree, to_pointer(loc)) == loc
        written = "".join(f"[{step}]" if isinstance(step, int) else f'["{step}"]' for step in loc)
        assert find_value(tree, written, "f") == loc


def test_paths_are_shown_as_people_write_them() -> None:
    """Entries by name; keys with dots in quotes."""
    assert shown_path(DATA, ("obstacles", 0, "xyz", 2)) == "obstacles.table.xyz[2]"
    assert shown_path(DATA, ("frames", "bin.slot", "xyz", 0)) == 'frames["bin.slot"].xyz[0]'


@pytest.mark.parametrize(
    ("pointer", "message"),
    [
        ("/base/xyz/3", "a list of 3 has no '3'; there: 0, 1, 2"),
        ("/base/xyz/-1", "a list of 3 has no '-1', did you mean '1'? There: 0, 1, 2"),
        ("/bas/xyz", "no 'bas', did you mean 'base'?"),
        ("/clearance/x", "12 has no 'x' in it"),
        ("/base/new/er", "no 'new'; there: xyz"),
    ],
)
def test_a_pointer_to_nothing_is_refused(pointer: str, message: str) -> None:
    """Whether a key may be added or not: never more than the last one, and never an entry of a list."""
    for may_add in (False, True):
        with pytest.raises(PathError) as error:
            from_pointer(DATA, pointer, may_add)
        assert message in str(error.value)


def test_the_last_key_may_be_new_where_that_is_wanted() -> None:
    """As somebody would add a line to a file."""
    assert from_pointer(DATA, "/base/rpy", may_add=True) == ("base", "rpy")
    with pytest.raises(PathError, match="no 'rpy'; there: xyz"):
        from_pointer(DATA, "/base/rpy")
