"""`dualarm sweep` as a user meets it: table, files, exit codes, going on after Ctrl-C, any number of processes."""

from __future__ import annotations

import csv
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from dualarm_cli import UsageError, sweep
from dualarm_cli.cli.run import run
from dualarm_cli.cli.sweep import exit_code
from dualarm_cli.evaluation import crew
from dualarm_cli.evaluation.evaluate import evaluate
from dualarm_cli.evaluation.request import Request
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.studies import search

STUDY = """\
dualarm: study/1
tasks: tasks.yaml
objectives: [cycle_time, travel]
settings: {effort: quick, platform: exact}
parameters:
  x:
    tasks: tasks.P1.move.xyz[0]
    range: {from: 70 mm, to: 90 mm, step: 10 mm}
  y: {tasks: "tasks.P2.move.xyz[1]", values: [0.1, 0.11]}
"""
RANGE = "range: {from: 70 mm, to: 90 mm, step: 10 mm}"


@pytest.fixture
def folder(tmp_path: Path, tasks_folder: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a job of two moves, quick to plan, and a study of six points."""
    (tmp_path / "dualarm.toml").write_text("")
    for file in (tasks_folder / "03_bottin_planar").glob("*.yaml"):
        shutil.copy(file, tmp_path)
    (tmp_path / "study.yaml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class _OneAfterTheOther:
    """Evaluates in this process: what a crew's processes come to, without waiting until they have loaded."""

    def __init__(
        self, _processes: int, timeout: float | None = None, until: float | None = None
    ) -> None:
        """Takes what a crew takes."""
        assert timeout is until is None

    def run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        """Yields answers in the order of the requests."""
        for index, request in enumerate(requests):
            yield index, evaluate(request)

    def close(self) -> None:
        """Has nothing to end."""


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Lets all that follows be planned in this process."""
    return lambda: monkeypatch.setattr("dualarm_cli.evaluation.crew.Crew", _OneAfterTheOther)


def test_a_study_is_planned_ranked_and_written(folder, here, capsys) -> None:
    """Six points and the files as they are, one of which is among them: six plans; then none."""
    assert run(["sweep", "study.yaml", "--out", "out", "--csv", "rows.csv", "--jobs", "2"]) == 0
    out, err = capsys.readouterr()
    assert "study.yaml: 6 of 6 points have a plan" in out
    assert "what matters" in out
    (best_line,) = (line for line in out.splitlines() if line.startswith("best cycle time: "))
    assert "6 jobs planned, 1 cached" in err
    document = json.loads((folder / "out" / "study.json").read_text())
    rows = document["rows"]
    assert document["counts"]["planned"] == len(rows) == 6
    assert {(r["values"]["x"], r["values"]["y"]) for r in rows} == {
        (x, y) for x in (70, 80, 90) for y in (0.1, 0.11)
    }
    best = [row["cycle_time"] for row in rows if row["pareto"]]
    assert rows[0]["cycle_time"] == min(best) == min(row["cycle_time"] for row in rows)
    (same,) = [row for row in rows if row["values"] == {"x": 80.0, "y": 0.1}]
    assert same["cycle_time"] == document["reference"]["cycle_time"]
    assert (folder / "out" / "table.csv").read_text() == (folder / "rows.csv").read_text()
    table = list(csv.DictReader(io.StringIO((folder / "rows.csv").read_text())))
    assert [float(row["x [mm]"]) for row in table] == [row["values"]["x"] for row in rows]
    assert [float(row["cycle_time"]) for row in table] == [row["cycle_time"] for row in rows]
    for picture in ("pareto.png", "sensitivity.png"):
        assert (folder / "out" / picture).read_bytes().startswith(b"\x89PNG")
    # Again: nothing is planned, and all files are the same to the byte, by this process as by two others.
    here()
    assert run(["sweep", "study.yaml", "--out", "again"]) == 0
    assert "0 jobs planned, 7 cached" in capsys.readouterr().err
    for name in ("study.json", "table.csv", "pareto.png", "sensitivity.png"):
        assert (folder / "out" / name).read_bytes() == (folder / "again" / name).read_bytes()
    assert run(["sweep", "study.yaml", "--no-cache", "--json", "-q"]) == 0
    captured = capsys.readouterr()
    assert captured.out == (folder / "out" / "study.json").read_text()
    assert captured.err == ""
    assert run(["sweep", "study.yaml", "-q"]) == 0
    assert capsys.readouterr() == (f"study.yaml: 6 of 6 points have a plan; {best_line}\n", "")
    said: list[str] = []
    assert sweep("study.yaml", progress=said.append) == document
    assert said[-1] == f"6 of 6 points, best cycle time {rows[0]['cycle_time']:.3f} s"
    # A mapping, and the bundled job that the files are copies of.
    values = yaml.safe_load(STUDY)
    assert sweep(values)["rows"] == rows
    bundled = sweep(values | {"tasks": "03_bottin_planar"})
    assert (
        bundled["tasks"]
        == [job["tasks"] for job in bundled["rows"][0]["jobs"]]
        == ["03_bottin_planar"]
    )
    assert [row["cycle_time"] for row in bundled["rows"]] == [row["cycle_time"] for row in rows]
    for wrong in ({"budget": 0}, {"processes": 0}, {"budget": "10"}, {"processes": 1.5}):
        with pytest.raises(UsageError, match="must be an integer from 1"):
            sweep("study.yaml", **wrong)


def test_points_without_a_plan_do_not_stop_others(folder, here, capsys) -> None:
    """900 mm is out of reach; where all are, the exit code is 3."""
    here()
    (folder / "study.yaml").write_text(STUDY.replace(RANGE, "values: [80 mm, 900 mm]"))
    assert run(["sweep", "study.yaml", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["counts"] == {
        "points": 4,
        "planned": 2,
        "pareto": document["counts"]["pareto"],
        "infeasible": 2,
    }
    (failure,) = document["failures"]
    assert (failure["status"], failure["count"]) == ("infeasible", 2)
    assert "tasks.yaml:" in failure["example"]
    (folder / "study.yaml").write_text(STUDY.replace(RANGE, "values: [900 mm]"))
    assert run(["sweep", "study.yaml"]) == 3
    assert (
        "2 points without a plan; of the first (x 900 mm, y 0.1): tasks.yaml:"
        in capsys.readouterr().out
    )


def test_a_bad_value_is_a_row_of_its_own(folder, here, capsys) -> None:
    """Told of the study file; the others are planned, and the exit code is 2."""
    here()
    (folder / "study.yaml").write_text(STUDY.replace("values: [0.1, 0.11]", "values: [0.1, 2000]"))
    assert run(["sweep", "study.yaml"]) == 2
    out = capsys.readouterr().out
    assert "3 of 6 points have a plan" in out
    assert (
        "3 points with bad input; of the first (x 70 mm, y 2000): study.yaml:9:3: E200 parameter 'y' makes tasks.P2"
        in out
    )
    assert "did you mean '2000 mm'" in out


def test_a_time_out_is_a_row_of_its_own(folder, capsys, monkeypatch) -> None:
    """No plan is made in a millisecond; one attempt at each is enough here, as each takes a process of its own."""
    monkeypatch.setattr(crew, "CREW", replace(crew.CREW, attempts=1))
    text = STUDY.replace(RANGE, "values: [80 mm]").replace("values: [0.1, 0.11]", "values: [0.1]")
    (folder / "study.yaml").write_text(text)
    assert run(["sweep", "study.yaml", "--timeout", "1 ms", "--jobs", "1"]) == 3
    assert (
        "1 point timed out (x 80 mm, y 0.1): tasks.yaml: took longer than 0.001 s"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--budget", "5"], "--budget 5: goes with --optimise only"),
        (["--seed", "5"], "--seed 5: goes with --optimise only"),
        (["--timeout", "x"], "--timeout: 'x' is not a number"),
        (["--jobs", "2", "--scheduler", "tcp://x"], "--jobs does not go with --scheduler"),
        (["--cache", "a", "--no-cache"], "--cache does not go with --no-cache"),
        (["--csv", "none/a.csv"], "--csv none/a.csv: there is no folder none"),
        (["--csv", "tasks.yaml"], "--csv tasks.yaml: already exists; add --force"),
        (["--out", "tasks.yaml"], "--out tasks.yaml: is a file"),
        (
            ["--csv", "study.yaml", "--force"],
            "--csv study.yaml: is an input of the study",
        ),
        (["--csv", "./cell.yaml", "--force"], "--csv cell.yaml: is an input of the study"),
        (
            ["--csv", "o/study.json", "--out", "o", "--force"],
            "--csv o/study.json: is a file of --out",
        ),
        (
            ["--scheduler", "foo"],
            "--scheduler 'foo': is not an address; write one such as tcp://10.0.0.1:8786",
        ),
    ],
)
def test_options_that_cannot_be_are_refused_before_anything_is_planned(
    options, message, folder, capsys
) -> None:
    """Exit code 2, one sentence; what is there stays as it is."""
    (folder / "o").mkdir()
    (folder / "o" / "study.json").write_text("{}")
    before = {path: path.read_bytes() for path in folder.rglob("*.*")}
    assert run(["sweep", "study.yaml", *options]) == 2
    captured = capsys.readouterr()
    assert message in captured.err
    assert captured.out == ""
    assert {path: path.read_bytes() for path in folder.rglob("*.*")} == before


def test_figures_of_an_earlier_study_do_not_stay_beside_what_has_no_plan(
    folder, here, capsys
) -> None:
    """They would be taken for this one's."""
    (folder / "study.yaml").write_text(STUDY.replace(RANGE, "values: [900 mm]"))
    here()
    (folder / "out").mkdir()
    for name in ("study.json", "pareto.png", "sensitivity.png"):
        (folder / "out" / name).write_text("old")
    assert run(["sweep", "study.yaml", "--out", "out", "--force"]) == 3
    captured = capsys.readouterr()
    assert "study.yaml: none of 2 points has a plan" in captured.out
    assert "pareto.png and sensitivity.png are not drawn: no point has a plan" in captured.err
    assert {path.name for path in (folder / "out").iterdir()} == {"study.json", "table.csv"}
    assert json.loads((folder / "out" / "study.json").read_text())["counts"]["planned"] == 0


def test_a_wrong_study_is_refused_with_all_that_is_wrong(folder, capsys) -> None:
    """With places and source lines."""
    text = STUDY.replace("tasks.P1.move", "tasks.P3.move").replace("effort: quick", "effort: quik")
    (folder / "study.yaml").write_text(text)
    assert run(["sweep", "study.yaml"]) == 2
    assert "error[E200]: study.yaml:4:20: 'quik' is not allowed" in capsys.readouterr().err


def test_the_missing_extra_names_itself(folder, capsys, monkeypatch) -> None:
    """Before anything is planned."""
    monkeypatch.setattr("importlib.util.find_spec", lambda name, *_: None)
    assert run(["sweep", "study.yaml", "--optimise"]) == 2
    assert "optuna is not installed: pip install 'dualarm[optimise]'" in capsys.readouterr().err


def test_a_search_is_the_same_whatever_the_number_of_processes(
    folder, here, capsys, monkeypatch
) -> None:
    """To the byte, by two others or by this one; five points are three batches of two, each from what came before."""
    pytest.importorskip("optuna")
    monkeypatch.setattr(search, "SEARCH", replace(search.SEARCH, batch=2))
    (folder / "study.yaml").write_text(STUDY.replace(RANGE, "range: {from: 70 mm, to: 90 mm}"))
    documents = []
    arguments = ["--optimise", "--budget", "5", "--no-cache", "--jobs", "2", "--json", "-q"]
    for prepare in (lambda: None, here):
        prepare()
        assert run(["sweep", "study.yaml", *arguments]) == 0
        documents.append(capsys.readouterr().out)
    assert documents[0] == documents[1]
    document = json.loads(documents[0])
    assert document["method"] == {"name": "optimise", "budget": 5, "seed": 0, "batch": 2}
    assert document["counts"]["points"] == 5


def test_a_budget_for_all_points_finds_the_optimum(folder, here, capsys) -> None:
    """The search and the enumeration have the same rows."""
    pytest.importorskip("optuna")
    here()
    assert run(["sweep", "study.yaml", "--json", "-q"]) == 0
    whole = json.loads(capsys.readouterr().out)
    assert run(["sweep", "study.yaml", "--optimise", "--budget", "6", "--json", "-q"]) == 0
    searched = json.loads(capsys.readouterr().out)
    assert searched["rows"] == whole["rows"]


@pytest.mark.parametrize(
    ("counts", "code"),
    [
        ({"planned": 3, "infeasible": 2, "timed_out": 1}, 0),
        ({"planned": 3, "fails_verification": 1}, 1),
        ({"planned": 0, "fails_verification": 1, "infeasible": 1}, 1),
        ({"planned": 0, "infeasible": 1, "timed_out": 1}, 3),
        ({"planned": 3, "bad_input": 1, "fails_verification": 1}, 2),
        ({"planned": 0, "bad_input": 1}, 2),
        ({"planned": 3, "crashed": 1, "bad_input": 1}, 4),
        ({"planned": 3, "internal_error": 1}, 4),
    ],
)
def test_the_most_severe_end_counts(counts, code) -> None:
    """In the order 4, 2, 3, 1, 0; points without a plan beside others that have one are a result."""
    assert exit_code({"counts": counts}) == code


def test_ctrl_c_ends_it_at_once_and_the_next_run_goes_on(folder, here, capsys) -> None:
    """130 within 2 s, no process left; what was planned is not planned again."""
    (folder / "study.yaml").write_text(STUDY.replace("step: 10 mm", "step: 0.5 mm"))
    command = [sys.executable, "-m", "dualarm_cli", "sweep", "study.yaml", "--jobs", "1"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    kept = folder / ".dualarm-cache" / "answers"
    until = time.monotonic() + 60
    while len(list(kept.glob("*/*.json"))) < 3 and time.monotonic() < until:
        time.sleep(0.05)
    children = _children(process.pid)
    assert children
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=10)
    assert time.monotonic() - begun < 2.0
    assert process.returncode == 130
    assert "run the same command to continue" in err
    assert not [pid for pid in children if _lives(pid)]
    done = len(list(kept.glob("*/*.json")))
    assert 3 <= done < 82
    (folder / "study.yaml").write_text(
        STUDY.replace("step: 10 mm", "step: 0.5 mm").replace("to: 90", "to: 70.5")
    )
    here()
    assert run([*command[3:], "--quiet", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["counts"]["planned"] == 4
    # Four points and the files as they are; the first ones were known.
    assert len(list(kept.glob("*/*.json"))) == max(done, 5)


def _children(pid: int) -> list[int]:
    """Returns the processes that a process has started."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = entry.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(entry.parent.name))
    return found


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
def test_a_cluster_gives_the_same_bytes(folder, capsys) -> None:
    """As processes of this machine do; a cluster that is not there is exit 2."""
    distributed = pytest.importorskip("distributed")
    arguments = ["sweep", "study.yaml", "--no-cache", "--json", "-q"]
    assert run([*arguments, "--jobs", "1"]) == 0
    local = capsys.readouterr().out
    options = {
        "n_workers": 2,
        "threads_per_worker": 1,
        "processes": True,
        "dashboard_address": None,
    }
    with distributed.LocalCluster(**options) as cluster:
        address = cluster.scheduler_address
        assert run([*arguments, "--scheduler", address]) == 0
        assert capsys.readouterr().out == local
    assert run([*arguments, "--scheduler", address]) == 2
    assert "no scheduler answers there" in capsys.readouterr().err
