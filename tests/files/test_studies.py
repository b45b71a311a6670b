"""Study files: what they mean, and everything wrong with one at once and at its place."""

from __future__ import annotations

from pathlib import Path

import pytest

from dualarm_cli.errors import InputError
from dualarm_cli.files.studies.studies import load_study
from dualarm_cli.model.studies.study import Amount, Study

HEAD = "dualarm: study/1\ntasks: tasks.yaml\n"


@pytest.fixture
def study(project: Path):
    """Loads a study of the tiny project from its text below the first two lines."""

    def load(text: str) -> Study:
        (project / "study.yaml").write_text(HEAD + text)
        return load_study("study.yaml")

    return load


@pytest.fixture
def wrong(study):
    """Returns what is wrong with a study."""

    def errors(text: str) -> list[str]:
        with pytest.raises(InputError) as error:
            study(text)
        return [str(d) for d in error.value.diagnostics]

    return errors


def _parameter(rest: str, target: str = "cell: clearance") -> str:
    return f"parameters:\n  p:\n    {target}\n    {rest}\n"


def _written(study: Study) -> list[object]:
    return [v.written if isinstance(v, Amount) else v for v in study.parameters[0].levels]


@pytest.mark.parametrize(
    ("values", "levels"),
    [
        ("range: {from: 0, to: 40 mm, step: 10 mm}", ["0.0 mm", "10.0 mm", "20.0 mm", "30.0 mm", "40.0 mm"]),
        ("range: {from: 0, to: 0.3, step: 0.1}", [0.0, 0.1, 0.2, 0.3]),
        ("range: {from: 1, to: 3, step: 1}", [1, 2, 3]),
        ("range: {from: 0, to: 1, count: 5}", [0.0, 0.25, 0.5, 0.75, 1.0]),
        ("range: {from: 2 cm, to: 30 mm, count: 3}", ["2.0 cm", "2.5 cm", "3.0 cm"]),
        ("values: [5 mm, 0.01]", ["5.0 mm", "10.0 mm"]),
        ("values: [left, right]", ["left", "right"]),
        ("values: [true, false]", [True, False]),
    ],
)  # fmt: skip
def test_values_are_as_people_count(values: str, levels: list[object], study) -> None:
    """In the unit that is written, without 0.30000000000000004."""
    found = _written(study(_parameter(values)))
    assert found == levels
    assert [type(v) for v in found] == [type(v) for v in levels]


def test_a_range_without_steps_is_a_span(study) -> None:
    """For samples and searches."""
    (parameter,) = study(
        _parameter("range: {from: 0, to: 40 mm}") + "sample: {count: 4}\n"
    ).parameters
    assert parameter.span is not None
    assert (parameter.span.low.written, parameter.span.high.written) == ("0.0 mm", "40.0 mm")
    assert parameter.span.at(0.25).written == "10.0 mm"
    assert parameter.levels == ()


def test_targets_move_together_and_are_resolved_to_pointers(study) -> None:
    """By name, each with what the file has."""
    (parameter,) = study(
        "parameters:\n  height:\n    targets:\n      - cell: obstacles.table.xyz[2]\n"
        "      - {cell: 'frames.bin.slot.xyz[2]', apply: set}\n    apply: shift\n    values: [10 mm, 20 mm]\n"
    ).parameters
    assert [t.keys for t in parameter.targets] == [
        ("cell:/obstacles/table/xyz/2",),
        ("cell:/frames/bin.slot/xyz/2",),
    ]
    assert [t.apply for t in parameter.targets] == ["shift", "set"]
    assert [t.present[0].si for t in parameter.targets if t.present[0]] == [0.6, 0]


def test_what_is_not_said_has_a_default(study) -> None:
    """The objective is the cycle time; samples are a Latin hypercube with seed 0."""
    found = study(_parameter("range: {from: 0, to: 1}") + "sample: {count: 4}\n")
    assert [o.name for o in found.objectives] == ["cycle_time"]
    assert found.sampling is not None
    assert (found.sampling.method, found.sampling.seed) == ("latin_hypercube", 0)
    assert found.settings == {}


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("parameters: {}\n", ["study.yaml:3:13: E200 a list of 0 is too short; at least 1 are needed"]),
        (_parameter("vales: [1]"), ["study.yaml:6:5: E201 unknown key 'vales', did you mean 'values'?"]),
        (_parameter("values: [1]", "cel: clearance"), ["study.yaml:5:5: E201 unknown key 'cel', did you mean 'cell'?"]),
        (
            _parameter("values: [1]", "cell: clearence"),
            ["study.yaml:5:11: E300 cell.yaml has no 'clearence', did you mean 'clearance'?"],
        ),
        (
            _parameter("values: [1]", "robot: limits.turn.velocity"),
            [
                "study.yaml:5:12: E300 'limits.turn' of robot.yaml has no 'velocity'; there: acceleration, jerk, "
                "source; position and velocity limits are the URDF's, and cannot be varied"
            ],
        ),
        (
            _parameter("values: [1]", "robot.left: name"),
            ["study.yaml:5:5: E300 tasks.yaml has no file 'robot.left'; its files are: tasks, cell, robot"],
        ),
        (_parameter("values: [1, 1.0]"), ["study.yaml:6:17: E102 1.0 is listed twice"]),
        (
            _parameter("values: [1, x]"),
            ["study.yaml:6:17: E200 'x' is not a number; write one such as 0.12 or '120 mm'; the others are numbers"],
        ),
        (
            _parameter("values: [1 mm, 1 deg]"),
            ["study.yaml:6:20: E200 dimensions differ: '1 deg' is an angle, '1 mm' is a length"],
        ),
        (
            _parameter("values: [[1]]"),
            ["study.yaml:6:14: E200 must be a number, text, true or false, not a list of 1"],
        ),
        (_parameter("values: [1 deg]"), ["study.yaml:5:11: E300 '1 deg' is an angle, '10 mm' is a length"]),
        (
            _parameter("range: {from: 0, to: 10, step: 3}"),
            ["study.yaml:6:36: E200 steps of 3 from 0 end at 9, not at 10; change step or to"],
        ),
        (_parameter("range: {from: 0, to: 10, step: 0}"), ["study.yaml:6:36: E200 a step must be above 0"]),
        (
            _parameter("range: {from: 0, to: 10, step: 1, count: 3}"),
            ["study.yaml:6:39: E200 step and count both set the number of values; keep one"],
        ),
        (_parameter("range: {from: 5, to: 5}"), ["study.yaml:6:26: E200 must be above 'from' (5), not 5"]),
        (_parameter("range: {from: 0, to: 1, step: 0.00001}"), ["makes 100001 values; at most 10000"]),
        (
            _parameter("values: [50%]\n    apply: shift", "tasks: start"),
            ["study.yaml:5:12: E300 only a number can be moved, not 'bent' (tasks.yaml:5:8); write `apply: set`"],
        ),
        (
            _parameter("values: [5 mm]\n    apply: scale"),
            ["study.yaml:5:11: E300 '5 mm' cannot scale a value; write a factor such as 0.9 or 90%"],
        ),
        (_parameter("values: [1]") + "sample: {count: 5}\n", ["study.yaml:7:1: E300 no range is sampled"]),
        (
            _parameter("values: [1]") + "objectives: [cycle_tme]\n",
            ["study.yaml:7:14: E200 'cycle_tme' is not allowed, did you mean 'cycle_time'?"],
        ),
        (_parameter("values: [1]") + "objectives: [gap, gap]\n", ["study.yaml:7:19: E102 'gap' is named twice"]),
        (
            _parameter("values: [1]") + "  q: {cell: clearance, values: [2]}\n",
            ["study.yaml:7:13: E300 parameter 'p' changes the same value, at line 5"],
        ),
        (_parameter("values: [1]") + "settings: {effort: fast}\n", ["study.yaml:7:20: E200 'fast' is not allowed"]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_at_its_place(text: str, messages: list[str], wrong) -> None:
    """Place, code, value, what is allowed."""
    found = wrong(text)
    assert len(found) == len(messages)
    for one, message in zip(found, messages, strict=True):
        assert message in one


def test_errors_of_all_parameters_come_at_once(wrong) -> None:
    """By line."""
    found = wrong(
        "parameters:\n  a: {cell: clear, values: [1]}\n  b: {cell: clearance, range: {from: 1, to: 0}}\n"
        "  c: {robot: nam, values: [x]}\n"
    )
    assert [error.split(":")[1] for error in found] == ["4", "5", "6"]


def test_a_job_that_is_wrong_is_told_of_its_own_file(project: Path, wrong) -> None:
    """And paths into it are not blamed."""
    (project / "cell.yaml").write_text("dualarm: cell/1\nrobot: robot.yaml\nclearance: 3 deg\n")
    assert [e.split(" ")[0] for e in wrong(_parameter("values: [1]", "cell: clear"))] == [
        "cell.yaml:3:12:"
    ]


def test_several_task_files_are_all_read(project: Path) -> None:
    """A path must be in every one; a file that is named twice is refused."""
    (project / "other.yaml").write_text((project / "tasks.yaml").read_text())
    text = "dualarm: study/1\ntasks: [tasks.yaml, other.yaml]\n" + _parameter("values: [1 mm]")
    (project / "study.yaml").write_text(text)
    study = load_study("study.yaml")
    assert [t.name for t in study.tasks] == ["tasks.yaml", "other.yaml"]
    assert study.parameters[0].targets[0].keys == ("cell:/clearance",) * 2
    (project / "study.yaml").write_text(text.replace("other.yaml", "./tasks.yaml"))
    with pytest.raises(InputError, match=r"study.yaml:2:21: E102 './tasks.yaml' is named twice"):
        load_study("study.yaml")
    (project / "study.yaml").write_text(text.replace("other.yaml", "none.yaml"))
    with pytest.raises(
        InputError, match=r"study.yaml:2:21: E500 there is no file 'none.yaml' here"
    ):
        load_study("study.yaml")
