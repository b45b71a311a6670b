from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.source.text_source import quote, read_text
from dualarm_cli.files.source.yaml_source import parse_yaml
from tests.checked_files import check_file


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "f: E101 is empty; its first key must be 'dualarm', such as 'dualarm: tasks/1'"),
        (
            b"# only\n",
            "f: E101 is empty; its first key must be 'dualarm', such as 'dualarm: tasks/1'",
        ),
        ("a: 1".encode("utf-16"), "f: E101 is UTF-16 or UTF-32; save it as UTF-8"),
        (b"a: 1\nb: \xff", "f:2:4: E101 byte 0xff is not UTF-8; save the file as UTF-8"),
        (b"a: 1\nb: \0", "f:2:4: E101 character U+0000 is not allowed; remove it"),
        ("a: 1\u2028b: 2".encode(), "f:1:5: E101 character U+2028 is not allowed; remove it"),
        (b"a" * 50_000_000, "f: E100 has 50.0 MB; at most 20 MB are read"),
    ],
)
def test_text_that_is_none_is_refused(
    data: bytes, message: str, tmp_path: Path, messages: Callable[..., list[str]]
) -> None:
    """Empty, wrongly encoded, binary and huge files are refused in one line."""
    (tmp_path / "f").write_bytes(data)
    assert messages(lambda: parse_yaml(read_text(tmp_path / "f", "f"))) == [message]


def test_byte_order_mark_and_carriage_returns_are_accepted(tmp_path: Path) -> None:
    """A file from a Windows editor reads like any other."""
    (tmp_path / "f").write_bytes(b"\xef\xbb\xbfa: 1\r\nb: 2\r\n")
    document = parse_yaml(read_text(tmp_path / "f", "f"))
    assert document.data == {"a": 1, "b": 2}
    assert document.place(["b"]) == (2, 4)


def test_what_is_no_regular_file_is_refused_without_waiting(project: Path) -> None:
    """Pipes, devices, directories, missing files and loops get one line each."""
    os.mkfifo(project / "pipe")
    (project / "empty").mkdir()
    (project / "loop").symlink_to("loop")
    expected = {
        "pipe": "pipe: E500 is not a regular file (a pipe or a device); save it to a file first",
        "/dev/zero": "/dev/zero: E500 is not a regular file (a pipe or a device); "
        "save it to a file first",
        ".": ".: E500 is a directory; name a file in it: cell.yaml, robot.yaml, tasks.yaml",
        "empty": "empty: E500 is a directory; name a file in it",
        "none.yaml": "none.yaml: E500 cannot be read: No such file or directory",
        "loop": "loop: E500 cannot be read: Too many levels of symbolic links",
        "a\0b": "'a\\x00b': E500 'a\\x00b' is not the name of a file",
    }
    assert {name: [str(d) for d in check_file(name)] for name in expected} == {
        name: [message] for name, message in expected.items()
    }


def test_an_unreadable_file_is_refused(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The system's reason is passed on."""

    def deny(*_: object) -> int:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(os, "open", deny)
    assert [str(d) for d in check_file("tasks.yaml")] == [
        "tasks.yaml: E500 cannot be read: Permission denied"
    ]


def test_quoted_values_are_fit_for_a_terminal() -> None:
    """Control characters are escaped and long texts cut off."""
    assert quote("\x1b[31mred") == "'\\x1b[31mred'"
    assert quote("x" * 100) == "'" + "x" * 57 + "...'"
    assert [quote(v) for v in (None, True, [1, 2], {}, 1.5)] == [
        "nothing",
        "true",
        "a list of 2",
        "a mapping",
        "1.5",
    ]
