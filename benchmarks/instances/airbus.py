"""Drilling the Airbus Shopfloor Challenge's 245 holes with both arms of an SDA10F, as a job.

python -m benchmarks.instances.airbus --out FOLDER [--arm split] [--order given] [--mode free]

The pattern is that of RoboTSP's example (github.com/crigroup/robotsp, BSD-3): pitch 25 mm, tool along +x, any turn
about it. There it is drilled by one arm in the plane x = 0.57 m; here the pattern as a whole is shifted to where both
arms of this robot reach most of it. RoboTSP's published 78.6 s are another robot's; only the geometry compares.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.instances.job_files import numbers, write_job

FloatArray = NDArray[np.float64]
PITCH = 0.025
"""Distance of neighbouring holes [m]."""
PLANE = 0.57
"""Where the holes are along x in the original [m]."""
BLOCKS = ((0.570, 0.050, 8), (0.370, -0.225, 19), (0.170, -0.225, 8))
"""Blocks of seven rows: z of the lowest row, y of the first column [m], number of columns."""
ROWS = 7
SHIFT = (0.18, 0.0, 0.75)
"""What is added to the original's positions [m]. With the torso at 0 and the tool of `TOOL`, target and start of the
approach, each arm reaches all holes within its joint limits but the 14 of the other side's last column: 231, both 217,
and the arm of its own side every hole. On a grid of 3 cm along x and 5 cm along z no shift gives more."""
SHORTEST_TOUR = 6.2309
"""Shortest closed tour through all holes in the plane [m]; an exact solver's, of the original."""
TOOL = (
    "{tcp: {xyz: [0, 0, 150 mm]}, mass: 1.5 kg, "
    "shapes: [{capsule: {radius: 25 mm, length: 70 mm}, xyz: [0, 0, 60 mm]}]}"
)
CELL = """\
# Drilling spindles, 150 mm from flange to tip; the last 30 mm, the drill, have no shape. Behind the holes is the panel.
robot: sda10f
tools:
  left:  {tool}
  right: {tool}
obstacles:
  panel: {{box: [20 mm, 600 mm, 700 mm], xyz: {panel}}}
clearance: 10 mm
"""


def holes() -> FloatArray:
    """Returns the original's holes [m], shape (245, 3): rows from the top, in turn from either side."""
    found = []
    for z, y, columns in BLOCKS:
        for row in reversed(range(ROWS)):
            line = [(PLANE, y + PITCH * k, z + PITCH * row) for k in range(columns)]
            found += line if row % 2 == 0 else line[::-1]
    return np.round(np.array(found), 6)


def write_instance(
    folder: Path, arm: str = "any", order: str = "optimise", mode: str = "paired"
) -> Path:
    """Returns the task file after writing the job.

    Args:
        folder: where.
        arm: any, or split: the left arm drills where y is not negative, the right one the rest.
        order: optimise, or given: row by row.
        mode: paired or free.
    """
    targets = np.round(holes() + SHIFT, 6)
    tasks = (
        "# 245 holes of the Airbus Shopfloor Challenge after crigroup/robotsp (BSD-3), the pattern shifted by\n"
        f"# {numbers(SHIFT)} m. Approach, retract and 0.2 s of drilling are assumed: none is published.\n"
        f"mode: {mode}\norder: {order}\nstart: home\nreturn: true\ntasks:\n"
    )
    for k, target in enumerate(targets, 1):
        side = arm if arm == "any" else "left" if target[1] >= 0.0 else "right"
        tasks += (
            f"  - {{id: hole-{k:03d}, arm: {side}, approach: 20 mm, retract: 20 mm, dwell: 0.2 s,\n"
            f"     move: {{xyz: {numbers(target)}, rpy: [0, 90 deg, 0], free: yaw}}}}\n"
        )
    panel = np.round((targets.min(axis=0) + targets.max(axis=0)) / 2.0 + [0.01, 0.0, 0.0], 6)
    cell = CELL.format(tool=TOOL, panel=numbers(panel))
    return write_job(folder, tasks=tasks, cell=cell)


def main() -> None:
    """Writes the job."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", type=Path, default=Path("airbus"), help="folder of the job")
    parser.add_argument("--arm", choices=("any", "split"), default="any")
    parser.add_argument("--order", choices=("optimise", "given"), default="optimise")
    parser.add_argument("--mode", choices=("paired", "free"), default="paired")
    arguments = parser.parse_args()
    print(write_instance(arguments.out, arguments.arm, arguments.order, arguments.mode))


if __name__ == "__main__":
    main()
