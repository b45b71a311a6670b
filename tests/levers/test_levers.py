"""Levers of plans: values that readers take, estimates against plans, choice of what is re-planned."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from io import StringIO
from itertools import islice
from pathlib import Path
from time import monotonic
from types import SimpleNamespace
from typing import Any

import jsonschema
import pytest
from rich.console import Console

from dualarm_cli.cli.run import run
from dualarm_cli.errors import InputError, UsageError
from dualarm_cli.evaluation.evaluate import settings_of
from dualarm_cli.evaluation.request import Request
from dualarm_cli.exporting.whole_files import replace_all
from dualarm_cli.files.source.bundled import robots_folder
from dualarm_cli.files.source.overrides import Overrides
from dualarm_cli.files.source.projects import Project
from dualarm_cli.files.studies.studies import job_documents
from dualarm_cli.files.tasks.tasks import load_job
from dualarm_cli.levers.applying import applied, edited
from dualarm_cli.levers.changes import Lever, documents_of, levers
from dualarm_cli.levers.document import best_set, sentences
from dualarm_cli.levers.estimates import (
    ONLY_PLANNED,
    Estimate,
    estimated_levers,
    with_raised_limits,
)
from dualarm_cli.levers.replanning import Replanned, Replanner, merged, replan, request_of
from dualarm_cli.model.settings import PlanSettings
from dualarm_cli.model.studies.evaluation import Evaluation
from dualarm_cli.planning.planner import plan_without_bound
from dualarm_cli.planning.redundancy_choice import with_redundancy
from dualarm_cli.report.comparison.why_table import combinations_table
from dualarm_cli.schemas.kinds_of_files import result_schema
from dualarm_cli.schemas.result_fields import RESULTS


def of_file(tasks: Path) -> list[Lever]:
    """Returns the levers of a job."""
    return levers(documents_of(tasks))


@pytest.mark.parametrize(
    "name", ["04_packing", "09_yumi", "12_chute", "13_hand_over", "15_conveyor"]
)
def test_readers_take_every_lever(name: str, tasks_folder: Path) -> None:
    """Each changes the job; `mode: free` is refused where it does not go with paths."""
    tasks = tasks_folder / name / "tasks.yaml"
    before, every = load_job(tasks), of_file(tasks)
    assert len({str(lever) for lever in every}) == len(every)
    for lever in every:
        try:
            after = load_job(tasks, tasks.name, lever.values)
        except InputError:
            assert (name, lever.name) == ("09_yumi", "mode")  # its path needs paired arms
            continue
        assert pickle.dumps(after) != pickle.dumps(before)
        if lever.kind == "robot":
            raised = with_raised_limits(before, lever).limits
            for rate in ("velocity", "acceleration", "jerk"):
                assert getattr(raised, rate) == pytest.approx(getattr(after.limits, rate))


TASKS = """dualarm: tasks/1
cell: cell.yaml
mode: paired
order: given
defaults: {approach: 50 mm, retract: 40 mm, dwell: {gripper: 0.2, settle: 0.1}}
tasks:
  - {id: a, arm: left, pick: {xyz: [0.5, 0.6, 0.2], rpy: [180 deg, 0, 0]}, place: {at: tray, xyz: [0, 0, 0]}}
  - id: b
    arm: right
    pick: {xyz: [0.5, -0.6, 0.2], rpy: [180 deg, 0, 0]}
    place: {xyz: [0.6, -0.4, 0.2], rpy: [180 deg, 0, 0]}
"""
CELL = """dualarm: cell/1
robot:
  left:  {robot: iiwa7, base: {xyz: [0, 0.6, 0]}}
  right: {robot: iiwa7, base: {xyz: [0, -0.6, 0]}}
frames: {tray: {xyz: [0.5, 0.4, 0.2], rpy: [180 deg, 0, 0]}}
"""


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """Returns a task file of two arms with two tasks."""
    (tmp_path / "cell.yaml").write_text(CELL)
    (tmp_path / "tasks.yaml").write_text(TASKS)
    return tmp_path / "tasks.yaml"


def test_estimates_of_kept_postures_are_the_plans_own(cell: Path) -> None:
    """Stops at both ends of lines: the same motion with other dwells and limits, planned by itself."""
    settings = PlanSettings(blend="none", effort="quick")
    schedule = plan_without_bound(load_job(cell), settings, check_collisions=False)
    gains = {str(e.lever): e.gain for e in estimated_levers(schedule, load_job(cell), cell)}
    # Both arms pick, then both place.
    assert gains["gripper 0.2 to 0.1 s"] == pytest.approx(2 * 0.1, abs=1e-6)
    assert gains["settle 0.1 to 0 s"] == pytest.approx(2 * 0.1, abs=1e-6)
    for name in ("approach 50 mm to 25 mm", "acceleration of all joints"):
        [full] = [key for key in gains if key.startswith(name)]
        [lever] = [lever for lever in of_file(cell) if str(lever) == full]
        changed = load_job(cell, None, lever.values)
        anew = plan_without_bound(changed, settings, check_collisions=False)
        gain = schedule.duration - anew.duration
        assert gains[full] == pytest.approx(gain, rel=0.3)
        assert gain > 0.02
    # The speed limits are in the robot's URDF, which no lever changes.
    robot = load_job(cell).cell.robot
    limits = replace(robot.limits, velocity=1.2 * robot.limits.velocity)
    faster = replace(load_job(cell).cell, robot=replace(robot, limits=limits))
    anew = plan_without_bound(
        replace(load_job(cell), cell=faster), settings, check_collisions=False
    )
    gain = schedule.duration - anew.duration
    assert gains["speed of all joints +20%"] == pytest.approx(gain, rel=0.3)
    assert gain > 0.02


def test_arms_without_platform_need_no_stages(cell: Path) -> None:
    """The left arm dwells for long in the first two stages, the right arm in the last two; by itself each has two."""
    text = cell.read_text()
    first = text[text.index("  - {id: a") :]
    second = first.replace("id: a", "id: c").replace("id: b", "id: d\n    dwell: 1.3 s")
    cell.write_text(text.replace("id: a,", "id: a, dwell: 1.3 s,") + second)
    job, settings = load_job(cell), PlanSettings(effort="quick")
    schedule = plan_without_bound(job, settings)

    def of_mode() -> Estimate:
        found = estimated_levers(schedule, load_job(cell), cell)
        return next(e for e in found if e.lever.name == "mode")

    free = plan_without_bound(load_job(cell, None, of_mode().lever.values), settings)
    # Beside two of the four long dwells, an arm no longer waits for the slower motion of each stage.
    assert of_mode().gain == pytest.approx(2 * (1.3 - 0.3), abs=0.4)
    assert of_mode().gain == pytest.approx(schedule.duration - free.duration, rel=0.15)
    # A task after another one may have to wait.
    cell.write_text(cell.read_text().replace("id: b\n", "id: b\n    after: [a]\n"))
    assert (of_mode().gain, of_mode().reason) == (None, ONLY_PLANNED)


def test_start_grasps_and_blends_are_levers(cell: Path) -> None:
    """A closed cycle starts anywhere, a task takes any grasp of its part, and a move is passed twice as far away."""
    text = cell.read_text().replace("order: given", "order: given\nreturn: true")
    text = text.replace("dwell: {", "blend: 10 mm, dwell: {")
    cell.write_text(text.replace("id: a,", "id: a, part: cup, grasp: top,"))
    grasp = "{xyz: [0, 0, 0], rpy: [0, 0, 90 deg]}"
    cup = f"{{shapes: [{{sphere: {{radius: 10 mm}}}}], grasps: {{top: {grasp}, side: {grasp}}}}}"
    cell.with_name("cell.yaml").write_text(f"{CELL}parts: {{cup: {cup}}}\n")
    by_name = {str(one): one for one in of_file(cell)}
    free = by_name["start home to free"]
    assert load_job(cell, None, free.values).start == "free"
    any_grasp = load_job(cell, None, by_name["grasps of the file to any"].values)
    assert len(any_grasp.tasks[0].grasps) == 2
    given = "  - {id: c, part: cup, handover: {grasp: side}}\n"
    cell.write_text(cell.read_text() + given)
    [any_grasp] = [one for one in of_file(cell) if one.name == "grasps"]
    assert any_grasp.values == {
        "tasks:/tasks/0/grasp": ["top", "side"],
        "tasks:/tasks/2/handover/grasp": ["top", "side"],
    }
    assert not by_name["blend 10 mm to 20 mm"].is_modelled
    assert (free.is_number, free.is_modelled) == (False, False)
    cell.write_text(text.replace("return: true", ""))
    assert not [one for one in of_file(cell) if one.name == "start"]


def test_times_that_vary_and_care_are_levers(cell: Path) -> None:
    """Least, nominal and greatest time are halved; 90 % of the speed becomes all of it, 50 % becomes 60 %."""
    text = cell.read_text().replace("gripper: 0.2", "gripper: [80 ms, 120 ms, 200 ms]")
    cell.write_text(text.replace("id: a,", "id: a, part: cup, speed: 90 %,"))
    cup = "{shapes: [{sphere: {radius: 10 mm}}], while_holding: {acceleration: 50 %}}"
    cell.with_name("cell.yaml").write_text(f"{CELL}parts: {{cup: {cup}}}\n")
    by_name = {one.name: one for one in of_file(cell)}
    [halved] = load_job(cell, None, by_name["gripper"].values).tasks[0].stops[0].varying
    assert (halved.least, halved.nominal, halved.most) == pytest.approx((0.04, 0.06, 0.1))
    assert by_name["gripper"].change == "-50%"
    [careful] = [t for t in load_job(cell, None, by_name["care"].values).tasks if t.id == "a"]
    assert (careful.care.speed, careful.holding.acceleration) == pytest.approx((1.0, 0.6))
    assert not by_name["care"].is_modelled
    assert by_name["care"].change == "+11.1% to +20%"


def test_the_largest_estimate_is_said_where_nothing_is_replanned() -> None:
    """A half and a tenth of a plan of 10 s."""
    estimates = [Estimate(lever("a"), 1.0), Estimate(lever("b"), 5.0), Estimate(lever("c"), None)]
    [words] = sentences(Plan(), None, [], estimates)  # type: ignore[arg-type]
    assert words == "largest estimate: b, 5.000 s (-50.0%); nothing was re-planned"


def test_levers_without_an_estimate_are_named() -> None:
    """Of a job with belts nothing has an estimate; another order has none in any job."""
    order = Estimate(lever("order", kind="search"), None, ONLY_PLANNED)
    estimates = [Estimate(lever("a"), None, "parts move"), order]
    belts, orders = sentences(Plan(), None, [], estimates)  # type: ignore[arg-type]
    assert belts == "no lever has an estimate: parts move"
    assert orders == "only new plans show what these gain, with --budget '5 min': order"
    evaluation = Evaluation("", "planned", cycle_time=9.0)
    replanned = [Replanned((order.lever,), evaluation, 10.0)]
    [_, best] = sentences(Plan(), None, replanned, estimates)  # type: ignore[arg-type]
    assert best == "most of what was re-planned: order gives 9.000 s, verified (-10.0%)"


def test_a_budget_that_is_met_asks_for_no_fewer_levers() -> None:
    """A plan of 10 s within 11 s: the largest gain is applied, not the smallest."""
    results = [
        Replanned((lever(name),), Evaluation("", "planned", cycle_time=time), 10.0)
        for name, time in (("little", 9.9), ("much", 8.0))
    ]
    best = best_set(results, 11.0)
    assert best is not None and best.names == ["much"]
    best = best_set(results, 9.95)
    assert best is not None and best.names == ["little"]


def lever(name: str, *keys: str, kind: Any = "process") -> Lever:
    """Returns a lever that changes keys of the task file."""
    return Lever(name, "", kind, {f"tasks:/{key}": 1 for key in keys})


GAINS = {"a": 2.0, "b": 1.5, "c": 0.5, "d": 0.4, "e": 0.1}


class Plan:
    """Schedule of 10 s."""

    duration = 10.0


def cycle(request: Request) -> float:
    """Returns the cycle of a job whose gains add up; together they lose a tenth."""
    gains = [GAINS[key.removeprefix("tasks:/")] for key in request.overrides]
    return 10.0 - sum(gains) * (0.9 if len(gains) > 1 else 1.0)


def planner(limit: float | None = None) -> Replanner:
    """Returns a planner whose plans are arithmetic."""

    def answered(requests: Sequence[Request]) -> Iterator[tuple[int, Evaluation]]:
        for k, request in reversed(list(enumerate(requests))):
            yield k, Evaluation(request.case, "planned", cycle_time=cycle(request))

    return Replanner(Plan(), Request("tasks.yaml", "/tasks.yaml"), answered, None, limit)  # type: ignore[arg-type]


@pytest.mark.parametrize("redundancy", [None, "arm_angle", "numeric", "min_norm", "still"])
@pytest.mark.parametrize("platform", ["sequence", "fixed"])
def test_levers_are_planned_with_the_settings_of_the_plan(
    platform: str, redundancy: str | None
) -> None:
    """A plan's record of its settings gives the settings that made it."""
    chosen = PlanSettings(timing="trapezoid", blend="none", effort="quick", seed=3)
    settings = with_redundancy(chosen.naming(platform=platform), redundancy).as_dict()
    recorded: Any = SimpleNamespace(provenance=SimpleNamespace(settings=settings))
    request = request_of(recorded, Path("tasks.yaml"), "tasks.yaml")
    assert settings_of(request).as_dict() == settings


ESTIMATES = [
    Estimate(lever("both", "a", "b"), 3.0),
    Estimate(lever("first", "a"), 1.9),
    Estimate(lever("second", "b"), 1.0),
    Estimate(lever("third", "c"), 0.4),
    Estimate(lever("fourth", "d"), 0.3),
    Estimate(lever("order", "e", kind="search"), None, "only another plan shows it"),
]


@pytest.mark.parametrize(
    ("required", "chosen", "cycle"),
    [
        (None, ["both", "third", "fourth"], 6.04),
        (9.0, ["both"], 6.85),
        (6.2, ["both", "third", "fourth"], 6.04),
    ],
)
def test_the_fewest_levers_that_meet_the_budget_are_chosen(
    required: float | None, chosen: list[str], cycle: float
) -> None:
    """By hand: 10 s less nine tenths of 2 + 1.5 + 0.5 + 0.4 s; two levers give 6.4 s only."""
    for limit, count in ((None, 2), (monotonic() + 1e3, 6)):
        replanner = planner(limit)
        replan(replanner, ESTIMATES, required)
        check_results(replanner, required, chosen, cycle)
        assert len(replanner.results) == count
    # With time, every lever is planned by itself, but for parts of larger ones.
    alone = {r.names[0].strip(): r.gain for r in replanner.results if len(r.levers) == 1}
    gains = {"both": 0.9 * 3.5, "third": 0.5, "fourth": 0.4, "order": 0.1}
    assert alone == pytest.approx(gains)


def check_results(
    replanner: Replanner, required: float | None, chosen: list[str], cycle: float
) -> None:
    """Asserts what is chosen, that nothing is planned twice, and that levers go together."""
    best = best_set(replanner.results, required)
    assert best is not None
    assert [name.strip() for name in best.names] == chosen
    assert best.evaluation.cycle_time == pytest.approx(cycle)
    assert len({tuple(result.names) for result in replanner.results}) == len(replanner.results)
    for result in replanner.results:
        assert len(merged(result.levers)) == sum(len(lever.values) for lever in result.levers)
    [words] = sentences(Plan(), required, replanner.results, [])  # type: ignore[arg-type]
    if required is not None:
        assert words.startswith(f"needs {required:g} s: ")


def test_plans_without_an_answer_in_time_are_counted() -> None:
    """Of two that are begun together the second one is answered."""
    replanner = planner(monotonic() + 1e3)
    whole = replanner.run
    replanner.run = lambda requests: islice(whole(requests), 1)
    replanner.plan([(lever("first", "a"),), (lever("second", "b"),)])
    assert [result.names[0].strip() for result in replanner.results] == ["second"]
    assert replanner.cut == 1


def test_nothing_is_begun_after_the_budget() -> None:
    """An instant that has passed."""
    replanner = planner(0.0)
    replan(replanner, ESTIMATES, None)
    assert replanner.results == []


def test_the_command_prints_its_document(
    planned_files: Callable[[str], Path],
    capsys: pytest.CaptureFixture[str],
    tasks_folder: Path,
    tmp_path: Path,
) -> None:
    """Estimates only, with tool changes: the path adds up to the cycle; the document is as its schema says."""
    plan = tmp_path / "plan"
    shutil.copytree(planned_files("14_two_grippers"), plan)
    tasks = tasks_folder / "14_two_grippers" / "tasks.yaml"
    arguments = ["why", str(plan), "--tasks", str(tasks), "--budget", "0"]
    assert run([*arguments, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    jsonschema.validate(document, result_schema("why", *RESULTS["why"]))
    assert sum(row["time"] for row in document["shares"]) == pytest.approx(document["cycle_time"])
    estimates = [row["estimate"] for row in document["levers"] if row["estimate"] is not None]
    assert estimates == sorted(estimates, reverse=True)
    by_name = {row["name"]: row["estimate"] for row in document["levers"]}
    # The left arm changes tools, and decides the cycle: half of 0.12 s at its eight picks and places.
    assert by_name["gripper"] == pytest.approx(8 * 0.06)
    assert run([*arguments, "-v"]) == 0
    printed = capsys.readouterr().out
    *tables, _, _ = printed.splitlines()
    assert max(map(len, tables)) <= 80
    assert "slack of others ms" in printed
    assert "-0.0 " not in printed


def test_the_plan_of_another_job_is_refused(
    planned_files: Callable[[str], Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """The same robot with other tasks, another robot, and a schedule of unknown settings."""
    plan = str(planned_files("01_first_pick"))
    for name, words in (("04_packing", "another job than"), ("09_yumi", "another robot than")):
        assert run(["why", plan, "--tasks", name, "--budget", "0"]) == 2
        assert words in capsys.readouterr().err
    shutil.copytree(plan, tmp_path / "foreign")
    document = json.loads((tmp_path / "foreign" / "schedule.json").read_text())
    document["provenance"]["settings"] = {}
    (tmp_path / "foreign" / "schedule.json").write_text(json.dumps(document))
    assert run(["why", str(tmp_path / "foreign"), "--tasks", "01_first_pick"]) == 2
    assert "does not state the settings" in capsys.readouterr().err


def test_levers_together_fit_in_80_columns() -> None:
    """Three long names, one a line; no plan where the levers do not go together."""
    names = ["approach and retract", "acceleration of the platform", "frame tray_right: yaw"]
    document = {
        "cycle_time": 10.0,
        "levers": [{"name": name, "change": "80 mm to 40 mm"} for name in names],
        "combinations": [
            {"levers": [0, 1, 2], "cycle_time": 7.5, "gain": 2.5},
            {"levers": [0, 2], "cycle_time": None, "gain": None},
        ],
    }
    console = Console(file=StringIO(), width=120)
    console.print(combinations_table(document))
    lines = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert max(map(len, lines)) <= 80
    assert sum("80 mm to 40 mm" in line for line in lines) == 5
    [first] = [line.split("│")[2:5] for line in lines if "7.500" in line]
    assert [cell.strip() for cell in first] == ["7.500", "2.500", "25.0"]
    assert sum("no plan" in line for line in lines) == 1


@pytest.mark.parametrize("name", ["04_packing", "09_yumi", "13_hand_over"])
def test_copies_say_what_the_levers_replace(name: str, tasks_folder: Path, tmp_path: Path) -> None:
    """Read again, a copy has the values that replacing them in memory gives; its comments stay."""
    tasks = tasks_folder / name / "tasks.yaml"
    for k, lever in enumerate([lever for lever in of_file(tasks) if lever.kind != "robot"][::4]):
        files, folder = applied(tasks, lever.values), tmp_path / str(k)
        replace_all(folder, {file: [content] for file, content in files.contents.items()})
        replaced = Project.of(tasks)
        replaced.overrides = Overrides(lever.values)
        copy = folder / files.tasks
        expected = job_documents(replaced, tasks, tasks.name)
        for role, document in job_documents(Project.of(copy), copy, copy.name).items():
            assert document.data == expected[role].data
        comments = [line for line in tasks.read_text().splitlines() if line.startswith("#")]
        assert [line for line in copy.read_text().splitlines() if line.startswith("#")] == comments
        changed = [line for line in files.difference.splitlines() if line.startswith("+")]
        assert len(changed) >= 2


@pytest.mark.parametrize(
    "old",
    [
        "grasp: top  # one",
        "grasp: [top, side]  # two",
        "grasp:  # two\n      [top,\n       side]",
        "grasp:\n    - top\n    - side  # two",
        "grasp:\n      - top\n      - side",
    ],
)
def test_copies_have_lists_in_place_of_lists(cell: Path, old: str) -> None:
    """In brackets or line by line; what follows stays."""
    old = f"    {old}\n"
    text = cell.read_text().replace("    arm: right\n", f"{old}    arm: right\n")
    cell.write_text(text)
    document = documents_of(cell)["tasks"]
    new = edited(document, {"/tasks/1/grasp": ["a", "b", "c"]})
    cell.write_text(new)
    data = documents_of(cell)["tasks"].data
    assert data["tasks"][1].pop("grasp") == ["a", "b", "c"]
    document.data["tasks"][1].pop("grasp")
    assert data == document.data
    assert new.endswith(text.partition(old)[2])


def test_another_robot_is_not_applied(tasks_folder: Path) -> None:
    """Its file may be of other cells as well."""
    with pytest.raises(UsageError, match="edit the robot file"):
        applied(tasks_folder / "04_packing" / "tasks.yaml", {"robot:/limits/torso_b1/jerk": 90})


def test_a_copy_has_the_meshes_of_its_robot(cell: Path, tmp_path: Path) -> None:
    """Those that collide and those that are only shown, which the URDF names beside it."""
    shutil.copytree(robots_folder() / "iiwa7", tmp_path / "iiwa7")
    tetrahedron = "v 0 0 0\nv .1 0 0\nv 0 .1 0\nv 0 0 .1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    urdf, link = tmp_path / "iiwa7" / "iiwa7.urdf", '<link name="link_7">'
    meshes = ""
    for kind in ("visual", "collision"):
        (tmp_path / "iiwa7" / f"{kind}.obj").write_text(tetrahedron)
        meshes += f"<{kind}><geometry><mesh filename='{kind}.obj'/></geometry></{kind}>"
    urdf.write_text(urdf.read_text().replace(link, link + meshes))
    file = cell.with_name("cell.yaml")
    file.write_text(CELL.replace("robot: iiwa7", "robot: iiwa7/robot.yaml"))
    names = {"tasks.yaml", "cell.yaml", *(f"iiwa7/{kind}.obj" for kind in ("visual", "collision"))}
    copied = set(applied(cell, {"tasks:/order": "optimise"}).contents)
    assert copied == names | {"iiwa7/robot.yaml", "iiwa7/iiwa7.urdf"}
