# ruff: noqa: E501 (tables of exact messages, one a line)
"""Care of tasks and held parts in files: what is read, and 75 mutants that are refused with their place."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.part_flow import NO_CARE, Care

Messages = Callable[..., list[str]]
Change = Callable[..., None]
PICK = "pick: {at: bin.slot, xyz: [0, 0, 50 mm], rpy: [180 deg, 0, 0], free: yaw}"
PLACE = "place: {xyz: [0.2, 0.5, 0.8], symmetry: 2}"
UPRIGHT = "place: {xyz: [0.2, 0.5, 0.8], rpy: [180 deg, 0, 0], symmetry: 2}"


@pytest.fixture
def careful(change: Change) -> Callable[[str, str], None]:
    """Writes care of the part cup, and keys of the task that carries it."""

    def write(part: str, task: str) -> None:
        held = f"while_holding: {part}, " if part else ""
        change("cell.yaml", "clearance:", f"parts: {{cup: {{{held}shapes: [{{sphere: 30 mm}}]}}}}\nclearance:")  # fmt: skip
        change("tasks.yaml", "    arm: left", f"    arm: left\n    part: cup\n    {task}", PLACE, UPRIGHT)  # fmt: skip

    return write


def test_care_of_a_task_and_of_its_part_are_read(careful: Callable[[str, str], None]) -> None:
    """Units become SI; the stricter limit holds while the part is held, the task's alone before."""
    careful("{tilt: 10 deg, acceleration: 50 %, tool_speed: 500 mm/s}", "tool_speed: 0.8 m/s")
    task, other = load_job("tasks.yaml").tasks
    assert task.care == Care(tool_speed=0.8)
    assert task.holding == Care(1.0, 0.5, 0.5, np.radians(10.0))
    assert task.care_before("pick") == task.care_after("place") == task.care
    assert task.care_after("pick") == task.care_before("place") == task.holding
    assert other.care == other.holding == NO_CARE
    assert np.allclose(task.upright, [0.0, 0.0, -1.0])  # the tool points down


def faulty(value: str, key: str) -> list[str]:
    """Returns a value of a key, as care of a part or of a task."""
    return [f"{{{key}: {value}}}", f"{key}: {value}"]


VALUES = [
    *[(key, "0", "must be at least 0.001") for key in ("speed", "acceleration")],
    *[(key, "-20 %", "must be at least 0.1 %") for key in ("speed", "acceleration")],
    *[(key, "120 %", "must be at most 100 %") for key in ("speed", "acceleration")],
    *[(key, "50", "must be at most 1") for key in ("speed", "acceleration")],
    *[(key, "0.5 m/s", "allowed: %") for key in ("speed", "acceleration")],
    *[
        (key, "half", "is not a number; write one such as 0.8 or 80%")
        for key in ("speed", "acceleration")
    ],
    *[
        (key, "[0.5, 1]", "must be a number such as 0.8 or 80%")
        for key in ("speed", "acceleration")
    ],
    ("tool_speed", "0", "must be positive"),
    ("tool_speed", "-1 m/s", "must be positive"),
    ("tool_speed", "1e-9 m/s", "must be at least 1e-06 m/s"),
    ("tool_speed", "30", "did you mean '30 mm/s'?"),
    ("tool_speed", "50 %", "allowed: m/s, mm/s"),
    ("tool_speed", "'0,5'", "write a decimal point: 0.5"),
    ("tool_speed", "{max: 1}", "must be a number such as"),
    ("tilt", "0", "must be at least 0.01 rad"),
    ("tilt", "-10 deg", "must be at least 0.572958 deg"),
    ("tilt", "91 deg", "must be at most 90 deg"),
    ("tilt", "10", "did you mean '10 deg'?"),
    ("tilt", "10 mm", "allowed: rad, mrad, deg"),
    ("tilt", "true", "must be a number such as '30 deg'"),
    ("tilt", "level", "is not a number"),
]
"""Key, faulty value, and part of the message: refused in a part and in a task."""


@pytest.mark.parametrize(("key", "value", "wanted"), VALUES)
@pytest.mark.parametrize("of_part", [True, False])
def test_faulty_values_are_refused(
    careful: Callable[[str, str], None],
    messages: Messages,
    key: str,
    value: str,
    wanted: str,
    of_part: bool,
) -> None:
    """With line and column of the value, and what is allowed."""
    of_part_or_task = faulty(value, key)
    careful(of_part_or_task[0] if of_part else "", "" if of_part else of_part_or_task[1])
    [message] = messages(lambda: load_job("tasks.yaml"))
    file, line, column = message.split(":")[:3]
    assert (file, line) == (
        ("cell.yaml", "10") if of_part else ("tasks.yaml", "11")
    ) and wanted in message
    assert Path(file).read_text().splitlines()[int(line) - 1][int(column) - 1 :].startswith(value)


RULES = [
    (
        "{}",
        "",
        "cell.yaml:10:30",
        "no limit; give speed, acceleration, tool_speed or tilt, or remove 'while_holding'",
    ),
    ("10 deg", "", "cell.yaml:10:30", "must be a mapping"),
    ("{sped: 0.5}", "", "cell.yaml:10:31", "did you mean 'speed'?"),
    ("{tilt: 10 deg, lean: 1}", "", "cell.yaml:10:45", "unknown key 'lean'"),
    ("", "toolspeed: 1 m/s", "tasks.yaml:11:5", "did you mean 'tool_speed'?"),
    ("", "while_holding: {tilt: 0.1}", "tasks.yaml:11:5", "unknown key 'while_holding'"),
]
"""Care of the part and of the task, place and message."""


@pytest.mark.parametrize(("part", "task", "place", "wanted"), RULES)
def test_unknown_and_empty_care_is_refused(
    careful: Callable[[str, str], None],
    messages: Messages,
    part: str,
    task: str,
    place: str,
    wanted: str,
) -> None:
    """With a remedy or the key that was meant."""
    careful(part, task)
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert message.startswith(f"{place}: ") and wanted in message


@pytest.mark.parametrize("of_part", [True, False])
@pytest.mark.parametrize(
    ("pick", "place", "wanted"),
    [
        ("pick: {joints: [0.5, -90 deg]}", UPRIGHT, "joint positions at the pick give the part no attitude; give xyz, with rpy or quat"),
        (PICK, "place: {joints: [0.5, 0.2]}", "joint positions at the place give the part no attitude; give xyz, with rpy or quat"),
        ("pick: {xyz: [0, 0, 1], rpy: [150 deg, 0, 0], free: yaw}", "place: {xyz: [0, 0, 1], rpy: [150 deg, 0, 0]}", "at the pick the part may turn about the tool's z axis, which is not vertical there; remove 'free' or 'symmetry', or tilt"),
        (PICK, "place: {xyz: [0, 0, 1], rpy: [168 deg, 0, 0]}", "at the place the part leans 12.0 deg from its attitude at the pick, and at a target 9.5 deg are allowed; turn the target, or raise tilt"),
        (PICK, PLACE, "at the place the part leans 180.0 deg from its attitude at the pick"),
    ],
)  # fmt: skip
def test_a_tilt_that_no_motion_keeps_is_refused(
    careful: Callable[[str, str], None],
    change: Change,
    messages: Messages,
    pick: str,
    place: str,
    wanted: str,
    of_part: bool,
) -> None:
    """At the key of the task, or of the part that has the limit."""
    careful("{tilt: 10 deg}" if of_part else "", "" if of_part else "tilt: 10 deg")
    change("tasks.yaml", PICK, pick, UPRIGHT, place)
    [message] = messages(lambda: load_job("tasks.yaml"))
    of = "while_holding of part 'cup'" if of_part else "tilt"
    where = "tasks.yaml:10:" if of_part else "tasks.yaml:11:"
    assert message.startswith(where) and f"{of}: {wanted}" in message


def test_a_bare_move_holds_nothing_that_could_tilt(change: Change, messages: Messages) -> None:
    """It may be slow."""
    change("tasks.yaml", "    arm: right", "    arm: right\n    speed: 0.5\n    tilt: 5 deg")
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert message.startswith("tasks.yaml:15:") and "a bare move holds no part" in message


ON_BELT = (
    "pick: {xyz: [0, 0, 1], rpy: [180 deg, 0, 0], conveyor: belt, passes: 2.5 s, within: 600 mm}"
)


@pytest.mark.parametrize("of_part", [True, False])
def test_a_tool_that_follows_a_conveyor_is_no_slower_than_it(
    careful: Callable[[str, str], None], change: Change, messages: Messages, of_part: bool
) -> None:
    """120 mm/s over a belt at 150 mm/s are refused, 160 mm/s and shares of the joints' rates are read."""
    limits = "tool_speed: 120 mm/s", "speed: 50 %"
    careful(f"{{{limits[0]}}}" if of_part else "", limits[1] if of_part else limits[0])
    change("cell.yaml", "clearance:", "conveyors: {belt: {velocity: [0, -150 mm/s, 0]}}\nclearance:")  # fmt: skip
    change("tasks.yaml", PICK, ON_BELT)
    [message] = messages(lambda: load_job("tasks.yaml"))
    of = "while_holding of part 'cup'" if of_part else "tool_speed"
    assert message.startswith("tasks.yaml:10:11" if of_part else "tasks.yaml:11:17"), message
    assert (
        f"{of}: 120 mm/s, but the tool follows conveyor 'belt', which moves at 150 mm/s" in message
    )
    assert "raise it above that, or slow the conveyor" in message
    for name in ("cell.yaml", "tasks.yaml"):
        change(name, "120 mm/s", "160 mm/s") if "120 mm/s" in Path(name).read_text() else None
    task = load_job("tasks.yaml").tasks[0]
    assert task.care.stricter(task.holding).tool_speed == 0.16


def test_paths_and_seams_have_all_four_limits(tasks_folder: Path, tmp_path: Path) -> None:
    """Their accelerations scale those of the robot."""
    keys = "speed: 0.5\n    acceleration: 0.25\n    tool_speed: 0.3 m/s\n    tilt: 0.2\n    id: "
    for file in (tasks_folder / "10_seam").glob("*.yaml"):
        text = file.read_text().replace("- id: ", f"- {keys}", 1)
        (tmp_path / file.name).write_text(text if file.name == "tasks.yaml" else file.read_text())
    job = load_job(tmp_path / "tasks.yaml")
    care = job.tasks[0].care
    assert care == Care(0.5, 0.25, 0.3, 0.2)
    slow = job.under(care).limits
    np.testing.assert_allclose(slow.velocity, 0.5 * job.limits.velocity)
    np.testing.assert_allclose(slow.acceleration, 0.25 * 0.25 * job.limits.acceleration)
    np.testing.assert_allclose(slow.jerk, 0.125 * job.limits.jerk)
