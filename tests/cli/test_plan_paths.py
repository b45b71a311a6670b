"""Paths on the command line: figures, followers, refusals at their place."""

from __future__ import annotations

import json

import pytest

from dualarm_cli.cli.run import run
from dualarm_cli.kinds.path.following import PATH_SOLVERS
from dualarm_cli.postures import REDUNDANCY_SOLVERS

CELL = """\
dualarm: cell/1
robot: sda10f
tools:
  left:  {tcp: {xyz: [0, 0, 120 mm]}}
  right: {tcp: {xyz: [0, 0, 120 mm]}}
"""
TASKS = """\
dualarm: tasks/1
cell: cell.yaml
start: free
tasks:
  - id: seam
    arm: left
    path:
      speed: 100 mm/s
      posture: home
      through:
        - {xyz: [0.45, 0.25, 0.90], rpy: [180 deg, 0, 0]}
        - {xyz: [0.46, 0.25, 0.90]}
"""


@pytest.fixture
def seam(tmp_path, monkeypatch):
    """A folder with a path of 10 mm, which is the working directory."""
    (tmp_path / "dualarm.toml").write_text("")
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_plan_writes_the_measures_and_the_figure(seam, capsys):
    """The report has one path, by the default follower; the output says so; the figure is what was asked for."""
    assert run(["plan", "tasks.yaml", "--out", "plan", "--plot", "paths.svg", "-v"]) == 0
    out = capsys.readouterr().out.replace("\n", " ")
    assert "path seam by arm_angle: 10.0 mm in" in out
    (found,) = json.loads((seam / "plan" / "report.json").read_text())["paths"]
    assert (found["task"], found["method"], found["arms"]) == ("seam", "arm_angle", ["left"])
    assert found["length"] == pytest.approx(0.01)
    assert found["tool_error"] < 1e-4
    assert "<!-- path -->" in (seam / "paths.svg").read_text()  # the legend of the Gantt chart
    assert (seam / "paths_paths.svg").read_bytes().startswith(b"<?xml")


def test_an_arm_that_follows_no_path_waits_for_the_end(seam):
    """The right arm never works: the report has its wait, as long as the plan, for what the left arm follows."""
    assert run(["plan", "tasks.yaml", "--out", "plan", "--quiet"]) == 0
    report = json.loads((seam / "plan" / "report.json").read_text())
    waits = [row for row in report["waits"] if row["arm"] == "right"]
    assert {(row["reason"], row["for"]["task"]) for row in waits} == {("end", "seam")}
    total = sum(row["length"] for row in waits)
    assert total == pytest.approx(report["cycle_time"], abs=1e-6)
    assert report["arms"]["right"]["waited"]["end"] == pytest.approx(total, abs=1e-6)


def test_the_command_line_s_follower_counts_before_the_file_s(seam):
    """`--redundancy` names it for all paths; without it the file does."""
    (seam / "tasks.yaml").write_text(
        TASKS.replace("speed: 100", "redundancy: min_norm\n      speed: 100")
    )
    for options, method in (([], "min_norm"), (["--redundancy", "arm_angle"], "arm_angle")):
        assert run(["plan", "tasks.yaml", "--out", "plan", "--force", "--quiet", *options]) == 0
        (found,) = json.loads((seam / "plan" / "report.json").read_text())["paths"]
        assert found["method"] == method


def test_a_job_without_paths_has_its_chart_drawn(seam, tasks_folder):
    """Where nothing follows a path the figure is of who does what when: it names the robot and both arms."""
    tasks = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    options = ["--out", "plan", "--platform", "fixed", "--plot", "chart.svg", "--quiet"]
    assert run(["plan", str(tasks), *options]) == 0
    drawn = (seam / "chart.svg").read_text()
    assert drawn.startswith("<?xml")
    report = json.loads((seam / "plan" / "report.json").read_text())
    assert f", {report['robot']}: " in drawn
    for lane in (*report["arms"], "platform"):
        assert f"<!-- {lane} -->" in drawn


def test_a_figure_that_is_there_or_of_an_unknown_kind_is_refused_before_planning(seam, capsys):
    """Exit 2 and the old one stays; `--force` overwrites it."""
    for name in ("paths.png", "paths_paths.png"):
        (seam / name).write_text("mine")
        assert run(["plan", "tasks.yaml", "--out", "plan", "--plot", "paths.png"]) == 2
        assert name in _one_line(capsys)
        assert (seam / name).read_text() == "mine"
        (seam / name).unlink()
    (seam / "paths.png").write_text("mine")
    assert run(["plan", "tasks.yaml", "--out", "plan", "--plot", "paths.gif"]) == 2
    assert ".png" in _one_line(capsys)
    assert not (seam / "plan").exists()
    arguments = ["plan", "tasks.yaml", "--out", "plan", "--plot", "paths.png", "--force", "--quiet"]
    assert run(arguments) == 0
    assert (seam / "paths.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("command", [["plan"], ["compare", "solvers"]])
def test_an_unknown_redundancy_is_refused_with_all_known_names(seam, capsys, command):
    """Solvers of stops and followers of paths; the nearest name is guessed."""
    assert run([*command, "tasks.yaml", "--redundancy", "min_nrom"]) == 2
    message = _one_line(capsys)
    assert "redundancy: there is no 'min_nrom', did you mean 'min_norm'?" in message
    for name in (*REDUNDANCY_SOLVERS.names, *PATH_SOLVERS.names):
        assert name in message
    assert not (seam / f"{seam.name}-plan").exists()


def test_a_path_that_names_an_unknown_method_is_refused_at_its_place(seam, capsys):
    """Exit 2, file and line of the path, the known names; a method of stops does not follow paths."""
    for name, guess in (("min_nrom", ", did you mean 'min_norm'?"), ("numeric", "")):
        (seam / "tasks.yaml").write_text(
            TASKS.replace("speed: 100", f"redundancy: {name}\n      speed: 100")
        )
        assert run(["plan", "tasks.yaml", "--out", "plan"]) == 2
        message = _one_line(capsys)
        # The path's content begins in line 8.
        assert "tasks.yaml:8:" in message
        assert f"no method '{name}' follows paths{guess}" in message
        for known in PATH_SOLVERS.names:
            assert known in message
        assert not (seam / "plan").exists()


def test_a_path_out_of_reach_is_infeasible(seam, capsys):
    """Exit 3, with the task's name; nothing is written."""
    (seam / "tasks.yaml").write_text(TASKS.replace("[0.46,", "[3.0,"))
    assert run(["plan", "tasks.yaml", "--out", "plan"]) == 3
    assert "seam" in _one_line(capsys)
    assert not (seam / "plan").exists()


def test_a_mistake_in_a_path_is_exit_2_with_its_line(seam, capsys):
    """As any mistake of a task file."""
    (seam / "tasks.yaml").write_text(TASKS.replace("speed: 100 mm/s", "speed: 0"))
    assert run(["plan", "tasks.yaml", "--out", "plan"]) == 2
    assert "tasks.yaml:8:14" in _one_line(capsys)


def test_compare_has_a_row_for_every_follower(seam, capsys):
    """Each verified or with a reason; the table of paths has each follower that has a plan."""
    assert run(["compare", "solvers", "tasks.yaml", "--out", "all"]) == 0
    out = capsys.readouterr().out
    (section,) = json.loads((seam / "all" / "comparison.json").read_text())["comparisons"]
    rows = section["rows"]
    assert sorted(row["redundancy"] for row in rows) == sorted(PATH_SOLVERS.names)
    assert len({row["method"] for row in rows}) == 1
    for row in rows:
        assert row["status"] in ("verified", "infeasible")
        if row["status"] == "verified":
            assert [path["method"] for path in row["paths"]] == [row["redundancy"]]
        else:
            assert row["reason"]
    assert sum(row["status"] == "verified" for row in rows) >= 4
    assert "tasks.yaml: path " in out


def test_compare_takes_the_followers_that_are_named(seam, capsys):
    """Twice the same is once."""
    names = ["min_norm", "arm_angle", "min_norm"]
    options = [word for name in names for word in ("--redundancy", name)]
    assert run(["compare", "solvers", "tasks.yaml", *options, "--json"]) == 0
    (section,) = json.loads(capsys.readouterr().out)["comparisons"]
    assert sorted(row["redundancy"] for row in section["rows"]) == ["arm_angle", "min_norm"]


def test_followers_of_paths_do_not_serve_jobs_without(tasks_folder, capsys):
    """Exit 2: named, known, and of no use there."""
    tasks = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    arguments = ["compare", "solvers", str(tasks), "--redundancy", "min_norm", "--method", "fixed"]
    assert run([*arguments, "--json"]) == 2
    (section,) = json.loads(capsys.readouterr().out)["comparisons"]
    (row,) = section["rows"]
    assert (row["status"], row["redundancy"]) == ("not served", "min_norm")
    assert "min_norm follows paths, and the job has none" in row["reason"]


def _one_line(capsys):
    """What went to stderr, without line breaks."""
    return " ".join(capsys.readouterr().err.split())
