"""Plan random valid jobs of every kind of work, and judge each plan by `judge.py`, which shares no code with it.

python -m benchmarks.correctness.random_cells --jobs 500 --folder random-cells

The jobs are those of `tests/random_valid_jobs.py`, varied: straight parts of lines shorter than the lines, moves that
tools pass, parts that are carried, wait and lie. Each job is planned by the command at quick effort, verified again
from its files, and judged. Printed are the jobs by outcome, and each one that is unsound or ends otherwise than with a
plan or a refusal.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from random_valid_jobs import write_random_job  # noqa: E402

from benchmarks.correctness.judge import Judge  # noqa: E402

APART = 0.075
"""Least distance between targets of parts, so that no part lies in another one [m]."""


def vary(seed: int, folder: Path) -> str:
    """Vary a random job in its folder; return what was varied."""
    random = np.random.default_rng([seed, 45])
    cell, job = (json.loads((folder / name).read_text()) for name in ("cell.yaml", "tasks.yaml"))
    said = []
    plain = all({"pick", "place", "move"} & task.keys() for task in job["tasks"])
    simple = plain and not {"buffers"} & job.keys() and "conveyors" not in cell
    simple = simple and not any("handover" in task for task in job["tasks"])
    if random.random() < 0.3:
        job["defaults"]["straight"] = 0.02
        said.append("straight")
    if simple and random.random() < 0.3:
        for task in job["tasks"]:
            if "move" in task:
                task["blend"] = 0.02
                said.append("blend")
    if simple and "parts" not in cell and "tool_changes" not in cell and random.random() < 0.4:
        cell["parts"] = {"box": {"shapes": [{"box": [0.03, 0.03, 0.02], "xyz": [0, 0, 0.012]}]}}
    if "parts" in cell and simple:
        _spread(job, random)
        said.append("parts")
    for name, document in (("cell.yaml", cell), ("tasks.yaml", job)):
        (folder / name).write_text(json.dumps(document, indent=1))
    return " ".join(sorted(set(said)))


def _spread(job: dict[str, Any], random: np.random.Generator) -> None:
    """Give parts to picks whose targets, and all others, are apart; move targets a little where that helps."""
    taken: list[np.ndarray] = []
    for task in job["tasks"]:
        apart = True
        for key in ("pick", "place", "move"):
            if key not in task:
                continue
            start = np.array(task[key]["xyz"])
            for _ in range(60):
                xyz = np.round(start + random.uniform(-0.05, 0.05, 3) * [1, 1, 0.3], 4)
                if all(np.linalg.norm(xyz - other) > APART for other in taken):
                    task[key]["xyz"] = xyz.tolist()
                    break
            else:
                apart = False
            taken.append(np.array(task[key]["xyz"]))
        task.pop("part", None)
        if "pick" in task and apart and random.random() < 0.8:
            task["part"] = "box"


def command(*words: str) -> tuple[int, str]:
    """Run the program; return its exit code and what it says on stderr."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "dualarm_cli", *words],
            capture_output=True,
            text=True,
            timeout=600,
        )
    except subprocess.TimeoutExpired:
        return -1, "longer than 600 s"
    return done.returncode, done.stderr


def main() -> None:
    """Plan and judge."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--jobs", type=int, default=500)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path("random-cells"))
    arguments = parser.parse_args()
    outcomes: Counter[str] = Counter()
    for seed in range(arguments.first, arguments.first + arguments.jobs):
        folder = arguments.folder / str(seed)
        folder.mkdir(parents=True, exist_ok=True)
        what = write_random_job(seed, folder)
        what += " " + vary(seed, folder)
        tasks, plan = folder / "tasks.yaml", folder / "plan"
        code, error = command(
            "plan", str(tasks), "--out", str(plan), "--effort", "quick", "--quiet"
        )
        outcome = {0: "planned", 3: "refused"}.get(code, f"exit {code}")
        if code == 0:
            code, error = command("verify", str(plan), "--tasks", str(tasks), "--quiet")
            error = "\n".join([error] * (code != 0) + Judge(plan, tasks).run())
            outcome = "unsound" if error else outcome
        outcomes[outcome] += 1
        if outcome not in ("planned", "refused"):
            print(f"{what}: {outcome}\n{error}", flush=True)
        elif outcome == "refused":
            print(f"{what}: refused: {error.splitlines()[0][:160]}", flush=True)
    print(dict(outcomes))


if __name__ == "__main__":
    main()
