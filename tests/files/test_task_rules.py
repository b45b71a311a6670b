# ruff: noqa: E501 (tables of exact messages, one a line)
"""Rules across tasks that leave arms and order open: sequences, windows, precedence, what goes with what."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.tasks.tasks import load_job

Messages = Callable[..., list[str]]
MARK = "¦"
"""Where a message is expected to point."""
OPEN = """\
dualarm: tasks/1
cell: cell.yaml
mode: free
order: optimise
sequences: [[first, second]]
tasks:
  - id: first
    arm: left
    move: {xyz: [0.4, 0.1, 0.9]}
  - id: second
    arm: any
    move: {xyz: [0.4, 0.2, 0.9]}
  - id: third
    arm: right
    after: [first]
    not_before: 500 ms
    not_after: 2 s
    move: {xyz: [0.4, -0.1, 0.9]}
"""
SEQUENCES = "sequences: [[first, second]]"


@pytest.fixture
def opened(project: Path) -> Callable[..., str]:
    """Writes the open job with changes, and returns where the mark was, as file:line:column."""

    def run(*pairs: str) -> str:
        text = OPEN
        for old, new in zip(pairs[::2], pairs[1::2], strict=True):
            assert old in text, old
            text = text.replace(old, new, 1)
        before, _, behind = text.partition(MARK)
        (project / "tasks.yaml").write_text(before + behind)
        return f"tasks.yaml:{before.count(chr(10)) + 1}:{len(before) - before.rfind(chr(10))}"

    return run


def test_what_a_file_leaves_open_is_left_open(opened: Callable[..., str]) -> None:
    """Mode, order, sequences, arm, precedence and window, as written."""
    opened()
    job = load_job("tasks.yaml")
    assert (job.mode, job.order, job.sequences) == ("free", "optimise", (("first", "second"),))
    assert not job.is_decided
    first, second, third = job.tasks
    assert [task.arm for task in job.tasks] == ["left", "any", "right"]
    assert [second.allows(arm) for arm in ("left", "right")] == [True, True]
    assert [first.allows(arm) for arm in ("left", "right")] == [True, False]
    assert (third.after, third.not_before, third.not_after) == (("first",), 0.5, 2.0)
    assert (first.after, first.not_before, first.not_after) == ((), 0.0, math.inf)
    assert job.notes == ()


def test_a_job_that_says_all_is_decided(opened: Callable[..., str]) -> None:
    """Asynchronous arms may still be told all; one task for any arm leaves something open."""
    opened("order: optimise\n" + SEQUENCES, "order: given", "arm: any", "arm: left")
    assert load_job("tasks.yaml").is_decided
    opened("order: optimise\n" + SEQUENCES, "order: given")
    assert not load_job("tasks.yaml").is_decided


@pytest.mark.parametrize(
    ("pairs", "expected"),
    [
        # Sequences.
        ((SEQUENCES, "sequences: [[first, ¦secnd]]"), "E300 there is no task 'secnd', did you mean 'second'?"),
        ((SEQUENCES, "sequences: [[first, second], [third, ¦second]]"), "E300 task 'second' is in a sequence already (number 1)"),
        ((SEQUENCES, "sequences: [¦[first, third]]"), "E300 one arm does a sequence; 'first' and 'third' have different arms"),
        ((SEQUENCES, "sequences: [¦[first, second, third]]"), "E300 one arm does a sequence; 'first' and 'third' have different arms"),
        ((SEQUENCES, "sequences: [¦[first]]"), "E200 a list of 1 is too short; at least 2 are needed"),
        ((SEQUENCES, "sequences: [¦first, [second, first]]"), "E200 must be a list, such as [a, b], not 'first'"),
        (("order: optimise\nsequences: ", "order: given\nsequences: ¦"), "E300 order: given does all tasks in the file's order already; write order: optimise, or remove 'sequences'"),
        # Windows: they may be an instant, not less.
        (("not_after: 2 s", "not_after: ¦499 ms"), "E300 not_after: 0.499 s is before not_before: 0.5 s"),
        (("not_before: 500 ms", "not_before: ¦-500 ms"), "E200 '-500 ms': time must be at least 0"),
        # Any arm.
        (("move: {xyz: [0.4, 0.2, 0.9]}", "move: {joints: ¦[0, 0]}"), "E300 joint configurations belong to one arm; use arm: left or right, or give a pose"),
        (("move: {xyz: [0.4, 0.2, 0.9]}", "pick: {joints: ¦[0, 0]}"), "E300 joint configurations belong to one arm; use arm: left or right, or give a pose"),
        (("    arm: right\n", "    arm: ¦both\n"), "E200 'both' is not allowed; allowed: left, right, any"),
        # Rings: 'third' comes after 'first'.
        (("    arm: left\n", "    arm: left\n    after: ¦[third]\n"), "E300 tasks wait for each other: 'first' after 'third' after 'first'"),
    ],
)  # fmt: skip
def test_each_mistake_is_reported_at_its_place(
    pairs: tuple[str, ...], expected: str, opened: Callable[..., str], messages: Messages
) -> None:
    """Exact text, line and column; nothing else is reported."""
    place = opened(*pairs)
    assert messages(lambda: load_job("tasks.yaml")) == [f"{place}: {expected}"]


def test_a_ring_through_a_sequence_is_found_and_says_so(
    opened: Callable[..., str], messages: Messages
) -> None:
    """By the sequence the first comes before the second, by `after` the second before the first."""
    opened("    arm: left\n", "    arm: left\n    after: [second]\n")
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert message.endswith(
        "E300 tasks wait for each other: 'second' after 'first' after 'second' (those of a sequence for the ones before them)"
    )


def test_a_window_of_one_instant_is_a_window(opened: Callable[..., str]) -> None:
    """At 0.5 s, neither earlier nor later."""
    opened("not_after: 2 s", "not_after: 0.5 s")
    task = load_job("tasks.yaml").tasks[2]
    assert (task.not_before, task.not_after) == (0.5, 0.5)


def test_what_only_one_arm_can_do_is_that_arms(
    opened: Callable[..., str], change: Callable[..., None]
) -> None:
    """A robot with a left arm alone."""
    joints = ("r1", "r2")
    for joint in joints:
        change("tiny.urdf", f'"{joint}" type="revolute"', f'"{joint}" type="fixed"')
        change(
            "robot.yaml", f"  {joint}: {{acceleration: 10, jerk: none, source: datasheet}}\n", ""
        )
    arm = "  right: {joints: [r1, r2], flange: r_tool, kind: general}\n"
    change("robot.yaml", arm, "", ", r1: -1.5", "")
    opened("    arm: right\n", "    arm: left\n")
    assert [task.arm for task in load_job("tasks.yaml").tasks] == ["left"] * 3


GIVEN = ("order: optimise\n" + SEQUENCES, "order: given")


def test_in_the_given_order_a_task_of_any_arm_cannot_wait_for_a_later_one(
    opened: Callable[..., str], messages: Messages
) -> None:
    """Whichever arm it turns out to be; the one before it may be waited for."""
    place = opened(*GIVEN, "    arm: any\n", "    arm: any\n    after: [¦third]\n")
    assert messages(lambda: load_job("tasks.yaml")) == [
        f"{place}: E300 task 'second' must come after 'third', but order: given puts it first; change their order in the file"
    ]
    opened(*GIVEN, "    arm: any\n", "    arm: any\n    after: [first]\n")
    assert load_job("tasks.yaml").notes == ()


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_arms_wait_for_each_other_in_the_given_order(opened: Callable[..., str], mode: str) -> None:
    """The same in both modes: 'third' is made after 'first', which is over by then; nothing needs to be noted."""
    alone = ("  - id: second\n    arm: any\n    move: {xyz: [0.4, 0.2, 0.9]}\n", "")
    opened(*GIVEN, *alone, "mode: free", f"mode: {mode}")
    job = load_job("tasks.yaml")
    assert job.notes == ()
    made = [[task.id for task, _ in stage.values()] for stage in job.stages()]
    assert made.index(["third"]) > max(k for k, names in enumerate(made) if "first" in names)


@pytest.mark.parametrize("mode", ["paired", "free"])
def test_arms_that_wait_for_each_other_for_ever_are_refused(
    project: Path, messages: Messages, mode: str
) -> None:
    """By hand: a waits for d behind c, c for b behind a; no two tasks of `after` and arm alone contradict each other."""
    move = "move: {xyz: [0.4, 0.1, 0.9]}"
    rows = [("a", "left", "d"), ("b", "left", ""), ("c", "right", "b"), ("d", "right", "")]
    (project / "tasks.yaml").write_text(
        f"dualarm: tasks/1\ncell: cell.yaml\nmode: {mode}\nstart: bent\ntasks:\n"
        + "".join(f"  - {{id: {n}, arm: {arm}, after: [{o}], {move}}}\n" for n, arm, o in rows)
    )
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert message.endswith(
        "in the given order 'a' and 'c' wait forever for tasks that come later; "
        "change the order in the file, or write order: optimise"
    )
    assert message.startswith("tasks.yaml:6:")
    text = (project / "tasks.yaml").read_text()
    (project / "tasks.yaml").write_text(text.replace("tasks:\n", "order: optimise\ntasks:\n", 1))
    assert len(load_job("tasks.yaml").tasks) == 4


def test_orders_may_be_open_beside_paths_but_windows_and_sequences_of_paths_not(
    project: Path, messages: Messages
) -> None:
    """A path keeps its place in the file; what is asked of its time or its neighbours is refused where it stands."""
    tasks = (
        "dualarm: tasks/1\ncell: cell.yaml\norder: optimise\n{}tasks:\n"
        "  - {{id: go, arm: any, {}move: {{xyz: [0.6, 0.2, 0.9], rpy: [180 deg, 0, 0]}}}}\n"
        "  - id: wipe\n    arm: left\n    path:\n      speed: 50 mm/s\n      through:\n"
        "        - {{xyz: [0.5, 0.2, 0.9], rpy: [180 deg, 0, 0]}}\n        - {{xyz: [0.6, 0.2, 0.9]}}\n"
    )
    file = project / "tasks.yaml"
    file.write_text(tasks.format("", ""))
    assert not load_job(file).is_decided
    file.write_text(tasks.format("", "not_before: 1 s, "))
    (found,) = messages(lambda: load_job(file))
    assert "not_before does not go with paths and coordinate tasks (task 'wipe')" in found
    file.write_text(tasks.format("sequences: [[go, wipe]]\n", ""))
    (found,) = messages(lambda: load_job(file))
    assert "task 'wipe' names its own arms" in found


@pytest.mark.parametrize("value", ["5", "true", "x", "1.5"])
def test_tasks_that_are_no_list_beside_sequences_are_refused_in_their_place(
    value, project, change, messages
):
    """The rules across tasks look at what the file has, whatever that is."""
    (project / "tasks.yaml").write_text(
        f"dualarm: tasks/1\ncell: cell.yaml\norder: optimise\nsequences: [[a, b]]\ntasks: {value}\n"
    )
    found = messages(lambda: load_job("tasks.yaml"))
    assert any(one.startswith("tasks.yaml:5:8: E200 must be a list") for one in found)
