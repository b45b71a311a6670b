from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.errors import Diagnostic
from dualarm_cli.files.source import diagnostics
from dualarm_cli.files.source.diagnostics import render
from tests.checked_files import check_file


def test_a_caret_stands_below_the_column() -> None:
    """Place and message, then the source line with its number."""
    diagnostic = Diagnostic("f.yaml", 12, 8, "E200", "must be a number", "speed: fast")
    assert render([diagnostic]) == (
        "error[E200]: f.yaml:12:8: must be a number\n  12 | speed: fast\n     |        ^"
    )


def test_a_whole_file_has_neither_line_nor_caret() -> None:
    """Only its name and what is wrong with it."""
    assert (
        render([Diagnostic("f", 0, 0, "E500", "is a directory")])
        == "error[E500]: f: is a directory"
    )


def test_twenty_are_shown_and_the_rest_is_counted() -> None:
    """Nobody reads four thousand."""
    many = [Diagnostic("f", k, 1, "E200", "bad") for k in range(1, 4001)]
    lines = render(many).splitlines()
    assert lines[19:] == ["error[E200]: f:20:1: bad", "... and 3980 more"]
    assert "more" not in render(many[:20])


def test_three_faults_of_a_repeated_task_are_shown() -> None:
    """They have one place, and the rest is counted; other places are shown."""

    def fault(k: int, line: int) -> Diagnostic:
        return Diagnostic("f", line, 1, "E610", f"task a[{k}]", about={"task": f"a[{k}]"})

    lines = render([fault(k, 5) for k in range(1, 21)] + [fault(21, 6)]).splitlines()
    assert lines == [
        *(f"error[E610]: f:5:1: task a[{k}]" for k in (1, 2, 3)),
        "... and 17 more here",
        "error[E610]: f:6:1: task a[21]",
    ]
    assert len(render([fault(k, 5) for k in range(1, 4)]).splitlines()) == 3


def test_so_many_mistakes_that_telling_them_would_fill_the_memory_are_counted(
    project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Eleven unknown keys where ten are told one by one."""
    monkeypatch.setattr(diagnostics, "MAX_MISTAKES", 10)
    for keys in (10, 11):
        unknown = "".join(f"key{k}: 1\n" for k in range(keys))
        task = "tasks: [{id: a, arm: left, move: {xyz: [0, 0, 0]}}]\n"
        (project / "t.yaml").write_text("dualarm: tasks/1\ncell: c.yaml\n" + task + unknown)
        found = [str(one) for one in check_file("t.yaml") if one.code in ("E100", "E201")]
        if keys == 10:
            assert found == [one for one in found if "E201 unknown key" in one]
            assert len(found) == 10
        else:
            assert found == [
                "t.yaml:1:1: E100 11 mistakes in this file; correct the program that wrote it"
            ]


def test_nothing_that_is_printed_can_steer_a_terminal(project: Path) -> None:
    """Escape sequences in names, texts and source lines come out as dots or escapes."""
    (project / "t\x1b[31m.yaml").write_text('dualarm: tasks/1\n\u202ecell: "\\e[31m"\n')
    (project / "raw").write_bytes(b"a:\t\x1b[31m\n")
    for name in ("t\x1b[31m.yaml", "raw"):
        text = render(check_file(name))
        assert text and all(c.isprintable() or c == "\n" for c in text)


def test_a_value_of_the_wrong_kind_is_told_with_its_key(project: Path) -> None:
    """A mapping begins below its key: the line that is shown has the first key inside it, not its own."""
    text = "dualarm: cell/1\nrobot: robot.yaml\nclearances:\n  post: {box: [1, 1, 1]}\nclearance: [1]\n"
    (project / "c.yaml").write_text(text)
    found = [str(one) for one in check_file("c.yaml") if one.code == "E200"]
    assert found[0].startswith(
        "c.yaml:4:3: E200 'clearances' must be a list, such as [a, b], not a mapping"
    )
