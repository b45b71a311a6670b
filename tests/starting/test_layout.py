"""Cells that `dualarm init` proposes for short arms, long hands, and wrists that hardly turn."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InfeasibleError
from dualarm_cli.files.cells.cells import load_cell
from dualarm_cli.files.robots.mesh_formats import stl_bytes
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinematics.cell_model import CellModel
from dualarm_cli.model.job import Job
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.shape import Hull
from dualarm_cli.refusals import Refusal
from dualarm_cli.starting.layout import _home_fault
from dualarm_cli.starting.table import Table

OFFSETS = (
    (0.0, 0.0, 0.1),
    (0.0, 0.0, 0.08),
    (0.0, 0.0, 0.17),
    (0.0, 0.0, 0.17),
    (0.02, 0.0, 0.06),
    (0.0, 0.0, 0.05),
)
"""Origin of each joint in the link before [m], all joints at zero."""
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1", "0 1 0", "0 0 1")


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> str:
    """Returns a collision box from corner to corner."""
    middle, size = (
        " ".join(f"{v:.6g}" for v in rows)
        for rows in (0.5 * np.add(low, high), np.subtract(high, low))
    )
    return (
        f'<collision><origin xyz="{middle}"/><geometry><box size="{size}"/></geometry></collision>'
    )


def write_arm(
    along: tuple[float, ...] = (0.0,) * 6, more: str = "", limits: dict[int, str] | None = None
) -> str:
    """Writes an arm of six joints that reaches 0.45 m from its shoulder; returns its path.

    Args:
        along: distance by which the origin of each joint is moved along its axis [m].
        more: further links and joints.
        limits: lowest and highest position of joints, by number.
    """
    text, parent = '<link name="base"/>', "base"
    before = np.zeros(3)
    for k, (offset, axis) in enumerate(zip(OFFSETS, AXES, strict=True)):
        moved = along[k] * np.array([float(v) for v in axis.split()])
        xyz = " ".join(f"{v:.6g}" for v in np.array(offset) + moved - before)
        x, y, z = -moved
        shape = box((x - 0.02, y - 0.02, z + 0.02), (x + 0.02, y + 0.02, z + 0.04))
        low, high = ((limits or {}).get(k) or "-2.6 2.6").split()
        text += (
            f'<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/><origin xyz="{xyz}"/>'
            f'<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" velocity="2" effort="1"/></joint>'
            f'<link name="l{k}">{shape}</link>'
        )
        parent, before = f"l{k}", moved
    Path("arm.urdf").write_text(f'<robot name="arm">{text}{more}</robot>')
    return "arm.urdf"


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.usefixtures("unplanned")
def test_origins_along_axes_make_no_difference() -> None:
    """A URDF may have its joints anywhere on their axes, as far as the arm is long: the same arm, the same cell."""
    for name, along in (("plain", (0.0,) * 6), ("moved", (0.0, 0.0, 0.4, -0.35, 0.0, 0.0))):
        assert run(["init", name, "--robot", write_arm(along)]) == 0
    plain, moved = (load_cell(Path(name) / "cell.yaml").cell for name in ("plain", "moved"))
    assert plain.frames.keys() == moved.frames.keys()
    for name, frame in plain.frames.items():
        assert frame.isApprox(moved.frames[name], 1e-9)
    assert (Path("plain") / "tasks.yaml").read_text() == (Path("moved") / "tasks.yaml").read_text()


def test_a_hand_beyond_its_tool_centre_point_stays_above_the_table() -> None:
    """Its fingers end 60 mm beyond the tip: targets are at least that high, at rows that are half a spacing apart."""
    hand = (
        '<joint name="palm_joint" type="fixed"><parent link="l5"/><child link="palm"/></joint><link name="palm">'
        f'{box((-0.03, -0.03, 0.04), (0.03, 0.03, 0.16))}</link><joint name="tip_joint" type="fixed">'
        '<parent link="palm"/><child link="arm_tip"/><origin xyz="0 0 0.1"/></joint><link name="arm_tip"/>'
    )
    assert run(["init", "demo", "--robot", write_arm(more=hand)]) == 0
    assert run(["check", "demo/tasks.yaml"]) == 0
    job = load_job(Path("demo/tasks.yaml"))
    [table] = job.cell.obstacles
    top = table.shape.pose.translation[2] + 0.5 * table.shape.size[2]
    for task in job.tasks:
        for stop in task.stops:
            assert stop.target.pose.translation[2] - top > 0.06


@pytest.mark.parametrize("refused", [1, 99])
def test_targets_that_the_planner_refuses_are_not_written(
    refused: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The planner refuses the job on the first table, or on all: the next one is taken, or nothing is written."""
    calls = []

    def refuse(job: Job, settings: PlanSettings) -> None:
        calls.append(job.cell.obstacles[0].shape.pose.translation)
        assert (len(job.tasks), settings) == (6, PlanSettings(effort="quick"))
        if len(calls) <= refused:
            raise InfeasibleError(Refusal("no_plan_on_grid"))

    monkeypatch.setattr("dualarm_cli.starting.project.plan_without_bound", refuse)
    code = run(["init", "next", "--robot", write_arm()])
    if refused == 99:
        assert (code, Path("next").exists()) == (3, False)
        assert (
            "no plan was found of 6 picks for each arm, 40 mm apart, on any table tried in front of arm.urdf"
            in capsys.readouterr().err
        )
        return
    assert code == 0
    table = load_cell(Path("next") / "cell.yaml").cell.obstacles[0].shape
    assert np.allclose(table.pose.translation, calls[1])
    assert not np.allclose(calls[0], calls[1])


@pytest.mark.usefixtures("unplanned")
def test_visual_meshes_of_a_folder_come_along() -> None:
    """Planning does not read them, the page does; also for two robots."""
    corners = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]])
    Path("cover.stl").write_bytes(stl_bytes(Hull(corners, triangles)))
    arm = Path(write_arm())
    cover = '<link name="base"><visual><geometry><mesh filename="cover.stl"/></geometry></visual></link>'
    arm.write_text(arm.read_text().replace('<link name="base"/>', cover))
    assert run(["robot", "import", str(arm), "--out", "one"]) == 0
    assert run(["robot", "import", "--left", str(arm), "--right", str(arm), "--out", "two"]) == 0
    for source, copy in (("one", "one"), ("two/arm", "arm")):
        name = source.split("/")[0]
        [mesh] = Path(source).rglob("visual_*.stl")
        assert run(["init", f"demo_{name}", "--robot", name]) == 0
        copied = Path(f"demo_{name}") / copy / mesh.relative_to(source)
        assert copied.read_bytes() == mesh.read_bytes()


def test_a_wrist_that_does_not_face_the_front_gets_a_table() -> None:
    """Joints 1 and 6 keep the tool's yaw away from 0 by more than 10 degrees, where all searches began."""
    arm = write_arm(limits={0: "-0.7 0.7", 3: "-0.3 0.3", 5: "0.9 2.4"})
    assert run(["init", "demo", "--robot", arm]) == 0
    assert run(["check", "demo/tasks.yaml"]) == 0


def test_an_arm_that_hardly_turns_is_told_the_room_that_is_lacking(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """Two strips of 36 by 16 cm, at yaws of 90 degrees alone; the remedy works: reach of the imported folder."""
    arm = write_arm(limits={0: "-0.7 0.7", 3: "-0.3 0.3", 5: "1.4 1.8"})
    assert run(["init", "demo", "--robot", arm]) == 3
    said = capsys.readouterr().err
    assert "no table in front of arm.urdf has room for two rows of 6 targets 40 mm apart" in said
    assert run(["robot", "import", arm, "--out", "arm"]) == 0
    assert run(["robot", "reach", "arm"]) == 0
    assert "the arm reaches points between x" in capsys.readouterr().out


@pytest.mark.usefixtures("unplanned")
def test_a_start_elsewhere_than_home_has_its_reason() -> None:
    """A table 10 mm above the tip cuts into the tool; without it the tool is below the top by the difference."""
    assert run(["init", "arm", "--robot", write_arm()]) == 0
    cell = load_cell(Path("arm") / "cell.yaml").cell
    x, y, z = CellModel.from_cell(cell).tool_position("left", cell.robot.postures["home"])
    low, high = (x - 0.1, y - 0.1), (x + 0.1, y + 0.1)
    table = Table(low, high, z + 0.01, 0.02).obstacle
    message = _home_fault(replace(cell, obstacles=(table,)), z + 0.01)
    assert re.fullmatch(r"at home left_tool and table lack \d+\.\d mm of clearance", message)
    below = _home_fault(replace(cell, obstacles=()), z + 0.2)
    assert below == "at home the tool is 200 mm below the table's top"
    assert _home_fault(replace(cell, obstacles=()), z - 0.2) == ""
