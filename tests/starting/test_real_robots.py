"""Robots as their makers describe them, with real link shapes: import, init, plan, verified; two commands before it."""

from __future__ import annotations

import json
from importlib.metadata import files
from pathlib import Path

import pytest

from dualarm_cli.cli.run import run

ROBOTS = {
    "two_ur5": "ur_description/urdf/ur5_robot.urdf",
    "two_panda": "panda_description/urdf/panda.urdf",
    "baxter": "baxter_description/urdf/baxter.urdf",
    "tiago_dual": "tiago_description/robots/tiago_dual.urdf",
    "pr2": "pr2_description/urdf/pr2.urdf",
    "talos": "talos_data/robots/talos_reduced.urdf",
}
"""URDF of each robot in the package."""
QUICK = "baxter"
"""The one that is planned quickest."""


def robots_folder():
    """Returns the folder of the package example-robot-data that holds one folder for each robot."""
    [package] = [file for file in files("example-robot-data") if file.name == "baxter.urdf"]
    return Path(package.locate()).resolve().parents[2]


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[] if name == QUICK else pytest.mark.slow) for name in ROBOTS],
)
def test_from_urdf_to_a_verified_plan(name, tmp_path, monkeypatch, capsys):
    """No file is edited; the proof of clearance is made with the shapes of all links."""
    monkeypatch.chdir(tmp_path)
    path = str(robots_folder() / ROBOTS[name])
    given = ["--left", path, "--right", path] if name.startswith("two_") else [path]
    assert run(["robot", "import", *given, "--out", "robot"]) == 0
    assert run(["init", "demo", "--robot", "robot"]) == 0
    assert run(["plan", "demo/tasks.yaml", "--effort", "quick", "--out", "plan"]) == 0
    out = capsys.readouterr().out
    assert "verification: passed" in out
    assert "could not be checked" not in out
    report = json.loads(Path("plan/report.json").read_text())
    assert report["verification"]["passed"]
    assert report["parts"] == 6
