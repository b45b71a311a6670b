from __future__ import annotations

from collections.abc import Callable

import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.source.text_source import TextSource
from dualarm_cli.files.source.yaml_source import Document, parse_yaml


def parse(text: str) -> Document:
    """Parses text as a file named f."""
    return parse_yaml(TextSource("f", text, ""))


def test_every_key_and_value_has_its_place() -> None:
    """Lines and columns are counted from 1."""
    document = parse("a: 1\nb:\n  - {c: [10, 20]}\n")
    assert document.data == {"a": 1, "b": [{"c": [10, 20]}]}
    assert document.place(["b"], key=True) == (2, 1)
    assert document.place(["b", 0, "c"], key=True) == (3, 6)
    assert document.place(["b", 0, "c", 1]) == (3, 14)
    assert document.place(["b", 0, "missing", "deeper"]) == (3, 5)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("1.0e3", 1000.0),
        (".5", 0.5),
        ("-7", -7),
        ("no", "no"),
        ("on", "on"),
        ("017", "017"),
        ("12:30:45", "12:30:45"),
        ("2024-13-45", "2024-13-45"),
        ("0x10", "0x10"),
        ("1_000", "1_000"),
        ("true", True),
        ("null", None),
        ("~", None),
        ("'1'", "1"),
        ('"true"', "true"),
        ("30 deg", "30 deg"),
    ],
)
def test_scalars_are_read_as_yaml_1_2_reads_them(text: str, value: object) -> None:
    """YAML 1.1's octals, sexagesimals, dates and yes/no are text; exponents need no dot."""
    found = parse(f"a: {text}").data["a"]
    assert found == value
    assert type(found) is type(value)


def test_keys_are_always_text() -> None:
    """Keys that YAML 1.1 would merge stay apart."""
    assert parse("{1: a, 1.0: b, true: c}").data == {"1": "a", "1.0": "b", "true": "c"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: &x 1", "f:1:4: E105 anchor '&x' is not allowed; repeat the value where it is needed"),
        ("a: 1\nb: *x", "f:2:4: E105 alias '*x' is not allowed; repeat the value"),
        ("a: !include b", "f:1:4: E105 tag '!include' is not allowed; remove it"),
        (
            "a: !!python/object:os.system b",
            "f:1:4: E105 tag 'tag:yaml.org,2002:python/object:os.system' is not allowed; remove it",
        ),
        ("a: 1\n---\nb: 2", "f:2:1: E101 a second document begins here; a file holds one"),
        ("a:\n\tb: 1", "f:2:1: E101 a tab cannot indent YAML; use spaces"),
        (
            "a: 1\n<<<<<<< HEAD\nb: 1",
            "f:2:1: E101 merge-conflict marker '<<<<<<<'; resolve the conflict first",
        ),
        ("? [a]\n: 1", "f:1:3: E101 a key must be text, not a list or a mapping"),
        ("[" * 900, "f:1:41: E100 nesting deeper than 40"),
        (
            # Nodes 1 to 3: mapping, key, list; node 1,000,001 is item 999,998, at 5 + 2 * 999,997.
            "a: [" + "1," * 1_000_000 + "]",
            "f:1:1999999: E100 more than 1000000 keys and values; split the file, or put numbers into a CSV",
        ),
    ],
)
def test_yaml_that_is_refused_says_where_and_why(
    text: str, message: str, messages: Callable[..., list[str]]
) -> None:
    """Aliases, tags, tabs, several documents, conflict markers and bombs."""
    assert messages(lambda: parse(text)) == [message]


def test_brackets_deeper_than_any_parser_reads(messages: Callable[..., list[str]]) -> None:
    """Whether the parser notices or its reader; which of them decides where."""
    [message] = messages(lambda: parse("[" * 100_000))
    assert message.endswith("E100 nesting deeper than 40")


def test_ten_thousand_tasks_are_read_with_the_place_of_the_last_one() -> None:
    """One line each, as many keys and values as a pick and a place have; lines counted by hand."""
    stop = "{at: tray, xyz: [0.1, 0.2, 0.3], rpy: [180 deg, 0, 0], free: yaw}"
    line = f"- {{id: t, arm: left, after: [a, b], not_before: 1 s, pick: {stop}, place: {stop}}}\n"
    document = parse("dualarm: tasks/1\ntasks:\n" + 10_000 * line)
    assert len(document.data["tasks"]) == 10_000
    assert document.data["tasks"][-1]["place"]["xyz"] == [0.1, 0.2, 0.3]
    assert document.place(["tasks", 9_999, "id"])[0] == 10_002


def test_unclosed_brackets_name_the_line_where_they_began(
    messages: Callable[..., list[str]],
) -> None:
    """The parser's own words, with the place of the opening bracket."""
    (message,) = messages(lambda: parse("a: 1\nb: [1, 2\n\n"))
    assert message.startswith("f:4:1: E101 not YAML: did not find expected ',' or ']'")
    assert message.endswith("(begun at line 2)")


def test_half_a_surrogate_pair_is_refused(messages: Callable[..., list[str]]) -> None:
    """It could not be written as UTF-8 again."""
    (message,) = messages(lambda: parse('a: "\\ud800"'))
    assert message.startswith("f:1:") and "E101" in message


def test_duplicate_keys_and_numbers_that_are_none_are_collected() -> None:
    """Single bad entries do not stop the reading; both lines of a duplicate are named."""
    document = parse("a: 1\nb: .nan\na: {x: [1]}\nc: -.INF\nd: 1e999\ne: " + "9" * 5000)
    assert [str(d) for d in document.diagnostics] == [
        "f:2:4: E104 non-finite number '.nan' is not allowed",
        "f:3:1: E102 duplicate key 'a', first at line 1",
        "f:4:4: E104 non-finite number '-.INF' is not allowed",
        "f:5:4: E104 non-finite number '1e999' is not allowed",
        "f:6:4: E104 number of 5000 characters; at most 40 are read",
    ]
    assert document.data["a"] == 1


def test_a_billion_laughs_end_at_the_first_anchor(messages: Callable[..., list[str]]) -> None:
    """No alias is ever followed, so the bomb costs nothing."""
    lines = ["a0: &a0 [x, x]"] + [f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, 60)]
    (message,) = messages(lambda: parse("\n".join(lines)))
    assert message.startswith("f:1:5: E105 anchor")


def test_brackets_within_braces_are_told_to_need_quotes() -> None:
    """As of paths in study files; other errors of syntax are not."""
    hint = "text with brackets needs quotes there"
    for text, expected in (
        ("a: {b: base.xyz[2], c: 1}", True),
        ("a: {b: 'base.xyz[2]' c}", False),
        ("a: [1", False),
    ):
        with pytest.raises(InputError) as error:
            parse_yaml(TextSource("f", text, ""))
        assert (hint in str(error.value)) is expected


def test_a_unit_after_a_list_is_told_to_go_with_each_number() -> None:
    """In mappings of both styles and in lists; a missing comma is another error."""
    hint = "write one with each number, such as [80 ms, 120 ms]"
    for text, expected in (
        ("dwell: {gripper: [80, 120, 200] ms}", True),
        ("gripper: [80, 120, 200] ms  # measured\nsettle: 1", True),
        ("speed:\n  - [1, 2]mm/s\n  - 3", True),
        ("{xyz: [1, 2, 3] at: bin}", False),
        ("{gripper: [80, 120}", False),
    ):
        with pytest.raises(InputError) as error:
            parse_yaml(TextSource("f", text, ""))
        assert (hint in str(error.value)) is expected, text
