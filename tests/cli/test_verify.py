"""`dualarm verify`: exit codes, one JSON document, edits by hand that are noticed."""

from __future__ import annotations

import json
import re
import shutil

import pytest

from dualarm_cli.cli.run import run


@pytest.fixture(scope="module")
def first_pick(tasks_folder):
    """The first task file."""
    return tasks_folder / "01_first_pick" / "tasks.yaml"


@pytest.fixture(scope="module")
def planned(tmp_path_factory, first_pick):
    """Its plan."""
    out = tmp_path_factory.mktemp("verify") / "out"
    assert run(["plan", str(first_pick), "--out", str(out), "--quiet"]) == 0
    return out


@pytest.fixture
def copied(planned, tmp_path):
    """A copy of the plan that a test may edit."""
    return shutil.copytree(planned, tmp_path / "copy")


def edit(folder, change):
    """Lets `change` edit schedule.json."""
    file = folder / "schedule.json"
    document = json.loads(file.read_bytes())
    change(document)
    file.write_text(json.dumps(document))


def forget_tasks(document):
    """Lets a schedule no longer say which task file it is of."""
    document["provenance"]["inputs"].clear()


def judged(capsys, *arguments):
    """Returns exit code and document of a judgement as JSON; stdout holds nothing else."""
    code = run(["verify", *map(str, arguments), "--json"])
    return code, json.loads(capsys.readouterr().out, parse_constant=pytest.fail)


def failures(document):
    """Returns the names of the checks that failed, with their details."""
    return {c["name"]: c["detail"] for c in document["checks"] if c["verdict"] == "failed"}


@pytest.mark.parametrize("name", ["", "schedule.json"])
@pytest.mark.parametrize("with_tasks", [False, True])
def test_a_plan_passes_by_folder_and_by_file_with_and_without_its_tasks(
    planned, first_pick, capsys, name, with_tasks
):
    """The plan knows its task file. Exit 0 and a table on stdout; nothing on stderr."""
    arguments = ["verify", str(planned / name)] + ["--tasks", str(first_pick)] * with_tasks
    assert run(arguments) == 0
    short = capsys.readouterr().out
    assert "tool_position_at_events" not in short
    assert re.match(r"\d+ checks do not apply or need more input: add -v\n", short)
    assert short.splitlines()[-1].startswith("verification: passed (")
    assert run([*arguments, "-v"]) == 0
    captured = capsys.readouterr()
    assert "verification: passed" in captured.out
    assert "tool_position_at_events" in captured.out
    assert "least clearance of every stage, proven" in captured.out
    assert captured.err == ""


def test_json_is_one_document_with_every_check(planned, first_pick, capsys):
    """Format, judgement, and for each check what was measured and what is allowed."""
    code, document = judged(capsys, planned, "--tasks", first_pick)
    assert (code, document["format"], document["passed"]) == (0, "dualarm.verification/1", True)
    names = [check["name"] for check in document["checks"]]
    assert len(set(names)) == len(names)
    assert {"jerk", "order", "return", "lines_straight", "duration", "files"} <= set(names)
    for check in document["checks"]:
        assert check["verdict"] in ("passed", "not checked")
        assert check["detail"]


def test_plan_and_verify_count_the_same_checks(planned, first_pick, capsys):
    """That of `report.json`; what only a file can be checked for is named."""
    assert run(["verify", str(planned), "--tasks", str(first_pick), "--quiet"]) == 0
    checks = json.loads((planned / "report.json").read_text())["verification"]["checks"]
    count = sum(check["verdict"] == "passed" for check in checks)
    line = capsys.readouterr().out
    assert line.startswith(f"verification: passed ({count} checks and robot, duration, files)")


def test_quiet_says_the_verdict_only_and_keeps_the_exit_code(planned, copied, capsys):
    """0 and 1."""
    edit(copied, lambda d: d.update(duration=1.0))
    assert run(["verify", str(planned), "--quiet"]) == 0
    assert run(["verify", str(copied), "--quiet"]) == 1
    captured = capsys.readouterr()
    passed, failed = captured.out.splitlines()
    assert passed.startswith("verification: passed (")
    assert failed == "verification: FAILED: duration"
    assert captured.err == ""


def push(document):
    """Moves one joint by a microradian at an anchor in the middle."""
    rows = document["motion"]["left"]["position"]
    rows[len(rows) // 2][0] += 1e-6


def swap(document):
    """Lets two events change their names."""
    one, two = (e for e in document["events"] if e["arm"] == "left")
    one["action"], two["action"] = two["action"], one["action"]


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (push, "position_agreement"),
        (swap, "order"),
        (lambda d: d["events"][0].update(arm="third"), "arms"),
        (lambda d: d["events"][0]["xyz"].__setitem__(2, d["events"][0]["xyz"][2] + 1e-5),
         "tool_position_at_events"),
        (lambda d: d.update(duration=d["duration"] + 1e-6), "duration"),
        (lambda d: d["motion"]["left"]["acceleration"][3].__setitem__(0, float("nan")), "finite"),
        (lambda d: d["motion"]["left"]["time"].__setitem__(3, -1.0), "time"),
    ],
    ids=["knot", "order", "arm", "event", "duration", "nan", "time"],
)  # fmt: skip
def test_what_was_edited_by_hand_is_found(copied, first_pick, capsys, change, name):
    """Exit 1, the check that failed by name, still one document of plain JSON."""
    edit(copied, change)
    code, document = judged(capsys, copied, "--tasks", first_pick)
    assert code == 1
    assert document["passed"] is False
    assert name in failures(document)
    assert run(["verify", str(copied), "--tasks", str(first_pick)]) == 1
    assert "verification: FAILED" in capsys.readouterr().out


def test_stated_limits_are_not_believed_where_the_tasks_know_better(copied, first_pick, capsys):
    """Limits of 1 µrad/s break the schedule's own word; with the tasks the robot's count, which differ."""

    def tighten(document):
        for row in document["robot"]["limits"].values():
            row["velocity"] = 1e-6

    edit(copied, tighten)
    assert set(failures(judged(capsys, copied)[1])) == {"robot"}
    edit(copied, forget_tasks)
    code, document = judged(capsys, copied)
    assert (code, set(failures(document))) == (1, {"velocity"})
    code, document = judged(capsys, copied, "--tasks", first_pick)
    assert (code, set(failures(document))) == (1, {"robot"})


def drop_joint(robot):
    robot["arms"]["right"]["joints"].pop(1)


def swap_arms(robot):
    robot["arms"] = dict(zip(("right", "left"), robot["arms"].values(), strict=True))


def swap_joints(robot):
    left, right = robot["arms"].values()
    left["joints"], right["joints"] = right["joints"], left["joints"]


def reverse_joints(robot):
    robot["arms"]["left"]["joints"].reverse()


def move_flange(robot):
    robot["arms"]["left"]["flange"] = "left_link_u"


def move_tool(robot):
    robot["arms"]["left"]["tcp"]["xyz"][2] += 1e-6


def move_base(robot):
    robot["base"]["xyz"][0] += 1e-6


def raise_limit(robot):
    robot["limits"]["left_s"]["velocity"] *= 1.01


def name_platform_in_arm(robot):
    robot["arms"]["left"]["joints"].insert(0, robot["platform"].pop())


@pytest.mark.parametrize(
    ("change", "words", "alone"),
    [
        (drop_joint, "joint 'right_l' is of none", True),
        (swap_arms, "left arm: its flange is right_tool0; the job's is left_tool0", False),
        (swap_joints, "left arm: its joint right_s is none of", True),
        (reverse_joints, "left arm: its joints have another order", True),
        (move_flange, "left arm: its ", True),
        (move_tool, "left arm: its tool centre point is not the job's", False),
        (move_base, "base: its pose is not the job's", False),
        (raise_limit, "velocity limit of left_s: 2.99673; the job's is 2.96706", False),
        (name_platform_in_arm, "left arm: its joint torso_b1 is none of the job's", False),
    ],
)
def test_a_robot_that_is_not_the_job_s_is_refused_by_name(
    copied, first_pick, tmp_path, capsys, change, words, alone
):
    """By `verify`, `report` and `export`; without the job where the URDF tells already."""
    edit(copied, lambda document: change(document["robot"]) or document.pop("files"))
    out = ["--out", str(tmp_path / "new")]
    tasks = ["--tasks", str(first_pick)]
    for command in (
        ["verify", *tasks, "--no-clearance"],
        ["report", *tasks],
        ["export", "--to", "ros2", *out, *tasks],
    ):
        assert run([command[0], str(copied), *command[1:]]) == (
            2 if "drop" in change.__name__ or command[0] != "verify" else 1
        )
        shown = capsys.readouterr()
        assert words in " ".join((shown.out + shown.err).replace("│", " ").split())
    if alone:
        assert run(["export", str(copied), "--to", "ros2", *out]) == 2
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("name", ["schedule.csv", "report.json"])
def test_an_edited_or_lost_file_beside_the_schedule_is_noticed(copied, capsys, name):
    """Against the hashes that the schedule was written with."""
    with (copied / name).open("a") as file:
        file.write("0\n")
    code, document = judged(capsys, copied)
    assert (code, failures(document)) == (1, {"files": f"{name} was changed"})
    (copied / name).unlink()
    code, document = judged(capsys, copied)
    assert (code, failures(document)) == (1, {"files": f"{name} is missing"})


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: (f / "schedule.json").write_text("{\n1"), "schedule.json:2"),
        (lambda f: (f / "schedule.json").unlink(), "there is no such file"),
        (
            lambda f: (f / "robot.urdf").unlink(),
            "'robot.urdf' in the schedule's folder: cannot be read",
        ),
        (lambda f: (f / "robot.urdf").write_text("<robot/>"), "robot.urdf"),
        (lambda f: edit(f, lambda d: d.update(duration=float("inf"))), "duration: must be"),
        (lambda f: edit(f, lambda d: d.pop("motion")), "motion: is missing"),
        (lambda f: edit(f, lambda d: d["robot"].update(urdf="../x")), "own folder"),
        (
            lambda f: edit(
                f, lambda d: (forget_tasks(d), d["robot"]["arms"]["left"].update(flange="x"))
            ),
            "flange",
        ),
    ],
    ids=["text", "lost", "urdf", "empty", "infinite", "motion", "outside", "flange"],
)
def test_what_cannot_be_read_is_exit_2_and_with_json_a_document_too(copied, capsys, spoil, words):
    """One sentence on stderr, no traceback; on stdout nothing, or the error as JSON."""
    spoil(copied)
    assert run(["verify", str(copied)]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""
    code, document = judged(capsys, copied)
    assert (code, document["format"], document["exit_code"]) == (2, "dualarm.error/1", 2)
    assert words in document["message"]


def test_tasks_for_another_robot_are_exit_2(planned, tasks_folder, capsys):
    """The joints that differ are named."""
    other = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    assert run(["verify", str(planned), "--tasks", str(other)]) == 2
    assert "schedule and tasks are for different robots" in capsys.readouterr().err


def test_names_out_of_a_file_are_shown_and_not_obeyed(copied, capsys):
    """Markup in the name of an arm stays text."""
    edit(copied, lambda d: d["events"][0].update(arm="[red]x[/red]"))
    assert run(["verify", str(copied)]) == 1
    assert "[red]x[/red]" in capsys.readouterr().out.replace("\n", "")


@pytest.mark.parametrize(
    ("task", "shown"),
    [("a\x1b[31mred", "a\\x1b[31mred"), ("\ud800", "\\ud800"), ("über", "über")],
)
def test_names_that_steer_a_terminal_or_are_no_text_are_spelt_out(copied, capsys, task, shown):
    """Escape codes and lone surrogates, in the table and in the document; other letters stay."""
    # The check of arms says whose task it is.
    edit(copied, lambda d: d["events"][0].update(task=task, arm="middle"))
    code, document = judged(capsys, copied)
    assert code == 1
    assert any(shown in detail for detail in failures(document).values())
    assert run(["verify", str(copied)]) == 1
    out = capsys.readouterr().out
    assert "\x1b[31mred" not in out
    assert shown in out


def test_clearance_is_proven_where_the_cell_is_known(planned, copied, first_pick, capsys):
    """A row per stage in the table and in the document; not where it is not wanted, and not without the task file."""
    assert run(["verify", str(planned), "--tasks", str(first_pick), "--details"]) == 0
    out = capsys.readouterr().out
    assert "least clearance of every stage, proven" in out
    code, document = judged(capsys, planned, "--tasks", first_pick, "--clearance")
    assert code == 0
    [check] = [check for check in document["checks"] if check["name"] == "collisions"]
    assert check["verdict"] == "passed"
    least = min(stage["margin"] for stage in document["clearances"])
    assert check["measured"] == pytest.approx(-least, abs=1e-12)
    code, document = judged(capsys, planned, "--tasks", first_pick, "--no-clearance")
    assert code == 0
    assert document["clearances"] == []
    edit(copied, forget_tasks)
    assert run(["verify", str(copied), "--clearance"]) == 2
    assert "--clearance needs obstacles, tools and clearances" in capsys.readouterr().err
    assert run(["verify", str(copied)]) == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("the task file of the plan is not found")
    assert "name it with --tasks" in captured.err
    assert "except that collisions were not checked" in captured.out


def test_a_budget_is_a_check_of_its_own_in_verify_and_in_plan(
    planned, tasks_folder, tmp_path, capsys
):
    """Kept: exit 0. Missed: exit 1 by both, with where it is written; the plan's files are there all the same."""
    (tmp_path / "dualarm.toml").touch()
    folder = tasks_folder / "01_first_pick"
    (tmp_path / "cell.yaml").write_text((folder / "cell.yaml").read_text())
    text = (folder / "tasks.yaml").read_text()
    tasks = tmp_path / "tasks.yaml"
    for seconds, code, verdict in ((60, 0, "passed"), (1, 1, "failed")):
        tasks.write_text(
            text.replace("\ntasks:\n", f"\nbudget: {{cycle_time: {seconds} s}}\ntasks:\n")
        )
        found, document = judged(capsys, planned, "--tasks", tasks, "--no-clearance")
        checks = {check["name"]: check for check in document["checks"]}
        assert (found, checks["budget_cycle_time"]["verdict"]) == (code, verdict)
        assert checks["budget_cycle_time"]["allowed"] == seconds
        out = tmp_path / f"out{seconds}"
        quick = ["--effort", "quick", "--platform", "fixed", "--out", str(out)]
        assert run(["plan", str(tasks), *quick]) == code
        told = capsys.readouterr().out
        assert ("MISSED" in told) is bool(code)
        assert f"at most {seconds} s" in told
        report = json.loads((out / "report.json").read_text())
        assert [line["kept"] for line in report["budget"]] == [not code]
        assert report["verification"]["passed"]
