"""Directions of approaches and retracts in task and cell files: what they become, and mistakes at their place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Stop
from dualarm_cli.model.lines import LineDirection

TASK = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
defaults: {approach: 80 mm, retract: {distance: 60 mm, direction: [0, 0, 5], in: world}}
tasks:
  - id: a
    arm: left
    approach: {distance: 70 mm}
    pick: {in: bin, xyz: [0, 0, 0], retract: {distance: 50 mm, direction: [3, 0, -4], in: bin}}
    place: {xyz: [0.2, 0.5, 0.7], approach: {distance: 40 mm, direction: [0, 1, 0], in: tool}}
"""


@pytest.fixture
def shelf(project: Path) -> Path:
    """The tiny project, whose frame `bin` is turned by a quarter."""
    (project / "tasks.yaml").write_text(TASK)
    return project


def stops() -> tuple[Stop, ...]:
    """The stops of the only task."""
    return load_job("tasks.yaml").tasks[0].stops


def test_lines_have_the_direction_of_their_frame(shelf: Path) -> None:
    """By hand: the tool moves along the vector; from the target outward an approach is against it."""
    pick, place = stops()
    assert pick.lines[0] == (0.07, LineDirection((0.0, 0.0, -1.0), False))
    length, away = pick.lines[1]
    # (0.6, 0, -0.8) turned by a quarter about z.
    assert (length, away.fixed) == (0.05, True)
    assert away.vector == pytest.approx((0.0, 0.6, -0.8), abs=1e-15)
    assert place.lines[0] == (0.04, LineDirection((0.0, -1.0, 0.0), False))
    assert place.lines[1] == (0.06, LineDirection((0.0, 0.0, 1.0), True))


def test_lines_of_a_grasp_give_way_to_those_of_task_and_target(
    shelf: Path, change: Callable[..., None]
) -> None:
    """Target before task before grasp before defaults; a direction goes with its length."""
    change(
        "cell.yaml",
        "clearance:",
        "parts: {block: {shapes: [{sphere: 20 mm}], grasps: {top: {rpy: [180 deg, 0, 0], approach: 30 mm, "
        "retract: {distance: 20 mm, direction: [1, 0, 0], in: tool}}}}}\nclearance:",
    )
    change("tasks.yaml", "    arm: left\n", "    arm: left\n    part: block\n")
    pick, place = stops()
    assert pick.lines[0][0] == 0.07
    assert pick.lines[1][0] == 0.05
    assert place.lines[1] == (0.02, LineDirection((1.0, 0.0, 0.0), False))


def test_a_taking_tool_approaches_as_at_its_place_or_as_the_hand_over_says(
    shelf: Path, change: Callable[..., None]
) -> None:
    """And the giving one leaves as from its pick."""
    change(
        "tasks.yaml",
        "    place:",
        "    handover: {xyz: [0.4, 0, 0.8], grip: {xyz: [0, 0, 100 mm], rpy: [180 deg, 0, 0]}}\n    place:",
    )
    giving, taking = load_job("tasks.yaml").tasks
    assert giving.stops[1].lines[1] == giving.stops[0].lines[1]
    assert taking.stops[0].lines[0] == taking.stops[1].lines[0]
    up = "{distance: 90 mm, direction: [0, 0, -1], in: world}"
    change("tasks.yaml", "grip:", f"approach: {up}, retract: 10 mm, grip:")
    giving, taking = load_job("tasks.yaml").tasks
    assert giving.stops[1].lines[1] == (0.01, LineDirection())
    assert taking.stops[0].lines[0] == (0.09, LineDirection((0.0, 0.0, 1.0), True))


def test_a_direction_in_the_world_needs_a_pose(
    shelf: Path, change: Callable[..., None], messages: Callable[..., list[str]]
) -> None:
    """Joint positions turn with a platform; the tool's own frame does, too."""
    change("tasks.yaml", "{in: bin, xyz: [0, 0, 0], ", "{joints: [0.5, -90 deg], ")
    assert messages(stops) == [
        "tasks.yaml:9:20: E300 joint positions say nothing of the world: give in: tool to the directions of approach "
        "and retract, or the target as a pose"
    ]
