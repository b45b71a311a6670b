"""The Python interface: public names, one result by command and function, samples, errors, the notebook."""

from __future__ import annotations

import inspect
import json
import pickle
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from html import escape
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np
import pinocchio as pin
import pytest
from jsonschema import Draft202012Validator
from matplotlib.figure import Figure
from typer.testing import CliRunner

import dualarm_cli
from dualarm_cli import (
    InputError,
    Plan,
    ReachReport,
    Report,
    ScheduleComparison,
    SolverComparison,
    StudyReport,
    UsageError,
    compare,
    compare_solvers,
    load,
    plan,
    verify,
)
from dualarm_cli.cli.run import command_line
from dualarm_cli.effort import EFFORTS
from dualarm_cli.formats import FORMATS, FormatName
from dualarm_cli.formats.request import COLUMNS, Column
from dualarm_cli.interface import PlanOptions
from dualarm_cli.model import settings
from dualarm_cli.model.blending import BLENDINGS
from dualarm_cli.model.cell import Tool
from dualarm_cli.model.job import Task
from dualarm_cli.model.motion.trajectory import Trajectory
from dualarm_cli.model.robot import JointLimits
from dualarm_cli.model.shape import Shape
from dualarm_cli.model.verification import Check
from dualarm_cli.schemas import schema_of
from dualarm_cli.timing import TIMING_SOLVERS

ROOT = Path(__file__).parents[1]
PUBLIC = {
    "compare": "before after names",
    "compare_solvers": "jobs cases effort seed progress kept",
    "explain": "code",
    "export": "plan to job rate interpolation platform columns uniform",
    "inverse_kinematics": "job arm pose platform",
    "load": "tasks changes",
    "plan": "job platform redundancy timing blend effort seed time_limit progress",
    "plan_many": "jobs processes progress options",
    "reach": "robot height tilt step handover",
    "read_schedule": "path",
    "perturb": "tasks draws seed effort processes cache",
    "sweep": "study budget seed processes cache progress",
    "verify": "schedule job clearance",
}
"""Public functions and their parameters: what is changed here is changed for users."""
CLASSES = (
    "Check Diagnostic DualArmError Event Explanation Export InfeasibleError InputError Job JointSamples "
    "MissingDependencyError OutputError PerturbationReport Plan ReachReport Report Schedule ScheduleComparison "
    "SolverComparison StudyReport UsageError Verification"
)


@pytest.fixture(scope="module")
def found() -> Plan:
    """A small job's plan."""
    return plan(load("01_first_pick"), effort="quick")


def test_public_names_are_these_and_documented() -> None:
    """With their parameters."""
    assert sorted(dualarm_cli.__all__) == sorted([*PUBLIC, *CLASSES.split(), "__version__"])
    for name, parameters in PUBLIC.items():
        function = getattr(dualarm_cli, name)
        assert " ".join(inspect.signature(function).parameters) == parameters
        assert inspect.getdoc(function)
    for name in CLASSES.split():
        assert inspect.getdoc(getattr(dualarm_cli, name))


def fits(value: object, kind: object) -> bool:
    """Whether a JSON-ready value has a type: a class, union, literal, list, dict, tuple or TypedDict."""
    if kind is Any:
        return True
    if is_typeddict(kind):
        members = get_type_hints(kind)
        same = isinstance(value, dict) and members.keys() == value.keys()
        return same and all(fits(value[name], inner) for name, inner in members.items())
    outer, inner = get_origin(kind), get_args(kind)
    if outer is Literal:
        return value in inner
    if outer is UnionType:
        return any(fits(value, part) for part in inner)
    if outer in (list, tuple):
        if not isinstance(value, outer):
            return False
        parts = inner * len(value) if outer is list else inner
        return len(parts) == len(value) and all(map(fits, value, parts))
    if outer is dict:
        return isinstance(value, dict) and all(fits(part, inner[1]) for part in value.values())
    return isinstance(value, kind)


def test_reports_have_the_types_that_checkers_see(found: Plan) -> None:
    """Every member, also of a plan with hand-overs."""
    for report in (found.report, plan(load("13_hand_over"), platform="exact").report):
        hints = get_type_hints(Report)
        assert list(report) == list(hints)
        assert [name for name, kind in hints.items() if not fits(report[name], kind)] == []
    assert not fits({**found.report, "parts": "2"}, Report)


def test_documents_have_the_types_that_checkers_see_and_their_schemas(
    found: Plan,
) -> None:
    """Of two schedules with a cause, of methods on a job, of a table with hand-overs, of a study with failures."""
    study = {
        "dualarm": "study/1",
        "tasks": ["01_first_pick"],
        "parameters": {"clear": {"tasks": "tasks[0].pick.xyz[0]", "values": [0.45, 3.0]}},
        "settings": {"effort": "quick"},
    }
    slow = plan(load("01_first_pick", {"tasks:/speed": 0.5}), effort="quick")
    documents: list[tuple[str, type, Any]] = [
        ("schedule-comparison", ScheduleComparison, dualarm_cli.compare(found, slow)),
        (
            "comparison",
            SolverComparison,
            dualarm_cli.compare_solvers(found.job, effort="quick"),
        ),
        ("reach", ReachReport, dualarm_cli.reach(found.job, height=0.8, step=0.2, handover=0.1)),
        ("sweep", StudyReport, dualarm_cli.sweep(study, processes=1)),
    ]
    for kind, members, document in documents:
        hints = get_type_hints(members)
        assert list(document) == list(hints), kind
        assert [name for name, inner in hints.items() if not fits(document[name], inner)] == []
        wrong = Draft202012Validator(schema_of(kind)).iter_errors(document)
        assert [f"{error.json_path}: {error.message}" for error in wrong] == []
    assert documents[0][2]["stages"][0]["blame"] is not None
    assert documents[2][2]["handovers"] and documents[3][2]["failures"]
    assert "handovers" not in ReachReport.__required_keys__


def test_choices_that_checkers_see_are_those_that_exist() -> None:
    """Of the registries and tables; `plan` and `plan_many` take the same options."""
    for kind, names in (
        (settings.Effort, EFFORTS),
        (settings.Blend, BLENDINGS.names),
        (settings.Timing, TIMING_SOLVERS.names),
        (FormatName, FORMATS),
        (Column, COLUMNS),
    ):
        assert get_args(kind) == tuple(names)
    options = get_type_hints(PlanOptions)
    assert {name: get_type_hints(plan)[name] for name in options} == options
    assert [*options, "progress"] == [*inspect.signature(plan).parameters][1:]


def test_importing_the_package_is_quick_and_loads_nothing() -> None:
    """Names are loaded as they are used; `plan` stays the function when the planner's modules are there."""
    code = (
        "import sys, dualarm_cli; early = [m for m in ('numpy', 'pinocchio', 'yaml') if m in sys.modules]; "
        "from dualarm_cli import plan; import dualarm_cli.planning.planner; "
        "from dualarm_cli import plan as again; print(early, plan is again, callable(again))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split("\n")[0] == "[] True True"


def test_the_command_writes_what_python_writes(tmp_path: Path, found: Plan) -> None:
    """Byte for byte."""
    found.write(tmp_path / "python", page=False)
    arguments = ["plan", "01_first_pick", "--effort", "quick", "--no-page", "--quiet"]
    assert (
        CliRunner()
        .invoke(command_line(), [*arguments, "--out", str(tmp_path / "command")])
        .exit_code
        == 0
    )
    names = sorted(path.name for path in (tmp_path / "python").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "command").iterdir())
    for name in names:
        assert (tmp_path / "python" / name).read_bytes() == (
            tmp_path / "command" / name
        ).read_bytes()
    assert verify(tmp_path / "python", found.job).passed
    document = json.loads((tmp_path / "python" / "report.json").read_text())
    assert document["cycle_time"] == found.cycle_time == found.report["cycle_time"]
    assert found.verification is found.schedule.verification and found.verification.passed


def test_samples_are_the_motion_at_equal_steps(found: Plan) -> None:
    """Against the trajectory itself, and velocities against central differences of positions."""
    schedule = found.schedule
    samples = schedule.sample(rate=1000.0)
    assert samples.time[-1] == schedule.duration
    assert np.diff(samples.time)[:-1] == pytest.approx(1e-3)
    assert samples.position == pytest.approx(schedule.trajectory.at(samples.time)[0])
    middle = (samples.position[2:-1] - samples.position[:-3]) / 2e-3
    assert np.abs(middle - samples.velocity[1:-2]).max() < 1e-2
    one = schedule.joint("left_s")
    assert one.joints == ("left_s",) and one.position.shape == (len(one.time), 1)
    with pytest.raises(UsageError, match="has torso_b1"):
        schedule.joint("left_x")
    for rate in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="above 0 Hz"):
            schedule.sample(rate)


@pytest.mark.parametrize("rate", [1e7, 1e12])
def test_a_rate_with_more_samples_than_memory_has_room_for_is_refused(
    found: Plan, rate: float
) -> None:
    """As by an export; the rate that the message names is allowed."""
    for sample in (found.schedule.sample, found.schedule.to_dataframe):
        with pytest.raises(UsageError, match="at most 250,000 are allowed") as error:
            sample(rate)
        assert f"rate of {rate:g} Hz" in str(error.value)
    allowed = float(str(error.value).split()[-2])
    assert 249_990 < len(found.schedule.sample(allowed).time) <= 250_001


def test_a_trajectory_at_a_scalar_is_the_row_of_an_array(found: Plan) -> None:
    """Python and numpy scalars, and times equal to the ends but for rounding."""
    motion = found.schedule.trajectory
    for time in (0.5, np.float64(0.5), np.array(0.5), 0, motion.duration + 1e-12):
        for row, rows in zip(motion.at(time), motion.at(np.array([time])), strict=True):
            assert row.shape == (len(motion.joints),) and np.array_equal(row, rows[0])


def test_times_outside_a_motion_are_refused(found: Plan) -> None:
    """With the range, by itself or among others; the planner's own evaluation stands at the ends."""
    motion = found.schedule.trajectory
    for time in (99.0, -0.1, motion.duration + 1e-6, np.nan, [0.5, 99.0], np.inf):
        with pytest.raises(UsageError, match=rf"from 0 to {motion.duration:.10g} s"):
            motion.at(time)  # type: ignore[arg-type]
    for wrong in ("0.5", None, [True]):
        with pytest.raises(UsageError, match="must be numbers"):
            motion.at(wrong)  # type: ignore[arg-type]
    assert np.array_equal(motion.clamped(99.0)[0], motion.position[-1])


def test_jobs_plans_and_schedules_equal_themselves_alone(found: Plan) -> None:
    """They are keys of dicts; a copy is another object."""
    for record in (found, found.job, found.schedule):
        assert record == record and {record: 1}[record] == 1
        assert record != replace(record) and record != 1
    assert found.job != load("01_first_pick")


def test_a_tool_is_where_its_events_say_and_moves_as_its_jacobian_says(found: Plan) -> None:
    """Poses against the commanded targets, twists against central differences of poses."""
    schedule, h = found.schedule, 1e-5
    for event in schedule.events:
        error = pin.log6(event.pose.inverse() * schedule.tool_pose(event.arm, event.time))
        assert np.abs(error.vector).max() < 1e-6
    for arm in ("left", "right"):
        for time in np.linspace(0.1, schedule.duration - 0.1, 7):
            before, after = (schedule.tool_pose(arm, time + step) for step in (-h, h))
            turn = pin.log3(after.rotation @ before.rotation.T)
            measured = np.append(after.translation - before.translation, turn) / (2.0 * h)
            rates = schedule.trajectory.at(np.array([time]))[1][0]
            assert schedule.jacobian(arm, time) @ rates == pytest.approx(measured, abs=1e-4)
    with pytest.raises(UsageError, match=r"'middle'.*has left, right"):
        schedule.tool_pose("middle", 0.0)
    for function in (schedule.tool_pose, schedule.jacobian):
        for wrong in (-0.1, schedule.duration + 0.1, float("nan")):
            with pytest.raises(UsageError, match="must be from 0 to"):
                function("left", wrong)
        with pytest.raises(UsageError, match=r"shape \(2,\): must be one time \[s\]"):
            function("left", np.array([0.1, 0.2]))  # type: ignore[arg-type]


def test_objects_have_a_short_text_and_notebooks_show_figures_with_a_picture(
    found: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No URDF in a text; the picture is left out where matplotlib is not installed."""
    schedule = found.schedule
    exported, explained = dualarm_cli.export(found, "csv"), dualarm_cli.explain("E610")
    for shown in (found, schedule, found.job, schedule.robot, exported, explained):
        assert len(repr(shown)) < 80
    assert repr(found.job) == "<Job 01_first_pick of Yaskawa Motoman SDA10F: 2 tasks>"
    assert repr(replace(found.job, inputs={})) == "<Job of Yaskawa Motoman SDA10F: 2 tasks>"
    assert repr(exported) == f"<Export to csv: {len(exported.files)} files>"
    assert repr(replace(exported, files={"a.csv": []})) == "<Export to csv: 1 file>"
    assert repr(explained) == f"<Explanation: {explained.title}>"
    assert (
        repr(found)
        == f"<Plan of Yaskawa Motoman SDA10F: {found.cycle_time:.3f} s, 3 stages, verified>"
    )
    assert all(task.id in found.job._repr_html_() for task in found.job.tasks)
    assert "data:image/svg+xml" in found.job._repr_html_()
    for shown in (found, schedule):
        html = shown._repr_html_()
        assert f"{found.cycle_time:.3f} s" in html and "no shapes of left_tool" in html
        assert "data:image/svg+xml" in html
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    assert "<img" not in found._repr_html_() + found.job._repr_html_()
    with pytest.raises(dualarm_cli.MissingDependencyError, match=r"dualarm\[plot\]"):
        schedule.plot()


def test_the_text_of_everything_in_a_plan_is_a_short_line(found: Plan) -> None:
    """All records that a user comes to from a plan of tools with shapes, however deep; short values are whole."""
    packed = load("04_packing")
    texts: dict[type, str] = {}
    open_: list[object] = [found, found.schedule.trajectory, packed, packed.limits]
    seen = set()
    while open_:
        value = open_.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if is_dataclass(value):
            texts[type(value)] = max(texts.get(type(value), ""), repr(value), key=len)
            open_ += [getattr(value, field.name) for field in fields(value)]
        elif isinstance(value, Mapping):
            open_ += value.values()
        elif isinstance(value, tuple | list):
            open_ += value
    assert {Trajectory, Task, Tool, Shape, Check, JointLimits} <= texts.keys()
    assert {kind: text for kind, text in texts.items() if len(text) > 200 or "\n" in text} == {}
    shape = f"<ndarray of {found.schedule.trajectory.position.shape}>"
    assert f"position={shape}" in texts[Trajectory]
    dwell = found.job.tasks[0].stops[0].dwell
    assert repr(dwell) == f"Dwell(gripper={dwell.gripper}, settle={dwell.settle}, handshake=0.0)"


def test_curves_are_those_of_the_motion(found: Plan) -> None:
    """At the knots, for the named joints, in given axes."""
    schedule = found.schedule
    axes = Figure().subplots()
    assert schedule.plot("acceleration", ["left_s", "torso_b1"], axes) is axes
    assert [line.get_label() for line in axes.lines] == ["left_s", "torso_b1"]
    time, values = axes.lines[0].get_data()
    knots = np.searchsorted(time, schedule.joint("left_s").time)
    assert values[knots] == pytest.approx(schedule.joint("left_s").acceleration[:, 0])
    for quantity, joints in (("jerk", None), ("velocity", ["left_x"]), ("velocity", [])):
        with pytest.raises(UsageError):
            schedule.plot(quantity, joints, axes)  # type: ignore[arg-type]


def test_a_legend_covers_no_curve(found: Plan) -> None:
    """Of all joints, within the figure; a joint may be named without a list."""
    figure = Figure(layout="constrained")
    axes = found.schedule.plot(axes=figure.subplots())
    figure.draw_without_rendering()
    legend, curves = axes.get_legend().get_window_extent(), axes.get_window_extent()
    assert not legend.overlaps(curves)
    assert curves.width > 0.6 * figure.bbox.width
    assert figure.bbox.x1 >= legend.x1 and figure.bbox.y0 <= legend.y0
    axes = found.schedule.plot(joints="left_s", axes=Figure().subplots())
    assert [line.get_label() for line in axes.lines] == ["left_s"]


def test_data_frames_have_the_samples(found: Plan) -> None:
    """By time, three columns a joint."""
    table = found.schedule.to_dataframe(rate=50.0)
    samples = found.schedule.sample(50.0)
    assert table.shape == (len(samples.time), 3 * len(samples.joints))
    assert np.array_equal(
        table["right_b_velocity"], samples.velocity[:, samples.joints.index("right_b")]
    )


def test_what_is_not_installed_says_how_to_install_it(
    found: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pandas, for data frames alone."""
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(dualarm_cli.MissingDependencyError, match=r"dualarm\[dataframe\]"):
        found.schedule.to_dataframe()


def test_changes_are_checked_like_files_and_plans_differ(found: Plan) -> None:
    """A target 20 mm on; a target without a z is refused at its place."""
    said: list[str] = []
    moved = plan(
        load("01_first_pick", {"tasks:/tasks/0/pick/xyz/0": "470 mm"}),
        effort="quick",
        progress=said.append,
    )
    assert moved.verified and said[-1] == "verifying"
    steps = [text.rpartition("step ")[2] for text in said if ", step " in text]
    count = int(steps[0].split(" of ")[1])
    each = [f"{step + 1} of {count}" for step in range(count)]
    assert steps == each * (len(steps) // count)
    document = compare(found, moved, ("before", "after"))
    assert document["difference"] == moved.cycle_time - found.cycle_time != 0.0
    with pytest.raises(InputError) as error:
        load("01_first_pick", {"tasks:/tasks/0/pick/xyz": [0.47, 0.3]})
    assert error.value.diagnostics


@pytest.mark.parametrize(
    "wrong",
    [
        {"effort": "much"},
        {"blend": "all"},
        {"platform": "best"},
        {"time_limit": -1.0},
        {"time_limit": "x"},
    ],
)
def test_wrong_values_are_refused(found: Plan, wrong: dict[str, str]) -> None:
    """By name, before any work."""
    with pytest.raises(UsageError):
        plan(found.job, **wrong)  # type: ignore[arg-type]


def test_solvers_are_compared_as_by_the_command(found: Plan) -> None:
    """The same winner, as both plan the same."""
    from dualarm_cli.planning.comparison import cases

    matrix = cases(["fixed", "minimum_time"])
    document = compare_solvers(found.job, cases={"job": matrix}, effort="quick")
    arguments = ["compare", "solvers", "01_first_pick", "--json", "--effort", "quick"]
    methods = ["--method", "fixed", "--method", "minimum_time"]
    printed = CliRunner().invoke(command_line(), [*arguments, *methods]).stdout
    mine, others = (d["comparisons"][0]["rows"] for d in (document, json.loads(printed)))
    assert [row["cycle_time"] for row in mine] == [row["cycle_time"] for row in others]
    lines = str(document).splitlines()
    assert lines[-1] == document["comparisons"][0]["sentence"]
    for row in mine:
        assert any({row["method"], f"{row['cycle_time']:.3f}"} <= {*line.split()} for line in lines)
    assert f"<pre>{escape(str(document))}</pre>" == document._repr_html_()  # type: ignore[attr-defined]


def test_a_comparison_prints_as_by_the_command(found: Plan, tmp_path: Path) -> None:
    """The same words; it stays a dict that is JSON-ready and can be copied."""
    slow = plan(load("01_first_pick", {"tasks:/speed": 0.5}), effort="quick")
    folders = [
        str(one.write(tmp_path / name, page=False)) for name, one in (("a", found), ("b", slow))
    ]
    document = compare(folders[0], folders[1], (folders[0], folders[1]))
    printed = CliRunner().invoke(command_line(), ["compare", "schedules", *folders]).stdout
    assert str(document).split() == printed.split()
    assert str(pickle.loads(pickle.dumps(document))) == str(document)
    assert json.loads(json.dumps(document)) == document


@pytest.mark.parametrize(
    ("script", "result"),
    [("curves.py", "curves.png"), ("replan.py", "last-plan/report.json"), ("layouts.py 3", "")],
)
def test_scripts_of_the_docs_run(script: str, result: str, tmp_path: Path) -> None:
    """From start to end, in an empty folder, on a few layouts."""
    name, *arguments = script.split()
    environment = {"MPLBACKEND": "Agg", "PYTHONPATH": str(ROOT), "PATH": ""}
    done = subprocess.run(
        [sys.executable, ROOT / "docs" / "scripts" / name, *arguments],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert " s" in done.stdout
    assert (tmp_path / result).exists()


def test_the_docs_import_public_names_only() -> None:
    """Of the package itself, in pages and scripts; what makes the pages is not meant."""
    texts = [
        *(ROOT / "docs").rglob("*.md"),
        *(ROOT / "docs" / "scripts").glob("*.py"),
        ROOT / "README.md",
    ]
    for path in texts:
        for line in re.findall(
            r"^ *(?:from|import) (dualarm_cli.*)$", path.read_text(), re.MULTILINE
        ):
            names = re.fullmatch(r"dualarm_cli import ([\w, ]+)", line)
            assert names is not None, f"{path.name}: {line}"
            assert {name.strip() for name in names[1].split(",")} <= {*dualarm_cli.__all__}, line


@pytest.mark.slow
def test_a_strict_type_checker_sees_types(tmp_path: Path) -> None:
    """Of the public names and of a report's members, outside the source tree."""
    (tmp_path / "mine.py").write_text(
        "from dualarm_cli import compare, compare_solvers, load, plan, reach, sweep\n"
        "job = load('tasks.yaml')\n"
        "made = plan(job)\n"
        "reveal_type((\n"
        "    made.report['stages'][0]['bottleneck'],\n"
        "    compare(made, 'before')['stages'][0]['difference'],\n"
        "    compare_solvers(job)['comparisons'][0]['rows'][0]['cycle_time'],\n"
        "    reach(job)['area']['left'],\n"
        "    sweep('study.yaml')['rows'][0]['pareto'],\n"
        "))\n"
        "made.report['cycletime']\n"
    )
    environment = {"MYPYPATH": str(ROOT), "PATH": "", "HOME": str(tmp_path)}
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports", "silent", "mine.py"]
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    revealed = done.stdout.replace("builtins.", "")
    assert "tuple[str, float, float | None, list[float], bool]" in revealed, done.stdout
    assert "Found 1 error" in revealed
    assert """has no key "cycletime""" in done.stdout


def test_the_package_says_that_it_has_types() -> None:
    """`py.typed`, without which type checkers take each name for Any."""
    assert (ROOT / "dualarm_cli" / "py.typed").is_file()
