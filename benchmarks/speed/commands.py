"""How long whole commands take, from their start to their files, and what `plan --watch` needs after a change.

python -m benchmarks.speed.commands

A study of 100 points of a job with eight picks, plans by both arms from one bin, `why`, and a watched plan whose task
file changes. Processor time is that of all processes of a command.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.tables import print_head, print_row

HERE = Path(__file__).resolve().parents[2]
ENVIRONMENT = os.environ | {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "PYTHONPATH": str(HERE),
}
STUDY = {
    "dualarm": "study/1",
    "tasks": "tasks/04_packing/first_parts.yaml",
    "settings": {"effort": "quick"},
    "parameters": {
        "gripper": {
            "targets": [{"tasks": "defaults.dwell.gripper"}],
            "range": {"from": "80 ms", "to": "170 ms", "step": "10 ms"},
        },
        "lines": {
            "targets": [{"tasks": "defaults.approach"}, {"tasks": "defaults.retract"}],
            "range": {"from": "40 mm", "to": "85 mm", "step": "5 mm"},
        },
    },
}
"""A study of ten by ten points."""
WAIT = 0.005
"""Time between looks at the files of a watched plan [s]."""
LONGEST = 120.0
"""When waiting for a plan is given up [s]."""


def command(words: str) -> list[str]:
    """Returns the arguments of a process that is one `dualarm` command."""
    return [sys.executable, "-m", "dualarm_cli", *words.split()]


def timed(words: str, folder: Path) -> tuple[str, str]:
    """Returns wall and processor time of a command in a folder, as the table has them.

    Raises:
        subprocess.CalledProcessError: the command fails.
    """
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(
        command(words), cwd=folder, env=ENVIRONMENT, stdout=subprocess.DEVNULL, check=True
    )
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return f"{wall:.1f} s", f"{used:.1f} s"


def watched(folder: Path) -> tuple[str, str]:
    """Returns how long the first plan of a watched job takes, and the one after a change of its file."""
    tasks, report = folder / "tasks" / "04_packing" / "tasks.yaml", folder / "watched/report.json"
    words = f"plan {tasks} --effort quick --out watched --watch"
    begin = time.perf_counter()
    process = subprocess.Popen(
        command(words),
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        first = _written(report, 0.0) - begin
        stamp = report.stat().st_mtime
        time.sleep(1.0)
        begin = time.perf_counter()
        text = tasks.read_text(encoding="utf-8")
        tasks.write_text(text.replace("80 mm", "79 mm"), encoding="utf-8")
        return f"{first:.1f} s", f"{_written(report, stamp) - begin:.1f} s"
    finally:
        process.terminate()
        process.wait()


def _written(report: Path, stamp: float) -> float:
    """Waits for a report that is newer than a stamp, and returns when it was there [s].

    Raises:
        TimeoutError: there is none after LONGEST.
    """
    end = time.perf_counter() + LONGEST
    while time.perf_counter() < end:
        if report.exists() and report.stat().st_mtime > stamp:
            return time.perf_counter()
        time.sleep(WAIT)
    raise TimeoutError(f"{report} is not written")


def main() -> None:
    """Prints the tables."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copytree(HERE / "tasks", folder / "tasks")
        (folder / "study.yaml").write_text(json.dumps(STUDY), encoding="utf-8")
        bin_tasks = folder / "tasks" / "06_shared_bin" / "tasks.yaml"
        text = bin_tasks.read_text(encoding="utf-8")
        free = bin_tasks.with_name("free.yaml")
        free.write_text(text.replace("mode: paired", "mode: free"), encoding="utf-8")
        rows = {
            "`sweep`, 100 points of eight picks": "sweep study.yaml --out study",
            "`plan`, 24 picks from one bin": f"plan {bin_tasks} --effort quick --out a",
            "the same, `mode: free`": f"plan {free} --effort quick --out b",
            "`plan 04_packing`, quick": "plan 04_packing --effort quick --out c",
            "`why` of it": "why c",
            "`plan 13_hand_over`, quick": "plan 13_hand_over --effort quick --out d",
            "`why` of that": "why d",
        }
        print_head("command", "wall", "processor time")
        for what, words in rows.items():
            print_row(what, *timed(words, folder))
        first, after = watched(folder)
        print_row("`plan --watch 04_packing`, quick, first plan", first, "")
        print_row("the same, after a change of its lines", after, "")


if __name__ == "__main__":
    main()
