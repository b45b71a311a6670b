"""Two UR5 side by side: planning in closed form against numeric inverse kinematics, and the lower bound.

python -m benchmarks.quality.ur_pair [--free-yaw] [--waist]

Writes robot, cell and tasks (twelve picks, synchronous stages), plans them by the command line with the arms as `kind:
parallel_axes` and as `kind: general`, and prints cycle time, lower bound and processor time.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.tables import print_head, print_row

QUARTER = 1.5707963267948966
LINKS = (
    ("0 0 0.089159", "0 0 0", "0 0 1", 2.0, 3.15, ("0 0.07 0", f"{QUARTER} 0 0", 0.06, 0.10)),
    ("0 0.13585 0", f"0 {QUARTER} 0", "0 1 0", 2.0, 3.15, ("0 0 0.2125", "0 0 0", 0.055, 0.425)),
    ("0 -0.1197 0.425", "0 0 0", "0 1 0", 1.0, 3.15, ("0 0 0.18", "0 0 0", 0.05, 0.3)),
    (
        "0 0 0.39225",
        f"0 {QUARTER} 0",
        "0 1 0",
        2.0,
        3.2,
        ("0 0.07 0", f"{QUARTER} 0 0", 0.045, 0.08),
    ),
    ("0 0.093 0", "0 0 0", "0 0 1", 2.0, 3.2, ("0 0 0.06", "0 0 0", 0.045, 0.07)),
    ("0 0 0.09465", "0 0 0", "0 1 0", 2.0, 3.2, ("0 0.05 0", f"{QUARTER} 0 0", 0.04, 0.03)),
)
"""Of the UR5's URDF: place in the parent, its rotation, axis, limits [pi rad], speed [rad/s]; and a capsule along z
around the link: its place, rotation, radius and length [m]."""
HOME = (0.0, -1.9, 1.9, -1.57, -1.57, 0.0)
"""Start posture [rad]."""
SPACE = 0.8
"""Distance of the two bases [m]."""


def urdf(waist: bool) -> str:
    """Returns both arms on one table, or on a waist that turns."""
    joint = "revolute" if waist else "fixed"
    parts = [
        f'<robot name="ur5_pair"><link name="table"/><link name="chest"/><joint name="waist" type="{joint}">'
        '<parent link="table"/><child link="chest"/><axis xyz="0 0 1"/>'
        '<limit lower="-2.8" upper="2.8" velocity="2" effort="1"/></joint>'
    ]
    for arm, side in (("left", 1), ("right", -1)):
        parent, origin = "chest", f'xyz="0 {0.5 * side * SPACE} 0"'
        parts.append(
            f'<link name="{arm}_base"/><joint name="{arm}_mount" type="fixed"><parent link="{parent}"/>'
            f'<child link="{arm}_base"/><origin {origin}/></joint>'
        )
        parent = f"{arm}_base"
        for k, (xyz, rpy, axis, turns, speed, (at, turned, radius, length)) in enumerate(LINKS, 1):
            link, limit = f"{arm}_{k}", turns * np.pi
            parts.append(
                f'<link name="{link}"><collision><origin xyz="{at}" rpy="{turned}"/><geometry>'
                f'<capsule radius="{radius}" length="{length}"/></geometry></collision></link>'
                f'<joint name="{arm}_j{k}" type="revolute"><parent link="{parent}"/><child link="{link}"/>'
                f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
                f'<limit lower="{-limit!r}" upper="{limit!r}" velocity="{speed}" effort="1"/></joint>'
            )
            parent = link
        parts.append(
            f'<link name="{arm}_flange"/><joint name="{arm}_end" type="fixed"><parent link="{parent}"/>'
            f'<child link="{arm}_flange"/><origin xyz="0 0.0823 0" rpy="{-QUARTER} 0 0"/></joint>'
        )
    return "".join([*parts, "</robot>"])


def write_job(
    folder: Path, kind: str, picks: int, seed: int, *, free: bool = False, waist: bool = False
) -> Path:
    """Writes robot, cell and tasks; returns the task file.

    Args:
        folder: where to.
        kind: of both arms.
        picks: how many in all, an even number.
        seed: of the targets.
        free: whether picks leave their yaw free.
        waist: whether a platform joint carries both arms.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "dualarm.toml").write_text("")
    (folder / "robot.urdf").write_text(urdf(waist))
    arms = {
        arm: {
            "joints": [f"{arm}_j{k}" for k in range(1, 7)],
            "flange": f"{arm}_flange",
            "kind": kind,
        }
        for arm in ("left", "right")
    }
    home = {f"{arm}_j{k}": q for arm in arms for k, q in enumerate(HOME, 1)}
    robot: dict[str, Any] = {
        "dualarm": "robot/1",
        "name": "Two UR5",
        "urdf": "robot.urdf",
        "arms": arms,
        "limits": {"default": {"acceleration": 8, "jerk": 80, "source": "assumed"}},
        "postures": {"home": home},
    }
    if waist:
        robot["platform"] = ["waist"]
    shape = {"capsule": {"radius": "30 mm", "length": "60 mm"}, "xyz": [0, 0, "60 mm"]}
    tool = {"tcp": {"xyz": [0, 0, "120 mm"]}, "shapes": [shape]}
    cell = {"dualarm": "cell/1", "robot": "robot.yaml", "tools": {"left": tool, "right": tool}}
    random, tasks = np.random.default_rng(seed), []
    for k in range(picks // 2):
        for arm, side in (("left", 1), ("right", -1)):
            pick = [*random.uniform((0.3, 0.2), (0.6, 0.7)), 0.10] * np.array([1, side, 1])
            place = [*random.uniform((-0.3, 0.65), (0.2, 0.85)), 0.15] * np.array([1, side, 1])
            yaws = random.uniform(-np.pi, np.pi, 2)
            poses = [
                {
                    "xyz": [round(float(v), 4) for v in xyz],
                    "rpy": ["180 deg", 0, round(float(yaw), 4)],
                }
                for xyz, yaw in zip((pick, place), yaws, strict=True)
            ]
            if free:
                poses[0]["free"] = "yaw"
            tasks.append({"id": f"{arm}-{k}", "arm": arm, "pick": poses[0], "place": poses[1]})
    line = {"approach": "80 mm", "retract": "80 mm", "dwell": "0.15 s"}
    job = {
        "dualarm": "tasks/1",
        "cell": "cell.yaml",
        "order": "given",
        "return": True,
        "defaults": line,
        "tasks": tasks,
    }
    for name, content in (("robot", robot), ("cell", cell), ("tasks", job)):
        (folder / f"{name}.yaml").write_text(json.dumps(content, indent=1))
    return folder / "tasks.yaml"


def planned(tasks: Path, effort: str) -> tuple[float, float | None, float]:
    """Returns cycle time [s], lower bound [s] and the processor time of the command [s]."""
    out = tasks.parent / "plan"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    command = [sys.executable, "-m", "dualarm_cli", "plan", str(tasks), "--out", str(out)]
    words = [*command, "--force", "--quiet", "--effort", effort]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    report = json.loads((out / "report.json").read_text())
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return report["cycle_time"], report["lower_bound"], spent


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--picks", type=int, default=12)
    parser.add_argument("--jobs", type=int, default=3)
    parser.add_argument("--effort", default="normal")
    parser.add_argument("--free-yaw", action="store_true")
    parser.add_argument("--waist", action="store_true")
    arguments = parser.parse_args()
    print_head("job", "kind", "cycle", "lower bound", "processor time")
    for seed in range(arguments.jobs):
        for kind in ("general", "parallel_axes"):
            with tempfile.TemporaryDirectory() as folder:
                where, free, waist = Path(folder), arguments.free_yaw, arguments.waist
                tasks = write_job(where, kind, arguments.picks, seed, free=free, waist=waist)
                cycle, bound, spent = planned(tasks, arguments.effort)
            told = "none" if bound is None else f"{bound:.3f} s"
            print_row(seed, f"`{kind}`", f"{cycle:.3f} s", told, f"{spent:.1f} s")


if __name__ == "__main__":
    main()
