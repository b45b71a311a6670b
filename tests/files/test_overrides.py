"""Values in place of those in files: as if somebody had edited them, checked, told of who wants them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.errors import Diagnostic, InputError
from dualarm_cli.files.source.overrides import Override
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.place import Place

EDITS = {
    "tool length": ("cell:/tools/left/tcp/xyz/2", "150 mm", "cell.yaml", "120 mm", "150 mm"),
    "frame": ("cell:/frames/bin/xyz/0", 0.45, "cell.yaml", "[0.4,", "[0.45,"),
    "obstacle": ("cell:/obstacles/table/xyz/2", 0.55, "cell.yaml", "0.6]}", "0.55]}"),
    "clearance": ("cell:/clearance", "5 mm", "cell.yaml", "10 mm", "5 mm"),
    "robot limit": ("robot:/limits/turn/acceleration", 3, "robot.yaml", "acceleration: 5", "acceleration: 3"),
    "posture": ("robot:/postures/bent/l1", "80 deg", "robot.yaml", "90 deg", "80 deg"),
    "target": ("tasks:/tasks/0/pick/xyz/2", "60 mm", "tasks.yaml", "50 mm", "60 mm"),
    "default": ("tasks:/defaults/approach", 0.07, "tasks.yaml", "80 mm", "0.07"),
    "word": ("tasks:/start", "home", "tasks.yaml", "start: bent", "start: home"),
}  # fmt: skip


def _facts(noun: Any) -> Any:
    """Returns all that a noun says, to the last bit, but for the hashes of its files and the places in them."""
    if isinstance(noun, Place):
        return None
    if isinstance(noun, np.ndarray):
        return noun.tolist()
    if isinstance(noun, pin.SE3):
        return noun.homogeneous.tolist()
    if is_dataclass(noun):
        return {f.name: _facts(getattr(noun, f.name)) for f in fields(noun) if f.name != "inputs"}
    if isinstance(noun, Mapping):
        return {key: _facts(value) for key, value in noun.items()}
    return [_facts(entry) for entry in noun] if isinstance(noun, tuple | list) else noun


@pytest.mark.parametrize("name", EDITS)
def test_an_override_is_as_good_as_an_edited_file(name: str, project: Path) -> None:
    """Every number of the job is the same, and not what it was."""
    key, value, file, old, new = EDITS[name]
    plain = _facts(load_job("tasks.yaml"))
    replaced = _facts(load_job("tasks.yaml", overrides={key: value}))
    text = (project / file).read_text()
    assert text.count(old) >= 1
    (project / file).write_text(text.replace(old, new, 1))
    assert replaced == _facts(load_job("tasks.yaml"))
    assert replaced != plain


def test_an_override_is_checked_like_the_file(project: Path) -> None:
    """At the file's place, with the path and the value; all at once."""
    with pytest.raises(InputError) as error:
        load_job(
            "tasks.yaml",
            overrides={
                "cell:/obstacles/table/box/1": "-5 mm",
                "robot:/limits/turn/jerk": 0,
                "cell:/clearance": "3 deg",
            },
        )
    texts = [str(d) for d in error.value.diagnostics]
    assert texts == [
        "cell.yaml:9:20: E200 obstacles.table.box[1] is replaced by '-5 mm': '-5 mm': length must be positive",
        "cell.yaml:10:12: E200 clearance is replaced by '3 deg': unit 'deg' in '3 deg' is not one of length; allowed: "
        "m, mm, cm, um, in",
        "robot.yaml:9:33: E200 limits.turn.jerk is replaced by 0: 0: angular jerk must be positive",
    ]


def test_an_error_is_told_of_who_wants_the_value(project: Path) -> None:
    """At that place, with the file's path and what is wrong."""
    at = Diagnostic("study.yaml", 7, 3, "E300", "", "  height:")
    override = Override("3 deg", "parameter 'height'", at)
    with pytest.raises(InputError) as error:
        load_job("tasks.yaml", overrides={"cell:/frames/bin/xyz/2": override})
    (found,) = error.value.diagnostics
    assert (found.file, found.line, found.column) == ("study.yaml", 7, 3)
    assert found.message.startswith(
        "parameter 'height' makes frames.bin.xyz[2] of cell.yaml '3 deg': unit 'deg'"
    )


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("cell:/base/xyz/2", "cell.yaml:1:1: E300 cell:/base/xyz/2 leads nowhere: no 'base'; there: dualarm, robot"),
        ("robot.left:/name", "robot.left: E300 /name is replaced by 1: this job has no file 'robot.left'"),
        ("sell:/clearance", "leads nowhere: write a file (tasks, cell, robot,"),
        ("cell:clearance", "leads nowhere: write a file (tasks, cell, robot,"),
    ],
)  # fmt: skip
def test_an_override_that_means_nothing_is_refused(key: str, message: str, project: Path) -> None:
    """It is never passed over."""
    with pytest.raises(InputError) as error:
        load_job("tasks.yaml", overrides={key: 1})
    assert message in str(error.value.diagnostics[0])


def test_two_robots_are_replaced_together_or_apart(tasks_folder: Path) -> None:
    """`robot` means both files, `robot.right` the right one only, also where both are the same file."""
    path = tasks_folder / "05_two_robots" / "tasks.yaml"
    limits = load_job(path).cell.robot.limits
    joint = limits.joints[0].removeprefix("left_")
    left, right = (limits.joints.index(f"{side}_{joint}") for side in ("left", "right"))
    pointer = f"/limits/{joint}/acceleration"
    both = load_job(path, overrides={f"robot:{pointer}": 1.5}).cell.robot.limits.acceleration
    assert (both[left], both[right]) == (1.5, 1.5)
    one = load_job(path, overrides={f"robot.right:{pointer}": 1.5}).cell.robot.limits.acceleration
    assert (one[left], one[right]) == (limits.acceleration[left], 1.5)
    assert limits.acceleration[left] != 1.5


def test_a_key_that_the_file_leaves_out_can_be_given(project: Path) -> None:
    """Its default is replaced; what no file can have is refused as in a file."""
    job = load_job(
        "tasks.yaml", overrides={"tasks:/speed": "50%", "cell:/base": {"xyz": [0, 0, 1]}}
    )
    assert job.speed == 0.5
    assert job.cell.base.translation[2] == 1.0
    with pytest.raises(
        InputError, match=r"cell.yaml:1:1: E201 nonsense is replaced by 1: unknown key 'nonsense'"
    ):
        load_job("tasks.yaml", overrides={"cell:/nonsense": 1})


def test_a_whole_cell_can_be_chosen(project: Path) -> None:
    """`tasks: cell` names another file, and a robot another one: they are read in place of the first."""
    (project / "high.yaml").write_text(
        (project / "cell.yaml").read_text().replace("0.6]}", "0.9]}")
    )
    (project / "slow.yaml").write_text(
        (project / "robot.yaml").read_text().replace("acceleration: 5", "acceleration: 1")
    )
    job = load_job("tasks.yaml", overrides={"tasks:/cell": "high.yaml", "cell:/robot": "slow.yaml"})
    assert job.cell.obstacles[0].shape.pose.translation[2] == 0.9
    assert job.cell.robot.limits.acceleration[0] == 1.0
