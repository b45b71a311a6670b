"""What varies in files: dwells with least, nominal and greatest times, poses of targets and frames."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.dwell import TimeRange

Change = Callable[..., None]
GRIPPER = "gripper: 0.12 s"
BIN = "rpy: [0, 0, 90 deg]"
PICK = "free: yaw}"


def test_three_times_are_a_spread_around_what_is_planned(project: object, change: Change) -> None:
    """The plan uses the nominal time; a part with one time does not vary."""
    change("tasks.yaml", GRIPPER, "gripper: [80 ms, 0.12, 200 ms]")
    change("tasks.yaml", "mode: paired", "budget: {cycle_time: 9 s, cycle: 95%}")
    job = load_job("tasks.yaml")
    pick = job.tasks[0].stops[0]
    assert (pick.dwell.gripper, pick.dwell.settle) == (0.12, 0.03)
    assert pick.varying == (TimeRange(0.08, 0.12, 0.2),)
    assert job.budget is not None and job.budget.cycle_kind == "95%"
    assert job.tasks[1].stops[0].varying == ()  # a move


def test_targets_vary_by_themselves_and_with_their_frames(project: object, change: Change) -> None:
    """Along the axes of the frame: its own about the target, then the slot's, then the bin's."""
    change("cell.yaml", BIN, f"{BIN}, varies: {{xy: 3 mm, yaw: 1 deg}}")
    change("cell.yaml", "{in: bin, xyz: [0.1, 0, 0]}", "{in: bin, xyz: [0.1, 0, 0], varies: 1 mm}")
    change("tasks.yaml", PICK, "free: yaw, varies: {z: 2 mm}}")
    job = load_job("tasks.yaml")
    own, slot, tray = job.tasks[0].stops[0].ranges
    assert (own.of, own.xy, own.z, own.yaw) == ("a pick", 0.0, 0.002, 0.0)
    assert own.centre.translation == pytest.approx([0.4, 0.2, 0.75])
    assert own.centre.rotation[:, 0] == pytest.approx(np.array([0.0, 1.0, 0.0]))
    assert (slot.of, slot.xy, tray.of, tray.xy) == ("frame bin.slot", 0.001, "frame bin", 0.003)
    assert tray.yaw == pytest.approx(math.radians(1.0))
    assert tray.centre == job.cell.frames["bin"]
    assert job.tasks[0].stops[1].ranges == job.tasks[1].stops[0].ranges == ()


@pytest.mark.parametrize(
    ("old", "new", "wanted"),
    [
        (GRIPPER, "gripper: [0.1, 0.2]", "a list of 2; give least, nominal and greatest time"),
        (GRIPPER, "gripper: [0.2, 0.1, 0.3]", "0.2, 0.1, 0.3 s: give least, nominal and greatest"),
        (GRIPPER, "gripper: [0.1, 0.2, 1 mm]", "unit 'mm' in '1 mm' is not one of time"),
        (GRIPPER, "gripper: [-1, 0.2, 1]", "time must be at least 0"),
        (GRIPPER, "gripper: {least: 1}", "must be a number such as"),
        ("mode: paired", "budget: {cycle: worst, skew: 1 ms}", "give cycle_time, too"),
        ("mode: paired", "budget: {cycle_time: 9, cycle: 99%}", "'99%' is not allowed"),
        (PICK, "free: yaw, varies: {}}", "no deviation; give xy, z or yaw above 0"),
        (PICK, "free: yaw, varies: 0}", "no deviation; give xy, z or yaw above 0"),
        (PICK, "free: yaw, varies: -1 mm}", "must be at least 0"),
        (PICK, "free: yaw, varies: 1 deg}", "unit 'deg' in '1 deg' is not one of length"),
        (PICK, "free: yaw, varies: {yaw: 1 mm}}", "unit 'mm' in '1 mm' is not one of angle"),
        (PICK, "free: yaw, varies: {roll: 1 deg}}", "unknown key 'roll'"),
        ("-90 deg]}", "-90 deg], varies: 1 mm}", "'varies' does not go with 'joints'; keep one"),
    ],
)
def test_values_that_say_nothing_are_refused(
    project: object, change: Change, messages: Callable[..., list[str]], old: str, new: str, wanted: str
) -> None:  # fmt: skip
    """With the place and what to write."""
    change("tasks.yaml", old, new)
    found = messages(lambda: load_job("tasks.yaml"))
    assert any(wanted in message for message in found), found
    assert all(message.startswith("tasks.yaml:") for message in found)
