"""Whole `dualarm plan` commands of this checkout against those of another commit, in one run, one after the other.

python -m benchmarks.speed.planning_time --against COMMIT [--stages 24 100] [--efforts quick normal] [--seeds 1 2 3]
    [--robots sda10f iiwa14] [--jobs tasks/*/tasks.yaml] [--repeats 5] [--cores 2] [--options="--blend none"]

Both are installed into a folder that is removed afterwards, with their pages and compiled functions. Every command is a
process of its own, from its start to its files written. Jobs are those of `long_sequences.py` by robot, stages and
seeds, or the given task files in one row. A job for which the other commit has no plan is left out. A job counts as
longer if its cycle is so by more than a millionth. Gaps are medians of the jobs that have a bound with both.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median

from benchmarks.jobs.long_sequences import ROOMS, write_sequence
from benchmarks.tables import print_head, print_row, tell

HERE = Path(__file__).resolve().parents[2]
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"), "1")


@dataclass(frozen=True)
class Run:
    """One command."""

    wall: float
    """From its start to its end [s]."""
    processor: float
    """Processor time of all its processes [s]."""
    cycle: float
    """Of its plan [s]."""
    gap: float | None
    """How far the lower bound is below the cycle, as a share of it; None without a bound."""


def planned(checkout: Path, tasks: Path, out: Path, options: list[str]) -> Run | None:
    """Returns what planning a job with a checkout took, None where it has no verified plan."""
    command = [sys.executable, "-m", "dualarm_cli", "plan", str(tasks), "--out", str(out)]
    before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(
        [*command, "--force", "--quiet", *options],
        cwd=checkout,
        env=os.environ | ONE_THREAD | {"PYTHONPATH": str(checkout)},
        capture_output=True,
        check=False,
    )
    wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode != 0:
        return None
    report = json.loads((out / "report.json").read_text(encoding="utf-8"))
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return Run(wall, used, report["cycle_time"], report.get("gap"))


def compared(
    checkouts: tuple[Path, Path], tasks: Path, folder: Path, options: list[list[str]], repeats: int
) -> tuple[list[Run], list[Run]] | None:
    """Returns the runs of a job with the other commit and with this one, by turns; None without a plan."""
    runs: tuple[list[Run], list[Run]] = ([], [])
    for _ in range(repeats):
        for mine, checkout, own in zip(runs, checkouts, options, strict=True):
            run = planned(checkout, tasks, folder / "plan", own)
            if run is None:
                return None
            mine.append(run)
    return runs


def main() -> None:
    """Prints one row per number of stages and effort."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--against", required=True, help="the other commit")
    parser.add_argument("--stages", type=int, nargs="+", default=[24, 100])
    parser.add_argument("--efforts", nargs="+", default=["quick", "normal"])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--robots", nargs="+", choices=[*ROOMS], default=["sda10f"])
    parser.add_argument("--jobs", type=Path, nargs="+", default=[], help="in place of sequences")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--options", default="", help="further options of this checkout's command")
    given = parser.parse_args()
    os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-given.cores :])
    ratios = "wall, ratio", "processor time, ratio", "cycle, ratio"
    gaps = "gap before", "gap now"
    print_head("robot", "stages", "effort", "jobs", "wall before", "now", *ratios, "longer", *gaps)
    with tempfile.TemporaryDirectory() as name:
        folder, here = Path(name), Path(name) / "here"
        other = installed(given.against, folder)
        pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target"]
        subprocess.run([*pip, str(here), str(HERE)], check=True)
        rows = _job_rows(given, folder)
        for effort in given.efforts:
            found = []
            for what, jobs in rows:
                pairs = _medians(given, effort, jobs, folder, (other, here))
                _print(*what, effort, pairs)
                found += pairs
            if len(rows) > 1:
                _print("all", "", effort, found)


def _job_rows(given: argparse.Namespace, folder: Path) -> list[tuple[tuple[str, str], list[Path]]]:
    """Returns robot, stages and task files of each row."""
    if given.jobs:
        return [(("any", "any"), [path.resolve() for path in given.jobs])]
    rows = []
    for robot, stages in itertools.product(given.robots, given.stages):
        files = []
        for seed in given.seeds:
            job = folder / f"{robot}-{stages}-{seed}"
            write_sequence(robot, stages, seed, job)
            files.append(job / "tasks.yaml")
        rows.append(((robot, str(stages)), files))
    return rows


def installed(commit: str, folder: Path) -> Path:
    """Returns where a commit's package is installed, without what it needs, below a folder."""
    checkout, place = folder / "checkout", folder / "other"
    git = ["git", "-C", str(HERE), "worktree"]
    add = [*git, "add", "--detach", str(checkout), commit]
    subprocess.run(add, check=True, capture_output=True)
    try:
        pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--target", str(place)]
        subprocess.run([*pip, str(checkout)], check=True)
    finally:
        subprocess.run([*git, "remove", "--force", str(checkout)], check=True)
    return place


def _medians(
    given: argparse.Namespace,
    effort: str,
    jobs: list[Path],
    folder: Path,
    checkouts: tuple[Path, Path],
) -> list[tuple[Run, Run]]:
    """Returns the medians of each job's repeats, of the other commit and of this one."""
    options = [["--effort", effort], ["--effort", effort, *given.options.split()]]
    pairs = []
    for job in jobs:
        found = compared(checkouts, job, folder, options, given.repeats)
        if found is None:
            tell(f"{job.parent.name}, {effort}: no plan")
            continue
        before, now = (
            replace(
                runs[0],
                wall=median(r.wall for r in runs),
                processor=median(r.processor for r in runs),
            )
            for runs in found
        )
        pairs.append((before, now))
        ratios = now.wall / before.wall, now.processor / before.processor, now.cycle / before.cycle
        tell(f"{job.parent.name}, {effort}: " + ", ".join(f"{ratio:.4f}" for ratio in ratios))
    return pairs


def _print(robot: str, stages: str, effort: str, pairs: list[tuple[Run, Run]]) -> None:
    """Prints a row: medians over jobs, in brackets the extremes."""
    if not pairs:
        return
    walls = [f"{median(pair[k].wall for pair in pairs):.1f} s" for k in range(2)]
    ratios = [
        _span([getattr(now, name) / getattr(before, name) for before, now in pairs], digits)
        for name, digits in (("wall", 2), ("processor", 2), ("cycle", 3))
    ]
    longer = sum(now.cycle > before.cycle * (1.0 + 1e-6) for before, now in pairs)
    bounded = [pair for pair in pairs if None not in (pair[0].gap, pair[1].gap)]
    gaps = [f"{median(pair[k].gap for pair in bounded):.1%}" if bounded else "" for k in range(2)]
    print_row(robot, stages, effort, len(pairs), *walls, *ratios, longer, *gaps)


def _span(values: list[float], digits: int) -> str:
    """Returns a median with the extremes."""
    low, middle, high = (f"{f(values):.{digits}f}" for f in (min, median, max))
    return middle if len(values) == 1 else f"{middle} ({low} to {high})"


if __name__ == "__main__":
    main()
