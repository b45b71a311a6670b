"""How large schedules of many stages are, how long they take to write, read and verify, and in how much memory.

python -m benchmarks.speed.long_schedules PLAN [--times N ...]

PLAN is a task file whose plan returns to its start, such as that of tasks/04_packing, or the folder of such a plan; its
cycle is repeated N times. Times are processor times of steps, memory is the most that the process had by then. Steps
run in processes of their own, since memory that was once taken counts to the end.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.tables import print_head, print_row
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.exporting.schedule_reader import read_schedule
from dualarm_cli.model.motion.joint_motion import JointMotion, lean
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.verification import verify


def repeated(schedule: Schedule, times: int) -> Schedule:
    """Returns a cycle so many times over, each with tasks of its own; ways back are transfers to what follows."""
    later = schedule.duration * np.arange(times)
    groups = {}
    for name, one in schedule.motion.groups.items():
        time_ = np.append((one.time[:-1] + later[:, None]).ravel(), one.time[-1] + later[-1])
        rates = (
            np.concatenate([np.tile(rate[:-1], (times, 1)), rate[-1:]])
            for rate in (one.position, one.velocity, one.acceleration)
        )
        whole = Trajectory(one.joints, time_, *rates)
        groups[name] = lean(whole, {name: one.joints}, {}).groups[name]
    last = times - 1
    return replace(
        schedule,
        motion=JointMotion(schedule.motion.joints, groups),
        stages=tuple(
            replace(s, start=s.start + t, end=s.end + t, tasks=tuple(f"{x}-{k}" for x in s.tasks))
            for k, t in enumerate(later.tolist())
            for s in schedule.stages
        ),
        segments=tuple(
            replace(
                s,
                task=s.task and f"{s.task}-{k}",
                kind="transfer" if s.kind == "return" and k < last else s.kind,
                reason="partner" if s.reason == "end" and k < last else s.reason,
                start=s.start + t,
                end=s.end + t,
            )
            for k, t in enumerate(later.tolist())
            for s in schedule.segments
        ),
        events=tuple(
            replace(e, time=e.time + t, task=f"{e.task}-{k}")
            for k, t in enumerate(later.tolist())
            for e in schedule.events
        ),
    )


def told(begun: float) -> str:
    """Returns how long a step took and how much memory the process has had."""
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    return f"{time.process_time() - begun:.1f} s, {most:.1f} GB"


def step(name: str, plan: Path, out: Path, times: int) -> None:
    """Does one step and prints what it took, first the number of stages and sizes where they are written."""
    if name == "written":
        schedule = repeated(read_schedule(plan), times)
        begun = time.process_time()
        with (out / "schedule.json").open("wb") as file:
            file.writelines(to_json(schedule, "robot.urdf", {}))
        taken, stages = told(begun), len(schedule.stages)
        (out / "robot.urdf").write_text(schedule.robot.urdf, encoding="utf-8")
        size = (out / "schedule.json").stat().st_size
        print(stages, f"{size / 1e6:.1f} MB", f"{size / stages / 1e3:.1f} kB", taken, sep="\n")
        return
    begun = time.process_time()
    schedule = read_schedule(out)
    if name == "verified":
        begun = time.process_time()
        failures = verify(schedule).failures
        assert not failures, failures
    print(told(begun))


def main() -> None:
    """Runs the steps, each in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", type=Path)
    parser.add_argument("--times", type=int, nargs="+", default=[40, 400])
    parser.add_argument("--step", nargs=2, metavar=("NAME", "FOLDER"))
    given = parser.parse_args()
    if given.step:
        step(given.step[0], given.plan, Path(given.step[1]), given.times[0])
        return
    print_head("stages", "`schedule.json`", "a stage", "written in", "read in", "verified in")
    with tempfile.TemporaryDirectory() as folder:
        plan = given.plan
        if plan.is_file():
            command = [sys.executable, "-m", "dualarm_cli", "plan", str(plan), "--effort", "quick"]
            plan = Path(folder) / "plan"
            subprocess.run(
                [*command, "--quiet", "--out", str(plan)], check=True, capture_output=True
            )
        for times in given.times:
            cells: list[str] = []
            for name in ("written", "read", "verified"):
                words = ["-m", "benchmarks.speed.long_schedules", str(plan), "--times", str(times)]
                command = [sys.executable, *words, "--step", name, folder]
                done = subprocess.run(command, check=True, capture_output=True, text=True)
                cells += done.stdout.splitlines()
            print_row(*cells)


if __name__ == "__main__":
    main()
