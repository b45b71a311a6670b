"""Bodies, contacts, clearances and parts of cell, robot and task files."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.robots import load_robot
from dualarm_cli.files.tasks.tasks import load_job

Change = Callable[..., None]
Messages = Callable[[Callable[[], object]], list[str]]
PARTS = "clearance: 10 mm\nparts: {box: {shapes: [{box: [0.1, 0.1, 50 mm], xyz: [0, 0, 25 mm]}]}}"


def test_contacts_clearances_and_parts_are_read(project: Path, change: Change) -> None:
    """Names and lengths as the file has them; shapes in the frame that carries them."""
    change(
        "cell.yaml",
        "clearance: 10 mm",
        f"{PARTS}\nclearances: [{{between: [left_tool, table], clearance: 2 mm}}]\n"
        "allowed_contacts: [[box, table]]",
    )
    cell = load_cell("cell.yaml").cell
    assert cell.clearances == (("left_tool", "table", 0.002),)
    assert cell.allowed_contacts == (("box", "table"),)
    [shape] = cell.parts["box"]
    assert shape.size == (0.1, 0.1, 0.05)
    np.testing.assert_allclose(shape.pose.translation, [0.0, 0.0, 0.025])


@pytest.mark.parametrize(
    ("new", "expected"),
    [
        ("allowed_contacts: [[table, tabel]]", "there is no body 'tabel', did you mean 'table'?"),
        ("allowed_contacts: [[table, table]]", "'table' is paired with itself; name two bodies"),
        (
            "allowed_contacts: [[table, left_tool], [left_tool, table]]",
            "'left_tool' and 'table' are paired twice",
        ),
        ("allowed_contacts: [[table]]", "cell.yaml:11:20: E2"),
        (
            "clearances: [{between: [table, arm], clearance: 1 mm}]",
            "cell.yaml:11:32: E300 there is no body 'arm'",
        ),
        ("clearances: [{between: [table, left_tool], clearance: -1 mm}]", "E2"),
        ("parts: {box: {shapes: []}}", "E2"),
        ("parts: {box: {shapes: [{half_space: true}]}}", "a half_space is infinite"),
        ("parts: {table: {shapes: [{sphere: 1 mm}]}}", "'table' is already the name of a"),
        ("parts: {left_tool: {shapes: [{sphere: 1 mm}]}}", "'left_tool' is already the name of a"),
    ],
)
def test_what_is_wrong_with_them_has_its_place(
    project: Path, change: Change, messages: Messages, new: str, expected: str
) -> None:
    """Unknown, doubled and impossible bodies."""
    change("cell.yaml", "clearance: 10 mm", f"clearance: 10 mm\n{new}")
    assert expected in messages(lambda: load_cell("cell.yaml"))[0]


def test_a_part_goes_from_pick_to_place(project: Path, change: Change) -> None:
    """By default, or by task; a bare move carries nothing."""
    change("cell.yaml", "clearance: 10 mm", PARTS)
    change("tasks.yaml", "retract: 60 mm,", "retract: 60 mm, part: box,")
    assert [task.part for task in load_job("tasks.yaml").tasks] == ["box", ""]


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("id: a", "id: a\n    part: bag", "the cell has no part 'bag'"),
        ("id: b", "id: b\n    part: box", "only a pick with its place carries a part"),
        ("retract: 60 mm,", "retract: 60 mm, part: bax,", "the cell has no part 'bax', did you"),
    ],
)
def test_parts_that_cannot_be_carried_are_named(
    project: Path, change: Change, messages: Messages, old: str, new: str, expected: str
) -> None:
    """Unknown ones, and those of tasks that carry nothing."""
    change("cell.yaml", "clearance: 10 mm", PARTS)
    change("tasks.yaml", old, new)
    assert expected in messages(lambda: load_job("tasks.yaml"))[0]


def test_a_robots_contacts_are_links_of_its_urdf(
    project: Path, change: Change, messages: Messages
) -> None:
    """Unknown ones are named with the nearest that there is."""
    change(
        "robot.yaml", "platform: [turn]", "platform: [turn]\nallowed_contacts: [[l_tool, r_tol]]"
    )
    assert (
        "there is no body 'r_tol', did you mean 'r_tool'?"
        in messages(lambda: load_robot(Path("robot.yaml")))[0]
    )


def test_two_robots_keep_their_contacts_with_their_prefixes(tasks_folder: Path) -> None:
    """Two iiwas: links five and seven of each."""
    robot = load_job(tasks_folder / "05_two_robots" / "tasks.yaml").cell.robot
    assert robot.allowed_contacts == (
        ("left_link_5", "left_link_7"),
        ("right_link_5", "right_link_7"),
    )
