# ruff: noqa: E501 (a table, one case a line)
"""Frames, obstacles and tools as lists of entries with a name: what their mappings mean, and errors at their lines."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.tasks.tasks import load_job

LISTS = """\
dualarm: cell/1
robot: robot.yaml
tools:
  - {name: left, tcp: {xyz: [0, 0, 120 mm]}, mass: 800 g}
frames:
  - {name: bin, xyz: [0.4, 0.1, 0.7], rpy: [0, 0, 90 deg]}
  - name: bin.slot
    in: bin
    xyz: [0.1, 0, 0]
obstacles:
  - {name: table, box: [1, 2, 40 mm], xyz: [0.5, 0, 0.6]}
  - {box: [1, 1, 1], name: post, xyz: [3, 0, 0]}
clearance: 10 mm
"""
MAPPINGS = """\
dualarm: cell/1
robot: robot.yaml
tools:
  left: {tcp: {xyz: [0, 0, 120 mm]}, mass: 800 g}
frames:
  bin: {xyz: [0.4, 0.1, 0.7], rpy: [0, 0, 90 deg]}
  bin.slot: {in: bin, xyz: [0.1, 0, 0]}
obstacles:
  table: {box: [1, 2, 40 mm], xyz: [0.5, 0, 0.6]}
  post: {box: [1, 1, 1], xyz: [3, 0, 0]}
clearance: 10 mm
"""


def test_a_list_with_names_means_what_the_mapping_means(project: Path) -> None:
    (project / "cell.yaml").write_text(LISTS)
    one = load_cell("cell.yaml").cell
    (project / "cell.yaml").write_text(MAPPINGS)
    other = load_cell("cell.yaml").cell
    assert list(one.frames) == list(other.frames) == ["bin", "bin.slot"]
    for name, pose in one.frames.items():
        np.testing.assert_array_equal(pose.homogeneous, other.frames[name].homogeneous)
    assert [o.name for o in one.obstacles] == [o.name for o in other.obstacles] == ["table", "post"]
    for mine, theirs in zip(one.obstacles, other.obstacles, strict=True):
        assert mine.shape.size == theirs.shape.size
        np.testing.assert_array_equal(mine.shape.pose.homogeneous, theirs.shape.pose.homogeneous)
    for arm in ("left", "right"):
        np.testing.assert_array_equal(
            one.tools[arm].tcp.homogeneous, other.tools[arm].tcp.homogeneous
        )
        assert one.tools[arm].inertia == other.tools[arm].inertia


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("box: [1, 2, 40 mm]", "box: [1, 2, 0]", "11:31: E200 0: length must be positive"),
        ("box: [1, 2, 40 mm]", "bocks: 1", "11:19: E201 unknown key 'bocks'; allowed: xyz, rpy, quat, in, box, sphere, cylinder, capsule, half_space, mesh"),
        ("name: post, ", "", "12:5: E202 'name' is missing"),
        ("name: post", "name: 12", "12:28: E200 must be text (in quotes, if it looks like a number), not 12"),
        ("name: post", "name: table", "12:28: E102 duplicate obstacle 'table', first at line 11"),
        ("name: post", "name: la", "12:28: E300 'la' is already the name of a link, tool or part"),
        ("  - {box: [1, 1, 1], name: post, xyz: [3, 0, 0]}", "  - post", "12:5: E200 must be a mapping, such as {key: value}, not 'post'"),
        ("in: bin", "in: bim", "8:9: E300 there is no frame 'bim', did you mean 'bin'? Frames: bin, bin.slot, world"),
        ("name: bin.slot", "name: bin", "7:11: E102 duplicate frame 'bin', first at line 6"),
        ("name: left", "name: lift", "4:12: E201 unknown key 'lift', did you mean 'left'? Allowed: left, right"),
        ("mass: 800 g", "mass: 800 mm", "4:52: E200 unit 'mm' in '800 mm' is not one of mass; allowed: kg, g"),
    ],
)  # fmt: skip
def test_each_mistake_of_a_list_is_told_at_its_line(
    old: str,
    new: str,
    expected: str,
    project: Path,
    change: Callable[..., None],
    messages: Callable[[Callable[[], object]], list[str]],
) -> None:
    (project / "cell.yaml").write_text(LISTS)
    change("cell.yaml", old, new)
    assert messages(lambda: load_cell("cell.yaml")) == [f"cell.yaml:{expected}"]


def test_entries_of_a_list_are_replaced_by_their_index(
    project: Path, messages: Callable[[Callable[[], object]], list[str]]
) -> None:
    """A study's path of a list has an index, as its file has it; errors name the entry."""
    (project / "cell.yaml").write_text(LISTS)
    job = load_job("tasks.yaml", overrides={"cell:/obstacles/0/xyz/2": 0.5})
    assert job.cell.obstacles[0].shape.pose.translation[2] == 0.5
    wrong = {"cell:/obstacles/0/box/1": "-5 mm"}
    assert messages(lambda: load_job("tasks.yaml", overrides=wrong)) == [
        "cell.yaml:11:28: E200 obstacles.table.box[1] is replaced by '-5 mm': '-5 mm': length must be positive"
    ]
