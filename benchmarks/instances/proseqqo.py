"""Pick-and-place sequencing of one 6-axis arm: eight of ProSeqqo's benchmark instances as jobs.

python -m benchmarks.instances.proseqqo test01 --out FOLDER [--order given]
python -m benchmarks.instances.proseqqo --import FILE.seq

An instance is a home configuration, several grasps of every part, and the configurations of one place for all of them.
The cycle: home, then grasp and place of every part in any order, home. The second form makes the data of ours
from an original file of github.com/sztaki-hu/ProSeqqo (Apache-2.0).
"""

from __future__ import annotations

import argparse
import csv
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.instances.job_files import DATA, accelerations, configurations, posture, write_job
from benchmarks.instances.moves import rest_to_rest_times

FloatArray = NDArray[np.float64]
FOLDER = DATA / "proseqqo"
JOINTS = tuple(f"joint_{k}" for k in range(1, 7))
VELOCITY = (2.269, 2.269, 2.269, 3.316, 3.316, 3.316)
"""Largest speeds [rad/s]."""
ACCELERATION = 10.472
"""Largest acceleration of every joint [rad/s²]; jerk is not limited."""
OPTIMA = {
    "test01": 9.492929,
    "test02": 9.876161,
    "test11": 12.325083,
    "test21": 17.229217,
    "test31": 16.989553,
    "test41": 29.890888,
    "test42": 30.806109,
    "test61": 57.294933,
}
"""Least cycle times over order and configurations [s]; exact dynamic programmes over subsets, our own computation."""
ROBOT = """\
# Stands in for the arm of ProSeqqo's instances, whose geometry is not published: only its joints count there. The rows
# are those of a small industrial arm, invented. The ranges hold every configuration, so that none is turned by 2 pi.
# Speeds and accelerations are the instances' own. They have no jerk limit: motion is trapezoidal.
name: 6-axis arm of ProSeqqo's instances
dh:
  left:
    - {{joint: joint_1, alpha: -90 deg, d: 400 mm, {0}}}
    - {{joint: joint_2, a: 450 mm, {1}}}
    - {{joint: joint_3, a: 50 mm, alpha: -90 deg, {2}}}
    - {{joint: joint_4, alpha: 90 deg, d: 450 mm, {3}}}
    - {{joint: joint_5, alpha: -90 deg, {4}}}
    - {{joint: joint_6, d: 80 mm, {5}}}
arms: {{left: {{kind: spherical_wrist}}}}
limits:
"""


@dataclass(frozen=True)
class Instance:
    """Configurations of one instance."""

    home: FloatArray
    """Where the cycle begins and ends [rad], shape (6,)."""
    picks: tuple[FloatArray, ...]
    """Grasps of every part [rad], each of shape (g, 6)."""
    places: FloatArray
    """Configurations of the place [rad], shape (p, 6)."""


def read_instance(name: str) -> Instance:
    """Returns one of the instances kept here."""
    with (FOLDER / f"{name}.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    values = np.array([[float(row[joint]) for joint in JOINTS] for row in rows])
    action = np.array([row["action"] for row in rows])
    part = np.array([int(row["part"] or 0) for row in rows])
    picks = [values[(action == "pick") & (part == k)] for k in range(1, part.max() + 1)]
    return Instance(values[action == "home"][0], tuple(picks), values[action == "place"])


def import_sequence(path: Path) -> Path:
    """Returns the file of ours that it makes from an original one (see the module's first lines).

    Its lists name configurations (`id;[six joints];name`, decimal commas) and then, line by line, which of them serve
    which step of which process: process 4000 is home, every other one a part with a grasp and a place.
    """
    text = path.read_text(encoding="utf-8")
    joints = {
        int(number): [value.replace(",", ".") for value in values.split(";")]
        for number, values in re.findall(r"^(\d+);\[([^\]]*)\];\w", text, re.MULTILINE)
    }
    steps: dict[int, dict[int, list[list[str]]]] = {}
    for words in re.findall(r"^(\d+);\d+;(\d+);\d+;\[(\d+)\]", text, re.MULTILINE):
        process, step, number = map(int, words)
        steps.setdefault(process, {}).setdefault(step, []).append(joints[number])
    (home,), *parts = (list(step.values()) for step in steps.values())
    places = parts[0][1]
    if any(len(part) != 2 or part[1] != places for part in parts):
        raise SystemExit(f"{path}: parts must have a grasp and the same place")
    rows = [["home", "", *home[0]]]
    rows += [["place", "", *place] for place in places]
    rows += [["pick", str(k), *grasp] for k, part in enumerate(parts, 1) for grasp in part[0]]
    FOLDER.mkdir(parents=True, exist_ok=True)
    made = FOLDER / f"{path.stem}.csv"
    with made.open("w", encoding="utf-8", newline="") as file:
        csv.writer(file, lineterminator="\n").writerows([["action", "part", *JOINTS], *rows])
    return made


def write_instance(name: str, folder: Path, order: str = "optimise") -> Path:
    """Returns the task file of an instance after writing its job.

    Args:
        name: one of `OPTIMA`.
        folder: where.
        order: optimise, or given: as the parts are listed.
    """
    instance = read_instance(name)
    limits = [f"lower: -7 rad, upper: 7 rad, velocity: {velocity}" for velocity in VELOCITY]
    robot = ROBOT.format(*limits) + accelerations(JOINTS, [str(ACCELERATION)] * 6)
    robot += f"postures:\n  home: {posture(JOINTS, instance.home)}\n"
    place = configurations(instance.places)
    tasks = (
        f"# {name} of sztaki-hu/ProSeqqo (Apache-2.0): {len(instance.picks)} parts; every grasp and every place is a\n"
        "# choice of joint configurations. Nothing dwells and nothing can touch.\n"
        f"order: {order}\nstart: home\nreturn: true\ntasks:\n"
    )
    for k, grasps in enumerate(instance.picks, 1):
        tasks += f"  - id: part-{k:02d}\n    arm: left\n"
        tasks += f"    pick:  {configurations(grasps)}\n    place: {place}\n"
    return write_job(folder, tasks=tasks, cell="robot: robot.yaml\n", robot=robot)


def given_order_time(instance: Instance) -> float:
    """Returns the least cycle time with the parts in the order given [s]: shortest path, layer by layer."""
    home = instance.home[None]
    layers = [layer for grasps in instance.picks for layer in (grasps, instance.places)]
    at, cost = home, np.zeros(1)
    for layer in [*layers, home]:
        cost = (cost[:, None] + _move_times(at, layer)).min(axis=0)
        at = layer
    return float(cost[0])


def _move_times(start: FloatArray, end: FloatArray) -> FloatArray:
    """Returns the times of the moves from each of configurations (a, 6) to each of (b, 6) [s], shape (a, b)."""
    return rest_to_rest_times(end - start[:, None], np.array(VELOCITY), ACCELERATION)


def main() -> None:
    """Writes a job, or makes the data of ours from original files."""
    parser = argparse.ArgumentParser()
    parser.add_argument("name", nargs="?", choices=OPTIMA)
    parser.add_argument("--out", type=Path, help="folder of the job")
    parser.add_argument("--order", choices=("optimise", "given"), default="optimise")
    parser.add_argument("--import", dest="originals", type=Path, nargs="+", metavar="FILE.seq")
    arguments = parser.parse_args()
    for path in arguments.originals or ():
        print(import_sequence(path))
    if arguments.name is not None:
        folder = arguments.out or Path(arguments.name)
        print(write_instance(arguments.name, folder, arguments.order))
    elif not arguments.originals:
        parser.error("name an instance, or files to import")


if __name__ == "__main__":
    main()
