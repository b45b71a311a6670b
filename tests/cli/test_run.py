"""The process: exit codes, streams, JSON, signals, start-up."""

from __future__ import annotations

import hashlib
import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from dualarm_cli.cli import plan as cli_plan
from dualarm_cli.cli import run as run_module
from dualarm_cli.cli.plan import _job_name
from dualarm_cli.cli.run import run
from dualarm_cli.planning import planner

AT_ONCE = 6.0
"""Two seconds by the contract [s]; the rest is for a machine that does other things meanwhile."""


def dualarm(*arguments, **options):
    """Runs the command line in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "dualarm_cli", *map(str, arguments)],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        **options,
    )


def hashes(folder):
    """SHA-256 of every file of a folder."""
    return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in folder.iterdir()}


@pytest.fixture(scope="module")
def planned(tmp_path_factory, tasks_folder):
    """One plan of the first task file with its details, made by a process."""
    out = tmp_path_factory.mktemp("plan") / "out"
    task = tasks_folder / "01_first_pick" / "tasks.yaml"
    result = dualarm("plan", task, "--out", out, "--effort", "quick", "-v")
    return result, out


def test_plan_writes_its_files_and_says_what_a_reader_needs(planned):
    """Exit 0, its files (no page where none was built), table, cycle time, assumed limits, no collisions checked."""
    result, out = planned
    assert result.returncode == 0, result.stderr
    assert sorted(f.name for f in out.iterdir() if f.suffix != ".html") == [
        "events.csv",
        "report.json",
        "robot.urdf",
        "schedule.csv",
        "schedule.json",
        "targets.csv",
    ]
    for words in (
        "cycle time (period)",
        "parts per hour",
        "bottleneck",
        "limits are assumed",
        "collisions: none",
        "verification: passed",
    ):
        assert words in result.stdout
    # The result comes last: cycle time, verdict with what it assumes, the file to open.
    cycle, verdict, file = result.stdout.splitlines()[-3:]
    assert cycle.startswith("cycle time (period): ")
    for words in ("no shapes of left_tool", "limits of 15 joints", "2 parts", "clearance 0 mm"):
        assert words in verdict
    assert file == f"open {out / 'report.html'}" or not (out / "report.html").exists()
    report = json.loads((out / "report.json").read_text())
    assert 0.0 < report["lower_bound"] <= report["cycle_time"]
    assert report["collisions"].startswith(
        "none between bodies with shapes; least clearance proven"
    )
    assert report["parts_per_hour"] == pytest.approx(3600 * 2 / report["cycle_time"])


def test_the_same_input_gives_the_same_bytes(planned, tasks_folder, tmp_path):
    """A second process with another hash seed writes identical files."""
    again = tmp_path / "again"
    task = tasks_folder / "01_first_pick" / "tasks.yaml"
    quick = ("--effort", "quick")
    result = dualarm("plan", task, "--out", again, *quick, env=os.environ | {"PYTHONHASHSEED": "7"})
    assert result.returncode == 0, result.stderr
    assert hashes(again) == hashes(planned[1])


def test_results_are_not_overwritten_unasked(planned, tasks_folder):
    """Exit 2, what to do, and the old files untouched; --force replaces them."""
    out = planned[1]
    before = hashes(out)
    task = tasks_folder / "01_first_pick" / "tasks.yaml"
    refused = dualarm("plan", task, "--out", out)
    assert refused.returncode == 2
    assert "already holds a schedule; add --force" in refused.stderr
    assert hashes(out) == before
    force = ("--force", "--quiet", "--effort", "quick")
    assert dualarm("plan", task, "--out", out, *force).returncode == 0
    assert hashes(out) == before


def test_without_out_the_folder_is_named_after_the_job(tasks_folder, tmp_path):
    """Of tasks.yaml its folder in the working directory; --quiet prints a line: cycle time, verdict, folder."""
    task = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    result = dualarm(
        "plan",
        task,
        "--quiet",
        "--effort",
        "quick",
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(Path.cwd())},
    )
    assert result.returncode == 0, result.stderr
    report = json.loads((tmp_path / "03_bottin_planar-plan" / "report.json").read_text())
    caveat = ", not fully checked" * bool(report["verification"]["caveats"])
    verdict = f"verification: passed{caveat}: 03_bottin_planar-plan"
    assert result.stdout == f"{report['cycle_time']:.3f} s, {verdict}\n"
    assert (tmp_path / "03_bottin_planar-plan" / "schedule.json").exists()


def test_a_plan_ends_with_at_most_sixty_words_and_opens_its_page(
    tasks_folder, tmp_path, monkeypatch, capsys
):
    """Three lines without -v; --open shows what the last one names."""
    opened = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("webbrowser.open", opened.append)
    command = ["plan", str(tasks_folder / "05_two_robots" / "tasks.yaml"), "--effort", "quick"]
    assert run([*command, "--open", "--no-page"]) == 2
    assert (
        "--open shows the page of the plan: it does not go with --no-page"
        in capsys.readouterr().err
    )
    assert run([*command, "--open"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 3
    assert len(" ".join(lines).split()) <= 60
    assert lines[-1].endswith(" notes: add -v")
    assert opened == [(tmp_path / "05_two_robots-plan" / "report.html").as_uri()]


@pytest.mark.parametrize(
    ("tasks", "name"),
    [
        ("line/tasks.yaml", "line"),
        ("line/two.yaml", "two"),
        ("tasks.yaml", "cell"),
        ("line/../tasks.yaml", "cell"),
    ],
)
def test_two_jobs_have_two_folders(tasks, name, tmp_path, monkeypatch):
    """By file; the jobs that everybody calls tasks.yaml by their folder."""
    (tmp_path / "cell").mkdir()
    monkeypatch.chdir(tmp_path / "cell")
    assert _job_name(Path(tasks)) == name


def test_plan_as_json_is_one_document(tasks_folder, tmp_path):
    """Nothing else on stdout."""
    task = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    result = dualarm("plan", task, "--out", tmp_path / "out", "--json", "--effort", "quick")
    assert json.loads(result.stdout)["format"] == "dualarm.report/1"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["plan", "nowhere.yaml"], 2, "nowhere.yaml"),
        (["plan"], 2, "Missing argument"),
        (["plan", "x.yaml", "--effort", "medium"], 2, "'--effort': 'medium' is not one of 'quick'"),
        (["plan", "x.yaml", "--rate", "nan"], 2, "--rate nan"),
        (
            ["plan", "x.yaml", "--rate", "0"],
            2,
            "--rate 0: must be at least 0.001 and at most 10000 Hz",
        ),
        (["plan", "x.yaml", "--rate", "inf"], 2, "--rate inf"),
        (
            ["plan", "x.yaml", "--columns", "position,torque"],
            2,
            "--columns: there is no column 'torque'",
        ),
        (["plan", "x.yaml", "--columns", ""], 2, "--columns: there is no column ''"),
        (["robot", "show", "sda10"], 2, "did you mean 'sda10f'"),
        (["frobnicate"], 2, "No such command"),
        (["platform", "--links", "70 mm"], 2, "needs 2 values, got 1"),
        (["platform", "--radius", "5 kg"], 2, "kg"),
        (["platform", "--start", "1 m, 0; 0, 1 m"], 2, "cannot reach its start point"),
        (["platform", "--plot", "x.gif"], 2, "must end in .png"),
        (["verify", "nowhere"], 2, "there is no such file"),
    ],
)
def test_bad_usage_is_exit_2_with_what_was_wrong(arguments, code, words, capsys):
    """One sentence on stderr, never a traceback, nothing on stdout."""
    assert run(arguments) == code
    captured = capsys.readouterr()
    assert words in captured.err
    assert "Traceback" not in captured.err
    assert captured.out == ""


def test_a_rate_that_no_plan_is_short_enough_for_is_refused_before_anything_is_planned(
    tasks_folder, tmp_path, capsys, monkeypatch
):
    """A thousandth of full speed: how many rows there would be at least, and how many per second there may be."""
    (tmp_path / ".git").mkdir()
    folder = tasks_folder / "04_packing"
    (tmp_path / "cell.yaml").write_text((folder / "cell.yaml").read_text())
    text = (folder / "tasks.yaml").read_text().replace("return: true", "return: true\nspeed: 0.1%")
    (tmp_path / "tasks.yaml").write_text(text)
    out = tmp_path / "out"
    monkeypatch.setattr(planner, "plan", lambda *_, **__: pytest.fail("it is planned"))
    task = str(tmp_path / "tasks.yaml")
    assert run(["plan", task, "--out", str(out), "--rate", "10000"]) == 2
    message = capsys.readouterr().err
    least = float(re.search(r"at least ([\d,]+) rows", message)[1].replace(",", ""))
    most = int(re.search(r"ask for at most (\d+) Hz", message)[1])
    assert least > 1_000_000
    assert most * least / 10_000 <= 1_000_000 < (most + 1) * least / 10_000 * 1.001
    assert not out.exists()


@pytest.mark.parametrize("options", [(), ("--rate", "5000")])
def test_a_plan_whose_table_would_be_too_long_is_written_with_fewer_rows(
    options, tasks_folder, tmp_path, monkeypatch
):
    """And the report says so: what was planned is not lost."""
    monkeypatch.setattr(cli_plan, "MAX_ROWS", 500)
    monkeypatch.setattr(cli_plan, "refuse_rate", lambda *_: None)
    task, out = tasks_folder / "01_first_pick" / "tasks.yaml", tmp_path / "out"
    command = ["plan", str(task), "--out", str(out), "--platform", "fixed", "-q", *options]
    assert run(command) == 0
    report = json.loads((out / "report.json").read_text())
    asked = options[1] if options else "250"
    (note,) = [note for note in report["notes"] if note.startswith("schedule.csv")]
    rate = int(re.search(rf"(\d+) rows per second rather than {asked},", note)[1])
    assert rate * report["cycle_time"] <= 500 < (rate + 1) * report["cycle_time"]
    rows = (out / "schedule.csv").read_text().splitlines()[1:]
    assert rate * report["cycle_time"] <= len(rows) <= 510


def test_json_also_on_failure(capsys):
    """One document with the exit code and the message."""
    assert run(["plan", "nowhere.yaml", "--json"]) == 2
    document = json.loads(capsys.readouterr().out)
    assert document["format"] == "dualarm.error/1"
    assert document["exit_code"] == 2


def test_an_internal_error_is_exit_4(monkeypatch, capsys):
    """A bug is said to be one; it does not look like a regression."""
    import dualarm_cli.files.source.bundled as bundled

    def broken():
        raise ZeroDivisionError("seven")

    monkeypatch.setattr(bundled, "bundled_robots", broken)
    assert run(["robot", "list"]) == 4
    assert "internal error: ZeroDivisionError: seven" in capsys.readouterr().err


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_end_a_plan_at_once_and_leave_no_files(number, code, tasks_folder, tmp_path):
    """130 and 143 within two seconds, no half-written result."""
    out = tmp_path / "out"
    task = tasks_folder / "04_packing" / "tasks.yaml"
    process = subprocess.Popen(
        [sys.executable, "-m", "dualarm_cli", "plan", str(task), "--out", str(out)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    time.sleep(1.0)
    process.send_signal(number)
    begin = time.monotonic()
    _, err = process.communicate(timeout=20)
    assert process.returncode == code, err
    assert time.monotonic() - begin < AT_ONCE
    assert "Traceback" not in err
    assert not out.exists()


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_of_which_a_library_makes_another_error_is_a_signal(
    number, code, monkeypatch, capsys
):
    """As pydantic does while it builds a model."""

    def wrapping(_arguments):
        try:
            signal.raise_signal(number)
        except BaseException:
            raise RuntimeError("cannot build the model") from None

    before = [signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)]
    monkeypatch.setattr("dualarm_cli.cli.run._run_command", wrapping)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        assert run(["solvers"]) == code
    finally:
        for one, handler in zip((signal.SIGINT, signal.SIGTERM), before, strict=True):
            signal.signal(one, handler)
    assert "internal error" not in capsys.readouterr().err


def test_an_interrupt_within_a_generated_method_ends_with_the_exit_code_too(tmp_path):
    """CPython marks a KeyboardInterrupt that went through `exec` of a text, and would die of SIGINT at exit."""
    (tmp_path / "interrupted.py").write_text(
        "import dualarm_cli.cli.run as command_line\n"
        "from dualarm_cli.__main__ import main\n"
        "def generating(arguments):\n"
        "    try:\n"
        "        exec('raise KeyboardInterrupt')\n"
        "    except KeyboardInterrupt:\n"
        "        return 130\n"
        "command_line.run = generating\n"
        "main()\n"
    )
    folders = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    result = subprocess.run(
        [sys.executable, "-m", "interrupted"],
        env=os.environ | {"PYTHONPATH": folders},
        check=False,
    )
    assert result.returncode == 130


def test_the_end_of_a_process_is_not_lost(tmp_path):
    """Its exit code, what is still to be written, what libraries do as it ends, and a profile of it."""
    (tmp_path / "ending.py").write_text(
        "import atexit\n"
        "import dualarm_cli.cli.run as command_line\n"
        "from dualarm_cli.__main__ import main\n"
        "def printing(arguments):\n"
        "    print('a result', end='')\n"
        "    return 3\n"
        "command_line.run = printing\n"
        "atexit.register(print, ' and more')\n"
        "main()\n"
    )
    folders = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    # A profiled program's exit code is not that of cProfile.
    for how, code in (([], 3), (["-m", "cProfile", "-o", tmp_path / "profile"], 0)):
        result = subprocess.run(
            [sys.executable, *how, "-m", "ending"],
            env=os.environ | {"PYTHONPATH": folders},
            capture_output=True,
            text=True,
            check=False,
        )
        assert result.returncode == code
        assert (result.stdout, result.stderr) == ("a result and more\n", "")
    assert (tmp_path / "profile").stat().st_size > 0


def test_a_closed_pipe_is_no_traceback(tasks_folder):
    """`dualarm robot show sda10f | head -1`."""
    command = f"{sys.executable} -m dualarm_cli robot show sda10f | head -1"
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=False)
    assert "Traceback" not in result.stderr


def test_help_loads_no_heavy_library():
    """What --help imports: no numpy, pinocchio, toppra, ruckig, pydantic, yaml."""
    code = (
        "import sys; from dualarm_cli.cli.run import run; run(['--help']); "
        "print([m for m in ('numpy','pinocchio','toppra','ruckig','pydantic','yaml',"
        "'matplotlib') if m in sys.modules], file=sys.stderr)"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stderr.strip() == "[]"
    for command in ("plan", "platform", "verify", "check", "robot", "solvers"):
        assert command in result.stdout


def test_plan_loads_neither_toppra_nor_matplotlib(tasks_folder, tmp_path):
    """The default path stays light."""
    task = tasks_folder / "03_bottin_planar" / "tasks.yaml"
    code = (
        "import sys; from dualarm_cli.cli.run import run; "
        f"run(['plan', {str(task)!r}, '--out', {str(tmp_path / 'o')!r}, '--quiet']); "
        "print([m for m in ('toppra','matplotlib') if m in sys.modules])"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert result.stdout.splitlines()[-1] == "[]"


def test_colour_is_off_where_there_is_no_terminal(planned):
    """No escape codes in a pipe."""
    assert "\x1b" not in planned[0].stdout
    assert "\x1b" not in planned[0].stderr


def test_a_latin_stdout_gets_text_and_not_a_crash():
    """LANG=C with an ASCII stdout."""
    environment = os.environ | {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    for command in (["platform"], ["platform", "--json"], ["robot", "list"]):
        result = dualarm(*command, env=environment)
        assert result.returncode == 0, result.stderr


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("std::bad_alloc"),
        RuntimeError("can't start new thread"),
        OSError(12, "Cannot allocate memory"),
        ImportError("libgfortran.so.5: failed to map segment from shared object"),
    ],
)
def test_too_little_memory_is_no_bug(error, monkeypatch, capsys):
    """Whatever the library raises that has too little of it."""
    monkeypatch.delenv("DUALARM_DEBUG", raising=False)

    def fail(_arguments):
        raise error

    monkeypatch.setattr(run_module, "_run_command", fail)
    assert run_module.run(["plan"]) == 4
    said = capsys.readouterr().err
    assert "not enough memory" in said
    assert "bug" not in said


@pytest.mark.parametrize("megabytes", [100, 250, 399])
def test_a_plan_within_too_little_memory_says_so(megabytes, tmp_path, tasks_folder):
    """Before any library is loaded that would not end."""
    most = megabytes * 1_000_000
    ended = dualarm(
        *("plan", tasks_folder / "02_two_trays/tasks.yaml", "--out", tmp_path / "out"),
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (most, most)),
    )
    assert ended.returncode == 4
    assert "not enough memory" in ended.stderr
    assert "bug" not in ended.stderr
    assert not (tmp_path / "out").exists()


def test_a_suggestion_ends_with_one_mark(capsys):
    """The command line's own words end with a question mark where they guess."""
    assert run_module.run(["verfy"]) == 2
    assert "'verify'? Try 'dualarm --help'." in capsys.readouterr().err
