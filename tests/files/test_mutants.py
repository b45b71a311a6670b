"""Mutants of the keys of grids, lists, grasps, lines, freedoms and ranges: each is refused at its line, with a remedy.

The files are good as they are. Each mutant changes one line. Its message has to name that line (or, where a list is
too long for another one, that of the other) and to say what is allowed or what to do.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dualarm_cli.files.tasks.tasks import load_job

CELL = """\
dualarm: cell/1
robot: robot.yaml
tools:
  left:
    opening: [10 mm, 60 mm]
frames:
  tray:
    xyz: [0.4, 0.1, 0.7]
    varies:
      xy: 3 mm
      z: 1 mm
      yaw: 1 deg
    grid:
      count: [2, 2]
      pitch: [60 mm, 50 mm]
      layers: 2
      layer_height: 40 mm
      order: snake
      stagger: 5 mm
      turn: 90 deg
      without: [[2, 2, 2]]
parts:
  block:
    shapes: [{box: [40 mm, 60 mm, 80 mm]}]
    symmetry: 2
    grasps:
      top:
        xyz: [0, 0, 80 mm]
        rpy: [180 deg, 0, 0]
        symmetry: 3
        approach:
          distance: 50 mm
          direction: [0, 0, 1]
          in: tool
        retract: 40 mm
        width: 40 mm
      side:
        xyz: [20 mm, 0, 40 mm]
        quat: [0, 0, 0, 1]
        free:
          turn: yaw
          tilt: 15 deg
          area: [20 mm, 10 mm]
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: bent
budget:
  cycle_time: 30 s
  cycle: 95%
defaults:
  part: block
  dwell:
    gripper: [80 ms, 120 ms, 200 ms]
    settle: 30 ms
    handshake: [0, 5 ms, 10 ms]
tasks:
  - id: a
    arm: left
    grasp: [top, side]
    pick:
      at: tray
      each:
        x: [1, 2]
        y: [1, 2]
        layer: [2, 2]
        first: 2
        order: columns
      xyz: [0, 0, 0]
      varies: 1 mm
      retract:
        distance: 60 mm
        direction: [0, 0.6, 0.8]
        in: world
    place: {in: tray, each: list.csv, xyz: [0, 0, 0]}
  - id: look
    arm: left
    move:
      xyz: [0.4, 0, 0.9]
      free:
        turn: yaw
        tilt: 12 deg
        area: [30 mm, 20 mm]
"""
LIST = "id,part,x [mm],y [mm],z,yaw [deg]\na,block,100,200,0.1,10\nb,block,200,200,0.1,20\n"

WRONG = ("abc", "{a: 1}", "true", ".nan")
"""What is neither a quantity nor a list nor a word."""
LENGTH = (*WRONG, "[1, 2, 3, 4]", "1 kg", "1 deg", "2000 m", "1 mmm")
POSITIVE = (*LENGTH, "-1 mm")
ANGLE = (*WRONG, "[1, 2, 3, 4]", "1 mm", "1 s", "1000")
WITHIN = (*ANGLE, "-1 deg", "200 deg")
COUNT = (*WRONG, "[1, 1]", "0", "-1", "1.5", "1 mm", "20000")
WORD = ("abc", "1", "[rows]", "{a: 1}", "true", '""')
PAIR = ("abc", "1", "[1]", "[1, 2, 3]", "{a: 1}", "[0, 1]", "[a, b]", "[1.5, 2]", "[-1, 2]")
LENGTHS = ("abc", "1", "[60 mm]", "[1 mm, 1 mm, 1 mm]", "{a: 1}", "[1 kg, 1]", "[a, b]", "[[1], 1]")
DIRECTION = (
    *("abc", "1", "[0, 1]", "[0, 0, 0]", "[0, 0, 1, 0]", "{a: 1}", "[a, 0, 1]", "[0, 0, 1 mm]"),
    "[0, 0, 2000]",
)
TIME = (
    *("abc", "{a: 1}", "true", "-1 s", "1 mm", "[1]", "[1, 2]", "[1, 2, 3, 4]", "[3, 2, 1]"),
    *("[-1, 1, 2]", "[1, 3, 2]", "[1, 2, a]", "[1 mm, 1, 2]", "[]"),
)
VALUES: dict[str, dict[str, tuple[str, ...]]] = {
    "cell.yaml": {
        "count: [2, 2]": PAIR,
        "pitch: [60 mm, 50 mm]": (*LENGTHS, "[0, 50 mm]", "[60 mm, 0]"),
        "layers: 2": COUNT,
        "layer_height: 40 mm": (*POSITIVE, "0"),
        "order: snake": WORD,
        "stagger: 5 mm": LENGTH,
        "turn: 90 deg": ANGLE,
        "without: [[2, 2, 2]]": (
            *("abc", "1", "[1, 1]", "[[1]]", "[[3, 1]]", "[[1, 3]]", "[[1, 1, 3]]", "[[0, 1]]"),
            *("[[1, 1, 1, 1]]", "[[1, 1], [1, 2], [2, 1], [2, 2]]", "{a: 1}", "[[a, b]]"),
        ),
        "xy: 3 mm": POSITIVE,
        "z: 1 mm": POSITIVE,
        "yaw: 1 deg": WITHIN,
        "    symmetry: 2": (*COUNT[:-1], "400", "23"),
        "symmetry: 3": (*COUNT[:-1], "400"),
        "distance: 50 mm": POSITIVE,
        "direction: [0, 0, 1]": DIRECTION,
        "in: tool": ("tol", "1", "[tool]", "{a: 1}", "true"),
        "retract: 40 mm": POSITIVE,
        "width: 40 mm": (*POSITIVE, "0"),
        "opening: [10 mm, 60 mm]": (*LENGTHS, "[60 mm, 60 mm]", "[-1 mm, 1 mm]", "[2, 1]"),
        "tilt: 15 deg": (*WITHIN, "61 deg"),
        "turn: yaw": WORD[:-1],
        "area: [20 mm, 10 mm]": (*LENGTHS, "[0, 1 mm]", "[1 mm, -1 mm]"),
        "xyz: [0, 0, 80 mm]": ("abc", "1", "[0, 0]", "[0, 0, 1 kg]", "{a: 1}"),
        "rpy: [180 deg, 0, 0]": ("abc", "1", "[0, 0]", "[0, 0, 1 mm]", "{a: 1}"),
        "quat: [0, 0, 0, 1]": ("abc", "[0, 0, 1]", "[0, 0, 0, 2]", "[0, 0, 0, a]"),
    },
    "tasks.yaml": {
        "cycle_time: 30 s": ("abc", "-1 s", "1 mm", "[1]", "0"),
        "cycle: 95%": ("abc", "95", "99%", "[worst]", "6 s"),
        "gripper: [80 ms, 120 ms, 200 ms]": TIME,
        "settle: 30 ms": TIME,
        "handshake: [0, 5 ms, 10 ms]": TIME,
        "grasp: [top, side]": ("tip", "[top, top]", "[top, tip]", "1", "{a: 1}", "[]", "[1]"),
        "x: [1, 2]": (*PAIR, "[3, 4]"),
        "y: [1, 2]": (*PAIR, "[3, 4]"),
        "layer: [2, 2]": (*PAIR, "[3, 3]"),
        "first: 2": (*COUNT, "4"),
        "order: columns": WORD,
        "distance: 60 mm": POSITIVE,
        "turn: yaw": WORD[:-1],
        "tilt: 12 deg": (*WITHIN, "61 deg"),
        "area: [30 mm, 20 mm]": (*LENGTHS, "[0, 1 mm]", "[1 mm, -1 mm]"),
        "direction: [0, 0.6, 0.8]": DIRECTION,
        "in: world": ("word", "trays", "1", "[world]", "{a: 1}", "true", '""'),
        "varies: 1 mm": (*(v for v in POSITIVE if v != "[1, 2, 3, 4]"), "0", "{}", "{x: 1 mm}"),
        "at: tray": ("trai", "bin", "1", "[tray]"),
        "each: list.csv": ("list2.csv", "places", "1", "[1, 2]", "{x: 1}", "../list.csv"),
        "part: block": ("1", "[block]", "{a: 1}"),
    },
}
"""Wrong values by file and line."""
KEYS = {
    "cell.yaml": (
        *("count:", "pitch:", "layers:", "layer_height:", "order:", "stagger:", "turn: 90"),
        *("without:", "varies:", "xy:", "grid:", "    symmetry: 2", "grasps:", "symmetry: 3"),
        *("width:", "opening:"),
        *(
            "approach:",
            "distance:",
            "direction:",
            "in: tool",
            "retract:",
            "free:",
            "turn: yaw",
            "tilt:",
            "area:",
            "rpy:",
            "quat:",
        ),
    ),
    "tasks.yaml": (
        *("cycle:", "gripper:", "settle:", "handshake:", "grasp:", "x: [1, 2]", "y: [1, 2]"),
        *("layer:", "first:", "order:", "varies:", "at: tray", "distance:", "direction:"),
        *("in: world", "retract:", "free:", "turn:", "tilt:", "area:"),
    ),
}
"""Lines whose key is misspelled, by file."""
CELLS: dict[str, tuple[str, ...]] = {
    "id,part,x [mm]": ("ids,part,x [mm]", "id,id,x [mm]", "id,part,x [kg]", "id,part,w"),
    "a,block,100": ("a,block,abc", "a,block,1,100", "a,100", "a,block,1 kg"),
    "b,block,200": ("a,block,200", "b,block,nan", "b,block,true"),
    "block,200": ("blok,200", "block@top,200"),
    "0.1,20": ("0.1,20 mm", "0.1,x", "0.1 deg,20", "0.1,20,30", "9999,20"),
}
"""Wrong cells of the list, by their text."""
REMEDY = re.compile(
    r"\b(must|allowed|give|write|remove|keep|choose|select|lower|at most|at least|did you mean|missing|needs?|"
    r"is not one of|not one of|name|names|outside the range|there is no file|"
    r"leave out|make|widen|change|use|it has|units?|duplicate|has no|too)\b",
    re.IGNORECASE,
)
"""Words that say what is allowed, or what to do."""


def mutants() -> Iterator[tuple[str, str, str]]:
    """Yield file, text and its replacement."""
    for file, lines in VALUES.items():
        for line, values in lines.items():
            key = line.partition(":")[0]
            yield from ((file, line, f"{key}: {value}") for value in values)
    for file, keys in KEYS.items():
        for line in keys:
            key, colon, rest = line.partition(":")
            yield file, line, f"{key[:-1] or key}{key[-1] * 2}{colon}{rest}"
    for text, cells in CELLS.items():
        yield from (("list.csv", text, cell) for cell in cells)


MUTANTS = list(mutants())


FILES = {"cell.yaml": CELL, "tasks.yaml": TASKS, "list.csv": LIST}


def test_the_files_are_good_and_the_mutants_many(project: Path) -> None:
    """Otherwise every mutant would be refused for the same reason."""
    for name, text in FILES.items():
        (project / name).write_text(text)
    assert len(load_job("tasks.yaml").tasks) == 3
    assert len(MUTANTS) == len(set(MUTANTS)) >= 300


@pytest.mark.parametrize(("file", "old", "new"), MUTANTS)
def test_a_mutant_is_refused_at_its_line(
    project: Path, messages: Callable[..., list[str]], file: str, old: str, new: str
) -> None:
    """One or more messages, the first at the line of the change."""
    for name, text in FILES.items():
        (project / name).write_text(text)
    text = FILES[file]
    assert text.count(old) == 1, old
    (project / file).write_text(text.replace(old, new))
    line = text[: text.index(old)].count("\n") + 1
    found = messages(lambda: load_job("tasks.yaml"))
    assert any(message.startswith(f"{file}:{line}:") for message in found), found
    assert all(REMEDY.search(message) for message in found), found
