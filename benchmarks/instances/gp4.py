"""Two Yaskawa GP4 that build with bricks: two of APEX-MR's assemblies as jobs.

python -m benchmarks.instances.gp4 cliff --out FOLDER [--mode free] [--bare]
python -m benchmarks.instances.gp4 --import FILE_steps.csv

An original file has a row per step: for robot 1 and robot 2 a flag, the flange's pose, and six joints. The flag says
whether the step is that robot's; a robot that supports its partner also moves in steps that are not its own, so the
flag is left aside and every change of joints counts. The second form makes the data of ours, a line per change, from an
original file of github.com/intelligent-control-lab/APEX-MR (MIT).
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.instances.job_files import DATA, accelerations, numbers, posture, write_job
from benchmarks.instances.moves import rest_to_rest_times

FloatArray = NDArray[np.float64]
FOLDER = DATA / "gp4"
SIDES = ("left", "right")
"""Our arms: APEX-MR's robot 1 and robot 2."""
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
COLUMNS = (*JOINTS, "x", "y", "z", "qx", "qy", "qz", "qw")
VELOCITY = (465, 465, 525, 565, 565, 1000)
"""Largest speeds [deg/s]."""
ACCELERATION = tuple(10 * v for v in VELOCITY)
"""Largest accelerations [deg/s²], assumed: full speed in 0.1 s. None is published."""
SPEED_SUMS = {"cliff": (3.950, 5.826, 9.773), "fish_high": (12.981, 14.457, 27.427)}
"""Sums of the steps' times at full speed [s], of either arm alone and step by step together; our own computation."""
TURN = np.arctan2(0.00573983, -0.99998353)
BASES = {"left": ((0, 0, 1.2546), 0.0), "right": ((0.88101137, -0.01304334, 1.2546), TURN)}
"""Places [m] and turns about z [rad]; 1.2546 m: table 0.9246 m, shoulder 0.33 m above it."""
ROWS = (
    "alpha: -1.57079632679, lower: -170 deg, upper: 170 deg",
    "theta: -1.57079632679, a: 260 mm, alpha: 3.1415926, lower: -110 deg, upper: 130 deg",
    "a: 15 mm, alpha: -1.57079632679, lower: -65 deg, upper: 200 deg",
    "d: -290 mm, alpha: 1.57079632679, lower: -200 deg, upper: 200 deg",
    "alpha: -1.57079632679, lower: -123 deg, upper: 123 deg",
    "d: -72 mm, alpha: 3.1415926, lower: -455 deg, upper: 455 deg",
)
RADII = (70, 60, 60, 50, 45, 35)
"""Invented radii of the links' capsules [mm]."""
ROBOT = """\
# Yaskawa GP4 after the table in intelligent-control-lab/APEX-MR (MIT), frame 0 in the shoulder: angles as printed
# there, so pi has eight digits. Ranges: ros-industrial/motoman (BSD), whose joints turn the same way. Accelerations are
# assumed (full speed in 0.1 s), jerk is not limited, no grippers. Shapes, where there are any, are invented capsules.
name: Yaskawa GP4
"""


@dataclass(frozen=True)
class Steps:
    """Steps of one assembly: row k is where both arms are after step k, row 0 where they begin."""

    q: dict[str, FloatArray]
    """Joints by arm [rad], each of shape (n, 6)."""
    poses: dict[str, FloatArray]
    """Flanges in the world by arm [m, quaternion x y z w], each of shape (n, 7)."""


def read_steps(name: str) -> Steps:
    """Returns an assembly kept here."""
    with (FOLDER / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        lines = list(csv.DictReader(file))
    count = 1 + max(int(line["step"]) for line in lines)
    values = {side: np.full((count, len(COLUMNS)), np.nan) for side in SIDES}
    for line in lines:  # in the order of steps: what follows is where the arm stays until told
        row = [float(line[column]) for column in COLUMNS]
        values[line["arm"]][int(line["step"]) :] = row
    return Steps(
        {side: np.radians(v[:, :6]) for side, v in values.items()},
        {side: v[:, 6:] for side, v in values.items()},
    )


def import_steps(path: Path) -> Path:
    """Returns the file of ours that it makes from an original one: nine decimals, a line per change of joints.

    The last step is kept for both arms, so that the number of steps is.
    """
    with path.open(encoding="utf-8", newline="") as file:
        table = np.array([[float(word) for word in row] for row in csv.reader(file)])
    lines = []
    for k, row in enumerate(table):
        for side, values in zip(SIDES, (row[:14], row[14:]), strict=True):
            first = 0 if side == "left" else 14
            still = k > 0 and np.array_equal(values[8:], table[k - 1, first + 8 : first + 14])
            if not still or k == len(table) - 1:
                ordered = [*values[8:], *values[1:8]]
                lines.append(
                    [str(k), side, *(f"{round(value, 9) + 0.0:.10g}" for value in ordered)]
                )
    FOLDER.mkdir(parents=True, exist_ok=True)
    made = FOLDER / f"{path.stem.removesuffix('_steps')}.csv"
    with made.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([["step", "arm", *COLUMNS], *lines])
    return made


def step_sums(steps: Steps, acceleration: FloatArray | float) -> tuple[float, float, float]:
    """Returns the sums of the steps' times [s]: left alone, right alone, step by step together.

    Args:
        steps: the assembly.
        acceleration: largest accelerations [rad/s²], inf for steps at full speed throughout.
    """
    top = np.radians(VELOCITY)
    left, right = (
        rest_to_rest_times(np.diff(steps.q[side], axis=0), top, acceleration) for side in SIDES
    )
    return float(left.sum()), float(right.sum()), float(np.maximum(left, right).sum())


def write_instance(name: str, folder: Path, mode: str = "paired", *, bare: bool = False) -> Path:
    """Returns the task file of an assembly after writing its job.

    Args:
        name: one of `SPEED_SUMS`.
        folder: where.
        mode: paired: a stage per step, also for an arm that stays; free: each arm has its own moves only.
        bare: whether the links have no shapes, so that the arms need not be clear of each other.
    """
    steps = read_steps(name)
    return write_job(
        folder, tasks=_tasks(name, steps, mode), cell=_cell(), robot=_robot(steps, bare)
    )


def _robot(steps: Steps, bare: bool) -> str:
    home = steps.q["left"][0]
    if not np.array_equal(home, steps.q["right"][0]):
        raise SystemExit("both arms must begin in the same posture")
    rows = []
    for joint, row, velocity, radius in zip(JOINTS, ROWS, VELOCITY, RADII, strict=True):
        body = "" if bare else f", radius: {radius} mm"
        rows.append(f"    - {{joint: {joint}, {row}, velocity: {velocity} deg/s{body}}}\n")
    text = (
        f"{ROBOT}dh:\n  left:\n{''.join(rows)}arms: {{left: {{kind: spherical_wrist}}}}\nlimits:\n"
    )
    text += accelerations(JOINTS, [f"{limit} deg/s^2" for limit in ACCELERATION])
    text += f"postures:\n  home: {posture(JOINTS, home)}\n"
    if not bare:
        text += "allowed_contacts:     # upper arm and forearm meet in the elbow, forearm and hand in the wrist\n"
        text += "  - [joint_2_link, joint_4_link]\n  - [joint_4_link, joint_6_link]\n"
    return text


def _cell() -> str:
    bases = [
        f"  {side}: {{robot: robot.yaml, base: {{xyz: {numbers(p)}, rpy: {numbers((0, 0, turn))}}}}}\n"
        for side, (p, turn) in BASES.items()
    ]
    return "robot:\n" + "".join(bases)


def _tasks(name: str, steps: Steps, mode: str) -> str:
    text = (
        f"# {name} of intelligent-control-lab/APEX-MR (MIT): every step's joints of both arms, in its order.\n"
        f"mode: {mode}\norder: given\nstart: home\ntasks:\n"
    )
    for k in range(1, len(steps.q["left"])):
        for side in SIDES:
            q = steps.q[side]
            if mode == "paired" or not np.array_equal(q[k], q[k - 1]):
                text += (
                    f"  - {{id: {side}-{k:03d}, arm: {side}, move: {{joints: {numbers(q[k])}}}}}\n"
                )
    return text


def main() -> None:
    """Writes a job, or makes the data of ours from original files."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name", nargs="?", choices=SPEED_SUMS)
    parser.add_argument("--out", type=Path, help="folder of the job")
    parser.add_argument("--mode", choices=("paired", "free"), default="paired")
    parser.add_argument("--bare", action="store_true", help="links without their invented shapes")
    parser.add_argument("--import", dest="originals", type=Path, nargs="+", metavar="FILE.csv")
    arguments = parser.parse_args()
    for path in arguments.originals or ():
        print(import_steps(path))
    if arguments.name is not None:
        folder = arguments.out or Path(arguments.name)
        print(write_instance(arguments.name, folder, arguments.mode, bare=arguments.bare))
    elif not arguments.originals:
        parser.error("name an assembly, or files to import")


if __name__ == "__main__":
    main()
