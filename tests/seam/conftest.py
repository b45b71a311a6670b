"""Seams on small cells, as problems for the solvers, and poses by pinocchio."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.geometry.arrays import FloatArray
from dualarm_cli.kinds.seam.closed_chain import SeamProblem
from dualarm_cli.kinds.seam.closed_chain.chain import Chain
from dualarm_cli.model.cell import Cell
from dualarm_cli.model.curves.contours import Ellipse, LineContour
from dualarm_cli.model.curves.feature_curve import FeatureCurve
from dualarm_cli.model.process_work import Hold, SeamTool, SeamWork

BOTH = "tools: {left: {tcp: {xyz: [0, 0, 100 mm]}}, right: {tcp: {xyz: [0, 0, 200 mm], rpy: [0, 0, 30 deg]}}}"
CELLS = {
    "sda10f": f"robot: sda10f\nbase: {{xyz: [0.1, -0.2, 0.05], rpy: [0, 0, 20 deg]}}\n{BOTH}",
    "yumi": f"robot: yumi\n{BOTH}",
    "iiwa14": "robot: iiwa14\ntools: {left: {tcp: {xyz: [0, 0, 100 mm]}}}",
}


@pytest.fixture(scope="session")
def cells(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Cell]:
    """A platform under two 7-axis arms, two arms that are not SRS, and one arm."""
    found = {}
    for name, text in CELLS.items():
        folder: Path = tmp_path_factory.mktemp(name)
        (folder / "dualarm.toml").write_text("")
        (folder / "cell.yaml").write_text(f"dualarm: cell/1\n{text}\n")
        (folder / "tasks.yaml").write_text(
            "dualarm: tasks/1\ncell: cell.yaml\nstart: free\ntasks:\n"
            "  - {id: a, arm: left, move: {xyz: [0.4, 0.2, 0.5], rpy: [180 deg, 0, 0]}}\n"
        )
        found[name] = load_job(folder / "tasks.yaml").cell
    return found


def line(length: float = 0.06, up: tuple[float, float, float] = (0.0, 0.0, 1.0)) -> FeatureCurve:
    """A line along x about the part's origin."""
    half = np.array([length / 2.0, 0.0, 0.0])
    return FeatureCurve(LineContour(-half, half, np.array(up)), pin.SE3.Identity())


def rim(radius: float = 0.03, degrees: float = 150.0) -> FeatureCurve:
    """An arc round a disc, the tool from outside: its surface faces every way in turn."""
    arc = Ellipse((radius, radius), 0.0, np.radians(degrees), outward=True)
    return FeatureCurve(arc, pin.SE3.Identity())


def work_on(curve: FeatureCurve, **changes: Any) -> SeamWork:
    """A seam on what the left arm holds 200 mm in front of its flange."""
    part = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.2]))
    work = SeamWork("left", "right", part, curve, SeamTool(0.002), Hold(), speed=0.1)
    return replace(work, **changes)


def problem_on(cell: Cell, work: SeamWork, time: float = 0.05, **changes: Any) -> SeamProblem:
    """The problem of one seam, few starts."""
    robot = cell.robot
    problem = SeamProblem(
        chain=Chain(cell, work),
        limits=robot.limits,
        start=np.array(robot.postures["home"]),
        reference=None,
        time=time,
        samples=100,
        improved_starts=2,
        seed=0,
        is_free=None,
    )
    return replace(problem, **changes)


def by_pinocchio(cell: Cell, work: SeamWork, q: FloatArray) -> tuple[pin.SE3, pin.SE3]:
    """Part and tool in the world at one configuration: base, flange, and what the files say of part and tool."""
    model = pin.buildModelFromXML(cell.robot.urdf)
    data = model.createData()
    pin.framesForwardKinematics(
        model, data, q[[cell.robot.joints.index(n) for n in model.names[1:]]]
    )
    flange = {
        arm.name: cell.base * data.oMf[model.getFrameId(arm.flange)] for arm in cell.robot.arms
    }
    part = work.part if work.master is None else flange[work.master] * work.part
    return part, flange[work.slave] * cell.tools[work.slave].tcp


@pytest.fixture(scope="session")
def make() -> SimpleNamespace:
    """What builds seams: line, rim, work_on, problem_on, by_pinocchio."""
    tools: dict[str, Callable[..., Any]] = {
        "line": line,
        "rim": rim,
        "work_on": work_on,
        "problem_on": problem_on,
        "by_pinocchio": by_pinocchio,
    }
    return SimpleNamespace(**tools)
