"""Plans where pairs of branches of both arms exist, and lines through singularities, from files to the verifier."""

from __future__ import annotations

import importlib
import math
import re
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.verification import verify

STOPS = PlanSettings(effort="quick", blend="none")
TOOL = "{tcp: {xyz: [0, 0, 0.1]}, shapes: [{capsule: {radius: 0.02, length: 0.06}, xyz: [0, 0, 0.04]}]}"


@pytest.fixture(scope="module")
def script():
    """The benchmark of branch pairs, as a module."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(Path(__file__).parents[2])
        yield importlib.import_module("benchmarks.correctness.branch_pairs")


def planned(folder: Path, files: dict[str, str]):
    """The verified plan of files."""
    for name, text in files.items():
        (folder / name).write_text(text)
    job = load_job(folder / "tasks.yaml")
    schedule = plan_without_bound(job, STOPS)
    assert verify(schedule, job).passed
    return schedule


def torso(script, line: float, more: str, yaw: str) -> dict[str, str]:
    """Two UR3e on a torso, tilted by 45 degrees to either side, with mirrored targets."""
    limit = np.array([2, 2, 1, 2, 2, 2]) * math.pi
    speeds = iter((2.0944, 2.0944, 3.1416, 3.1416, 3.1416, 3.1416))
    urdf = re.sub(
        'velocity="[^"]*"', lambda _: f'velocity="{next(speeds)}"', script.urdf(script.UR, limit)
    )
    cell, tasks = "", ""
    for arm, side in (("left", 1), ("right", -1)):
        base = f"{{xyz: [0, {0.12 * side}, 0.6], rpy: [{-45 * side} deg, 0, 0]}}"
        cell += f"  {arm}: {{robot: ur.yaml, base: {base}}}\n"
        pick, place = (
            f"{{xyz: [{x}, {side * y}, 0.45], rpy: [180 deg, 0, 0]{yaw}}}"
            for x, y in ((0.32, 0.15), (0.15, 0.4))
        )
        tasks += f"  - {{id: {arm}, arm: {arm}, pick: {pick}, place: {place}}}\n"
    return {
        "ur.urdf": urdf,
        "ur.yaml": script.robot("ur", np.zeros(6)),
        "cell.yaml": f"dualarm: cell/1\nrobot:\n{cell}tools: {{left: {TOOL}, right: {TOOL}}}\n",
        "tasks.yaml": "dualarm: tasks/1\ncell: cell.yaml\nstart: free\nreturn: true\n"
        f"{more}defaults: {{approach: {line}, retract: {line}, dwell: 0.15}}\ntasks:\n{tasks}",
    }


@pytest.mark.parametrize(
    ("line", "more", "yaw"),
    [(0.0, "", ", free: yaw"), (0.05, "mode: free\n", "")],
    ids=["free yaw", "lines, asynchronous"],
)
def test_where_the_quickest_branches_of_both_arms_collide_others_are_taken(
    script, line, more, yaw, tmp_path
):
    """At the picks 4 of 64 pairs of branches touch, by brute force: the quickest, in many whole turns."""
    planned(tmp_path, torso(script, line, more, yaw))


@pytest.mark.parametrize("number", [12, 92])
def test_random_jobs_are_refused_only_where_brute_force_finds_nothing(script, number, tmp_path):
    """One has no pair of branches that is clear; in the other straight moves of several branches are blocked."""
    job = script.random_job(number)
    exists = script.has_plan(job)
    assert exists == (number == 92)
    if exists:
        planned(tmp_path, job.text)
        return
    with pytest.raises(InfeasibleError) as caught:
        planned(tmp_path, job.text)
    head = str(caught.value).splitlines()[0]
    assert "other postures" in head
    assert "platform" not in head


def test_an_arm_picks_though_its_wrist_is_straight_on_the_way(script, tmp_path):
    """A Doosan M1013 with its tool down: on its way of 50 mm upwards joint 5 passes 0, joint 4 stays 0."""
    limit = np.full(6, 2.617)
    target = "{xyz: [0.4, -0.4, -0.4], rpy: [180 deg, 0, 0], free: yaw}"
    tool = "{tcp: {xyz: [0, 0, 0.12]}}"
    base = "{robot: m1013.yaml, base: {xyz: [0, 0, 0]}}"
    aside = base.replace("[0, 0, 0]", "[0, 3, 0]")
    schedule = planned(
        tmp_path,
        {
            "m1013.urdf": re.sub(
                "<collision>.*?</collision>", "", script.urdf(script.WRIST, limit)
            ),
            "m1013.yaml": script.robot("m1013", np.zeros(6)),
            "cell.yaml": f"dualarm: cell/1\nrobot: {{left: {base}, right: {aside}}}\ntools: {{left: {tool}}}\n",
            "tasks.yaml": "dualarm: tasks/1\ncell: cell.yaml\nstart: free\nreturn: false\n"
            "defaults: {approach: 50 mm, retract: 50 mm}\n"
            f"tasks:\n  - {{id: a, arm: left, pick: {target}, place: {target}}}\n",
        },
    )
    lines = [part for part in schedule.segments if part.kind in ("approach", "retract")]
    assert len(lines) == 4
    for part in lines:
        q, _, _ = schedule.trajectory.at(np.linspace(part.start, part.end, 50))
        assert q[0, 4] * q[-1, 4] < 0.0
        assert np.abs(np.sin(q[:, 3])).max() < 1e-5
