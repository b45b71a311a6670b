"""What motion of joints while tools dwell, or of the platform while they are on lines, saves, by the command itself.

python benchmarks/dwell_motion.py --sequences 6 --stages 24 --effort quick
python benchmarks/dwell_motion.py --keys line_motion --dwells 0.15

Random sequences of `long_sequences.py` on the SDA10F, lines of 80 mm, dwells of 0.15 s and 0.5 s, as it is and with a
platform of a quarter of the speed, acceleration and jerk: `dualarm plan` without and with `dwell_motion: allowed`, or
what `--keys` says.
Every plan is verified with its clearance by the command. Printed are both cycle times, the gain that the plan states,
and medians and extremes of the shares. Sequences that have no plan are left out, and named.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from long_sequences import write_sequence

ROBOT = Path(__file__).parents[1] / "robots" / "sda10f"
LIMITS = {"acceleration": 7.6, "jerk": 76.0}
"""Of the platform of the SDA10F [rad/s², rad/s³]; its speed is in the URDF."""
SPEED = re.compile(r'(<joint name="torso_b1".*?velocity=")([^"]*)(")', re.DOTALL)
DWELLS = (0.15, 0.5)
"""Of every pick and place [s], unless `--dwells` says otherwise."""
PLATFORMS = {"SDA10F": 1.0, "platform with a quarter of the speed": 4.0}
"""By how much the platform is slower."""


def write_job(folder: Path, seed: int, stages: int, dwell: float, slower: float) -> Path:
    """Writes a random sequence and its robot; returns the task file."""
    write_sequence("sda10f", stages, seed, folder)
    shutil.copytree(ROBOT, folder / "robot")
    robot = folder / "robot" / "robot.yaml"
    own = ", ".join(f"{name}: {value / slower}" for name, value in LIMITS.items())
    lines = robot.read_text(encoding="utf-8").splitlines()
    lines = [
        f"  torso_b1: {{{own}, source: assumed}}" if line.startswith("  torso_b1:") else line
        for line in lines
    ]
    robot.write_text("\n".join(lines), encoding="utf-8")
    urdf = folder / "robot" / "sda10f.urdf"
    text, count = SPEED.subn(
        lambda found: f"{found[1]}{float(found[2]) / slower}{found[3]}",
        urdf.read_text(encoding="utf-8"),
    )
    assert count == 1
    urdf.write_text(text, encoding="utf-8")
    cell = json.loads((folder / "cell.yaml").read_text(encoding="utf-8"))
    cell["robot"] = "robot/robot.yaml"
    (folder / "cell.yaml").write_text(json.dumps(cell), encoding="utf-8")
    tasks = folder / "tasks.yaml"
    document = json.loads(tasks.read_text(encoding="utf-8"))
    document["defaults"]["dwell"] = dwell
    tasks.write_text(json.dumps(document), encoding="utf-8")
    return tasks


def planned(tasks: Path, permissions: dict[str, str], effort: str) -> dict[str, Any] | None:
    """Returns the report of `dualarm plan` with some keys in the defaults, None where there is no plan.

    Raises:
        AssertionError: the command does not pass its plan.
    """
    document = json.loads(tasks.read_text(encoding="utf-8"))
    own = tasks.with_name("own.yaml")
    document["defaults"] |= permissions
    own.write_text(json.dumps(document), encoding="utf-8")
    out = tasks.parent / "out"
    options = ["--out", str(out), "--force", "--effort", effort, "--quiet"]
    command = [sys.executable, "-m", "dualarm_cli", "plan", str(own), *options]
    code = subprocess.run(command, check=False, capture_output=True).returncode
    if code == 3:
        return None
    assert code == 0, f"exit code {code} of {' '.join(command)}"
    report: dict[str, Any] = json.loads((out / "report.json").read_text(encoding="utf-8"))
    assert report["smallest_clearance"] is not None
    return report


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--sequences", type=int, default=6)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--stages", type=int, default=24)
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--keys", nargs="*", default=["dwell_motion"])
    parser.add_argument("--dwells", nargs="*", type=float, default=DWELLS)
    arguments = parser.parse_args()
    permissions = dict.fromkeys(arguments.keys, "allowed")
    for name, slower in PLATFORMS.items():
        for dwell in arguments.dwells:
            rows = []
            for seed in range(arguments.first, arguments.first + arguments.sequences):
                with tempfile.TemporaryDirectory() as folder:
                    tasks = write_job(Path(folder) / "job", seed, arguments.stages, dwell, slower)
                    without = planned(tasks, {}, arguments.effort)
                    found = planned(tasks, permissions, arguments.effort)
                if without is None or found is None:
                    print(f"{name}, dwells of {dwell} s, seed {seed}: no plan", flush=True)
                    continue
                cycles = without["cycle_time"], found["cycle_time"]
                gain = found["motion_gain"]
                rows.append((1.0 - cycles[1] / cycles[0], gain / (cycles[1] + gain)))
                print(
                    f"{name}, dwells of {dwell} s, seed {seed}: {cycles[0]:.3f} s without, {cycles[1]:.3f} s with it, "
                    f"of which by motion {gain:.3f} s",
                    flush=True,
                )
            if rows:
                whole, own = 100.0 * np.array(rows).T
                print(
                    f"{name}, dwells of {dwell} s: cycle {np.median(whole):.2f} % shorter ({whole.min():.2f} to "
                    f"{whole.max():.2f}), by motion {np.median(own):.2f} % ({own.min():.2f} to {own.max():.2f})",
                    flush=True,
                )


if __name__ == "__main__":
    main()
