"""Random jobs of two six-axis arms on tilted, close bases: is a job refused that has a plan?

python -m benchmarks.correctness.branch_pairs [--jobs 200] [--first 0] [--effort quick] [--out DIR]

Each job is planned. A refused one is searched exhaustively here, without code of the planner: own inverse kinematics
from random starts, own lines, own distances of capsules, all pairs of branches of both arms, straight transfers one arm
after the other or both at once. Prints what is said of each refused job, and how many of them have a plan.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.correctness.capsule_arms import (
    KEPT,
    OFFSET,
    REACH,
    UR,
    WRIST,
    Arm,
    cross,
    robot,
    rpy,
    urdf,
)
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound


@dataclass
class RandomJob:
    """Two arms, and what they are to do in each stage."""

    arms: list[Arm]
    stops: list[list[tuple[np.ndarray, np.ndarray, bool]]]
    line: float
    home: np.ndarray | None
    returns: bool
    text: dict[str, str]

    def paths(self, starts: int = 200) -> list[list[list[np.ndarray]]]:
        """Branches of each arm at each stop; of six yaws where any will do."""
        rng = np.random.default_rng(0)
        return [
            [arm.yawed(*stop, self.line, rng, starts) for stop in stops]
            for arm, stops in zip(self.arms, self.stops, strict=True)
        ]


def random_job(number: int) -> RandomJob:
    """A job whose stops each arm by itself can make."""
    rng = np.random.default_rng(number)
    while True:
        kinds = [("ur", UR), ("wrist", WRIST), ("offset", OFFSET)]
        names, arms, bases = [], [], []
        some = rng.integers(3, size=2) if rng.random() < 0.3 else [rng.integers(3)] * 2
        size = 0.5 if max(some) == 0 else 1.1
        for side, kind in zip((1, -1), some, strict=True):
            name, links = kinds[kind]
            names.append(name)
            place = np.array([0, side * size * rng.uniform(0.2, 0.5), 0.6])
            turn = [-side * rng.uniform(0.0, 0.5 * math.pi), *rng.uniform(-0.3, 0.3, 2).tolist()]
            limit = np.full(6, 2 * math.pi)
            limit[2] = math.pi if kind == 0 else 2.7
            arms.append(Arm(links, limit, rpy(*turn), place))
            file = f"{name}_{'left' if side > 0 else 'right'}.yaml"
            bases.append(f"{{robot: {file}, base: {{xyz: {place.tolist()}, rpy: {turn}}}}}")
        line, free = float(rng.choice([0.0, 0.03, 0.05])), rng.random() < 0.4
        count = 2 * int(rng.integers(1, 3))
        home = rng.uniform(-math.pi, math.pi, (2, 6)) * 0.7 if rng.random() < 0.4 else None
        if home is not None:
            own = min(arm.own(q[None])[0] for arm, q in zip(arms, home, strict=True))
            if min(own, cross(arms, home[:1], home[1:])[0]) < KEPT:
                continue
        stops, rows = [], []
        for _ in range(count):
            middle = rng.uniform([0.25, -0.3, 0.1], [0.9, 0.3, 1.1]) * [size, size, 1]
            for side in (1, -1):
                p = (middle + side * np.array([0, rng.uniform(0.05, 0.25) * size, 0])).round(3)
                lean = rng.uniform(-0.6, 0.6) * (rng.random() < 0.5)
                turn = [round(math.pi + lean, 3), 0.0, round(rng.uniform(-3, 3), 3)]
                rows.append((p, turn))
        for a, arm in enumerate(arms):
            stops.append([(rpy(*turn), p, free) for p, turn in rows[a::2]])
            if not all(arm.yawed(*stop, line, rng, 30) for stop in stops[-1]):
                break
        else:
            break
    flag = ", free: yaw" if free else ""
    tasks = []
    for a, arm in enumerate(("left", "right")):
        for k in range(0, count, 2):
            pick, place = (
                f"{{xyz: {p.tolist()}, rpy: {turn}{flag}}}"
                for p, turn in rows[2 * k + a : 2 * k + 3 + a : 2]
            )
            tasks.append(f"  - {{id: {arm}{k}, arm: {arm}, pick: {pick}, place: {place}}}")
    returns, start = bool(rng.random() < 0.5), "free" if home is None else "home"
    text = {
        f"{name}.urdf": urdf(dict(kinds)[name], arm.limit)
        for name, arm in zip(names, arms, strict=True)
    }
    posture = [np.zeros(6)] * 2 if home is None else home
    for side, name, q in zip(("left", "right"), names, posture, strict=True):
        text[f"{name}_{side}.yaml"] = robot(name, q)
    shape = "{capsule: {radius: 0.02, length: 0.06}, xyz: [0, 0, 0.04]}"
    tool = f"{{tcp: {{xyz: [0, 0, {REACH}]}}, shapes: [{shape}]}}"
    text["cell.yaml"] = (
        f"dualarm: cell/1\nrobot:\n  left: {bases[0]}\n  right: {bases[1]}\n"
        f"tools:\n  left: {tool}\n  right: {tool}\n"
    )
    mode = "mode: free\n" if rng.random() < 0.25 else ""
    text["tasks.yaml"] = (
        f"dualarm: tasks/1\ncell: cell.yaml\nstart: {start}\nreturn: {str(returns).lower()}\n{mode}"
        f"defaults: {{approach: {line}, retract: {line}, dwell: 0.1}}\ntasks:\n"
        + "\n".join(tasks)
        + "\n"
    )
    return RandomJob(arms, stops, line, home, returns, text)


def has_plan(job: RandomJob, most: int = 3000) -> bool | None:
    """Whether branches of all stops can be joined; None where that was not found out."""
    tried, pairs = 0, []
    for left, right in zip(*job.paths(), strict=True):
        rows = [(p, q) for p in left for q in right]
        clear = cross(job.arms, *(np.array([row[a][0] for row in rows]) for a in (0, 1))) >= KEPT
        pairs.append([row for row, good in zip(rows, clear, strict=True) if good])
    if not all(pairs):
        return False

    def joined(k: int, q: list[np.ndarray], begin: list[np.ndarray] | None) -> bool | None:
        nonlocal tried
        if k == len(job.stops[0]):
            return not job.returns or moves(job, q, [None, None], begin)
        some = pairs[k]
        if q:
            some = sorted(
                some, key=lambda p: max(np.abs(x[0] - y).max() for x, y in zip(p, q, strict=True))
            )
        for pair in some:
            tried += 1
            if tried > most:
                return None
            at = q or [path[0] for path in pair]
            near = [
                _near(path, a, arm.limit) for path, a, arm in zip(pair, at, job.arms, strict=True)
            ]
            key = (k, *(v.round(6).tobytes() for v in (*at, *(n[0] for n in near), *(begin or ()))))
            if key in done:
                continue
            done.add(key)
            if not moves(job, at, near, [n[0] for n in near]):
                continue
            found = joined(k + 1, [n[0] for n in near], begin or [n[0] for n in near])
            if found or found is None:
                return found
        return False

    done: set = set()
    home = None if job.home is None else list(job.home)
    return joined(0, home or [], home)


def _near(path: np.ndarray, q: np.ndarray, limit: np.ndarray) -> np.ndarray:
    """The whole turns of a path nearest to a posture, within limits."""
    turned = path + 2 * math.pi * np.round((q - path[0]) / (2 * math.pi))
    return np.where((np.abs(turned) <= limit).all(0), turned, path)


def moves(
    job: RandomJob, q: list[np.ndarray], lines: list[np.ndarray | None], to: list[np.ndarray]
) -> bool:
    """Whether both arms get to places and through their lines there, in some order or at once."""
    way = []
    for arm, at, line, there in zip(job.arms, q, lines, to, strict=True):
        steps = max(2, int(np.abs(there - at).max() / 0.06))
        own = at + np.linspace(0, 1, steps)[:, None] * (there - at)
        if arm.own(own).min() < KEPT:
            return False
        way.append([own, own[-1:] if line is None else np.concatenate([line, line[::-1]])])
    for first in (0, 1):
        parts = [np.concatenate(w) for w in way]
        still = [way[0][0][:1], way[1][0][:1]]
        still[first] = parts[first][-1:]
        one = [parts[first], np.repeat(still[1 - first], len(parts[first]), 0)]
        other = [np.repeat(still[first], len(parts[1 - first]), 0), parts[1 - first]]
        if first:
            one = one[::-1]
            other = other[::-1]
        if min(cross(job.arms, *one).min(), cross(job.arms, *other).min()) >= KEPT:
            return True
    together = []
    for part in zip(*way, strict=True):
        n = max(len(p) for p in part)
        together.append([p[np.linspace(0, len(p) - 1, n).round().astype(int)] for p in part])
    return all(cross(job.arms, *part).min() >= KEPT for part in together)


def verdict(number: int, effort: str, folder: Path) -> str:
    """What comes of a job: planned, refused rightly, or refused although it has a plan."""
    job = random_job(number)
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in job.text.items():
        (folder / name).write_text(text)
    try:
        done = load_job(folder / "tasks.yaml")
        plan_without_bound(done, PlanSettings(effort=effort, blend="none"))
    except InfeasibleError as error:
        found = has_plan(job)
        told = {True: "REFUSED, HAS A PLAN", False: "refused, none", None: "refused, unknown"}[
            found
        ]
        print(number, told, *str(error).splitlines()[:4], sep="\n    ", flush=True)
        return told
    return "planned"


def main() -> None:
    """Plans the jobs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--effort", default="quick")
    parser.add_argument("--out", type=Path, default=Path(tempfile.mkdtemp()))
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.jobs)
    print(Counter(verdict(n, asked.effort, asked.out / str(n)) for n in numbers))


if __name__ == "__main__":
    main()
