"""`dualarm curve`: what it prints, writes and refuses, and that its CSV is a curve again."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.files.tasks.tasks import load_job

TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: home
tasks:
  - id: seam
    coordinate:
      master: left
      slave: right
      curve: {curve}
      part: {{xyz: [0, 0, 200 mm]}}
      {speed}
"""
SADDLE = (
    "{kind: saddle, main_radius: 50 mm, branch_radius: 40 mm, angle: 70 deg, eccentricity: 3 mm, "
    "xyz: [0, 0, 10 mm], rpy: [0.1, 0.2, 0.3]}"
)


@pytest.fixture
def qin(tasks_folder: Path) -> str:
    """The paper's two curves."""
    return str(tasks_folder / "papers" / "qin_curves" / "tasks.yaml")


@pytest.fixture
def project(tmp_path: Path, tasks_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a cell and a saddle that is slanted, off the middle and placed somewhere."""
    (tmp_path / "dualarm.toml").write_text("")
    cell = (tasks_folder / "papers" / "qin_curves" / "cell.yaml").read_text()
    (tmp_path / "cell.yaml").write_text(cell)
    (tmp_path / "tasks.yaml").write_text(TASKS.format(curve=SADDLE, speed="speed: 100 mm/s"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rows(text: str) -> list[list[str]]:
    """The cells of the printed tables."""
    return [
        [c.strip() for c in line.split("│")[1:-1]] for line in text.splitlines() if line[0] == "│"
    ]


def test_the_paper_s_curves_as_a_user_sees_them(qin: str, capsys) -> None:
    """308.745 and 125.664 mm, points every 0.8 mm; Euler is off by 3.3 um on the saddle, by nothing on the circle."""
    assert run(["curve", qin]) == 0
    out = capsys.readouterr().out
    assert "saddle: 308.745 mm, a point every 0.8 mm (every 4 ms at 200 mm/s)" in out
    # Circle of 20 mm: 40 pi.
    assert "arc: 125.664 mm" in out
    table = rows(out)
    # 308.745 / 0.8 is 385.9 and 125.664 / 0.8 is 157.1: both ends, and a shorter last step.
    assert table[0] == ["points", "387", "387"]
    assert table[9] == ["points", "159", "159"]
    assert table[1] == ["spacing error um", "< 0.001", "3.285"]
    assert table[10] == ["spacing error um", "< 0.001", "< 0.001"]
    # 308.7447 - 385 * 0.8.
    assert table[4][:2] == ["last step mm", "0.7447"]
    # 0.8² / 8 / 20 mm is 4 um for the circle.
    assert table[14][:2] == ["chord error um", "4.000"]
    assert 4.0 <= float(table[15][1]) <= 4.004
    assert run(["curve", qin]) == 0
    assert capsys.readouterr().out == out


def test_json_has_the_same_numbers(qin: str, capsys) -> None:
    """In SI; ten milliseconds are 2 mm at 200 mm/s; the bound is above the error."""
    assert run(["curve", qin, "--task", "saddle", "--step", "10 ms", "--json"]) == 0
    words = capsys.readouterr()
    document = json.loads(words.out)
    assert document["format"] == "dualarm.curve/1"
    (curve,) = document["curves"]
    assert (curve["task"], curve["interval"], curve["speed"]) == ("saddle", 0.01, 0.2)
    assert curve["step"] == pytest.approx(0.002)
    assert round(curve["length"], 5) == 0.30874
    euler, ours = curve["methods"]["euler"], curve["methods"]["arc_length"]
    assert euler["spacing_error"] == pytest.approx(20.6e-6, rel=1e-2)
    assert ours["spacing_error"] < 1e-11
    for method in (euler, ours):
        assert method["chord_error"] <= method["chord_bound"] <= 1.01 * method["chord_error"]
        assert method["least_dot"] > 0.99


def test_the_csv_is_a_curve_again(project: Path, capsys) -> None:
    """Written every 0.5 mm and read as poses: the same points, frames and length; quaternions never change sides."""
    assert run(["curve", "tasks.yaml", "--spacing", "0.5 mm", "--out", "seam.csv"]) == 0
    assert "written: seam.csv" in capsys.readouterr().err
    work = load_job("tasks.yaml").tasks[0].seam
    assert work is not None
    lines = Path("seam.csv").read_text().splitlines()
    assert lines[0] == "s,x,y,z,qx,qy,qz,qw"
    table = np.array([[float(v) for v in line.split(",")] for line in lines[1:]])
    assert table[1:-1, 0] == pytest.approx(5e-4 * np.arange(1, len(table) - 1))
    assert table[-1, 0] == work.length
    assert (table[1:, 4:] * table[:-1, 4:]).sum(axis=1).min() > 0.99
    assert np.linalg.norm(table[:, 4:], axis=1) == pytest.approx(1.0)
    R, p = work.curve.at(table[:, 0])
    assert table[:, 1:4] == pytest.approx(p, abs=1e-15)
    again = TASKS.format(curve="{kind: poses, file: seam.csv}", speed="speed: 100 mm/s")
    (project / "again.yaml").write_text(again)
    other = load_job("again.yaml").tasks[0].seam
    assert other is not None
    assert other.length == pytest.approx(work.length, abs=1e-8)
    share = np.linspace(0.0, 1.0, 997)
    R, p = work.curve.at(share * work.length)
    S, q = other.curve.at(share * other.length)
    assert np.abs(p - q).max() < 1e-8
    assert np.abs(R - S).max() < 1e-4


def test_poses_have_no_euler_step_and_say_so(project: Path, capsys) -> None:
    """The frames' x is compared with the curve instead."""
    assert run(["curve", "tasks.yaml", "--out", "seam.csv", "--quiet"]) == 0
    (project / "again.yaml").write_text(
        TASKS.format(curve="{kind: poses, file: seam.csv}", speed="speed: 100 mm/s")
    )
    assert run(["curve", "again.yaml"]) == 0
    out = capsys.readouterr().out
    assert "no Euler steps: a curve through poses has no parameter of its own" in out
    assert all(len(row) == 2 for row in rows(out))
    assert float(rows(out)[-1][1]) < 0.02
    assert rows(out)[-1][0] == "x off the curve deg"
    assert run(["curve", "again.yaml", "--json"]) == 0
    (curve,) = json.loads(capsys.readouterr().out)["curves"]
    assert list(curve["methods"]) == ["arc_length"]


def test_a_duration_gives_the_speed_on_average(project: Path, capsys) -> None:
    """0.2 m in 4 s are 50 mm/s: 0.2 mm in 4 ms, 1001 points; and a line has no error at all."""
    line = "{kind: line, start: [0, 0, 0], end: [0.2, 0, 0]}"
    (project / "tasks.yaml").write_text(TASKS.format(curve=line, speed="duration: 4 s"))
    assert run(["curve", "tasks.yaml"]) == 0
    out = capsys.readouterr().out
    assert "seam: 200.000 mm, a point every 0.2 mm (every 4 ms at 50 mm/s on average)" in out
    assert rows(out)[0] == ["points", "1001", "1001"]
    assert rows(out)[6] == ["at most, proven um", "< 0.001", "< 0.001"]
    assert "the curve is straight" in out


def test_quiet_prints_nothing(project: Path, capsys) -> None:
    """Files are written all the same."""
    assert run(["curve", "tasks.yaml", "--quiet", "--out", "a.csv"]) == 0
    words = capsys.readouterr()
    assert (words.out, words.err) == ("", "")
    assert Path("a.csv").stat().st_size > 10_000


@pytest.mark.parametrize("kind", ["png", "svg", "pdf"])
def test_the_figure_is_the_same_every_time(kind: str, qin: str, tmp_path: Path, capsys) -> None:
    """Two runs, the same bytes; and something is on it."""
    digests = []
    for k in range(2):
        file = tmp_path / f"figure{k}.{kind}"
        assert run(["curve", qin, "--spacing", "5 mm", "--plot", str(file)]) == 0
        digests.append(hashlib.sha256(file.read_bytes()).hexdigest())
        assert file.stat().st_size > 10_000
    assert digests[0] == digests[1]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--step", "4 mm"], "--step: unit 'mm' in '4 mm' is not one of time"),
        (["--step", "0"], "--step 0: must be above 0 s"),
        (["--step", "nan"], "--step: 'nan' is not a number"),
        (["--step", "-1 ms"], "--step -1 ms: must be above 0 s"),
        (["--step", "1 us"], "--step: unit 'us'"),
        # 100 mm/s times 0.01 ms is 1 um; about 0.3 m by 2.5 um are more than 100 000.
        (["--step", "0.01 ms"], "task seam would have a point every 1 um; at least 2 um"),
        (["--spacing", "2.5 um"], "points; at most 100000 are allowed"),
        (["--spacing", "1e300"], "--spacing: '1e300' is outside the range of length"),
        (["--spacing", "0"], "--spacing 0: must be above 0 m"),
        (["--spacing", "1 mm", "--step", "4 ms"], "--spacing does not go with --step; keep one"),
        (["--task", "sem"], "--task sem: tasks.yaml has no such coordinate task, did you mean 'seam'? it has seam"),
        (["--plot", "a.gif"], "--plot a.gif: must end in .png, .svg, .pdf"),
        (["--out", "cell.yaml"], "cell.yaml: already exists; add --force to replace it"),
        (["--out", "no/a.csv"], "no/a.csv: there is no folder no"),
    ],
)  # fmt: skip
def test_what_makes_no_sense_is_refused(
    options: list[str], words: str, project: Path, capsys
) -> None:
    """Exit code 2, the option and its value, what to do."""
    assert run(["curve", "tasks.yaml", *options]) == 2
    found = capsys.readouterr()
    assert words in " ".join(found.err.split())
    assert found.out == ""


def test_one_file_holds_one_curve_and_other_tasks_have_none(
    qin: str, tasks_folder: Path, tmp_path: Path, capsys
) -> None:
    """Two curves need --task; picks are no curves."""
    out = tmp_path / "a.csv"
    assert run(["curve", qin, "--out", str(out)]) == 2
    assert "holds one curve; choose with --task: saddle, arc" in capsys.readouterr().err
    assert run(["curve", qin, "--task", "arc", "--out", str(out)]) == 0
    assert run(["curve", qin, "--task", "arc", "--out", str(out), "--force"]) == 0
    assert run(["curve", str(tasks_folder / "04_packing" / "tasks.yaml")]) == 2
    assert "has no coordinate task" in capsys.readouterr().err


def test_steps_longer_than_the_curve_leave_its_ends(project: Path, capsys) -> None:
    """One step from end to end."""
    assert run(["curve", "tasks.yaml", "--spacing", "1 m", "--json"]) == 0
    (curve,) = json.loads(capsys.readouterr().out)["curves"]
    method = curve["methods"]["arc_length"]
    assert (method["points"], method["spacing_error"]) == (2, 0.0)
    assert method["last_step"] == pytest.approx(curve["length"])
    assert method["chord_error"] <= method["chord_bound"]
