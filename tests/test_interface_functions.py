"""Functions of the Python interface beside planning: jobs without files, many plans, reach, postures, exports."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yaml
from typer.testing import CliRunner

from dualarm_cli import (
    InfeasibleError,
    InputError,
    OutputError,
    Plan,
    UsageError,
    compare,
    compare_solvers,
    explain,
    export,
    inverse_kinematics,
    load,
    plan,
    plan_many,
    reach,
    read_schedule,
    sweep,
    verify,
)
from dualarm_cli.cli.run import command_line
from dualarm_cli.errors import BlockedError, UnknownSolverError
from dualarm_cli.exporting.schedule_json import to_json
from dualarm_cli.files.studies.studies import load_study
from dualarm_cli.formats import FormatName
from dualarm_cli.refusals import Refusal
from dualarm_cli.studies import search

TASKS = Path(__file__).parents[1] / "tasks" / "01_first_pick"
X = "tasks:/tasks/left part/pick/xyz/0"


def values() -> dict:
    """Content of a bundled task file that holds its cell."""
    tasks, cell = (
        yaml.safe_load((TASKS / name).read_text()) for name in ("tasks.yaml", "cell.yaml")
    )
    return tasks | {"cell": cell}


@pytest.fixture(scope="module")
def found() -> Plan:
    """A small job's plan."""
    return plan(load("01_first_pick"), effort="quick")


def test_a_job_of_values_is_that_of_files(found: Plan) -> None:
    """The same motion; arrays and tuples are lists, and the files of a job of values are its texts."""
    given = values()
    for task in given["tasks"]:
        task["pick"]["xyz"] = np.array(task["pick"]["xyz"])
        task["place"]["xyz"] = tuple(task["place"]["xyz"])
    job = load(given)
    assert [*job.inputs][:2] == ["tasks", "cell"]
    motion = plan(job, effort="quick").schedule.motion
    for name, group in found.schedule.motion.groups.items():
        assert np.array_equal(group.acceleration, motion.groups[name].acceleration)
    changed = load(given, {"tasks:/speed": "50%", "cell:/clearance": "3 mm"})
    assert (changed.speed, changed.cell.clearance) == (0.5, 0.003)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"speed": {1}},
            r"tasks: E200 cannot be read: \{1\} is neither a number, text, list nor mapping",
        ),
        ({"speed": float("nan")}, "tasks: E200 cannot be read: .*nan"),
        ({"sped": 1}, "tasks:.*'sped', did you mean 'speed'"),
        ({"cell": {"dualarm": "cell/1"}}, "cell:1:1: E202 'robot' is missing"),
        ({"cell": "no.yaml"}, "there is no file 'no.yaml' here"),
    ],
)
def test_values_are_checked_like_files(wrong: dict, message: str) -> None:
    """With the role of the mapping as the file's name."""
    with pytest.raises(InputError, match=message):
        load(values() | wrong)


def test_changes_name_tasks_by_their_id() -> None:
    """An inserted task changes no meaning; an index is accepted, and a wrong id gets the nearest."""
    first, second = (
        load("01_first_pick", {name: 0.47}) for name in (X, X.replace("left part", "0"))
    )
    assert [job.tasks[0].stops[0].target.pose.translation[0] for job in (first, second)] == [
        0.47
    ] * 2
    given = values()
    given["tasks"].reverse()
    moved = load(given, {X: 0.47}).tasks
    assert {task.id: task.stops[0].target.pose.translation[0] for task in moved} == {
        "left part": 0.47,
        "right part": 0.45,
    }
    with pytest.raises(
        InputError, match=r"a list of 2 has no 'lft part', did you mean 'left part'\?"
    ):
        load("01_first_pick", {X.replace("left", "lft"): 0.47})


def test_changes_may_be_arrays_scalars_of_numpy_and_tuples() -> None:
    """Also within lists and mappings: as the same plain values."""
    xyz = "tasks:/tasks/left part/pick/xyz"
    for value in (
        np.array([0.44, 0.2, 0.8]),
        (0.44, np.float64(0.2), 0.8),
        [np.array(0.44), 0.2, 0.8],
    ):
        job = load("01_first_pick", {xyz: value})
        assert job.tasks[0].stops[0].target.pose.translation.tolist() == [0.44, 0.2, 0.8]
    for number in (np.float32(0.5), np.int64(1)):
        assert load("01_first_pick", {"tasks:/speed": number}).speed == number
    pick = {"xyz": np.array([0.44, 0.2, 0.8]), "rpy": ("180 deg", 0, np.int64(0))}
    job = load("01_first_pick", {"tasks:/tasks/0/pick": pick})
    assert job.tasks[0].stops[0].target.pose.translation[0] == 0.44


def test_many_plans_are_the_same_on_any_number_of_processes(found: Plan) -> None:
    """In the order of the jobs, byte for byte, with a job that has no plan among them."""
    jobs = [load("01_first_pick", {X: x}) for x in (0.45, 2.0, 0.47)]
    said: list[str] = []
    alone = plan_many(jobs, processes=1, effort="quick", progress=said.append)
    assert [text[:6] for text in said] == ["1 of 3", "2 of 3", "3 of 3"]
    time = f"{found.cycle_time:.3f} s"
    assert said[0] == f"1 of 3 jobs, job 0 (01_first_pick): {time}; best cycle time {time}"
    assert said[1].endswith(f"job 1 (01_first_pick): no plan; best cycle time {time}")
    shared = plan_many(jobs, processes=2, effort="quick")
    for one, two in zip(alone, shared, strict=True):
        if isinstance(one, Plan) and isinstance(two, Plan):
            first, second = (b"".join(to_json(p.schedule, "", {})) for p in (one, two))
            assert first == second
        else:
            assert isinstance(one, InfeasibleError) and str(one) == str(two)
    assert [isinstance(one, Plan) for one in alone] == [True, False, True]
    assert plan_many([]) == []
    for wrong in ({"processes": 0}, {"processes": "2"}, {"effort": "much"}, {"efort": "quick"}):
        with pytest.raises(UsageError):
            plan_many(jobs, **wrong)


def test_errors_keep_their_data_between_processes() -> None:
    """Also those whose constructors take other arguments than the text."""
    where = Refusal("at_platform_angle", data={"degrees": 30.0})
    refusal = Refusal("beyond_reach", measured=0.1, data={"point": "the target", "where": where})
    for error in (
        BlockedError(refusal, stages=(2,)),
        UnknownSolverError("timing", "x", ["ruckig"]),
    ):
        again = pickle.loads(pickle.dumps(error))
        assert (type(again), str(again), vars(again)) == (type(error), str(error), vars(error))


def test_postures_reach_their_pose(found: Plan) -> None:
    """By pinocchio on the URDF, with the platform turned; one of them is near that of the plan."""
    job, robot = found.job, found.job.cell.robot
    event, angle = found.schedule.events[0], 0.3
    model = pin.buildModelFromXML(robot.urdf)
    data, q = model.createData(), np.zeros(model.nq)
    assert tuple(model.names[1:]) == robot.joints
    for platform in (angle, None):
        postures = inverse_kinematics(job, event.arm, event.pose, platform)
        assert len(postures) and postures.shape[1] == 7
        q[robot.columns(robot.platform)] = job.start_joints[0] if platform is None else platform
        for posture in postures[:: len(postures) // 5]:
            q[robot.columns(robot.arm(event.arm).joints)] = posture
            pin.framesForwardKinematics(model, data, q)
            flange = data.oMf[model.getFrameId(robot.arm(event.arm).flange, pin.FrameType.BODY)]
            tool = job.cell.base * flange * job.cell.tools[event.arm].tcp
            assert np.abs(tool.homogeneous - event.pose.homogeneous).max() < 1e-9
    far = pin.SE3(np.eye(3), np.array([5.0, 0.0, 0.0]))
    assert inverse_kinematics(job.cell, "left", far).shape == (0, 7)
    with pytest.raises(UsageError, match="has left, right"):
        inverse_kinematics(job, "middle", far)
    with pytest.raises(UsageError, match="must have 1 positions"):
        inverse_kinematics(job, "left", far, np.zeros(2))
    from_matrix = inverse_kinematics(job, event.arm, event.pose.homogeneous)
    assert np.array_equal(from_matrix, inverse_kinematics(job, event.arm, event.pose))


def test_poses_and_platform_positions_that_make_no_sense_are_refused() -> None:
    """Reflected, scaled, sheared or cut matrices; a platform at 400 deg."""
    job, good = load("01_first_pick"), np.eye(4)
    for entry, value, message in (
        ((0, 0), -1.0, "no rotation matrix"),
        ((0, 0), 2.0, "no rotation matrix"),
        ((0, 1), 1e-3, "no rotation matrix"),
        ((3, 0), 0.1, r"must be \[0, 0, 0, 1\]"),
        ((0, 3), np.nan, "of finite numbers"),
    ):
        wrong = good.copy()
        wrong[entry] = value
        with pytest.raises(UsageError, match=message):
            inverse_kinematics(job, "left", wrong)
    for pose in (pin.SE3(np.eye(3), np.full(3, np.nan)), np.eye(3), "pose"):
        with pytest.raises(UsageError, match="of finite numbers"):
            inverse_kinematics(job, "left", pose)  # type: ignore[arg-type]
    with pytest.raises(UsageError, match="no rotation matrix"):
        inverse_kinematics(job, "left", pin.SE3(2.0 * np.eye(3), np.zeros(3)))
    for platform in (7.0, -7.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match=r"torso_b1 .*: must be from"):
            inverse_kinematics(job, "left", good, platform)


def test_functions_are_those_of_the_commands(tmp_path: Path, found: Plan) -> None:
    """The reach's document, the export's files and document, an explanation's title."""
    run = CliRunner().invoke
    printed = run(
        command_line(), ["robot", "reach", "iiwa7", "--height", "0.2", "--step", "0.2", "--json"]
    )
    assert reach("iiwa7", height=0.2, step=0.2) == json.loads(printed.stdout)
    found.write(tmp_path / "plan", page=False)
    arguments = ["export", str(tmp_path / "plan"), "--to", "ros2", "--rate", "50", "--quiet"]
    assert run(command_line(), [*arguments, "--out", str(tmp_path / "a")]).exit_code == 0
    made = export(found, "ros2", rate=50.0)
    folder = made.write(tmp_path / "b")
    assert made.verification.passed and made.loss is not None
    assert {path.name for path in folder.iterdir()} == {*made.files, "export.json"}
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / "a" / path.name).read_bytes()
    with pytest.raises(OutputError, match=r"already holds .*force=True"):
        export(found, "ros2").write(folder)
    with pytest.raises(UsageError, match="no format 'nps', did you mean 'npz'"):
        export(found, "nps")
    with pytest.raises(UsageError, match=r"add the task file, in Python `job=load"):
        export(found.schedule, "gltf")
    assert explain("e610").title in run(command_line(), ["explain", "E610"]).stdout


@pytest.mark.parametrize("to", ["csv", "ros2"])
def test_an_export_is_written_as_often_as_wanted(
    to: FormatName, tmp_path: Path, found: Plan
) -> None:
    """Each folder gets the same files, none of them empty."""
    made = export(found, to)
    first, second = (made.write(tmp_path / name) for name in ("first", "second"))
    for path in first.iterdir():
        assert path.read_bytes() == (second / path.name).read_bytes() != b""


def test_wrong_values_are_refused_by_name(found: Plan) -> None:
    """With what is allowed: numbers outside their range, words that do not exist."""
    for call, message in (
        (lambda: export(found, "npz", interpolation="spline"), "interpolation 'spline': choose"),
        (lambda: export(found, "csv", interpolation="spline"), "linear, cubic, quintic"),
        (lambda: reach(found.job, height=float("nan")), "height nan m: must be finite"),
        (lambda: plan(found.job, seed=1.5), "seed 1.5: must be an integer from 0"),
        (lambda: plan_many([], seed="a"), "seed 'a': must be an integer from 0"),
        (lambda: plan(found.job, seed=-1), "seed -1: must be an integer from 0"),
        (lambda: sweep("study.yaml", seed=0.5), "seed 0.5: must be an integer from 0"),
        (lambda: compare_solvers(found.job, effort="much"), "effort 'much': choose one of"),
        (lambda: explain("foo"), "no error code 'foo'; in a shell, `dualarm explain` lists all"),
    ):
        with pytest.raises(UsageError, match=message):
            call()


def test_arguments_of_wrong_types_are_refused_by_name(found: Plan) -> None:
    """With the function that makes the right one."""
    job, pose = found.job, pin.SE3.Identity()
    is_job, is_plan = r"must be a Job; `load\(…\)` makes one", r"must be a Plan, .* makes a Plan"
    for call, message in (
        (lambda: load(3), "tasks 3: must be a path, the name of a bundled job"),
        (lambda: load("01_first_pick", [1]), r"changes \[1\]: must be a mapping"),
        (lambda: load("01_first_pick", {1: 2}), "pointer 1: must be text"),
        (lambda: plan("01_first_pick"), f"job '01_first_pick': {is_job}"),
        (lambda: plan_many(job), "jobs <Job .*: must be several Jobs"),
        (lambda: plan_many("ab"), f"job 'a': {is_job}"),
        (lambda: verify(job), f"schedule <Job .*: {is_plan}"),
        (lambda: verify(found.schedule, "01_first_pick"), f"job '01_first_pick': {is_job}"),
        (lambda: compare(found, job), f"after <Job .*: {is_plan}"),
        (lambda: compare_solvers("01_first_pick"), f"job '01_first_pick': {is_job}"),
        (lambda: export(job, "csv"), f"plan <Job .*: {is_plan}"),
        (lambda: explain(610), "code 610: must be text, such as 'E610'"),
        (lambda: inverse_kinematics("01_first_pick", "left", pose), f"job '01.*: {is_job}"),
        (lambda: read_schedule(found), "path <Plan .*: must be the path of a plan's folder"),
        (lambda: found.schedule.sample("x"), r"rate 'x': must be a number \[Hz\]"),
        (lambda: found.schedule.tool_pose("left", "1 s"), r"time '1 s': must be a number \[s\]"),
        (lambda: reach(job, height="80 cm"), r"height '80 cm': must be a number \[m\]"),
        (lambda: reach(job, tilt="5 deg"), r"tilt '5 deg': must be a number \[rad\]"),
        (lambda: reach(job, step="5 cm"), r"step '5 cm': must be a number \[m\]"),
        (lambda: reach(job, handover="80 mm"), r"handover '80 mm': must be a number \[m\]"),
        (lambda: sweep(3), "study 3: must be the path of a study file, the name of a bundled job"),
    ):
        with pytest.raises(UsageError, match=message):
            call()  # type: ignore[no-untyped-call]


def test_studies_are_mappings_and_bundled_ones_too(tmp_path, monkeypatch) -> None:
    """From any folder; faults are placed in the mapping."""
    monkeypatch.chdir(tmp_path)
    study = load_study("04_packing")
    assert study.name == "tasks/04_packing/study.yaml"
    assert study.tasks[0].path.is_file() and len(search.study_points(study)) == 12
    values = {"dualarm": "study/1", "tasks": "01_first_pick", "parameters": {}}
    with pytest.raises(InputError, match=r"^study:4:17: E200 .*at least 1"):
        sweep(values)
    with pytest.raises(InputError, match=r"there is no file '04_packin' here"):
        sweep(
            values
            | {"tasks": "04_packin", "parameters": {"x": {"tasks": "mode", "values": ["free"]}}}
        )
    with pytest.raises(InputError, match=r"no such bundled study, did you mean '04_packing'\?"):
        sweep("04_pakcing")


def test_messages_of_write_name_its_arguments(tmp_path: Path, found: Plan) -> None:
    """Not the options of the command."""
    (tmp_path / "brk.py").touch()
    with pytest.raises(OutputError, match=r"^folder .*brk.py: is a file; name a folder"):
        found.write(tmp_path / "brk.py", page=False)
    found.write(tmp_path / "plan", page=False)
    with pytest.raises(OutputError, match=r"^folder .*already holds .*; pass force=True"):
        found.write(tmp_path / "plan", page=False)
