"""Whole commands: start-up of `--help` and `plan` of 24 stages, as a user waits for them.

Run with the installed command on the path: python benchmarks/plan.py [--command dualarm]
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

PACKING = Path(__file__).parent.parent / "tasks" / "04_packing" / "tasks.yaml"


def least_time(command: list[str], repeats: int) -> float:
    """Least wall time of a command [s]; it must succeed."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        times.append(time.perf_counter() - begin)
    return min(times)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--command", default="dualarm")
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    bare = least_time([sys.executable, "-c", "pass"], arguments.repeats)
    with tempfile.TemporaryDirectory() as folder:
        plan = [arguments.command, "plan", str(PACKING), "--out", folder, "--force", "--quiet"]
        rows = {
            "bare python": bare,
            "dualarm --help": least_time([arguments.command, "--help"], arguments.repeats),
            "dualarm plan, 24 stages, every platform solver": least_time(plan, arguments.repeats),
            "dualarm plan, 24 stages, --platform exact": least_time(
                [*plan, "--platform", "exact"], arguments.repeats
            ),
        }
    for name, seconds in rows.items():
        print(f"{name:48s} {seconds:7.3f} s   {seconds / bare:7.1f} x bare python")


if __name__ == "__main__":
    main()
