"""`dualarm robot reach`: areas by platform position, frames of a cell, a picture, and refusals in a sentence."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.files.source.bundled import robots_folder
from dualarm_cli.report.reach import ranges_of

CELL = """\
dualarm: cell/1
robot: iiwa7
tools:
  left: {tcp: {xyz: [0, 0, 100 mm]}, shapes: [{capsule: {radius: 20 mm, length: 60 mm}, xyz: [0, 0, 50 mm]}]}
frames:
  near: {xyz: [0.5, 0, 0.2]}
  far: {xyz: [1.5, 0, 0.2]}
obstacles:
  wall: {box: [0.04, 3, 2], xyz: [-0.30, 0, 0.2]}
"""


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def document(capsys, *words):
    """Returns the JSON document of the command."""
    assert run(["robot", "reach", *words, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_areas_are_counts_of_points(capsys):
    """Each point stands for a square; what both reach is no more than what either does."""
    found = document(capsys, "yumi", "--height", "100 mm", "--step", "0.1")
    assert found["height"] == 0.1
    assert found["platform"] == [None]
    counts = {who: np.array(one) for who, one in found["positions"].items()}
    for who, count in counts.items():
        assert count.shape == (len(found["y"]), len(found["x"]))
        assert found["area"][who] == pytest.approx([0.01 * count.sum()])
    assert (counts["both"] == counts["left"] * counts["right"]).all()
    assert 0 < counts["both"].sum() < counts["left"].sum()


def test_frames_of_a_cell_and_what_stands_in_the_way(capsys):
    """The near frame is reached and the far one is not; behind the wall nothing is."""
    Path("cell.yaml").write_text(CELL)
    found = document(capsys, "cell.yaml", "--step", "0.1")
    assert found["height"] == pytest.approx(0.2)
    assert {name: one["reached"]["left"] for name, one in found["frames"].items()} == {
        "near": [True],
        "far": [False],
    }
    Path("open.yaml").write_text(CELL.split("obstacles:")[0])
    free = document(capsys, "open.yaml", "--step", "0.1")
    assert free["area"]["left"][0] > 1.2 * found["area"]["left"][0]


def test_a_tilted_tool_reaches_elsewhere(capsys):
    """A tool that lies level does not reach where one that points down does."""
    down, level = (
        np.array(
            document(capsys, "iiwa7", "--height", "0.2", "--step", "0.1", *more)["positions"][
                "left"
            ]
        )
        for more in ((), ("--tilt", "90 deg"))
    )
    assert (down != level).any()
    assert level.any()


def test_a_table_and_a_picture(capsys):
    """Rows by platform angle; the same picture for the same robot; a file that is there is kept."""
    words = ["robot", "reach", "bottin_planar", "--height", "-0.1", "--step", "40 mm"]
    assert run([*words, "--out", "one.svg"]) == 0
    out = capsys.readouterr().out
    assert "platform °" in out
    assert "any" in out
    assert "no cell file names the tools" in out
    assert run([*words, "--out", "two.svg"]) == 0
    assert Path("one.svg").read_bytes() == Path("two.svg").read_bytes()
    assert run([*words, "--out", "two.svg"]) == 2
    assert "--out two.svg: already exists" in capsys.readouterr().err


def test_folders_and_robot_files_are_robots_too(capsys):
    """What `dualarm robot import` writes is a folder."""
    shutil.copytree(robots_folder() / "iiwa7", "mine")
    of_name, of_folder, of_file = (
        document(capsys, robot, "--height", "0.2", "--step", "0.1")
        for robot in ("iiwa7", "mine", "mine/robot.yaml")
    )
    assert of_name["area"] == of_folder["area"] == of_file["area"]


def test_a_tool_centre_point_at_the_flange_is_a_tool(capsys):
    """A cell file that names it is taken as it is: high up, a gripper of 0.12 m would lift the wrist out of reach."""
    head = "dualarm: cell/1\nrobot: iiwa7\n"
    Path("flange.yaml").write_text(head + "tools: {left: {tcp: {xyz: [0, 0, 0]}}}\n")
    Path("none.yaml").write_text(head)
    words = ("--height", "0.7", "--step", "0.1")
    areas = [
        document(capsys, f"{name}.yaml", *words)["area"]["left"] for name in ("flange", "none")
    ]
    assert areas[0] > areas[1]
    for name, assumed in (("flange", False), ("none", True)):
        assert run(["robot", "reach", f"{name}.yaml", *words]) == 0
        assert ("no cell file names the tools" in capsys.readouterr().out) is assumed


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["yuni"], "no bundled robot 'yuni'"),
        (["yumi", "--step", "0.1 mm"], "--step 0.0001 m: must be"),
        (["yumi", "--step", "0"], "--step 0 m: must be"),
        (["yumi", "--step", "-1"], "--step -1 m: must be"),
        (["yumi", "--height", "high"], "--height: 'high'"),
        (["yumi", "--tilt", "100 deg"], "--tilt 100 deg: must be between -90 and 90 deg"),
        (["yumi", "--out", "reach.gif"], "--out reach.gif: must end in"),
    ],
)
def test_what_cannot_be_is_refused(words, said, capsys):
    """Exit code 2, one sentence."""
    assert run(["robot", "reach", *words]) == 2
    assert said in capsys.readouterr().err


def test_nothing_is_reached_high_up(capsys):
    """It is told in a sentence, not by an empty table alone."""
    assert run(["robot", "reach", "iiwa7", "--height", "5", "--step", "0.1"]) == 0
    assert "the arm reaches nothing of a table 5 m high" in capsys.readouterr().out


def test_ranges_are_told_in_words():
    """Neighbours make a range; gaps part ranges."""
    angles = np.radians([-30.0, -15.0, 0.0, 15.0, 30.0]).tolist()
    assert ranges_of(angles, [True, True, False, False, True]) == "-30 to -15, 30"
    assert ranges_of(angles, [True] * 5) == "all"
    assert ranges_of(angles, [False] * 5) == "no"
    assert ranges_of([None], [True]) == "yes"
    assert ranges_of([0.0, 0.1, 0.2], [False, True, True], rail=True) == "100 to 200"


def test_an_arm_reaches_along_its_rail(capsys, sliding_robots):
    """By hand: its shoulder gets to y = 0.25 + 1.5 m, and its tool less than 0.75 m farther."""
    Path("rails").mkdir()
    sliding_robots.write_robot(Path("rails"), {}, own=sliding_robots.RAIL)
    found = document(capsys, "rails", "--height", "-0.2", "--step", "0.1")
    rows = np.nonzero(np.array(found["positions"]["left"]).any(axis=1))[0]
    assert 1.75 < found["y"][rows.max()] < 2.5


def test_a_lift_has_rows_in_millimetres(capsys, sliding_robots):
    """The higher the lift, the less it reaches of a low table; areas are by position, between its limits."""
    Path("lift").mkdir()
    sliding_robots.write_robot(Path("lift"), {"lift": sliding_robots.LIFT})
    found = document(capsys, "lift", "--height", "0.3", "--step", "0.1")
    assert found["platform_unit"] == "m"
    assert found["platform"][0] == -0.2
    assert found["platform"][-1] == 0.5
    assert found["area"]["left"][0] > found["area"]["left"][-1]
    assert run(["robot", "reach", "lift", "--height", "0.3", "--step", "0.1"]) == 0
    assert "platform mm" in capsys.readouterr().out
