"""What `dualarm score` takes for many cells: one process, two, and once more with nothing changed.

    python -m benchmarks.speed.scoring [CELLS]

Cells are variations of a small one with four moves, planned as `dualarm plan --effort quick` does, each with files of
its own. Printed are seconds and their ratios; with two free
cores the second figure is to be at most 0.6 of the first one, and a score of 100 cells with nothing changed is to take
2 s at most. The exit code says whether both hold.
"""

from __future__ import annotations

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
MOST_RATIO, LONGEST_AGAIN = 0.6, 2.0
CELL = "dualarm: cell/1\nrobot: ../../robots/planar/robot.yaml\n"
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
return: true
tasks:
  - {{id: P1, arm: left, move: {{xyz: [80 mm, {0:g} mm, 0], rpy: [180 deg, 0, 0], free: yaw}}}}
  - {{id: P2, arm: right, move: {{xyz: [50 mm, 100 mm, 0], rpy: [180 deg, 0, 0], free: yaw}}}}
  - {{id: P3, arm: left, move: {{xyz: [60 mm, {0:g} mm, 0], rpy: [180 deg, 0, 0], free: yaw}}}}
  - {{id: P4, arm: right, move: {{xyz: [70 mm, 80 mm, 0], rpy: [180 deg, 0, 0], free: yaw}}}}
"""


def make_cells(folder: Path, count: int) -> None:
    """Writes a project of cells, each a little other than the one before."""
    (folder / "dualarm.toml").touch()
    shutil.copytree(ROOT / "robots" / "bottin_planar", folder / "robots" / "planar")
    for number in range(count):
        place = folder / "cells" / f"{number:03d}"
        place.mkdir(parents=True)
        (place / "cell.yaml").write_text(CELL)
        (place / "tasks.yaml").write_text(TASKS.format(10.0 + 0.05 * number))


def score(folder: Path, *arguments: str) -> tuple[float, float]:
    """Scores the cells in a process of its own; returns how long that takes and what all processes work [s]."""
    words = ["score", "cells/**/tasks.yaml", "--effort", "quick", "--quiet"]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    }
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begin = time.perf_counter()
    subprocess.run(
        [sys.executable, "-m", "dualarm_cli", *words, *arguments],
        cwd=folder,
        env=environment,
        check=True,
    )
    taken = time.perf_counter() - begin
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return taken, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main() -> int:
    """Measures, prints, and returns 0 if both bounds hold."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_cells(folder, count)
        # Compiled bytecode and the disk's own cache are there for all that follow.
        score(folder, "--no-cache", "--subset", "--baseline", "b.json", "--update-baseline")
        one, work_of_one = score(folder, "--no-cache", "--jobs", "1")
        two, work_of_two = score(folder, "--cache", "answers", "--jobs", "2")
        again = min(score(folder, "--cache", "answers")[0] for _ in range(3))
        held, _ = score(folder, "--cache", "answers", "--baseline", "b.json")
    print(f"{count} cells: one process {one:.1f} s, two {two:.1f} s: {two / one:.2f} of it")
    print(f"processors' time: one process {work_of_one:.1f} s, two {work_of_two:.1f} s")
    print(f"nothing changed: {again:.2f} s; with a baseline {held:.2f} s")
    good = two <= MOST_RATIO * one and max(again, held) <= LONGEST_AGAIN
    print("good" if good else "NOT within the bounds (are two cores free?)")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
