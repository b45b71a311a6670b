"""Targets and frames of files that say how far they vary."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job

Change = Callable[..., None]
BIN = "rpy: [0, 0, 90 deg]"
PICK = "free: yaw}"


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
        (PICK, "free: yaw, varies: {}}", "no deviation; give xy, z or yaw above 0"),
        (PICK, "free: yaw, varies: 0}", "no deviation; give xy, z or yaw above 0"),
        (PICK, "free: yaw, varies: -1 mm}", "must be at least 0"),
        (PICK, "free: yaw, varies: 1 deg}", "unit 'deg' in '1 deg' is not one of length"),
        (PICK, "free: yaw, varies: {yaw: 1 mm}}", "unit 'mm' in '1 mm' is not one of angle"),
        (PICK, "free: yaw, varies: {roll: 1 deg}}", "unknown key 'roll'"),
        ("-90 deg]}", "-90 deg], varies: 1 mm}", "'varies' does not go with 'joints'; keep one"),
    ],
)
def test_deviations_that_say_nothing_are_refused(
    project: object, change: Change, messages: Callable[..., list[str]], old: str, new: str, wanted: str
) -> None:  # fmt: skip
    """With the place and what to write."""
    change("tasks.yaml", old, new)
    found = messages(lambda: load_job("tasks.yaml"))
    assert any(wanted in message for message in found), found
    assert all(message.startswith("tasks.yaml:") for message in found)
