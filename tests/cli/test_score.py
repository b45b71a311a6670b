"""`dualarm score`: the gate, its files and exit codes, what is kept, and faults while many processes plan."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from dualarm_cli.cli.run import run

QUICK = ("--platform", "fixed", "--effort", "quick")
ALL = "cells/**/tasks.yaml"
AT_ONCE = 6.0
"""Two seconds by the contract [s]; the rest is for a machine that does other things meanwhile."""


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """A cache that tests share, so that the same cells are planned once: names in it are from the project."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def score(kept, capsys):
    """Runs a score in this process; returns exit code, stdout and stderr."""

    def call(*arguments, cached=True):
        cache = ("--cache", str(kept)) if cached else ()
        code = run(["score", *QUICK, *map(str, (*cache, *arguments))])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return code, captured.out, captured.err

    return call


def command(*arguments):
    """A score in a process of its own."""
    return [sys.executable, "-m", "dualarm_cli", "score", *QUICK, *map(str, arguments)]


def start(*arguments, **options):
    """Starts a score in a process of its own."""
    return subprocess.Popen(
        command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options
    )


def children(process):
    """Returns the processes that a process has started and that still run."""
    found = []
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, parent = entry.read_text().rpartition(")")[2].split()[:2]
            if int(parent) == process.pid and state != "Z":
                found.append(int(entry.parent.name))
    return found


def wait_for_children(process, count):
    """Returns a process's children once there are so many."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end and process.poll() is None:
        if len(found := children(process)) >= count:
            return found
        time.sleep(0.01)
    raise AssertionError(f"{count} processes never ran")


def test_a_baseline_is_written_and_then_passed(cells, score):
    """All cases in the table; the second time nothing is planned."""
    names = cells(2)
    code, _, err = score(ALL, "--baseline", "scores.json", "--update-baseline")
    assert code == 0
    assert "written: scores.json" in err
    code, out, err = score("cells", "--baseline", "scores.json")
    assert code == 0
    assert all(name in out for name in names)
    assert "2 cases: 2 pass" in out
    assert "unchanged and not planned again: 2 of 2" in err
    assert set(json.loads(Path("scores.json").read_text())["cases"]) == set(names)


def test_a_lowered_limit_fails_with_cell_figure_and_joint(cells, score):
    """The robot file's acceleration of the joint that decides the cycle, 600 deg/s² then, 300 now."""
    case = cells(1)[0]
    assert score(ALL, "--baseline", "scores.json", "--update-baseline")[0] == 0
    recorded = json.loads(Path("scores.json").read_text())["cases"][case]
    joint = max(recorded["limiting"], key=recorded["limiting"].get)
    robot = Path("robots/planar/robot.yaml")
    text = robot.read_text()
    lowered = text.replace(
        f"{joint}: {{acceleration: 600 deg/s^2", f"{joint}: {{acceleration: 300 deg/s^2"
    )
    assert lowered != text
    robot.write_text(lowered)
    code, out, _ = score(ALL, "--baseline", "scores.json", "--max-regression", "2%", "--json")
    assert code == 1
    row = json.loads(out)["cases"][0]
    assert (row["case"], row["state"]) == (case, "regressed")
    message = row["reasons"][0]["message"]
    assert f"cycle time {recorded['cycle_time']:.3f} s -> {row['cycle_time']:.3f} s" in message
    assert joint in message
    assert "acceleration limit was 600 deg/s², now 300 deg/s²" in message
    assert "robots/planar/robot.yaml" in message
    # With half the acceleration and jerk as before, a move takes longer, but no more than twice as long.
    assert 1.02 < row["cycle_time"] / row["baseline_cycle_time"] <= 2.0
    assert score(ALL, "--baseline", "scores.json", "--max-regression", "200%")[0] == 0
    robot.write_text(text)
    code, out, _ = score(ALL, "--baseline", "scores.json")
    assert (code, "1 pass" in out) == (0, True)


def test_a_regression_names_the_number_that_made_it_and_a_lever(cells, score):
    """Both arms stay 0.5 s longer at once: setting the dwell back gains 0.5 s, half of it 0.3 s."""
    case = cells(1)[0]
    tasks = Path(case)
    task = "{id: ID, arm: ARM, pick: {xyz: [X mm, 100 mm, 0], rpy: [180 deg, 0, 0], free: yaw}}"
    rows = [("a", "left", "80"), ("b", "right", "50")]
    words = [
        f"  - {task.replace('ID', i).replace('ARM', arm).replace('X', x)}" for i, arm, x in rows
    ]
    head = ["dualarm: tasks/1", "cell: cell.yaml", "return: true", "defaults: {dwell: 100 ms}"]
    text = "\n".join([*head, "tasks:", *words, ""])
    tasks.write_text(text)
    assert score(ALL, "--baseline", "scores.json", "--update-baseline")[0] == 0
    tasks.write_text(text.replace("100 ms", "600 ms"))
    assert score(ALL)[0] == 0  # kept without its schedule
    code, out, err = score(ALL, "--baseline", "scores.json", "--json")
    assert code == 1
    [row] = json.loads(out)["cases"]
    message = row["reasons"][1]["message"]
    assert message in err
    assert message.startswith(
        "made by dwell 100 ms to 600 ms (set back it gains an estimated 0.500 s)"
    )
    assert "unchanged and not planned again: 1 of 1" in score(ALL, "--baseline", "scores.json")[2]
    # Baselines of earlier versions have no numbers: the other lever is named alone.
    old = json.loads(Path("scores.json").read_text())
    del old["cases"][case]["numbers"]
    Path("scores.json").write_text(json.dumps(old))
    code, out, _ = score(ALL, "--baseline", "scores.json", "--json")
    message = json.loads(out)["cases"][0]["reasons"][1]["message"]
    assert message == "dwell 600 ms to 300 ms would gain an estimated 0.300 s of the 0.500 s lost"


def test_one_bad_cell_does_not_stop_the_others_and_the_gravest_decides(cells, score):
    """A file that is wrong, a target out of reach, a good one: exit 2; without the first exit 3."""
    names = cells(3)
    for name, old, new in ((names[0], "80 mm", "1080 mm"), (names[1], "return", "retrun")):
        path = Path(name)
        path.write_text(path.read_text().replace(old, new))
    code, out, _ = score(ALL, "--json")
    assert code == 2
    rows = {row["case"]: row for row in json.loads(out)["cases"]}
    assert [rows[name]["state"] for name in names] == ["infeasible", "bad_input", "pass"]
    reason = rows[names[0]]["reasons"][0]
    assert (reason["file"], reason["line"]) == (names[0], 5)
    assert rows[names[1]]["reasons"][0]["line"] == 3
    assert score(names[0], names[2])[0] == 3


def test_a_missed_budget_is_exit_1_at_its_place(cells, score):
    """A second is too little for this cell; ten are enough."""
    case = cells(1)[0]
    path = Path(case)
    text = path.read_text()
    path.write_text(text.replace("tasks:\n", "budget: {cycle_time: 1 s}\ntasks:\n", 1))
    code, out, _ = score(ALL)
    assert code == 1
    assert f"{case}:4:22: over budget: cycle time 1." in out
    path.write_text(text.replace("tasks:\n", "budget: {cycle_time: 10 s}\ntasks:\n", 1))
    assert score(ALL)[0] == 0


def test_nothing_that_is_missing_or_damaged_passes(cells, score, tmp_path):
    """A case of the baseline, the baseline, its numbers, its settings, all cases."""
    cells(2)
    baseline = Path("scores.json")
    assert score(ALL, "--baseline", baseline)[0] == 2
    assert score(ALL, "--baseline", baseline, "--update-baseline")[0] == 0
    whole = baseline.read_text()
    shutil.move("cells/001", "elsewhere")
    code, out, _ = score(ALL, "--baseline", baseline)
    assert code == 1
    assert "cells/001/tasks.yaml: missing: is in the baseline" in out
    assert score(ALL, "--baseline", baseline, "--subset")[0] == 0
    shutil.move("elsewhere", "cells/001")
    for damaged in ("", whole[:300], whole.replace('"cycle_time": 1', '"cycle_time": NaN, "x": 1')):
        baseline.write_text(damaged)
        assert score(ALL, "--baseline", baseline)[0] == 2
        assert score(ALL, "--baseline", baseline, "--update-baseline")[0] == 2
        assert baseline.read_text() == damaged
    assert score(ALL, "--baseline", baseline, "--update-baseline", "--force")[0] == 0
    assert baseline.read_text() == whole
    code, _, err = score(ALL, "--baseline", baseline, "--seed", "1")
    assert (code, "seed 0 there, 1 here" in err) == (2, True)
    document = json.loads(whole)
    document["settings"]["weight"] = 3
    baseline.write_text(json.dumps(document))
    code, _, err = score(ALL, "--baseline", baseline)
    assert (code, "(weight 3 there, not stated here)" in err) == (2, True)
    code, _, err = score("cells/**/nothing.yaml", "--baseline", baseline)
    assert (code, "nothing to score" in err) == (2, True)


def test_a_baseline_is_not_updated_by_cases_without_a_plan(cells, score):
    """It stays as it is, byte for byte; a subset leaves the other cases in it."""
    names = cells(2)
    baseline = Path("scores.json")
    assert score(ALL, "--baseline", baseline, "--update-baseline")[0] == 0
    before = baseline.read_bytes()
    path = Path(names[0])
    text = path.read_text()
    path.write_text(text.replace("80 mm", "1080 mm"))
    code, _, err = score(ALL, "--baseline", baseline, "--update-baseline")
    assert (code, "stays as it is" in err) == (3, True)
    assert baseline.read_bytes() == before
    path.write_text(text.replace("return: true", "return: true\nspeed: 50%"))
    assert score(names[0], "--baseline", baseline, "--update-baseline", "--subset")[0] == 0
    then, now = json.loads(before)["cases"], json.loads(baseline.read_text())["cases"]
    assert now[names[1]] == then[names[1]]
    assert now[names[0]]["cycle_time"] == pytest.approx(2.0 * then[names[0]]["cycle_time"])
    shutil.rmtree(Path(names[1]).parent)
    assert score(ALL, "--baseline", baseline, "--update-baseline")[0] == 0
    assert set(json.loads(baseline.read_text())["cases"]) == {names[0]}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--update-baseline"], "--update-baseline needs --baseline"),
        (["--max-regression", "2%"], "--max-regression needs --baseline"),
        (["--subset"], "--subset needs --baseline"),
        (["--baseline", "b", "--max-regression", "-1%"], "must be 0 or more"),
        (["--baseline", "b", "--max-regression", "nan"], "is not a number"),
        (["--baseline", "b", "--max-regression", "2 s"], "unit 's'"),
        (["--baseline", "b", "--max-regression", "2"], "is 200 %; write 2% or 200%"),
        (
            ["--baseline", "b", "--max-regression", "x"],
            "'x' is not a number; write one such as 2% or 0.02",
        ),
        (["--baseline", "b"], "error[E500]: b: there is no such file; --update-baseline writes it"),
        (
            ["--baseline", "b", "--update-baseline", "--junit", "./b"],
            "is also the file of --baseline",
        ),
        (["--junit", "x", "--markdown", "x"], "--markdown x: is also the file of --junit"),
        (
            ["--scheduler", "foo"],
            "--scheduler 'foo': is not an address; write one such as tcp://10.0.0.1:8786",
        ),
        (["--scheduler", ""], "--scheduler '': is not an address"),
        (["--scheduler", "xyz://a:1"], "--scheduler 'xyz://a:1': is not an address"),
        (["--cache", "cells"], "--cache cells: holds other files"),
        (
            ["--baseline", "b", "--update-baseline", "--max-regression", "1%"],
            "--max-regression does not go with --update-baseline",
        ),
        (["--scheduler", "tcp://x:1", "--jobs", "2"], "--jobs does not go with --scheduler"),
        (["--cache", "c", "--no-cache"], "--cache does not go with --no-cache"),
        (["--timeout", "0"], "must be above 0 s"),
        (
            ["--timeout", "soon"],
            "--timeout: 'soon' is not a number; write one such as 30 or '2 min'",
        ),
        (["--jobs", "0"], "or equal to 1. Try 'dualarm score --help'."),
        (["--junit", "nowhere/x.xml"], "there is no folder nowhere"),
        (["--platform", "nothing"], "there is no 'nothing'"),
        (["--effort", "some"], "--effort"),
    ],
)
def test_options_that_do_not_go_together_are_refused(cells, arguments, words, capsys):
    """Exit 2 and a sentence, before anything is planned."""
    cells(1)
    assert run(["score", ALL, *arguments]) == 2
    captured = capsys.readouterr()
    assert words in captured.err
    assert captured.out == ""
    assert not Path(".dualarm-cache").exists()


def test_pipes_and_devices_are_no_reports(cells, score):
    """They are refused before anything is planned: whoever opens a pipe waits for its other end."""
    cells(1)
    os.mkfifo("pipe")
    for path in ("pipe", os.devnull):
        code, _, err = score(ALL, "--junit", path, "--force")
        assert (code, "is a device or a pipe" in err) == (2, True)
    assert not Path(".dualarm-cache").exists()


def test_reports_replace_reports_but_nobody_elses_file(cells, score):
    """A task file that is named by mistake stays; a report of before is replaced; --force replaces all."""
    case = cells(1)[0]
    before = Path(case).read_bytes()
    for option in ("--junit", "--markdown"):
        code, _, err = score(ALL, option, case)
        assert (code, "is not a report of an earlier score" in err) == (2, True)
    assert Path(case).read_bytes() == before
    for _ in range(2):
        assert score(ALL, "--junit", "j.xml", "--markdown", "m.md")[0] == 0
    Path("j.xml").write_text("mine")
    assert score(ALL, "--junit", "j.xml")[0] == 2
    assert score(ALL, "--junit", "j.xml", "--force")[0] == 0
    assert Path("j.xml").read_text().startswith("<?xml")


def test_github_gets_annotations_and_a_summary(cells, score, monkeypatch, tmp_path):
    """On stderr, so that stdout stays one document; the summary is added to."""
    case = cells(1)[0]
    path = Path(case)
    path.write_text(path.read_text().replace("80 mm", "1080 mm"))
    summary = tmp_path / "summary.md"
    summary.write_text("before\n")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))
    monkeypatch.setenv("GITHUB_WORKSPACE", str(tmp_path.parent))
    code, out, err = score(ALL, "--github", "--json")
    assert code == 3
    json.loads(out)
    commands = [line for line in err.splitlines() if line.startswith("::error ")]
    assert len(commands) == 1
    assert f"file={tmp_path.name}/{case},line=5,col=" in commands[0]
    assert summary.read_text().startswith("before\n<!-- dualarm score -->\n## dualarm score: 1 of")
    score(ALL)
    assert summary.read_text().count("dualarm score:") == 1


def test_an_answer_that_is_known_needs_no_heavy_library(cells, kept):
    """Neither numpy nor pinocchio nor yaml; not even rich where JSON is asked for."""
    cells(2)
    arguments = ["score", *QUICK, ALL, "--cache", str(kept), "--json", "--quiet"]
    assert run(arguments) == 0
    code = (
        f"import sys; from dualarm_cli.cli.run import run; run({arguments!r}); "
        "print([m for m in ('numpy', 'pinocchio', 'coal', 'yaml', 'scipy', 'distributed', 'rich.table')"
        " if m in sys.modules], file=sys.stderr)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stderr.strip() == "[]"
    assert json.loads(result.stdout)["passed"]


def test_who_supervises_loads_no_planner_though_a_method_is_named(cells):
    """It would take a second in which all processes could plan; a method that is none is told by what they answer."""
    cells(1)
    arguments = ["score", *QUICK, ALL, "--no-cache", "--json", "--quiet"]
    code = (
        f"import sys; from dualarm_cli.cli.run import run; run({arguments!r}); "
        "print([m for m in ('pinocchio', 'dualarm_cli.planning') if m in sys.modules], file=sys.stderr)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stderr.strip() == "[]"
    assert json.loads(result.stdout)["passed"]


@pytest.mark.parametrize("option", ["--platform", "--timing", "--redundancy"])
def test_a_method_that_is_none_is_one_error_whatever_the_cells_come_to(cells, score, option):
    """One is out of reach, one is wrong itself."""
    names = cells(2)
    for name, old, new in ((names[0], "80 mm", "1080 mm"), (names[1], "return", "retrun")):
        path = Path(name)
        path.write_text(path.read_text().replace(old, new))
    code, out, err = score(ALL, option, "nothing", "--jobs", "1")
    assert (code, out) == (2, "")
    assert "there is no 'nothing'" in err


def test_scores_are_the_same_bytes_by_one_process_by_two_and_on_a_cluster(cells, capsys):
    """The baseline and the document; nothing is taken from a cache. The cluster has two workers."""
    from distributed import LocalCluster

    cells(3)
    found = {}

    def bytes_of(name, *arguments):
        code = run(
            [
                "score",
                *QUICK,
                ALL,
                "--no-cache",
                "--json",
                *arguments,
                "--baseline",
                f"{name}.json",
                "--update-baseline",
            ]
        )
        out = capsys.readouterr().out
        assert code == 0
        found[name] = (Path(f"{name}.json").read_bytes(), out)

    bytes_of("one", "--jobs", "1")
    bytes_of("two", "--jobs", "2")
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, processes=True
    ) as cluster:
        bytes_of("cluster", "--scheduler", cluster.scheduler_address)
    assert found["one"] == found["two"] == found["cluster"]
    assert len(json.loads(found["one"][0])["cases"]) == 3


def test_a_cluster_that_is_not_there_and_a_library_that_is_not_are_told(cells, score, monkeypatch):
    """With the extra that brings it, and how to start one."""
    import dualarm_cli.evaluation.cluster as module

    cells(1)
    monkeypatch.setattr(module, "WAITS", replace(module.WAITS, connecting=0.5))
    code, _, err = score(ALL, "--scheduler", "tcp://127.0.0.1:9", "--no-cache", cached=False)
    assert (code, "no scheduler answers there" in err, "dask scheduler" in err) == (2, True, True)
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, _, err = score(ALL, "--scheduler", "tcp://127.0.0.1:9", "--no-cache", cached=False)
    assert (code, "dualarm[cluster]" in err) == (2, True)


def test_a_worker_that_is_killed_in_the_middle_changes_nothing(cells, score):
    """SIGKILL to each of the first two: the scores are those of an undisturbed run."""
    cells(6)
    assert score(ALL, "--baseline", "calm.json", "--update-baseline")[0] == 0
    hurt = start(ALL, "--cache", "c", "--jobs", 2, "--baseline", "hurt.json", "--update-baseline")
    for pid in wait_for_children(hurt, 2):
        time.sleep(0.4)
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    _, err = hurt.communicate(timeout=60)
    assert hurt.returncode == 0, err
    assert Path("hurt.json").read_bytes() == Path("calm.json").read_bytes()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_a_score_at_once_leave_no_process_and_a_good_cache(cells, number, code):
    """What was done by then is not done again, and nothing that was there is touched."""
    cells(8)
    process = start(ALL, "--cache", "c", "--jobs", 2, "--junit", "j.xml")
    for line in process.stderr:
        if line.startswith("[2/"):
            break
    pids = children(process)
    assert len(pids) == 2
    begin = time.monotonic()
    process.send_signal(number)
    out, err = process.communicate(timeout=20)
    assert time.monotonic() - begin < AT_ONCE
    assert process.returncode == code, err
    assert "Traceback" not in err
    assert out == ""
    assert not [pid for pid in pids if Path(f"/proc/{pid}").exists()]
    assert not Path("j.xml").exists()
    answers = list(Path("c/answers").rglob("*.json"))
    assert len(answers) >= 2
    if number != signal.SIGINT:
        return
    again = start(ALL, "--cache", "c", "--jobs", 2)
    _, err = again.communicate(timeout=60)
    assert again.returncode == 0
    known = int(err.rpartition("not planned again: ")[2].split()[0])
    assert known >= 2


def test_two_scores_at_once_on_one_cache_lose_nothing(cells):
    """Both answer all; the cache then has each answer once."""
    cells(4)
    both = [
        start(ALL, "--cache", "c", "--jobs", 1, "--baseline", f"{k}.json", "--update-baseline")
        for k in range(2)
    ]
    for process in both:
        _, err = process.communicate(timeout=120)
        assert process.returncode == 0, err
        assert "warning" not in err
    assert Path("0.json").read_bytes() == Path("1.json").read_bytes()
    assert len(list(Path("c/answers").rglob("*.json"))) == 4
    assert not list(Path("c/making").iterdir())
    again = start(ALL, "--cache", "c")
    assert "not planned again: 4 of 4" in again.communicate(timeout=60)[1]


def test_a_full_disk_costs_the_cache_and_not_the_result(cells):
    """A real one: 16 kB in memory, in a mount of its own."""
    cells(2)
    Path("c").mkdir()
    words = " ".join(command(ALL, "--cache", "c"))
    mounted = f"mount -t tmpfs -o size=16k,nr_inodes=8 none c && exec {words}"
    probe = ["unshare", "--map-root-user", "--mount", "sh", "-c", "mount -t tmpfs none c"]
    if shutil.which("unshare") is None or subprocess.run(probe, capture_output=True).returncode:
        pytest.skip("no mounts here; the limit on the size of files is tested all the same")
    result = subprocess.run(
        ["unshare", "--map-root-user", "--mount", "sh", "-c", mounted],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert "2 cases: 2 pass" in result.stdout
    assert result.stderr.count("warning: results could not be cached in c: No space left") == 1


def test_a_limit_on_files_costs_the_cache_and_not_the_result(cells):
    """No file may be longer than 300 bytes: half an entry is none, and the next score repairs it."""
    cells(1)
    process = start(
        ALL,
        "--cache",
        "c",
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (300, 300)),
        # CPython would take 300 bytes of a module's bytecode for all of it, and keep them for later tests.
        env=os.environ | {"PYTHONDONTWRITEBYTECODE": "1"},
    )
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, err
    assert "1 case: 1 pass" in out
    assert "warning: results could not be cached" in err
    assert not list(Path("c").rglob("making/*"))
    for known in (0, 1):
        again = start(ALL, "--cache", "c")
        assert f"not planned again: {known} of 1" in again.communicate(timeout=60)[1]


def test_a_case_that_takes_too_long_is_told_as_such(cells, score):
    """After two tries; exit 1, and nothing of it is kept."""
    cells(1)
    code, out, _ = score(ALL, "--timeout", "10 ms", "--cache", "c", cached=False)
    assert code == 1
    assert "timed out: took longer than 0.01 s, 2 times" in out
    assert not Path("c").exists()


def test_names_that_mean_harm_are_cases_like_any_other(cells, score):
    """Colours, line ends, pipes, half surrogates: every report is whole, and the baseline is found again."""
    from xml.etree import ElementTree

    cells(1)
    evil = "cells/\x1b[31m |é\udcff\n::error::<b>"
    shutil.move("cells/000", evil)
    reports = ("--junit", "j.xml", "--markdown", "m.md", "--baseline", "s.json", "--github")
    assert score(ALL, *reports, "--update-baseline")[0] == 0
    code, out, err = score(ALL, *reports)
    assert code == 0, err
    assert "\x1b" not in out + err
    assert not [line for line in (out + err).splitlines() if line.startswith("::error")]
    assert json.loads(Path("s.json").read_bytes())["cases"].keys() == {f"{evil}/tasks.yaml"}
    name = ElementTree.parse("j.xml").find(".//testcase").get("name")
    assert "\\udcff" in name
    assert "1 pass" in out
    code, out, _ = score(ALL, "--json")
    assert json.loads(out)["cases"][0]["state"] == "pass"


def test_a_baseline_that_cannot_be_written_is_one_error_and_no_result(cells, score, monkeypatch):
    """With --json there is one document on stdout, and the old baseline is whole."""
    import dualarm_cli.exporting.whole_files as module

    cells(1)
    assert score(ALL, "--baseline", "s.json", "--update-baseline")[0] == 0
    before = Path("s.json").read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "_fill", full)
    code, out, err = score(ALL, "--baseline", "s.json", "--update-baseline", "--json")
    assert code == 2
    assert json.loads(out)["format"] == "dualarm.error/1"
    assert "No space left" in err
    assert Path("s.json").read_bytes() == before
    assert not list(Path().glob(".s.json*"))


def test_a_latin_stdout_gets_the_table_and_not_a_crash(cells, kept):
    """LANG=C with an ASCII stdout and stderr."""
    cells(1)
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    result = subprocess.run(
        command(ALL, "--cache", kept), env=environment, capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr
    assert "1 case: 1 pass" in result.stdout


def test_on_a_terminal_there_is_a_bar_that_goes_away(cells, kept):
    """No line for each case; stdout is a pipe and has the table only."""
    import pty

    cells(2)
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        command(ALL, "--cache", kept), stdout=subprocess.PIPE, stderr=theirs, text=True
    )
    os.close(theirs)
    seen = b""
    with contextlib.suppress(OSError):
        while data := os.read(ours, 4096):
            seen += data
    os.close(ours)
    out, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    assert b"scoring" in seen
    assert b"2/2" in seen
    assert b"[1/2]" not in seen
    assert "\x1b" not in out


def test_progress_is_a_line_for_each_case_where_there_is_no_terminal(cells, score):
    """On stderr; none with --quiet, which counts the cases in one line."""
    names = cells(2)
    _, _, err = score(ALL)
    assert [line.split()[1] for line in err.splitlines() if line.startswith("[")] == [
        f"{name}:" for name in names
    ]
    code, out, err = score(ALL, "--quiet")
    assert (code, out.partition(" ")[0], out.count("\n"), err) == (0, "2", 1, "")
