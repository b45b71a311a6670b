"""Distributions of drawn plans: by hand, with plans that are a function of the draw; and as the command prints them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
from jsonschema import Draft202012Validator

from dualarm_cli import perturb
from dualarm_cli.cli.run import run
from dualarm_cli.errors import UsageError
from dualarm_cli.evaluation.evaluate import evaluate
from dualarm_cli.evaluation.request import Request
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.model.studies.evaluation import Evaluation, Finding
from dualarm_cli.report.comparison.perturbation_table import (
    perturbation_csv,
    perturbation_sentences,
)
from dualarm_cli.schemas import schema_of
from dualarm_cli.studies.perturbation import perturbation

CELL = "dualarm: cell/1\nrobot: sda10f\nframes: {tray: {xyz: [0.45, 0, 0.8], varies: 4 mm}}\n"
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
tasks:
  - id: a
    arm: left
    move: {at: tray, xyz: [0, 0.2, 0], rpy: [180 deg, 0, 0], varies: {z: 1 mm, yaw: 5 deg}}
    dwell: [0.1, 0.2, 0.4]
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project with a job of one move whose frame, pose and dwell vary."""
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _planned(requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
    """Yields plans, the last draw first: draw k takes 10 + k s, stage b all of it but 4 s; every tenth has no plan."""
    for index, request in reversed(list(enumerate(requests))):
        k = request.draw or 0
        if k % 10 == 3:
            finding = Finding(f"misses by {k} mm")
            yield index, Evaluation(request.case, "infeasible", findings=(finding,))
        else:
            stages = {"a pick": 4.0, "b pick": 6.0 + k, "c pick": 0.0} if k else {"a pick": 4.0}
            stated = {} if k else {"95%": 11.0, "worst": 12.0}
            yield (
                index,
                Evaluation(
                    request.case, "planned", cycle_time=10.0 + k, stages=stages, stated=stated
                ),
            )


def test_the_distribution_is_that_of_the_draws(folder: Path) -> None:
    """By hand: of 1 to 20 without 3 and 13, the ninth is 10 and the eighteenth 20; all variance is stage b's."""
    base = Request.of("tasks.yaml", draw_seed=5)
    document = perturbation(base, load_job("tasks.yaml"), 20, _planned, None)
    assert document["cycle_time"] == {
        "least": 11.0,
        "median": 20.0,
        "percentile_95": 30.0,
        "worst": 30.0,
    }
    assert document["counts"] == {"draws": 20, "planned": 18, "infeasible": 2}
    assert document["varying"] == {"targets": 1, "frames": 1, "dwells": 1}
    assert [row["draw"] for row in document["rows"]] == list(range(1, 21))
    assert [stage["work"] for stage in document["stages"]] == ["b pick", "a pick", "c pick"]
    assert [stage["share"] for stage in document["stages"]] == pytest.approx([1.0, 0.0, 0.0])
    [failure] = document["failures"]
    assert (failure["count"], failure["points"], failure["example"]) == (
        2,
        [3, 13],
        "misses by 3 mm",
    )
    lines = perturbation_sentences(document)
    assert lines[0].startswith(
        "tasks.yaml: 18 of 20 draws of 1 target, 1 frame and 1 dwell have a plan; cycle time: nominal 10.000 s, "
        "median 20.000 s, 95 % of them at most 30.000 s, worst 30.000 s"
    )
    assert "at most 11.000 s, the longest 12.000 s" in lines[1]
    assert lines[2].startswith("reacts: b pick: 7.000 to 26.000 s, 100% of the variance")
    assert lines[-1] == "2 draws without a plan; of draw 3: misses by 3 mm"
    rows = perturbation_csv(document).decode().splitlines()
    assert rows[0] == "draw,status,cycle_time,clearance,reason"
    assert (rows[1], rows[3]) == ("1,planned,11.0,,", "3,infeasible,,,misses by 3 mm")


def test_the_command_prints_what_the_function_returns(folder: Path, capsys, monkeypatch) -> None:
    """Three draws, planned in this process; the nominal plan is the plan of the file; a dwell more is a second more."""

    class Here:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def run(self, requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
            return enumerate(map(evaluate, requests))

        def close(self) -> None:
            pass

    monkeypatch.setattr("dualarm_cli.evaluation.crew.Crew", Here)
    command = ["sweep", "tasks.yaml", "--perturb", "3", "--effort", "quick"]
    assert run([*command, "--json", "--out", "out", "--csv", "rows.csv"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == perturb("tasks.yaml", 3, effort="quick", cache=".dualarm-cache")
    assert [*Draft202012Validator(schema_of("perturbation")).iter_errors(document)] == []
    assert json.loads((folder / "out" / "study.json").read_text()) == document
    assert (folder / "out" / "table.csv").read_bytes() == (folder / "rows.csv").read_bytes()
    assert document["nominal"] < document["stated"]["95%"] < document["stated"]["worst"]
    assert document["stated"]["worst"] == pytest.approx(document["nominal"] + 0.2, abs=1e-6)
    times = [row["cycle_time"] for row in document["rows"]]
    assert len(set(times)) == 3
    assert max(times) < document["stated"]["worst"] + 0.1
    for row in document["rows"]:
        assert sum(row["stages"].values()) == pytest.approx(row["cycle_time"], abs=1e-9)


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        (["--perturb", "2", "--optimise"], "--optimise does not go with --perturb"),
        (["--perturb", "2", "--pages", "p"], "--pages does not go with --perturb"),
        (["--effort", "quick"], "--effort quick: goes with --perturb only"),
        (["--perturb", "2", "--csv", "cell.yaml", "--force"], "is an input of the study"),
    ],
)
def test_options_of_studies_do_not_go_with_draws(
    folder: Path, capsys, options: list[str], wanted: str
) -> None:
    """Nothing is planned."""
    assert run(["sweep", "tasks.yaml", *options]) == 2
    assert wanted in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "wanted"),
    [
        ({"effort": "fast"}, "effort 'fast': choose one of quick, normal, thorough"),
        ({"seed": -1}, "seed -1: must be an integer from 0"),
        ({"draws": 0}, "draws 0: must be an integer from 1"),
    ],
)
def test_values_that_are_not_allowed_are_refused_before_planning(
    folder: Path, options: dict[str, Any], wanted: str
) -> None:
    """As `plan` does."""
    with pytest.raises(UsageError, match=wanted):
        perturb("tasks.yaml", **options)


def test_a_job_in_which_nothing_varies_is_refused(capsys) -> None:
    """With what to write."""
    assert run(["sweep", "01_first_pick", "--perturb", "2"]) == 2
    assert "nothing varies; give targets or frames `varies`" in capsys.readouterr().err
