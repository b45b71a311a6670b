"""Plan random jobs with heavy tools and parts, and compute the torques of each plan by MuJoCo from its files.

python -m benchmarks.correctness.payloads --jobs 300 --folder payloads

The jobs are those of `tests/random_valid_jobs.py` on the robots with masses and efforts. Each is planned at quick
effort. Inverse dynamics at knots and instants 4 ms apart take schedule.json, robot.urdf (with the tools) and the
weights of the parts; no code of the package takes part. Printed are the jobs by outcome, each unsound one, and the
largest share of an effort.
"""

from __future__ import annotations

import argparse
import itertools
import json
import re
import sys
import tempfile
from collections import Counter
from pathlib import Path
from time import process_time
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np

from benchmarks.correctness.judge import STEP, Motion
from benchmarks.tables import print_head, print_row, tell
from dualarm_cli.errors import DualArmError
from dualarm_cli.interface import load, plan

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))

from random_valid_jobs import BENCHES, write_random_job

LOADS = {"openarm": (0.5, 3.5), "iiwa14": (5.0, 25.0)}
"""Least and greatest mass of a tool with its part [kg]."""
TOLERATED = 1.001
"""Share of an effort that is tolerated."""


def weigh(seed: int, name: str, folder: Path) -> dict[str, Any]:
    """Give a random job's tools and parts weights; return the part."""
    random = np.random.default_rng([seed, 51])
    cell, job = (json.loads((folder / file).read_text()) for file in ("cell.yaml", "tasks.yaml"))
    mass = float(random.uniform(*LOADS[name]))
    share = float(random.uniform(0.2, 0.8))
    for tool in cell["tools"].values():
        tool |= {"mass": mass * share, "center_of_mass": [0.01, 0.0, 0.05]}
        tool["inertia"] = [2e-3 * mass, 2e-3 * mass, 1e-3 * mass]
    part = {"mass": mass * (1.0 - share), "center_of_mass": [0.0, 0.02, 0.03]}
    part["inertia"] = [1e-3 * mass, 2e-3 * mass, 1e-3 * mass]
    # Hardly larger than a point, so that parts which wait or lie are not in the way.
    parts = cell.setdefault("parts", {})
    parts["box"] = {"shapes": [{"sphere": {"radius": 1e-3}, "xyz": [0, 0, 2e-3]}]} | part
    for task in job["tasks"]:
        if "pick" in task:
            task["part"] = "box"
        if "path" in task and random.random() < 0.5:
            task["path"].pop("slower", None)
            task["path"]["speed"] *= 2.0
    for file, document in (("cell.yaml", cell), ("tasks.yaml", job)):
        (folder / file).write_text(json.dumps(document, indent=1))
    return part | {"tcp": cell["tools"]["left"]["tcp"]["xyz"]}


def by_mujoco(urdf: str, flanges: list[str], part: dict[str, Any]) -> mujoco.MjModel:
    """Build the model of a robot with the part in the tools at flanges."""
    urdf = re.sub(r"<(collision|visual).*?</\1>", "", urdf, flags=re.S)
    xyz = " ".join(map(str, np.add(part["center_of_mass"], part["tcp"])))
    ixx, iyy, izz = part["inertia"]
    inertia = f'ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"'
    for flange in flanges:
        urdf = urdf.replace(
            "</robot>",
            f'<link name="{flange}_load"><inertial><origin xyz="{xyz}"/><mass value="{part["mass"]}"/>'
            f'<inertia {inertia}/></inertial></link><joint name="{flange}_holds" type="fixed">'
            f'<parent link="{flange}"/><child link="{flange}_load"/></joint></robot>',
        )
    options = '<mujoco><compiler fusestatic="true" balanceinertia="false" boundmass="0"/></mujoco>'
    start = urdf.index(">", urdf.index("<robot")) + 1
    model = mujoco.MjModel.from_xml_string(urdf[:start] + options + urdf[start:])
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model


def held(document: dict[str, Any], arm: str, times: np.ndarray) -> np.ndarray:
    """Find the instants at which an arm carries a part."""
    carries, since = np.zeros(len(times), dtype=bool), None
    for event in sorted(document["events"], key=lambda event: event["time"]):
        if event["arm"] == arm and event["action"] in ("pick", "take"):
            since = event["time"] + event["dwell"] * (event["action"] == "take")
        elif event["arm"] == arm and event["action"] in ("place", "give") and since is not None:
            carries |= (times > since) & (times < event["time"])
            since = None
    return carries | (times > since) if since is not None else carries


def worst_share(folder: Path, part: dict[str, Any]) -> tuple[float, str]:
    """Compute the largest share of an effort in a plan, and where it is."""
    document = json.loads((folder / "schedule.json").read_text())
    urdf = (folder / "robot.urdf").read_text()
    arms = document["robot"]["arms"]
    assert document["robot"]["base"].get("quat_xyzw", [0, 0, 0, 1]) == [0, 0, 0, 1]
    limits = ElementTree.fromstring(urdf).findall("joint/limit/..")
    effort = {j.get("name"): float(j.find("limit").get("effort")) for j in limits}
    tracks, worst = Motion(document).tracks, (0.0, "")
    knots = np.concatenate([track[0] for track in tracks.values()])
    # Just after a knot, as accelerations may jump there.
    times = np.unique(np.concatenate([np.arange(0.0, document["duration"], STEP), knots + 1e-9]))
    times = times[times < document["duration"]]
    rows = {}
    for group, joints in document["robot"]["groups"].items():
        time, q, v, a = tracks[group]
        k = np.clip(np.searchsorted(time, times, side="right") - 1, 0, max(len(time) - 2, 0))
        n = np.minimum(k + 1, len(time) - 1)
        dt, h = (times - time[k])[:, None], np.maximum(time[n] - time[k], 1e-300)[:, None]
        jerk = np.where(n[:, None] > k[:, None], (a[n] - a[k]) / h, 0.0)
        motion = (
            q[k] + v[k] * dt + a[k] * dt**2 / 2 + jerk * dt**3 / 6,
            v[k] + a[k] * dt + jerk * dt**2 / 2,
            a[k] + jerk * dt,
        )
        rows |= {name: [part[:, i] for part in motion] for i, name in enumerate(joints)}
    carries = {entry["flange"]: held(document, arm, times) for arm, entry in arms.items()}
    for loads in itertools.product((False, True), repeat=len(arms)):
        model = by_mujoco(
            urdf, [flange for flange, on in zip(carries, loads, strict=True) if on], part
        )
        data = mujoco.MjData(model)
        kind = mujoco.mjtObj.mjOBJ_JOINT
        names = [mujoco.mj_id2name(model, kind, k) for k in range(model.nv)]
        efforts = np.array([effort[name] for name in names])
        chosen = np.all([carries[f] == on for f, on in zip(carries, loads, strict=True)], axis=0)
        for t in np.flatnonzero(chosen):
            for k, name in enumerate(names):
                data.qpos[k], data.qvel[k], data.qacc[k] = (part[t] for part in rows[name])
            mujoco.mj_inverse(model, data)
            share = np.abs(data.qfrc_inverse) / efforts
            k = int(share.argmax())
            worst = max(worst, (float(share[k]), f"{names[k]} at {times[t]:.3f} s"))
    return worst


def main() -> None:
    """Plan and judge."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=300)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="for jobs and plans, kept")
    parser.add_argument("--kinds", type=int, nargs="*", help="numbers of kinds, from 0")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        weighed(given, given.folder or Path(name))


def weighed(given: argparse.Namespace, jobs: Path) -> None:
    """Plans and judges jobs in a folder, and prints the table."""
    outcomes, names, largest = Counter[str](), list(BENCHES), 0.0
    count, seed = 0, given.first
    while count < given.jobs:
        name = names[seed % len(names)]
        kind = seed // len(names) % 12
        if name not in LOADS or (given.kinds and kind not in given.kinds):
            seed += 1
            continue
        folder = jobs / str(seed)
        folder.mkdir(parents=True, exist_ok=True)
        what = write_random_job(seed, folder)
        part, begun, share = weigh(seed, name, folder), process_time(), 0.0
        try:
            made = plan(load(folder / "tasks.yaml"), effort="quick")
            made.write(folder / "plan", page=False, force=True)
            share, where = worst_share(folder / "plan", part)
            own = made.schedule.verification.passed
            slowed = (
                "slowed" if any(n.startswith("torque") for n in made.schedule.notes) else "planned"
            )
            outcome = "unsound" if share > TOLERATED or not own else slowed
            detail = f"{share:.4f} {where} {'' if own else 'verification failed'}"
            largest = max(largest, share)
        except DualArmError as error:
            outcome, detail = "refused", str(error).splitlines()[0][:200]
        outcomes[outcome] += 1
        count, seed = count + 1, seed + 1
        tell(f"{what}: {outcome}, {detail} ({process_time() - begun:.1f} s)")
    kinds = "planned", "slowed", "refused", "unsound"
    print_head("jobs", *kinds, "largest share of an effort")
    print_row(count, *(outcomes[kind] for kind in kinds), f"{largest:.4f}")


if __name__ == "__main__":
    main()
