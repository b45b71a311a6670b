"""Kinds of work: each is one folder and one line of one list, and the rest works with it and without it."""

from __future__ import annotations

import dataclasses
import importlib
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from dualarm_cli import kinds
from dualarm_cli.cli.plan import figures_of
from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError
from dualarm_cli.files.tasks.schema_tasks import (
    DefaultsSection,
    TargetSection,
    TaskHead,
    TasksFile,
)
from dualarm_cli.files.tasks.task_reader import schemas_of
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.kinds import KINDS, of_kinds
from dualarm_cli.model.schedule import Schedule
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.report.console import summary_lines
from dualarm_cli.report.report import build_report
from dualarm_cli.verification import verify

SETTINGS = {"free", "window", "any", "sequence"}
"""What of a task file a kind may not go with, besides other kinds."""
READING = '''
"""Screws of task files: a tool drives one in at a place."""

from pydantic import Field

from dualarm_cli.files.source.fields import FramedPose
from dualarm_cli.files.tasks.schema_tasks import TaskHead
from dualarm_cli.files.tasks.task_reader import KindReading
from dualarm_cli.kinds.screw import RATE, ScrewStop
from dualarm_cli.model.dwell import Dwell
from dualarm_cli.model.job import PoseTarget


class ScrewSection(FramedPose):
    """A screw."""

    turns: float = Field(description="Turns until it is tight.")


class ScrewTask(TaskHead):
    """A task that may drive a screw."""

    screw: ScrewSection | None = Field(default=None, description="A screw to be driven in.")


def shares(reader, section, loc):
    """Returns the task."""
    screw, place = section.screw, (*loc, "screw")
    arm, pose = reader.arm(section, loc), reader.targets.pose(screw, None, place)
    dwell = Dwell(gripper=screw.turns / RATE)
    line = section.approach.distance if section.approach else 0.0
    stop = ScrewStop("move", PoseTarget(pose), line, line, dwell, reader.place(place), turns=screw.turns)
    return [reader.task(section, loc, arm, (stop,), "")]


READING = KindReading(key="screw", plural="screws", task_keys=ScrewTask, shares=shares)
'''
CHECKS = '''
"""Whether every screw is driven in for as long as it takes."""

from dualarm_cli.kinds.screw import RATE, ScrewStop
from dualarm_cli.verification.measuring.criteria import Criterion
from dualarm_cli.verification.kind_checks import KindChecks
from dualarm_cli.verification.tool_checks import Worst


def check(case):
    """Returns the check, by how many turns are missing."""
    worst = Worst()
    for span in case.spans:
        if isinstance(span.stop, ScrewStop):
            worst.add(span.stop.turns - RATE * span.event.dwell, span.event.task)
    return [worst.judge("screw_turns", 1e-6)]


CRITERIA = {"screw_turns": Criterion("turns", "Turns that a screw lacks.", "the job has no screws")}
CHECKS = KindChecks({"work": check}, CRITERIA)
'''
MEASURES = '''
"""What is measured of screws."""

from dualarm_cli.kinds.reporting import KindMeasures
from dualarm_cli.kinds.screw import ScrewStop
from dualarm_cli.verification.as_done import job_as_done


def rows(schedule, job):
    """Returns the screws."""
    stops = job_as_done(schedule, job).stops_by_key()
    found = [(e, stops.get((e.arm, e.task, e.action))) for e in schedule.events]
    return [{"task": e.task, "turns": s.turns, "time": e.dwell} for e, s in found if isinstance(s, ScrewStop)]


def lines(report):
    """Returns a sentence for each."""
    return [f"screw {row['task']}: {row['turns']:g} turns in {row['time']:.2f} s" for row in report["screws"]]


MEASURES = KindMeasures("work", {"screws": rows}, lines)
'''
PLANNING = '''
"""Screws in the planner: stops like others."""

from dualarm_cli.errors import InfeasibleError
from dualarm_cli.kinds.planning import KindPlanning
from dualarm_cli.kinds.screw import ScrewStop
from dualarm_cli.refusals import Refusal


def tight(job):
    """Returns a job whose screws all have turns."""
    for task in job.tasks:
        for stop in task.stops:
            if isinstance(stop, ScrewStop) and stop.turns <= 0.0:
                loose = Refusal("screw_loose", stop.place, task.id, measured=stop.turns, remedy=("more_turns",))
                raise InfeasibleError(loose)
    return job


PLANNING = KindPlanning(
    works=lambda task: any(isinstance(stop, ScrewStop) for stop in task.stops),
    decided=tight,
    notes=lambda job, settings, motion: ["screws: torque is not looked at"],
)
'''
REFUSALS = '''
"""Why a screw cannot be driven in."""

from dualarm_cli.explanations import Explanation, KindRefusals

REFUSALS = KindRefusals(
    "E690",
    Explanation("A screw cannot be driven in", ("It has no turns.",), ("Give it some.",)),
    {"screw_loose": "task '{task}': a screw of {measured:g} turns is loose"},
    {"more_turns": "turn it more often"},
)
'''
FIGURES = '''
"""Screws drawn."""

from dualarm_cli.kinds.drawing import KindFigures, new_figure, rendered
from dualarm_cli.kinds.screw import ScrewStop


def draw(schedule, job, kind):
    """Returns an empty figure."""
    return rendered(new_figure(1.0, 1.0), kind)


FIGURES = KindFigures("screws", lambda job: any(isinstance(s, ScrewStop) for t in job.tasks for s in t.stops), draw)
'''
DATA = '''
"""Screws."""

from dataclasses import dataclass

from dualarm_cli.model.job import Stop

RATE = 5.0
"""Turns a second."""


@dataclass(frozen=True)
class ScrewStop(Stop):
    """Where a screw is driven in."""

    turns: float = 0.0
    """How often it is turned."""
'''
BOLT = """
  - id: bolt
    arm: left
    approach: 30 mm
    screw: {xyz: [0.45, 0.30, 0.80], rpy: [180 deg, 0, 0], turns: 4}
"""


@pytest.fixture
def screw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A kind of work that is no part of the package: its folder, and its line in the list."""
    folder = tmp_path / "more_kinds" / "screw"
    folder.mkdir(parents=True)
    parts = {"__init__": DATA, "reading": READING, "planning": PLANNING}
    parts |= {"checks": CHECKS, "measures": MEASURES, "refusals": REFUSALS, "figures": FIGURES}
    for name, text in parts.items():
        (folder / f"{name}.py").write_text(text)
    monkeypatch.setattr(kinds, "__path__", [*kinds.__path__, str(folder.parent)])
    monkeypatch.setattr(kinds, "KINDS", {**KINDS, "screw": ("free",)})
    importlib.invalidate_caches()
    yield
    for name in [name for name in sys.modules if name.startswith("dualarm_cli.kinds.screw")]:
        del sys.modules[name]


@pytest.fixture
def job_file(tmp_path: Path, tasks_folder: Path) -> Path:
    """The smallest useful job, with a screw."""
    source = tasks_folder / "01_first_pick"
    (tmp_path / "cell.yaml").write_text((source / "cell.yaml").read_text())
    path = tmp_path / "tasks.yaml"
    path.write_text((source / "tasks.yaml").read_text().rstrip() + BOLT)
    return path


@pytest.fixture(scope="module")
def first_pick(tasks_folder: Path) -> Schedule:
    """A plan of the smallest useful job."""
    job = load_job(tasks_folder / "01_first_pick" / "tasks.yaml")
    return plan_without_bound(job, PlanSettings(effort="quick"))


@pytest.mark.usefixtures("screw")
def test_a_new_kind_is_a_folder_and_a_line(job_file: Path) -> None:
    """4 turns at 5 a second are 0.8 s at the screw: read, planned, judged, measured and told, and nothing else."""
    job = load_job(job_file)
    schedule = plan_without_bound(job, PlanSettings(effort="quick"))
    verification = verify(schedule, job, clearance=True)
    assert verification.passed
    assert schedule.notes[-1] == "screws: torque is not looked at"
    assert [c.verdict for c in verification.checks if c.name == "screw_turns"] == ["passed"]
    report = build_report(schedule, job)
    assert report["screws"] == [{"task": "bolt", "turns": 4.0, "time": pytest.approx(0.8)}]
    assert "screw bolt: 4 turns in 0.80 s" in summary_lines(report)
    assert [file.name for file in figures_of(Path("a.svg"), job)] == ["a.svg", "a_screws.svg"]
    hasty = [dataclasses.replace(e, dwell=0.6) if e.task == "bolt" else e for e in schedule.events]
    found = verify(dataclasses.replace(schedule, events=tuple(hasty)), job)
    [turns] = [check for check in found.failures if check.name == "screw_turns"]
    assert turns.measured == pytest.approx(4.0 - 5.0 * 0.6)


@pytest.mark.usefixtures("screw")
def test_a_new_kind_brings_its_refusals_and_their_code(
    job_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Sentence, remedy, code and explanation are in its folder alone, and `check` proves it before any search."""
    job_file.write_text(job_file.read_text().replace("turns: 4", "turns: 0"))
    line = len(job_file.read_text().splitlines())
    assert run(["check", str(job_file)]) == 3
    message = f"error[E690]: {job_file}:{line}:12: task 'bolt': a screw of 0 turns is loose; turn it more often"
    assert message in "".join(capsys.readouterr())
    assert run(["explain", "E690"]) == 0
    assert "Give it some." in capsys.readouterr().out


@pytest.mark.usefixtures("screw")
def test_what_a_new_kind_does_not_go_with_is_said(job_file: Path) -> None:
    """Its line in the list is all that the rules across tasks know of it."""
    text = job_file.read_text()
    job_file.write_text(text.replace("mode: paired", "mode: free"))
    with pytest.raises(InputError) as caught:
        load_job(job_file)
    [found] = caught.value.diagnostics
    assert found.code == "E310"
    assert found.message.startswith(
        "mode: free does not go with paths, coordinate tasks and screws (task 'bolt')"
    )
    job_file.write_text(text.replace("screw: {", "move: {xyz: [0, 0, 0]}\n    screw: {"))
    with pytest.raises(InputError) as caught:
        load_job(job_file)
    messages = [found.message for found in caught.value.diagnostics]
    assert messages == ["'screw' does not go with 'move'; make two tasks"]


def test_without_its_kind_a_key_is_unknown(job_file: Path) -> None:
    """No kind named screw, no key: what a kind adds comes with it alone."""
    with pytest.raises(InputError) as caught:
        load_job(job_file)
    [found] = caught.value.diagnostics
    assert (found.code, found.message[:19]) == ("E201", "unknown key 'screw'")


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_its_parts(kind: str) -> None:
    """Reading and checks, each told by its noun or key; what it does not go with are kinds and settings."""
    reading = importlib.import_module(f"dualarm_cli.kinds.{kind}.reading").READING
    checks = importlib.import_module(f"dualarm_cli.kinds.{kind}.checks").CHECKS
    assert bool(reading.key) == bool(reading.plural)
    assert checks.judge
    assert set(KINDS[kind]) <= SETTINGS | set(KINDS) - {kind}
    if not reading.key:
        assert KINDS[kind] == (), "only tasks of a kind by themselves can be told apart"


def test_reports_show_each_kind_but_hand_overs() -> None:
    """What is handed over is told among stages, waits and picks; every other kind has rows of its own."""
    shown = [key for measures in of_kinds("measures") for key in measures.rows]
    assert shown == ["paths", "seams", "conveyors", "tool_changes", "buffers"]


def _keys(kind: str) -> set[str]:
    """Returns the keys that a kind adds to task files."""
    reading = importlib.import_module(f"dualarm_cli.kinds.{kind}.reading").READING
    pairs = (
        (reading.task_keys, TaskHead),
        (reading.target_keys, TargetSection),
        (reading.defaults_keys, DefaultsSection),
        (reading.file_keys, TasksFile),
    )
    return {key for mine, core in pairs for key in set(mine.model_fields) - set(core.model_fields)}


def _said(value: object) -> Iterator[str]:
    """Yields all keys of a document."""
    if isinstance(value, dict):
        yield from value
    for inner in (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    ):
        yield from _said(inner)


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_has_an_example(kind: str, tasks_folder: Path) -> None:
    """A bundled task file uses its keys."""
    files = [yaml.safe_load(path.read_text()) for path in tasks_folder.rglob("tasks.yaml")]
    assert any(_keys(kind).intersection(_said(document)) for document in files)


@pytest.mark.parametrize("kind", KINDS)
def test_every_other_job_is_read_without_a_kind(
    kind: str, tasks_folder: Path, first_pick: Schedule, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its line taken out, its keys are unknown, and the smallest useful job is read, judged and told as ever."""
    path, keys = tasks_folder / "01_first_pick" / "tasks.yaml", _keys(kind)
    report = build_report(first_pick, load_job(path))
    monkeypatch.setattr(kinds, "KINDS", {k: apart for k, apart in KINDS.items() if k != kind})
    left = schemas_of(tuple(of_kinds("reading")))
    assert not keys.intersection(left.task.model_fields, left.file.model_fields)
    job = load_job(path)
    assert verify(first_pick, job).passed
    less = build_report(first_pick, job)
    assert less == {key: report[key] for key in less}
    assert summary_lines(less) == summary_lines(report)
