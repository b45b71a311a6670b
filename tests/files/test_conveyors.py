# ruff: noqa: E501 (tables of exact messages, one a line)
"""Conveyors of cells and targets on them: what is read, and every mistake with its place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.part_flow import Conveyor, OnBelt

Change = Callable[..., None]
Messages = Callable[..., list[str]]
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
tasks:
  - id: part
    arm: left
    pick: {xyz: [0.1, 0.2, 0.3], rpy: [180 deg, 0, 0], conveyor: belt, passes: 2.5 s, within: 600 mm}
    place: {xyz: [0.2, 0.3, 0.4]}
"""
SEAM = (
    TASKS
    + """\
  - id: wipe
    path: {arm: left, through: [{xyz: [0, 0, 0]}, {xyz: [0.1, 0, 0]}], speed: 100 mm/s}
"""
)


@pytest.fixture
def belt(project: Path) -> Path:
    """The tiny cell with a conveyor, and a task on it."""
    cell = (project / "cell.yaml").read_text()
    (project / "cell.yaml").write_text(cell + "conveyors: {belt: {velocity: [0, -150 mm/s, 0]}}\n")
    (project / "tasks.yaml").write_text(TASKS)
    return project


def test_a_target_moves_with_its_conveyor(belt: Path) -> None:
    """0.6 m at 0.15 m/s take 4 s; after 1.5 s the part is 0.225 m on along -y, turned as it was."""
    (task,) = load_job("tasks.yaml").tasks
    pick, place = task.stops
    assert place.belt is None
    assert pick.belt is not None
    assert (pick.belt.passes, pick.belt.within, pick.belt.at) == (2.5, 0.6, 2.5)
    assert pick.belt.last == pytest.approx(6.5)
    assert pick.belt.gone(4.0) == pytest.approx(0.225)
    met = pick.met(4.0)
    assert met.belt is not None
    assert met.target.pose.translation == pytest.approx([0.1, 0.2 - 0.225, 0.3])
    assert met.target.pose.rotation == pytest.approx(pick.target.pose.rotation)
    # From there on it is where it would have been; the window is the file's.
    assert met.met(6.5).target.pose.translation == pytest.approx([0.1, 0.2 - 0.6, 0.3])
    assert met.belt.last == pick.belt.last
    assert met.met(2.5).target.pose.translation == pytest.approx(pick.target.pose.translation)
    assert place.met(4.0) is place


def test_a_velocity_is_in_the_axes_of_its_frame(belt: Path, change: Change) -> None:
    """The bin is turned by 90 deg about z: 0.2 m/s along its x are 0.2 m/s along the world's y, where it is no matter."""
    change("cell.yaml", "velocity: [0, -150 mm/s, 0]", "velocity: [0.2, 0, 0.1], in: bin")
    conveyor = load_cell("cell.yaml").cell.conveyors["belt"]
    assert conveyor.velocity == pytest.approx([0.0, 0.2, 0.1], abs=1e-15)
    assert conveyor.speed == pytest.approx(np.sqrt(0.05))


def test_a_part_on_a_sloping_belt_is_where_it_has_got_to() -> None:
    """By hand, backwards in time too: 3 s before it passes it is 3 s times the velocity before."""
    velocity = np.array([0.03, 0.0, 0.04])
    belt = OnBelt(Conveyor("c", velocity), passes=7.0, within=0.1, at=7.0)
    pose, there = belt.moved(pin.SE3.Identity(), 4.0)
    assert pose.translation == pytest.approx([-0.09, 0.0, -0.12])
    assert there.gone(4.0) == pytest.approx(-0.15)
    assert belt.last == pytest.approx(9.0)


MISTAKES = [
    ("cell.yaml", ("velocity: [0, -150 mm/s, 0]", "velocity: [0, 0, 0]"), "a conveyor must move by 0.1 mm/s or more"),
    ("cell.yaml", ("velocity: [0, -150 mm/s, 0]", "velocity: [0, 20, 0]"), "speed must be at most 10 m/s"),
    ("cell.yaml", ("velocity: [0, -150 mm/s, 0]", "velocity: [0, 1]"), "3"),
    ("cell.yaml", ("velocity: [0, -150 mm/s, 0]", "velocity: [0, 1, 0], in: nowhere"), "the cell has no frame 'nowhere'"),
    ("tasks.yaml", ("conveyor: belt", "conveyor: bolt"), "the cell has no conveyor 'bolt', did you mean 'belt'?"),
    ("tasks.yaml", (", passes: 2.5 s", ""), "'passes' is missing"),
    ("tasks.yaml", (", within: 600 mm", ""), "'within' is missing"),
    ("tasks.yaml", ("conveyor: belt, ", ""), "'passes' is of a target on a conveyor; add 'conveyor'"),
    ("tasks.yaml", ("within: 600 mm", "within: 0"), "must be positive"),
    ("tasks.yaml", ("passes: 2.5 s", "passes: -1 s"), "must be at least 0"),
    ("tasks.yaml", ("xyz: [0.1, 0.2, 0.3], rpy: [180 deg, 0, 0]", "joints: [0.1, 0.2]"), "'conveyor' does not go with 'joints'"),
    ("tasks.yaml", ("pick: {", "move: {"), "'conveyor' goes with pick and place"),
]  # fmt: skip


@pytest.mark.parametrize(("file", "pair", "message"), MISTAKES)
def test_each_mistake_is_told_at_its_place(
    belt: Path,
    change: Change,
    messages: Messages,
    file: str,
    pair: tuple[str, str],
    message: str,
) -> None:
    """The line is that of what is wrong, whatever else the file holds."""
    change(file, *pair)
    if pair[1].startswith("move"):
        change("tasks.yaml", "    place: {xyz: [0.2, 0.3, 0.4]}\n", "")
    lines = (belt / file).read_text().splitlines()
    line = next(
        k
        for k, text in enumerate(lines, 1)
        if "conveyors:" in text or "passes" in text or "conveyor" in text
    )
    found = messages(lambda: load_job("tasks.yaml"))
    assert len(found) == 1, found
    assert message in found[0]
    assert f"{file}:{line}:" in found[0]


@pytest.mark.parametrize(
    ("window", "message"),
    [
        ("not_before: 6.5 s", ""),
        ("not_before: 6.6 s", "not_before: 6.6 s is after the part of the pick may be met on conveyor 'belt', from 2.5 s (passes) to 6.500 s (within)"),
        ("not_after: 2.5 s", ""),
        ("not_after: 2.4 s", "not_after: 2.4 s is before the part of the pick may be met"),
    ],
)  # fmt: skip
def test_a_window_has_to_have_the_part_in_it(
    belt: Path, change: Change, messages: Messages, window: str, message: str
) -> None:
    """600 mm at 150 mm/s are four seconds after 2.5 s."""
    change("tasks.yaml", "    arm: left\n", f"    arm: left\n    {window}\n")
    if not message:
        assert load_job("tasks.yaml").tasks[0].stops[0].belt is not None
        return
    [found] = messages(lambda: load_job("tasks.yaml"))
    assert message in found
    assert "tasks.yaml:7:" in found


def test_conveyors_do_not_go_with_paths(belt: Path, messages: Messages) -> None:
    """What has no one time at which it begins cannot wait for parts yet: E310, at the conveyor."""
    (belt / "tasks.yaml").write_text(SEAM)
    found = messages(lambda: load_job("tasks.yaml"))
    [told] = [text for text in found if "conveyors do not go with paths" in text]
    assert "tasks.yaml:7:" in told
    assert "E310" in told
