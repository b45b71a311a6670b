"""`--out -`: the main result on stdout, and nothing else; what people read goes to stderr."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
import yaml

from dualarm_cli.cli.run import run

Capture = pytest.CaptureFixture[str]


def test_plan_prints_the_schedule_that_it_would_write(
    tasks_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    """The same schedule, but for the hashes of files that are not there."""
    monkeypatch.chdir(tmp_path)
    plan = ["plan", str(tasks_folder / "03_bottin_planar" / "tasks.yaml"), "--effort", "quick"]
    assert run([*plan, "--out", "-"]) == 0
    printed = capsys.readouterr()
    assert "verification: passed" in printed.err
    assert list(tmp_path.iterdir()) == []
    assert run([*plan, "--out", "folder", "--quiet", "--no-page"]) == 0
    written = json.loads((tmp_path / "folder" / "schedule.json").read_text())
    assert json.loads(printed.out) | {"files": {}} == written | {"files": {}}
    assert run([*plan, "--out", "-", "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_other_files_are_printed(tasks_folder: Path, capsys: Capture) -> None:
    """URDF, base file, curve and schema."""
    assert run(["robot", "export", "iiwa14", "--out", "-"]) == 0
    out, err = capsys.readouterr()
    assert "<robot" in out and err == ""
    assert run(["calibrate", str(tasks_folder / "papers/qin_calibration/points.yaml"), "--out", "-"]) == 0  # fmt: skip
    out, err = capsys.readouterr()
    assert yaml.safe_load(out)["dualarm"] == "base/1"
    assert err
    curves = str(tasks_folder / "10_seam" / "tasks.yaml")
    assert run(["curve", curves, "--out", "-"]) == 0
    out, err = capsys.readouterr()
    assert next(csv.reader(io.StringIO(out))) == ["s", "x", "y", "z", "qx", "qy", "qz", "qw"]
    assert err
    assert run(["schema", "cell", "--out", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["title"] == "dualarm cell file"


def test_two_documents_on_stdout_are_refused(tasks_folder: Path, capsys: Capture) -> None:
    tasks = str(tasks_folder / "01_first_pick" / "tasks.yaml")
    points = str(tasks_folder / "papers/qin_calibration/points.yaml")
    for words in (["plan", tasks], ["calibrate", points], ["curve", tasks]):
        assert run([*words, "--out", "-", "--json"]) == 2
        assert "both print on standard output" in capsys.readouterr().err
