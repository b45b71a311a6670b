# ruff: noqa: E501 (tables of exact messages, one a line)
"""Buffers of task files: what is read, and what is refused with its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.part_flow import Buffer

Messages = Callable[..., list[str]]
MARK = "¦"
"""Where a message is expected to point."""
STORED = """\
dualarm: tasks/1
cell: cell.yaml
mode: free
order: optimise
return: true
buffers:
  chute: {capacity: 2, initial: 1}
tasks:
  - id: load
    arm: left
    pick:  {xyz: [0.4, 0.1, 0.9]}
    place: {xyz: [0.4, 0.2, 0.9], buffer: chute}
  - id: unload
    arm: any
    pick:  {xyz: [0.4, 0.0, 0.9], buffer: chute}
    place: {xyz: [0.4, 0.3, 0.9]}
"""
LOAD = "place: {xyz: [0.4, 0.2, 0.9], buffer: chute}"
UNLOAD = "pick:  {xyz: [0.4, 0.0, 0.9], buffer: chute}"
LEVELS = "{capacity: 2, initial: 1}"


@pytest.fixture
def stored(project: Path) -> Callable[..., str]:
    """Writes the job with changes, and returns where the mark was, as file:line:column."""

    def run(*pairs: str) -> str:
        text = STORED
        for old, new in zip(pairs[::2], pairs[1::2], strict=True):
            assert old in text, old
            text = text.replace(old, new, 1)
        before, _, behind = text.partition(MARK)
        (project / "tasks.yaml").write_text(before + behind)
        return f"tasks.yaml:{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"

    return run


def test_buffers_are_read_with_who_uses_them(stored: Callable[..., str]) -> None:
    """Capacity, start and place; a place puts one in, a pick takes one out, the other stops do neither."""
    stored()
    job = load_job("tasks.yaml")
    assert {name: (b.capacity, b.initial) for name, b in job.buffers.items()} == {"chute": (2, 1)}
    assert str(job.buffers["chute"].place).startswith("tasks.yaml:7")
    found = {(t.id, s.action): (s.buffer, s.stored) for t in job.tasks for s in t.stops}
    assert found == {
        ("load", "pick"): ("", 0),
        ("load", "place"): ("chute", 1),
        ("unload", "pick"): ("chute", -1),
        ("unload", "place"): ("", 0),
    }
    assert job.notes == ()


def test_without_buffers_nothing_is_stored(stored: Callable[..., str]) -> None:
    """Neither in the job nor at its stops; what a buffer begins with is nothing unless it is said."""
    stored(
        "buffers:\n  chute: " + LEVELS + "\n",
        "",
        LOAD,
        "place: {xyz: [0.4, 0.2, 0.9]}",
        UNLOAD,
        "pick: {xyz: [0.4, 0, 0.9]}",
    )
    job = load_job("tasks.yaml")
    assert job.buffers == {}
    assert Buffer(3).initial == 0
    stored(LEVELS, "{capacity: 2}")
    assert load_job("tasks.yaml").buffers["chute"].initial == 0


def test_a_buffer_that_nobody_uses_is_noted(stored: Callable[..., str]) -> None:
    """It is no error: a file may be on its way to be finished."""
    stored(LEVELS, LEVELS + "\n  spare: {capacity: 5}")
    [note] = load_job("tasks.yaml").notes
    assert note == "buffer 'spare': no task uses it; a pick or place does with buffer: spare"


@pytest.mark.parametrize(
    ("pairs", "expected"),
    [
        ((LOAD, "place: {xyz: [0.4, 0.2, 0.9], buffer: ¦shute}"), "E300 there is no buffer 'shute', did you mean 'chute'? Buffers: chute"),
        ((UNLOAD, "pick: {xyz: [0.4, 0.0, 0.9], buffer: ¦tray}", LEVELS, "{capacity: 2}", "return: true", "return: false"), "E300 there is no buffer 'tray'; buffers: chute"),
        ((LEVELS, "{capacity: ¦0}"), "E200 0 must be at least 1"),
        ((LEVELS, "{capacity: ¦1.5}"), "E200 must be a whole number, not 1.5"),
        ((LEVELS, "{capacity: 2, initial: ¦-1}"), "E200 -1 must be at least 0"),
        ((LEVELS, "{capacity: 2, initial: ¦3}"), "E200 3 parts at the start; there is room for 2 (capacity)"),
        ((LEVELS, "¦{initial: 1}"), "E202 'capacity' is missing"),
        ((UNLOAD, "pick: {xyz: [0.4, 0.0, 0.9]}", "  chute: ", "  chute: ¦"), "E300 with return: true the cycle cannot repeat: buffer 'chute' ends with 2 parts and began with 1 (puts: 1, takes: 0); make the numbers of picks and places equal, or write return: false"),
        ((UNLOAD, "pick: {xyz: [0.4, 0.0, 0.9]}", "return: true", "return: false", LEVELS, "¦{capacity: 1, initial: 1}"), "E300 buffer 'chute' has no room for all parts: 1 at the start, puts: 1, takes: 0, so 2 remain where there is room for 1 (capacity)"),
        ((LOAD, "place: {xyz: [0.4, 0.2, 0.9]}", "return: true", "return: false", LEVELS, "¦{capacity: 2}"), "E300 buffer 'chute' never holds as many parts as are taken: 0 at the start, puts: 0, takes: 1; 1 more must be put into it, or be in it at the start (initial)"),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    pairs: tuple[str, ...], expected: str, stored: Callable[..., str], messages: Messages
) -> None:
    """Exact text and line; nothing else is reported."""
    place = stored(*pairs)
    [message] = messages(lambda: load_job("tasks.yaml"))
    where, text = message.split(" ", 1)
    assert text == expected
    assert where.split(":")[1] == place.split(":")[1]


def test_a_move_has_no_buffer(stored: Callable[..., str], messages: Messages) -> None:
    """It puts nothing and takes nothing."""
    move = "  - id: look\n    arm: left\n    move: {xyz: [0.4, 0.2, 0.9], buffer: chute}\n"
    stored("  - id: unload\n", move + "  - id: unload\n")
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert message.endswith("E300 'buffer' goes with picks and places only; remove it")
