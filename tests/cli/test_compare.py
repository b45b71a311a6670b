"""`dualarm compare` as a user meets it: files, exit codes, streams, schedules from elsewhere."""

from __future__ import annotations

import csv
import hashlib
import io
import json

import pytest

from dualarm_cli.cli.run import run

SOME = ["--method", "fixed", "--method", "exact"]


@pytest.fixture(scope="module")
def planar(tasks_folder):
    """A job of two moves: quick to plan."""
    return tasks_folder / "03_bottin_planar" / "tasks.yaml"


@pytest.fixture(scope="module")
def plans(tmp_path_factory, planar):
    """Two plans of it."""
    folder = tmp_path_factory.mktemp("plans")
    for name in ("fixed", "exact"):
        out = str(folder / name)
        assert run(["plan", str(planar), "--platform", name, "--out", out, "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def far(tmp_path_factory):
    """A job that nobody can do."""
    folder = tmp_path_factory.mktemp("far")
    (folder / ".git").mkdir()
    (folder / "cell.yaml").write_text("dualarm: cell/1\nrobot: sda10f\n")
    (folder / "tasks.yaml").write_text(
        "dualarm: tasks/1\ncell: cell.yaml\ntasks:\n"
        "  - id: far\n    arm: left\n    move: {xyz: [3, 0, 1], rpy: [180 deg, 0, 0]}\n"
    )
    return folder / "tasks.yaml"


def test_solvers_prints_a_table_and_names_the_winner(planar, capsys):
    """Cycle times by row, the sentence last; nothing of progress without a terminal."""
    assert run(["compare", "solvers", str(planar), *SOME]) == 0
    out, err = capsys.readouterr()
    assert "cycle s" in out
    assert "verified" in out
    assert "is the fastest with" in out.replace("\n", " ")
    assert err == ""


def test_json_is_one_document_and_wall_clock_is_its_last_member(planar, capsys):
    """Rows by cycle time; every planning time under `wall_clock`, none elsewhere."""
    assert run(["compare", "solvers", str(planar), *SOME, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["format"] == "dualarm.comparison/1"
    assert list(document)[-1] == "wall_clock"
    (section,) = document["comparisons"]
    cycles = [row["cycle_time"] for row in section["rows"]]
    assert cycles == sorted(cycles)
    assert section["winner"]["method"] == section["rows"][0]["method"]
    assert [entry["method"] for entry in document["wall_clock"]] == [
        row["method"] for row in section["rows"]
    ]
    assert "planning_time" not in json.dumps(document["comparisons"])


def test_out_holds_three_files_that_are_the_same_but_for_the_wall_clock(planar, tmp_path):
    """The figure byte by byte, JSON without its last member, CSV without its last column."""
    seen = []
    for name in ("one", "two"):
        out = tmp_path / name
        assert run(["compare", "solvers", str(planar), *SOME, "--out", str(out), "-q"]) == 0
        assert sorted(file.name for file in out.iterdir()) == [
            "comparison.csv",
            "comparison.json",
            "comparison.png",
        ]
        document = json.loads((out / "comparison.json").read_text())
        del document["wall_clock"]
        rows = list(csv.reader(io.StringIO((out / "comparison.csv").read_text())))
        figure = hashlib.sha256((out / "comparison.png").read_bytes()).hexdigest()
        seen.append((document, [row[:-1] for row in rows], figure))
    assert seen[0] == seen[1]


def test_results_are_not_overwritten_unasked(planar, tmp_path, capsys):
    """Refused before any planning; a schedule beside them is nobody's business."""
    (tmp_path / "schedule.json").write_text("mine")
    arguments = ["compare", "solvers", str(planar), *SOME, "--out", str(tmp_path)]
    assert run([*arguments, "--quiet"]) == 0
    assert run(arguments) == 2
    assert "already holds comparison.json; add --force" in capsys.readouterr().err
    assert run([*arguments, "--quiet", "--force"]) == 0
    assert (tmp_path / "schedule.json").read_text() == "mine"


def test_quiet_prints_the_sentence_only(planar, tmp_path, capsys):
    """No table, and not where the files went."""
    figure = tmp_path / "figure.svg"
    assert run(["compare", "solvers", str(planar), *SOME, "-q", "--plot", str(figure)]) == 0
    out, err = capsys.readouterr()
    assert (out.count("\n"), out.partition(" with ")[0], err) == (1, "fixed is the fastest", "")
    assert figure.read_bytes().startswith(b"<?xml")


def test_without_task_files_the_bundled_ones_are_compared(
    monkeypatch, planar, tasks_folder, capsys
):
    """By the names of their folders; here only two of them, to be quick."""
    import dualarm_cli.files.source.bundled as bundled

    assert sorted(bundled.bundled_tasks()) == sorted(
        entry.name for entry in tasks_folder.iterdir() if (entry / "tasks.yaml").is_file()
    )
    some = {"03_bottin_planar": planar, "01": tasks_folder / "01_first_pick" / "tasks.yaml"}
    monkeypatch.setattr(bundled, "bundled_tasks", lambda *_: some)
    assert run(["compare", "solvers", *SOME, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [section["tasks"] for section in document["comparisons"]] == list(some)


def test_a_job_that_no_method_can_do_is_exit_3_with_its_rows(far, capsys):
    """The table is printed all the same, with the place of the task."""
    assert run(["compare", "solvers", str(far), "--method", "fixed"]) == 3
    out = capsys.readouterr().out.replace("\n", " ")
    assert "infeasible" in out
    assert "tasks.yaml:6:" in out
    assert "no method finds a plan" in out


@pytest.mark.parametrize("first", [True, False])
def test_a_stop_out_of_reach_is_a_row_with_its_reason_wherever_it_is(
    tasks_folder, tmp_path, first, capsys
):
    """The first or the last stop of an arm; the lower bound says nothing then."""
    cell = tasks_folder / "04_packing" / "cell.yaml"
    (tmp_path / "tasks").mkdir()
    (tmp_path / "tasks" / "cell.yaml").write_text(cell.read_text())
    near, far = "[0.5, 0.3, 0.9]", "[2.5, 0.3, 0.9]"
    places = (far, near) if first else (near, far)
    moves = "".join(
        f"  - {{id: m{k}, arm: left, move: {{xyz: {place}, rpy: [180 deg, 0, 0]}}}}\n"
        for k, place in enumerate(places)
    )
    file = tmp_path / "tasks" / "tasks.yaml"
    file.write_text(f"dualarm: tasks/1\ncell: cell.yaml\ntasks:\n{moves}")
    assert run(["compare", "solvers", str(file), "--method", "fixed", "--json"]) == 3
    out, err = capsys.readouterr()
    [section] = json.loads(out)["comparisons"]
    assert section["lower_bound"] is None
    assert [row["status"] for row in section["rows"]] == ["infeasible"]
    assert "Traceback" not in err


def test_methods_that_do_not_serve_are_rows_and_exit_2_where_none_does(tasks_folder, capsys):
    """Two robots without a platform."""
    robots = str(tasks_folder / "05_two_robots" / "tasks.yaml")
    assert run(["compare", "solvers", robots, "--method", "exact"]) == 2
    assert "exact: not served: it is not two arms" in capsys.readouterr().out
    assert run(["compare", "solvers", robots, *SOME, "--json"]) == 0
    (section,) = json.loads(capsys.readouterr().out)["comparisons"]
    assert [row["status"] for row in section["rows"]] == ["verified", "not served"]


def test_a_plan_that_fails_its_verification_is_exit_1_and_never_wins(monkeypatch, planar, capsys):
    """A verifier that fails the faster of the two."""
    from dualarm_cli import interface
    from dualarm_cli.model.verification import Check, Verification

    real = interface.judged

    def strict(schedule, job=None, clearance=False):
        if schedule.provenance.settings["platform"] == "fixed":
            return Verification((Check("velocity", "failed", 2.0, 1.0, "", "left_1"),))
        return real(schedule, job, clearance=clearance)

    monkeypatch.setattr(interface, "judged", strict)
    assert run(["compare", "solvers", str(planar), *SOME, "--json"]) == 1
    (section,) = json.loads(capsys.readouterr().out)["comparisons"]
    assert section["winner"]["method"] == "exact"
    assert section["rows"][1]["status"] == "failed"
    assert section["rows"][1]["cycle_time"] < section["rows"][0]["cycle_time"]
    assert run(["compare", "solvers", str(planar), "--method", "fixed", "--json"]) == 1
    (section,) = json.loads(capsys.readouterr().out)["comparisons"]
    assert section["winner"] is None


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["solvers", "nowhere.yaml", "nothere.yaml"], ["nowhere.yaml", "nothere.yaml"]),
        (["solvers", "--method", "exat"], ["did you mean 'exact'"]),
        (["solvers", "--timing", "nope"], ["timing: there is no 'nope'"]),
        (["solvers", "--redundancy", "nope"], ["redundancy: there is no 'nope'"]),
        (["solvers", "--effort", "most"], ["--effort"]),
        (["solvers", "--out", ""], ["--out ''"]),
        (["solvers", "--plot", "x.gif"], ["must end in .png, .svg, .pdf"]),
        (["solvers", "--plot", "nofolder/x.png"], ["there is no folder nofolder"]),
        (["schedules", "nowhere", "nothere"], ["nowhere", "there is no such file"]),
        (["schedules", "."], ["Missing argument 'B'"]),
    ],
)
def test_bad_usage_is_exit_2_with_what_was_wrong(arguments, words, capsys):
    """Nothing on stdout, no traceback, no work done."""
    assert run(["compare", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert all(word in err for word in words)


def test_schedules_are_compared_stage_by_stage(plans, tmp_path, capsys):
    """Folders or files; --out writes JSON and CSV; slower is no failure."""
    out = tmp_path / "out"
    pair = [str(plans / "fixed"), str(plans / "exact" / "schedule.json")]
    assert run(["compare", "schedules", *pair, "--out", str(out)]) == 0
    text = capsys.readouterr().out
    assert "P1 move, P2 move" in text
    assert "slower than A" in text.replace("\n", " ")
    assert sorted(file.name for file in out.iterdir()) == ["schedules.csv", "schedules.json"]
    assert run(["compare", "schedules", *pair, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads((out / "schedules.json").read_text())
    durations = [
        json.loads((plans / n / "report.json").read_text())["cycle_time"]
        for n in ("fixed", "exact")
    ]
    assert document["difference"] == pytest.approx(durations[1] - durations[0])


def test_identical_schedules_are_said_to_be(plans, capsys):
    """No table."""
    assert run(["compare", "schedules", *[str(plans / "fixed")] * 2]) == 0
    assert capsys.readouterr().out.startswith("A and B are identical: ")


def edited(plans, tmp_path, change, name="fixed"):
    """A copy of a plan whose document went through `change`."""
    document = json.loads((plans / name / "schedule.json").read_text())
    change(document)
    folder = tmp_path / f"edited-{name}"
    folder.mkdir()
    (folder / "robot.urdf").write_text((plans / name / "robot.urdf").read_text())
    (folder / "schedule.json").write_text(json.dumps(document))
    return str(folder)


def test_a_schedule_from_elsewhere_without_stages_is_compared(plans, tmp_path, capsys):
    """It states trajectory and events only."""

    def strip(document):
        for name in ("stages", "segments", "provenance"):
            del document[name]
        document["robot"].pop("limits")

    foreign = edited(plans, tmp_path, strip)
    assert run(["compare", "schedules", str(plans / "exact"), foreign]) == 0
    assert "note: B states no stages and no segments" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["motion"]["left"]["time"].__setitem__(2, float("nan")), "is not finite"),
        (lambda d: d["motion"]["left"]["time"].reverse(), "do not increase"),
        (lambda d: d["stages"][0].__setitem__("end", -1), "stage 1 ends before it starts"),
        (
            lambda d: [e.__setitem__("task", "x" + e["task"]) for e in d["events"] + d["segments"]],
            "no common stages",
        ),
        (lambda d: d.__setitem__("format", "other/1"), "other/1"),
    ],
)
def test_schedules_that_cannot_be_compared_are_exit_2(plans, tmp_path, change, words, capsys):
    """Broken or of other work."""
    broken = edited(plans, tmp_path, change)
    assert run(["compare", "schedules", str(plans / "fixed"), broken]) == 2
    assert words in capsys.readouterr().err


def test_names_from_files_do_not_steer_the_terminal(plans, tmp_path, capsys):
    """Escape codes and lone surrogates are spelt out, markup is text."""

    def rename(document):
        for entry in document["events"] + document["segments"]:
            entry["task"] = {"P1": "[red]\x1b[31m", "P2": "\ud800"}.get(entry["task"], "")

    odd = [edited(plans, tmp_path, rename, name) for name in ("fixed", "exact")]
    for arguments in ([*odd, "--json"], odd):
        assert run(["compare", "schedules", *arguments]) == 0
        text = capsys.readouterr().out
        assert "[red]" in text
        assert "\x1b" not in text
        assert "\ud800" not in text
