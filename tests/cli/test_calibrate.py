"""`dualarm calibrate`: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.files.cells.cells import load_cell

COORDINATES = """\
dualarm: points/1
points:
  - {name: A, left: {xyz: [0, 0, 0]}, right: {xyz: [-1, -2, -3]}}
  - {name: B, left: {xyz: [1, 0, 0]}, right: {xyz: [0, -2, -3]}}
  - {name: C, left: {xyz: [0, 1, 0]}, right: {xyz: [-1, -1, -3]}}
  - {name: D, left: {xyz: [0, 0, 1]}, right: {xyz: [-1, -2, -2]}}
"""


@pytest.fixture
def qin(tasks_folder: Path) -> str:
    """The paper's readings."""
    return str(tasks_folder / "papers" / "qin_calibration" / "points.yaml")


@pytest.fixture
def points(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four points whose transform is a shift by (1, 2, 3), in the working directory."""
    (tmp_path / "dualarm.toml").write_text("")
    file = tmp_path / "points.yaml"
    file.write_text(COORDINATES)
    monkeypatch.chdir(tmp_path)
    return file


def test_the_paper_s_readings_by_the_plain_command(qin: str, capsys) -> None:
    """5.0, 9.0, 4.0 mm by least squares, with the warnings on stderr; the same bytes again."""
    assert run(["calibrate", qin]) == 0
    words = capsys.readouterr()
    assert "T_left_right by least_squares from 3 points" in words.out
    rows = [line for line in words.out.splitlines() if line.startswith("│ P")]
    assert [row.split("│")[2].strip() for row in rows[:3]] == ["5.0", "9.0", "4.0"]
    assert "degrees of freedom" in words.out
    assert "warning: the points are nearly on one line" in words.err
    assert run(["calibrate", qin]) == 0
    assert capsys.readouterr().out == words.out


def test_the_frame_method_prints_the_paper_s_matrix(qin: str, capsys) -> None:
    """As JSON, with the origin that was chosen: P2 as printed, P1 as the text says."""
    found = {}
    for origin in ("P1", "P2", "P3"):
        assert run(["calibrate", qin, "--method", "frame", "--origin", origin, "--json"]) == 0
        found[origin] = json.loads(capsys.readouterr().out)
    assert found["P2"]["format"] == "dualarm.calibration/1"
    xyz = {origin: document["T_left_right"]["xyz"] for origin, document in found.items()}
    np.testing.assert_allclose(xyz["P2"], [-2.7878, 0.2734, -0.0461], atol=5e-4)
    assert xyz["P1"][1] == pytest.approx(0.2778, abs=5e-4)
    # The residual at the origin is 0.
    for k, origin in enumerate(found):
        assert found[origin]["residuals"][k]["distance"] == pytest.approx(0.0, abs=1e-12)
    assert found["P2"]["uncertainty"] is None


def test_the_fit_finds_tool_and_base_height(qin: str, capsys) -> None:
    """347 mm and 335 mm with their uncertainties, in words and as JSON."""
    assert run(["calibrate", qin, "--fit", "tool,base_height", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    for side in ("left", "right"):
        fit = document["fit"][side]
        assert fit["values"]["tool z"] == pytest.approx(0.347, abs=3e-4)
        assert 0.0 < fit["half_widths"]["tool z"] < 2e-4
        assert document["second_joint_height"][side] == pytest.approx(0.335, abs=3e-4)
    assert run(["calibrate", qin, "--fit", "tool,base_height"]) == 0
    words = capsys.readouterr()
    assert "fitted left: tool x" in words.out
    assert "the second joint's axis is then 335.0" in words.out
    assert "treats fitted tools and heights as exact" in words.err


def test_the_result_is_a_base_of_a_cell(points: Path, capsys) -> None:
    """--out writes what `base:` takes: the right robot stands at (1, 2, 3) from the left one."""
    assert run(["calibrate", "points.yaml", "--out", "calibrated.yaml", "--quiet"]) == 0
    words = capsys.readouterr()
    assert (words.out, words.err) == ("", "")
    text = Path("calibrated.yaml").read_text()
    assert text.startswith("dualarm: base/1\n# from points.yaml by dualarm calibrate")
    Path("cell.yaml").write_text(
        "dualarm: cell/1\nrobot: "
        "{left: {robot: qin_150, base: {xyz: [5, 0, 0]}}, right: {robot: qin_150, base: calibrated.yaml}}\n"
    )
    urdf = load_cell("cell.yaml").cell.robot.urdf
    xyz = urdf[urdf.index('name="world_to_right"') :].split('xyz="')[1].split('"')[0]
    np.testing.assert_allclose([float(word) for word in xyz.split()], [6, 2, 3], atol=1e-12)
    assert run(["check", "calibrated.yaml", "points.yaml", "cell.yaml"]) == 0
    out = capsys.readouterr().out
    assert "good: base, a pose relative to the left robot" in out
    assert "good: points, 4 points" in out
    assert run(["calibrate", "points.yaml", "--out", "calibrated.yaml"]) == 2
    assert "add --force" in capsys.readouterr().err
    assert run(["calibrate", "points.yaml", "--out", "calibrated.yaml", "--force"]) == 0


@pytest.mark.parametrize(
    ("old", "new", "code", "words"),
    [
        ("[0, 1, 0]", "[0, 1, .nan]", 2, "points.yaml:5:"),
        ("[0, 1, 0]", "[0, 1e6, 0]", 2, "outside the range of length"),
        (", right: {xyz: [-1, -1, -3]}", "", 2, "'right' is missing"),
        ("dualarm: points/1", "dualarm: cell/1", 2, "required here: points/1"),
        (COORDINATES[COORDINATES.index("  - {name: C") :], "", 3, "2 points do not determine"),
        (COORDINATES[COORDINATES.index("  - {name: B") :], "", 3, "1 point does not determine"),
    ],
)
def test_bad_input_is_2_and_points_that_determine_nothing_are_3(
    old: str, new: str, code: int, words: str, points: Path, capsys
) -> None:
    """Nothing is written in either case."""
    assert old in COORDINATES
    points.write_text(COORDINATES.replace(old, new, 1))
    assert run(["calibrate", "points.yaml", "--out", "calibrated.yaml"]) == code
    assert words in capsys.readouterr().err
    assert not Path("calibrated.yaml").exists()


def test_points_on_a_line_are_3_and_millimetres_without_unit_too(points: Path, capsys) -> None:
    """The message says what to do."""
    lines = "".join(
        f"  - {{name: L{k}, left: {{xyz: [{k}, 0, 0]}}, right: {{xyz: [0, {k}, 1]}}}}\n"
        for k in range(5)
    )
    points.write_text(f"dualarm: points/1\npoints:\n{lines}")
    assert run(["calibrate", "points.yaml"]) == 3
    assert "touch a point far from that line" in capsys.readouterr().err
    points.write_text(COORDINATES.replace("left: {xyz: [1, 0, 0]}", "left: {xyz: [40, 0, 0]}", 1))
    assert run(["calibrate", "points.yaml", "--json"]) == 3
    words = capsys.readouterr()
    assert json.loads(words.out)["exit_code"] == 3
    assert "check the units" in words.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--method", "kabsch"], "method: there is no 'kabsch'"),
        (["--origin", "A"], "only --method frame has an origin"),
        (["--method", "frame", "--origin", "D"], "must be one of the first three points: A, B, C"),
        (["--fit", "tol"], "did you mean 'tool'?"),
        (["--fit", "tool"], "needs joint readings"),
        (["--out", "none/calibrated.yaml"], "there is no folder none"),
    ],
)
def test_options_that_cannot_be_served_are_refused(
    options: list[str], words: str, points: Path, capsys
) -> None:
    """Exit code 2 with the reason."""
    assert run(["calibrate", "points.yaml", *options]) == 2
    assert words in capsys.readouterr().err


def test_solvers_lists_both_methods(capsys) -> None:
    """With the paper's equations."""
    assert run(["solvers", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["solvers"]
    found = {row["name"]: row["reference"] for row in rows if row["family"] == "calibration"}
    assert found["frame"] == "[Qin2024] Eq. 7 to 10"
    assert "[Kabsch1976]" in found["least_squares"]
