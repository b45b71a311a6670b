# ruff: noqa: E501 (tables of exact messages, one a line)
"""Tasks repeated for the places of grids and CSV files: poses, ids, order, and what is refused with its place."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.job import Job, PoseTarget
from dualarm_cli.notes import is_about

Messages = Callable[..., list[str]]
Change = Callable[..., None]
FRAME = "bin: {xyz: [0.4, 0.1, 0.7], rpy: [0, 0, 90 deg]}"
"""The frame of the tiny cell: its x is the world's y."""
PICK = "pick: {at: bin.slot, xyz: [0, 0, 50 mm], rpy: [180 deg, 0, 0], free: yaw}"
PLACE = "place: {xyz: [0.2, 0.5, 0.8], symmetry: 2}"


@pytest.fixture
def pattern(change: Change) -> Callable[..., Job]:
    """Reads the tiny job with a grid in its frame, a repeated pick and place."""

    def load(grid: str, pick: str = "each: place", place: str = "", *more: str) -> Job:
        change("cell.yaml", FRAME, f"{FRAME[:-1]}, grid: {{{grid}}}}}")
        frame = "{at: bin, " if place else "{"
        change(
            "tasks.yaml",
            PICK,
            f"pick: {{at: bin, {pick}, xyz: [0, 0, 0]}}" if pick else "pick: {xyz: [0, 0, 0]}",
            PLACE,
            f"place: {frame}{place or 'symmetry: 2'}, xyz: [0, 0, 0]}}",
            *more,
        )
        return load_job("tasks.yaml")

    return load


def points(job: Job, action: str) -> list[list[float]]:
    """Returns where the stops of an action are in the frame [mm], in order."""
    stops = [stop for task in job.tasks for stop in task.stops if stop.action == action]
    targets = [stop.target for stop in stops]
    assert all(isinstance(target, PoseTarget) for target in targets)
    world = np.array([target.pose.translation for target in targets])  # type: ignore[union-attr]
    x, y, z = world[:, 1] - 0.1, 0.4 - world[:, 0], world[:, 2] - 0.7
    return np.round(np.column_stack([x, y, z]) * 1e3, 6).tolist()


def ids(job: Job) -> list[str]:
    """Returns the ids of the repeated tasks."""
    return [task.id for task in job.tasks if task.id != "b"]


@pytest.mark.parametrize(
    ("order", "numbers"),
    [
        ("rows", [(1, 1), (2, 1), (3, 1), (1, 2), (2, 2), (3, 2)]),
        ("columns", [(1, 1), (1, 2), (2, 1), (2, 2), (3, 1), (3, 2)]),
        ("snake", [(1, 1), (2, 1), (3, 1), (3, 2), (2, 2), (1, 2)]),
    ],
)
def test_places_follow_the_order_of_the_grid(
    pattern: Callable[..., Job], order: str, numbers: list[tuple[int, int]]
) -> None:
    """A tray of three by two: ids name the places, counted from 1; the first lies at the frame."""
    job = pattern(f"count: [3, 2], pitch: [60 mm, -40 mm], order: {order}")
    assert ids(job) == [f"a[{x},{y}]" for x, y in numbers]
    assert points(job, "pick") == [[60.0 * (x - 1), -40.0 * (y - 1), 0.0] for x, y in numbers]


def test_layers_are_picked_from_the_top(pattern: Callable[..., Job]) -> None:
    """Two layers of one row: the upper one first, and numbers have the layer."""
    job = pattern("count: [2, 1], pitch: [60 mm, 0], layers: 2, layer_height: 45 mm")
    assert ids(job) == ["a[1,1,2]", "a[2,1,2]", "a[1,1,1]", "a[2,1,1]"]
    assert points(job, "pick") == [[0, 0, 45], [60, 0, 45], [0, 0, 0], [60, 0, 0]]


def test_layers_are_placed_from_the_bottom(pattern: Callable[..., Job]) -> None:
    """The same pallet, filled from one pick."""
    job = pattern("count: [2, 1], pitch: [60 mm, 0], layers: 2, layer_height: 45 mm", "", "each: place")  # fmt: skip
    assert points(job, "place") == [[0, 0, 0], [60, 0, 0], [0, 0, 45], [60, 0, 45]]


def test_rows_are_staggered_and_layers_turned(pattern: Callable[..., Job]) -> None:
    """By hand: the second row is shifted; the second layer is turned about the middle (30, 20) by a quarter."""
    grid = "count: [2, 2], pitch: [60 mm, 40 mm], stagger: 30 mm"
    turned = f"{grid}, layers: 2, layer_height: 10 mm, turn: 90 deg"
    job = pattern(turned, "", "each: place")
    flat = [[0, 0], [60, 0], [30, 40], [90, 40]]
    assert points(job, "place")[:4] == [[x, y, 0] for x, y in flat]
    assert points(job, "place")[4:] == [[30 - (y - 20), 20 + (x - 30), 10] for x, y in flat]
    target = job.tasks[4].stops[1].target
    assert isinstance(target, PoseTarget)
    # The frame is turned by a quarter, the layer by another.
    assert np.allclose(target.pose.rotation[:2, :2], [[-1, 0], [0, -1]], atol=1e-12)


def test_places_are_left_out_and_selected(pattern: Callable[..., Job]) -> None:
    """One place is missing in all layers, one in the upper layer; ranges and a number select."""
    grid = "count: [2, 2], pitch: [60 mm, 40 mm], layers: 2, layer_height: 10 mm, without: [[1, 1], [2, 2, 2]]"
    job = pattern(grid, "each: {y: [1, 2], layer: [2, 2], first: 2}")
    assert ids(job) == ["a[2,1,2]", "a[1,2,2]"]


def test_poses_are_those_of_coordinates_by_hand(change: Change) -> None:
    """Decimal numbers stay decimal, so that the poses are equal to the last bit."""
    change("cell.yaml", FRAME, f"{FRAME[:-1]}, grid: {{count: [4, 1], pitch: [0.06, 0]}}}}")
    change("tasks.yaml", PICK, "pick: {at: bin, each: place, xyz: [-90 mm, 0.07, 0]}")
    job = load_job("tasks.yaml")
    repeated = [task.stops[0].target for task in job.tasks if task.id != "b"]
    for x, target in zip(("-90", "-30", "30", "90"), repeated, strict=True):
        change("tasks.yaml", job_pick := _pick_text("tasks.yaml"), f"pick: {{at: bin, xyz: [{x} mm, 0.07, 0]}}")  # fmt: skip
        [by_hand] = [task.stops[0].target for task in load_job("tasks.yaml").tasks if task.id == "a"]  # fmt: skip
        assert isinstance(target, PoseTarget) and isinstance(by_hand, PoseTarget)
        assert np.array_equal(target.pose.homogeneous, by_hand.pose.homogeneous), job_pick


def _pick_text(file: str) -> str:
    return next(line.strip() for line in Path(file).read_text().split("\n") if "pick:" in line)


SHARED = """\
dualarm: tasks/1
cell: cell.yaml
order: optimise
start: bent
tasks:
  - id: left
    arm: left
    pick:  {xyz: [0.4, 0.1, 0.9]}
    place: {at: bin, each: {x: [1, 2]}, xyz: [0, 0, 0]}
  - id: right
    arm: any
    pick:  {xyz: [0.4, 0.1, 0.9]}
    place: {at: bin, each: {x: [3, 4]}, xyz: [0, 0, 0]}
  - {id: last, arm: right, after: [left], move: {xyz: [0.4, 0.1, 0.9]}}
"""
PALLET = "count: [4, 1], pitch: [60 mm, 0], layers: 2, layer_height: 45 mm, stagger: 0"


def test_upper_layers_wait_for_what_carries_them(project: Path, change: Change) -> None:
    """Each place of the second layer lies on the one below; other tasks wait for all tasks of a pattern."""
    change("cell.yaml", FRAME, f"{FRAME[:-1]}, grid: {{{PALLET}}}}}")
    (project / "tasks.yaml").write_text(SHARED)
    after = {task.id: task.after for task in load_job("tasks.yaml").tasks}
    upper = {f"{name}[{x},1,2]": (f"{name}[{x},1,1]",) for name, x in [("left", 1), ("left", 2), ("right", 3), ("right", 4)]}  # fmt: skip
    lower = {name.replace(",2]", ",1]"): () for name in upper}
    assert after == upper | lower | {"last": ("left[1,1,1]", "left[2,1,1]", "left[1,1,2]", "left[2,1,2]")}  # fmt: skip


def test_an_arm_in_the_order_of_the_file_needs_no_rules(project: Path, change: Change) -> None:
    """With order: given the left arm fills from the bottom anyway."""
    change("cell.yaml", FRAME, f"{FRAME[:-1]}, grid: {{{PALLET}}}}}")
    given = SHARED.replace("order: optimise", "order: given").replace("arm: any", "arm: right")
    (project / "tasks.yaml").write_text(given)
    assert {task.after for task in load_job("tasks.yaml").tasks if task.id != "last"} == {()}


def test_parts_of_a_turned_layer_lie_on_all_that_they_overlap(pattern: Callable[..., Job]) -> None:
    """Brute force: squares of a pitch that overlap, in a layer turned by 45 degrees."""
    grid = "count: [3, 3], pitch: [60 mm, 60 mm], layers: 2, layer_height: 45 mm, turn: 45 deg"
    job = pattern(grid, "", "each: place", "order: given", "order: optimise")
    flat = {(x, y): (60.0 * x, 60.0 * y) for x, y in itertools.product(range(3), repeat=2)}
    c = math.sqrt(0.5)
    for task in job.tasks:
        if not task.id.endswith(",2]"):
            continue
        i, j = (int(n) - 1 for n in task.id[2:-1].split(",")[:2])
        dx, dy = flat[i, j][0] - 60.0, flat[i, j][1] - 60.0
        x, y = 60.0 + c * (dx - dy), 60.0 + c * (dx + dy)
        lie = [k for k, (u, v) in flat.items() if abs(u - x) < 60.0 - 1e-6 and abs(v - y) < 60.0 - 1e-6]  # fmt: skip
        assert set(task.after) == {f"a[{u + 1},{v + 1},1]" for u, v in lie}


def test_parts_in_layers_may_touch_what_carries_them(pattern: Callable[..., Job], change: Change) -> None:  # fmt: skip
    """With a kind of part, the upper one touches the lower; `touches` with the own id means all others."""
    change("cell.yaml", "clearance:", "parts: {block: {shapes: [{box: [0.05, 0.05, 0.04]}]}}\nclearance:")  # fmt: skip
    job = pattern(
        "count: [2, 1], pitch: [60 mm, 0], layers: 2, layer_height: 45 mm", "", "each: place",
        "    arm: left", "    arm: left\n    part: block\n    touches: [a]",
    )  # fmt: skip
    touches = {task.id: set(task.touches) for task in job.tasks if task.id != "b"}
    names = set(touches)
    assert touches == {name: names - {name} for name in names}


def test_a_list_of_parts_comes_from_a_csv_file(project: Path, change: Change) -> None:
    """Units in the head of columns or with a value; without ids the rows are counted."""
    (project / "parts.csv").write_text(
        "id, x [mm], y, yaw [deg]\nbolt, 100, 20 mm, 90\n\nnut,-50,0,0\n"
    )
    change("tasks.yaml", PICK, "pick: {at: bin, each: parts.csv, xyz: [0, 0, 10 mm]}")
    job = load_job("tasks.yaml")
    assert ids(job) == ["a[bolt]", "a[nut]"]
    assert points(job, "pick") == [[100, 20, 10], [-50, 0, 10]]
    turned = job.tasks[0].stops[0].target
    assert isinstance(turned, PoseTarget)
    assert np.allclose(turned.pose.rotation[:2, 0], [-1, 0], atol=1e-12)  # 90 and 90 deg
    assert "parts.csv" in job.inputs
    (project / "parts.csv").write_text("x;y\n0,1;0\n")
    with pytest.raises(Exception, match=r"decimal point: 0\.1"):
        load_job("tasks.yaml")


@pytest.mark.parametrize(
    ("each", "expected"),
    [
        ("each: place", "a is 6 tasks, a[1,1] to a[2,3]: pick bin[1,1] … [2,3]"),
        ("each: {x: [2, 2], y: [3, 3]}", "a is 1 task, a[2,3]: pick bin[2,3]"),
    ],
)
def test_notes_say_what_a_task_is_expanded_to(
    pattern: Callable[..., Job], each: str, expected: str
) -> None:
    """The first and the last task, and their places; of a single one once."""
    job = pattern("count: [2, 3], pitch: [60 mm, 40 mm]", each)
    assert [note for note in job.notes if is_about(note, "pattern")] == [expected]


GRID = "count: [3, 4], pitch: [60 mm, 60 mm]"


@pytest.mark.parametrize(
    ("grid", "wanted"),
    [
        ("count: [3, 4]", "E202 'pitch' is missing"),
        ("count: [3], pitch: [1, 1]", "too short"),
        ("count: [0, 4], pitch: [60 mm, 60 mm]", "0 must be at least 1"),
        ("count: [3, 4], pitch: [60 mm, 0]", "places along y coincide: their pitch is 0"),
        ("count: [200, 200], pitch: [60 mm, 6 mm]", "40000 places; at most 10000 are allowed"),
        (f"{GRID}, layers: 2", "E202 'layer_height' is missing: the grid has layers"),
        (f"{GRID}, order: zigzag", "'zigzag' is not allowed"),
        (f"{GRID}, without: [[4, 1]]", "there is no place [4, 1] to leave out"),
        ("count: [1, 1], pitch: [0, 0], without: [[1, 1]]", "no place is left; leave out fewer"),
        (f"{GRID}, staggered: 3 mm", "unknown key 'staggered'"),
    ],
)
def test_bad_grids_are_refused(
    pattern: Callable[..., Job], messages: Messages, grid: str, wanted: str
) -> None:
    """With the place in the cell file and what to do, once."""
    [message] = messages(lambda: pattern(grid))
    assert message.startswith("cell.yaml:6:") and wanted in message


@pytest.mark.parametrize(
    ("pick", "wanted"),
    [
        ("each: plce", "each: 'plce' is not allowed; write place, the path of a CSV file, or a selection such as {x: [1, 2]}"),
        ("each: {x: [4, 4]}", "selects 0 of the 12 places of 'bin'; widen the ranges"),
        ("each: {first: 13}", "selects 12 of the 12 places of 'bin'; first: at most 12"),
        ("each: {row: [1, 2]}", "unknown key 'row'"),
        ("each: {x: 2}", "must be a list, such as [a, b], not 2"),
        ("each: parts.csv", "there is no file 'parts.csv' here"),
        ("each: place, yaw: free", "unknown key 'yaw'"),
    ],
)  # fmt: skip
def test_bad_repetitions_are_refused(
    pattern: Callable[..., Job], messages: Messages, pick: str, wanted: str
) -> None:
    """With the place in the task file and what to do, once for all tasks that would be made."""
    [message] = messages(lambda: pattern(GRID, pick))
    assert message.startswith("tasks.yaml:10:") and wanted in message


def test_a_frame_without_places_is_refused(change: Change, messages: Messages) -> None:
    """It names the frames that have places."""
    change("cell.yaml", FRAME, f"{FRAME[:-1]}, grid: {{{GRID}}}}}")
    change("tasks.yaml", "at: bin.slot", "at: bin.slot, each: place")
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert "frame 'bin.slot' has no grid; frames with a grid: bin" in message


def test_different_numbers_of_places_are_refused(pattern: Callable[..., Job], messages: Messages) -> None:  # fmt: skip
    """Twelve are picked, six fit: nothing is dropped without a word."""
    [message] = messages(lambda: pattern(GRID, "each: place", "each: {x: [1, 2], y: [1, 3]}"))
    assert "pick has 12 places and place has 6 places; select as many of each, such as each: {first: 6}" in message  # fmt: skip


def test_a_place_is_filled_once(project: Path, change: Change, messages: Messages) -> None:
    """Two tasks may not fill the same pallet twice."""
    change("cell.yaml", FRAME, f"{FRAME[:-1]}, grid: {{{PALLET}}}}}")
    (project / "tasks.yaml").write_text(SHARED.replace("{x: [3, 4]}", "{x: [2, 4]}"))
    [message] = messages(lambda: load_job("tasks.yaml"))
    assert "place [2,1,1] of 'bin' is used by 'left[2,1,1]' and 'right[2,1,1]'" in message


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("", "has no places: the first row names the columns (id, part, x, y, z, roll, pitch, yaw)"),
        ("x,y\n", "has no places"),
        ("x,why\n1,2\n", "1:3: E201 no column 'why'; allowed: id"),
        ("x,x\n1,2\n", "1:3: E102 column 'x' is given twice"),
        ("x [kg]\n1\n", "'kg' is no unit of x; write x [mm]"),
        ("x,yaw [mm]\n0,90\n", "1:3: E200 'mm' is no unit of yaw; write yaw [deg]"),
        ("x,id [deg]\n0,a\n", "1:3: E200 'deg' is no unit of id; write id"),
        ("x,yaw\n0,90\n", "2:3: E200 yaw: '90' without a unit"),
        ("id\na\n", "no column gives a pose; name x, y and z"),
        ("x,y\n1\n", "2:1: E200 1 values; the first row names 2"),
        ("x,y\n1,one\n", "2:3: E200 y: 'one' is not a number"),
        ("id,x\na,1\na,2\n", "3:1: E102 duplicate id 'a', first at line 2"),
        ("x,y\n120,1\n", "did you mean '120 mm'?"),
        ("id,x,part\nb,1,blok\n", "2:5: E300 the cell has no part 'blok' for task 'a[b]'"),
    ],
)  # fmt: skip
def test_bad_lists_are_refused(
    project: Path, change: Change, messages: Messages, text: str, wanted: str
) -> None:
    """With line and column of the CSV file; one mistake has one message."""
    (project / "parts.csv").write_text(text)
    change("tasks.yaml", PICK, "pick: {at: bin, each: parts.csv, xyz: [0, 0, 10 mm]}")
    (message,) = messages(lambda: load_job("tasks.yaml"))
    assert wanted in message


def test_overrides_reach_into_patterns(pattern: Callable[..., Job]) -> None:
    """As of studies: a pitch of the cell, and a key of the repeated task."""
    pattern(GRID)
    values = {"cell:/frames/bin/grid/pitch/0": "80 mm", "tasks:/tasks/a/pick/xyz/2": 0.01}
    moved = load_job("tasks.yaml", overrides=values)
    assert points(moved, "pick")[1] == [80, 0, 10]
